"""The mass of a pot that needs each arm of a team, and where the arms stand around it.

Arms hold the pot at points, so it hangs level where their forces add up to its weight
without a moment about its centre of mass. The most that they carry so is a linear
program: the greatest sum of forces, each within what its arm holds. The mass lies
between what all arms carry and what the best of all but one do.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.motion.lift_mass import IN_MOTION, LEAST_SHARE, Weighing
from collaborative_gym.motion.loads import (
    from_base,
    greatest_loads,
    mounted_way,
    rounded,
    way_loads,
)
from collaborative_gym.objects.pot import greatest_balance
from collaborative_gym.robots import Robot
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import Placement

_SHARES = np.array([0.36, 0.46, 0.56, 0.66, 0.75, 0.84])  # of the reach, tried
_LEVELS = 40  # loads that are tried as what each arm is to carry
_CENTRES = 9  # places of the centre of mass that are tried along each axis
_SIDES = 8  # of the polygon in which a tilted pot's weight acts


def greatest_weight(capacities: Array, spots: Array, *, presses: bool = False) -> Array:
    """Return the most that arms carry together without a moment, in kg.

    It is the dual of the linear program, a convex function of two numbers x. It is
    least where two arms, at p and q, add nothing: where x p = 1 and x q = 1.

    Args:
      capacities: what each arm carries, (arms,), in kg.
      spots: where, from the centre of mass, (..., arms, 2), in m; not all on a line.
      presses: whether arms may also press the pot down, as hard as they carry.
    """
    first, second = np.triu_indices(len(capacities), 1)
    p, q = spots[..., first, :], spots[..., second, :]
    size = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    is_apart = np.abs(size) > 1e-7
    x = np.stack([q[..., 1] - p[..., 1], p[..., 0] - q[..., 0]], axis=-1)
    x = x / np.where(is_apart, size, 1.0)[..., None]
    worth = 1.0 - x @ np.swapaxes(spots, -1, -2)
    worth = np.abs(worth) if presses else np.maximum(worth, 0.0)
    total = (capacities * worth).sum(axis=-1)
    return np.where(is_apart, total, np.inf).min(axis=-1)


def weigh_team(
    robots: Sequence[Robot],
    placements: Sequence[Placement],
    *,
    ends: Sequence[tuple[np.ndarray, np.ndarray]],
    target: np.ndarray,
    handles: np.ndarray,
    radius: float,
    tilt: float,
    grasps: Sequence[float],
) -> Weighing:
    """Return the loads of three or more arms, of all and without each.

    Arguments are those of `lift_mass.weigh`, with handles of all arms, (arms, 3), and
    the `tilt` of the pot that counts as level, in rad.
    """
    # All handles of a pot that counts as lifted are moved alike.
    up, out = np.array([[0.0, 0.0, 1.0]]), handles * (1.0, 1.0, 0.0)
    out = out / math.norm(out)[:, None]
    moved = target + radius * np.concatenate([0.0 * up, up, -up, out])
    ways, held = [], []
    grasps = [force / GRAVITY for force in grasps]
    for i, (robot, place) in enumerate(zip(robots, placements, strict=True)):
        ways.append(mounted_way(robot, place, ends[i]).at_most(IN_MOTION * grasps[i]))
        # In an order that equal arms around the pot share, so as to be searched once.
        points = from_base(place, moved + handles[i])
        order = tuple(sorted(set(points)))
        loads = dict(zip(order, greatest_loads(robot, order), strict=True))
        held.append([min(loads[point], grasps[i]) for point in points])
    capacities, spots = np.array([way.load for way in ways]), handles[:, :2]
    # The weight of a tilted pot acts beside the middle of its handles.
    lean = handles[0, 2] * np.sin(tilt)
    most = greatest_balance(len(spots))
    centre, together, fewer = _balance(
        capacities, np.array(held).T, spots, lean=lean, most=most
    )
    shares = _shares(capacities, spots - centre)
    return Weighing(tuple(ways), fewer, together, shares, centre)


def _balance(
    capacities: Array, held: Array, spots: Array, *, lean: float, most: float
) -> tuple[tuple[float, float], float, tuple[float, ...]]:
    """Return the centre of mass at which a team needs each of its arms most.

    Args:
      capacities: what each arm carries on its way, (arms,), in kg.
      held: what each carries near the target, (places, arms), in kg.
      spots: of the handles, (arms, 2), in m.
      lean: how far the weight may act from the centre, in m.
      most: greatest distance of the centre from the pot's axis, in m.

    Returns:
      The centre, what all carry, and what the best others carry without each arm.
    """
    grid = np.linspace(-most, most, _CENTRES)
    centres = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    even = capacities @ spots / capacities.sum()
    centres = np.concatenate([[even], centres[math.norm(centres) <= most]])
    centres *= np.minimum(1.0, most / np.maximum(math.norm(centres), 1e-9))[:, None]
    together = greatest_weight(capacities, spots - centres[:, None])
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    leans = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    leans = np.concatenate([np.zeros((1, 2)), lean / np.cos(np.pi / _SIDES) * leans])
    acts = spots - (centres[:, None] + leans)[:, :, None]
    others = ~np.eye(len(spots), dtype=bool)
    # By arm that is missing, place, centre and lean.
    fewer = [
        [greatest_weight(at[rest], acts[:, :, rest], presses=True) for at in held]
        for rest in others
    ]
    fewer = np.max(fewer, axis=(1, 3))
    worst = np.maximum(fewer.max(axis=0), LEAST_SHARE**2 * together)
    # Of equal ones it is where all carry most.
    best = (together / worst + 1e-3 * together / capacities.sum()).argmax()
    x, y = centres[best].tolist()
    return (x, y), float(together[best]), tuple(fewer[:, best].tolist())


def _shares(capacities: Array, spots: Array) -> tuple[float, ...]:
    rows = np.concatenate([np.ones((1, len(spots))), spots.T])
    weighted = capacities**2 * rows
    shares = weighted.T @ np.linalg.solve(weighted @ rows.T, [1.0, 0.0, 0.0])
    return tuple(shares.tolist())


@lru_cache(maxsize=64)
def spread(
    robots: tuple[Robot, ...],
    heights: tuple[float, ...],
    *,
    start: float,
    end: float,
    radius: float,
) -> tuple[float, ...]:
    """Return how far arms of a team stand from their handles, so that each is needed.

    What an arm carries to the target should be what each other one does, and no less
    than what it holds near the target.

    Args:
      robots: the arms.
      heights: of their bases, in m.
      start: height of a handle on the table, in m.
      end: height of a handle at the target, in m.
      radius: distance of the pot to the target that counts as there, in m.
    """
    team, carried, held = tuple(zip(robots, heights, strict=True)), [], []
    kinds = tuple(dict.fromkeys(team))
    for robot, height in kinds:
        far = robot.reach * _SHARES
        ways = [(x, 0.0, z - height) for x in far for z in (start, end)]
        near = [(x - dx, 0.0, end - height) for x in far for dx in (0.0, radius)]
        ways, near = rounded(np.array(ways)), rounded(np.array(near))
        carried.append(way_loads(robot, tuple(zip(ways[::2], ways[1::2], strict=True))))
        loads = np.array(greatest_loads(robot, near)).reshape(-1, 2)
        held.append(loads.mean(axis=1))
    # What is out of reach counts as hardly carried; `strongest_way` refuses it.
    carried, held = (np.maximum(each, 1e-3)[:, None] for each in (carried, held))
    level = np.geomspace(held.min(), held.max(), _LEVELS)[:, None]
    # How far apart the loads are, by kind, level and share of the reach.
    cost = np.maximum(held / level, level / carried)
    best = cost.min(axis=2).max(axis=0).argmin()
    shares = _SHARES[cost[:, best].argmin(axis=1)].tolist()
    return tuple(shares[kinds.index(kind)] * kind[0].reach for kind in team)
