"""How Pass's expert plays, and how it hands over elsewhere in its styles.

Each arm first comes to its cube: the first arm picks it up, and others take it. Then it
brings it on: the last arm to the target, and others to the next hand.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import reach, settling, standoff
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.handing import of

if TYPE_CHECKING:
    from collaborative_gym.tasks.pass_ import Pass, PassFacts

DOWN, ACROSS = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])

_CLOSE = 0.8  # share of the greatest distance of a grip at which a hand grips
# How a hand comes before the cube, in m. One that takes it 6 mm aside passes the
# giver's fingers by less than 1 mm.
_ABOVE = {"slack": 0.01, "least": 0.0, "most": 0.06}
# In a relay less exactly, so that networks can do what it advises.
_LOOSE = {**_ABOVE, "slack": 0.017}
_ASIDE = {"slack": 0.002, "least": 0.0, "most": 0.1}
# Fingers that touch the cube must have it well between them, come straight from above,
# and be calm with it, or it creeps out of them.
_BETWEEN, _CALM = 0.014, 0.3  # m, and share of the usual motion
_SLOW = 0.4  # the most of its joints' speed with the cube
_STRAIGHT = {"slack": 0.005, "least": 0.0, "most": 0.02}
# A hand that goes back by more does not grip: with late actions, it would let go of the
# cube as it gets it.
_BACK = 0.01  # m
_LIFT, _LIFTED = 0.1, 0.03  # m, how far a hand pulls a cube up, and which is enough
_ARRIVED = 0.05  # m from the meeting at which the next arm follows the cube
_SETTLED = 0.02  # m, in a relay, whose hands come faster
_TURNED = np.cos(0.4)  # of half the angle by which a hand does not yet point downwards
_NEAR_MEETING = 0.3  # m
_APART = 0.08  # m between two hands, from which on the one with the cube turns away
BEYOND = 0.05  # m from the meeting across, from which on the next arm picks up the cube
_NEAR_END = 0.3  # m from the target, within which the last arm goes straight
_PUT = 0.03  # m from the target, within which the last arm's hand opens
_LEAVING = 0.13  # m from what it has let go, within which a hand goes straight away
_AWAY = 0.15  # m, how far it goes
_FAR = 0.5  # m from where its next cube comes, from which on an arm swings there
_POINT = (0.0, 0.0, 0.0)
# Where styles hand over, in m from the meeting, about as far away as learners chose to:
# middle and half axes of an ellipsoid in which each episode draws a place.
_ELSEWHERE = {
    "nearer": ((-0.2, 0.0, 0.0), _POINT, "0.2 m nearer to the arms' bases"),
    "farther": ((0.15, 0.0, 0.0), _POINT, "0.15 m farther from the arms' bases"),
    "lower": ((0.0, 0.0, -0.2), _POINT, "0.2 m lower"),
    "higher": ((0.0, 0.0, 0.2), _POINT, "0.2 m higher"),
    "first-side": ((0.0, -0.15, 0.0), _POINT, "0.15 m nearer to robot_1"),
    "second-side": ((0.0, 0.15, 0.0), _POINT, "0.15 m nearer to robot_2"),
    "anywhere": ((-0.05, 0.0, 0.0), (0.15, 0.15, 0.2), "where each episode draws"),
}
STYLES = {style: f"they hand over {where}" for style, (*_, where) in _ELSEWHERE.items()}


def expert(self: "Pass", sim: Sim, facts: "PassFacts") -> dict[str, Motion]:
    """Return motions for a hand-over at the usual meeting."""
    return _hand_over(self, sim, facts, np.zeros(3))


def styled(
    self: "Pass", sim: Sim, facts: "PassFacts", *, style: str, draws: np.ndarray
) -> dict[str, Motion]:
    """Return motions for a hand-over elsewhere."""
    middle, spread, _ = _ELSEWHERE[style]
    # In a ball, because arms do not reach into all corners.
    inside = draws / np.maximum(math.norm(draws), 1.0)[:, None]
    return _hand_over(self, sim, facts, middle + np.multiply(spread, inside))


class _Aim(NamedTuple):
    """Where an arm goes, (num_envs or 1, ...) each."""

    place: Array  # of its tcp, in m
    hand: Array  # its quaternion there
    angles: Array  # joint angles to prefer, or where it swings, to go to, in rad
    swings: Array  # (num_envs, 1), where it goes to the angles, and not straight


def _choose(where: Array, one: _Aim, other: _Aim) -> _Aim:
    """Return an aim in the worlds `where`, (num_envs, 1), and the other elsewhere."""
    return _Aim(*(np.where(where, *pair) for pair in zip(one, other, strict=True)))


class _View:
    """What one arm looks at, (num_envs, ...) each."""

    def __init__(self, task: "Pass", facts: "PassFacts", i: int, shift: Array):
        self.task, self.facts, self.i, self.agent = task, facts, i, task.agents[i]
        self.is_last, self.shift = i == len(task.meetings), shift
        self.which = facts.own[:, i]
        self.tcp, self.quat = facts.tcp[self.agent]
        self.cube, self.target = self.own(facts.cubes[0]), self.own(facts.targets)
        self.holds = facts.holds[self.agent][:, None]
        self.angles, self.hands = task.angles[self.agent], task.hands[self.agent]
        self.touches = task.scene.grasp.touches
        if self.touches:
            # Contacts may miss a finger for a step, in which a hand must not open.
            near = (facts.to_cube[self.agent] < _BETWEEN)[:, None]
            others = sum(self.held_by(k) for k in range(len(task.agents))) > 0
            self.holds = self.holds | (near & ~others & ~self.is_low())

    def own(self, rows: Array, behind: int = 0) -> Array:
        """Return of rows (num_envs, cubes, ...) what is of its cube, or one before."""
        return of(rows, np.maximum(self.which - behind, 0))

    def held_by(self, i: int) -> Array:
        """Return where another arm holds its cube, (num_envs, 1)."""
        return self.own(self.facts.grips[self.task.agents[i]])[:, None]

    def is_beyond(self, i: int) -> Array:
        """Return where arm i has lost its cube on the side of the next."""
        across = math.dot(self.cube - self.task.meetings[i], ACROSS)
        return (across > BEYOND)[:, None] & ~self.held_by(i)

    def above(self) -> Array:
        """Return how far above its cube its hand goes, (num_envs, 1), in m."""
        way = self.tcp - self.cube
        if self.touches:
            return 2.0 * standoff(way, DOWN, **_STRAIGHT)
        return standoff(way, DOWN, **(_LOOSE if self.task.config.relay else _ABOVE))

    def is_low(self) -> Array:
        """Return where its hand is at the cubes on the tables, (num_envs, 1)."""
        return self.tcp[:, 2:] <= self.task.cube_start[2] + _LIFTED

    def along(self, hand: Array) -> Array:
        """Return a hand above the table, along the sides of a cube that lies turned."""
        if not self.touches:
            return hand
        x, y, _ = np.moveaxis(math.axis_x(self.own(self.facts.cubes[1])), -1, 0)
        yaw = (np.arctan2(y, x) + np.pi / 4) % (np.pi / 2) - np.pi / 4
        return math.multiply(math.from_yaw(yaw), np.broadcast_to(hand, (len(yaw), 4)))

    def grips(self, comes: Array | bool = True) -> Array:
        """Return where it holds a cube, or comes close enough to grip its own."""
        most = _CLOSE * self.task.thresholds[self.agent]
        if self.touches:
            most = min(most, _BETWEEN)
        near = self.facts.to_cube[self.agent] < most
        return self.holds[:, 0] | (near & comes)


def _hand_over(
    task: "Pass", sim: Sim, facts: "PassFacts", shift: np.ndarray
) -> dict[str, Motion]:
    motions = {}
    for i, (agent, arm) in enumerate(task.scene.arms.items()):
        view = _View(task, facts, i, shift)
        aim, has, grips = _take(view) if i else _pick(view)
        aim = _come_back(view, aim)
        end, brings, lets_go = _bring(view, has) if view.is_last else _give(view, has)
        aim = _choose(brings, end, aim)
        goal = aim.place, aim.hand
        straight = reach(sim, arm, tcp=facts.tcp[agent], goal=goal, posture=aim.angles)
        swing = settling(sim, arm, change=aim.angles - facts.joints[agent])
        change = np.where(aim.swings, swing, straight)
        if view.touches:
            fastest = np.abs(change / arm.stride).max(axis=1, keepdims=True)
            calm = np.minimum(_CALM, _SLOW / np.maximum(fastest, _SLOW))
            change = change * np.where(view.holds, calm, 1.0)
        motions[agent] = Motion(change, grips & ~lets_go[:, 0])
    return motions


def _pick(view: _View) -> tuple[_Aim, Array, Array]:
    """Pick the cube up: return the aim, where it is lifted (num_envs, 1), and grips."""
    tcp, cube, holds = view.tcp, view.cube, view.holds
    above = view.above()
    place = cube - np.where(holds, _LIFT, above) * DOWN
    angles = np.where(holds, view.angles[-1], view.angles[0])
    draws_back = (above - _BACK)[:, 0] > math.dot(cube - tcp, DOWN)
    aim = _Aim(place, view.along(view.hands[0]), angles, np.zeros_like(holds))
    return aim, holds & ~view.is_low(), view.grips(~draws_back)


def _take(view: _View) -> tuple[_Aim, Array, Array]:
    """Wait at the meeting and take the cube there; the results are those of `_pick`."""
    tcp, cube, holds, i = view.tcp, view.cube, view.holds, view.i
    giver = view.facts.tcp[view.task.agents[i - 1]][0]
    meeting = view.task.meetings[i - 1] + view.shift
    relay = bool(view.task.config.relay)
    is_there = math.distance(cube, meeting) < (_SETTLED if relay else _ARRIVED)
    offered = view.held_by(i - 1) & is_there[:, None]
    gap = standoff(tcp - cube, -ACROSS, **_ASIDE)
    place = np.where(offered, cube, meeting) + np.where(holds, 0.15, gap) * ACROSS
    picks = ~holds & view.is_beyond(i - 1)
    # From a table it lifts the cube first, but not where it puts it down.
    is_far = (math.distance(tcp, view.target) > _NEAR_END)[:, None]
    low = holds & view.is_low() & is_far
    above = np.where(holds, _LIFT, view.above())
    place = np.where(picks | low, cube - above * DOWN, place)
    (downwards, above_table), taking = view.task.picks[view.agent], view.angles[1]
    hand = np.where(picks | low, view.along(downwards), view.hands[1])
    angles = np.where(picks, above_table, taking) if relay else taking
    # Wrists that take have no straight way to all that lies on the table.
    is_turned = np.abs(math.dot(view.quat, downwards)) < _TURNED
    aim = _Aim(place, hand, angles, relay & picks & is_turned[:, None])
    has = holds & ~low & (math.distance(tcp, giver) > _APART)[:, None]
    return aim, has, view.grips()


def _come_back(view: _View, aim: _Aim) -> _Aim:
    """Return the aim of an arm that comes for its next cube: away, and back first."""
    free = ~view.holds & (view.which > 0)[:, None]
    # Straight away from the cube that it has just let go.
    last = view.own(view.facts.cubes[0], behind=1)
    leaves = free & (math.distance(view.tcp, last) < _LEAVING)[:, None]
    back = view.tcp - _AWAY * (DOWN if view.is_last else ACROSS)
    away = _Aim(back, view.quat, view.angles[-1], np.zeros_like(free))
    start = view.task.meetings[view.i - 1] if view.i else view.cube
    is_far = free & (math.distance(view.tcp, start) > _FAR)[:, None]
    swing = _Aim(view.tcp, view.quat, view.angles[0], np.ones_like(free))
    return _choose(leaves, away, _choose(is_far, swing, aim))


def _give(view: _View, has: Array) -> tuple[_Aim, Array, Array]:
    """Bring the cube to the meeting: return the aim, where it is that, and let go."""
    usual, taken = view.task.meetings[view.i], view.held_by(view.i + 1)
    meeting, passed = usual + view.shift, taken | view.is_beyond(view.i)
    # Elsewhere, and in a relay, which settles, it goes straight, once it is near.
    goes_straight = bool(view.task.config.relay or (meeting != usual).any())
    near = math.distance(view.cube, usual) < _NEAR_MEETING
    straight = has & near[:, None] & goes_straight
    place = np.where(passed, meeting - _AWAY * ACROSS, meeting)
    angles = np.where(view.holds, view.angles[-1], view.angles[0])
    aim = _Aim(place, view.hands[-1], angles, ~passed & ~straight)
    return aim, has | passed, taken


def _bring(view: _View, has: Array) -> tuple[_Aim, Array, Array]:
    """Bring the cube to its target, and in a relay put it down; results as `_give`."""
    task, tcp, target = view.task, view.tcp, view.target
    swings = (math.distance(tcp, target) > _NEAR_END)[:, None]
    if not task.config.relay:
        aim = _Aim(target, view.quat, view.angles[-1], swings)
        return aim, has, np.zeros_like(has)
    near = math.distance(view.cube, target) < task.config.success_radius
    lies = ~view.holds & near[:, None]
    above = standoff(tcp - target, DOWN, **_ABOVE)
    place = target - np.where(lies, _AWAY, above) * DOWN
    is_there = (math.distance(tcp, target) < _PUT)[:, None]
    aim = _Aim(place, view.hands[-1], view.angles[-1], swings & ~lies)
    return aim, has | lies, lies | (has & is_there)
