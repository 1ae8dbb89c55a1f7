"""The scripted player of Hockey: where it wants its mallets, seen from above.

Everything is in the frame of the side that plays: it shoots towards +x, and its own
goal is at -x. It foresees the puck's way for a second, cushions included. It blocks a
puck that comes to its goal, or comes fast. If it can reach the puck, it goes behind it,
on the far side from where it aims, and hits it. It aims at the goal past the other
side's mallets, straight or by a cushion, whichever way is freer. Else it stands between
the puck and its goal. Of two mallets, the one to whose half the puck comes plays it.
"""

from dataclasses import dataclass

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.objects.mallet import RADIUS as MALLET
from collaborative_gym.objects.puck import RADIUS as PUCK
from collaborative_gym.objects.rink import HALF_LENGTH

_TOUCH = MALLET + PUCK
_DT, _STEPS = 0.05, 20  # s, and how many of them are foreseen
_PACE = 0.6  # m/s at which a mallet is expected to come to its place
_FAST = 1.0  # m/s towards the goal; a puck that comes faster is blocked
_GUARD = -HALF_LENGTH + 0.16  # m, x where a mallet waits
_BLOCK = -HALF_LENGTH + 0.10  # m, x where it blocks
_BEHIND = 0.05  # m, free way before a hit
_THROUGH = 0.15  # m by which a hit goes on
_LINED_UP = 0.025  # m, greatest miss of the line along which it hits
_FREE = 0.16  # m from a mallet, from where on a way counts as free
_TARGETS = (-0.6, 0.0, 0.6)  # of half of the goal's width, where it aims
_SHOT = 2.2  # m/s, what a hit puck does about


@dataclass(frozen=True)
class Field:
    """What a player knows of the table; lengths are in m."""

    half_width: float
    half_goal: float  # half of a goal's width
    restitution: float  # of a bounce


