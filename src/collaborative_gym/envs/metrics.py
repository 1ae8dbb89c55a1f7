"""Measures of the worlds' episodes so far, computed when somebody asks."""

from collections.abc import Iterator, Mapping
from typing import Any

from collaborative_gym.envs import strain
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.tasks.task import Task
from collaborative_gym.timing import CONTROL_DT

OF_SIDES = ("return", "completion", "performance", "at_goal", "time_to_success")
OF_SIDES += ("score",)
"""Metrics of a side; a single side has no score."""


class Metrics(Mapping[str, Any]):
    """The metrics after one control step, by name, as `VectorEnv` describes them.

    Those of most steps are never read, so each is worked out when it is asked for.

    Args:
      task: what is done.
      sides: the agents of each side, by its name.
      sums: the rows with the sums of reward terms, by agent and term.
      rows: those of `Progress`, which nobody writes to.
    """

    def __init__(
        self,
        task: Task,
        sides: Mapping[str, tuple[str, ...]],
        sums: Mapping[str, Mapping[str, str]],
        rows: Mapping[str, Array],
    ):
        self._from_start, self._kept = task.performance_from_start, task.coordination
        self._sides, self._sums, self._rows = sides, sums, rows
        self._names = OF_SIDES[: 6 if len(sides) > 1 else 5]
        self._names += "returns", "reward_terms", "length", "episode", "seed"
        self._names += ("coordination",) * bool(self._kept)
        if strain.BLANK.keys() <= rows.keys():
            self._names += ("strain",)
        self._found: dict[str, Any] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._found:
            self._found[name] = self._find(name)
        return self._found[name]

    def __repr__(self) -> str:
        return repr(dict(self))

    def _find(self, name: str) -> Any:
        rows, sums = self._rows, self._sums.items()
        if name in OF_SIDES:
            by_side = {side: self._of_side(name, side) for side in self._sides}
            return by_side if len(by_side) > 1 else by_side.popitem()[1]
        if name == "returns":
            return {a: sum(rows[row] for row in own.values()) for a, own in sums}
        if name == "strain":
            return strain.measured(rows)
        xp = array_namespace(rows["length"])
        if name == "coordination":
            first = rows["side_1: first_success"]
            steps = xp.maximum(xp.where(first < 0, rows["length"], first), 1)
            return {
                own: rows[f"coordination: {own}"] / (steps if kept == "mean" else 1)
                for own, kept in self._kept.items()
            }
        if name == "reward_terms":
            return {
                agent: {term: xp.asarray(rows[row], copy=True) for term, row in own}
                for agent, own in ((agent, own.items()) for agent, own in sums)
            }
        return xp.asarray(rows[name], copy=True)

    def _of_side(self, name: str, side: str) -> Any:
        if name == "return":
            return sum(self["returns"][agent] for agent in self._sides[side])
        rows, xp = self._rows, array_namespace(self._rows["length"])
        # An episode whose physics has diverged counts as lost.
        counts, first = ~rows["diverged"], rows[f"{side}: first_success"]
        if name == "score":
            return xp.where(counts, rows[f"{side}: score"], 0.0)
        if name == "completion":
            return xp.where((first >= 0) & counts, 1.0, 0.0)
        if name == "time_to_success":
            return xp.where((first >= 0) & counts, first * CONTROL_DT, xp.nan)
        steps = rows["length"]
        if name == "at_goal":
            share = rows[f"{side}: goal_steps"] / xp.maximum(steps, 1)
            return xp.where(counts, share, 0.0)
        if not self._from_start:
            steps = steps - xp.maximum(first, 1) + 1
        share = rows[f"{side}: performing_steps"] / xp.maximum(steps, 1)
        return xp.where(counts, share, 0.0)
