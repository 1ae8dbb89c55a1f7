"""The mass of the pot of two arms: too heavy for either, light enough for both.

`loads` searches for the postures in which an arm's torque limits carry most: for one
arm with the pot hanging from its handle anywhere in the success radius, and for both
along the way of their handles. The mass is the geometric mean of what the stronger arm
carries alone and what both carry together, so that both have the same share to spare.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from collaborative_gym.motion import loads
from collaborative_gym.objects.pot import GRIP_RADIUS
from collaborative_gym.robots import Robot
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import Placement

_LEAST_RATIOS = {2: 1.44}
"""What all carry, over what the best of all but one do, by the number of arms. So the
pot weighs 1.2 times what one of two arms carries, and two carry as much more."""

_LEAST_RATIO = 1.02
"""That of larger teams. Their bound is loose: no such team was found that lifts the pot
with an arm that only holds on, by `benchmarks/teams.py`."""

_ALIKE = 0.95  # ratio of loads above which no arm is the one that carries too much

LEAST_SHARE = 0.6
"""The pot weighs at least this share of what all carry."""

IN_MOTION = 0.75
"""Share of what a hand holds that it carries: in motion and beside other arms it must
hold more than the weight. Our choice, by `benchmarks/grasps.py`."""

_GREATEST_SHARE = 0.65  # greatest share of the pot's weight on one handle


@dataclass(frozen=True)
class Weighing:
    """Loads of arms. Tuples have an entry for each arm."""

    ways: tuple[loads.Way, ...]  # of their handles, with approaches in the world frame
    fewer: tuple[float, ...]  # kg that the others hold near the target without it
    together: float  # kg that all can hold all the way to the target
    shares: tuple[float, ...]  # of the pot's weight on each handle
    centre: tuple[float, float]  # x and y of the centre of mass in the pot, in m

    @property
    def pot_mass(self) -> float:
        """The mass in kg that needs all of the arms.

        Raises:
          ValueError: if all but one carry nearly as much as all.
        """
        most, count = max(self.fewer), len(self.ways)
        ratio = _LEAST_RATIOS.get(count, _LEAST_RATIO)
        if self.together < ratio * most:
            missing = f"robot_{self.fewer.index(most) + 1}"
            who = "all" if min(self.fewer) > _ALIKE * most else f"all but {missing}"
            raise ValueError(
                f"Lift's pot must need {'both' if count == 2 else f'all {count}'} arms:"
                f" together they must carry {ratio:.2f} times the {most:.1f} kg that"
                f" they carry without {missing}, but carry {self.together:.1f} kg;"
                f" mount {who} farther from the pot, take other arms, or pass pot_mass"
            )
        mass = max(np.sqrt(most * self.together), LEAST_SHARE * self.together)
        return float(mass)


def weigh(
    robots: Sequence[Robot],
    placements: Sequence[Placement],
    *,
    ends: Sequence[tuple[np.ndarray, np.ndarray]],
    target: np.ndarray,
    handles: np.ndarray,
    radius: float,
    grasps: Sequence[float],
) -> Weighing:
    """Return the loads of two arms, alone and together.

    Args:
      robots: the arms.
      placements: where they are mounted.
      ends: start and end (3,) of the way of each arm's handle, in the world frame.
      target: (3,) where the pot is to go.
      handles: from the pot's middle to where each arm holds it, (2, 3), in m.
      radius: distance of the pot to the target that counts as there, in m.
      grasps: what each hand bears, in N.
    """
    ways, alone = [], []
    grasps = [force / GRAVITY for force in grasps]
    for robot, place, line, held in zip(robots, placements, ends, grasps, strict=True):
        [middle] = loads.from_base(place, target[None])
        ways.append(loads.mounted_way(robot, place, line).at_most(IN_MOTION * held))
        lifted = loads.greatest_load(robot, _places(np.array(middle), radius))
        alone.append(min(lifted, held))
    first, second = (way.load for way in ways)
    # The contents lie nearer to the stronger arm, but still inside the pot.
    share = second / (first + second)
    share = min(max(share, 1 - _GREATEST_SHARE), _GREATEST_SHARE)
    together = min(first / (1 - share), second / share)
    shares = 1 - share, share
    balance = float(np.dot(shares, handles[:, 1]))
    # Without an arm, the other one carries alone.
    return Weighing(tuple(ways), tuple(alone[::-1]), together, shares, (0.0, balance))


def _places(target: np.ndarray, radius: float) -> loads.Positions:
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
    return loads.rounded(np.array(places))
