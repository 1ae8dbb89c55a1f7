"""Help with heavy things while they are hard to lift."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.curve import sides_of

_EASE = 0.01
"""How much less is carried after a rollout that went well."""


class Assistance:
    """Carries a share of the weight of what moves freely, and less as more succeed.

    A pot that takes all the strength of two arms is not lifted by chance. What is
    learned on a lighter one carries over as its weight comes back. What a task itself
    pushes by `disturb` is not carried.

    Attributes:
      share: of the weight, from 0 to 1.
    """

    def __init__(self, share: float):
        self.share = share
        self._is_given = share > 0.0

    def carry(self, env: VectorEnv) -> None:
        """Carry the share during the coming control step, in every world."""
        if self._is_given:
            bodies, weights = _loose(env.model)
            env.sim.xfrc_applied[:, bodies, 2] = self.share * weights

    def adapt(self, episodes: Sequence[Mapping[str, Any]]) -> None:
        """Carry less from now on if at least half of these episodes were completed.

        Where there are several sides, it is enough that one of them did.
        """
        completed = [
            max(row.get(f"{side}completion", 0.0) for side in sides_of(row))
            for row in episodes
        ]
        if completed and np.mean(completed) >= 0.5:
            self.share = max(0.0, self.share - _EASE)


def _loose(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the bodies with a free joint, and their weights in N."""
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    bodies = model.jnt_bodyid[free]
    return bodies, model.body_mass[bodies] * -model.opt.gravity[2]
