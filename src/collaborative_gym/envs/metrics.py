"""How the episodes of worlds went so far, worked out when somebody asks."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from collaborative_gym.envs import strain
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.tasks.task import Task
from collaborative_gym.timing import CONTROL_DT


class Metrics(Mapping[str, Any]):
    """The metrics after one control step, by name, as `VectorEnv` describes them.

    Those of most steps are never read, so each is worked out when it is asked for.

    Args:
      task: what is done.
      sides: the agents of each side, by its name.
      sums: the rows with the sums of reward terms, by agent and term.
      rows: counters and sums of the episodes by name, which nobody writes to.
    """

    def __init__(
        self,
        task: Task,
        sides: Mapping[str, tuple[str, ...]],
        sums: Mapping[str, Mapping[str, str]],
        rows: Mapping[str, Array],
    ):
        self._from_start = task.performance_from_start
        self._sides, self._sums, self._rows = sides, sums, rows
        self._xp = array_namespace(rows["length"])
        self._counts = ~rows["diverged"]
        of_sides: dict[str, Callable[[str], Array]] = {
            "return": self._return,
            "completion": self._completion,
            "performance": self._performance,
            "time_to_success": self._time_to_success,
        }
        if len(sides) > 1:
            of_sides["score"] = self._score
        self._makers: dict[str, Callable[[], Any]] = {
            name: partial(self._of_sides, make) for name, make in of_sides.items()
        }
        self._makers |= {"returns": self._returns, "reward_terms": self._terms}
        for name in ("length", "episode", "seed"):
            self._makers[name] = partial(self._copy, name)
        if strain.BLANK.keys() <= rows.keys():
            self._makers["strain"] = partial(strain.told, rows)
        self._found: dict[str, Any] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)

    def __getitem__(self, name: str) -> Any:
        if name not in self._found:
            self._found[name] = self._makers[name]()
        return self._found[name]

    def __repr__(self) -> str:
        return repr(dict(self))

    def _copy(self, row: str) -> Array:
        return self._xp.asarray(self._rows[row], copy=True)

    def _of_sides(self, make: Callable[[str], Array]) -> Any:
        by_side = {side: make(side) for side in self._sides}
        return by_side if len(by_side) > 1 else by_side.popitem()[1]

    def _terms(self) -> dict[str, dict[str, Array]]:
        return {
            agent: {term: self._copy(row) for term, row in rows.items()}
            for agent, rows in self._sums.items()
        }

    def _returns(self) -> dict[str, Any]:
        rows = self._rows
        return {
            agent: sum(rows[row] for row in own.values())
            for agent, own in self._sums.items()
        }

    def _return(self, side: str) -> Any:
        return sum(self["returns"][agent] for agent in self._sides[side])

    def _completed(self, side: str) -> Array:
        return (self._rows[f"{side}: first_success"] >= 0) & self._counts

    def _completion(self, side: str) -> Array:
        return self._xp.where(self._completed(side), 1.0, 0.0)

    def _performance(self, side: str) -> Array:
        rows, xp = self._rows, self._xp
        counted = rows["length"]
        if not self._from_start:
            counted = counted - xp.maximum(rows[f"{side}: first_success"], 1) + 1
        share = rows[f"{side}: performing_steps"] / xp.maximum(counted, 1)
        return xp.where(self._counts, share, 0.0)

    def _time_to_success(self, side: str) -> Array:
        time = self._rows[f"{side}: first_success"] * CONTROL_DT
        return self._xp.where(self._completed(side), time, self._xp.nan)

    def _score(self, side: str) -> Array:
        # Nobody wins an episode whose physics has diverged.
        return self._xp.where(self._counts, self._rows[f"{side}: score"], 0.0)
