"""Inverse kinematics by damped least squares, for many postures side by side.

Each row of a batch is a posture of one arm, with a goal of its own. The result of a row
is the same to the bit, whatever the other rows are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.scene import Arm
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.sim.sim import EnvIds, Sim

DAMPING = 0.05
"""Damping of the least squares: bounds joint motion near singular poses."""

Goal = tuple[Array, Array | None]
"""Where a tcp should be: position, and quaternion w x y z, or direction for its z axis
that leaves the turn about it free, or None."""

_STILL = np.eye(4)


@dataclass(frozen=True)
class Postures:
    """Rows of a batch, each a posture of one arm.

    Attributes:
      at: returns the tcps' positions (n, 3), rotation matrices (n, 3, 3) and Jacobians
        (n, 6, joints) for angles (n, joints) of rows (n,).
      low: lowest angles, (joints,) or a row for each posture, in rad.
      high: highest angles, likewise.
    """

    at: Callable[[Array, Array], tuple[Array, Array, Array]]
    low: Array
    high: Array


def rotation_error(quat: Array, target: Array) -> Array:
    """Return the rotation from a quaternion to another, or to a direction of z.

    It is a vector in the world frame, (..., 3), in rad.
    """
    if target.shape[-1] == 4:
        return math.rotation_vector(math.multiply(target, math.conjugate(quat)))
    axis = math.axis_z(quat)
    turn = math.cross(axis, target)
    sine, cosine = math.norm(turn), math.dot(axis, target)
    angle = np.arctan2(sine, cosine)
    # Opposite directions leave the way round open; turn about the x axis then.
    opposite = (sine < 1e-6) & (cosine < 0)
    unit = turn / np.maximum(sine, 1e-9)[..., None]
    if opposite.any():
        unit = np.where(opposite[..., None], math.axis_x(quat), unit)
    return unit * angle[..., None]


def joint_change(
    jacobian: Array,
    error: Array,
    *,
    nullspace: Array,
    room: tuple[Array, Array],
    damping: float = DAMPING,
    longest: float = np.inf,
    rounds: int = 3,
) -> Array:
    """Return the joint changes that reduce an error, and make another change beside.

    Joints that would run into their limits are left out, and the others solve it again.

    Args:
      jacobian: (n, m, joints) of the error's coordinates.
      error: (n, m) what is missing, in m and rad.
      nullspace: (n, joints) change of the arm's null-space motion, in rad.
      room: (n, joints) lowest and highest change that the joints' ranges leave.
      damping: bounds the changes where the arm hardly moves the tcp.
      longest: change of a joint, in rad, beyond which all are scaled down.
      rounds: how often to solve at most; after the last, joints stop at their limits.
    """
    free, change = np.ones(nullspace.shape), np.zeros(nullspace.shape)
    damped, (lowest, highest) = damping**2 * np.eye(jacobian.shape[1]), room
    for _ in range(rounds):
        active = jacobian * free[:, None, :]
        square = active @ active.transpose(0, 2, 1) + damped
        fixed = (jacobian @ (change * (1 - free))[..., None])[..., 0]
        wanted = nullspace * free
        needed = error - fixed - (active @ wanted[..., None])[..., 0]
        solved = np.linalg.solve(square, needed[..., None])
        step = wanted + (active.transpose(0, 2, 1) @ solved)[..., 0]
        step = step / np.maximum(1.0, greatest(step)[:, None] / longest)
        change = np.where(free > 0, step, change)
        limited = np.minimum(np.maximum(change, lowest), highest)
        stays = change == limited
        if stays.all():
            break
        free, change = free * stays, limited
    return change


def tcp_jacobian(sim: Sim, arm: Arm, tcp: Array, env_ids: EnvIds = None) -> np.ndarray:
    """Return the Jacobian of an arm's tcp, which is there, (worlds, 6, joints)."""
    both = sim.jacobian(arm.hand, tcp, env_ids)
    return np.concatenate(both, axis=1)[:, :, arm.dof]


def without_spin(jacobian: Array, error: Array, axis: Array) -> tuple[Array, Array]:
    """Return rows and error with the rotation about `axis` (n, 3) taken out."""
    keep = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    rows = np.concatenate([jacobian[:, :3], keep @ jacobian[:, 3:]], axis=1)
    turn = (keep @ error[:, 3:, None])[..., 0]
    return rows, np.concatenate([error[:, :3], turn], axis=1)