def play(
    field: Field, own: Array, lanes: Array, others: Array, puck: tuple[Array, Array]
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the mallets of a side should go, and which of them hit now.

    Args:
      field: the table.
      own: (num_envs, mallets, 2) places of the side's mallets, in m.
      lanes: (mallets,) y of the middle of each one's part of the table.
      others: (num_envs, others, 2) places of the other side's.
      puck: its place and velocity, (num_envs, 2) each.

    Returns:
      (num_envs, mallets, 2) in m, and (num_envs, mallets) booleans.
    """
    foreseen = foresee(field, *puck)
    targets, hits = np.zeros(own.shape), np.zeros(own.shape[:2], bool)
    half = field.half_width / len(lanes)
    for i, lane in enumerate(lanes):
        chases = np.abs(foreseen[4, :, 1] - lane) <= half
        guard = _guard(field, foreseen, lane, half)
        strike, hit = _attack(field, own[:, i], others, puck, foreseen)
        comes = puck[1][:, 0] < -_FAST
        mine = chases & ~comes & (foreseen[2:7, :, 0].min(axis=0) < -0.02)
        targets[:, i] = np.where(mine[:, None], strike, guard)
        hits[:, i] = hit & mine
    return targets, hits


def foresee(field: Field, place: Array, velocity: Array) -> np.ndarray:
    """Return where a puck will be every 0.05 s, (21, num_envs, 2), in m."""
    place, velocity = place.copy(), velocity.copy()
    side, end = field.half_width - PUCK, HALF_LENGTH - PUCK
    ways = [place.copy()]
    for _ in range(_STEPS):
        place += _DT * velocity
        is_open = np.abs(place[:, 1]) < field.half_goal - 0.5 * PUCK
        for axis, bound in ((0, np.where(is_open, np.inf, end)), (1, side)):
            over = np.abs(place[:, axis]) - bound
            bounces = (over > 0) & (place[:, axis] * velocity[:, axis] > 0)
            back = (1 + field.restitution) * np.where(bounces, over, 0.0)
            place[:, axis] -= np.sign(place[:, axis]) * back
            velocity[bounces, axis] *= -field.restitution
        ways.append(place.copy())
    return np.array(ways)


def _guard(field: Field, foreseen: Array, lane: float, half: float) -> np.ndarray:
    place = foreseen[0]
    # Where the puck first comes to the mallet's line, if it does.
    arrives = foreseen[:, :, 0] < _BLOCK + 0.02
    first = np.argmax(arrives, axis=0)
    comes = arrives.any(axis=0) & (first > 0)
    there = np.take_along_axis(foreseen, first[None, :, None], axis=0)[0, :, 1]
    share = (_GUARD + HALF_LENGTH) / np.maximum(place[:, 0] + HALF_LENGTH, 0.1)
    between = place[:, 1] * np.minimum(share, 1.0)
    y = np.where(comes, there, between)
    reach = field.half_goal + 0.5 * MALLET
    y = np.clip(np.clip(y, -reach, reach), lane - half + MALLET, lane + half - MALLET)
    return np.stack([np.where(comes, _BLOCK, _GUARD), y], axis=1)


def _attack(
    field: Field, mallet: Array, others: Array, puck: tuple[Array, Array], way: Array
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a mallet goes to hit the puck, and whether it hits now."""
    near = way[2]  # a control step from now
    far = math.distance(mallet, near)
    later = np.clip((far / _PACE / _DT).astype(int), 2, 10)
    there = np.take_along_axis(way, later[None, :, None], axis=0)[0]
    normal = _normal(field, near, puck[1], others)
    gap = near - mallet
    along = math.dot(gap, normal)
    across = np.abs(gap[:, 0] * normal[:, 1] - gap[:, 1] * normal[:, 0])
    hits = (across < _LINED_UP) & (along > 0.5 * _TOUCH) & (along < _TOUCH + 0.10)
    through = near + _THROUGH * normal
    normal_there = _normal(field, there, puck[1], others)
    behind = there - (_TOUCH + _BEHIND) * normal_there
    behind = _round(mallet, behind, way[1])
    return np.where(hits[:, None], through, behind), hits


def _round(mallet: Array, goal: Array, puck: Array) -> np.ndarray:
    """Return a goal, or where the puck is in the way, a place beside it to go first."""
    way, to_puck = goal - mallet, puck - mallet
    length = np.maximum(math.norm(way), 1e-6)
    ahead = way / length[:, None]
    along = np.clip(math.dot(to_puck, ahead), 0.0, length)
    nearest = mallet + along[:, None] * ahead
    aside = nearest - puck
    is_blocked = (math.norm(aside) < _TOUCH) & (along > 0) & (along < length)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    side = np.where(math.dot(aside, left) < 0, -1.0, 1.0)
    beside = puck + (side * (_TOUCH + 0.04))[:, None] * left
    return np.where(is_blocked[:, None], beside, goal)


def _normal(field: Field, place: Array, velocity: Array, others: Array) -> np.ndarray:
    """Return the direction from mallet to puck of a hit that sends it to the goal."""
    aim = _aim(field, place, others)
    across = np.stack([-aim[:, 1], aim[:, 0]], axis=1)
    # The puck keeps its speed across its new way, besides what the hit adds.
    slip = math.dot(velocity, across) / _SHOT
    normal = aim - np.clip(slip, -0.5, 0.5)[:, None] * across
    return normal / math.norm(normal)[:, None]


def _aim(field: Field, place: Array, others: Array) -> np.ndarray:
    """Return the direction of the freest way to the goal, (num_envs, 2)."""
    side, e = field.half_width - PUCK, field.restitution
    targets = np.array(_TARGETS)[:, None] * (field.half_goal - PUCK)
    length, y = HALF_LENGTH - place[:, 0], place[:, 1]
    ways = [(targets - y) / length]
    for wall in (-side, side):
        ways.append((wall - targets + e * (wall - y)) / (e * length))
    slopes = np.concatenate(ways)
    free = _freedom(field, place, slopes, others)
    slope = np.take_along_axis(slopes, free.argmax(axis=0)[None], axis=0)[0]
    way = np.stack([np.ones(len(place)), slope], axis=1)
    return way / math.norm(way)[:, None]


def _freedom(field: Field, place: Array, slopes: Array, others: Array) -> np.ndarray:
    """Return how far ways stay from the others' mallets, in m, at most `_FREE`.

    They begin at places (num_envs, 2), with slopes (ways, num_envs).
    """
    side, e = field.half_width - PUCK, field.restitution
    ahead = np.linspace(0.1, 1.0, 10)[:, None, None] * (HALF_LENGTH - place[:, 0])
    y = place[:, 1] + slopes * ahead
    over = np.abs(y) - side
    y = np.where(over > 0, np.sign(y) * (side - e * over), y)
    x = np.broadcast_to(place[:, 0] + ahead, y.shape)
    at = np.stack([x, y], axis=-1)[..., None, :]
    return np.minimum(math.distance(at, others).min(axis=(0, -1)), _FREE)
