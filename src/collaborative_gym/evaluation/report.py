"""What an evaluation found, as numbers, JSON, CSV and Markdown."""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

_RESAMPLES = 2000
"""Draws of the bootstrap; more would change an interval by less than a tenth."""


@dataclass(frozen=True)
class Statistic:
    """The mean over episodes and how sure it is.

    Attributes:
      mean: the mean; NaN if there was no value.
      low: lower end of the mean's 95 % bootstrap interval.
      high: upper end of it.
      iqm: interquartile mean, that of the middle half of the values.
    """

    mean: float
    low: float
    high: float
    iqm: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Statistic":
        """Return the statistic of some values, leaving out those that are NaN."""
        array = np.sort(np.asarray(values, float))
        array = array[~np.isnan(array)]
        if not len(array):
            return cls(math.nan, math.nan, math.nan, math.nan)
        # The same resamples every time, so that equal episodes give equal intervals.
        rng = np.random.default_rng(0)
        means = array[rng.integers(0, len(array), (_RESAMPLES, len(array)))].mean(
            axis=1
        )
        low, high = np.quantile(means, (0.025, 0.975))
        cut = len(array) // 4
        middle = array[cut : len(array) - cut]
        return cls(float(array.mean()), float(low), float(high), float(middle.mean()))


@dataclass(frozen=True)
class Score:
    """How one side did, over the episodes.

    Attributes:
      mean_reward: of the return, the sum over all steps and the side's agents.
      completion: of whether the goal was reached, 0 to 1.
      performance: of the share of steps at the goal, 0 to 1, as the task counts it.
      time_to_success: of the time until the goal was reached, over the episodes in
        which it was, in s.
    """

    mean_reward: Statistic
    completion: Statistic
    performance: Statistic
    time_to_success: Statistic


@dataclass(frozen=True)
class Report:
    """How a policy did.

    A row of `episodes` has `episode`, `seed`, `return`, `completion`, `performance`,
    `time_to_success` (s, NaN if never), `length` (control steps), `diverged`, and by
    agent `robot_1/return` and the sum of each reward term, such as
    `robot_1/distance`. Where the task has several sides, their names stand before what
    each has of its own, as in `side_1/return`; nothing is summed over opponents.

    Attributes:
      environment: the environment's id or the task's name.
      settings: what was evaluated: the environment's whole `identity`, the policy,
        episodes and seed.
      sides: how each side did, by its name; most tasks have one.
      returns: of each agent's own return, by agent.
      episodes: one row per episode, in order.
      steps_per_second: environment steps per second, with the policy's own time.
    """

    environment: str
    settings: dict[str, Any]
    sides: dict[str, Score]
    returns: dict[str, Statistic]
    episodes: tuple[dict[str, Any], ...]
    steps_per_second: float

    @property
    def mean_reward(self) -> Statistic:
        """That of the only side; of several, `sides` has one each."""
        return self._score.mean_reward

    @property
    def completion(self) -> Statistic:
        """That of the only side; of several, `sides` has one each."""
        return self._score.completion

    @property
    def performance(self) -> Statistic:
        """That of the only side; of several, `sides` has one each."""
        return self._score.performance

    @property
    def time_to_success(self) -> Statistic:
        """That of the only side; of several, `sides` has one each."""
        return self._score.time_to_success

    @property
    def _score(self) -> Score:
        if len(self.sides) != 1:
            raise ValueError(
                f"{self.environment} has the sides {', '.join(self.sides)}, each with a"
                " score of its own; see report.sides"
            )
        return next(iter(self.sides.values()))

    def summary(self) -> dict[str, Any]:
        """Return the statistics as plain dictionaries, an only side's at the top."""
        scores = {side: asdict(score) for side, score in self.sides.items()}
        own = next(iter(scores.values())) if len(scores) == 1 else {"sides": scores}
        returns = {agent: asdict(own) for agent, own in self.returns.items()}
        return {"settings": self.settings, **own, "returns": returns}

    def to_json(self) -> str:
        """Return everything as JSON, with null for NaN."""
        return reports_to_json([self])

    def to_csv(self) -> str:
        """Return the episodes as CSV, one row each, with an empty cell for NaN."""
        return reports_to_csv([self])

    def to_markdown(self) -> str:
        """Return the statistics as a Markdown table."""
        return reports_to_markdown([self])


def reports_to_json(reports: Sequence[Report]) -> str:
    """Return reports as one JSON object by environment, with null for NaN."""
    content = {
        report.environment: {
            "environment": report.environment,
            **report.summary(),
            "episodes": report.episodes,
            "steps_per_second": report.steps_per_second,
        }
        for report in reports
    }
    return json.dumps(without_nan(content), indent=2) + "\n"


def reports_to_csv(reports: Sequence[Report]) -> str:
    """Return all episodes of the reports as one CSV; what a row lacks is empty."""
    rows = [
        {"environment": report.environment, **without_nan(row)}
        for report in reports
        for row in report.episodes
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def reports_to_markdown(reports: Sequence[Report]) -> str:
    """Return a Markdown table, one line for each environment and measure."""
    lines = [
        "| environment | measure | mean (95 % interval) | interquartile mean |",
        "|---|---|---|---|",
    ]
    for report in reports:
        measures = [
            *_measures(report, "mean_reward"),
            *(
                (f"return of {agent}", own, False, "")
                for agent, own in report.returns.items()
            ),
            *_measures(report, "completion", True),
            *_measures(report, "performance", True),
            *_measures(report, "time_to_success", unit=" s"),
        ]
        for name, statistic, percent, unit in measures:
            cells = (
                report.environment,
                name,
                format_statistic(statistic, percent=percent, unit=unit),
                format_number(statistic.iqm, percent=percent, unit=unit),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _measures(
    report: Report, field: str, percent: bool = False, unit: str = ""
) -> list[tuple[str, Statistic, bool, str]]:
    """Return names, statistics and forms of a measure, one for each side."""
    name = "return" if field == "mean_reward" else field.replace("_", " ")
    is_alone = len(report.sides) == 1
    return [
        (
            name if is_alone else f"{name} of {side}",
            getattr(score, field),
            percent,
            unit,
        )
        for side, score in report.sides.items()
    ]


def format_statistic(
    statistic: Statistic, *, percent: bool = False, unit: str = ""
) -> str:
    """Return a mean and its interval for people, such as `98.0 % (95.0 to 100)`.

    Args:
      statistic: what to tell.
      percent: whether it is a share from 0 to 1.
      unit: what to put after the mean.
    """
    if math.isnan(statistic.mean):
        return "-"
    digits = 1 if percent or max(abs(statistic.low), abs(statistic.high)) < 1000 else 0
    mean = format_number(statistic.mean, percent=percent, unit=unit, digits=digits)
    low, high = (
        format_number(end, percent=percent, digits=digits).removesuffix(" %")
        for end in (statistic.low, statistic.high)
    )
    return f"{mean} ({low} to {high})"


def format_number(
    value: float, *, percent: bool = False, unit: str = "", digits: int = 1
) -> str:
    """Return a number for people to read, such as `98.0 %`; a dash for NaN.

    Args:
      value: what to tell.
      percent: whether it is a share from 0 to 1.
      unit: what to put after it.
      digits: how many after the point; a share of all is `100 %` in any case.
    """
    if math.isnan(value):
        return "-"
    if not percent:
        return f"{value:.{digits}f}{unit}"
    return "100 %" if value == 1.0 else f"{100 * value:.{digits}f} %"


def without_nan(value: Any) -> Any:
    """Return dictionaries and lists with None in the place of NaN."""
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
