"""How Reach's expert plays: arms whose ways cross go one after the other.

An arm that points away from its base takes the room above a line on the floor, from its
base to its tcp. Drawn back and put out again, it sweeps no other room than those lines.
So it goes only where the lines that it will sweep are clear of all other arms.
"""

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.scene import SHOULDER
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import LEVEL

if TYPE_CHECKING:
    from collaborative_gym.tasks.reach import Reach, ReachFacts

_ROOM = 0.26  # m between the lines of two arms that pass each other
_MORE = 0.03  # m, of room for an arm that is about to start
_ROOM_AT_REST = 0.12  # m, where one of them is drawn back; goals are clear of it
_STEEP, _FLAT = np.radians(75.0), np.radians(45.0)
"""How far down hands point, near the base and far out: near it, wrists cannot fold."""

_NEAR, _FAR = 0.32, 0.55  # where these slopes are reached, as shares of an arm's reach

_POINTS = 6  # of each line whose distances are taken
_SLACK = 0.05  # m, how far out an arm that is drawn back may be
_CLOSE = 0.15  # m, from a goal, within which hands point as they like


def approach(level: Array, reach: float) -> np.ndarray:
    """Return directions of hands, (..., 3).

    Args:
      level: from the base to the tcp, (..., 3), without its height, in m.
      reach: of the arm, in m.
    """
    far = math.norm(level)[..., None]
    share = np.clip((far / reach - _NEAR) / (_FAR - _NEAR), 0.0, 1.0)
    slope = _STEEP + share * (_FLAT - _STEEP)
    return np.cos(slope) * level / far - np.sin(slope) * np.array([0.0, 0.0, 1.0])


def expert(self: "Reach", sim: Sim, facts: "ReachFacts") -> dict[str, Motion]:
    """Go to a goal if the way is clear and nobody before has it; else draw back."""
    bases = np.stack([np.array(p.position) for p in self.placements.values()])
    rests = np.stack(list(self.rests.values()))
    tcps = np.stack([place for place, _ in facts.tcps.values()], axis=1)
    goals = np.stack(list(facts.goals.values()), axis=1)
    done = np.stack(list(facts.done.values()), axis=1)
    has_goal = done < self.config.goals
    elbows = np.stack(list(facts.elbows.values()), axis=1)
    shoulders = np.broadcast_to(bases + SHOULDER, tcps.shape)
    now = _lines((shoulders, elbows), (elbows, tcps))
    sweeps = _lines((shoulders, tcps), (shoulders, goals), (tcps, goals))
    rested = math.distance(tcps, rests) < _SLACK
    goes = _right_of_way(sweeps, now, rested, done, has_goal)
    # Drawn straight back, then turned.
    away = (tcps - bases) * LEVEL
    length = math.norm((rests - bases) * LEVEL)[:, None]
    far = math.norm(away)[..., None]
    back = bases + away / far * length
    back[..., 2] = rests[:, 2]
    target = np.where(goes[..., None], goals, back)
    is_back = ~goes & (far[..., 0] < length[:, 0] + _SLACK)
    motions, loaded = {}, np.zeros(sim.num_envs, bool)
    for i, (agent, arm) in enumerate(self.scene.arms.items()):
        down = approach((target[:, i] - bases[i]) * LEVEL, arm.robot.reach)
        tcp, posture = facts.tcps[agent], self.postures[agent]
        aim, goal = (target[:, i], down), facts.goals[agent]
        change = motion.reach(sim, arm, tcp=tcp, goal=aim, posture=posture)
        # At the goal it no longer matters how the hand points.
        ends = motion.carry(
            sim, arm, tcp=tcp[0], goal=goal, posture=posture, is_loaded=loaded
        )
        is_near = goes[:, i] & (facts.distance[agent] < _CLOSE)
        change = np.where(is_near[:, None], ends, change)
        swing = self.starts[agent] - facts.joints[agent]
        swing = motion.settling(sim, arm, change=swing)
        motions[agent] = Motion(np.where(is_back[:, i : i + 1], swing, change))
    return motions


def _lines(*pairs: tuple[Array, Array]) -> np.ndarray:
    """Return lines between places (num_envs, arms, 3), (num_envs, arms, n, 2, 3)."""
    return np.stack([np.stack(pair, axis=2) for pair in pairs], axis=2)


def _right_of_way(
    sweeps: Array, now: Array, rested: Array, done: Array, has_goal: Array
) -> np.ndarray:
    """Return which arms go to their goals, (num_envs, arms) booleans."""
    count = done.shape[1]
    # Who starts needs more room than who is on the way, or both would hesitate.
    needed = np.where(rested, _ROOM + _MORE, _ROOM)
    room = np.where(rested, _ROOM_AT_REST, _ROOM - _MORE)
    fits, is_clear = np.ones((2, len(done), count, count), bool)
    for i, j in combinations(range(count), 2):
        gap = _gap(sweeps[:, i], sweeps[:, j])
        fits[:, i, j], fits[:, j, i] = gap > needed[:, i], gap > needed[:, j]
        is_clear[:, i, j] = _gap(sweeps[:, i], now[:, j]) > room[:, j]
        is_clear[:, j, i] = _gap(sweeps[:, j], now[:, i]) > room[:, i]
    order = np.argsort(done + np.arange(count) / count, axis=1, kind="stable")
    goes, worlds = np.zeros(done.shape, bool), np.arange(len(done))
    for first in order.T:
        own = (fits[worlds, first] | ~goes).all(axis=1)
        goes[worlds, first] = own & has_goal[worlds, first]
    return goes & is_clear.all(axis=2)


def _gap(one: Array, other: Array) -> np.ndarray:
    """Return the distance between two sets of lines (num_envs, lines, 2, 3), in m."""
    return np.minimum(_nearest(one, other), _nearest(other, one))


def _nearest(one: Array, other: Array) -> np.ndarray:
    """Return the least distance from points on lines to other lines, in m."""
    shares = np.linspace(0.0, 1.0, _POINTS)[:, None]
    points = one[:, :, :1] + shares * (one[:, :, 1:] - one[:, :, :1])
    points = points.reshape(len(one), -1, 1, one.shape[-1])
    start, along = other[:, None, :, 0], (other[:, :, 1] - other[:, :, 0])[:, None]
    share = math.dot(points - start, along) / np.maximum(math.dot(along, along), 1e-9)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return math.distance(points, nearest).min(axis=(1, 2))
