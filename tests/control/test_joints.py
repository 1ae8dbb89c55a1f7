"""Actions become servo commands within the real arms' limits."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.control import JointChanges
from collaborative_gym.scene import Scene
from collaborative_gym.sim.cpu import CpuSim

APART = (cg.Placement((0.0, -3.0, 2.0)), cg.Placement((0.0, 3.0, 2.0)))
"""Far from each other and from the floor."""

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@pytest.fixture
def free(make_env):
    """Return a function that makes arms in free motion."""

    def make(num_envs, *robots, **settings):
        settings |= {"placements": APART, "max_episode_steps": 1000}
        env = make_env(num_envs, robots=robots, **settings)
        env.reset(seed=0)
        return env

    return make


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_an_arm_turns_by_what_is_asked_and_stays(free, robots):
    env = free(2, *robots)
    arms = env.scene.arms
    asked = {agent: np.zeros((2, 8)) for agent in env.agents}
    for agent in env.agents:
        asked[agent][0, :7] = 0.5
    before = {agent: env.sim.qpos[:, arm.qpos].copy() for agent, arm in arms.items()}
    for agent in env.agents:
        asked[agent][:, 7] = -1.0
    env.step(asked)
    stay = {agent: np.zeros((2, 8)) for agent in env.agents}
    env.step(stay)
    for agent, arm in arms.items():
        turned = env.sim.qpos[:, arm.qpos] - before[agent]
        scale = np.minimum(0.25, 0.1 * np.array(arm.robot.velocity_limits))
        np.testing.assert_allclose(turned[0], 0.5 * scale, atol=0.15 * scale.min())
        np.testing.assert_allclose(turned[1], 0.0, atol=0.01)
    held = {agent: env.sim.qpos[:, arm.qpos].copy() for agent, arm in arms.items()}
    for _ in range(20):
        env.step(stay)
    for agent, arm in arms.items():
        np.testing.assert_allclose(env.sim.qpos[:, arm.qpos], held[agent], atol=0.02)


@pytest.fixture
def speeds():
    """Return a function that records joint speeds as shares of their limits."""

    def record(env):
        shares = {agent: [] for agent in env.agents}

        def watch():
            for agent, arm in env.scene.arms.items():
                speed = np.abs(env.sim.qvel[:, arm.dof]) / arm.robot.velocity_limits
                shares[agent].append(speed)

        env.watch(watch, env.substeps)
        return shares

    return record


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_a_joint_that_turns_alone_keeps_its_speed_limit(free, speeds, robots):
    env = free(14, *robots)
    shares = speeds(env)
    # Each world turns one joint, up or down.
    joints = np.concatenate([np.eye(7), -np.eye(7)])
    for turn in (1.0, 1.0, 1.0, 0.0):
        action = np.concatenate([turn * joints, np.zeros((14, 1))], axis=1)
        env.step(dict.fromkeys(env.agents, action))
    for agent, arm in env.scene.arms.items():
        fastest = np.max(shares[agent], axis=(0, 1))
        full = np.minimum(1.0, 2.5 / np.array(arm.robot.velocity_limits))
        assert (fastest < 1.11).all()
        assert (fastest > 0.95 * full).all()


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_a_joint_turns_most_of_a_full_command_in_its_step(free, robots):
    at_home = cg.Randomization(joint_noise=0.0)
    env = free(14, *robots, randomization=at_home)
    arms = env.scene.arms
    joints = np.concatenate([np.eye(7), -np.eye(7)])
    before = {agent: env.sim.qpos[:, arm.qpos].copy() for agent, arm in arms.items()}
    action = np.concatenate([joints, np.zeros((14, 1))], axis=1)
    env.step(dict.fromkeys(env.agents, action))
    for agent, arm in arms.items():
        turned = (env.sim.qpos[:, arm.qpos] - before[agent]) * joints
        scale = np.minimum(0.25, 0.1 * np.array(arm.robot.velocity_limits))
        share = (turned / scale).sum(axis=1)
        assert (share > 0.8).all()
        assert (share < 1.1).all()


@pytest.mark.parametrize("name", cg.list_robots())
@pytest.mark.parametrize(
    ("nudge", "least", "most"), [(0.0, -1e-3, 1e-3), (0.05, 1e-3, 1e-2)]
)
def test_a_payload_is_held_at_rest_and_sinks_slowly_in_motion(name, nudge, least, most):
    scene, robot, load = Scene(), cg.get_robot(name), mujoco.MjSpec()
    scene.add_robot("arm", robot, placement=cg.Placement((0.0, 0.0, 3.0)))
    body = load.worldbody.add_body(name="load")
    body.add_geom(size=[0.03, 0, 0], mass=robot.payload, contype=0, conaffinity=0)
    scene.add_tool("arm", "load", child=load)
    JointChanges.add_drives(scene)
    model = scene.compile()
    arm, sim = scene.arms["arm"], CpuSim(model, 8, num_threads=1)
    mode = JointChanges(scene, sim, gripping=False)
    rng = np.random.default_rng(0)
    # Postures of which joint torques leave 30 % to spare.
    sim.qpos[:, arm.qpos] = robot.home
    for row in range(8):
        while True:
            drawn = rng.uniform(-0.5, 0.5, arm.num_joints)
            sim.qpos[row, arm.qpos] = robot.home + drawn
            sim.forward()
            levers = sim.jacobian(arm.hand, sim.pose("arm/tcp")[0])[0][row, 2, arm.dof]
            torque = np.abs(levers) * robot.payload * 9.81
            if np.all(torque < 0.7 * np.array(robot.torque_limits)):
                break
    mode.start(np.arange(8))
    sim.forward()
    ask = np.full((8, arm.num_joints), nudge)
    heights = [sim.pose("arm/tcp")[0][:, 2].copy()]
    for i in range(16):
        sim.step(mode.prepare(mode.commands({"arm": ask * (-1) ** i})))
        heights.append(sim.pose("arm/tcp")[0][:, 2].copy())
    # Each is of a step to and one fro. The first steps take the load on; from then on
    # the servos carry all or most of it.
    sunk = -np.diff(heights[6::2], axis=0) / 2
    assert least < sunk.mean() and sunk.max() < most


@pytest.mark.parametrize(
    ("nudge", "least", "most"), [(0.0, 0.5, 1.1), (0.05, 0.0, 0.2)]
)
def test_what_arms_exert_against_each_other_dies_away_as_they_move(nudge, least, most):
    env = cg.make_vec("BalanceTaskSawyers-v0", 2, num_threads=1)
    env.reset(seed=0)
    arm = env.scene.arms["robot_1"]
    # Both play the same episode, but one arm of the second presses against the board.
    env.set_state(env.get_state([0]), [1])
    # Its targets come first, and lead its angles.
    lead = 0.5 * np.array(arm.robot.torque_limits) / arm.robot.stiffness
    env.sim.act[1, : arm.num_joints] += lead
    pressed = []
    for i in range(8):
        nudges = {a: each + nudge * (-1) ** i for a, each in env.idle().items()}
        env.step(nudges)
        torque = env.action_mode.torques(env.sim, "robot_1")
        pressed.append(np.abs(torque[1] - torque[0]).max())
    assert pressed[0] > 5.0 and least <= pressed[-1] / pressed[0] < most


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_random_actions_seldom_pass_a_speed_limit_by_a_tenth(free, speeds, robots):
    """They ask for more torque than the motors have, and so for some catching up."""
    env = free(8, *robots)
    shares = speeds(env)
    rng = np.random.default_rng(0)
    for _ in range(20):
        actions = rng.uniform(-1, 1, (2, 8, 8))
        env.step(dict(zip(env.agents, actions, strict=True)))
    for agent in env.agents:
        assert np.mean(np.array(shares[agent]) > 1.1) < 0.02


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_ranges_and_torques_are_kept_whatever_is_asked(free, robots):
    env = free(8, *robots)
    mode, data = env.action_mode, mujoco.MjData(env.model)
    rng = np.random.default_rng(1)
    # Half of the worlds push steadily into their ranges, the others to and fro.
    steady = rng.choice([-1.0, 1.0], size=(2, 4, 8))
    for step in range(40):
        to_and_fro = rng.choice([-1.0, 1.0], size=(2, 4, 8))
        signs = np.concatenate([steady, to_and_fro], axis=1)
        actions = dict(zip(env.agents, signs, strict=True))
        before, world = env.get_state(), step % 8
        controls = mode.prepare(mode.commands(actions))[world]
        mujoco.mj_setState(env.model, data, env.sim.get_state([world])[0], STATE)
        env.set_state(before)
        for control in controls:
            data.ctrl = control
            mujoco.mj_step(env.model, data)
            for arm in env.scene.arms.values():
                torque = np.abs(data.qfrc_actuator[arm.dof])
                assert (torque <= np.array(arm.robot.torque_limits) + 1e-9).all()
        env.step(actions)
        for arm in env.scene.arms.values():
            low, high = arm.joint_range
            angle = env.sim.qpos[:, arm.qpos]
            beyond = np.maximum(low - angle, angle - high)
            # Swung arms give a little where they hit the end of a range.
            assert beyond[:4].max() < 0.02
            assert beyond[4:].max() < 0.05


@pytest.mark.parametrize("robots", [("sawyer", "jaco"), ("panda", "panda")])
def test_a_joint_that_is_turned_too_fast_is_braked_by_its_motors_limit(free, robots):
    env = free(1, *robots)
    for sign in (1.0, -1.0):
        env.reset(seed=0)
        data = env.sim.data(0)
        for arm in env.scene.arms.values():
            data.qvel[arm.dof] = sign * 3.0 * np.array(arm.robot.velocity_limits)
        for _ in range(2):
            mujoco.mj_step(env.model, data)
            for arm in env.scene.arms.values():
                brakes = -sign * np.array(arm.robot.torque_limits)
                np.testing.assert_allclose(data.qfrc_actuator[arm.dof], brakes)


def test_a_grip_needs_to_be_near_and_lasts_while_it_is_asked_for(make_env):
    env = make_env(2)
    env.reset(seed=0)
    equality = [env.model.equality(grip.name).id for grip in env.scene.grips]
    ask = {agent: np.zeros((2, 8)) for agent in env.agents}

    def grips(first, second):
        ask["robot_1"][:, 7] = first
        ask["robot_2"][:, 7] = second
        env.step(ask)
        return env.sim.eq_active[:, equality].tolist()

    assert grips(0.0, -1.0) == [[0, 0], [0, 0]]
    env.reset(seed=0)
    free = env.model.joint(env.model.body("cube/cube").jntadr[0]).qposadr[0]
    env.sim.qpos[1, free + 2] += 0.2
    env.sim.forward()
    assert grips(1.0, 0.5) == [[1, 1], [0, 0]]
    for _ in range(3):
        assert grips(1.0, 0.5)[0] == [1, 1]
    distance = np.stack([env.facts.distance[agent][0] for agent in env.agents])
    assert (distance < 5e-3).all()
    assert grips(1.0, 1.0)[0] == [1, 1]
    assert grips(-1.0, 1.0)[0] == [0, 1]


def test_new_episodes_begin_with_open_grips_and_holding_servos(make_env):
    env = make_env(1)
    env.reset(seed=0)
    env.step(env.expert())
    assert env.sim.eq_active.any()
    env.reset()
    assert not env.sim.eq_active.any()
    for agent, arm in env.scene.arms.items():
        assert not env.action_mode.torques(env.sim, agent).any()
        np.testing.assert_array_equal(env.sim.ctrl[:, arm.servos], 0.0)


def test_a_grip_draws_together_without_a_jerk(make_env):
    env = make_env(1)
    env.reset(seed=0)
    grip = next(grip for grip in env.scene.grips if grip.agent == "robot_1")
    site = env.model.site(grip.site)
    start = int(env.model.jnt_qposadr[env.model.body_jntadr[site.bodyid[0]]])
    tcp = env.sim.pose("robot_1/tcp")[0][0].copy()
    env.sim.qpos[0, start : start + 3] = tcp - site.pos + [0.03, 0, 0]
    env.sim.forward()
    gaps = [0.03]

    def measure():
        apart = env.sim.pose("robot_1/tcp")[0] - env.sim.pose(grip.site)[0]
        gaps.append(float(np.linalg.norm(apart)))

    env.watch(measure, shots=10)
    actions = {agent: np.zeros((1, 8)) for agent in env.agents}
    actions["robot_1"][:, -1] = 1.0
    for _ in range(5):
        env.step(actions)
    closing = -np.diff(gaps) / env.model.opt.timestep
    assert 0.05 < max(closing) < 0.4
    assert gaps[-1] < 0.015
