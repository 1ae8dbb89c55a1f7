"""Step, return and first success of each world's episode."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.envs import strain
from collaborative_gym.envs.metrics import Metrics
from collaborative_gym.envs.world import World
from collaborative_gym.math import Array
from collaborative_gym.tasks.task import Terms, named_facts


class Progress:
    """Counters and sums of the worlds' episodes.

    World i plays every `num_envs`-th episode of its seed. Its index is NumPy's, because
    random numbers are; counters and sums are the backend's arrays.

    Attributes:
      rows: (num_envs,) arrays by name, part of a saved state, which are replaced and
        never written to: `seed` and index (`episode`) of the episode, its control steps
        (`step`; `length` counts only those that were played if starts are staggered),
        the sums, and how it ended (`terminated` or `truncated`, and `diverged`).
    """

    def __init__(self, world: World, xp: Any, *, num_envs: int, seed: int):
        self._task, self._xp, self._num_envs = world.task, xp, num_envs
        self._sides = sides = world.definition.sides
        self._is_divided = len(sides) > 1
        self._sums = {
            agent: {name: f"{agent}: {name}" for name in names}
            for agent, names in world.definition.reward_terms.items()
        }
        blank: dict[str, float] = {"step": 0, "length": 0}
        blank |= dict.fromkeys(("terminated", "truncated", "diverged"), False)
        for side in sides:
            blank |= {f"{side}: performing_steps": 0, f"{side}: first_success": -1}
            blank[f"{side}: goal_steps"] = 0
            if self._is_divided:
                blank[f"{side}: score"] = 0.0
            if world.task.success_for > 1:
                blank[f"{side}: met_steps"] = 0
        for names in self._sums.values():
            blank |= dict.fromkeys(names.values(), 0.0)
        blank |= {f"coordination: {name}": 0.0 for name in world.task.coordination}
        if world.has_strain:
            blank |= strain.BLANK
        kinds = {bool: xp.bool, int: xp.int64, float: xp.float64}
        self._blank, self.rows = blank, {}
        for name, value in blank.items():
            self.rows[name] = xp.full(num_envs, value, dtype=kinds[type(value)])
        for name in "seed", "episode":
            self.rows[name] = np.zeros(num_envs, np.int64)
        self.begin(seed, np.arange(num_envs), np.arange(num_envs))

    @property
    def has_ended(self) -> Array:
        """Whether each episode is at its end, (num_envs,)."""
        return self.rows["terminated"] | self.rows["truncated"]

    @property
    def next_step(self) -> Array:
        """The control step that each episode does next; the last one if it is over."""
        last = self._task.config.max_episode_steps - 1
        return self._xp.minimum(self.rows["step"], last)

    def where(self) -> dict[str, Array]:
        """Return copies of `seed`, `episode` and `step`."""
        return {name: self.rows[name] + 0 for name in ("seed", "episode", "step")}

    def begin(self, seed: int, episodes: np.ndarray, env_ids: np.ndarray) -> None:
        """Make these episodes of a seed the next ones of these worlds."""
        for name, value in ("seed", seed), ("episode", episodes - self._num_envs):
            self.rows[name] = self.rows[name].copy()
            self.rows[name][env_ids] = value

    def start(self, env_ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Go on to these worlds' next episodes; return their seeds and indices."""
        rows, starts = self.rows, np.zeros(self._num_envs, bool)
        starts[env_ids] = True
        rows["episode"] = rows["episode"] + self._num_envs * starts
        starts = self._xp.asarray(starts)
        for name, value in self._blank.items():
            rows[name] = self._xp.where(starts, value, rows[name])
        return rows["seed"][env_ids], rows["episode"][env_ids]

    def stagger(self, env_ids: np.ndarray) -> None:
        """Pretend that these worlds' episodes began at evenly spread times."""
        length = self._task.config.max_episode_steps
        times = env_ids * length // self._num_envs
        self.rows["step"][env_ids] = self._xp.asarray(times)

    def count(
        self, facts: Any, terms: Mapping[str, Terms], diverged: Array, resting: Array
    ) -> Any:
        """Bring all up to a control step; return where the goal is met.

        Nothing counts where worlds rest because their episode had ended before.
        """
        rows, task, xp = self.rows, self._task, self._xp
        moved = ~resting
        rows["diverged"] = rows["diverged"] | diverged
        counts = ~rows["diverged"]
        for name in "step", "length":
            rows[name] = rows[name] + moved
        for agent, names in self._sums.items():
            for name, row in names.items():
                rows[row] = rows[row] + terms[agent][name]
        if task.coordination:
            self._count_coordination(facts, counts & moved)
        met, performing = task.success(facts), task.performing(facts)
        performing = met if performing is None else performing
        points = task.score(facts) if self._is_divided else None
        successes = {}
        is_late = (rows["step"] > task.success_after) & counts
        for i, side in enumerate(self._sides):
            now = (met[i] if self._is_divided else met) & is_late
            successes[side] = now if task.success_for <= 1 else self._lasting(side, now)
            first = rows[f"{side}: first_success"]
            is_first = successes[side] & (first < 0)
            rows[f"{side}: first_success"] = xp.where(is_first, rows["length"], first)
            at_goal = rows[f"{side}: goal_steps"]
            rows[f"{side}: goal_steps"] = at_goal + (successes[side] & moved)
            now = performing[i] if self._is_divided else performing
            now = now & counts & moved
            if not task.performance_from_start:
                now &= rows[f"{side}: first_success"] >= 0
            performed = rows[f"{side}: performing_steps"]
            rows[f"{side}: performing_steps"] = performed + now
            if self._is_divided:
                gained = is_first if points is None else points[i]
                gained = xp.where(counts & moved, gained, 0)
                rows[f"{side}: score"] = rows[f"{side}: score"] + gained
        self._end(task.over(facts), counts & moved, diverged)
        return successes if self._is_divided else successes[side]

    def _end(self, over: Array | None, counts: Array, diverged: Array) -> None:
        rows = self.rows
        if over is not None:
            rows["terminated"] = rows["terminated"] | (over & counts)
        is_late = rows["step"] >= self._task.config.max_episode_steps
        is_late = (is_late | diverged) & ~rows["terminated"]
        rows["truncated"] = rows["truncated"] | is_late

    def _count_coordination(self, facts: Any, counts: Array) -> None:
        """Bring the coordination up to a control step, until the goal is first met."""
        rows, xp, facts = self.rows, self._xp, named_facts(facts)
        counts = counts & (rows["side_1: first_success"] < 0)
        for name, kept in self._task.coordination.items():
            row, now = f"coordination: {name}", xp.where(counts, facts[name], 0.0)
            before = rows[row]
            rows[row] = before + now if kept == "mean" else xp.maximum(before, now)

    def _lasting(self, side: str, met: Array) -> Array:
        name = f"{side}: met_steps"
        self.rows[name] = self._xp.where(met, self.rows[name] + 1, 0)
        return self.rows[name] >= self._task.success_for

    def endings(self, agents: tuple[str, ...]) -> tuple[dict[str, Array], ...]:
        """Return which episodes are terminated, and which truncated, by agent."""
        ends = self.rows["terminated"], self.rows["truncated"]
        return tuple({agent: end | False for agent in agents} for end in ends)

    def begun(self, facts: Any) -> tuple[Any, dict[str, Terms]]:
        """Return where the goal is met before any step, and reward terms of zero."""
        met, counts = self._task.success(facts), ~self.rows["diverged"]
        counts = counts & (self._task.success_for <= 1)
        if self._is_divided:
            met = {side: met[i] & counts for i, side in enumerate(self._sides)}
        else:
            met = met & counts
        zero = self._xp.zeros(self._num_envs, dtype=self._xp.float32)
        return met, {
            agent: {name: zero + 0 for name in names}
            for agent, names in self._sums.items()
        }

    def infos(
        self,
        success: Any,
        terms: Mapping[str, Terms],
        resting: Array,
        observations: Mapping[str, Array],
    ) -> dict[str, Any]:
        """Return the infos of a step, as `VectorEnv` describes them."""
        return {
            "episode": self.rows["episode"] + 0,
            "step": self.rows["step"] + 0,
            "success": success,
            "diverged": self.rows["diverged"] | False,
            "reward_terms": terms,
            "ended": self.has_ended,
            "resting": resting,
            "final_observation": observations,
            "metrics": Metrics(self._task, self._sides, self._sums, dict(self.rows)),
        }


def copied(arrays: Mapping[str, Array], xp: Any) -> dict[str, Array]:
    """Return copies of named arrays."""
    return {name: xp.asarray(array, copy=True) for name, array in arrays.items()}


def where(mask: Array, xp: Any) -> np.ndarray:
    """Return the worlds of a mask as NumPy's integers, which name worlds."""
    return np.array([int(i) for i in xp.nonzero(mask)[0]], dtype=np.int64)
