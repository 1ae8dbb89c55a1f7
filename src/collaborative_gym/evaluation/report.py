"""The results of an evaluation, as numbers, JSON, CSV and Markdown."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from collaborative_gym.evaluation.intervals import iqm, mean_of, wilson
from collaborative_gym.evaluation.table import escaped, markdown_table, to_csv, to_json
from collaborative_gym.tasks.identity import Identity

SHARES = ("completion", "performance", "at_goal", "points")
"""Measures from 0 to 1."""

ACTION_CHANGE = "action_change"
"""Mean change of an action's movements from one control step to the next, 0 to 2, over
components and steps. It stands with the strain."""

_STRAIN_FORMS = {
    "contact_depth": (1e3, " mm"),
    "clearance": (1e3, " mm"),
    "contact_force": (1.0, " N"),
    "internal_force": (1.0, " N"),
    "wrist_force": (1.0, " N"),
    "wrist_torque": (1.0, " N m"),
    "pad_force": (1.0, " N"),
    "torque_limit_share": (1e2, " %"),
    "torque_over_limit": (1.0, ""),
    "speed_over_limit": (1.0, ""),
    "energy": (1.0, " J"),
    ACTION_CHANGE: (1.0, ""),
}
"""Factor and unit for people, by the beginning of a measure's name."""

_FORMS: dict[str, dict[str, Any]] = {
    "score": {},
    "mean_reward": {},
    "returns": {},
    "completion": {"percent": True},
    "performance": {"percent": True},
    "at_goal": {"percent": True},
    "time_to_success": {"unit": " s"},
}
"""Formats of the measures for `format_number`, in the order of the table."""


@dataclass(frozen=True)
class Statistic:
    """The mean over episodes, with its 95 % interval.

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
    def of(
        cls,
        values: Sequence[float],
        *,
        is_share: bool = False,
        at_least: float = -math.inf,
    ) -> "Statistic":
        """Return the statistic of the values that are not NaN.

        If they are shares from 0 to 1, an interval where all are alike is Wilson's. No
        interval goes below what all values are at least.
        """
        array = np.sort(np.asarray(values, float))
        array = array[~np.isnan(array)]
        if not len(array):
            return cls(*[math.nan] * 5)
        (mean,) = mean_of([array[:, None]], is_share=is_share)
        ends = np.maximum(mean.low, at_least), mean.high
        if len(array) > 1 and is_share and np.isin(array, (0.0, 1.0)).all():
            ends = wilson(mean.value, len(array))
        numbers = mean.value, *ends, iqm(array), np.median(array)
        return cls(*map(float, numbers))


@dataclass(frozen=True)
class Worst:
    """A measure of the strain over episodes."""

    mean: float
    worst: float  # greatest value; for the clearance, the least
    episode: int  # episode with that value

    @classmethod
    def of(cls, name: str, rows: Sequence[Mapping[str, Any]]) -> "Worst":
        """Return the mean and the worst of the measure `name` in episodes' rows."""
        worst = (min if name == "clearance" else max)(rows, key=lambda row: row[name])
        mean = float(np.mean([row[name] for row in rows]))
        return cls(mean, worst[name], worst["episode"])


@dataclass(frozen=True)
class Score:
    """Results of one side, over the episodes.

    Attributes:
      mean_reward: the return, which is the sum over all steps and the side's agents.
      completion: whether the goal was reached, 0 to 1.
      performance: the share of steps at the goal, 0 to 1, as the task counts it.
      at_goal: the share of all steps at which the goal is met, 0 to 1.
      time_to_success: time in s, over the episodes in which the goal was reached.
      score: the points if there are several sides, else None.
    """

    mean_reward: Statistic
    completion: Statistic
    performance: Statistic
    at_goal: Statistic
    time_to_success: Statistic
    score: Statistic | None = None


@dataclass(frozen=True)
class Report:
    """Results of a policy.

    A row of `episodes` has `episode`, `seed`, `return`, `completion`, `performance`,
    `at_goal`, `time_to_success` (s, NaN if never), `length` (control steps),
    `diverged`, and by agent `robot_1/return` and the sum of each reward term, such as
    `robot_1/distance`, the measures of the coordination and of the strain, and
    `action_change`. Where the task
    has several sides, their names stand before what each has of its own, as in
    `side_1/return` and `side_1/score`; nothing is summed over opponents.

    Attributes:
      environment: the environment's id or the task's name.
      settings: the environment's whole `identity`, the policy, episodes and seed.
      sides: score of each side, by its name; most tasks have one.
      returns: statistic of each agent's own return.
      episodes: one row per episode, in order.
      steps_per_second: environment steps per second, with the policy's own time and
        that of measuring the strain.
      strain: the arms' strain, by the names in docs/concepts.md.
      coordination: of the arms, by the names in `Task.coordination`: the unit, none for
        a share, and the statistic.
    """

    environment: str
    settings: dict[str, Any] = field(repr=False)
    sides: dict[str, Score]
    returns: dict[str, Statistic]
    episodes: tuple[dict[str, Any], ...] = field(repr=False)
    steps_per_second: float
    strain: dict[str, Worst] = field(default_factory=dict, repr=False)
    coordination: dict[str, tuple[str, Statistic]] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The environment and its arms."""
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
        """Return of the only side; where there are several, see `sides`."""
        return self._score.mean_reward

    @property
    def completion(self) -> Statistic:
        """Completion of the only side; where there are several, see `sides`."""
        return self._score.completion

    @property
    def performance(self) -> Statistic:
        """Performance of the only side; where there are several, see `sides`."""
        return self._score.performance

    @property
    def at_goal(self) -> Statistic:
        """Share of steps that the only side is at the goal; else see `sides`."""
        return self._score.at_goal

    @property
    def time_to_success(self) -> Statistic:
        """Time to success of the only side; where there are several, see `sides`."""
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
        plain = asdict(replace(self, episodes=()))
        own = {"sides": plain["sides"]}
        if len(self.sides) == 1:
            [own] = plain["sides"].values()
            del own["score"]
        first = {"settings": self.settings, "is_one_episode": self.is_one_episode}
        last = "returns", "strain", "coordination"
        return first | own | {name: plain[name] for name in last}

    def to_json(self) -> str:
        """Return everything as JSON, with null for NaN."""
        return reports_to_json([self])

    def to_csv(self) -> str:
        """Return the episodes as CSV, one row each, with an empty cell for NaN."""
        return reports_to_csv([self])

    def to_markdown(self) -> str:
        """Return the statistics as Markdown: a title, and tables."""
        count, seed = (self.settings[name] for name in ("episodes", "seed"))
        title = escaped(f"{self.title}, {format_episodes(count)} of seed {seed}")
        return f"{title}:\n\n{markdown_tables(self)}"

    _repr_markdown_ = to_markdown  # for notebooks


def is_share(measure: str) -> bool:
    """Return whether a measure, such as `side_1/completion`, is from 0 to 1."""
    return measure.rpartition("/")[2] in SHARES


def are_one_episode(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether rows differ by the episode's number alone."""
    return len({repr({**row, "episode": 0}) for row in rows}) == 1


