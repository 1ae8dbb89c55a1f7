"""Springs hold the tool: as stiff as they say, softly, and without a swing."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math

APART = (cg.Placement((0.0, -3.0, 2.0), 0.7), cg.Placement((0.0, 3.0, 2.0), -2.0))


@pytest.fixture
def free(make_env):
    """Return a function that makes arms in free motion, held by springs."""

    def make(num_envs, *robots, action="impedance"):
        settings = {"placements": APART, "max_episode_steps": 1000}
        settings["randomization"] = cg.Randomization(joint_noise=0.0)
        env = make_env(num_envs, robots=robots, action=action, **settings)
        env.reset(seed=0)
        for _ in range(10):
            env.step(env.idle())  # The springs take the weight of the fingers on.
        return env

    return make


def places(env):
    return {agent: env.sim.pose(f"{agent}/tcp")[0] for agent in env.agents}


def pushed(env, newtons):
    """Return how far tools give way, (axes, 3) in m; world i is pushed along axis i."""
    before = places(env)
    for arm in env.scene.arms.values():
        data = env.sim.data(0)
        lever = data.site_xpos[arm.tcp] - data.xipos[arm.hand]
        for axis in range(3):
            force = newtons * np.eye(3)[axis]
            env.sim.xfrc_applied[axis, arm.hand, :3] = force
            env.sim.xfrc_applied[axis, arm.hand, 3:] = np.cross(lever, force)
    for _ in range(10):
        env.step(env.idle())
    return {agent: (place - before[agent])[:3] for agent, place in places(env).items()}


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_a_tool_gives_way_as_its_springs_say_and_comes_back(free, robots):
    env = free(3, *robots)
    start = places(env)
    for agent, ways in pushed(env, 5.0).items():
        softness = np.linalg.eigvalsh((ways + ways.T) / 2 / 5.0)
        stiffness = 1.0 / softness[::-1] / 1000.0
        # 1000 N/m in the mean of the directions; softer across the arm than along it.
        assert 0.7 < np.prod(stiffness) ** (1 / 3) < 1.4, (agent, stiffness)
        assert 0.3 < stiffness[0] < stiffness[1] < 1.0 < stiffness[2] < 10.0
    stiff = {
        a: np.abs(w).max()
        for a, w in pushed(free(3, *robots, action="tcp"), 5.0).items()
    }
    soft = {a: np.abs(w).max() for a, w in pushed(free(3, *robots), 5.0).items()}
    assert all(soft[agent] > 1.5 * stiff[agent] for agent in soft)
    env.sim.xfrc_applied[:] = 0.0
    away, paths = places(env), {agent: [] for agent in env.agents}

    def watch():
        for agent, place in places(env).items():
            way = away[agent] - start[agent]
            paths[agent].append(
                math.dot(place - start[agent], way) / math.dot(way, way)
            )

    env.watch(watch, 10)
    for _ in range(10):
        env.step(env.idle())
    for rows in paths.values():
        # It is critically damped, so it does not swing past its target.
        assert np.min(rows) > -0.1 and np.abs(rows[-1]).max() < 0.05


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_a_tool_goes_where_it_is_sent_and_does_not_swing(free, robots):
    env = free(6, *robots)
    way = np.concatenate([np.eye(3), -np.eye(3)])
    sent = np.concatenate([0.4 * way, np.zeros((6, 3)), -np.ones((6, 1))], axis=1)
    start, ways = places(env), {agent: [] for agent in env.agents}

    def watch():
        for agent, place in places(env).items():
            moved = place - start[agent]
            back = math.conjugate(np.array(env.task.placements[agent].quat))
            ways[agent].append(math.dot(math.rotate(back, moved), way))

    env.watch(watch, 10)
    env.step(dict.fromkeys(env.agents, sent))
    for _ in range(9):
        env.step(env.idle())
    for agent, rows in ways.items():
        rows = np.array(rows) / 0.02
        assert (np.abs(rows[-1] - 1.0) < 0.3).all(), agent
        assert (rows.max(axis=0) < 1.2).all(), agent


def test_servos_are_as_stiff_as_the_tools_springs_and_critically_damped(free):
    env = free(2, "panda", "jaco")
    env.step(env.idle())
    gain, bias = (env.sim.expand(f"actuator_{name}prm") for name in ("gain", "bias"))
    data, inertia = env.sim.data(1), np.zeros((env.model.nv,) * 2)
    mujoco.mj_fullM(env.model, data, inertia)
    for agent, arm in env.scene.arms.items():
        place = env.sim.pose(f"{agent}/tcp")[0]
        shift, turn = (
            each[1][:, arm.dof] for each in env.sim.jacobian(arm.hand, place)
        )
        expected = 1000.0 * (shift**2).sum(axis=0) + 50.0 * (turn**2).sum(axis=0)
        np.testing.assert_allclose(gain[1, arm.servos, 0], expected, rtol=3e-3)
        np.testing.assert_array_equal(bias[:, arm.servos, 1], -gain[:, arm.servos, 0])
        damping = 2.0 * np.sqrt(expected * np.diag(inertia)[arm.dof])
        np.testing.assert_allclose(-bias[1, arm.servos, 2], damping, rtol=0.02)


def test_an_action_says_how_stiff_the_springs_are(free):
    env = free(3, "panda", "jaco", action="impedance_stiffness")
    fixed = free(3, "panda", "jaco")
    actions = env.idle()
    assert {rows.shape for rows in actions.values()} == {(3, 8)}
    actions["robot_1"][:, 6] = [-1.0, 0.0, 1.0]
    for each, moves in ((env, actions), (fixed, fixed.idle())):
        each.step(moves)
    gain, usual = (each.sim.expand("actuator_gainprm") for each in (env, fixed))
    for agent, by in (("robot_1", [0.25, 1.0, 4.0]), ("robot_2", [1.0, 1.0, 1.0])):
        servos = env.scene.arms[agent].servos
        np.testing.assert_allclose(
            gain[:, servos, 0], np.outer(by, usual[0, servos, 0]), rtol=2e-3
        )
    # What holds now is in the state.
    state, seen = env.get_state(), env.action_mode.torques(env.sim, "robot_1").copy()
    env.step(env.idle())
    env.set_state(state)
    np.testing.assert_array_equal(env.action_mode.torques(env.sim, "robot_1"), seen)
    for agent, action in env.expert().items():
        np.testing.assert_allclose(action[:, 6], 0.0, err_msg=agent)
