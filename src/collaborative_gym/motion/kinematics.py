"""Poses of the tcps of all arms of all worlds, and their Jacobians.

Arrays have the worlds on their last axis, the arms on the one before it, and what they
consist of in front. All is spelt out by element: so many worlds cost little more than
one, no world's bits depend on the others, and NumPy and torch run the same code.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from array_api_compat import array_namespace

from collaborative_gym.math import Array
from collaborative_gym.scene import Arm

Pose = tuple[Array, Array]
"""Positions (3, arms, worlds) in m, and rotation matrices (3, 3, arms, worlds)."""


class Kinematics:
    """The kinematics of arms in closed form, each in the frame of its own base.

    Arms with fewer joints get joints that move nothing. The bases' yaws are in rad.

    Attributes:
      moves: which joints move something, (joints, arms, 1) ones and zeros.
    """

    def __init__(
        self, model: mujoco.MjModel, arms: Sequence[Arm], yaws: Sequence[float], xp: Any
    ):
        count = max(arm.num_joints for arm in arms)
        links, first = np.zeros((count, 3, 4, len(arms))), np.zeros((3, 4, len(arms)))
        moves = np.zeros((count, len(arms)))
        for i, (arm, yaw) in enumerate(zip(arms, yaws, strict=True)):
            frames = _frames(model, arm, yaw, count)
            first[..., i] = frames[0]
            for j in range(count):
                turn = frames[j][:, :3].T
                links[j, :, :3, i] = turn @ frames[j + 1][:, :3]
                links[j, :, 3, i] = turn @ (frames[j + 1][:, 3] - frames[j][:, 3])
            moves[: arm.num_joints, i] = 1.0
        self._links = xp.asarray(links[..., None])
        self._first = xp.asarray(first[..., None])
        self.moves = xp.asarray(moves[..., None])

    def __call__(self, angles: Array) -> tuple[Pose, Array]:
        """Return the tcps' poses and Jacobians (6, joints, arms, worlds)."""
        xp = array_namespace(angles)
        cosine, sine = xp.cos(angles), xp.sin(angles)
        axes, anchors = [], []
        frame = self._first[:, :3] + xp.zeros_like(angles[:1, None])
        place = self._first[:, 3] + xp.zeros_like(angles[:1])
        for i in range(angles.shape[0]):
            axes.append(frame[:, 2])
            anchors.append(place)
            x = cosine[i] * frame[:, 0] + sine[i] * frame[:, 1]
            y = cosine[i] * frame[:, 1] - sine[i] * frame[:, 0]
            link = self._links[i]
            next_ = x[:, None] * link[0] + y[:, None] * link[1]
            next_ = next_ + frame[:, 2][:, None] * link[2]
            frame, place = next_[:, :3], place + next_[:, 3]
        axis, lever = xp.stack(axes, axis=1), place[:, None] - xp.stack(anchors, axis=1)
        jacobian = xp.concat([_cross(axis, lever), axis], axis=0)
        return (place, frame), jacobian


def _frames(
    model: mujoco.MjModel, arm: Arm, yaw: float, count: int
) -> list[np.ndarray]:
    """Return frames (3, 4) at joint angles of zero, as seen from the arm's base.

    Joints have their axes as z. The tcp's follows, once more than joints are missing.
    """
    data = mujoco.MjData(model)
    data.qpos[arm.qpos] = 0.0
    mujoco.mj_kinematics(model, data)
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    frames = []
    for joint in model.dof_jntid[arm.dof]:
        z = data.xaxis[joint]
        x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
        x = x / np.linalg.norm(x)
        frames.append(np.stack([x, np.cross(z, x), z, data.xanchor[joint]], axis=1))
    tcp = data.site_xmat[arm.tcp].reshape(3, 3), data.site_xpos[arm.tcp][:, None]
    frames += [np.concatenate(tcp, axis=1)] * (count + 1 - len(frames))
    return [turned @ frame for frame in frames]


def travel(start: Pose, end: Pose) -> Array:
    """Return translations in m and rotation vectors in rad, (6, arms, worlds)."""
    xp = array_namespace(start[0])
    turned = [
        [_total([end[1][i, k] * start[1][j, k] for k in range(3)]) for j in range(3)]
        for i in range(3)
    ]
    pairs = (2, 1), (0, 2), (1, 0)
    axis = xp.stack([turned[i][j] - turned[j][i] for i, j in pairs], axis=0)
    # Twice the sine and the cosine of the angle, the axis being as long as the former.
    sine = _total([axis[i] * axis[i] for i in range(3)]) ** 0.5
    cosine = turned[0][0] + turned[1][1] + turned[2][2] - 1.0
    small = sine < 1e-9
    scale = xp.atan2(sine, cosine) / xp.where(small, 1.0, sine)
    return xp.concat([end[0] - start[0], axis * xp.where(small, 0.5, scale)], axis=0)


def damped_change(
    jacobian: Array, error: Array, *, nullspace: Array, free: Array, damping: float
) -> Array:
    """Return changes as `joint_change` does, of joints where `free` is 1 and not 0."""
    active, nullspace = jacobian * free, nullspace * free
    joints = range(nullspace.shape[0])
    missing = error - _total([active[:, j] * nullspace[j] for j in joints])
    square = _total([active[:, None, j] * active[None, :, j] for j in joints])
    for i in range(6):
        square[i, i] = square[i, i] + damping**2
    solved = _solve(square, missing)
    return nullspace + _total([active[i] * solved[i] for i in range(6)])


def _solve(matrix: Array, right: Array) -> Array:
    """Return the solutions (k, ...) of positive definite systems (k, k, ...)."""
    xp = array_namespace(matrix)
    rows = xp.concat([matrix, right[:, None]], axis=1)
    for i in range(matrix.shape[0]):
        own = rows[i] / rows[i, i]
        rows = rows - rows[:, i : i + 1] * own
        rows[i] = own
    return rows[:, -1]


def _cross(a: Array, b: Array) -> Array:
    xp = array_namespace(a)
    a, b = xp.concat([a, a], axis=0), xp.concat([b, b], axis=0)
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def _total(terms: Sequence[Array]) -> Array:
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
