"""What training runs show on the terminal while they learn."""

import math
import time
from collections.abc import Mapping
from typing import Self

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

_WIDTH = 100
"""Most columns of the panel."""

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
"""What each number is called on the terminal, and how it is written there.

`kl` is the divergence of the last epoch, `std` that of the actions. PPO tells the KL
divergence and the entropy's loss, with the price of actions; SAC tells the entropy's
weight.
"""

_RESULTS = ("return", "completion", "performance")


class _Screen:
    """What shows progress while the context lasts, on a terminal or by lines."""

    def __init__(self, console: Console | None):
        self._console = Console(stderr=True) if console is None else console
        # A dumb terminal, as within an editor, cannot go back up to draw anew.
        self._is_live = self._console.is_terminal and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False)
        self._next_line = -math.inf

    def __enter__(self) -> Self:
        if self._is_live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_live:
            self._live.stop()
        else:
            self._print_last()

    def _print(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        self._next_line = time.monotonic() + _LINE_INTERVAL

    def _print_last(self) -> None:
        raise NotImplementedError


class Display(_Screen):
    """Shows how far a run is and how well it does, while the context lasts.

    On a terminal it is a panel that is drawn anew with each row; elsewhere it is a
    plain line at most every 30 s, at each validation and at the end.

    Args:
      title: heads the panel.
      total_steps: environment steps of the whole run.
      console: where to show it; None for standard error.
    """

    def __init__(self, title: str, total_steps: int, console: Console | None = None):
        super().__init__(console)
        self._title = title
        self._total_steps = total_steps
        self._known: dict[str, float] = {}
        self._first: Mapping[str, float] | None = None
        self._unprinted: Mapping[str, float] | None = None

    def show(
        self, row: Mapping[str, float], best: Mapping[str, float] | None = None
    ) -> None:
        """Show an iteration's row; what it lacks stays as earlier rows had it.

        Args:
          row: as `monitor.summarize` gives it.
          best: the row with the best validation so far, if there is one.
        """
        self._known |= row
        self._first = self._first or dict(row)
        if self._is_live:
            self._live.update(self._panel(best or {}), refresh=True)
            return
        self._unprinted = row
        is_validated = any(name.startswith("validation/") for name in row)
        if is_validated or time.monotonic() >= self._next_line:
            self._print_line(row)

    def _print_last(self) -> None:
        if self._unprinted is not None:
            self._print_line(self._unprinted)

    def _print_line(self, row: Mapping[str, float]) -> None:
        cells = [self._title, *self._pace()]
        for where, known in (("", self._known), ("validation/", row)):
            for name in self._measures():
                if where + name in known:
                    told = format_result(known, where + name)
                    cells.append(f"{where}{name} {told}".replace("/", " "))
        self._print(", ".join(cells))
        self._unprinted = None

    def _panel(self, best: Mapping[str, float]) -> Panel:
        width = min(self._console.width, _WIDTH)
        progress = Table.grid(expand=True)
        progress.add_row(ProgressBar(self._total_steps, self._known["steps"]))
        progress.add_row(", ".join(self._pace()))
        blocks = (Group(self._results(best), "", self._learners()), self._rewards())
        gap, frame = 4, 4
        needed = sum(self._console.measure(block).maximum for block in blocks) + gap
        if needed <= width - frame:
            body = Table.grid(padding=(0, gap))
            body.add_row(*blocks)
        else:
            body = Group(blocks[0], "", blocks[1])
        return Panel(
            Group(progress, "", body),
            title=Text(self._title),
            title_align="left",
            box=box.ROUNDED,
            width=width,
        )

    def _pace(self) -> list[str]:
        """Return steps, steps per second and the time left, or taken in the end."""
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
        assert self._first is not None, "a row is known"
        seconds = known["seconds"] - self._first["seconds"]
        if seconds > 0:
            rate = (steps - self._first["steps"]) / seconds
        return (
            [*words, f"{format_duration((total - steps) / rate)} left"]
            if rate > 0
            else words
        )

    def _measures(self) -> list[str]:
        """Return the columns of what the robots reach, side by side."""
        names = [f"{side}{name}" for side in sides_of(self._known) for name in _RESULTS]
        return [*names, "points"] if "validation/points" in self._known else names

    def _results(self, best: Mapping[str, float]) -> Table:
        """Return how well the robots do, all together."""
        table = _table("", "training", "validation", "best")
        for name in self._measures():
            table.add_row(
                name.replace("/", " "),
                format_result(self._known, name),
                format_result(self._known, f"validation/{name}"),
                format_result(best, f"validation/{name}"),
            )
        return table

    def _rewards(self) -> Table:
        """Return each robot's return and what it is made of."""
        robots = robots_of(self._known)
        terms = dict.fromkeys(
            term
            for robot, _, term in (name.rpartition("/") for name in self._known)
            if robot in robots and term not in UPDATE
        )
        table = _table("reward" if robots else "", *robots)
        for term in terms:
            columns = [f"{robot}/{term}" for robot in robots]
            table.add_row(
                term, *(format_result(self._known, name, absent="") for name in columns)
            )
        return table

    def _learners(self) -> Table:
        """Return what the last update did, by learner."""
        end = "/learning_rate"
        learners = [n.removesuffix(end) for n in self._known if n.endswith(end)]
        table = _table("update", *learners)
        for number, (label, digits) in UPDATE.items():
            values = [self._known.get(f"{name}/{number}") for name in learners]
            if any(value is not None for value in values):
                cells = (
                    "" if value is None else f"{value:{digits}}" for value in values
                )
                table.add_row(label, *cells)
        return table


class ManyDisplay(_Screen):
    """Shows how far each of several runs is, while the context lasts.

    On a terminal it is a table; elsewhere a line at most every 30 s and in the end.

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
        if self._is_live:
            self._live.update(self._runs(), refresh=True)
        elif time.monotonic() >= self._next_line:
            self._print_line()

    def _print_last(self) -> None:
        if any(self._known.values()):
            self._print_line()

    def _print_line(self) -> None:
        steps = {name: row.get("steps", 0.0) for name, row in self._known.items()}
        done = sum(steps[name] >= total for name, total in self._totals.items())
        under_way = sum(0 < steps[n] < total for n, total in self._totals.items())
        line = (
            f"{done} of {len(steps)} runs done, {under_way} begun,"
            f" {format_steps(sum(steps.values()))} of"
            f" {format_steps(sum(self._totals.values()))} steps"
        )
        self._print(line)

    def _runs(self) -> Table:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        table.add_column("run", no_wrap=True)
        heads = "steps", "return", "completion", "validated", "left"
        for head in heads:
            table.add_column(head, justify="right", no_wrap=True)
        # Runs under way stand above those that wait, so that they are on the screen.
        for name, row in sorted(self._known.items(), key=lambda each: not each[1]):
            cells = [
                format_result(row, column)
                for column in ("return", "completion", "validation/completion")
            ]
            table.add_row(name, self._share(name, row), *cells, self._left(name, row))
        return table

    def _share(self, name: str, row: Mapping[str, float]) -> str:
        return f"{min(1.0, row.get('steps', 0.0) / self._totals[name]):.0%}"

    def _left(self, name: str, row: Mapping[str, float]) -> str:
        left = self._totals[name] - row.get("steps", 0.0)
        rate = row.get("steps_per_second", 0.0)
        if left <= 0:
            return "-"
        return format_duration(left / rate) if rate > 0 else "waits"


def _table(*columns: str) -> Table:
    """Return an empty table, text in its first column and numbers in the others."""
    table = Table(box=None, pad_edge=False, padding=(0, 1), header_style="bold")
    for i, name in enumerate(columns):
        justify = "right" if i else "left"
        table.add_column(name, justify=justify, no_wrap=True, min_width=6)
    return table


def format_result(row: Mapping[str, float], column: str, absent: str = "-") -> str:
    """Return a return, a reward term or a share as one reads it."""
    value = row.get(column)
    if value is None:
        return absent
    if column.rpartition("/")[2] in ("completion", "performance", "points"):
        return f"{100 * value:.0f} %"
    return f"{value:,.1f}" if abs(value) < 1e5 else f"{value:.3g}"


def format_steps(steps: float) -> str:
    """Return a number of steps as one reads it, such as "1.50 M"."""
    return f"{steps / 1e6:.2f} M" if steps >= 1e5 else f"{steps:,.0f}"


def format_duration(seconds: float) -> str:
    """Return a time as one reads it, such as "1 min 30 s"."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {seconds:02} s" if minutes else f"{seconds} s"
