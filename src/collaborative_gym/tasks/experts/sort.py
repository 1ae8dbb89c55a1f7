"""How Sort's expert plays: each arm takes what comes next, and brings it where it goes.

An arm that has nothing to take waits above its lane.
"""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.motion import reach, settling, standoff
from collaborative_gym.objects.belt import WALL
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.handing import of

if TYPE_CHECKING:
    from collaborative_gym.tasks.sort import Sort, SortFacts

HEIGHT = 0.64  # m of the belt above the floor
SIZE = 0.04  # m, of a cube
MIDDLE = 0.1  # m from the middle, within which a cube is in reach of either side

_DOWN = np.array([0.0, 0.0, -1.0])
_ABOVE = {"slack": 0.01, "least": 0.0, "most": 0.08}
_CLOSE = 0.8  # share of the greatest distance of a grip at which a hand grips
_BACK = 0.01  # m; a hand that goes back by more does not grip
_LEAD = 0.22  # s by which a hand that follows a moving cube would come late
_LIFT = 0.1  # m above where it was taken, from which on a cube is swung to its tote
_FAR = 0.3  # m across the floor, from which on an arm swings instead of going straight
_OVER = 0.06  # m from the middle of the tote, within which the hand opens
_LOW = 0.012  # m above the belt, from which the mate's cube is let go


def expert(self: "Sort", sim: Sim, facts: "SortFacts") -> dict[str, Motion]:
    """Return motions with which all arms sort."""
    return {agent: _sort(self, sim, facts, agent) for agent in self.agents}


def _sort(task: "Sort", sim: Sim, facts: "SortFacts", agent: str) -> Motion:
    """Return the motion of one arm."""
    arm, angles = task.scene.arms[agent], task.angles[agent]
    tcp, which = facts.tcp[agent][0], facts.own[agent]
    place, held = of(facts.cubes, which), of(facts.grips[agent], which)
    is_mates = np.array([c.mover == task.agents.index(agent) for c in task.cubes])[
        which
    ]
    takes = of(facts.near[agent], which) & ~held
    side = np.sign(task.placements[agent].position[1])
    # Take it from above, where it will be.
    ahead = place + np.array([_LEAD * task.config.belt_speed, 0.0, 0.0])
    gap = standoff(tcp - place, _DOWN, **_ABOVE)
    taking = ahead - gap * _DOWN
    backs = gap[:, 0] - _BACK > math.dot(ahead - tcp, _DOWN)
    # Bring the mate's cube to the middle, and put it down there.
    middle = np.abs(tcp[:, 1])
    low = HEIGHT + SIZE / 2 + np.where(middle > 0.05, 0.05, 0.0)
    seat = task.seats[task.agents.index(agent)]
    x = np.clip(tcp[:, 0], seat - 0.15, seat + 0.15)
    moving = np.stack([x, 0.0 * x - 0.02 * side, low], axis=1)
    puts = is_mates & (middle < 0.6 * MIDDLE) & (tcp[:, 2] < HEIGHT + SIZE / 2 + _LOW)
    # Swing its own over the tote, and let it fall.
    tote = task.totes[agent] + np.array([0.0, 0.0, WALL + 0.05])
    across = (tote - tcp) * [1.0, 1.0, 0.0]
    drops = ~is_mates & (math.norm(across) < _OVER)
    lifted = tcp[:, 2] > HEIGHT + _LIFT
    own = np.where(lifted[:, None], tote + np.zeros_like(tcp), tcp - 0.1 * _DOWN)
    goal = np.where(held[:, None], np.where(is_mates[:, None], moving, own), taking)
    # Where nothing comes, wait above the lane.
    idle = ~held & ~takes
    is_middle = np.abs(place[:, 1]) < MIDDLE
    posture = np.where(
        (is_middle & takes)[:, None] | (held & is_mates)[:, None], angles[1], angles[0]
    )
    posture = np.where((held & ~is_mates & lifted)[:, None], angles[2], posture)
    hand = np.where(
        (held & ~is_mates)[:, None], task.hands[agent][2], task.hands[agent][0]
    )
    hand = np.where((held & ~is_mates & ~lifted)[:, None], task.hands[agent][0], hand)
    away = math.norm((goal - tcp) * [1.0, 1.0, 0.0]) > _FAR
    swings = idle | (away & ~(held & is_mates) & (lifted | ~held))
    straight = reach(sim, arm, tcp=facts.tcp[agent], goal=(goal, hand), posture=posture)
    swing = settling(sim, arm, change=posture - facts.joints[agent])
    near = math.distance(tcp, place) < _CLOSE * task.config.picking_threshold
    grips = (held & ~(puts | drops)) | (takes & near & ~backs)
    return Motion(np.where(swings[:, None], swing, straight), grips)
