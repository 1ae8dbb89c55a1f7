"""Checks of an arm, when its value is made; their callers add its name to errors."""

from itertools import pairwise

import mujoco
import numpy as np

from collaborative_gym.quiet import quiet
from collaborative_gym.robots.bounds import check_numbers, check_places
from collaborative_gym.robots.data import GRAVITY, SLACK, RobotData, compile_error

_MOUNTING = 0.5  # greatest distance of base and first axis from the origin, over reach
_REACHES = 0.6, 1.25  # least and greatest reach, over how far the tcp comes
_DRAWS = 300  # postures that are tried for it; they find 92 to 100 % of it
_TURNS = 30.0  # rad; ends of a range beyond this are degrees: it is almost five turns
_LONGEST = 10.0  # m; longer arms are given in mm
_BULKIEST = 5.0  # radius over the reach; larger shapes are given in mm
_TOUCHING = 0.0005  # m; shapes nearer than this count as touching at home
_NEIGHBOURS = 2  # joints apart, up to where links may overlap at home, by their shapes


def compile_alone(robot: RobotData, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Return an arm's model for checks.

    What collides in it collides with all, as in worlds, from half a millimetre on.

    Raises:
      FileNotFoundError: if a mesh is missing.
      ValueError: if MuJoCo cannot compile it, or a definition does not fit it.
    """
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype = geom.conaffinity = 1
            geom.margin = max(geom.margin, _TOUCHING)
    try:
        model = spec.compile()
    except ValueError as error:
        raise compile_error(robot, error) from error
    check_numbers(robot, model)
    _check_joints(robot, model)
    _check_ranges(robot, model)
    _check_chain(robot, model)
    data = at_home(robot, model, robot.gripper.open_position)
    _check_size(robot, model, data)
    check_places(robot, model)
    _check_tcp(robot, model, data)
    _check_weight(robot, model, data)
    if len(robot.gripper.joints) > 1:
        _check_fingers(robot, model)
    return model


def at_home(robot: RobotData, model: mujoco.MjModel, fingers: float) -> mujoco.MjData:
    """Return the state of an arm at home, its fingers at a position (m or rad)."""
    data = mujoco.MjData(model)
    for joint, angle in zip(robot.joints, robot.home, strict=True):
        data.joint(joint).qpos = angle
    for joint in robot.gripper.joints:
        data.joint(joint).qpos = fingers
    with quiet():
        mujoco.mj_forward(model, data)
    return data


def overlaps(robot: RobotData, model: mujoco.MjModel) -> tuple[tuple[str, str], ...]:
    """Return the pairs of neighbouring bodies, or of a gripper, that touch at home.

    Raises:
      ValueError: if others touch.
    """
    found, last = set(), model.joint(robot.joints[-1]).bodyid[0]
    for contact in at_home(robot, model, robot.gripper.open_position).contact:
        first, second = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
        names = model.body(first).name, model.body(second).name
        is_gripper = all(_carries(model, last, body) for body in (first, second))
        if not is_gripper and _joints_between(model, first, second) > _NEIGHBOURS:
            remedy = "leave out a <collision> of one of them"
            if robot.model_file.suffix.lower() == ".xml":
                remedy = (
                    "let them pass one another: <contact><exclude"
                    f' body1="{names[0]}" body2="{names[1]}"/></contact>'
                )
            raise ValueError(
                f"its bodies {names[0]!r} and {names[1]!r} touch at home; give a home"
                " where they do not, make their collision shapes smaller, or"
                f" {remedy}"
            )
        found.add(names)
    return tuple(sorted(found))


def _joints_between(model: mujoco.MjModel, first: int, second: int) -> int:
    """Return how many bodies with joints lie on the way from one body to another."""
    ways = []
    for body in (first, second):
        way = [int(model.body_weldid[body])]
        while way[-1]:
            way.append(int(model.body_weldid[model.body_parentid[way[-1]]]))
        ways.append(way)
    shared = next(body for body in ways[0] if body in ways[1])
    return ways[0].index(shared) + ways[1].index(shared)


def _carries(model: mujoco.MjModel, carrier: int, body: int) -> bool:
    while body not in (carrier, 0):
        body = int(model.body_parentid[body])
    return body == carrier


def _check_joints(robot: RobotData, model: mujoco.MjModel) -> None:
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    for name in (*robot.joints, *robot.gripper.joints):
        kind = mujoco.mjtJoint(int(model.joint(name).type[0]))
        if kind != hinge and (kind != slide or name in robot.joints):
            given = kind.name.removeprefix("mjJNT_").lower()
            raise ValueError(
                f"joint {name!r} is a {given}; arm joints must be hinges (revolute),"
                " those of fingers hinges or slides (prismatic)"
            )
    for name in robot.joints:
        low, high = model.joint(name).range
        if low > high:
            raise ValueError(
                f"joint {name!r} has its range the wrong way round, {low:g} to"
                f" {high:g}; give the lower end first"
            )
        if not model.joint(name).limited[0]:
            raise ValueError(
                f"joint {name!r} has no range; give it one in the model file, two turns"
                " (-6.2832 to 6.2832 rad) if it turns freely"
            )
        if max(-low, high) > _TURNS:
            raise ValueError(
                f"joint {name!r} has the range {low:g} to {high:g}; give rad, not"
                " degrees, and two turns (-6.2832 to 6.2832 rad) if it turns freely"
            )


def _check_ranges(robot: RobotData, model: mujoco.MjModel) -> None:
    gripper = robot.gripper
    placed = [("home", *pair) for pair in zip(robot.joints, robot.home, strict=True)]
    for name in gripper.joints:
        placed.append(("gripper.open_position", name, gripper.open_position))
        placed.append(("gripper.closed_position", name, gripper.closed_position))
    for field, name, value in placed:
        low, high = model.joint(name).range
        if model.joint(name).limited[0] and not low - SLACK <= value <= high + SLACK:
            raise ValueError(
                f"{field} puts joint {name!r} at {value:g}, outside of its range"
                f" {low:g} to {high:g} in the model file; give angles in rad, not in"
                " degrees, and lengths in m"
            )


def _check_chain(robot: RobotData, model: mujoco.MjModel) -> None:
    """Raise ValueError unless each joint carries the next, and the last the tool."""
    chain = [int(model.joint(name).bodyid[0]) for name in robot.joints]
    tips = [int(model.joint(name).bodyid[0]) for name in robot.gripper.joints]
    tips.append(int(model.site(robot.tcp).bodyid[0]))
    for carrier, body in (*pairwise(chain), *((chain[-1], tip) for tip in tips)):
        if not _carries(model, carrier, body):
            raise ValueError(
                f"its body {model.body(body).name!r} is not carried by"
                f" {model.body(carrier).name!r}; list joints from the base to the tool,"
                " and choose a tcp and fingers beyond the last"
            )
    places = [int(model.joint(name).qposadr[0]) for name in robot.joints]
    if places != list(range(places[0], places[0] + len(places))):
        raise ValueError(
            "other joints come between those of the arm; in the model file, put"
            " branches of the arm after the link that continues it"
        )


def _check_size(robot: RobotData, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise ValueError if the arm is in mm, or does not fit its reach."""
    points = [data.xanchor[model.joint(name).id] for name in robot.joints]
    points.append(data.site(robot.tcp).xpos)
    length = sum(np.linalg.norm(b - a) for a, b in pairwise(points))
    if length > _LONGEST:
        raise ValueError(
            "in the model file the way along its joints to the tcp is"
            f" {length:.0f} m long; give m, not mm"
        )
    far = _farthest(robot, model)
    if not _REACHES[0] * far <= robot.reach <= _REACHES[1] * far:
        raise ValueError(
            f"its reach is {robot.reach:g} m, but in the model file its tcp comes"
            f" {far:.2f} m away from the axis of its first joint; give the reach in m,"
            " from the shoulder to the flange"
        )
    base = data.xpos[model.body_rootid[model.site_bodyid[model.site(robot.tcp).id]]]
    # Where on its axis a joint has its anchor is the model file's choice.
    aside = _off_axis(data, model.joint(robot.joints[0]).id, np.zeros(3))
    for what, place in ("base", base), ("axis of the first joint", aside):
        if np.linalg.norm(place) > _MOUNTING * robot.reach:
            raise ValueError(
                f"its {what} is {np.linalg.norm(place):.2f} m away from the origin of"
                f" the model file, too far for a reach of {robot.reach:g} m; move the"
                " base to the origin, its mounting plate at z = 0"
            )
    # Meshes of CAD programs often are in mm.
    radius = model.geom_rbound.max(initial=0.0)
    if radius > _BULKIEST * robot.reach:
        body = model.body(int(model.geom_bodyid[model.geom_rbound.argmax()])).name
        raise ValueError(
            f"a shape of its body {body!r} is {2 * radius:.0f} m wide;"
            ' give m, not mm; a mesh in mm takes scale="0.001 0.001 0.001"'
        )


def _farthest(robot: RobotData, model: mujoco.MjModel) -> float:
    data, joints = mujoco.MjData(model), [model.joint(name) for name in robot.joints]
    tcp, angles = data.site(robot.tcp).xpos, data.qpos[joints[0].qposadr[0] :]
    low, high = np.array([joint.range for joint in joints]).T
    far = 0.0
    for draw in np.random.default_rng(0).uniform(low, high, (_DRAWS, len(joints))):
        angles[: len(joints)] = draw
        mujoco.mj_kinematics(model, data)
        far = max(far, float(np.linalg.norm(_off_axis(data, joints[0].id, tcp))))
    return far


def _off_axis(data: mujoco.MjData, joint: int, point: np.ndarray) -> np.ndarray:
    """Return the way of a point from a joint's axis, (3,) in m."""
    axis, way = data.xaxis[joint], point - data.xanchor[joint]
    return way - (way @ axis) * axis


def check_payload(robot: RobotData, pull: float) -> None:
    """Raise ValueError if the payload is heavier than the gripper or the arm can hold.

    Its strongest joint pulls with `pull`, in N, near the base; that is 10 to 28 times
    the weight of the payload of Sawyer, Panda and Jaco.
    """
    weight = GRAVITY * robot.payload
    if min(robot.gripper.holding_force, pull) < weight:
        raise ValueError(
            f"its payload of {robot.payload:g} kg weighs {weight:.1f} N, but its"
            f" gripper's holding_force is {robot.gripper.holding_force:g} N, and its"
            f" greatest torque limit {max(robot.torque_limits):g} N m; correct the"
            " one that is wrong"
        )


def _check_weight(robot: RobotData, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    for name, most in zip(robot.joints, robot.torque_limits, strict=True):
        own = abs(float(data.qfrc_bias[model.joint(name).dofadr[0]]))
        if own > most:
            raise ValueError(
                f"joint {name!r} bears {own:.1f} N m of the arm's own weight at home,"
                f" but has a torque limit of {most:g}; correct torque_limits or masses"
            )


def _check_tcp(robot: RobotData, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise ValueError unless the tcp's z axis points away from the wrist.

    The wrist is where the last axis is next to the one before: anchors of joints may
    lie anywhere on their axes.
    """
    tcp, last = data.site(robot.tcp), model.joint(robot.joints[-1]).id
    offset = tcp.xpos - data.xanchor[last]
    if len(robot.joints) > 1:
        before, axis = model.joint(robot.joints[-2]).id, data.xaxis[last]
        across = _off_axis(data, before, data.xanchor[last] + axis)
        here = _off_axis(data, before, data.xanchor[last])
        step = across - here  # how an axis leaves the other; none if they are parallel
        if step @ step > 1e-3:
            offset += axis * (here @ step) / (step @ step)
    along = offset @ tcp.xmat.reshape(3, 3)
    length = np.linalg.norm(along)
    if length > 0.02 and along[2] < 0.5 * length:
        axis = int(np.abs(along).argmax())
        name = ("-" if along[axis] < 0 else "") + "xyz"[axis]
        raise ValueError(
            f"the z axis of its tcp {robot.tcp!r} must point along the approach, away"
            f" from the wrist, where now its {name} axis points; turn that frame in the"
            " model file, or add one"
        )


def _check_fingers(robot: RobotData, model: mujoco.MjModel) -> None:
    """Raise ValueError unless the fingers close along the tcp's y axis."""
    bodies = [int(model.joint(name).bodyid[0]) for name in robot.gripper.joints]
    places = []
    for position in (robot.gripper.open_position, robot.gripper.closed_position):
        data = at_home(robot, model, position)
        tcp = data.site(robot.tcp)
        places.append((data.xipos[bodies] - tcp.xpos) @ tcp.xmat.reshape(3, 3))
    moved = np.abs(places[1] - places[0]).sum(axis=0)
    if moved[0] > moved[1]:
        raise ValueError(
            f"its fingers close along x of its tcp {robot.tcp!r}, but must close along"
            " y; turn that frame about z by 90 degrees in the model file, or add one"
        )
    spread = [np.ptp(place[:, 1]) for place in places]
    if spread[1] >= spread[0]:
        raise ValueError(
            "its fingers move apart from gripper.open_position to"
            " gripper.closed_position; swap the two"
        )
