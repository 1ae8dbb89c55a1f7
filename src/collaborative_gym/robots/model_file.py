"""From an arm's model file to a model that goes into any world."""

from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from collaborative_gym.errors import naming, told_by_mujoco, unknown
from collaborative_gym.quiet import quiet
from collaborative_gym.robots.data import SLACK, RobotData, compile_error
from collaborative_gym.robots.urdf import read_urdf

_FINGER_INERTIA = 0.002
"""Rotor inertia over force of fingers whose file gives none, in s2/m (s2 where they
turn). It keeps a finger of a few grams stable at the physics time step."""


def load_model(robot: RobotData) -> mujoco.MjSpec:
    """Return the model of an arm's file, fresh, prepared for the arm's servos.

    Raises:
      FileNotFoundError: if the file or one of its meshes is missing.
      ValueError: if MuJoCo cannot read the file, or names do not fit it.
    """
    spec = _read(robot)
    for i, body in enumerate(spec.bodies):
        body.name = body.name or f"unnamed_{i}"
    _take_torque_limits(robot, spec)
    _leave_out(spec)
    _check_names(robot, spec)
    _mirror_fingers(robot, spec)
    # Bodies keep their names; MuJoCo would fuse the fixed ones of a URDF.
    spec.compiler.fusestatic = False
    if not any(site.name == robot.tcp for site in spec.sites):
        _add_tcp(robot, spec)
    _prepare_joints(robot, spec)
    return spec


def follows(equality: mujoco.MjsEquality, joints: Collection[str]) -> bool:
    """Return whether a joint is made to follow one of these, as by URDF's mimic."""
    return equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name2 in joints


def finger_bodies(
    spec: mujoco.MjSpec, arm_joints: Collection[str]
) -> list[mujoco.MjsBody]:
    """Return the bodies that joints other than the arm's move."""
    return [
        body
        for joint in spec.joints
        if joint.name not in arm_joints
        for body in _with_descendants(joint.parent)
    ]


def kinematics(spec: mujoco.MjSpec, positions: Mapping[str, float]) -> mujoco.MjData:
    """Return where an arm's bodies are while joints are at positions (m or rad).

    Shapes are left out, as meshes take seconds to compile.
    """
    bare = spec.copy()
    for element in [*bare.geoms, *bare.meshes]:
        bare.delete(element)
    bare.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    bare.compiler.boundmass = bare.compiler.boundinertia = 1.0
    model = bare.compile()
    data = mujoco.MjData(model)
    for name, position in positions.items():
        data.joint(name).qpos = position
    mujoco.mj_kinematics(model, data)
    return data


def relative_pose(
    data: mujoco.MjData, body: str, other: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the position (3,) and quaternion (4,) of a body in another one's frame."""
    here, there = data.body(other), data.body(body)
    inverse, position, quat = np.zeros(4), np.zeros(3), np.zeros(4)
    mujoco.mju_negQuat(inverse, here.xquat)
    mujoco.mju_rotVecQuat(position, there.xpos - here.xpos, inverse)
    mujoco.mju_mulQuat(quat, inverse, there.xquat)
    return position, quat


def _read(robot: RobotData) -> mujoco.MjSpec:
    path = robot.model_file
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no model file {path}; model_file is the path of an MJCF (.xml)"
            " or URDF (.urdf) file"
        )
    with naming(f"{path.name} cannot be loaded"), quiet():
        if path.suffix.lower() == ".urdf":
            return read_urdf(path)
        if path.suffix.lower() != ".xml":
            raise ValueError("its name must end in .xml (MJCF) or .urdf (URDF)")
        try:
            return mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise ValueError(told_by_mujoco(error)) from error


def _take_torque_limits(robot: RobotData, spec: mujoco.MjSpec) -> None:
    """Give arm joints that have no torque limits those of the file's actuators."""
    joints = [joint for joint in spec.joints if joint.name in robot.joints]
    free = {joint.name: joint for joint in joints if not np.ptp(joint.actfrcrange)}
    for actuator in spec.actuators:
        joint = free.get(actuator.target)
        if joint is None or actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        force = np.array(actuator.forcerange)
        is_motor = actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        if not np.ptp(force) and is_motor:
            force = actuator.gainprm[0] * np.array(actuator.ctrlrange)
        joint.actfrcrange = np.sort(actuator.gear[0] * force)


def _mirror_fingers(robot: RobotData, spec: mujoco.MjSpec) -> None:
    """Reverse the axes of fingers whose positions have the other sign.

    So all fingers have the same joint position, whichever way their file counts it.
    """
    gripper = robot.gripper
    for joint in map(spec.joint, gripper.joints):
        is_hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        unit = np.pi / 180 if is_hinge and spec.compiler.degree else 1.0
        ends = np.array([gripper.open_position, gripper.closed_position]) / unit
        low, high = joint.range + np.array([-SLACK, SLACK]) / unit
        if not low < high or ((low <= ends).all() and (ends <= high).all()):
            continue
        if (low <= -ends).all() and (-ends <= high).all():
            joint.axis, joint.range = -joint.axis, -joint.range[::-1]
            joint.ref, joint.springref = -joint.ref, -joint.springref
            for equality in spec.equalities:
                if follows(equality, (joint.name,)):
                    equality.data[1:5:2] *= -1.0


