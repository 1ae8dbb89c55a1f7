"""What a robot of a team of any size sees: its own frame, and its team as a set."""

from collections.abc import Mapping, Sequence

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.scene import Placement

MOST_MATES = 7
"""Elements of a block of mates, so that robots of teams of two to eight see alike."""


def mates_of(agents: Sequence[str], agent: str) -> tuple[str, ...]:
    """Return the other agents in their order, beginning after this one."""
    i = list(agents).index(agent)
    return (*agents[i + 1 :], *agents[:i])


def mates_block(rows: Sequence[Array]) -> Array:
    """Return what a robot sees of its mates, as a block that is a set.

    A block of two axes is a set: its rows are elements, whose first number is 1, and
    rows of zeros, which stand for nobody.

    Args:
      rows: what it sees of each mate, (num_envs, k) each, at most `MOST_MATES`.

    Returns:
      (num_envs, MOST_MATES, 1 + k).
    """
    xp = array_namespace(rows[0])
    num_envs, width = rows[0].shape
    seen = xp.zeros((num_envs, MOST_MATES, 1 + width), dtype=rows[0].dtype)
    seen[:, : len(rows), 0] = 1.0
    seen[:, : len(rows), 1:] = xp.stack(list(rows), axis=1)
    return seen


class Frames:
    """Turns world frames into those of the robots' bases.

    Args:
      placements: of the bases, by agent. A base's frame has its origin and its yaw.
    """

    def __init__(self, placements: Mapping[str, Placement]):
        self._origins = {a: np.array(each.position) for a, each in placements.items()}
        self._turns = {
            a: math.from_yaw(np.array(-p.yaw)) for a, p in placements.items()
        }

    def direction(self, agent: str, vector: Array) -> Array:
        """Return directions (num_envs, 3) in the frame of the agent's base."""
        xp = array_namespace(vector)
        turn = xp.asarray(self._turns[agent], dtype=vector.dtype)
        return math.rotate(xp.broadcast_to(turn, (len(vector), 4)), vector)

    def place(self, agent: str, position: Array) -> Array:
        """Return places (num_envs, 3), in m, in the frame of the agent's base."""
        xp = array_namespace(position)
        origin = xp.asarray(self._origins[agent], dtype=position.dtype)
        return self.direction(agent, position - origin)

    def pose(self, agent: str, pose: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return places and quaternions (num_envs, 4) in the frame of its base."""
        position, quat = pose
        xp = array_namespace(quat)
        turn = xp.asarray(self._turns[agent], dtype=quat.dtype)
        turn = xp.broadcast_to(turn, quat.shape)
        return self.place(agent, position), math.multiply(turn, quat)
