"""Places of arms in a row, where they meet and pick up, and whose a thing is."""

from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import Chains, hold, safest_way
from collaborative_gym.objects.table import table
from collaborative_gym.robots import Robot
from collaborative_gym.scene import SHOULDER, Arm, Placement, Scene

PICKING = np.array([0.0, 0.5**0.5, 0.5**0.5, 0.0])
"""Orientation (w x y z) of a hand that picks from above."""

GIVING = np.array([[-0.5, 0.5, 0.5, 0.5], [0.0, 0.0, 0.5**0.5, 0.5**0.5]])
TAKING = np.array([[-0.5, -0.5, 0.5, -0.5], [0.5**0.5, 0.5**0.5, 0.0, 0.0]])
"""Those of the hands of arms in turn that give and take. Hands meet head on, one
closing along x and the other along z, so that their fingers pass one another. A hand
closes along the same axis wherever its arm meets others."""

TABLE_END = 1.1
"""x of the tables' far ends, in m."""

_TABLE_HEIGHT = 0.64  # m, of a table that no arm stands on
_GRID = 25  # places along either side of a table
_BEFORE = 1.7  # tangent of 60 degrees to either side
_AT_EASE = 1.05  # times as far away an arm must reach; at the very end it is slow
_LIFTED = 0.1  # m, how high the hand is free above what it picks up


def either_way(hand: np.ndarray) -> list[np.ndarray]:
    """Return a hand, and turned half about its approach: it grips as well so."""
    turns = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return [math.multiply(hand, turn) for turn in turns]


def stand_in_row(robots: Iterable[Robot]) -> tuple[Placement, ...]:
    """Return a row of bases that face +x, farther apart, the longer the reach is.

    So neighbours reach a place between them, and others do not reach each other.
    """
    robots = list(robots)
    halves = [0.7 if r.stand == "pedestal" else 0.71 * r.reach for r in robots]
    middle, placements = len(halves) // 2, []
    for i, (robot, half) in enumerate(zip(robots, halves, strict=True)):
        is_left = i < middle
        between = sum(halves[i + 1 : middle] if is_left else halves[middle:i])
        y = (-1 if is_left else 1) * (half + 2 * between)
        if robot.stand == "pedestal":
            placements.append(Placement((0.8 - 0.635 * robot.reach, y, 1.0)))
        else:
            placements.append(Placement((0.55, y, 0.62)))
    return tuple(placements)


class Row:
    """Arms in a row, by agent, each with a table, and things of this size (m) there."""

    def __init__(
        self,
        robots: Mapping[str, Robot],
        placements: Mapping[str, Placement],
        size: float,
    ):
        self._robots, self._placements = robots, placements
        gaps = np.diff([place.position[1] for place in placements.values()])
        widths = np.minimum([*gaps, np.inf], [np.inf, *gaps]) - 0.2
        self._tables, self._tops, self._heights = {}, {}, {}
        for (agent, place), width in zip(placements.items(), widths, strict=True):
            x, y, z = place.position
            before = robots[agent].stand == "pedestal"
            near, height = (0.5, _TABLE_HEIGHT) if before else (x - 0.2, z)
            area, middle = (TABLE_END - near, width), ((TABLE_END + near) / 2, y)
            self._tables[agent] = area, height, (*middle, 0.0)
            corner = np.array(area) / 2 - size
            self._tops[agent] = middle - corner, middle + corner
            self._heights[agent] = height + size / 2

    def add_to(self, scene: Scene) -> None:
        """Add the arms, with the table of each."""
        for agent, robot in self._robots.items():
            own, place = robot.stand == "pedestal", self._placements[agent]
            scene.add_robot(agent, robot, placement=place, stand=own)
            area, height, position = self._tables[agent]
            top = table(*area, height=height)
            scene.add(f"{agent}_table", top, position=position)

    def before(self, agent: str, aside: float) -> np.ndarray:
        """Return where a thing lies at ease before an arm, so far to its left, (3,)."""
        x, y, _ = self._placements[agent].position
        x = min(x + 0.635 * self._robots[agent].reach, TABLE_END - 0.1)
        return np.array([x, y + aside, self._heights[agent]])

    def meetings(self, spots: Sequence[Array]) -> list[np.ndarray]:
        """Return where neighbours meet, at ease for both, (3,) each, in m.

        That is half-way between the spots where they have a thing by themselves.
        """
        pairs = zip(self._robots.values(), self._placements.values(), strict=True)
        arms = [(0.8 * r.reach, np.array(p.position) + SHOULDER) for r, p in pairs]
        meetings = []
        for i in range(len(arms) - 1):
            place = (np.array(spots[i]) + spots[i + 1]) / 2
            for easy, shoulder in 50 * arms[i : i + 2]:
                arm = place - shoulder
                place = shoulder + arm * min(1.0, easy / math.norm(arm))
            meetings.append(place)
        return meetings

    def picking(
        self, model: mujoco.MjModel, arm: Arm, *, agent: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a hand above the middle of an arm's table, and joint angles there."""
        place = self.before(agent, 0.0) + np.array([0.0, 0.0, 0.1])
        ways = [[(place, hand)] for hand in either_way(PICKING)]
        chosen, [angles] = safest_way(model, arm, ways=ways)
        return ways[chosen][0][1], angles

    def in_reach(
        self,
        model: mujoco.MjModel,
        arm: Arm,
        *,
        agent: str,
        right: float,
        start: tuple[Array, Array],
    ) -> np.ndarray:
        """Return places on an agent's table from which it picks things up, (n, 3).

        Their y is at least `right`. It picks with the hand of `start`, and begins with
        the joint angles there, (joints,), in rad.
        """
        (x, y), (far, left) = self._tops[agent]
        y, height = max(y, right), self._heights[agent]
        base = np.array(self._placements[agent].position[:2])
        steps = np.mgrid[x : far : _GRID * 1j, y : left : _GRID * 1j]
        ahead, aside = away = steps.reshape(2, -1) - base[:, None]
        # Straight ways to what lies beside a base lead into it.
        away = away.T[np.abs(aside) < _BEFORE * ahead]
        hand, angles = start[0], np.tile(start[1], (len(away), 1))
        chains, reached = Chains(model, [arm]), np.ones(len(away), bool)
        for above, share in ((_LIFTED, 1.0), (0.0, _AT_EASE)):
            place = np.insert(base + share * away, 2, height + above, axis=1)
            [angles], there = hold(chains, [(place, hand)], near=[angles])
            reached &= there
        return np.insert(base + away, 2, height, axis=1)[reached]


def handed_on(handed: Array, grips: Sequence[Array]) -> Array:
    """Return how many arms have now had each thing, from hand to hand.

    It takes how many had it before, (num_envs, things), and which things each arm of
    the row holds, likewise. For a moment two hold what one takes from the other.
    """
    xp = array_namespace(handed)
    for i, held in enumerate(grips):
        takes = held & grips[i - 1] if i else held
        handed = xp.where((handed == i) & takes, i + 1.0, handed)
    return handed


def own_thing(held: Array, passed: Array) -> Array:
    """Return which thing is an arm's own, (num_envs,).

    It is what it holds, or the first that it has not passed on, or the last; both are
    given as (num_envs, things) booleans.
    """
    xp, count = array_namespace(held), held.shape[1]
    order = xp.arange(count)
    rank = xp.where(passed, 2 * count - order, order)
    return xp.argmin(xp.where(held, -1, rank), axis=1)


def of(rows: Array, which: Array) -> Array:
    """Return of each row (num_envs, things, ...) what is of one thing, (num_envs,)."""
    return rows[array_namespace(rows).arange(len(rows)), which]
