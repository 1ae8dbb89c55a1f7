"""What teams of all sizes need: places, blocks, own frames, and a team as a set."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.objects.pot import handle_directions
from collaborative_gym.objects.table import round_table
from collaborative_gym.scene import Placement, Scene

COLOURS = (
    (0.90, 0.45, 0.13, 1.0),
    (0.16, 0.47, 0.82, 1.0),
    (0.24, 0.62, 0.28, 1.0),
    (0.93, 0.76, 0.14, 1.0),
    (0.62, 0.28, 0.68, 1.0),
    (0.85, 0.20, 0.24, 1.0),
    (0.20, 0.70, 0.70, 1.0),
    (0.55, 0.38, 0.25, 1.0),
)
"""A colour for each robot of a team and what is its own, red, green, blue, alpha."""

MOST_MATES = 7
"""Elements of a block of mates, so that robots of teams of two to eight see alike."""

MOST_JOINTS = 7
"""Numbers of a block of joint angles that arms of all kinds share."""

_FINE = 0.01  # m or rad, beside which what is more shows by its logarithm
_STAND = 0.13  # m, radius of what an arm of a team stands on
_TALL = 0.7  # m, of an arm at work in a picture
_SLOPES, _MARGINS = (0.35, 0.9), (0.25, 0.1)  # of a pair, and of a team; m around it
_VIEW = np.array([16 / 9, 1.0]) * np.tan(np.radians(45 / 2))
"""Half a picture's width and height in proportion to the distance."""


def alike(joints: Array) -> Array:
    """Return joint angles (num_envs, k), with zeros after those of a shorter arm."""
    xp = array_namespace(joints)
    missing = max(0, MOST_JOINTS - joints.shape[1])
    zeros = xp.zeros((len(joints), missing), dtype=joints.dtype)
    return xp.concat([joints, zeros], axis=1) if missing else joints


def mates_of(agents: Sequence[str], agent: str) -> tuple[str, ...]:
    """Return the other agents in their order, beginning after this one."""
    i = list(agents).index(agent)
    return (*agents[i + 1 :], *agents[:i])


def away(agents: Iterable[str], agent: str, mate: str) -> float:
    """Return how many seats after an agent a mate is, as a share of `MOST_MATES`."""
    seats = list(agents)
    return (seats.index(mate) - seats.index(agent)) / MOST_MATES


def mates_block(rows: Sequence[Array]) -> Array:
    """Return a robot's observation of its mates, as a block that is a set.

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


def hands_block(
    frames: "Frames",
    agent: str,
    *,
    tcps: Mapping[str, tuple[Array, Array]],
    grips: Mapping[str, Array],
    more: Mapping[str, Array] | None = None,
) -> Array:
    """Return a robot's observation of its mates' hands, as `mates_block` makes it.

    A row has how many seats away a mate is, as a share of `MOST_MATES`; whether it
    grips; and the way from the own tcp to its tcp, in the frame of the own base, in m.

    Args:
      frames: those of the robots.
      agent: who looks.
      tcps: poses of the tcps by agent, in the order of the agents.
      grips: 1 where an agent grips, else 0, (num_envs, 1).
      more: numbers that follow in a mate's row, (num_envs, k).
    """
    here, mates, rows = tcps[agent][0], mates_of([*tcps], agent), []
    xp = array_namespace(here)
    ways = frames.directions(agent, [tcps[mate][0] - here for mate in mates])
    for mate, apart in zip(mates, ways, strict=True):
        seats = 0.0 * grips[mate] + away(tcps, agent, mate)
        row = [seats, grips[mate], apart]
        rows.append(xp.concat([*row, more[mate]] if more else row, axis=1))
    return mates_block(rows)


def fine(way: Array) -> Array:
    """Return displacements in m, or turns in rad, on a signed logarithmic scale.

    It is log(1 + 100 |x|) with the sign of x (symlog, as in arXiv 2301.04104).
    """
    xp = array_namespace(way)
    return xp.sign(way) * xp.log1p(xp.abs(way) / _FINE)


def around(
    distances: Sequence[float], heights: Sequence[float]
) -> tuple[Placement, ...]:
    """Return bases evenly around the origin that face it, the first at -y.

    The others follow counterclockwise, at these distances and heights, in m.
    """
    placements, count = [], len(distances)
    for i, direction in enumerate(handle_directions(count)):
        x, y = (distances[i] * direction[:2]).tolist()
        angle = 2.0 * np.pi * i / count - np.pi / 2
        yaw = angle - np.pi if angle > 0.0 else angle + np.pi
        placements.append(Placement((x, y, heights[i]), yaw))
    return tuple(placements)


def face_to_face(
    distances: Sequence[float], heights: Sequence[float]
) -> tuple[Placement, Placement]:
    """Return bases, at these distances (m) along -y and +y, that face each other."""
    return (
        Placement((0.0, -distances[0], heights[0]), np.pi / 2),
        Placement((0.0, distances[1], heights[1]), -np.pi / 2),
    )


def add_stand(scene: Scene, agent: str, placement: Placement) -> None:
    """Put a round table under an arm, slim enough to stand beside many others."""
    x, y, height = placement.position
    stand = round_table(_STAND, height=height)
    scene.add(f"{agent}_stand", stand, position=(x, y, 0.0))


class Frames:
    """Turns world frames into those of the robots' bases.

    Args:
      placements: where the bases stand, by agent. A base's frame has both.
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

    def directions(self, agent: str, vectors: Sequence[Array]) -> list[Array]:
        """Return several directions, (num_envs, 3) each, all turned at once."""
        xp = array_namespace(vectors[0])
        turned = self.direction(agent, xp.concat(list(vectors), axis=0))
        return list(xp.reshape(turned, (len(vectors), *vectors[0].shape)))

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

    def way(
        self, agent: str, pose: tuple[Array, Array], goal: tuple[Array, Array]
    ) -> Array:
        """Return how a pose must move to a goal, (num_envs, 6), in its base's frame.

        It is a way in m, then the axis of a turn times its angle, in rad.
        """
        turn = math.multiply(goal[1], math.conjugate(pose[1]))
        both = goal[0] - pose[0], math.rotation_vector(turn)
        xp = array_namespace(turn)
        return xp.concat(self.directions(agent, both), axis=1)


