"""Help while few episodes succeed, and demands once many do."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.curve import sides_of

_EASE, _RISE = 0.01, 0.02
"""Fall of the share, and rise of the demand, after a good rollout."""


class Assistance:
    """Makes a task easier until it succeeds, and then harder.

    At first the simulator carries a share of the weight of all loose things, because
    chance does not lift a pot that needs all the strength of two arms. It does not
    replace forces that a task sets in `disturb`.

    Penalties, late actions and lost grips begin at zero: a robot that pays for torque
    before it was ever rewarded for a lift never tries one.

    Attributes:
      share: of the weight, from 0 to 1.
      demand: share of the demands, from 0 to 1.
    """

    def __init__(self, share: float):
        self.share, self.demand = share, 0.0
        self._is_given = share > 0.0

    def lift(self, env: VectorEnv) -> None:
        """Carry the share during the coming control step, in every world."""
        if self._is_given:
            model = env.model
            loose = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
            weights = model.body_mass[loose] * -model.opt.gravity[2]
            env.sim.xfrc_applied[:, loose, 2] = self.share * weights

    def adapt(self, episodes: Sequence[Mapping[str, Any]]) -> None:
        """Carry less, and demand more, if half of these episodes were completed.

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
        """Return the state that changes."""
        return {"share": self.share, "demand": self.demand}

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Go on from what `state_dict` returned."""
        self.share, self.demand = state["share"], state["demand"]
