"""Inverse kinematics by damped least squares, for many postures side by side.

Each row of a batch is a posture of one arm, with a goal of its own. The result of a row
is the same to the bit, whatever the other rows are.
"""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.scene import Arm
from collaborative_gym.sim.cpu import CpuSim

DAMPING = 0.05
"""Damping of the least squares: bounds joint motion near singular poses."""

Goal = tuple[Array, Array | None]
"""Where a tcp should be: position, and quaternion w x y z, or direction for its z axis
that leaves the turn about it free, or None."""

_STILL = np.eye(4)

Kinematics = Callable[[Array, Array], tuple[Array, Array, Array]]
"""A function that returns, for angles (n, joints) of rows (n,), the tcps' positions
(n, 3), their rotation matrices (n, 3, 3) and Jacobians (n, 6, joints)."""


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
    jacobian: Array,
    error: Array,
    *,
    lean: Array,
    room: tuple[Array, Array],
    damping: float = DAMPING,
    longest: float = np.inf,
    rounds: int = 3,
) -> Array:
    """Return the joint changes that reduce an error, and also lean to a posture.

    Joints that would run into their limits are left out, and the others solve it again.

    Args:
      jacobian: (n, m, joints) of the error's coordinates.
      error: (n, m) what is missing, in m and rad.
      lean: (n, joints) change that the free motion of the arm should make.
      room: (n, joints) lowest and highest change that the joints' ranges leave.
      damping: bounds the changes where the arm hardly moves the tcp.
      longest: change of a joint, in rad, beyond which all are scaled down.
      rounds: how often to solve at most; after the last, joints stop at their limits.

    Returns:
      (n, joints) in rad.
    """
    free, change = np.ones(lean.shape), np.zeros(lean.shape)
    damped, (lowest, highest) = damping**2 * np.eye(jacobian.shape[1]), room
    for _ in range(rounds):
        active = jacobian * free[:, None, :]
        square = active @ active.transpose(0, 2, 1) + damped
        fixed = (jacobian @ (change * (1 - free))[..., None])[..., 0]
        leaning = lean * free
        needed = error - fixed - (active @ leaning[..., None])[..., 0]
        solved = np.linalg.solve(square, needed[..., None])
        step = leaning + (active.transpose(0, 2, 1) @ solved)[..., 0]
        step = step / np.maximum(1.0, _greatest(step)[:, None] / longest)
        change = np.where(free > 0, step, change)
        limited = np.minimum(np.maximum(change, lowest), highest)
        stays = change == limited
        if stays.all():
            break
        free, change = free * stays, limited
    return change


def without_spin(jacobian: Array, error: Array, axis: Array) -> tuple[Array, Array]:
    """Return rows and error with the rotation about `axis` (n, 3) taken out."""
    keep = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    rows = np.concatenate([jacobian[:, :3], keep @ jacobian[:, 3:]], axis=1)
    turn = (keep @ error[:, 3:, None])[..., 0]
    return rows, np.concatenate([error[:, :3], turn], axis=1)


def _quats(rotation: Array) -> np.ndarray:
    """Return quaternions of rotation matrices (n, 3, 3)."""
    quats = np.empty((len(rotation), 4))
    # One by one is quickest for the few worlds that start together.
    for quat, entries in zip(quats, rotation.reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quat, entries)
    return quats


def _greatest(error: Array) -> np.ndarray:
    """Return the worst coordinate of each error."""
    return np.abs(error).max(axis=1)


def _all(error: Array) -> Array:
    return error


def _nothing(step: int, angle: Array, rows: Array, jacobian: Array) -> Array:
    return np.zeros(angle.shape)


def descend(
    kinematics: Kinematics,
    start: Array,
    *,
    goal: Goal,
    limits: tuple[Array, Array],
    steps: int,
    enough: float = 0.0,
    miss: Callable[[Array], Array] = _greatest,
    bound: Callable[[Array], Array] = _all,
    lean: Callable[[int, Array, Array, Array], Array] = _nothing,
    change: Callable[..., Array] = joint_change,
) -> tuple[Array, Array]:
    """Return joint angles that bring tcps to their goals, and by how much they miss.

    Args:
      kinematics: of the rows' arms.
      start: (n, joints) angles to begin with, within the limits, in rad.
      goal: of each row, (n, ...), or of all.
      limits: lowest and highest angles, (n, joints) or (joints,) each.
      steps: greatest number of steps.
      enough: a row stops once it misses by less.
      miss: returns one number for each of the errors (n, 3 or 6) in m and rad; unless
        given, the worst coordinate.
      bound: returns the part of an error (n, 3 or 6) that one step works on.
      lean: takes a step's number, and the angles (n, joints), indices and Jacobians of
        the rows that go on; returns changes that the arms should make as well.
      change: `joint_change`, or a partial of it with other options.
    """
    angles = np.array(start)
    low, high = (np.full(angles.shape, limit) for limit in limits)
    position, orientation = goal
    position = np.full((len(angles), 3), position)
    aims = orientation is not None and orientation.shape[-1] == 3
    if orientation is not None:
        orientation = np.full((len(angles), orientation.shape[-1]), orientation)
    misses, rows = np.full(len(angles), np.inf), np.arange(len(angles))
    for step in range(steps + 1):
        here, rotation, jacobian = kinematics(angles[rows], rows)
        error, quat = position[rows] - here, _quats(rotation)
        if orientation is not None:
            turn = rotation_error(quat, orientation[rows])
            error = np.concatenate([error, turn], axis=1)
        misses[rows] = miss(error)
        goes_on = misses[rows] >= enough
        if step == steps or not goes_on.any():
            break
        rows, error, jacobian = rows[goes_on], bound(error[goes_on]), jacobian[goes_on]
        angle, reduced = angles[rows], jacobian[:, : error.shape[1]]
        if aims:
            axis = math.axis_z(quat[goes_on])
            reduced, error = without_spin(reduced, error, axis)
        posture = lean(step, angle, rows, jacobian)
        room = low[rows] - angle, high[rows] - angle
        angles[rows] = angle + change(reduced, error, lean=posture, room=room)
    return angles, misses


