"""A policy whose actions come late."""

from collections.abc import Mapping

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.math import Array
from collaborative_gym.policies.policy import Policy


class DelayedPolicy:
    """Does each of a policy's actions one control step late, and holds still at first.

    Args:
      policy: what decides.
      env: what it plays, from an episode's first step on.
    """

    def __init__(self, policy: Policy, env: VectorEnv):
        self._policy = policy
        self._env = env
        self._previous: Mapping[str, Array] = env.idle()

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, Array]:
        """Return by agent what the policy decided one control step earlier."""
        is_first, idle = (self._env.progress["step"] == 0)[:, None], self._env.idle()
        late = {a: np.where(is_first, idle[a], self._previous[a]) for a in idle}
        self._previous = self._policy(observations)
        return late
