"""The starts of episodes, drawn for many worlds at a time."""

from collections.abc import Mapping

import numpy as np

from collaborative_gym.envs.world import World
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom


class Starts:
    """The start of an episode for each world, drawn before it is needed.

    A start depends on nothing but the seed and the index of its episode. So where one
    is missing, those that other worlds need next are drawn with it: many at once take
    hardly longer than one.

    Args:
      world: what is started.
      num_envs: how many worlds there are.
      num_threads: physics threads.

    Attributes:
      sim: worlds of their own, as many, in which the starts wait.
      observations: what the robots see at the starts, by agent, (num_envs, k).
    """

    def __init__(self, world: World, num_envs: int, num_threads: int):
        self._world = world
        self.sim, self._mode = world.batch(num_envs, num_threads)
        self.observations: dict[str, Array] = {}
        self._drawn = np.full((2, num_envs), -1)

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
        task, sim = self._world.task, self.sim
        self._drawn[:, env_ids] = -1
        sim.reset(env_ids)
        for name, array in task.remember(len(env_ids)).items():
            sim.memory[name] = sim.xp.asarray(sim.memory[name], copy=True)
            sim.memory[name][env_ids] = array
        task.reset(sim, env_ids, rng=EpisodeRandom(seeds, episodes))
        self._mode.start(env_ids)
        sim.forward(env_ids)
        self.observations = self._world.flat(task.measure(sim), sim.xp)
        self._drawn[:, env_ids] = seeds, episodes
