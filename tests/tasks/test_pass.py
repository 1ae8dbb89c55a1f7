"""Pass: rewards and success, the need for both robots, the hand-over, the cube."""

from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pytest

from collaborative_gym import Randomization, VectorEnv
from collaborative_gym.control import Command
from collaborative_gym.objects.cube import cube
from collaborative_gym.robots import list_robots
from collaborative_gym.scene import Scene
from collaborative_gym.tasks.registry import make_task

IDS = ("PassTaskSawyers-v0", "PassTaskJacoSawyer-v0")
PAIRS = [*product(("sawyer", "panda", "jaco"), repeat=2)]
PAIRS += [("panda", name) for name in list_robots()[3:]]
AGENTS = ("robot_1", "robot_2")


@pytest.fixture(scope="module")
def sawyers():
    env = VectorEnv(make_task(IDS[0], randomization="paper"), 1, num_threads=1)
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module", params=IDS)
def variant(request):
    return VectorEnv(make_task(request.param), 8, num_threads=1)


def play(env, steps, idle=(), each_step=lambda env: None):
    """Play the expert; return in which worlds the goal was reached."""
    reached = np.zeros(env.num_envs, bool)
    for _ in range(steps):
        actions = env.expert()
        for agent in idle:
            actions[agent] = env.idle()[agent]
        reached |= env.step(actions)[4]["success"]
        each_step(env)
    return reached


def situation(facts, to_cube=(0.5, 0.5), to_target=1.0, holds=(False, False)):
    """Return facts with these distances and holds."""
    return replace(
        facts,
        to_cube={a: np.array([d]) for a, d in zip(AGENTS, to_cube, strict=True)},
        to_next={"robot_1": np.array([to_cube[1]])},
        to_target=np.array([to_target]),
        holds={a: np.array([h]) for a, h in zip(AGENTS, holds, strict=True)},
    )


def rewards(env, facts, grips=(0.0, 0.0)):
    """Return each robot's reward for standing still, gripping where told."""
    commands = {
        agent: Command(np.zeros((1, 7)), np.array([grip > 0]))
        for agent, grip in zip(AGENTS, grips, strict=True)
    }
    terms = env.task.reward(facts, commands)
    return [sum(terms[agent].values())[0] for agent in AGENTS]


def least_distance(model, arm, point, tries=5):
    """Return how near an arm can bring its tcp to a point, its joint limits kept."""
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    rng = np.random.default_rng(0)
    low, high = arm.joint_range
    least = np.inf
    for _ in range(tries):
        angle = np.array(arm.robot.home) + rng.uniform(-1.5, 1.5, len(low))
        for _ in range(120):
            data.qpos[arm.qpos] = angle = np.clip(angle, low, high)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian, None, arm.tcp)
            missing = point - data.site_xpos[arm.tcp]
            least = min(least, np.linalg.norm(missing))
            columns = jacobian[:, arm.dof]
            pull = missing * min(1.0, 0.3 / np.linalg.norm(missing))
            damped = columns @ columns.T + 0.03 * np.eye(3)
            angle = angle + columns.T @ np.linalg.solve(damped, pull)
    return least


def test_paper_starts_as_in_the_thesis(sawyers):
    sawyers.reset(seed=0)
    assert sawyers.facts.cubes[0][0, 0] == pytest.approx((0.8, -0.6, 0.66), abs=1e-3)
    assert sawyers.facts.targets[0, 0] == pytest.approx((1.2, 0.7, 1.3), abs=1e-9)


def test_observation_is_as_in_the_thesis(sawyers):
    for agent in AGENTS:
        blocks = sawyers.observation_blocks[agent].values()
        assert [(block.name, block.size) for block in blocks] == [
            ("joints", 7),
            ("robot_1 end effector", 7),
            ("robot_2 end effector", 7),
            ("robot_1 gripping", 1),
            ("robot_2 gripping", 1),
            ("cube", 7),
            ("target", 3),
        ]
        assert sawyers.single_observation_spaces[agent].shape == (33,)
        assert sawyers.single_action_spaces[agent].shape == (8,)


