"""The progress of training runs on the terminal."""

import math
import time
from collections.abc import Iterable, Mapping
from itertools import takewhile
from typing import Any, Self

from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from collaborative_gym.learning.curve import robots_of, sides_of

_LINE_INTERVAL = 30.0
"""Least time between two lines where the output is no terminal, in s."""

_WIDTH = 100  # most columns of the panel

UPDATE = {
    "kl": ("KL", ".4f"),
    "learning_rate": ("learning rate", ".1e"),
    "std": ("std", ".3f"),
    "policy_loss": ("policy loss", ".4f"),
    "value_loss": ("value loss", ".4f"),
    "entropy_loss": ("entropy loss", ".4f"),
    "entropy_weight": ("entropy weight", ".4f"),
    "weight_norm": ("weight norm", ".1f"),
}
"""The numbers of an update: how each is called on the terminal, and its format.

`kl` is the divergence of the last epoch, `std` that of the actions. PPO has the KL
divergence, and the entropy's loss with the penalty on actions; SAC has its weight.
"""


class _Screen:
    """Shows progress while the context lasts: a drawing on a terminal, else lines.

    A line comes at most every 30 s and at the end.
    """

    def __init__(self, console: Console | None):
        self._console = Console(stderr=True) if console is None else console
        # A dumb terminal, as within an editor, cannot go back up to draw anew.
        self._is_live = self._console.is_terminal and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False)
        self._next_line = -math.inf
        self._is_news = False

    def __enter__(self) -> Self:
        if self._is_live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_live:
            self._live.stop()
        elif self._is_news:
            self._print()

    def _show(self, drawing: Any, is_due: bool = False) -> None:
        self._is_news = True
        if self._is_live:
            self._live.update(drawing(), refresh=True)
        elif is_due or time.monotonic() >= self._next_line:
            self._print()

    def _print(self) -> None:
        line = self._line()
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        self._next_line = time.monotonic() + _LINE_INTERVAL
        self._is_news = False

    def _line(self) -> str:
        raise NotImplementedError


class Display(_Screen):
    """Shows the pace and the results of a run, while the context lasts.

    On a terminal it is a panel; elsewhere a line also comes at each validation.

    Args:
      title: heads the panel.
      total_steps: environment steps of the whole run.
      console: where to show it; None for standard error.
    """

    def __init__(self, title: str, total_steps: int, console: Console | None = None):
        super().__init__(console)
        self._title, self._total_steps = title, total_steps
        self._known: dict[str, float] = {}
        self._first: Mapping[str, float] = {}
        self._last: Mapping[str, float] = {}
        self._best: Mapping[str, float] = {}

    def show(
        self, row: Mapping[str, float], best: Mapping[str, float] | None = None
    ) -> None:
        """Show an iteration's row; what it lacks stays as earlier rows had it.

        Args:
          row: as `monitor.summarize` returns it.
          best: the row with the best validation so far, if there is one.
        """
        self._known |= row
        self._first = self._first or dict(row)
        self._last, self._best = row, best or {}
        self._show(self._panel, any(name.startswith("validation/") for name in row))

    def _line(self) -> str:
        cells = [self._title, *self._pace()]
        for where, known in (("", self._known), ("validation/", self._last)):
            for name in (f"{where}{each}" for each in self._measures()):
                if name in known:
                    words = name.replace("/", " ")
                    cells.append(f"{words} {format_result(known, name)}")
        return ", ".join(cells)

    def _panel(self) -> Panel:
        width = min(self._console.width, _WIDTH)
        progress = Table.grid(expand=True)
        progress.add_row(ProgressBar(self._total_steps, self._known["steps"]))
        progress.add_row(", ".join(self._pace()))
        blocks = Group(self._results(), "", self._learners()), self._rewards()
        gap, frame = 4, 4
        needed = sum(self._console.measure(block).maximum for block in blocks) + gap
        body = Group(blocks[0], "", blocks[1])
        if needed <= width - frame:
            body = Table.grid(padding=(0, gap))
            body.add_row(*blocks)
        whole, title = Group(progress, "", body), Text(self._title)
        return Panel(whole, box.ROUNDED, title=title, title_align="left", width=width)

    def _pace(self) -> list[str]:
        known, total = self._known, self._total_steps
        steps, rate = known["steps"], known["steps_per_second"]
        words = [
            # The last update may go past the total.
            f"{format_steps(steps)} of {format_steps(total)} steps"
            f" ({min(100.0, 100 * steps / total):.0f} %)",
            f"{rate:,.0f} steps/s",
        ]
        if steps >= total:
            return [*words, f"took {format_duration(known['seconds'])}"]
        # The latest rate jumps; the rate since the first row predicts better.
        seconds = known["seconds"] - self._first["seconds"]
        if seconds > 0:
            rate = (steps - self._first["steps"]) / seconds
        left = [f"{format_duration((total - steps) / rate)} left"] if rate > 0 else []
        return words + left

    def _measures(self) -> list[str]:
        measures = "return", "completion", "performance"
        names = [f"{side}{name}" for side in sides_of(self._known) for name in measures]
        return names + ["points"] * ("validation/points" in self._known)

    def _results(self) -> Table:
        lines = {
            name.replace("/", " "): [
                format_result(self._known, name),
                format_result(self._known, f"validation/{name}"),
                format_result(self._best, f"validation/{name}"),
            ]
            for name in self._measures()
        }
        return _table(["", "training", "validation", "best"], lines)

    def _rewards(self) -> Table:
        robots = robots_of(self._known)
        named = (name.rpartition("/") for name in self._known)
        terms = [term for robot, _, term in named if robot in robots]
        lines = {
            term: [format_result(self._known, f"{r}/{term}", "") for r in robots]
            for term in dict.fromkeys(terms)
            if term not in UPDATE
        }
        return _table(["reward" if robots else "", *robots], lines)

    def _learners(self) -> Table:
        end = "/learning_rate"
        learners = [n.removesuffix(end) for n in self._known if n.endswith(end)]
        lines = {}
        for number, (label, digits) in UPDATE.items():
            columns = [f"{name}/{number}" for name in learners]
            if any(column in self._known for column in columns):
                lines[label] = [
                    f"{self._known[column]:{digits}}" if column in self._known else ""
                    for column in columns
                ]
        return _table(["update", *learners], lines)


