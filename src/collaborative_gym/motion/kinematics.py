"""Inverse kinematics by damped least squares, for one pose or for many worlds.

Orientation is asked for in one of two ways: a quaternion w x y z, or a direction for
the tcp's z axis (the approach of the gripper) that leaves the turn about it free.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.scene import Arm
from collaborative_gym.sim.sim import Sim

_DAMPING = 0.05
"""Damping of the least squares: bounds joint motion near singular poses."""


def rotation_error(quat: Array, target: Array) -> Array:
    """Return the rotation that is missing, as a world-frame vector in rad.

    Args:
      quat: (..., 4) present orientation.
      target: (..., 4) orientation to reach, or (..., 3) direction that the z axis is
        to take.
    """
    if target.shape[-1] == 4:
        return math.rotation_vector(math.multiply(target, math.conjugate(quat)))
    axis = math.axis_z(quat)
    turn = math.cross(axis, target)
    sine, cosine = math.norm(turn), math.dot(axis, target)
    angle = np.arctan2(sine, cosine)
    # Opposite directions leave the way round open; turn about the x axis then.
    opposite = (sine < 1e-6) & (cosine < 0)
    unit = np.where(
        opposite[..., None], math.axis_x(quat), turn / np.maximum(sine, 1e-9)[..., None]
    )
    return unit * angle[..., None]


def joint_change(
    jacobian: Array, error: Array, posture: Array, room: tuple[Array, Array]
) -> Array:
    """Return the joint changes that reduce an error, and lean to a posture besides.

    Joints that would run into their limits are left out and the rest solve again.

    Args:
      jacobian: (n, m, joints) of the error's coordinates.
      error: (n, m) what is missing, in m and rad.
      posture: (n, joints) change that the free motion of the arm should make.
      room: (n, joints) lowest and highest change that the joints' ranges leave.

    Returns:
      (n, joints) in rad.
    """
    low, high = room
    free = np.ones_like(posture)
    change = np.zeros_like(posture)
    for _ in range(3):
        active = jacobian * free[:, None, :]
        square = active @ active.transpose(0, 2, 1)
        square = square + _DAMPING**2 * np.eye(square.shape[1])
        fixed = (jacobian @ (change * (1 - free))[..., None])[..., 0]
        lean = posture * free
        needed = error - fixed - (active @ lean[..., None])[..., 0]
        solved = np.linalg.solve(square, needed[..., None])
        step = lean + (active.transpose(0, 2, 1) @ solved)[..., 0]
        change = np.where(free > 0, step, change)
        limited = np.clip(change, low, high)
        free = free * (change == limited)
        change = limited
    return change


def aim(rotation: Array, quat: Array, direction: Array) -> tuple[Array, Array]:
    """Return rows and error that aim a tcp's z axis, its spin about it left free.

    Args:
      rotation: (n, 3, joints) Jacobian of the tcp's orientation.
      quat: (n, 4) its orientation.
      direction: (n, 3) unit vectors for its z axis.

    Returns:
      (n, 3, joints) and (n, 3), in rad, for `joint_change`.
    """
    axis, zero = math.axis_z(quat), np.zeros_like(direction)
    turn = rotation_error(quat, direction)
    rows = np.concatenate([np.zeros_like(rotation), rotation], axis=1)
    rows, turn = _without_spin(rows, np.concatenate([zero, turn], axis=1), axis)
    return rows[:, 3:], turn[:, 3:]


def shortened(vector: Array, longest: float) -> Array:
    """Return vectors no longer than `longest`, their directions kept."""
    length = math.norm(vector)[..., None]
    return vector * np.minimum(1.0, longest / np.maximum(length, 1e-9))


def reach(
    sim: Sim,
    arm: Arm,
    tcp: tuple[Array, Array],
    position: Array,
    orientation: Array,
    posture: Array,
    speed: float = 0.1,
) -> Array:
    """Return joint changes that bring a tcp towards a pose, by resolved-rate control.

    Args:
      sim: the worlds.
      arm: whose tcp.
      tcp: its position (num_envs, 3) and quaternion (num_envs, 4).
      position: (num_envs, 3) where it should go.
      orientation: (num_envs, 4) quaternion or (num_envs, 3) approach direction.
      posture: joint angles to prefer, (joints,), in rad.
      speed: greatest motion of the tcp in this step, in m (and thrice that in rad).

    Returns:
      (num_envs, joints) in rad, not limited to what the joints can do in a step.
    """
    missing = shortened(position - tcp[0], speed)
    turn = shortened(rotation_error(tcp[1], orientation), 3 * speed)
    translation, rotation = sim.jacobian(arm.hand, tcp[0])
    jacobian = np.concatenate([translation, rotation], axis=1)[:, :, arm.dof]
    error = np.concatenate([missing, turn], axis=1)
    if orientation.shape[-1] == 3:
        jacobian, error = _without_spin(jacobian, error, math.axis_z(tcp[1]))
    angle = np.asarray(sim.qpos[:, arm.qpos])
    low, high = arm.joint_range
    most = 0.5 * arm.max_change
    lean = np.clip(0.1 * (posture - angle), -most, most)
    return joint_change(jacobian, error, lean, (low - angle, high - angle))


def standoff(
    offset: Array, approach: Array, slack: float, least: float, most: float
) -> Array:
    """Return how far before its goal a hand is to stay until it is straight before it.

    Args:
      offset: (num_envs, 3) from the goal to the hand, in m.
      approach: (3,) direction in which the hand goes to its goal.
      slack: distance from the line of approach that does not matter, in m.
      least: bound of the result, in m.
      most: bound of the result, in m.

    Returns:
      (num_envs, 1) in m: twice the distance from the line beyond the slack.
    """
    along = math.dot(offset, approach)[:, None]
    aside = math.norm(offset - along * approach)
    return np.clip(2.0 * (aside - slack), least, most)[:, None]


def solve_pose(
    model: mujoco.MjModel,
    arm: Arm,
    position: ArrayLike,
    orientation: ArrayLike,
    start: ArrayLike,
    tries: int = 20,
) -> np.ndarray:
    """Return joint angles that put an arm's tcp at a pose.

    Args:
      model: the compiled world.
      arm: whose tcp.
      position: (3,) in the world frame, in m.
      orientation: (4,) quaternion or (3,) approach direction.
      start: joint angles to begin with; the solution stays near them if it can.
      tries: how many starts to try; those after the first are drawn around `start`.

    Raises:
      ValueError: if no try comes within 1 mm and 0.01 rad.
    """
    data = mujoco.MjData(model)
    low, high = arm.joint_range
    rng = np.random.default_rng(0)
    target = np.asarray(position, float), np.asarray(orientation, float)
    best = np.inf
    for i in range(tries):
        spread = 0.0 if i == 0 else 0.2 + i / tries
        noise = rng.uniform(-spread, spread, len(low))
        angle, miss = _descend(model, data, arm, target, np.asarray(start) + noise)
        if miss < 1.0:
            return np.clip(angle, low, high)
        best = min(best, miss)
    raise ValueError(
        f"{arm.robot.name} cannot bring its tcp to {np.round(target[0], 3).tolist()}"
        f" with orientation {np.round(target[1], 3).tolist()}"
        f" (best try missed by {best:.0f} times the tolerance of 1 mm and 0.01 rad);"
        " mount it nearer or choose an arm with a longer reach"
    )


def refine_pose(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    arm: Arm,
    pose: tuple[np.ndarray, np.ndarray],
    start: np.ndarray,
    steps: int = 20,
) -> tuple[np.ndarray, float]:
    """Return joint angles near `start` that put a tcp exactly at a pose.

    Newton's method with the smallest joint changes, so that the free motion of the arm
    stays as it is in `start`: quick where `start` is less than about a radian off.

    Args:
      model: the compiled world.
      data: to compute with; its joint angles of this arm are overwritten.
      arm: whose tcp.
      pose: position (3,) in m and quaternion (4,) in the world frame.
      start: (joints,) angles to begin with, in rad.
      steps: greatest number of iterations.

    Returns:
      The angles, and by how much they miss in the worst coordinate, in m or rad.
    """
    low, high = arm.joint_range
    jacobian = np.zeros((6, model.nv))
    error = np.zeros(6)
    present, inverse, turn = np.zeros((3, 4))
    angle = np.clip(start, low, high)
    miss = np.inf
    for step in range(steps + 1):
        data.qpos[arm.qpos] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mju_mat2Quat(present, data.site_xmat[arm.tcp])
        mujoco.mju_negQuat(inverse, present)
        mujoco.mju_mulQuat(turn, pose[1], inverse)
        mujoco.mju_quat2Vel(error[3:], turn, 1.0)
        error[:3] = pose[0] - data.site_xpos[arm.tcp]
        miss = float(np.abs(error).max())
        if miss < 1e-6 or step == steps:
            break
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], arm.tcp)
        columns = jacobian[:, arm.dof]
        square = columns @ columns.T + 1e-4 * np.eye(6)
        change = columns.T @ np.linalg.solve(square, error)
        longest = max(1.0, float(np.abs(change).max()) / 0.5)
        angle = np.clip(angle + change / longest, low, high)
    return angle, miss


def central_pose(
    model: mujoco.MjModel,
    arm: Arm,
    poses: list[tuple[np.ndarray, np.ndarray]],
    tries: int = 24,
) -> np.ndarray:
    """Return joint angles for the first pose from which the others are soonest reached.

    Of many postures drawn around the arm's home that touch nothing, the one from which
    the slowest joint needs the least time for the farthest of the other poses; a second
    more for each that is out of reach.

    Args:
      model: the compiled world.
      arm: whose tcp.
      poses: positions (3,) in m and quaternions (4,) in the world frame.
      tries: how many postures to draw.

    Raises:
      ValueError: if the first pose is out of reach.
    """
    data = mujoco.MjData(model)
    limits = np.array(arm.robot.velocity_limits)
    home = np.array(arm.robot.home)
    rng = np.random.default_rng(0)
    best, least = None, np.inf
    for i in range(tries):
        spread = 0.3 + 1.5 * i / tries if i else 0.0
        start = home + rng.uniform(-spread, spread, len(home))
        angle, miss = refine_pose(model, data, arm, poses[0], start)
        if miss > 1e-4 or _touches(model, data, arm, angle):
            continue
        time = 0.0
        for pose in poses[1:]:
            other, miss = refine_pose(model, data, arm, pose, angle)
            time = max(time, np.max(np.abs(other - angle) / limits)) + (miss > 1e-4)
        if time < least:
            best, least = angle, time
    if best is None:
        return solve_pose(model, arm, *poses[0], arm.robot.home)
    return best


def quickest_way(
    model: mujoco.MjModel,
    arm: Arm,
    ways: Sequence[Sequence[tuple[ArrayLike, ArrayLike]]],
    tries: int = 10,
) -> tuple[int, np.ndarray]:
    """Return the way that an arm goes quickest from its first pose to its last.

    Ways that lead a joint closer than 0.2 rad to a limit are taken only if there is no
    other.

    Args:
      model: the compiled world.
      arm: whose tcp.
      ways: each a sequence of poses as `solve_pose` takes them.
      tries: how many starts to try for each pose.

    Returns:
      The way's index, and the joint angles at its poses, (poses, joints), in rad.

    Raises:
      ValueError: if the arm can go none of the ways.
    """
    low, high = arm.joint_range
    best, least, failure = None, np.inf, None
    # Ways may begin alike; each beginning is solved once.
    solved: dict[bytes, np.ndarray | ValueError] = {}
    for i, way in enumerate(ways):
        angles, key = [np.array(arm.robot.home)], b""
        for pose in way:
            key += np.concatenate(pose).tobytes()
            if key not in solved:
                try:
                    solved[key] = solve_pose(model, arm, *pose, angles[-1], tries)
                except ValueError as error:
                    solved[key] = error
            found = solved[key]
            if isinstance(found, ValueError):
                failure = found
                break
            angles.append(found)
        else:
            found = np.array(angles[1:])
            room = np.minimum(found - low, high - found).min()
            steps = (np.abs(np.diff(found, axis=0)) / arm.max_change).max(axis=1).sum()
            cost = steps + (1e3 * (0.2 - room) if room < 0.2 else 0.0)
            if cost < least:
                best, least = (i, found), cost
    if best is None:
        raise failure or ValueError("no way was given")
    return best


def _touches(
    model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, angle: np.ndarray
) -> bool:
    """Return whether an arm at these angles touches itself or what is mounted."""
    data.qpos[:] = model.qpos0
    data.qpos[arm.qpos] = angle
    mujoco.mj_forward(model, data)
    bodies = model.geom_bodyid[data.contact.geom]
    is_own = model.body_rootid[bodies] == model.body_rootid[arm.hand]
    is_fixed = model.body_weldid[bodies] == 0
    return bool(np.any(is_own.any(axis=1) & (is_own | is_fixed).all(axis=1)))


def _descend(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    arm: Arm,
    target: tuple[np.ndarray, np.ndarray],
    start: np.ndarray,
) -> tuple[np.ndarray, float]:
    """Return where the descent from `start` ends and its miss in tolerances."""
    low, high = arm.joint_range
    middle = np.clip(start, low, high)
    angle = middle.copy()
    jacobian = np.zeros((6, model.nv))
    quat = np.zeros(4)
    miss = np.inf
    for _ in range(100):
        data.qpos[arm.qpos] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mju_mat2Quat(quat, data.site_xmat[arm.tcp])
        missing = target[0] - data.site_xpos[arm.tcp]
        turn = rotation_error(quat, target[1])
        miss = max(np.linalg.norm(missing) / 1e-3, np.linalg.norm(turn) / 1e-2)
        if miss < 0.1:
            break
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], arm.tcp)
        error = np.concatenate([shortened(missing, 0.2), shortened(turn, 0.6)])[None]
        columns = jacobian[None, :, arm.dof]
        if target[1].shape[-1] == 3:
            columns, error = _without_spin(columns, error, math.axis_z(quat)[None])
        lean = 0.02 * (middle - angle)[None]
        room = (low - angle)[None], (high - angle)[None]
        angle = angle + joint_change(columns, error, lean, room)[0]
    return angle, float(miss)


def _without_spin(jacobian: Array, error: Array, axis: Array) -> tuple[Array, Array]:
    """Return rows and error with the rotation about `axis` (n, 3) taken out."""
    keep = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    rows = np.concatenate([jacobian[:, :3], keep @ jacobian[:, 3:]], axis=1)
    turn = (keep @ error[:, 3:, None])[..., 0]
    return rows, np.concatenate([error[:, :3], turn], axis=1)
