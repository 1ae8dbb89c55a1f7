"""Lift's expert: arms grip, wait for one another and lift together.

If one arm loses its grip on the way, all let go and begin again.
"""

from functools import reduce
from operator import and_
from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import carry, shortened, standoff
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import LEVEL

if TYPE_CHECKING:
    from collaborative_gym.tasks.lift import Lift, LiftFacts

STYLES = {
    "first-leads": "robot_1 lifts, and the others only keep the pot level",
    "second-leads": "robot_2 lifts, and the others only keep the pot level",
}

START = np.array([0.0, 0.0, 0.7])
"""The pot's nominal place on the table, in m."""

_STEP = 0.067  # m from the pot to its goal; it moves by 0.4 of this in a control step
_CLOSE = 0.018  # m from the handle at which an arm grips
_GENTLE, _NEAR = 0.02, 0.008  # m, the same where a thing stays where it is taken


def expert(self: "Lift", sim: Sim, facts: "LiftFacts") -> dict[str, Motion]:
    """Return motions with which all arms lift alike."""
    return _lift(self, sim, facts, _lifted_handles(self, facts))


def styled(
    self: "Lift", sim: Sim, facts: "LiftFacts", *, style: str, draws: np.ndarray
) -> dict[str, Motion]:
    """Return motions with which all arms but one only keep the pot level."""
    leads = list(STYLES).index(style)
    place, straight = facts.handles[self.agents[leads]][0], _straightened(facts)
    across = (self.handles - self.handles[leads]) * LEVEL
    goals = _lifted_handles(self, facts)
    goals |= {
        agent: place + math.rotate(straight, across[i])
        for i, agent in enumerate(self.agents)
        if i != leads
    }
    return _lift(self, sim, facts, goals)


def _lift(
    task: "Lift", sim: Sim, facts: "LiftFacts", goals: dict[str, np.ndarray]
) -> dict[str, Motion]:
    """Return motions of arms that grip, and bring handles to these goals."""
    holds, motions, gentle = facts.gripping, {}, not task.scene.grasp.draws
    lifting = reduce(and_, holds.values())
    # A pot that an arm has lost tips over. If all let go of it, it lands upright.
    stands = facts.pot[0][:, 2] < START[2] + 0.03
    for i, (agent, arm) in enumerate(task.scene.arms.items()):
        handle, tcp = facts.handles[agent][0], facts.tcps[agent][0]
        way = task.ways[agent]
        height = task.target[2] - START[2]
        progress = (handle[:, 2] - START[2] - task.handles[i, 2]) / height
        gap = standoff(tcp - handle, way.approach, slack=0.004, least=0.0, most=0.1)
        # An arm that waits draws the pot to where others surely reach it.
        aside = (START + task.handles[i] - handle) * LEVEL
        drawn = handle + np.clip(aside, -0.02, 0.02)
        near = holds[agent] | (facts.to_handle[agent] < (_NEAR if gentle else _CLOSE))
        # A hand that moves on as it grips pushes the pot.
        stays, there = (near, tcp) if gentle else (holds[agent], drawn)
        goal = np.where(stays[:, None], there, handle - gap * way.approach)
        goal = np.where(lifting[:, None], goals[agent], goal)
        # The hand may turn about where it holds the handle.
        held = tcp + task.scene.hands.ways(sim)[:, i] * lifting[:, None]
        mass = np.where(lifting, task.pot_mass * task.weighing.shares[i], 0.0)
        posture, is_loaded = way.at(progress), mass > 0.0
        how = {"posture": posture, "is_loaded": is_loaded, "is_calm": gentle}
        change = carry(sim, arm, tcp=held, goal=goal, **how)
        motions[agent] = Motion(change, near & (lifting | stands), mass=mass)
    return motions


def _lifted_handles(task: "Lift", facts: "LiftFacts") -> dict[str, np.ndarray]:
    """Return where each handle goes next on the pot's way to the target."""
    middle = sum(facts.handles[agent][0] for agent in task.agents) / len(task.agents)
    missing = facts.target + task.handles[0] * (0.0, 0.0, 1.0) - middle
    step = _STEP if task.scene.grasp.draws else _GENTLE
    middle, straight = middle + shortened(missing, step), _straightened(facts)
    return {
        agent: middle + math.rotate(straight, place * LEVEL)
        for agent, place in zip(task.agents, task.handles, strict=True)
    }


def _straightened(facts: "LiftFacts") -> Array:
    """Return the turn of a nearly level pot about the vertical, but 0.1 rad less."""
    quat = facts.pot[1]
    yaw = 2.0 * np.arctan2(quat[:, 3].copy(), quat[:, 0].copy())
    return math.from_yaw(yaw - np.clip(yaw, -0.1, 0.1))
