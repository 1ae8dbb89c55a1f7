"""Modes whose actions move the tool, so that all arms have one action space."""

from collections.abc import Mapping

import numpy as np

from collaborative_gym.control.joints import ServoMode
from collaborative_gym.control.modes import Encoded, Motion, register_mode
from collaborative_gym.math import Array
from collaborative_gym.motion.kinematics import Kinematics, damped_change, travel
from collaborative_gym.motion.solver import DAMPING
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim

_FARTHEST = np.array([0.05] * 3 + [0.15] * 3)
"""Greatest translation in m, and greatest turn in rad, of a control step."""

_ROUNDS = 2  # Newton steps in a control step; one alone misses a tenth of the way
_TO_POSTURE, _FULLY = 0.2, 0.2
"""Gain towards the posture, and the size of an action from which on it is full."""


class TcpChanges(ServoMode):
    """A change of the pose of the tool centre point, in the frame of the arm's base.

    Three numbers give the translation, three the rotation vector, as shares of 0.05 m
    and 0.15 rad; longer vectors are shortened to that. They become joint changes within
    the limits of joints, speeds and torques. Where one joint would be too fast, all
    slow down, so the tool slows down near singular poses. A redundant arm also moves
    towards its posture in `Scene.postures`.
    """

    axes = (0, 1, 2, 3, 4, 5)
    """Which components of a pose's change an action has; the others are zero."""

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        super().__init__(scene, sim, gripping)
        xp, arms = sim.xp, list(self.arms.values())
        yaws = [scene.placements[agent].yaw for agent in self.arms]
        self._kinematics = Kinematics(sim.model, arms, yaws, xp)
        servos = self._servos.values()
        self._low = self._columns([servo.low[None] for servo in servos])
        self._high = self._columns([servo.high[None] for servo in servos])
        stride = self._columns([xp.asarray(arm.stride[None]) for arm in arms])
        self._stride = xp.where(self._kinematics.moves > 0.0, stride, 1.0)
        self._farthest = xp.asarray(_FARTHEST[:, None, None])
        postures = [xp.asarray(scene.postures[agent])[None] for agent in self.arms]
        self._postures = self._columns(postures)

    def num_moves(self, agent: str) -> int:
        return len(self.axes)

    def decode(self, moves: Mapping[str, Array]) -> Mapping[str, Array]:
        xp, worlds = self._sim.xp, self._sim.num_envs
        asked = xp.zeros((6, len(self.arms), worlds))
        for i, agent in enumerate(self.arms):
            for k, axis in enumerate(self.axes):
                asked[axis, i] = moves[agent][:, k]
        shares = self._joint_changes(asked) / self._stride
        return {
            agent: xp.permute_dims(shares[: arm.num_joints, i], (1, 0))
            for i, (agent, arm) in enumerate(self.arms.items())
        }

    def moves(self, motions: Mapping[str, Motion]) -> Encoded:
        angles = self._angles(self._sim)
        change = self._columns([self._borne(a, motions[a]) for a in self.arms])
        # The tool goes the way that it goes in as much as joints can do in one step.
        excess = np.maximum(np.abs(change / self._stride).max(axis=0), 1.0)
        way = self._way(angles, change / excess)
        size = np.maximum(self._size(way), 1.0)
        # What the least squares leave out of it is asked for once more.
        done = self._way(angles, self._joint_changes(way / size))
        way = (way + size * (way / size - done))[list(self.axes)]
        size = self._size(way)
        most = excess * np.where(excess > 1.0, np.maximum(size, 1.0), size)
        return (
            {agent: (excess * way)[:, i].T for i, agent in enumerate(self.arms)},
            {agent: most[i] for i, agent in enumerate(self.arms)},
        )

    def _way(self, angles: Array, change: Array) -> Array:
        """Return the tools' motion by joint changes, as an action has it, (6, ...)."""
        start, end = (self._kinematics(each)[0] for each in (angles, angles + change))
        way = travel(start, end) / self._farthest
        for axis in {*range(6)}.difference(self.axes):
            way[axis] = 0.0
        return way

    def _joint_changes(self, asked: Array) -> Array:
        """Return joint changes (joints, arms, worlds) for actions (6, arms, worlds)."""
        xp, angles, size = self._sim.xp, self._angles(self._sim), self._size(asked)
        way = asked * self._farthest / xp.maximum(size, 1.0)
        low, high = self._low - angles, self._high - angles
        # Only an arm that moves goes to its posture; another stays as it is.
        share = _TO_POSTURE / _FULLY * xp.minimum(size, _FULLY)
        nullspace = share * (self._postures - angles)
        nullspace = xp.minimum(xp.maximum(nullspace, -self._stride), self._stride)
        free = self._kinematics.moves + xp.zeros_like(angles)
        change, (start, jacobian) = xp.zeros_like(angles), self._kinematics(angles)
        left = way
        for step in range(_ROUNDS):
            if step > 0:
                here, jacobian = self._kinematics(angles + change)
                left, nullspace = way - travel(start, here), xp.zeros_like(nullspace)
            more = damped_change(
                jacobian, left, nullspace=nullspace, free=free, damping=DAMPING
            )
            tried = change + more
            change = xp.minimum(xp.maximum(tried, low), high)
            # What a joint at the end of its range cannot do, the others do.
            free = xp.where(change == tried, free, 0.0)
        peak = xp.max(xp.abs(change) / self._stride, axis=0)
        return change / xp.maximum(peak, 1.0)

    def _angles(self, sim: Sim) -> Array:
        return self._columns([sim.qpos[:, arm.qpos] for arm in self.arms.values()])

    def _columns(self, rows: list[Array]) -> Array:
        """Return rows (worlds, joints) of all arms as (joints, arms, worlds)."""
        xp, count = self._sim.xp, self._kinematics.moves.shape[0]
        columns = xp.zeros((count, len(rows), rows[0].shape[0]))
        for i, own in enumerate(rows):
            columns[: own.shape[1], i] = xp.permute_dims(own, (1, 0))
        return columns

    def _size(self, moves: Array) -> Array:
        """Return the length of the longer vector of moves, (arms, worlds)."""
        square = moves * moves
        shift = square[0] + square[1] + square[2]
        turn = square[3]
        for each in range(4, square.shape[0]):
            turn = turn + square[each]
        return self._sim.xp.maximum(shift, turn) ** 0.5


class TcpPositionChanges(TcpChanges):
    """A change of the tool's position and yaw, its turn about the vertical.

    The tool keeps its tilt. Three numbers move and one turns it; else it is as `tcp`.
    """

    axes = (0, 1, 2, 5)


register_mode("tcp", TcpChanges)
register_mode("tcp_position", TcpPositionChanges)
