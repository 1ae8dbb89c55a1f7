"""Penalties of training besides the task's reward, so that robots act gently."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.config import Hyperparameters

_FREE_DEPTH, _MOST_DEPTH = 1.0, 10.0
"""Depth in mm up to which contacts of things cost nothing, because they rest so deep on
what holds them; and how much more of any contact is counted."""

_INNER = 0.9
"""Share of a joint's range, around its middle, in which a posture costs nothing."""


class Penalties:
    """Penalties of each robot for its acts, and of all robots for contacts.

    They are in no episode's return. Torque is measured as a control step ends; where
    that ended an episode, the next one's start costs nothing. Contacts are measured in
    every physics step, whoever is in them.

    A goal that counts only once it has been kept for a time, as BalancePath's, would
    cost the same whatever robots do until then. So a goal counts as met wherever a step
    counts towards performance, if that does not count from the start anyway; where that
    ended an episode, the next one's start counts.

    Args:
      env: the worlds, which measure strain if contacts are charged.
      hyperparameters: the penalties' weights.
    """

    def __init__(self, env: VectorEnv, hyperparameters: Hyperparameters):
        self._env, self._numbers = env, hyperparameters

    def charge(
        self, rewards: Mapping[str, np.ndarray], success: Any, share: float = 1.0
    ) -> dict[str, np.ndarray]:
        """Return rewards less the costs of the control step that was just done.

        Args:
          rewards: of the task, (num_envs,) by agent.
          success: where the goal was met, as in the worlds' infos.
          share: of the costs that is charged. That of joints is always charged whole:
            arms that come to the ends of their ranges while they learn stay there.
        """
        numbers, charged = self._numbers, dict(rewards)
        contact = numbers.contact_penalty
        deep = contact * self._depth() if share and contact else 0.0
        for agent in charged:
            if numbers.range_penalty:
                cost = numbers.range_penalty * self._ends(agent)
                charged[agent] = charged[agent] - cost
            if not share:
                continue
            if numbers.torque_penalty:
                cost = share * numbers.torque_penalty * self._torque(agent)
                charged[agent] = charged[agent] - cost
            if numbers.miss_penalty:
                missed = ~self._met(agent, success)
                charged[agent] = charged[agent] - share * numbers.miss_penalty * missed
            charged[agent] = charged[agent] - share * deep
        return charged

    def _met(self, agent: str, success: Any) -> np.ndarray:
        task, sides = self._env.task, self._env.sides
        own = next(side for side, agents in sides.items() if agent in agents)
        met = success if len(sides) == 1 else success[own]
        performing: Any = task.performing(self._env.facts)
        if task.performance_from_start or performing is None:
            return met
        if len(sides) > 1:
            performing = performing[list(sides).index(own)]
        return met | performing

    def _ends(self, agent: str) -> np.ndarray:
        """Return how near joints are to the ends of their ranges, from 0 to 1."""
        arm = self._env.scene.arms[agent]
        low, high = arm.joint_range
        middle = (low + high) / 2
        away = np.abs(self._env.sim.qpos[:, arm.qpos] - middle) / (high - middle)
        outer = np.maximum(away - _INNER, 0.0) / (1.0 - _INNER)
        return np.square(outer).mean(axis=1)

    def _depth(self) -> np.ndarray:
        """Return how deep the deepest contact was that costs something, in mm."""
        assert self._env.strain is not None
        free = {"objects": _FREE_DEPTH}
        depths = [
            1e3 * depth - free.get(kind, 0.0)
            for kind, depth in self._env.strain.depths.items()
        ]
        return np.clip(np.max(depths, axis=0), 0.0, _MOST_DEPTH)

    def _torque(self, agent: str) -> np.ndarray:
        """Return the cost of the torques that the drives ask for.

        Up to a motor's limit it is the mean square of its share. Beyond, where a servo
        may ask for many times what its motor has, it is the tangent, which still says
        in which direction torque falls, and does not dwarf the task.
        """
        limits = np.array(self._env.scene.arms[agent].robot.torque_limits)
        torque = self._env.action_mode.torques(self._env.sim, agent)
        asked = np.abs(torque) / limits
        within = np.minimum(asked, 1.0)
        return (within * (2.0 * asked - within)).mean(axis=1)