def _leave_out(spec: mujoco.MjSpec) -> None:
    """Remove what the world decides: settings, lights, and other controllers."""
    for elements in (spec.keys, spec.sensors, spec.actuators, spec.lights):
        for element in list(elements):
            spec.delete(element)
    fresh = mujoco.MjSpec()
    spec.option, spec.visual, spec.memory = fresh.option, fresh.visual, fresh.memory
    for part in dir(fresh.authored):
        if not part.startswith("_"):
            setattr(spec.authored, part, 0)


def _check_names(robot: RobotData, spec: mujoco.MjSpec) -> None:
    """Raise ValueError if the file lacks what the value names, or has more joints."""
    file, fingers = f"its model file {robot.model_file.name}", robot.gripper.joints
    joints = [joint.name for joint in spec.joints]
    frames = {element.name for element in (*spec.sites, *spec.bodies[1:])} - {""}
    for kind, wanted, names in (
        ("joint", (*robot.joints, *fingers), joints),
        ("frame", (robot.tcp,), frames),
    ):
        for name in wanted:
            if name not in names:
                more = "; name a site or body by tcp=" * (kind == "frame")
                raise ValueError(f"{file} has {unknown(kind, name, names)}{more}")
    driven = {*robot.joints, *fingers}
    driven |= {eq.name1 for eq in spec.equalities if follows(eq, fingers)}
    for joint in spec.joints:
        if joint.name not in driven:
            named = repr(joint.name)
            if not joint.name:
                named = f"without a name, of body {joint.parent.name!r},"
            raise ValueError(
                f"{file} has a joint {named} that nothing would drive; name an arm's"
                " in joints and a finger's by gripper=cg.Gripper(joints=...), or fix it"
                ' (type="fixed" in URDF, no <joint> in MJCF)'
            )
    if spec.worldbody.geoms:
        raise ValueError(
            f"{file} has a geom {spec.worldbody.geoms[0].name!r} outside of all bodies;"
            " leave floors out, and give the base a body for its geoms"
        )


def _add_tcp(robot: RobotData, spec: mujoco.MjSpec) -> None:
    """Add the tcp's site where the body of its name is.

    If this body is only a frame, as a URDF's links without shape are, the site goes on
    the body that carries it, because tasks look at what else that body has.
    """
    try:
        data = kinematics(spec, {})
    except ValueError as error:
        raise compile_error(robot, error) from error
    body = spec.body(robot.tcp)
    while body.parent.name != "world" and not (
        body.joints or body.geoms or body.explicitinertial
    ):
        body = body.parent
    position, quat = relative_pose(data, robot.tcp, body.name)
    body.add_site(name=robot.tcp, pos=position, quat=quat)


def _prepare_joints(robot: RobotData, spec: mujoco.MjSpec) -> None:
    """Let the arm's links float, and its servos alone set torques."""
    fingers = {body.name for body in finger_bodies(spec, robot.joints)}
    for body in _with_descendants(spec.joint(robot.joints[0]).parent):
        if body.name not in fingers:
            body.gravcomp = 1.0
    for name in robot.joints:
        joint = spec.joint(name)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actgravcomp = False
    for name in robot.gripper.joints:
        joint = spec.joint(name)
        if not joint.armature:
            joint.armature = _FINGER_INERTIA * robot.gripper.force
    for equality in list(spec.equalities):
        # Fingers that have servos of their own need no constraint besides.
        joints = robot.gripper.joints
        if follows(equality, joints) and equality.name1 in joints:
            spec.delete(equality)


def _with_descendants(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    return [body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)]


def fix_joints(spec: mujoco.MjSpec, positions: dict[str, float]) -> None:
    """Put joints at positions (m or rad) and remove them, fixing their bodies there.

    Joints that follow one of them are fixed where it puts them.
    """
    positions = dict(positions)
    for equality in list(spec.equalities):
        if follows(equality, positions):
            leader = positions[equality.name2]
            positions[equality.name1] = float(
                np.polynomial.polynomial.polyval(leader, equality.data[:5])
            )
            spec.delete(equality)
    data = kinematics(spec, positions)
    for name in positions:
        joint = spec.joint(name)
        body = joint.parent
        # A frame around the body would turn it once more.
        body.set_frame(body.parent.add_frame())
        body.pos, body.quat = relative_pose(data, body.name, body.parent.name)
        # An orientation in other words, such as Euler angles, would go before quat.
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        spec.delete(joint)
