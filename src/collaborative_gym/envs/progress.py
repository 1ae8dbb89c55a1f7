"""How far the episode of each world has come and what it has earned."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.tasks.task import Task, Terms
from collaborative_gym.timing import CONTROL_DT


class Progress:
    """Counters and sums of the worlds' episodes.

    World i plays every `num_envs`-th episode of its seed. Which episode that is, is
    NumPy's, because random numbers are; the counters and sums are the backend's arrays.

    Args:
      task: what is done.
      xp: array API namespace of the backend's arrays.
      num_envs: how many worlds.
      seed: of the first episodes.
      sides: the agents of each side, by its name.
      reward_terms: names of a reward's parts, by agent.

    Attributes:
      rows: (num_envs,) arrays by name, part of a saved state: `seed` and index
        (`episode`) of the episode, its control steps (`step`; `length` counts only
        those that were played where starts are staggered), and the sums.
    """

    def __init__(
        self,
        task: Task,
        xp: Any,
        *,
        num_envs: int,
        seed: int,
        sides: Mapping[str, tuple[str, ...]],
        reward_terms: Mapping[str, tuple[str, ...]],
    ):
        self._task = task
        self._xp = xp
        self._num_envs = num_envs
        self._sides = sides
        self._sums = {
            agent: {name: f"{agent}: {name}" for name in names}
            for agent, names in reward_terms.items()
        }
        blank: dict[str, float] = {"step": 0, "length": 0}
        for side in sides:
            blank |= {f"{side}: performing_steps": 0, f"{side}: first_success": -1}
        for names in self._sums.values():
            blank |= dict.fromkeys(names.values(), 0.0)
        self._blank = blank
        self.rows: dict[str, Array] = {
            name: xp.full(num_envs, value, dtype=_dtype(xp, value))
            for name, value in blank.items()
        }
        self.rows["seed"] = np.zeros(num_envs, np.int64)
        self.rows["episode"] = np.zeros(num_envs, np.int64)
        self.begin(seed, np.arange(num_envs))

    @property
    def step(self) -> Array:
        """Control steps that each episode has done, (num_envs,)."""
        return self.rows["step"]

    @property
    def is_timed_out(self) -> Array:
        """Whether each episode has had all its control steps, (num_envs,)."""
        return self.rows["step"] >= self._task.config.max_episode_steps

    def where(self) -> dict[str, Array]:
        """Return copies of `seed`, `episode` and `step`."""
        return {name: self.rows[name] + 0 for name in ("seed", "episode", "step")}

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
        times = self._xp.arange(self._num_envs) * length // self._num_envs
        self.rows["step"][:] = times

    def count(self, facts: Any, terms: Mapping[str, Terms], diverged: Array) -> Any:
        """Bring all up to a control step; return where the goal is met."""
        rows, task, xp = self.rows, self._task, self._xp
        rows["step"] += 1
        rows["length"] += 1
        for agent, names in self._sums.items():
            for name, row in names.items():
                rows[row] += terms[agent][name]
        counts = (rows["step"] > task.success_after) & ~diverged
        successes = self._by_side(task.success(facts))
        performing = self._by_side(task.performing(facts))
        for side in self._sides:
            successes[side] = successes[side] & counts
            first = rows[f"{side}: first_success"]
            is_first = successes[side] & (first < 0)
            rows[f"{side}: first_success"] = xp.where(is_first, rows["length"], first)
            now = performing[side] & ~diverged
            if not task.performance_from_start:
                now &= rows[f"{side}: first_success"] >= 0
            rows[f"{side}: performing_steps"] += now
        return _told(successes)

    def metrics(self, diverged: Array) -> dict[str, Any]:
        """Return the metrics of the episodes so far, as `VectorEnv` describes them."""
        rows, xp = self.rows, self._xp
        sums = {
            agent: {name: rows[row] + 0.0 for name, row in names.items()}
            for agent, names in self._sums.items()
        }
        returns = {agent: sum(named.values()) for agent, named in sums.items()}
        by_side: dict[str, dict[str, Array]] = {
            "return": {},
            "completion": {},
            "performance": {},
            "time_to_success": {},
        }
        for side, agents in self._sides.items():
            first = rows[f"{side}: first_success"]
            completed = (first >= 0) & ~diverged
            counted = rows["length"] + 0
            if not self._task.performance_from_start:
                counted -= xp.maximum(first, 1) - 1
            share = rows[f"{side}: performing_steps"] / xp.maximum(counted, 1)
            by_side["return"][side] = sum(returns[agent] for agent in agents)
            by_side["completion"][side] = xp.where(completed, 1.0, 0.0)
            by_side["performance"][side] = xp.where(diverged, 0.0, share)
            time = xp.where(completed, first * CONTROL_DT, xp.nan)
            by_side["time_to_success"][side] = time
        return {
            **{name: _told(values) for name, values in by_side.items()},
            "returns": returns,
            "length": rows["length"] + 0,
            "reward_terms": sums,
            "episode": rows["episode"] + 0,
            "seed": rows["seed"] + 0,
        }

    def met(self, success: Any) -> Any:
        """Return what a task's `success` gave, by side where there are several."""
        return _told(self._by_side(success))

    def _by_side(self, given: Any) -> dict[str, Array]:
        masks = given if len(self._sides) > 1 else (given,)
        return dict(zip(self._sides, masks, strict=True))


def _told(by_side: dict[str, Any]) -> Any:
    """Return what is told of the sides: by side only where there are several."""
    return by_side if len(by_side) > 1 else next(iter(by_side.values()))


def _dtype(xp: Any, value: float) -> Any:
    return xp.float64 if isinstance(value, float) else xp.int64
