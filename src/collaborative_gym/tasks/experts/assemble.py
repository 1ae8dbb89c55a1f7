"""How Assemble's expert plays: each arm takes its part and brings it where it goes.

What it steers is the pose of the part, wherever the hand holds it.
"""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import reach, settling, standoff
from collaborative_gym.motion.solver import rotation_error
from collaborative_gym.objects.assembly import DEEP, HALF
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import LEVEL

if TYPE_CHECKING:
    from collaborative_gym.tasks.assemble import Assemble, AssembleFacts

HEIGHT = 0.64  # m of the tables
WAIT = 0.14  # m before its hole, where a part waits

_DOWN = np.array([0.0, 0.0, -1.0])
_ABOVE = {"slack": 0.012, "least": 0.0, "most": 0.08}
_CLOSE, _EVEN = 0.018, 0.2  # m and rad, of a hand from the knob, with which it grips
_LIFT = 0.1  # m above where it lay, to where a part is lifted straight up
_LIFTED = 0.08  # m, from where on it goes on
_FAR = 0.3  # m across the floor, from which on an arm swings instead of going straight
_READY, _STRAIGHT = 0.02, 0.08  # m and rad, of a block that a peg may go into
_BEFORE, _IN_LINE = 0.03, 0.008  # m beside its hole, where a part waits, and goes in
_STEP, _OUTSIDE = 0.02, 0.04  # m by which it goes in at a time, and away where it waits
_CLEAR = 0.008  # m before its hole, where it is brought in line
_MOVED, _TURNED = 0.015, 0.1  # m by which a block may be pushed away, and m for 1 rad
# Shares of their way: from where on a part goes all the way, and the peg is in.
_INSIDE, _SEATED = 0.2, 0.95


def expert(self: "Assemble", sim: Sim, facts: "AssembleFacts") -> dict[str, Motion]:
    """Return motions with which three arms assemble."""
    motions = {}
    for i, agent in enumerate(self.agents):
        arm, (tcp, quat) = self.scene.arms[agent], facts.tcp[agent]
        holds = facts.holds[agent][:, None]
        taking, closes = _take(facts, agent)
        bringing, lifts = _bring(self, facts, i)
        place, turn = (np.where(holds, bringing[k], taking[k]) for k in (0, 1))
        posture = self.angles[agent][np.where(holds & ~lifts, 1, 0)[:, 0]]
        far = math.norm((place - tcp) * LEVEL)[:, None] > _FAR
        # A posture would draw it off its goal, where millimetres count.
        joints = facts.joints[agent]
        straight = reach(sim, arm, tcp=(tcp, quat), goal=(place, turn), posture=joints)
        swing = settling(sim, arm, change=posture - joints)
        change = np.where(far & ~lifts, swing, straight)
        motions[agent] = Motion(change, facts.holds[agent] | closes)
    return motions


def _take(facts: "AssembleFacts", agent: str) -> tuple[tuple[Array, Array], Array]:
    """Take the part by its knob, from above.

    Returns the hand's pose, and where it closes, (num_envs,).
    """
    (tcp, quat), (knob, hand) = facts.tcp[agent], facts.knobs[agent]
    uneven = math.norm(rotation_error(quat, hand))
    gap = standoff(tcp - knob, _DOWN, **_ABOVE)
    gap = np.maximum(gap, np.clip(uneven - _EVEN, 0.0, _ABOVE["most"])[:, None])
    closes = (facts.to_knob[agent] < _CLOSE) & (uneven < _EVEN)
    return (knob - gap * _DOWN, hand), closes


def _bring(
    task: "Assemble", facts: "AssembleFacts", i: int
) -> tuple[tuple[Array, Array], Array]:
    """Lift the part; bring the block to the target, and the others into the block.

    Returns the hand's pose, and where the part is lifted, (num_envs, 1).
    """
    agent = task.agents[i]
    (tcp, quat), (part, turned) = facts.tcp[agent], facts.parts[agent]
    goal, straight = facts.goals[agent]
    if i > 0:
        block, straight = facts.parts[task.agents[0]]
        axis = np.eye(3)[i - 1] + 0.0 * block
        gap = _gap(task, facts, i)[:, None]
        goal = block + math.rotate(straight, gap * axis)
    away = math.norm((part - task.tables[agent][0]) * LEVEL)[:, None]
    lifts = (part[:, 2:] < HEIGHT + HALF + _LIFTED) & (away < _FAR)
    goal = np.where(lifts, part * LEVEL - (HEIGHT + HALF + _LIFT) * _DOWN, goal)
    straight = np.where(lifts, turned, straight)
    change = math.multiply(straight, math.conjugate(turned))
    hand = goal + math.rotate(change, tcp - part), math.multiply(change, quat)
    return hand, lifts


def _gap(task: "Assemble", facts: "AssembleFacts", i: int) -> Array:
    """Return how far from its end peg or pin should be, (num_envs,), in m."""
    block = task.agents[0]
    steady = (facts.to_goal[block] < _READY) & (facts.turn[block] < _STRAIGHT)
    is_ready = steady if i == 1 else facts.inside[:, 1] > _SEATED
    out, beside, inside = facts.out[:, i], facts.beside[:, i], facts.inside[:, i]
    before = is_ready & (facts.turn[task.agents[i]] < _STRAIGHT) & (beside < _BEFORE)
    # Whoever pushes the block away pushes no further.
    moved = facts.to_goal[block] + _TURNED * facts.turn[block]
    onwards = out - _STEP * np.clip(2.0 - moved / _MOVED, 0.0, 1.0)
    onwards = np.maximum(onwards, np.minimum(out, 0.0))
    outside = np.maximum(out, DEEP[i] + _CLEAR)
    corrects = np.where(beside < _IN_LINE, onwards, outside)
    gap = np.where(before, corrects, DEEP[i] + _OUTSIDE)
    return np.where(inside > _INSIDE, onwards, gap)
