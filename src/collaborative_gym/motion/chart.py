"""Joint angles for all places of a plane area, solved once and read off afterwards."""

from itertools import product

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym.math import Array
from collaborative_gym.motion.poses import central_pose
from collaborative_gym.motion.solver import Chains, descend, greatest
from collaborative_gym.scene import Arm

_PLACES = 9  # solved along each axis
_STEPS = 150
_NEAR = 3e-4  # m and rad within which a place counts as reached


class Chart:
    """Joint angles with which an arm's tcp is at places of an area, in one direction.

    They are near those of the area's middle and change evenly from place to place, so
    an arm that follows the chart never jumps to another posture.

    Args:
      model: the compiled world.
      arm: whose tcp.
      middle: of the area in the world frame, (3,), in m.
      along: edges of the area in the world frame, (2, 3): from its middle to the ends
        along its first and second axis, in m.
      approach: (3,) direction of the tcp's z axis.

    Raises:
      ValueError: if the arm cannot reach all of the area.

    Attributes:
      chains: the arm's kinematics.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        arm: Arm,
        *,
        middle: ArrayLike,
        along: ArrayLike,
        approach: Array,
    ):
        middle, along = np.asarray(middle, float), np.asarray(along, float)

        def places(*shares: ArrayLike) -> np.ndarray:
            return np.array(
                [middle + np.dot(at, along) for at in product(*map(np.asarray, shares))]
            )

        poses = [(place, approach) for place in places((-1, 1), (-1, 0, 1))]
        centre = central_pose(model, arm, poses=[(middle, approach), *poses])
        goals = places(*[np.linspace(-1.0, 1.0, _PLACES)] * 2)
        self.chains = chains = Chains(model, [arm])
        angles, missed = descend(
            chains.of(np.zeros(len(goals), int)),
            np.tile(centre, (len(goals), 1)),
            goal=(goals, np.tile(approach, (len(goals), 1))),
            steps=_STEPS,
            is_there=lambda error: greatest(error) < _NEAR,
            # This keeps the free motion near the middle's, and fades out.
            nullspace=lambda step, angle, *_: 0.03 * 0.97**step * (centre - angle),
        )
        misses = greatest(missed)
        if misses.max() > 10 * _NEAR:
            worst = np.round(goals[misses.argmax()], 2).tolist()
            raise ValueError(
                f"{arm.robot.name} cannot bring its tcp to {worst} as it is mounted;"
                " mount it elsewhere, or choose an arm that reaches or folds farther"
            )
        self._angles = angles.reshape(_PLACES, _PLACES, -1)

    def at(self, share: Array) -> np.ndarray:
        """Return the angles at places, (n, joints), in rad.

        Args:
          share: (n, 2) of the way from the middle to both axes' ends, at most 1.
        """
        place = (np.clip(share, -1.0, 1.0) + 1.0) / 2 * (_PLACES - 1)
        low = np.minimum(place.astype(int), _PLACES - 2)
        (x, y), (u, v) = low.T, (place - low).T[..., None]
        table = self._angles
        return (1 - u) * ((1 - v) * table[x, y] + v * table[x, y + 1]) + u * (
            (1 - v) * table[x + 1, y] + v * table[x + 1, y + 1]
        )
