"""What an arm's value leaves out is computed from its model."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE, SIM_DT

COMPUTED = {"armature": (), "damping": (), "stiffness": ()}


def test_what_is_left_out_is_filled_in(own, compiled):
    assert own.title == "own"
    assert (own.stand, own.tcp) == ("table", "tcp")
    assert own.torque_limits == (105, 105, 70, 24, 24, 24)
    bare, data = compiled(own)
    full = np.zeros((bare.nv, bare.nv))
    mujoco.mj_fullM(bare, data, full)
    links = np.diag(full)[[int(bare.joint(name).dofadr[0]) for name in own.joints]]
    rotors = np.array(own.armature)
    # But for the fingers, which are open when it is computed.
    np.testing.assert_allclose(own.damping, (links + rotors) / SIM_DT, rtol=3e-3)
    np.testing.assert_allclose(own.stiffness, 8.0 * np.array(own.damping))
    speed = np.minimum(own.velocity_limits, MAX_CHANGE / CONTROL_DT)
    push = np.array(own.torque_limits) / speed
    np.testing.assert_allclose(
        rotors, np.maximum(0.02 * push - links, 0.01 * push), rtol=3e-3
    )


def test_what_is_given_is_kept(edited, in_a_world):
    rotor = ('range="-3.4 3.4"', 'range="-3.4 3.4" armature="0.7"')
    arm = edited(rotor, torque_limits=(31.0, 32.0, 33.0, 34.0, 35.0, 36.0))
    assert arm.armature[3] == pytest.approx(0.7)
    assert arm.damping[3] > 70.0
    assert arm.torque_limits == (31, 32, 33, 34, 35, 36)
    given = edited(stiffness=(900.0,) * 6, damping=(90.0,) * 6, armature=(0.4,) * 6)
    assert given.stiffness == (900.0,) * 6
    _, model = in_a_world(given)
    np.testing.assert_allclose(model.dof_armature[:6], 0.4)
    np.testing.assert_allclose(model.actuator("arm/joint_1").gainprm[0], 900.0)


def test_the_files_torque_limits_do_not_bind_those_that_are_given(edited, compiled):
    model, _ = compiled(edited(torque_limits=(500.0,) * 6))
    assert not model.jnt_actfrclimited.any()


@pytest.mark.parametrize("name", ["own", "sawyer", "panda", "jaco"])
def test_computed_gains_follow_commands(own, make_env, name):
    robot = replace(cg.get_robot(name), **COMPUTED)
    count = len(robot.joints)
    apart = (cg.Placement((0, -3, 2)), cg.Placement((0, 3, 2)))
    still = cg.Randomization(joint_noise=0.0)
    env = make_env(
        2 * count, robots=(robot, robot), placements=apart, randomization=still
    )
    env.reset(seed=0)
    arm, speeds = env.scene.arms["robot_1"], []
    env.watch(lambda: speeds.append(np.abs(env.sim.qvel[:, arm.dof])), env.substeps)
    # Each world turns one joint, one way or the other.
    joints = np.concatenate([np.eye(count), -np.eye(count)])
    idle = np.zeros((2 * count, 1))
    scale = np.minimum(MAX_CHANGE, CONTROL_DT * np.array(robot.velocity_limits))
    turned = []
    for turn in (1.0, 1.0, -1.0):
        before = env.sim.qpos[:, arm.qpos].copy()
        action = np.concatenate([turn * joints, idle], axis=1)
        env.step(dict.fromkeys(env.agents, action))
        turned.append(turn * ((env.sim.qpos[:, arm.qpos] - before) / scale * joints))
    shares = np.sum(turned, axis=2)
    assert (shares[0] > 0.8).all()
    assert (np.abs(shares[1] - 1.0) < 0.03).all()
    peak = np.max(speeds, axis=(0, 1)) / robot.velocity_limits
    assert (peak < 1.12).all()
