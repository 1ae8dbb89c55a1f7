"""The arms against published kinematics, limits and masses.

`fk_samples.json` holds poses of flange and grip centre for random joint angles, from
the makers' kinematics: position (m) and quaternion (w x y z) in the base frame. Without
MuJoCo, UR5e's are from the URDF of airo-models 0.0.12, xArm7's from that of
example-robot-data 6.0.0, Gen3's from the origins in ros2_kortex's gen3_macro.xacro, and
those of UR10e, FR3 and iiwa 14 from published Denavit-Hartenberg parameters.
"""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.control import JointChanges
from collaborative_gym.scene import Scene

SAMPLES = json.loads(Path(__file__).with_name("fk_samples.json").read_text())
NAMES = sorted(SAMPLES)

TURN = 2 * np.pi
RANGES = {
    "fr3": [
        (-2.7437, 2.7437),
        (-1.7837, 1.7837),
        (-2.9007, 2.9007),
        (-3.0421, -0.1518),
        (-2.8065, 2.8065),
        (0.5445, 4.5169),
        (-3.0159, 3.0159),
    ],
    "gen3": [
        (-TURN, TURN),
        (-2.24973, 2.24973),
        (-TURN, TURN),
        (-2.5796, 2.5796),
        (-TURN, TURN),
        (-2.09963, 2.09963),
        (-TURN, TURN),
    ],
    "iiwa14": [(-2.96706, 2.96706), (-2.0944, 2.0944)] * 3 + [(-3.05433, 3.05433)],
    "jaco": [
        (-TURN, TURN),
        (0.82030475, 5.4628806),
        (-TURN, TURN),
        (0.52359878, 5.7595865),
        (-TURN, TURN),
        (1.134464, 5.1487213),
        (-TURN, TURN),
    ],
    "panda": [
        (-2.8973, 2.8973),
        (-1.7628, 1.7628),
        (-2.8973, 2.8973),
        (-3.0718, -0.0698),
        (-2.8973, 2.8973),
        (-0.0175, 3.7525),
        (-2.8973, 2.8973),
    ],
    "sawyer": [
        (-3.0503, 3.0503),
        (-3.8095, 2.2736),
        (-3.0426, 3.0426),
        (-3.0439, 3.0439),
        (-2.9761, 2.9761),
        (-2.9761, 2.9761),
        (-4.7124, 4.7124),
    ],
    **dict.fromkeys(
        ("ur5e", "ur10e"), [(-TURN, TURN)] * 2 + [(-np.pi, np.pi)] + [(-TURN, TURN)] * 3
    ),
    "xarm7": [
        (-TURN, TURN),
        (-2.059, 2.0944),
        (-TURN, TURN),
        (-0.19198, 3.927),
        (-TURN, TURN),
        (-1.69297, np.pi),
        (-TURN, TURN),
    ],
}

VELOCITIES = {
    "fr3": (2.62,) * 4 + (5.26, 4.18, 5.26),
    "gen3": (1.3963,) * 4 + (1.2218,) * 3,
    "iiwa14": np.radians((85, 85, 100, 75, 130, 135, 135)),
    "jaco": (0.62831853,) * 4 + (0.83775804,) * 3,
    "panda": (2.175,) * 4 + (2.61,) * 3,
    "sawyer": (1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),
    "ur5e": (np.pi,) * 6,
    "ur10e": np.radians((120, 120, 180, 180, 180, 180)),
    "xarm7": (np.pi,) * 7,
}

