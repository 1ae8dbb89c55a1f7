"""Sort's expert: each arm takes the next cube, and brings it where it goes.

An arm that has nothing to take waits above its lane.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import reach, settling, shortened, standoff
from collaborative_gym.objects.belt import WALL
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.handing import of
from collaborative_gym.tasks.task import LEVEL

if TYPE_CHECKING:
    from collaborative_gym.tasks.sort import Sort, SortFacts

HEIGHT = 0.64  # m of the belt above the floor
SIZE = 0.04  # m, of a cube
MIDDLE = 0.1  # m from the middle, within which a cube is in reach of either side

_DOWN = np.array([0.0, 0.0, -1.0])
_ABOVE = {"slack": 0.015, "least": 0.0, "most": 0.08}
_CLOSE = 0.8  # share of the greatest distance of a grip at which a hand grips
_BACK = 0.01  # m; a hand that goes back by more does not grip
_LEAD = 0.22  # s by which a hand that follows a moving cube would come late
_LIFT = 0.1  # m above where it was taken, from which on a cube is swung to its tote
_FAR = 0.3  # m across the floor, from which on an arm swings instead of going straight
_OVER = 0.06  # m from the middle of the tote, within which the hand opens
_LOW = 0.012  # m above the belt, from which the mate's cube is let go
_ASIDE = 0.15  # m along the belt from an arm, within which it puts that down
_GENTLE = 0.03  # m in a control step, at which cups and pads do not tear
_BEYOND = 0.02  # m beyond the middle, where it does


def expert(self: "Sort", sim: Sim, facts: "SortFacts") -> dict[str, Motion]:
    """Return motions with which all arms sort."""
    return {agent: _sort(self, sim, facts, agent) for agent in self.agents}


class _Aim(NamedTuple):
    """Where an arm goes, (num_envs, ...) each."""

    place: Array  # of its tcp, in m
    station: Array  # index of the posture and the hand that it has there
    swings: Array  # where it goes to that posture, and not straight to the place


def _sort(task: "Sort", sim: Sim, facts: "SortFacts", agent: str) -> Motion:
    arm, tcp = task.scene.arms[agent], facts.tcp[agent]
    held = of(facts.grips[agent], facts.own[agent])
    taking, closes = _take(task, facts, agent)
    bringing, opens = _bring(task, facts, agent)
    both = zip(bringing, taking, strict=True)
    aim = _Aim(
        *(np.where(held if b.ndim < 2 else held[:, None], b, t) for b, t in both)
    )
    hand = np.concatenate(task.hands[agent])[aim.station]
    posture, goal = task.angles[agent][aim.station], (aim.place, hand)
    straight = reach(sim, arm, tcp=tcp, goal=goal, posture=posture)
    swing = settling(sim, arm, change=posture - facts.joints[agent])
    change = np.where(aim.swings[:, None], swing, straight)
    return Motion(change, np.where(held, ~opens, closes))


def _take(task: "Sort", facts: "SortFacts", agent: str) -> tuple[_Aim, Array]:
    """Take a cube from above, where it will be; where none comes, wait above the lane.

    Returns the aim, and where the hand closes, (num_envs,).
    """
    tcp, which = facts.tcp[agent][0], facts.own[agent]
    cube, comes = of(facts.cubes, which), of(facts.near[agent], which)
    ahead = cube + np.array([_LEAD * task.config.belt_speed, 0.0, 0.0])
    gap = standoff(tcp - cube, _DOWN, **_ABOVE)
    place = ahead - gap * _DOWN
    backs = gap[:, 0] - _BACK > math.dot(ahead - tcp, _DOWN)
    near = math.distance(tcp, cube) < _CLOSE * task.config.picking_threshold
    station = np.where(comes & (np.abs(cube[:, 1]) < MIDDLE), 1, 0)
    return _Aim(place, station, ~comes | _is_far(place - tcp)), comes & near & ~backs


def _bring(task: "Sort", facts: "SortFacts", agent: str) -> tuple[_Aim, Array]:
    """Put the mate's cube down on the middle; lift its own and let it fall in the tote.

    Returns the aim, and where the hand opens, (num_envs,).
    """
    i, tcp, which = task.agents.index(agent), facts.tcp[agent][0], facts.own[agent]
    # Hands that draw nothing to their tcp hold it where they took it.
    at = tcp if task.scene.grasp.draws else of(facts.cubes, which)
    is_mates = task.is_mates(agent, which)
    across, lies = np.abs(at[:, 1]), HEIGHT + SIZE / 2
    x = np.clip(at[:, 0], task.seats[i] - _ASIDE, task.seats[i] + _ASIDE)
    beyond = np.full_like(x, -_BEYOND * np.sign(task.placements[agent].position[1]))
    middle = np.stack([x, beyond, lies + np.where(across > 0.05, 0.05, 0.0)], axis=1)
    is_there = (across < 0.6 * MIDDLE) & (at[:, 2] < lies + _LOW)
    is_lifted = at[:, 2] > HEIGHT + _LIFT
    over = task.totes[agent] + np.array([0.0, 0.0, WALL + 0.05]) + 0.0 * at
    is_over = math.norm((over - at) * LEVEL) < _OVER
    own = np.where(is_lifted[:, None], over, at - _LIFT * _DOWN)
    place = np.where(is_mates[:, None], middle, own)
    station = np.where(is_mates, 1, np.where(is_lifted, 2, 0))
    swings = ~is_mates & is_lifted & _is_far(place - at)
    if not task.scene.grasp.draws:
        place = tcp + shortened(place - at, _GENTLE)
    return _Aim(place, station, swings), np.where(is_mates, is_there, is_over)


def _is_far(way: Array) -> Array:
    """Return which ways lead so far across the floor that an arm swings there."""
    return math.norm(way * LEVEL) > _FAR
