"""The starts of episodes, drawn for many worlds at a time."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from collaborative_gym.control import ActionMode
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Task


class Starts:
    """The start of an episode for each world, drawn before it is needed.

    A start depends on nothing but the seed and the index of its episode. So where one
    is missing, those that other worlds need next are drawn with it: many at once take
    hardly longer than one.

    Args:
      task: what is done.
      sim: worlds of their own, as many, in which the starts wait.
      mode: what actions mean there.
      observe: returns what the robots see of facts, by agent.

    Attributes:
      sim: as given.
      observations: what the robots see at the starts, by agent, (num_envs, k).
    """

    def __init__(
        self,
        task: Task,
        sim: Sim,
        mode: ActionMode,
        observe: Callable[[Any], dict[str, Array]],
    ):
        self._task, self.sim, self._mode, self._observe = task, sim, mode, observe
        self.observations: dict[str, Array] = {}
        self._drawn = np.full((2, sim.num_envs), -1)

    def prepare(self, env_ids: np.ndarray, progress: Mapping[str, Array]) -> None:
        """Let the starts of the episodes in which these worlds are be there.

        Args:
          env_ids: the worlds.
          progress: `seed` and `episode` of all.
        """
        count = self.sim.num_envs
        wanted = np.stack([progress["seed"], progress["episode"] + count])
        wanted[1, env_ids] -= count
        missing = (self._drawn != wanted).any(axis=0)
        if missing[env_ids].any():
            self._draw(np.flatnonzero(missing), *wanted[:, missing])

    def _draw(
        self, env_ids: np.ndarray, seeds: np.ndarray, episodes: np.ndarray
    ) -> None:
        task, sim = self._task, self.sim
        self._drawn[:, env_ids] = -1
        sim.reset(env_ids)
        fresh = task.remember(len(env_ids))
        sim.memory = sim.memory or task.remember(sim.num_envs)
        for name, array in fresh.items():
            sim.memory[name] = sim.xp.asarray(sim.memory[name], copy=True)
            sim.memory[name][env_ids] = array
        task.reset(sim, env_ids, rng=EpisodeRandom(seeds, episodes))
        self._mode.start(env_ids)
        sim.forward(env_ids)
        self.observations = self._observe(task.measure(sim))
        self._drawn[:, env_ids] = seeds, episodes