TORQUES = {
    "fr3": (87.0,) * 4 + (12.0,) * 3,
    "gen3": (39.0,) * 4 + (9.0,) * 3,
    "iiwa14": (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
    "jaco": (30.5,) * 4 + (6.8,) * 3,
    "panda": (87.0,) * 4 + (12.0,) * 3,
    "sawyer": (80.0, 80.0, 40.0, 40.0, 9.0, 9.0, 9.0),
    "ur5e": (150.0,) * 3 + (28.0,) * 3,
    "ur10e": (330.0, 330.0, 150.0) + (56.0,) * 3,
    "xarm7": (50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0),
}

ARM_MASSES = {"fr3": 17.891, "gen3": 8.188, "iiwa14": 30.61, "ur5e": 21.7}
ARM_MASSES |= {"ur10e": 33.104, "xarm7": 11.317}
HANDS = {"fr3": 0.76, "xarm7": 0.75156}
"""Of Robotiq's 2F-85, without an entry: 0.893 kg."""

MASSES = {"jaco": 5.557, "panda": 17.452, "sawyer": 21.095}
MASSES |= {name: mass + HANDS.get(name, 0.893041) for name, mass in ARM_MASSES.items()}
"""Arm, gripper and, of Sawyer, head; in kg."""


@pytest.fixture(params=NAMES)
def robot(request):
    return cg.get_robot(request.param)


def compiled(robot):
    model = robot.spec().compile()
    return model, mujoco.MjData(model)


def set_joints(robot, data, angles):
    for joint, angle in zip(robot.joints, angles, strict=True):
        data.joint(joint).qpos = angle


def test_the_arms_are_listed():
    assert sorted(cg.list_robots()) == NAMES
    assert all(cg.get_robot(name).name == name for name in NAMES)


def test_forward_kinematics_are_the_makers(robot):
    model, data = compiled(robot)
    turn, rest = np.zeros(4), np.zeros(4)
    assert len(SAMPLES[robot.name]) == 20
    for sample in SAMPLES[robot.name]:
        set_joints(robot, data, sample["q"])
        mujoco.mj_kinematics(model, data)
        for name in ("flange", "tcp"):
            position, quat = sample[name]
            site = data.site(name)
            assert np.linalg.norm(site.xpos - position) < 1e-4
            mujoco.mju_mat2Quat(turn, site.xmat)
            mujoco.mju_negQuat(rest, np.array(quat))
            mujoco.mju_mulQuat(turn, rest, turn.copy())
            assert 2 * np.linalg.norm(turn[1:]) < np.radians(0.01)


def test_joint_ranges_are_the_makers(robot):
    model, _ = compiled(robot)
    ranges = [model.joint(joint).range for joint in robot.joints]
    np.testing.assert_allclose(ranges, RANGES[robot.name], atol=1e-6)
    assert all(model.joint(joint).limited for joint in robot.joints)


def test_speeds_and_torques_are_the_makers(robot):
    np.testing.assert_allclose(robot.velocity_limits, VELOCITIES[robot.name])
    np.testing.assert_allclose(robot.torque_limits, TORQUES[robot.name])


def test_the_mass_is_the_makers(robot):
    model, _ = compiled(robot)
    assert model.body_mass.sum() == pytest.approx(MASSES[robot.name], abs=1e-3)


def test_home_is_well_inside_the_ranges_and_touches_nothing(robot):
    model, data = compiled(robot)
    low, high = np.transpose(RANGES[robot.name])
    assert (low + 0.05 < robot.home).all()
    assert (robot.home < high - 0.05).all()
    set_joints(robot, data, robot.home)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_servos_have_the_arms_limits(robot):
    scene = Scene()
    scene.add_robot("arm", robot, placement=cg.Placement((0, 0, 1)))
    JointChanges.add_drives(scene)
    model = scene.compile()
    for i, joint in enumerate(robot.joints):
        servo = model.actuator(f"arm/{joint}")
        torque = robot.torque_limits[i]
        np.testing.assert_allclose(servo.forcerange, (-torque, torque))


def test_links_float_and_fingers_do_not_stray(robot):
    """Links are gravity compensated, as real controllers do; fingers are not."""
    scene = Scene()
    scene.add_robot("arm", robot, placement=cg.Placement((0, 0, 1)))
    JointChanges.add_drives(scene)
    model = scene.compile()
    for joint in robot.joints:
        body = model.jnt_bodyid[model.joint(f"arm/{joint}").id]
        assert model.body_gravcomp[body] == 1
    arm, data = scene.arms["arm"], mujoco.MjData(model)
    data.qpos[arm.qpos] = data.act[:] = robot.home
    data.ctrl[arm.fingers] = robot.gripper.open_position
    for joint in robot.gripper.joints:
        data.joint(f"arm/{joint}").qpos = robot.gripper.open_position
    start = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=100)
    assert np.abs(data.qpos - start)[arm.qpos].max() < 5e-3
    stroke = abs(robot.gripper.closed_position - robot.gripper.open_position)
    for joint in robot.gripper.joints:
        strayed = data.joint(f"arm/{joint}").qpos - robot.gripper.open_position
        assert abs(strayed) < 0.1 * stroke