@pytest.mark.parametrize(
    ("to_cube", "grips", "expected"),
    [
        ((0.5, 0.4), (0, 0), (-0.9, -1.4)),
        ((0.5, 0.4), (1, 1), (-0.9, -1.4)),
        ((0.02, 0.4), (1, 1), (-0.32, -1.4)),
        ((0.02, 0.04), (1, 1), (0.2 - 0.04 - 0.1, -1.04 + 0.1)),
        ((0.02, 0.04), (0, 1), (0.2 - 0.04, -1.04 + 0.1)),
        ((0.50, 0.04), (0, 1), (0.2 - 0.04, -1.04 + 0.1)),
    ],
)
def test_rewards(sawyers, to_cube, grips, expected):
    facts = situation(sawyers.facts, to_cube)
    assert rewards(sawyers, facts, grips) == pytest.approx(expected)


def test_moving_costs_a_hundredth_of_its_length(sawyers):
    open_hand, moves = np.zeros(1, bool), np.zeros((2, 1, 7))
    moves[0, :, :2] = 0.6, 0.8
    commands = {a: Command(m, open_hand) for a, m in zip(AGENTS, moves, strict=True)}
    terms = sawyers.task.reward(situation(sawyers.facts), commands)
    assert terms["robot_1"]["effort"] == pytest.approx(-0.01)
    assert terms["robot_2"]["effort"] == pytest.approx(0.0)


def test_success_needs_the_cube_at_the_target_in_the_grip_of_robot_2(sawyers):
    there = {"to_target": 0.119, "to_cube": (0.5, 0.06)}
    for holds, expected in (((False, True), 1.0), ((True, False), 0.0)):
        facts = situation(sawyers.facts, **there, holds=holds)
        assert sawyers.task.success(facts) == [expected]
        gained = rewards(sawyers, facts)
        assert gained == pytest.approx([-0.56 + expected, -0.179 + expected])
    far = situation(sawyers.facts, to_target=0.121, holds=(False, True))
    assert not sawyers.task.success(far)


def test_expert_passes_the_cube(variant):
    variant.reset(seed=1)
    assert play(variant, 45).all()


@pytest.mark.parametrize("name", (*IDS, "Pass"))
def test_expert_passes_the_cube_gently_even_where_its_actions_come_late(name):
    robots = ("panda", "jaco") if name == "Pass" else None
    task = make_task(name, robots, randomization=Randomization(delay=1))
    env = VectorEnv(task, 8, num_threads=1, strain=True)
    env.reset(seed=1)
    for _ in range(70):
        infos = env.step(env.expert())[4]
    assert infos["success"].all()
    strain = infos["metrics"]["strain"]
    assert strain["torque_limit_share"].mean() < 0.05
    assert strain["contact_depth_arms"].max() < 0.003


def test_expert_picks_up_a_cube_that_it_lost_over_either_table(variant):
    variant.reset(seed=1)
    held, lost, reached = np.zeros(8, int), np.zeros(8, bool), np.zeros(8, bool)
    fell_beyond = np.zeros(8, bool)
    for _ in range(120):
        actions = variant.expert()
        held += variant.facts.holds["robot_1"]
        # Where it leaves its table, and where it flies on to the other one.
        now = (held > [0, 0, 1, 1, 2, 2, 4, 4]) & ~lost
        actions["robot_1"][now, -1] = -1.0
        lost |= now
        reached |= variant.step(actions)[4]["success"]
        place = variant.facts.cubes[0][:, 0]
        fell_beyond |= (place[:, 1] > 0.1) & (place[:, 2] < 0.7)
    assert lost.all() and reached.all() and fell_beyond.any()


@pytest.mark.parametrize("idle", AGENTS)
def test_one_robot_cannot_pass_alone(variant, idle):
    variant.reset(seed=1)
    assert not play(variant, 50, idle=[idle]).any()


