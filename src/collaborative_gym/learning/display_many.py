"""What many runs show on the terminal while they learn: one table for all."""

import time
from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Console
from rich.live import Live
from rich.table import Table

from collaborative_gym.learning.display import (
    format_duration,
    format_result,
    format_steps,
)
from collaborative_gym.learning.many import Plan

_LINE_INTERVAL = 30.0
"""Least time between two lines where the output is no terminal, in s."""

_SHOWN = ("return", "completion", "validation/completion")


class ManyDisplay:
    """Shows how far each of several runs is, while the context lasts.

    On a terminal it is a table; elsewhere a line at most every 30 s and in the end.

    Args:
      plans: the runs.
      console: where to show it; None for standard error.
    """

    def __init__(self, plans: Sequence[Plan], console: Console | None = None):
        self._totals = {plan.folder.name: plan.total_steps for plan in plans}
        self._known: dict[str, dict[str, float]] = {name: {} for name in self._totals}
        self._console = Console(stderr=True) if console is None else console
        is_live = self._console.is_terminal and not self._console.is_dumb_terminal
        self._live = (
            Live(console=self._console, auto_refresh=False) if is_live else None
        )
        self._next_line = time.monotonic()

    def __enter__(self) -> "ManyDisplay":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
        elif any(self._known.values()):
            self._print_line()

    def show(
        self, plan: Plan, row: Mapping[str, float], best: Mapping[str, float]
    ) -> None:
        """Show a run's row; what it lacks stays as earlier rows had it."""
        self._known[plan.folder.name] |= row
        if self._live is not None:
            self._live.update(self._table(), refresh=True)
        elif time.monotonic() >= self._next_line:
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
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        self._next_line = time.monotonic() + _LINE_INTERVAL

    def _table(self) -> Table:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        table.add_column("run", no_wrap=True)
        heads = "steps", "return", "completion", "validated", "left"
        for head in heads:
            table.add_column(head, justify="right", no_wrap=True)
        # Runs under way stand above those that wait, so that they are on the screen.
        for name, row in sorted(self._known.items(), key=lambda each: not each[1]):
            cells = [format_result(row, column) for column in _SHOWN]
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
