"""What an evaluation found, as numbers, JSON, CSV and Markdown."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from collaborative_gym.evaluation.intervals import iqm, mean_of, wilson
from collaborative_gym.evaluation.table import escaped, markdown_table
from collaborative_gym.tasks.identity import Identity

ACTION_CHANGE = "action_change"
"""How much what moves the arms in an action changes from one control step to the next,
the mean over components and steps, 0 to 2; told with the strain."""

_STRAIN_FORMS = {
    "contact_depth": (1e3, " mm"),
    "clearance": (1e3, " mm"),
    "contact_force": (1.0, " N"),
    "internal_force": (1.0, " N"),
    "torque_limit_share": (1e2, " %"),
    "speed_over_limit": (1.0, ""),
    "energy": (1.0, " J"),
    ACTION_CHANGE: (1.0, ""),
}
"""How people read measures, by the beginning of their names: the factor and the
unit."""


@dataclass(frozen=True)
class Statistic:
    """The mean over episodes and how sure it is.

    Attributes:
      mean: the mean; NaN if there was no value.
      low: lower end of the mean's 95 % interval: Wilson's (1927) where all values are 0
        or 1, else Student's t; NaN for a single value, and where all are alike.
      high: upper end of it.
      iqm: interquartile mean, that of the middle half of the values.
      median: the middle value, which no single bad episode moves.
    """

    mean: float
    low: float
    high: float
    iqm: float
    median: float

    @classmethod
    def of(cls, values: Sequence[float], *, is_share: bool = False) -> "Statistic":
        """Return the statistic of some values, leaving out those that are NaN.

        Args:
          values: of the episodes.
          is_share: whether they are from 0 to 1. Where all are alike, the interval is
            then Wilson's, too.
        """
        array = np.sort(np.asarray(values, float))
        array = array[~np.isnan(array)]
        if not len(array):
            return cls(*[math.nan] * 5)
        (mean,) = mean_of([array[:, None]], is_share=is_share)
        ends = mean.low, mean.high
        if len(array) > 1 and is_share and np.isin(array, (0.0, 1.0)).all():
            ends = wilson(mean.value, len(array))
        numbers = mean.value, *ends, iqm(array), np.median(array)
        return cls(*map(float, numbers))


@dataclass(frozen=True)
class Worst:
    """A measure of the strain over episodes.

    Attributes:
      mean: of the episodes.
      worst: the greatest value of all episodes; for the clearance, the least.
      episode: the episode that has it.
    """

    mean: float
    worst: float
    episode: int

    @classmethod
    def of(cls, name: str, rows: Sequence[Mapping[str, Any]]) -> "Worst":
        """Return that of the measure of this name, of episodes' rows."""
        worst = (min if name == "clearance" else max)(rows, key=lambda row: row[name])
        mean = float(np.mean([row[name] for row in rows]))
        return cls(mean, worst[name], worst["episode"])


@dataclass(frozen=True)
class Score:
    """How one side did, over the episodes.

    Attributes:
      mean_reward: the return, which is the sum over all steps and the side's agents.
      completion: whether the goal was reached, 0 to 1.
      performance: the share of steps at the goal, 0 to 1, as the task counts it.
      time_to_success: the time until the goal was reached in s, over the episodes in
        which it was reached.
      score: the points if there are several sides, else None.
    """

    mean_reward: Statistic
    completion: Statistic
    performance: Statistic
    time_to_success: Statistic
    score: Statistic | None = None


@dataclass(frozen=True)
class Report:
    """How a policy did.

    A row of `episodes` has `episode`, `seed`, `return`, `completion`, `performance`,
    `time_to_success` (s, NaN if never), `length` (control steps), `diverged`, and by
    agent `robot_1/return` and the sum of each reward term, such as
    `robot_1/distance`, the measures of the strain, and `action_change`. Where the task
    has several sides, their names stand before what each has of its own, as in
    `side_1/return` and `side_1/score`; nothing is summed over opponents.

    Attributes:
      environment: the environment's id or the task's name.
      settings: what was evaluated: the environment's whole `identity`, the policy,
        episodes and seed.
      sides: how each side did, by its name; most tasks have one.
      returns: of each agent's own return, by agent.
      episodes: one row per episode, in order.
      steps_per_second: environment steps per second, with the policy's own time and
        that of measuring the strain.
      strain: what arms did to one another, to things and to themselves, by the names in
        `envs.strain`.
    """

    environment: str
    settings: dict[str, Any]
    sides: dict[str, Score]
    returns: dict[str, Statistic]
    episodes: tuple[dict[str, Any], ...]
    steps_per_second: float
    strain: dict[str, Worst] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What was played: the environment and its arms."""
        return self._identity.title

    @property
    def _identity(self) -> Identity:
        return Identity.from_dict(self.settings["identity"])

    @property
    def is_one_episode(self) -> bool:
        """Whether all episodes are the same one, because they start alike."""
        return len(self.episodes) > 1 and are_one_episode(self.episodes)

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
        own = {"sides": scores}
        if len(scores) == 1:
            own = next(iter(scores.values()))
            del own["score"]
        returns = {agent: asdict(own) for agent, own in self.returns.items()}
        strain = {name: asdict(worst) for name, worst in self.strain.items()}
        return {
            "settings": self.settings,
            "is_one_episode": self.is_one_episode,
            **own,
            "returns": returns,
            "strain": strain,
        }

    def to_json(self) -> str:
        """Return everything as JSON, with null for NaN."""
        return reports_to_json([self])

    def to_csv(self) -> str:
        """Return the episodes as CSV, one row each, with an empty cell for NaN."""
        return reports_to_csv([self])

    def to_markdown(self) -> str:
        """Return the statistics as Markdown: what was played, and tables."""
        count, seed = (self.settings[name] for name in ("episodes", "seed"))
        told = f"{self.title}, {told_episodes(count)} of seed {seed}"
        return f"{escaped(told)}:\n\n{markdown_tables(self)}"

    def _repr_markdown_(self) -> str:
        """Return what a notebook shows."""
        return self.to_markdown()


def are_one_episode(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether rows differ by the episode's number alone."""
    return len({repr({**row, "episode": 0}) for row in rows}) == 1


