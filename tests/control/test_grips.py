"""Grips are taken near, hold what the gripper bears, and tear beyond it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@pytest.fixture
def held(make_env):
    """Return worlds in which both arms hold the cube, with their action mode."""

    def make(num_envs=1):
        env = make_env(num_envs)
        env.reset(seed=0)
        ask(env, [1.0, 1.0])
        assert holds(env).all()
        return env, env.action_mode

    return make


def ask(env, grips, moves=0.0):
    """Do a control step with these grips."""
    actions = {}
    for agent, grip in zip(env.agents, grips, strict=True):
        actions[agent] = np.full((env.num_envs, 8), moves)
        actions[agent][:, 7] = grip
    return env.step(actions)


def holds(env):
    return np.array([env.scene.holds(env.sim, agent) for agent in env.agents]).T


def push(env, mode, force):
    """Push the cubes of the worlds upwards for a control step, in which arms grip."""
    still = {agent: np.zeros((env.num_envs, 8)) for agent in env.agents}
    for action in still.values():
        action[:, 7] = 1.0
    controls = mode.prepare(mode.commands(still))
    env.sim.xfrc_applied[:, env.model.body("cube/cube").id, 2] = force
    env.sim.step(controls, breaks=mode.tears)
    env.sim.xfrc_applied[:] = 0.0


def test_the_force_on_a_palm_is_that_of_its_grips(held):
    env, _ = held()
    model, data = env.model, mujoco.MjData(env.model)
    mujoco.mj_setState(model, data, env.sim.get_state()[0], STATE)
    data.xfrc_applied[model.body("cube/cube").id] = (40.0, -25.0, 60.0, 1.0, 2.0, 3.0)
    mujoco.mj_step(model, data, 3)
    for grip in env.scene.grips:
        of_grip = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        of_grip &= data.efc_id == model.equality(grip.name).id
        force = np.linalg.norm(data.efc_force[of_grip])
        assert force > 5.0
        assert np.linalg.norm(data.sensor(grip.palm).data) == pytest.approx(force)


def test_a_grip_tears_above_what_its_gripper_holds(held):
    env, mode = held(2)
    limit = env.scene.robots["robot_1"].gripper.holding_force
    push(env, mode, [1.2 * limit, 3.0 * limit])
    assert holds(env).tolist() == [[True, True], [False, False]]


def test_a_grip_tears_beyond_twice_its_threshold(held):
    env, mode = held(2)
    start = int(env.model.jnt_qposadr[env.model.body("cube/cube").jntadr[0]])
    threshold = env.scene.grips[0].threshold
    env.sim.qpos[:, start + 2] += np.array([1.8, 2.2]) * threshold
    env.sim.forward()
    push(env, mode, 0.0)
    assert holds(env).tolist() == [[True, True], [False, False]]


def test_a_torn_grip_is_taken_anew_after_three_control_steps(held):
    env, mode = held()
    before = env.sim.qpos.copy()
    push(env, mode, 3000.0)
    assert not holds(env).any()
    for is_taken in (False, False, False, True):
        # The cube is within reach of both hands, every time.
        env.sim.qpos[:], env.sim.qvel[:] = before, 0.0
        env.sim.forward()
        ask(env, [1.0, 1.0])
        assert (holds(env) == is_taken).all()


def test_a_grip_that_was_let_go_can_be_taken_at_once(held):
    env, _ = held()
    ask(env, [-1.0, -1.0])
    assert not holds(env).any()
    ask(env, [1.0, 1.0])
    assert holds(env).all()


def test_a_hand_that_closed_on_nothing_takes_nothing_until_it_has_opened(make_env):
    env = make_env(2)
    env.reset(seed=0)
    before = env.sim.qpos.copy()
    start = int(env.model.jnt_qposadr[env.model.body("cube/cube").jntadr[0]])

    def bring_cube(up):
        env.sim.qpos[:], env.sim.qvel[:] = before, 0.0
        env.sim.qpos[:, start + 2] += up
        env.sim.forward()

    bring_cube([0.0, 0.2])
    ask(env, [1.0, 1.0])
    assert holds(env).tolist() == [[True, True], [False, False]]
    for grips, taken in (
        ([1.0, 1.0], [False, False]),
        ([-1.0, 1.0], [False, False]),
        ([1.0, 1.0], [True, False]),
    ):
        bring_cube(0.0)
        ask(env, grips)
        assert holds(env)[1].tolist() == taken


def test_a_gripping_partner_opens_its_hand_until_it_holds(make_env):
    env = make_env(1)
    env.reset(seed=0)
    start = int(env.model.jnt_qposadr[env.model.body("cube/cube").jntadr[0]])
    place, act = env.sim.qpos.copy(), cg.load_policy("gripping", env)
    env.sim.qpos[:, start + 2] += 0.2
    env.sim.forward()
    env.step(act({}))
    assert not holds(env).any()
    for _ in range(2):
        env.sim.qpos[:], env.sim.qvel[:] = place, 0.0
        env.sim.forward()
        env.step(act({}))
    assert holds(env).all()
    env.step(act({}))
    assert holds(env).all()


def test_a_gripper_holds_what_its_arm_pulls_if_nothing_else_is_said():
    panda = cg.get_robot("panda")
    assert panda.gripper.holding_force == pytest.approx(87.0 / (0.855 / 8.0))
    weak = replace(panda, gripper=replace(panda.gripper, holding_force=70.0))
    assert weak.gripper.holding_force == 70.0


def torn_apart(env, watched=False, first=None):
    """Play bang-bang with grips on; return what is seen, and how many grips tore."""
    rng = np.random.default_rng(0)
    env.watch((lambda: None) if watched else None, 10 if watched else 1)
    seen, tears, before = [], 0, None
    for step in range(11):
        signs = rng.choice([-1.0, 1.0], size=(2, 4, 8))
        signs[:, :, 7] = 1.0
        if env.num_envs == 1:
            signs = signs[:, first : first + 1]
        if step == 7:
            state = env.get_state()
            env.reset()
            env.set_state(state)
        env.step(dict(zip(env.agents, signs, strict=True)))
        seen.append(env.sim.get_state())
        if before is not None:
            tears += int((before & ~holds(env)).sum())
        before = holds(env)
    return np.array(seen), tears


def test_tears_are_the_same_in_any_number_of_worlds_watched_and_restored(carry):
    panda, task = cg.get_robot("panda"), carry()
    weak = replace(panda, gripper=replace(panda.gripper, holding_force=100.0))
    task = type(task)((weak, weak), task.config)
    env = cg.VectorEnv(task, 4, num_threads=1)
    env.reset(seed=3)
    together, tears = torn_apart(env)
    assert tears > 0
    env.reset(seed=3)
    watched, _ = torn_apart(env, watched=True)
    np.testing.assert_array_equal(watched, together)
    for world in range(4):
        alone = cg.VectorEnv(task, 1, num_threads=1)
        alone.reset(seed=3, episodes=[world])
        seen, _ = torn_apart(alone, first=world)
        np.testing.assert_array_equal(seen[:, 0], together[:, world])
