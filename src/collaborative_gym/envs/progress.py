"""How far the episode of each world has come and what it has earned."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.tasks.task import Task, Terms
from collaborative_gym.timing import CONTROL_DT

_ZERO = {"step": 0, "length": 0, "performing_steps": 0, "first_success": -1}
"""Counters of an episode, at its start."""


class Progress:
    """Counters and sums of the worlds' episodes.

    World i plays every `num_envs`-th episode of its seed.

    Args:
      task: what is done.
      num_envs: how many worlds.
      seed: of the first episodes.
      reward_terms: names of a reward's parts, by agent.

    Attributes:
      rows: (num_envs,) arrays by name, part of a saved state: `seed` and index
        (`episode`) of the episode, its control steps (`step`; `length` counts only
        those that were played where starts are staggered), and the sums.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        seed: int,
        reward_terms: dict[str, tuple[str, ...]],
    ):
        self._task = task
        self._num_envs = num_envs
        self._reward_terms = reward_terms
        self._blank: dict[str, float] = dict(_ZERO)
        for agent, names in reward_terms.items():
            self._blank |= {_sum_name(agent, name): 0.0 for name in names}
        self.rows = {
            name: np.full(num_envs, value) for name, value in self._blank.items()
        }
        self.rows["seed"] = np.zeros(num_envs, np.int64)
        self.rows["episode"] = np.zeros(num_envs, np.int64)
        self.begin(seed, np.arange(num_envs))

    @property
    def step(self) -> np.ndarray:
        """Control steps that each episode has done, (num_envs,)."""
        return self.rows["step"]

    @property
    def is_over(self) -> np.ndarray:
        """Whether each episode has had all its control steps, (num_envs,)."""
        return self.rows["step"] >= self._task.config.max_episode_steps

    def place(self) -> dict[str, np.ndarray]:
        """Return copies of `seed`, `episode` and `step`."""
        return {name: self.rows[name].copy() for name in ("seed", "episode", "step")}

    def begin(self, seed: int, episodes: np.ndarray) -> None:
        """Let the next episodes be these of a seed, one for each world."""
        self.rows["seed"][:] = seed
        self.rows["episode"][:] = episodes - self._num_envs

    def start(self, env_ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Go on to these worlds' next episodes; return their seeds and indices."""
        self.rows["episode"][env_ids] += self._num_envs
        for name, value in self._blank.items():
            self.rows[name][env_ids] = value
        return self.rows["seed"][env_ids], self.rows["episode"][env_ids]

    def stagger(self) -> None:
        """Pretend that the worlds' episodes began at evenly spread times."""
        length = self._task.config.max_episode_steps
        self.rows["step"][:] = np.arange(self._num_envs) * length // self._num_envs

    def count(
        self, facts: Any, terms: Mapping[str, Terms], diverged: np.ndarray
    ) -> np.ndarray:
        """Bring all up to a control step; return where the goal is met."""
        rows, task = self.rows, self._task
        rows["step"] += 1
        rows["length"] += 1
        for agent, named in terms.items():
            for name, term in named.items():
                rows[_sum_name(agent, name)] += term
        late = rows["step"] > task.success_after
        success = np.asarray(task.success(facts)) & late & ~diverged
        is_first = success & (rows["first_success"] < 0)
        rows["first_success"][is_first] = rows["length"][is_first]
        performing = np.asarray(task.performing(facts)) & ~diverged
        if not task.performance_from_start:
            performing &= rows["first_success"] >= 0
        rows["performing_steps"] += performing
        return success

    def metrics(self, diverged: np.ndarray) -> dict[str, Any]:
        """Return the metrics of the episodes so far, as `VectorEnv` describes them."""
        rows = self.rows
        completion = (rows["first_success"] >= 0) & ~diverged
        counted = rows["length"].copy()
        if not self._task.performance_from_start:
            counted -= np.maximum(rows["first_success"], 1) - 1
        sums = {
            agent: {name: rows[_sum_name(agent, name)].copy() for name in names}
            for agent, names in self._reward_terms.items()
        }
        returns = {agent: sum(named.values()) for agent, named in sums.items()}
        performance = rows["performing_steps"] / np.maximum(counted, 1)
        time = np.where(completion, rows["first_success"] * CONTROL_DT, np.nan)
        return {
            "return": sum(returns.values()),
            "returns": returns,
            "completion": completion.astype(np.float64),
            "performance": np.where(diverged, 0.0, performance),
            "length": rows["length"].copy(),
            "time_to_success": time,
            "reward_terms": sums,
            "episode": rows["episode"].copy(),
            "seed": rows["seed"].copy(),
        }


def _sum_name(agent: str, term: str) -> str:
    return f"{agent}: {term}"
