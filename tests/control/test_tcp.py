"""Actions move the tool as they say, within the limits, and alike for all arms."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.control import get_mode, list_modes, register_mode
from collaborative_gym.testing import play

APART = (cg.Placement((0.0, -3.0, 2.0), 0.7), cg.Placement((0.0, 3.0, 2.0), -2.0))
"""Far from each other and from the floor, and turned."""

ARMS = [("sawyer", "jaco"), ("panda", "panda")]


@pytest.fixture
def free(make_env):
    """Return a function that makes arms in free motion, moved by their tools."""

    def make(num_envs, *robots, action="tcp", **settings):
        settings |= {"placements": APART, "max_episode_steps": 1000}
        env = make_env(num_envs, robots=robots, action=action, **settings)
        env.reset(seed=0)
        return env

    return make


def poses(env):
    """Return the tools' positions and orientations as the arms' bases see them."""
    seen = {}
    for agent, placement in env.task.placements.items():
        position, quat = env.sim.pose(f"{agent}/tcp")
        back = math.conjugate(np.array(placement.quat))
        seen[agent] = math.rotate(back, position), math.multiply(back, quat)
    return seen


def moved(env, actions):
    """Do a control step; return by how much the tools moved and turned."""
    before = poses(env)
    env.step(actions)
    ways = {}
    for agent, (place, quat) in poses(env).items():
        turn = math.multiply(quat, math.conjugate(before[agent][1]))
        ways[agent] = place - before[agent][0], math.rotation_vector(turn)
    return ways


def meant(env, actions):
    """Return the moves of tools whose joints turn exactly as actions come to."""
    before, start = poses(env), env.get_state()
    for agent, command in env.action_mode.commands(actions).items():
        arm = env.scene.arms[agent]
        env.sim.qpos[:, arm.qpos] += command.moves * arm.stride
    env.sim.forward()
    ways = {}
    for agent, (place, quat) in poses(env).items():
        turn = math.multiply(quat, math.conjugate(before[agent][1]))
        shift, turn = place - before[agent][0], math.rotation_vector(turn)
        ways[agent] = np.concatenate([shift / 0.05, turn / 0.15], axis=1)
    env.set_state(start)
    return ways


def asked(env, rows):
    """Return the same moves for each arm, with open grips."""
    rows = np.asarray(rows, float)
    still = -np.ones((len(rows), 1))
    return dict.fromkeys(env.agents, np.concatenate([rows, still], axis=1))


def leans(env, posture):
    """Let all arms keep to a posture."""
    env.scene.postures |= dict.fromkeys(env.agents, posture)
    mode = get_mode(env.task.config.action)
    env.action_mode = mode(env.scene, env.sim, env.task.gripping)


def test_modes_have_names_and_a_wrong_one_is_told(carry):
    assert list_modes()[:3] == ("joints", "tcp", "tcp_position")
    with pytest.raises(KeyError, match=r"no action mode 'tpc' \(did you mean 'tcp'\?"):
        carry(action="tpc")
    with pytest.raises(TypeError, match="action must be the name of an action mode"):
        carry(action=None)
    with pytest.raises(ValueError, match="action mode 'tcp' is registered already"):
        register_mode("tcp", get_mode("joints"))


def test_all_arms_have_one_action_space():
    for action, size in (("tcp", 6), ("impedance", 6), ("tcp_position", 4)):
        for robots in (("panda", "jaco"), ("sawyer", "panda")):
            env = cg.make("Poke", robots=robots, action=action)
            assert {env.action_space(a).shape for a in env.possible_agents} == {(size,)}
            env.close()
    env = cg.make("Lift", robots=("panda", "jaco"), action="tcp")
    assert {env.action_space(a).shape for a in env.possible_agents} == {(7,)}
    env.close()


@pytest.mark.parametrize("robots", ARMS)
def test_a_tool_goes_where_it_is_sent_in_the_frame_of_its_base(free, robots):
    env = free(12, *robots)
    sent = 0.3 * np.concatenate([np.eye(6), -np.eye(6)])
    exact = meant(env, asked(env, sent))
    for agent, (shift, turn) in moved(env, asked(env, sent)).items():
        way = np.concatenate([shift / 0.05, turn / 0.15], axis=1)
        assert np.abs(way - sent).max() < 0.06, agent
        assert np.abs(exact[agent] - sent).max() < 0.004, agent


@pytest.mark.parametrize("robots", ARMS)
def test_no_step_is_longer_and_no_joint_faster_than_allowed(free, robots):
    env, rng = free(8, *robots), np.random.default_rng(0)
    fastest = []
    for _ in range(20):
        actions = {a: rng.uniform(-1, 1, (8, 7)) for a in env.agents}
        for command in env.action_mode.commands(actions).values():
            assert np.abs(command.moves).max() <= 1.0 + 1e-12
        for shift, turn in moved(env, actions).values():
            assert math.norm(shift).max() < 1.2 * 0.05
            assert math.norm(turn).max() < 1.3 * 0.15
        for arm in env.scene.arms.values():
            speed = np.abs(env.sim.qvel[:, arm.dof]) / arm.robot.velocity_limits
            fastest.append(speed.max(axis=1))
            angle, (low, high) = env.sim.qpos[:, arm.qpos], arm.joint_range
            assert np.maximum(low - angle, angle - high).max() < 0.02
    assert np.mean(np.array(fastest) > 1.1) < 0.02


@pytest.mark.parametrize("action", ["tcp", "tcp_position"])
def test_idle_arms_hold_still_and_keep_what_they_exert(free, action):
    env = free(2, "panda", "jaco", action=action)
    leans(env, np.zeros(7))
    for command in env.action_mode.commands(env.idle()).values():
        assert not command.moves.any() and not command.grips.any()
    for shift, turn in moved(env, env.idle()).values():
        assert max(math.norm(shift).max(), math.norm(turn).max()) < 1e-3


def test_what_an_expert_means_is_what_the_tool_does(free):
    """Of motions that are too fast the tool makes a part, in the same direction."""
    env, rng = free(6, "panda", "jaco"), np.random.default_rng(3)
    mode, before = env.action_mode, poses(env)
    motions, goals = {}, {}
    for agent, arm in env.scene.arms.items():
        change = 0.02 * rng.uniform(-1, 1, (6, 7))
        motions[agent] = cg.Motion(change)
        env.sim.qpos[:, arm.qpos] += change
    env.sim.forward()
    for agent, (place, quat) in poses(env).items():
        turn = math.multiply(quat, math.conjugate(before[agent][1]))
        goals[agent] = place - before[agent][0], math.rotation_vector(turn)
        env.sim.qpos[:, env.scene.arms[agent].qpos] -= motions[agent].change
    env.sim.forward()
    actions = mode.encode(motions)
    exact = meant(env, actions)
    for agent, (shift, turn) in goals.items():
        way = np.concatenate([shift / 0.05, turn / 0.15], axis=1)
        np.testing.assert_allclose(exact[agent], way, atol=1e-3)
    for agent, (shift, turn) in moved(env, actions).items():
        assert math.distance(shift, goals[agent][0]).max() < 2e-3
        assert math.distance(turn, goals[agent][1]).max() < 8e-3
    fast = {agent: cg.Motion(40 * each.change) for agent, each in motions.items()}
    for agent, action in mode.encode(fast).items():
        sizes = np.linalg.norm(action[:, :6].reshape(6, 2, 3), axis=2).max(axis=1)
        assert sizes.max() <= 1.0 + 1e-12 and sizes.min() > 0.2, agent


def test_arms_in_step_slow_down_alike(free):
    env = free(2, "panda", "panda")
    slow, fast = (np.full((2, 7), size) for size in (0.01, 0.2))
    encode = env.action_mode.encode
    alone = encode({"robot_1": cg.Motion(slow), "robot_2": cg.Motion(fast)})
    steady = {"robot_1": cg.Motion(slow, in_step=True)}
    together = encode(steady | {"robot_2": cg.Motion(fast, in_step=True)})
    share = together["robot_1"][:, :6] / alone["robot_1"][:, :6]
    assert share.max() < 0.5 and np.ptp(share, axis=1).max() < 1e-9
    np.testing.assert_allclose(together["robot_2"], alone["robot_2"])


@pytest.mark.parametrize("robots", ARMS)
def test_a_stretched_arm_slows_down_and_never_jumps(free, robots):
    env = free(4, *robots)
    away = np.zeros((4, 6))
    away[:, :3] = [[1, 0, 0], [0, 0, 1], [0.7, 0, 0.7], [0, 1, 0]]
    lengths, turns = [], []
    for _ in range(45):
        commands = env.action_mode.commands(asked(env, away)).values()
        turns.append(np.concatenate([command.moves for command in commands], axis=1))
        ways = moved(env, asked(env, away))
        lengths.append([math.norm(shift) for shift, _ in ways.values()])
    assert np.max(lengths) < 1.2 * 0.05
    one, other = np.array(turns[:-1]), np.array(turns[1:])
    to_and_fro = (one * other < 0.0) & (np.minimum(abs(one), abs(other)) > 0.2)
    assert to_and_fro.sum() <= 5
    # Most are as far away as they can be by now.
    assert np.median(lengths[-5:]) < 0.02
    back = moved(env, asked(env, -away))
    assert np.mean([math.norm(shift) for shift, _ in back.values()]) > 0.005


def test_a_redundant_arm_goes_to_its_posture_as_it_moves(free):
    env = free(2, "panda", "panda")
    arm, home = env.scene.arms["robot_1"], poses(env)["robot_1"][0].copy()
    start = env.sim.qpos[:, arm.qpos].copy()
    posture = start[0] + 0.4 * np.eye(7)[2]
    leans(env, posture)
    to_and_fro = np.zeros((2, 6))
    for i in range(12):
        to_and_fro[:, 0] = 0.2 * (-1) ** i
        env.step(asked(env, to_and_fro))
    turned = env.sim.qpos[:, arm.qpos] - start
    assert (turned[:, 2] > 0.05).all()
    assert math.distance(poses(env)["robot_1"][0], home).max() < 0.01


def test_a_tool_whose_place_is_commanded_keeps_its_tilt(free):
    env, rng = free(4, "panda", "jaco", action="tcp_position"), np.random.default_rng(0)
    tilts = {a: math.axis_z(quat).copy() for a, (_, quat) in poses(env).items()}
    turn = np.zeros((4, 4))
    turn[:, 3] = 0.5
    for way in (rng.uniform(-1, 1, (4, 4)), turn):
        for shift, turned in moved(env, asked(env, way)).values():
            assert math.norm(turned[:, :2]).max() < 0.04
            assert math.norm(shift).max() < 1.2 * 0.05
    for _ in range(6):
        env.step(asked(env, turn))
    for agent, (_, quat) in poses(env).items():
        tilt = math.axis_z(quat)
        np.testing.assert_allclose(tilt[:, 2], tilts[agent][:, 2], atol=0.05)


def test_an_episode_is_the_same_in_any_batch_and_restored(make_env):
    alone = make_env(1, robots=("panda", "jaco"), action="tcp")
    alone.reset(seed=3)
    expected = play(alone, 5 * 12)
    env = make_env(5, robots=("panda", "jaco"), action="tcp", num_threads=2)
    env.reset(seed=3)
    seen = play(env, 12)
    assert all(seen[3, episode] == expected[3, episode] for episode in range(5))
    env.reset(seed=3)
    ways = []
    actions = {agent: np.full((5, 7), 0.3) for agent in env.agents}
    for _ in range(3):
        env.step(actions)
    state = env.get_state()
    for _ in range(2):
        env.set_state(state)
        ways.append([env.step(actions)[0]["robot_2"] for _ in range(4)])
    np.testing.assert_array_equal(*ways)


def test_effort_is_that_of_the_joint_changes_that_actions_come_to(free):
    env = free(3, "panda", "jaco")
    actions = asked(env, np.full((3, 6), 0.2))
    commands = env.action_mode.commands(actions)
    *_, infos = env.step(actions)
    for agent, command in commands.items():
        expected = -math.dot(command.moves, command.moves) / 100
        effort = infos["reward_terms"][agent]["effort"]
        np.testing.assert_allclose(effort, expected, rtol=1e-6)