def told_episodes(count: object) -> str:
    """Return a number of episodes for people."""
    return f"{count} episode" if str(count) == "1" else f"{count} episodes"


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
    return plain_to_json(content)


def plain_to_json(content: Any) -> str:
    """Return plain dictionaries and lists as JSON, with null for NaN."""
    return json.dumps(without_nan(content), indent=2) + "\n"


def reports_to_csv(reports: Sequence[Report]) -> str:
    """Return all episodes of the reports as one CSV; what a row lacks is empty."""
    rows = [
        {
            "environment": report.environment,
            "robots": " ".join(report._identity.robot_names),
            **without_nan(row),
        }
        for report in reports
        for row in report.episodes
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_tables(report: Report) -> str:
    """Return Markdown tables of a report, one line for each measure."""
    measures = [
        *_measures(report, "score"),
        *_measures(report, "mean_reward"),
        *(
            (f"return of {agent}", own, False, "")
            for agent, own in report.returns.items()
        ),
        *_measures(report, "completion", True),
        *_measures(report, "performance", True),
        *_measures(report, "time_to_success", unit=" s"),
    ]
    heads = ["measure", "mean (95 % interval)", "median", "interquartile mean"]
    lines = [
        [
            name,
            format_statistic(statistic, percent=percent, unit=unit),
            format_number(statistic.median, percent=percent, unit=unit),
            format_number(statistic.iqm, percent=percent, unit=unit),
        ]
        for name, statistic, percent, unit in measures
    ]
    parts = [markdown_table(heads, lines), strain_table(report)]
    return "\n\n".join([*parts, *map(escaped, one_episode_notes([report]))]) + "\n"


def strain_table(report: Report) -> str:
    """Return a Markdown table of the strain."""
    heads = ["strain", "mean", "worst", "in episode"]
    return markdown_table(heads, strain_lines(report))


def one_episode_notes(reports: Sequence[Report]) -> list[str]:
    """Return a sentence for each report whose episodes are all the same one."""
    return [
        f"{report.title}: one deterministic episode; all"
        f" {len(report.episodes)} start alike, and there is no interval."
        for report in reports
        if report.is_one_episode
    ]


def strain_lines(report: Report) -> list[list[str]]:
    """Return what people read of the strain: measure, mean, worst and its episode."""
    lines = []
    for name, worst in report.strain.items():
        factor, unit = next(
            form for start, form in _STRAIN_FORMS.items() if name.startswith(start)
        )
        digits = 1 if name != ACTION_CHANGE else 3
        both = worst.mean, worst.worst
        cells = (f"{factor * value:.{digits}f}{unit}" for value in both)
        lines.append([name.replace("_", " "), *cells, str(worst.episode)])
    return lines


def _measures(
    report: Report, field: str, percent: bool = False, unit: str = ""
) -> list[tuple[str, Statistic, bool, str]]:
    """Return names, statistics and forms of a measure, one for each side with it."""
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
        if getattr(score, field) is not None
    ]


def format_statistic(
    statistic: Statistic, *, percent: bool = False, unit: str = ""
) -> str:
    """Return a mean and its interval for people, such as `98.0 % (95.0 to 100)`.

    A single value has no interval, and equal ones show none.

    Args:
      statistic: what to tell.
      percent: whether it is a share from 0 to 1.
      unit: what to put after the mean.
    """
    ends = statistic.mean, statistic.low, statistic.high
    return format_interval(*ends, percent=percent, unit=unit)


def format_interval(
    value: float, low: float, high: float, *, percent: bool = False, unit: str = ""
) -> str:
    """Return a number and its interval as `format_statistic` does.

    Args:
      value: the number; for NaN it is a dash.
      low: lower end; NaN for no interval. One without a width is not told.
      high: upper end.
      percent: whether they are shares from 0 to 1.
      unit: what to put after the number.
    """
    if math.isnan(value):
        return "-"
    ends = [value] if math.isnan(low) or low == high else [low, high]
    digits = 1 if percent or max(map(abs, ends)) < 1000 else 0
    middle = format_number(value, percent=percent, unit=unit, digits=digits)
    if len(ends) == 1:
        return middle
    first, last = (
        format_number(end, percent=percent, digits=digits).removesuffix(" %")
        for end in ends
    )
    return f"{middle} ({first} to {last})"


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
    """Return dictionaries and lists with None for NaN and what is infinite."""
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