def test_fingers_open_and_close_along_the_tcps_y_axis(robot):
    gripper = robot.gripper
    assert gripper.position(gripper.open_gap) == pytest.approx(gripper.open_position)
    assert gripper.position(gripper.closed_gap) == pytest.approx(
        gripper.closed_position
    )
    assert gripper.position(1.0) == pytest.approx(gripper.open_position)
    model, data = compiled(robot)
    bodies = [model.jnt_bodyid[model.joint(name).id] for name in gripper.joints]
    spread = []
    for position in (gripper.open_position, gripper.closed_position):
        for joint in gripper.joints:
            data.joint(joint).qpos = position
        mujoco.mj_forward(model, data)
        tcp = data.site("tcp")
        across = tcp.xmat.reshape(3, 3)[:, 1]
        spread.append([(data.xipos[body] - tcp.xpos) @ across for body in bodies])
    opened, closed = np.array(spread)
    assert opened.min() < 0 < opened.max()
    assert (np.abs(closed) < np.abs(opened)).all()


def test_fingers_that_hold_are_where_their_joints_would_put_them(robot, in_a_world):
    _, free = in_a_world(robot)
    _, fixed = in_a_world(robot, holds=0.03)
    data, held = mujoco.MjData(free), mujoco.MjData(fixed)
    for joint in robot.gripper.joints:
        data.joint(f"arm/{joint}").qpos = robot.gripper.position(0.03)
    mujoco.mj_kinematics(free, data)
    mujoco.mj_kinematics(fixed, held)
    for joint in robot.gripper.joints:
        body = free.body(free.joint(f"arm/{joint}").bodyid.item()).name
        np.testing.assert_allclose(
            held.body(body).xpos, data.body(body).xpos, atol=1e-6
        )
        np.testing.assert_allclose(
            held.body(body).xmat, data.body(body).xmat, atol=1e-6
        )


def test_an_unknown_arm_is_refused_with_the_nearest():
    with pytest.raises(KeyError) as caught:
        cg.get_robot("sawer")
    assert str(caught.value) == (
        "no robot 'sawer' (did you mean 'sawyer'?); robots: fr3, gen3, iiwa14, jaco,"
        " panda, sawyer, ur10e, ur5e, xarm7; for one of your own, load its file"
        " (--module FILE, cg.load_module)"
    )


@pytest.mark.parametrize(
    "field",
    (
        "home",
        "velocity_limits",
        "torque_limits",
        "stiffness",
        "damping",
        "armature",
    ),
)
def test_every_joint_needs_every_value(robot, field):
    assert cg.get_robot(robot) is robot
    count = len(robot.joints)
    message = f"has {count} joints but {count - 1} values in {field}"
    with pytest.raises(ValueError, match=message):
        replace(robot, **{field: getattr(robot, field)[:-1]})


def test_names_that_the_model_file_lacks_are_refused(robot):
    with pytest.raises(
        ValueError, match=rf"{robot.name}.xml has no joint 'joint9'.*; j"
    ):
        replace(robot, joints=(*robot.joints[:-1], "joint9"))
    with pytest.raises(ValueError, match=r"has no frame 'tool'; frames: .*tcp"):
        replace(robot, tcp="tool")