def seat_turns(placements: Mapping[str, Placement]) -> dict[str, np.ndarray]:
    """Return turns by agent, so that equal seats evenly around see one thing alike.

    Each is a quaternion about the vertical, (4,), for a thing whose part is at -y for
    the first agent, and counterclockwise for the others.
    """
    turns = {}
    for i, (agent, placement) in enumerate(placements.items()):
        angle = 2.0 * np.pi * i / len(placements)
        # Of the two quaternions of a turn, the one that all bases see alike.
        whole = np.round((angle - placement.yaw) / (2.0 * np.pi))
        turns[agent] = math.from_yaw(np.array(angle - 2.0 * np.pi * whole))
    return turns


def add_team_camera(
    scene: Scene,
    placements: Mapping[str, Placement],
    below: float = 0.0,
    tall: float = _TALL,
    *,
    steep: bool = False,
    also: Sequence[np.ndarray] = (),
) -> None:
    """Look at arms, and so many m below, from above through the widest gap between.

    Points of `also`, (3,) in m, are to be seen as well.
    """
    is_team = len(placements) > 2
    slope, margin = _SLOPES[steep or is_team], _MARGINS[is_team]
    bases = np.array([each.position for each in placements.values()])
    bases, tops = bases - (0.0, 0.0, below), bases + np.array((0.0, 0.0, tall))
    middle = (bases.min(axis=0) + tops.max(axis=0)) / 2
    azimuths = np.sort(np.arctan2(*(bases - bases.mean(axis=0))[:, 1::-1].T))
    gaps = np.diff(azimuths, append=azimuths[0] + 2 * np.pi)
    between = azimuths + gaps / 2
    # Of gaps that are equally wide, the one nearest to +x.
    angle = between[np.lexsort((np.cos(between), gaps.round(3)))[-1]]
    back = np.array([np.cos(angle), np.sin(angle), slope])
    back /= np.linalg.norm(back)
    right = np.array([-np.sin(angle), np.cos(angle), 0.0])
    up = np.cross(back, right)
    away = np.concatenate([bases, tops, np.reshape(also, (-1, 3))]) - middle
    for _ in range(20):  # Until the lowest and the highest are as near to the edges.
        off = away @ np.transpose([right, up])
        far = np.max(away @ back + np.max((np.abs(off) + margin) / _VIEW, axis=1))
        seen = off[:, 1] / (far - away @ back)
        shift = up * far * (seen.max() + seen.min()) / 2
        middle, away = middle + shift, away - shift
    scene.add_camera(middle + far * back, np.concatenate([right, up]))
