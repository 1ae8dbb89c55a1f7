"""Balance: what counts as fallen and reached, honest starts, a ball that rolls."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from collaborative_gym import Randomization, VectorEnv, math
from collaborative_gym.objects.ball import RADIUS, ball
from collaborative_gym.policies.scripted import expert_policy
from collaborative_gym.scene import Placement
from collaborative_gym.tasks.registry import make_task

IDS = ("BalanceTaskSawyers-v0", "BalanceTaskJacoSawyer-v0")
PUSHED, UNPUSHED = IDS


def make(env_id, num_envs, **options):
    env = VectorEnv(make_task(env_id, **options), num_envs, num_threads=1)
    env.reset(seed=0)
    return env


def parted(env):
    """Return how far both tcps are from their handles, in m and rad."""
    board, pulled, turned = env.sim.pose("board"), [], []
    for agent, name in zip(env.agents, ("handle_1", "handle_2"), strict=True):
        site, tcp = (
            env.model.site(f"robot_1/board/{name}"),
            env.sim.pose(f"{agent}/tcp"),
        )
        pos, quat = (np.tile(row, (env.num_envs, 1)) for row in (site.pos, site.quat))
        pulled.append(math.distance(tcp[0], board[0] + math.rotate(board[1], pos)))
        turn = math.multiply(math.multiply(board[1], quat), math.conjugate(tcp[1]))
        turned.append(math.norm(math.rotation_vector(turn)))
    return np.max(pulled), np.max(turned)


@pytest.fixture(scope="module")
def option():
    """Return the physics options of the compiled task."""
    return make(UNPUSHED, 1).model.opt


def roll(option, slope, speed, turn):
    """Return the speed of a rolling ball one second later, and how fast it slips.

    It rolls on a floor, `turn` from the x axis, with gravity turned as on the slope.
    """
    spec = mujoco.MjSpec()
    for name in ("timestep", "integrator", "cone", "impratio"):
        setattr(spec.option, name, getattr(option, name))
    along = np.array([np.cos(turn), np.sin(turn)])
    axis = np.array([-along[1], along[0]])
    down = -9.81 * np.cos(slope)
    spec.option.gravity = [*(9.81 * np.sin(slope) * along), down]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[9, 9, 1])
    spec.attach(ball(), frame=spec.worldbody.add_frame(pos=[0, 0, RADIUS]), prefix="b/")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:2], data.qvel[3:5] = speed * along, speed / RADIUS * axis
    mujoco.mj_step(model, data, nstep=100)
    reached = data.qvel[:2] @ along
    return reached, reached - RADIUS * (data.qvel[3:5] @ axis)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("randomization", ["default", "paper"])
def test_starts_level_held_and_at_rest(env_id, randomization):
    env = make(env_id, 8, randomization=randomization)
    facts = env.facts
    pulled, turned = parted(env)
    assert pulled < 1e-4 and turned < 2e-4
    np.testing.assert_allclose(math.axis_z(facts.board[1])[:, 2], 1.0, atol=1e-6)
    np.testing.assert_allclose(facts.offset[:, 2], 0.06, atol=1e-6)
    assert np.ptp(facts.offset[:, 1]) > 0.3
    moved = np.ptp(facts.board[0], axis=0)
    joints = [np.ptp(facts.joints[agent], axis=0) for agent in env.agents]
    if randomization == "paper":
        assert np.max(moved) < 1e-12 and np.max(joints) < 1e-12
    else:
        assert np.min(moved) > 0.03 and np.min(joints) > 0.05
    for world in range(env.num_envs):
        # At most the ball on the plate, and that without weight yet.
        contacts = env.sim.data(world).contact
        assert len(contacts) <= 1 and np.all(contacts.dist > -1e-6)
    env.step({agent: np.zeros((8, 7)) for agent in env.agents})
    assert np.abs(env.facts.offset[:, 2] - 0.06).max() < 1e-3


def test_observation_has_the_thesis_blocks():
    env = make(UNPUSHED, 1)
    for agent in env.agents:
        blocks = env.observation_blocks[agent].values()
        assert [(block.name, block.size) for block in blocks] == [
            ("robot_1 joints", 7),
            ("robot_2 joints", 7),
            ("ball", 7),
            ("ball linear velocity", 3),
            ("ball angular velocity", 3),
            ("board", 7),
        ]
        assert env.single_observation_spaces[agent].shape == (34,)


def test_reward_and_success_of_known_facts():
    env = make(UNPUSHED, 3)
    facts = replace(
        env.facts,
        distance=np.array([0.089, 0.091, 0.05]),
        fell=np.array([False, False, True]),
    )
    np.testing.assert_array_equal(env.task.success(facts), [True, False, False])
    np.testing.assert_array_equal(env.task.performing(facts), [True, True, False])
    terms = env.task.reward(facts, {})
    for agent in env.agents:
        np.testing.assert_array_equal(terms[agent]["distance"], -facts.distance)
        np.testing.assert_array_equal(terms[agent]["fell"], [0.0, 0.0, -1.0])


def test_a_fallen_ball_never_counts_as_back():
    env = make(UNPUSHED, 2)
    sim, first = env.sim, int(env.model.joint("ball/free").qposadr[0])
    ball_pos = sim.qpos[1, first : first + 3]
    for place in ([0, 0, -0.06], [0.41, 0, 0.06], [0, 0.76, 0.06]):
        env.reset(seed=0)
        board, quat = (array[1] for array in sim.pose("board"))
        ball_pos[:] = board + math.rotate(quat, np.array(place))
        sim.forward()
        np.testing.assert_array_equal(env.task.measure(sim).fell, [False, True])
        ball_pos[:] = board + np.array([0, 0, 0.06])
        sim.forward()
        facts = env.task.measure(sim)
        np.testing.assert_array_equal(facts.fell, [False, True])
        assert not env.task.success(facts)[1]
    env.reset(seed=0)
    assert not env.facts.fell.any()


def test_the_ball_rolls_as_friction_says(option):
    for turn in (0.0, np.pi / 4):
        for slope in (0.03, 0.07):
            assert roll(option, slope, 0.0, turn)[0] < 0.02
        speed, slip = roll(option, 0.12, 0.0, turn)
        expected = 5 / 7 * 9.81 * (np.sin(0.12) - 0.075 * np.cos(0.12))
        assert speed == pytest.approx(expected, rel=0.05)
        assert abs(slip) < 0.01 * speed
        speed, slip = roll(option, 0.0, 0.8, turn)
        assert speed == pytest.approx(0.8 - 5 / 7 * 9.81 * 0.075, abs=0.03)
        assert abs(slip) < 0.01 * speed


def test_pushes_belong_to_the_episode():
    alone, among = make(PUSHED, 1), make(PUSHED, 3)
    alone.reset(seed=0, episodes=[2])
    pushes = alone.sim.memory["pushes"]
    np.testing.assert_array_equal(pushes[0], among.sim.memory["pushes"][2])
    assert pushes.shape == (1, 200, 3)
    assert 9 < np.abs(pushes[0, :, 0]).max() < 10
    steps = np.array([5, 6, 7])
    among.task.disturb(among.sim, steps)
    board = among.model.body("robot_1/board/board").id
    wrench = among.sim.xfrc_applied[:, board]
    force, *point = among.sim.memory["pushes"][[0, 1, 2], steps].T
    lever = math.rotate(among.facts.board[1], np.stack([*point, 0 * force], axis=1))
    up = np.stack([0 * force, 0 * force, force], axis=1)
    np.testing.assert_allclose(wrench, np.hstack([up, np.cross(lever, up)]))


def test_variants_without_a_push_are_left_alone():
    env = make(UNPUSHED, 1)
    env.step(env.expert())
    assert "pushes" not in env.sim.memory
    assert not env.sim.xfrc_applied.any()


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("delay", [0, 1])
def test_the_expert_brings_the_ball_to_the_middle_and_rests(env_id, delay):
    env = make(env_id, 6, randomization=Randomization(delay=delay))
    policy = expert_policy(env)
    for _ in range(60):
        actions = policy({})
        *_, infos = env.step(actions)
        pulled, turned = parted(env)
        assert pulled < 3e-3 and turned < np.radians(0.7)
    assert infos["success"].all()
    assert all(np.abs(action).max() < 0.2 for action in actions.values())


def test_the_board_stays_held_under_random_actions():
    env = make(PUSHED, 4)
    rng = np.random.default_rng(0)
    for _ in range(40):
        env.step({agent: rng.uniform(-1, 1, (4, 7)) for agent in env.agents})
        pulled, turned = parted(env)
        assert pulled < 0.01 and turned < np.radians(4)


def test_arms_out_of_reach_are_refused():
    placements = (Placement((0, -2.5, 1.0), np.pi / 2), Placement((0, 1.8, 1.0)))
    with pytest.raises(ValueError, match="sawyer cannot bring its tcp"):
        make(PUSHED, 1, placements=placements)


def test_a_world_that_rests_does_not_stop_the_pushes_of_others():
    task = make_task("BalanceTaskSawyers-v0", max_episode_steps=2)
    env = VectorEnv(task, num_envs=2, auto_reset=False, num_threads=1)
    env.reset(seed=0)
    begun = env.get_state([1])
    for _ in range(2):
        env.step(env.idle())
    ended = env.get_state([0])
    env.set_state(begun, [1])
    *_, infos = env.step(env.idle())
    assert infos["step"].tolist() == [2, 1]
    np.testing.assert_array_equal(env.get_state([0]).physics, ended.physics)