@pytest.mark.parametrize("robots", PAIRS, ids="-".join)
def test_no_arm_reaches_both_cube_and_target(robots):
    task, scene = make_task("Pass", robots), Scene()
    task.build(scene)
    model = scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    spread, config = task.config.randomization, task.config
    # A UR5e takes a pot of Lift to nearly the end of its reach, so it stands nearer; a
    # UR10e's reach includes its hand.
    reserve = 0.02 if robots[1] in ("ur5e", "ur10e") else 0.1
    cube = data.body("cube/cube").xpos
    target = np.array([1.2, task.placements["robot_2"].position[1], 1.3])
    alone = least_distance(model, scene.arms["robot_1"], target)
    drawn = 3**0.5 * spread.target_position
    assert alone > config.success_radius + drawn + reserve
    alone = least_distance(model, scene.arms["robot_2"], cube)
    drawn = 2**0.5 * spread.object_position
    assert alone > config.handover_threshold + drawn + reserve


def test_both_hold_still_during_the_hand_over(variant):
    variant.reset(seed=2)
    seen = np.zeros(8, bool)

    def check(env):
        both = env.facts.holds["robot_1"] & env.facts.holds["robot_2"]
        seen[both] = True
        for agent in AGENTS:
            assert (env.facts.to_cube[agent][both] < 0.02).all()
            joints = env.sim.qvel[both, env.scene.arms[agent].dof]
            assert (np.abs(joints) < 1.0).all()

    play(variant, 30, each_step=check)
    assert seen.all()


def test_neither_pulls_the_cube_out_of_a_hand_that_holds_on(variant):
    for puller, holder in (AGENTS, AGENTS[::-1]):
        variant.reset(seed=2)
        rng = np.random.default_rng(0)
        pulls = np.sign(rng.uniform(-1.0, 1.0, (8, 8)))
        pulls[:, -1] = 1.0
        pulling, torn = np.zeros(8, bool), np.zeros(8, bool)
        for _ in range(60):
            actions = variant.expert()
            pulling |= variant.facts.holds[puller] & variant.facts.holds[holder]
            actions[puller][pulling] = pulls[pulling]
            still = variant.idle({puller: False, holder: True})
            actions[holder][pulling] = still[holder][pulling]
            held = variant.facts.holds[holder] & pulling
            variant.step(actions)
            tears = held & ~variant.facts.holds[holder]
            assert not variant.facts.holds[puller][tears].any()
            torn |= tears
        assert pulling.all() and torn.sum() >= 4


def test_robots_that_both_go_on_holding_come_to_rest(variant):
    variant.reset(seed=2)
    both = np.zeros(8, bool)
    for _ in range(40):
        actions = variant.expert()
        both |= variant.facts.holds["robot_1"] & variant.facts.holds["robot_2"]
        for agent in AGENTS:
            actions[agent][both] = 0.0
            actions[agent][both, -1] = 1.0
        variant.step(actions)
    assert both.all()
    assert np.abs(variant.sim.qvel).max() < 0.05


def test_at_the_start_only_the_cube_touches_its_table():
    for robots in (("panda", "sawyer"), ("jaco", "jaco")):
        env = VectorEnv(make_task("Pass", robots), 8, num_threads=1)
        env.reset(seed=3)
        for world in range(8):
            data = env.sim.data(world)
            pairs = {(env.model.geom(c.geom1).name, c.geom2) for c in data.contact}
            cube_geom = env.model.geom("cube/cube").id
            assert pairs <= {("robot_1_table/table_top_collision", cube_geom)}
            assert (data.contact.dist > -1e-3).all()


def test_cube_stops_turning():
    model = cube(size=0.04, mass=0.05).compile()
    assert model.body("cube").mass == pytest.approx(0.05)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.qvel[:] = (1, 0, 0, 0, 0, 5)
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    assert data.qvel[0] > 0.99
    assert np.abs(data.qvel[3:]).max() < 0.01
