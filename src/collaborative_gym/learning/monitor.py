"""The files that a training run writes into its folder while it learns."""

import math
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np

from collaborative_gym.errors import how_to_install
from collaborative_gym.evaluation.report import Report
from collaborative_gym.files import SealedRows, naming, write_text
from collaborative_gym.learning.curve import draw_curve
from collaborative_gym.learning.folder import CURVE, PROGRESS
from collaborative_gym.learning.pool import Iteration

Row = dict[str, float]
"""The numbers of an iteration by column; `summarize` says which there are."""

_NOT_AVERAGED = {"episode", "seed", "time_to_success", "length", "diverged"}
"""Entries of an episode's row whose mean says nothing about learning."""

_REDRAW_INTERVAL = 20.0  # least time between two drawings of the curve, in s
_DRAWING_SHARE = 0.01  # most of the run's time that goes into drawing the curve


def summarize(
    steps: int,
    seconds: float,
    steps_per_second: float,
    iteration: Iteration,
    validation: Mapping[str, float] | None = None,
) -> Row:
    """Return the results of an iteration as one row of numbers.

    The columns are `steps`, `seconds` and `steps_per_second`; of the episodes that were
    played in full, `episodes` (how many) and the means of `return`, `completion` and
    `performance`, and by agent of `robot_1/return` and each reward term, such as
    `robot_1/distance`; by learner the numbers of the update, such as `team/kl`; and the
    means of a validation, such as `validation/return`. Where there are several sides,
    return, completion and performance are by side, as `side_1/return`, and so is
    `score`. What is not known, for example if no episode ended, is left out.

    Args:
      steps: environment steps done so far, over all worlds.
      seconds: the time they took.
      steps_per_second: of this iteration.
      iteration: results of the rollout and the update.
      validation: the means of a validation after the update, if there was one.
    """
    row: Row = {
        "steps": steps,
        "seconds": float(seconds),
        "steps_per_second": float(steps_per_second),
        "episodes": len(episodes := iteration.episodes),
    }
    # Of teams of several sizes, the smaller ones have no such agent.
    for name in dict.fromkeys(chain(*episodes)):
        if name not in _NOT_AVERAGED and not name.endswith("/time_to_success"):
            values = [float(each[name]) for each in episodes if name in each]
            row[name] = math.fsum(values) / len(values)
    for learner, update in iteration.updates.items():
        row |= {f"{learner}/{name}": float(value) for name, value in update.items()}
    for name, mean in (validation or {}).items():
        row[f"validation/{name}"] = mean
    return row


def means_of(report: Report) -> Row:
    """Return `return`, `completion`, `performance` and `score` of a report, by side."""
    row = {}
    for side, score in report.sides.items():
        own = f"{side}/" if len(report.sides) > 1 else ""
        row[f"{own}return"] = score.mean_reward.mean
        row[f"{own}completion"] = score.completion.mean
        row[f"{own}performance"] = score.performance.mean
        if score.score is not None:
            row[f"{own}score"] = score.score.mean
    return row


class Monitor:
    """Writes a run's progress into its folder.

    `progress.csv` has a line for each iteration, the TensorBoard events a scalar for
    each of its numbers, and `curve.png`, redrawn now and then, the learning curve.

    Args:
      folder: the run's; made if it is missing.
      title: heads the curve.
      rows: those of a run that goes on; later ones of its files are dropped.

    Attributes:
      rows: all rows so far, with plain numbers.

    Raises:
      ImportError: if the extra `train` is not installed.
      OSError: if the folder cannot be written to.
    """

    def __init__(self, folder: Path, title: str, rows: Sequence[Row] = ()):
        for name in ("matplotlib", "tensorboard"):
            if find_spec(name) is None:
                raise ImportError(
                    f"training needs {name}, which is not installed;"
                    f" {how_to_install('train')}"
                )
        # Takes seconds, and only a run needs it.
        from torch.utils.tensorboard.writer import SummaryWriter

        self.rows = [_plain(row) for row in rows]
        self._folder, self._title = Path(folder), title
        self._path = self._folder / PROGRESS
        self._rewrite()
        # Hides the events of a run that went further before it was resumed.
        purge_step = int(self.rows[-1]["steps"]) + 1 if self.rows else 0
        self._events = SummaryWriter(str(self._folder), purge_step=purge_step)
        self._next_drawing = -math.inf

    def log(self, row: Mapping[str, float]) -> None:
        """Append an iteration's row.

        Raises:
          OSError: if the disk is full or the folder is gone; names the file.
        """
        row = _plain(row)
        self.rows.append(row)
        if row.keys() <= set(self._lines.columns):
            with naming(self._path), self._path.open("a", encoding="utf-8") as file:
                file.write(self._line(row))
        else:
            self._rewrite()
        with naming(self._folder):  # TensorBoard's errors name no file.
            for name, value in row.items():
                if name != "steps":
                    self._events.add_scalar(name, value, int(row["steps"]))
            self._events.flush()
        if time.monotonic() >= self._next_drawing:
            self._draw()

    def close(self) -> None:
        """Draw the last curve and close the events."""
        try:
            self._draw()
        finally:
            with naming(self._folder):
                self._events.close()

    def _rewrite(self) -> None:
        """Write all rows anew, under a header that knows all columns."""
        columns: list[str] = []
        for row in self.rows:
            if not row.keys() <= set(columns):  # New ones stand as in their row.
                columns = list(dict.fromkeys([*row, *columns]))
        self._lines = SealedRows(columns)
        lines = [self._lines.header, *map(self._line, self.rows)]
        with naming(self._path):
            write_text(self._path, "".join(lines))

    def _line(self, row: Row) -> str:
        return self._lines.line({name: repr(value) for name, value in row.items()})

    def _draw(self) -> None:
        started = time.monotonic()
        draw_curve(self.rows, self._title, self._folder / CURVE)
        ended = time.monotonic()
        pause = max(_REDRAW_INTERVAL, (ended - started) / _DRAWING_SHARE)
        self._next_drawing = ended + pause


def _plain(row: Mapping[str, float]) -> Row:
    return {name: np.asarray(value).item() for name, value in row.items()}
