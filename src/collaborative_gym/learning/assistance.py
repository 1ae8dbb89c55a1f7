"""Help while little succeeds, and demands once much succeeds."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.curve import sides_of

_EASE, _RISE = 0.01, 0.02
"""How much less is carried, and how much more is demanded, after a good rollout."""


class Assistance:
    """Makes a task easier until it succeeds, and then harder.

    At first it carries a share of the weight of all loose things. Chance does not lift
    a pot that needs all the strength of two arms. Robots learn with a lighter pot, and
    keep what they learned while its weight comes back. It does not carry what the task
    itself pushes by `disturb`.

    The demands of training beyond the task's reward (penalties, late actions, lost
    grips) begin at zero. A robot that pays for torque before it was ever paid for a
    lift never tries one.

    Attributes:
      share: of the weight, from 0 to 1.
      demand: share of the demands, from 0 to 1.
    """

    def __init__(self, share: float):
        self.share = share
        self.demand = 0.0
        self._is_given = share > 0.0

    def carry(self, env: VectorEnv) -> None:
        """Carry the share during the coming control step, in every world."""
        if self._is_given:
            bodies, weights = _loose(env.model)
            env.sim.xfrc_applied[:, bodies, 2] = self.share * weights

    def adapt(self, episodes: Sequence[Mapping[str, Any]]) -> None:
        """Carry less, and demand more, if at least half of these were completed.

        If there are several sides, it is enough that one of them completed it.
        """
        completed = [
            max(row.get(f"{side}completion", 0.0) for side in sides_of(row))
            for row in episodes
        ]
        if completed and np.mean(completed) >= 0.5:
            self.share = max(0.0, self.share - _EASE)
            self.demand = min(1.0, self.demand + _RISE)

    def state_dict(self) -> dict[str, float]:
        """Return what changes."""
        return {"share": self.share, "demand": self.demand}

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Go on from what `state_dict` returned."""
        self.share, self.demand = state["share"], state["demand"]


def _loose(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the bodies with a free joint, and their weights in N."""
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    bodies = model.jnt_bodyid[free]
    return bodies, model.body_mass[bodies] * -model.opt.gravity[2]
