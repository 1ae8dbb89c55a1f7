"""How Hockey's expert moves its arms: the mallets go where `hockey_player` wants them.

Hands follow the charts of their arms. A mallet that hits swings freely.
"""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import shortened
from collaborative_gym.objects.mallet import HEIGHT as MALLET_HEIGHT
from collaborative_gym.objects.rink import HEIGHT
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.experts.hockey_player import Field, play

if TYPE_CHECKING:
    from collaborative_gym.tasks.hockey import Hockey, HockeyFacts

HOVER = 0.015  # m, from the ice to a mallet at rest
AREA_MIDDLE = np.array([-0.29, 0.0])  # m, of what a mallet uses of its lane, and
AREA_SIZE = np.array([0.19, 0.27])  # m, how far that reaches to either end
_FIRMNESS = 0.5  # share of its way that a mallet goes at once
_SOFT = 1e-5  # m2, damping of a swing near singular poses
_STRIDE = 0.12  # m, longest way of a mallet that is planned at a time


def expert(self: "Hockey", sim: Sim, facts: "HockeyFacts") -> dict[str, Motion]:
    """Return motions that play both sides."""
    motions, sides = {}, self.sides
    half_width, half_goal = self.half_sizes
    field = Field(half_width, half_goal, self.config.restitution)
    for side, other in (sides, sides[::-1]):
        way = self.turns[side[0]]
        own, others = (
            np.stack([way * facts.mallet[a][0][:, :2] for a in each], axis=1)
            for each in (side, other)
        )
        puck = way * facts.puck, way * facts.puck_velocity
        lanes = np.array([self.lanes[agent] for agent in side])
        goals, hits = play(field, own, lanes, others, puck)
        for i, agent in enumerate(side):
            lane, angles = np.array([0.0, lanes[i]]), facts.joints[agent]
            low, high = AREA_MIDDLE - AREA_SIZE, AREA_MIDDLE + AREA_SIZE
            goal, here = np.clip(goals[:, i] - lane, low, high), own[:, i] - lane
            step = _FIRMNESS * shortened(goal - here, _STRIDE)
            share = (here + step - AREA_MIDDLE) / AREA_SIZE
            change = self.charts[agent].at(share) - angles
            rows = np.flatnonzero(hits[:, i])
            way_there = way * (goals[rows, i] - own[rows, i])
            change[rows] = _swing(self, agent, angles[rows], way_there)
            motions[agent] = Motion(change)
    return motions


def _swing(task: "Hockey", agent: str, angles: Array, way: Array) -> np.ndarray:
    """Return joint changes that swing a mallet as far along a way as a step allows.

    The mallet may tilt: an arm that keeps it upright is half as fast. The way (n, 2)
    is in the table's frame, in m.
    """
    arm = task.scene.arms[agent]
    postures = task.charts[agent].chains.of(np.zeros(len(way), int))
    rows, goal, there = np.arange(len(way)), np.zeros((len(way), 3)), angles.copy()
    goal[:, 2] = HEIGHT + HOVER
    for i in range(4):
        place, rotation, jacobian = postures.at(there, rows)
        lever = MALLET_HEIGHT * rotation[:, :, 2]
        turned = math.cross(jacobian[:, 3:].transpose(0, 2, 1), lever[:, None])
        moves = (jacobian[:, :3] + turned.transpose(0, 2, 1)) * arm.stride
        if i == 0:
            goal[:, :2] = (place + lever)[:, :2] + way
        square = moves @ moves.transpose(0, 2, 1) + _SOFT * np.eye(3)
        error = (goal - place - lever)[..., None]
        share = (moves.transpose(0, 2, 1) @ np.linalg.solve(square, error))[..., 0]
        if i == 0:
            # No farther than the slowest joint comes in a step.
            most = np.maximum(np.abs(share).max(axis=1), 1.0)[:, None]
            goal[:, :2] += (1.0 / most - 1.0) * way
            share = share / most
        there = there + arm.stride * share
    return there - angles