class ManyDisplay(_Screen):
    """Shows the progress of several runs in a table, while the context lasts.

    Args:
      totals: environment steps of each whole run, by its name.
      console: where to show it; None for standard error.
    """

    def __init__(self, totals: Mapping[str, int], console: Console | None = None):
        super().__init__(console)
        self._totals = totals
        self._known: dict[str, dict[str, float]] = {name: {} for name in totals}
        self._next_line = time.monotonic()

    def show(self, name: str, row: Mapping[str, float]) -> None:
        """Show a run's row; what it lacks stays as earlier rows had it."""
        self._known[name] |= row
        self._show(self._table)

    def _line(self) -> str:
        steps = {name: row.get("steps", 0.0) for name, row in self._known.items()}
        done = sum(steps[name] >= total for name, total in self._totals.items())
        under_way = sum(0 < steps[n] < total for n, total in self._totals.items())
        return (
            f"{done} of {len(steps)} runs done, {under_way} begun,"
            f" {format_steps(sum(steps.values()))} of"
            f" {format_steps(sum(self._totals.values()))} steps"
        )

    def _table(self) -> Table:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        # What all names begin with, such as the environment, would take the width.
        words = [name.split("-") for name in self._known]
        alike = takewhile(lambda each: len({*each}) == 1, zip(*words, strict=False))
        start = sum(len(word) + 1 for word, *_ in alike) if len(words) > 1 else 0
        table.add_column("run", no_wrap=True)
        for head in ("steps", "return", "completion", "validated", "left"):
            table.add_column(head, justify="right", no_wrap=True)
        columns = "return", "completion", "validation/completion"
        # Runs under way stand above those that wait, so that they are on the screen.
        for name, row in sorted(self._known.items(), key=lambda each: not each[1]):
            steps, total = row.get("steps", 0.0), self._totals[name]
            rate = row.get("steps_per_second", 0.0)
            left = format_duration((total - steps) / rate) if rate > 0 else "waits"
            table.add_row(
                name[start:],
                f"{min(1.0, steps / total):.0%}",
                *(format_result(row, column) for column in columns),
                left if steps < total else "-",
            )
        return table


def _table(heads: Iterable[str], lines: Mapping[str, Iterable[str]]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1), header_style="bold")
    for i, name in enumerate(heads):
        justify = "right" if i else "left"
        table.add_column(name, justify=justify, no_wrap=True, min_width=6)
    for label, cells in lines.items():
        table.add_row(label, *cells)
    return table


def format_result(row: Mapping[str, float], column: str, absent: str = "-") -> str:
    """Return a return, a reward term or a share for reading."""
    value = row.get(column)
    if value is None:
        return absent
    if column.rpartition("/")[2] in ("completion", "performance", "points"):
        return f"{100 * value:.0f} %"
    return f"{value:,.1f}" if abs(value) < 1e5 else f"{value:.3g}"


def format_steps(steps: float) -> str:
    """Return a number of steps for reading, such as "1.50 M"."""
    return f"{steps / 1e6:.2f} M" if steps >= 1e5 else f"{steps:,.0f}"


def format_duration(seconds: float) -> str:
    """Return a time for reading, such as "1 min 30 s"."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {seconds:02} s" if minutes else f"{seconds} s"