def simulated(sim: CpuSim, arm: Arm) -> Kinematics:
    """Return the kinematics of an arm, each row of which is a world of its own."""
    positions, rotations = sim.site_xpos, sim.site_xmat

    def kinematics(angle: Array, rows: Array) -> tuple[Array, Array, Array]:
        sim.qpos[rows, arm.qpos] = angle
        sim.forward(rows)
        position = positions[rows, arm.tcp]
        rotation = rotations[rows, arm.tcp].reshape(-1, 3, 3)
        jacobian = np.concatenate(sim.jacobian(arm.hand, position, rows), axis=1)
        return position, rotation, jacobian[:, :, arm.dof]

    return kinematics


class Chains:
    """The kinematics of several arms of a world, in closed form.

    They are many times as fast as `simulated`, and the same but for rounding. Arms with
    fewer joints than others get joints that move nothing.

    Attributes:
      low: lowest joint angles, (arms, joints), in rad.
      high: highest joint angles.
    """

    def __init__(self, model: mujoco.MjModel, arms: Sequence[Arm]):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        shape = len(arms), max(arm.num_joints for arm in arms)
        self.low, self.high, self._zero = np.zeros((3, *shape))
        axes, anchors = np.zeros((2, *shape, 3))
        self._tcp = np.tile(np.eye(4), (len(arms), 1, 1))
        for i, arm in enumerate(arms):
            own, joints = slice(arm.num_joints), model.dof_jntid[arm.dof]
            self.low[i, own], self.high[i, own] = arm.joint_range
            self._zero[i, own] = model.qpos0[arm.qpos]
            axes[i, own], anchors[i, own] = data.xaxis[joints], data.xanchor[joints]
            self._tcp[i, :3, :3] = data.site_xmat[arm.tcp].reshape(3, 3)
            self._tcp[i, :3, 3] = data.site_xpos[arm.tcp]
        # A joint's turn is exp(S q) = 1 + sin(q) S + (1 - cos(q)) S S, S its screw.
        self._lines = np.stack([axes, anchors], axis=-1)
        self._screws = np.zeros((*shape, 4, 4))
        turned = np.cross(axes[..., None, :], np.eye(3))
        self._screws[..., :3, :3] = turned.swapaxes(-1, -2)
        self._screws[..., :3, 3] = np.cross(anchors, axes)
        self._squares = self._screws @ self._screws

    def of(self, arm: Array) -> Kinematics:
        """Return the kinematics of rows (n,) that are postures of these arms."""
        zero, tcp, lines = self._zero[arm], self._tcp[arm], self._lines[arm]
        screws, squares = self._screws[arm], self._squares[arm]

        def kinematics(angle: Array, rows: Array) -> tuple[Array, Array, Array]:
            turned = (angle - zero[rows])[..., None, None]
            turns = _STILL + np.sin(turned) * screws[rows]
            turns += (1.0 - np.cos(turned)) * squares[rows]
            # Where each joint has been brought by those before it, and the tcp by all.
            before = np.empty(turns.shape)
            before[:, 0] = place = _STILL
            for i in range(1, turns.shape[1]):
                before[:, i] = place = place @ turns[:, i - 1]
            place = place @ turns[:, -1] @ tcp[rows]
            moved = before[..., :3, :3] @ lines[rows]
            axis, anchor = moved[..., 0], moved[..., 1] + before[..., :3, 3]
            lever = math.cross(axis, place[:, None, :3, 3] - anchor)
            jacobian = np.concatenate([lever, axis], axis=2).transpose(0, 2, 1)
            return place[:, :3, 3], place[:, :3, :3], jacobian

        return kinematics
