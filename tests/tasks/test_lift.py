from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from collaborative_gym import math
from collaborative_gym.control import Command
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.motion import greatest_load, strongest_way
from collaborative_gym.objects.pot import pot
from collaborative_gym.robots import get_robot, list_robots
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.tasks.lift import Lift, LiftConfig, LiftFacts
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization

VARIANTS = ("LiftTaskSawyers-v0", "LiftTaskJacos-v0")
LEVEL = [1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module", params=VARIANTS)
def env(request):
    env = VectorEnv(make_task(request.param), num_envs=6, num_threads=1)
    yield env
    env.close()


def play(env, idle=None, steps=200, policy=None):
    observations, _ = env.reset(seed=0)
    for _ in range(steps):
        actions = policy(observations) if policy else env.expert()
        if idle is not None:
            actions[idle] = env.idle()[idle]
        infos = env.step(actions)[4]
    return infos


def facts(pot_pose=((0.0, 0.0, 1.0), LEVEL), far=0.3):
    """Return facts of two worlds that are alike but for the distance to the handle."""
    two = np.ones((2, 1))
    handle = two * np.array([0.0, -0.14, 1.05]), two * np.array(LEVEL)
    tcp = handle[0] - [[0.01, 0.0, 0.0], [far, 0.0, 0.0]], handle[1]
    place, quat = two * np.array(pot_pose[0]), two * np.array(pot_pose[1])
    target = two * np.array([0.0, 0.0, 1.2])
    roll, pitch = math.roll_pitch(quat)
    agents = ("robot_1", "robot_2")
    return LiftFacts(
        joints=dict.fromkeys(agents, np.zeros((2, 7))),
        gripping=dict.fromkeys(agents, np.zeros(2, bool)),
        handles=dict.fromkeys(agents, handle),
        tcps=dict.fromkeys(agents, tcp),
        pot=(place, quat),
        target=target,
        to_handle=dict.fromkeys(agents, math.distance(handle[0], tcp[0])),
        to_target=math.distance(place, target),
        tilt=np.abs(roll) + np.abs(pitch),
        speed=np.zeros(2),
        **dict.fromkeys(("stage", "idle", "handle_spread"), np.zeros(2)),
    )


def rewards(moves, grips):
    """Return what arms get for the same command, in worlds that nobody needs."""
    task = Lift((get_robot("panda"), get_robot("panda")), LiftConfig())
    command = Command(np.array([moves] * 2), np.array([grips] * 2))
    return task.reward(facts(), dict.fromkeys(task.agents, command))


def test_expert_lifts_from_every_start_and_holds(env):
    metrics = play(env)["metrics"]
    assert metrics["completion"].mean() == 1.0
    assert metrics["performance"].mean() > 0.95


@pytest.mark.parametrize("name", (*VARIANTS, "Lift"))
def test_expert_lifts_gently_even_where_its_actions_come_late(name):
    robots = ("panda", "jaco") if name == "Lift" else None
    task = make_task(name, robots, randomization=Randomization(delay=1))
    metrics = play(VectorEnv(task, 6, num_threads=1, strain=True))["metrics"]
    assert metrics["completion"].all()
    assert metrics["performance"].mean() > 0.95
    assert metrics["strain"]["torque_limit_share"].mean() < 0.05
    assert metrics["strain"]["internal_force_mean"].max() < 30.0


@pytest.mark.parametrize("loser", ("robot_1", "robot_2"))
def test_expert_lifts_again_where_a_grip_was_lost(env, loser):
    lost = np.zeros(6, bool)

    def clumsy(observations):
        actions = env.expert()
        high = env.facts.pot[0][:, 2] > np.linspace(0.72, 1.0, 6)
        actions[loser][high & ~lost, -1] = -1.0
        lost[high] = True
        return actions

    metrics = play(env, policy=clumsy)["metrics"]
    assert lost.all()
    assert metrics["completion"].sum() >= 5


@pytest.mark.parametrize("idle", ("robot_1", "robot_2"))
def test_expert_fails_while_one_robot_is_idle(env, idle):
    assert play(env, idle)["metrics"]["completion"].max() == 0.0


def test_pot_is_held_level_and_at_its_handles(env):
    play(env, steps=150)
    assert env.facts.tilt.max() < np.radians(5)
    for agent in env.agents:
        assert env.facts.gripping[agent].all()
        assert env.facts.to_handle[agent].max() < 0.003


def test_joint_torques_stay_within_the_limits_while_holding(env):
    play(env, steps=100)
    data = env.sim.data(0)
    for arm in env.scene.arms.values():
        torque = np.abs(data.actuator_force[arm.servos])
        assert (torque <= np.array(arm.robot.torque_limits) + 1e-9).all()


def test_observation_has_the_blocks_of_the_thesis(env):
    for blocks in env.observation_blocks.values():
        assert [(block.name, block.size) for block in blocks.values()] == [
            ("robot_1 joints", 7),
            ("robot_2 joints", 7),
            ("robot_1 gripping", 1),
            ("robot_2 gripping", 1),
            ("robot_1 handle", 7),
            ("robot_2 handle", 7),
            ("robot_1 tcp", 7),
            ("robot_2 tcp", 7),
            ("pot", 7),
            ("target", 3),
        ]


def test_start_is_at_rest_and_free_of_contact_but_for_the_table(env):
    env.reset(seed=0)
    for world in range(env.num_envs):
        data = env.sim.data(world)
        for contact in data.contact:
            bodies = env.model.geom_bodyid[contact.geom]
            names = {env.model.body(body).name for body in bodies}
            # A finger may graze the table.
            assert names == {"pot/pot", "table/table"} or contact.dist > -1e-3


def test_reward_terms_by_hand():
    terms = rewards((0.6, 0.8), True)["robot_1"]
    assert terms["reach"] == pytest.approx([-0.01, -0.3])
    assert terms["lift"] == pytest.approx([-0.4, -0.4])
    assert terms["tilt"] == pytest.approx([0.0, 0.0])
    assert terms["effort"] == pytest.approx([-0.01, -0.01])
    assert terms["grip"] == pytest.approx([0.1, 0.0])


def test_grip_is_rewarded_only_where_it_is_asked_for():
    assert rewards((0.0, 0.0), False)["robot_2"]["grip"].max() == 0.0


def test_tilt_is_roll_and_pitch_and_costs_a_fifth(env):
    env.reset(seed=0)
    first = int(env.model.jnt_qposadr[env.model.body("pot/pot").jntadr[0]])
    roll, pitch = (math.from_rotation_vector(0.3 * axis) for axis in np.eye(3)[:2])
    env.sim.qpos[0, first + 3 : first + 7] = roll
    env.sim.qpos[1, first + 3 : first + 7] = math.multiply(pitch, roll)
    env.sim.forward()
    measured = env.task.measure(env.sim)
    assert measured.tilt[:3] == pytest.approx([0.3, 0.6, 0.0], abs=1e-6)
    still = dict.fromkeys(env.agents, Command(np.zeros((6, 7)), np.zeros(6, bool)))
    for terms in env.task.reward(measured, still).values():
        assert terms["tilt"][:3] == pytest.approx([-0.06, -0.12, 0.0], abs=1e-6)


def test_success_is_within_the_radius_level_and_slow_in_both_grips():
    task = Lift((get_robot("panda"), get_robot("panda")), LiftConfig())
    gripping = {"robot_1": np.array([True, True]), "robot_2": np.array([True, False])}
    near = replace(facts(((0.0, 0.1, 1.29), LEVEL)), gripping=gripping)
    # The second world's pot was swung there by one arm.
    assert task.success(near).tolist() == [True, False]
    far = replace(facts(((0.0, 0.1, 1.32), LEVEL)), gripping=gripping)
    assert not task.success(far).any()
    tilts, speeds = np.radians([14.0, 16.0]), np.array([0.29, 0.31])
    both = dict.fromkeys(gripping, np.array([True, True]))
    for changed in ({"tilt": tilts}, {"speed": speeds}):
        held = replace(near, gripping=both, **changed)
        assert task.success(held).tolist() == [True, False]


# Of the other pairs those that are too unequal are refused.
ALIKE = [*product(("sawyer", "panda", "jaco"), repeat=2)]
ALIKE += [(name, name) for name in list_robots()[3:] if name != "ur10e"]


@pytest.mark.parametrize("robots", ALIKE)
def test_pot_is_too_heavy_for_one_and_light_enough_for_two(robots):
    task = make_task("Lift", robots=robots)
    task.build(Scene())
    assert task.pot_mass >= 1.2 * max(task.weighing.fewer)
    assert task.weighing.together >= 1.2 * task.pot_mass
    assert max(task.weighing.shares) <= 0.65


def test_arms_that_do_not_suit_each_other_are_refused_with_their_loads():
    near = (
        Placement((0, -0.6, 0.65), np.pi / 2),
        Placement((0, 0.9, 0.65), -np.pi / 2),
    )
    task = make_task("Lift", robots=("panda", "jaco"), placements=near)
    with pytest.raises(ValueError, match="must need both arms") as told:
        task.build(Scene())
    assert "without robot_2" in str(told.value)
    assert "mount all but robot_2 farther from the pot" in str(told.value)


def test_pot_mass_can_be_given():
    task = make_task("Lift", robots=("jaco", "jaco"), pot_mass=1.5)
    task.build(Scene())
    assert task.pot_mass == 1.5


@pytest.mark.parametrize("settings", ({"mass": 0.0}, {"mass": 1.0, "balance": 0.06}))
def test_impossible_pots_are_refused(settings):
    with pytest.raises(ValueError, match=r"(mass|balance) must be"):
        pot(**settings)


def test_contents_shift_the_centre_of_mass():
    model = pot(10.0, balance=0.02).compile()
    assert model.body("pot").mass[0] == pytest.approx(10.0)
    assert model.body("pot").ipos == pytest.approx([0.0, 0.02, 0.0])


def test_greatest_load_is_bounded_by_the_shoulder():
    robot = get_robot("jaco")
    load = greatest_load(robot, ((0.7, 0.0, 0.3),))
    # Two shoulder joints at right angles carry it between them at most.
    assert 0.7 * robot.payload < load < 2 * robot.torque_limits[1] / (0.7 * GRAVITY)
    stronger = replace(robot, torque_limits=tuple(2 * t for t in robot.torque_limits))
    assert greatest_load(stronger, ((0.7, 0.0, 0.3),)) == pytest.approx(2 * load)


def test_way_out_of_reach_is_refused():
    with pytest.raises(ValueError, match="jaco cannot carry a load"):
        strongest_way(get_robot("jaco"), start=(1.5, 0.0, 0.1), end=(1.5, 0.0, 0.5))
