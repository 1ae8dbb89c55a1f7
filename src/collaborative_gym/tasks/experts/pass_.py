"""How Pass's expert plays, and how it hands over elsewhere in its styles."""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import reach, settling, standoff
from collaborative_gym.sim.sim import Sim

if TYPE_CHECKING:
    from collaborative_gym.tasks.pass_ import Pass, PassFacts

DOWN, ACROSS = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])

PICKING = np.array([0.0, 0.5**0.5, 0.5**0.5, 0.0])
"""Orientation (w x y z) of a hand that picks from above."""

_CLOSE = 0.8  # share of the greatest distance of a grip at which a hand grips
# How a hand comes before the cube, in m. One that takes it 6 mm aside passes the
# giver's fingers by less than 1 mm.
_ABOVE = {"slack": 0.01, "least": 0.0, "most": 0.06}
_ASIDE = {"slack": 0.002, "least": 0.0, "most": 0.1}
# A hand that goes back by more does not grip: with late actions, it would let go of the
# cube as it gets it.
_BACK = 0.01  # m
_ARRIVED = 0.05  # m from the meeting at which robot_2 follows the cube
_NEAR_MEETING = 0.3  # m
BEYOND = 0.05  # m from the meeting across, from which on robot_2 picks up the cube
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


def _hand_over(
    task: "Pass", sim: Sim, facts: "PassFacts", shift: np.ndarray
) -> dict[str, Motion]:
    """Return motions for a hand-over so far from the usual meeting."""
    meeting = task.meeting + shift
    return {
        "robot_1": _give(task, sim, facts, meeting),
        "robot_2": _take(task, sim, facts, meeting),
    }


def _give(task: "Pass", sim: Sim, facts: "PassFacts", meeting: np.ndarray) -> Motion:
    """Return robot_1's motion: pick from above, bring to the meeting, let go."""
    giver, taker = task.agents
    position, place = facts.tcp[giver][0], facts.cube[0]
    holds = facts.holds[giver][:, None]
    taken = facts.holds[taker][:, None] | _is_beyond(task, facts)
    above = standoff(position - place, DOWN, **_ABOVE)
    gap = np.where(holds, 0.1, above)
    lifted = position[:, 2:] > task.cube_start[2] + 0.03
    # Elsewhere it goes straight, once it is near the posture of the usual meeting.
    is_usual = (meeting == task.meeting).all()
    near = math.distance(place, task.meeting) < _NEAR_MEETING
    straight = holds & lifted & ~is_usual & near[:, None]
    goal = np.where(straight, meeting, place - gap * DOWN)
    goal = np.where(taken, meeting - 0.15 * ACROSS, goal)
    hand = np.where(taken | straight, task.hands[giver][1], task.hands[giver][0])
    angles = np.where(holds, task.angles[giver][1], task.angles[giver][0])
    swings = holds & lifted & ~taken & ~straight
    change = _move(task, sim, facts, giver, (goal, hand), angles, swings)
    draws_back = (above - _BACK)[:, 0] > math.dot(place - position, DOWN)
    grips = _grips(facts, giver, task.config.picking_threshold, ~draws_back)
    return Motion(change, grips & ~facts.holds[taker])


def _take(task: "Pass", sim: Sim, facts: "PassFacts", meeting: np.ndarray) -> Motion:
    """Return robot_2's motion: wait at the meeting, grip, carry to the target."""
    giver, taker = task.agents
    (position, quat), holds = facts.tcp[taker], facts.holds[taker][:, None]
    cube, (_, before, end) = facts.cube[0], task.angles[taker]
    is_there = math.distance(cube, meeting) < _ARRIVED
    offered = (facts.holds[giver] & is_there)[:, None]
    gap = standoff(position - cube, -ACROSS, **_ASIDE)
    carries = holds & (math.distance(position, facts.tcp[giver][0]) > 0.08)[:, None]
    goal = np.where(offered, cube, meeting) + np.where(holds, 0.15, gap) * ACROSS
    goal = np.where(carries, facts.target, goal)
    picks = ~holds & _is_beyond(task, facts)
    above = standoff(position - cube, DOWN, **_ABOVE)
    goal = np.where(picks, cube - above * DOWN, goal)
    hand = np.where(picks, PICKING, task.hands[taker][1])
    hand = np.where(carries, quat, hand)
    angles = np.where(carries, end, before)
    swings = carries & (math.distance(position, facts.target) > 0.3)[:, None]
    change = _move(task, sim, facts, taker, (goal, hand), angles, swings)
    return Motion(change, _grips(facts, taker, task.config.handover_threshold, True))


def _is_beyond(task: "Pass", facts: "PassFacts") -> np.ndarray:
    """Return where robot_1 has lost the cube on robot_2's side, (num_envs, 1)."""
    across = math.dot(facts.cube[0] - task.meeting, ACROSS)
    return ((across > BEYOND) & ~facts.holds[task.agents[0]])[:, None]


def _move(
    task: "Pass",
    sim: Sim,
    facts: "PassFacts",
    agent: str,
    goal: tuple[Array, Array],
    angles: Array,
    swings: Array,
) -> np.ndarray:
    """Return joint changes straight to a pose, or to the angles where `swings`."""
    arm = task.scene.arms[agent]
    straight = reach(sim, arm, tcp=facts.tcp[agent], goal=goal, posture=angles)
    swing = settling(sim, arm, change=angles - facts.joints[agent])
    return np.where(swings, swing, straight)


def _grips(
    facts: "PassFacts", agent: str, threshold: float, comes: Array | bool
) -> Array:
    """Return where a hand holds the cube, or comes close enough to grip it."""
    near = facts.to_cube[agent] < _CLOSE * threshold
    return facts.holds[agent] | (near & comes)