def format_episodes(count: object) -> str:
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
    return to_json(content)


def reports_to_csv(reports: Sequence[Report]) -> str:
    """Return all episodes of the reports as one CSV; missing cells are empty."""
    rows: list[dict[str, Any]] = []
    for report in reports:
        robots = " ".join(report._identity.robot_names)
        own = {"environment": report.environment, "robots": robots}
        rows += [own | row for row in report.episodes]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    return to_csv(columns, ([row.get(name) for name in columns] for row in rows))


def markdown_tables(report: Report) -> str:
    """Return Markdown tables of a report, one line for each measure."""
    lines = []
    for measure, form in _FORMS.items():
        if by_agent := measure == "returns":
            name, own = "return", report.returns
        else:
            name = "return" if measure == "mean_reward" else measure.replace("_", " ")
            own = {side: getattr(each, measure) for side, each in report.sides.items()}
        for who, statistic in own.items():
            if statistic is not None:
                is_alone = len(own) == 1 and not by_agent
                title = name if is_alone else f"{name} of {who}"
                middles = statistic.median, statistic.iqm
                cells = (format_number(each, **form) for each in middles)
                lines.append([title, format_statistic(statistic, **form), *cells])
    lines += coordination_lines(report)
    heads = ["measure", "mean (95 % interval)", "median", "interquartile mean"]
    parts = [markdown_table(heads, lines), strain_table(report)]
    return "\n\n".join([*parts, *map(escaped, one_episode_notes([report]))]) + "\n"


def strain_table(report: Report) -> str:
    """Return a Markdown table of the strain."""
    heads = ["strain", "mean", "worst", "in episode"]
    return markdown_table(heads, strain_lines(report))


def coordination_lines(report: Report) -> list[list[str]]:
    """Return the coordination for people: measure, mean, median, interquartile mean."""
    lines = []
    for name, (unit, found) in report.coordination.items():
        form: dict[str, Any] = {"unit": f" {unit}"} if unit else {"percent": True}
        if unit == "m":
            numbers = {each: 1e3 * value for each, value in vars(found).items()}
            found, form = Statistic(**numbers), {"unit": " mm"}
        middles = (format_number(x, **form) for x in (found.median, found.iqm))
        text = format_statistic(found, **form)
        lines.append([name.replace("_", " "), text, *middles])
    return lines


def one_episode_notes(reports: Sequence[Report]) -> list[str]:
    """Return a sentence for each report whose episodes are all the same one."""
    return [
        f"{report.title}: one deterministic episode; all"
        f" {len(report.episodes)} start alike, and there is no interval."
        for report in reports
        if report.is_one_episode
    ]


def strain_lines(report: Report) -> list[list[str]]:
    """Return the strain for people: measure, mean, worst and its episode."""
    lines = []
    for name, worst in report.strain.items():
        factor, unit = next(
            own for s, own in _STRAIN_FORMS.items() if name.startswith(s)
        )
        digits = 1 if name != ACTION_CHANGE else 3
        both = worst.mean, worst.worst
        cells = (f"{factor * value:.{digits}f}{unit}" for value in both)
        lines.append([name.replace("_", " "), *cells, str(worst.episode)])
    return lines


def format_statistic(statistic: Statistic, **form: Any) -> str:
    """Return a mean and its interval as `format_interval` does."""
    return format_interval(statistic.mean, statistic.low, statistic.high, **form)


def format_interval(
    value: float, low: float, high: float, *, percent: bool = False, unit: str = ""
) -> str:
    """Return a number and its interval for people, such as `98.0 % (95.0 to 100)`.

    An interval that is NaN or has no width is left out; a number that is NaN is a dash.
    The arguments are those of `format_number`.
    """
    ends = [value] if math.isnan(low) or low == high else [low, high]
    digits = 1 if percent or max(map(abs, ends)) < 1000 else 0
    middle = format_number(value, percent=percent, unit=unit, digits=digits)
    if len(ends) == 1 or math.isnan(value):
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

    With `percent` it is a share from 0 to 1, else followed by `unit`; a share of all is
    `100 %` with any number of digits after the point.
    """
    if math.isnan(value):
        return "-"
    if not percent:
        return f"{value:.{digits}f}{unit}"
    return "100 %" if value == 1.0 else f"{100 * value:.{digits}f} %"
