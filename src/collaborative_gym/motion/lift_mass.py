"""The mass of Lift's pot: too heavy for either arm, light enough for both.

`loads` searches for the postures in which an arm's torque limits carry most: for one
arm with the pot hanging from its handle anywhere in the success radius, and for both
along the way of their handles. The mass is the geometric mean of what the stronger arm
carries alone and what both carry together, so that both have the same share to spare.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from collaborative_gym import math
from collaborative_gym.motion.loads import Way, greatest_load, strongest_way
from collaborative_gym.objects.pot import GRIP_RADIUS
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Placement

_MARGIN = 1.2
"""The pot weighs at least so many times what one arm can carry, and two arms can carry
at least so many times the pot."""

_GREATEST_SHARE = 0.65  # greatest share of the pot's weight on one handle


@dataclass(frozen=True)
class Weighing:
    """What two arms carry. Tuples have an entry for each arm."""

    ways: tuple[Way, ...]  # of their handles, with approaches in the world frame
    alone: tuple[float, ...]  # kg that each could hold near the target without help
    together: float  # kg that both can hold all the way to the target
    shares: tuple[float, float]  # of the pot's weight on each handle

    @property
    def pot_mass(self) -> float:
        """The mass in kg that needs both arms.

        Raises:
          ValueError: if one arm carries nearly as much as both.
        """
        most = max(self.alone)
        if self.together < _MARGIN**2 * most:
            alone = " and ".join(f"{load:.1f}" for load in self.alone)
            raise ValueError(
                f"one of these arms carries too much of Lift's pot alone: {alone} kg"
                f" alone and {self.together:.1f} kg together, which must be"
                f" {_MARGIN**2:.2f} times what the stronger one carries alone; if one"
                " is stronger, mount it farther from the pot and the weaker one nearer,"
                " or pass pot_mass"
            )
        return float(np.sqrt(most * self.together))


def weigh(
    robots: Sequence[Robot],
    placements: Sequence[Placement],
    *,
    ends: Sequence[tuple[np.ndarray, np.ndarray]],
    target: np.ndarray,
    radius: float,
) -> Weighing:
    """Return what two arms carry, alone and together.

    Args:
      robots: the arms.
      placements: where they are mounted.
      ends: start and end (3,) of the way of each arm's handle, in the world frame.
      target: (3,) where the pot is to go.
      radius: distance of the pot to the target that counts as there, in m.
    """
    ways, alone = [], []
    for robot, placement, line in zip(robots, placements, ends, strict=True):
        back = math.from_yaw(np.array(-placement.yaw))
        points = np.array([*line, target]) - np.array(placement.position)
        # In the frame of the arm's base, to the micrometre.
        start, end, middle = math.rotate(back, points).round(6)
        way = strongest_way(robot, start=tuple(start.tolist()), end=tuple(end.tolist()))
        turn = math.from_yaw(np.array(placement.yaw))
        ways.append(replace(way, approach=math.rotate(turn, way.approach)))
        alone.append(greatest_load(robot, _places(middle, radius)))
    first, second = (way.load for way in ways)
    # The contents lie nearer to the stronger arm, but still inside the pot.
    share = second / (first + second)
    share = min(max(share, 1 - _GREATEST_SHARE), _GREATEST_SHARE)
    together = min(first / (1 - share), second / share)
    return Weighing(tuple(ways), tuple(alone), together, (1 - share, share))


def _places(
    target: np.ndarray, radius: float
) -> tuple[tuple[float, float, float], ...]:
    """Return where one arm, at the origin, would hold a pot that counts as lifted.

    The pot hangs from its handle, on the near side of the ball around the target.
    """
    flat = -target * (1.0, 1.0, 0.0)
    nearer = flat / np.maximum(np.linalg.norm(flat), 1e-9)
    up = np.array([0.0, 0.0, 1.0])
    places = [
        target + radius * (np.cos(a) * nearer + np.sin(a) * up) + GRIP_RADIUS * up
        for a in np.radians([-60.0, -30.0, 0.0, 30.0, 60.0])
    ]
    return tuple((x, y, z) for x, y, z in np.round(places, 6).tolist())