def _quats(rotation: Array) -> np.ndarray:
    quats = np.empty((len(rotation), 4))
    # One by one is quickest for the few worlds that start together.
    for quat, entries in zip(quats, rotation.reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quat, entries)
    return quats


def greatest(error: Array) -> np.ndarray:
    """Return the worst coordinate of each error."""
    return np.abs(error).max(axis=1)


def descend(
    postures: Postures,
    start: Array,
    *,
    goal: Goal,
    steps: int,
    is_there: Callable[[Array], Array] = lambda error: np.zeros(len(error), bool),
    bound: Callable[[Array], Array] = lambda error: error,
    nullspace: Callable[[int, Array, Array, Array], Array] | None = None,
    change: Callable[..., Array] = joint_change,
    patience: int | None = None,
) -> tuple[Array, Array]:
    """Return joint angles that bring tcps to their goals, and what they still miss.

    Errors are (n, 3 or 6), in m and rad.

    Args:
      postures: the rows' kinematics.
      start: (n, joints) angles to begin with, within the limits, in rad.
      goal: of each row, (n, ...), or of all.
      steps: greatest number of steps.
      is_there: returns for which errors a row stops.
      bound: returns the part of an error that one step works on.
      nullspace: takes a step's number, and the angles (n, joints), indices and
        Jacobians of the rows that go on; returns changes beside.
      change: `joint_change`, or a partial of it with other options.
      patience: steps in which a row's worst coordinate must fall by a tenth, or the row
        stops, because it makes no way; None for no such rule.
    """
    angles = np.array(start)
    low, high = (np.full(angles.shape, x) for x in (postures.low, postures.high))
    position, orientation = goal
    position = np.full((len(angles), 3), position)
    aims = orientation is not None and orientation.shape[-1] == 3
    if orientation is not None:
        orientation = np.full((len(angles), orientation.shape[-1]), orientation)
    missed = np.zeros((len(angles), 3 if orientation is None else 6))
    patience = patience or steps + 1  # Without one, all are compared with infinity.
    worst = np.full((patience + steps + 1, len(angles)), np.inf)
    rows = np.arange(len(missed))
    for step in range(steps + 1):
        here, rotation, jacobian = postures.at(angles[rows], rows)
        error, quat = position[rows] - here, _quats(rotation)
        if orientation is not None:
            turn = rotation_error(quat, orientation[rows])
            error = np.concatenate([error, turn], axis=1)
        missed[rows] = error
        worst[patience + step, rows] = now = greatest(error)
        goes_on = ~is_there(error) & (now < 0.9 * worst[step, rows])
        if step == steps or not goes_on.any():
            break
        rows, error, jacobian = rows[goes_on], bound(error[goes_on]), jacobian[goes_on]
        angle, reduced = angles[rows], jacobian[:, : error.shape[1]]
        if aims:
            axis = math.axis_z(quat[goes_on])
            reduced, error = without_spin(reduced, error, axis)
        free = np.zeros(angle.shape)
        if nullspace:
            free = nullspace(step, angle, rows, jacobian)
        room = low[rows] - angle, high[rows] - angle
        angles[rows] = angle + change(reduced, error, nullspace=free, room=room)
    return angles, missed


def simulated(
    sim: CpuSim, arm: Arm, limits: tuple[Array, Array] | None = None
) -> Postures:
    """Return postures of an arm, each of a world of its own, within its range."""
    positions, rotations = sim.site_xpos, sim.site_xmat

    def at(angle: Array, rows: Array) -> tuple[Array, Array, Array]:
        sim.qpos[rows, arm.qpos] = angle
        sim.forward(rows)
        position = positions[rows, arm.tcp]
        rotation = rotations[rows, arm.tcp].reshape(-1, 3, 3)
        return position, rotation, tcp_jacobian(sim, arm, position, rows)

    return Postures(at, *(limits or arm.joint_range))


class Chains:
    """The kinematics of several arms of a world, in closed form.

    They are many times as fast as MuJoCo's, and differ only by rounding. Arms with
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

    def of(self, arm: Array) -> Postures:
        """Return rows that are postures of these arms, (n,) indices."""
        zero, tcp, lines = self._zero[arm], self._tcp[arm], self._lines[arm]
        screws, squares = self._screws[arm], self._squares[arm]

        def at(angle: Array, rows: Array) -> tuple[Array, Array, Array]:
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

        return Postures(at, self.low[arm], self.high[arm])
