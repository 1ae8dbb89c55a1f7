"""Table 11 of the 2023 thesis that defined the environments, beside our baselines."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from collaborative_gym.errors import check_callback, check_count, look_up
from collaborative_gym.evaluation.play import OnProgress, evaluate, parts_of
from collaborative_gym.evaluation.report import Report, format_number
from collaborative_gym.evaluation.table import markdown_table, to_json
from collaborative_gym.policies import load_policy
from collaborative_gym.policies.policy import is_shipped
from collaborative_gym.tasks.registry import make_task

COLUMNS = {
    "ours": ("baseline", "paper"),
    "ours_on_default": ("baseline", "default"),
    "expert": ("expert", "paper"),
    "random": ("random", "paper"),
    "idle": ("idle", "paper"),
}
"""Policy and randomization of the columns beside the thesis's numbers."""

_AS_GOOD_AS_ALL = 0.9995
"""Least share that reads 100.0 %; where the thesis has one, an equal one is enough."""

_LEAST_ON_DEFAULT = {"completion": 0.98, "performance": 0.95}
"""The least that counts as good on `default`, which the thesis lacks. Our choice."""

NOTE = (
    "PASS means that our number exceeds the thesis's (or equals its 100 %); on"
    " `default`, it means 98 % completion and 95 % performance. Our success rules are"
    " stricter: in Poke, the stick must be through the ring for 0.5 s; in Lift, both"
    " arms must hold a level, slow pot; in Balance, success must last 2 s; in Pass,"
    " robot_2 must hold the cube."
)
"""Note below the table: what decides a cell, and how the success rules differ."""


@dataclass(frozen=True)
class Thesis:
    """A line of the thesis's table, over 200 trials."""

    mean_reward: float  # sum over all steps and both robots
    completion: float  # share of the trials that reached the goal
    performance: float  # share of the steps at the goal


THESIS: Mapping[str, Thesis] = {
    "PokeTaskSawyers-v0": Thesis(254.23, 0.985, 0.9849),
    "PokeTaskPandaSawyer-v0": Thesis(215.94, 1.0, 0.9998),
    "LiftTaskSawyers-v0": Thesis(-356.88, 0.98, 0.2901),
    "LiftTaskJacos-v0": Thesis(-144.53, 0.985, 0.6940),
    "BalanceTaskSawyers-v0": Thesis(-341.90, 0.92, 0.72),
    "BalanceTaskJacoSawyer-v0": Thesis(-404.53, 0.735, 0.6497),
    "PassTaskSawyers-v0": Thesis(-95.22, 0.723, 0.5993),
    "PassTaskJacoSawyer-v0": Thesis(198.16, 0.96, 0.9546),
}
"""The thesis's Table 11 (2023), by environment id."""


@dataclass(frozen=True)
class Line:
    """An environment's line of the thesis, and our reports by column of `COLUMNS`.

    A baseline that is not shipped has no report.
    """

    environment: str
    thesis: Thesis
    reports: Mapping[str, Report]

    def mean(self, column: str, measure: str) -> float:
        """Return the mean of our report, NaN where there is no baseline."""
        report = self.reports.get(column)
        return math.nan if report is None else getattr(report, measure).mean

    def verdicts(self) -> dict[tuple[str, str], bool]:
        """Return whether ours is good enough, by column and measure."""
        verdicts = {}
        for measure, bound in asdict(self.thesis).items():
            ours = self.mean("ours", measure)
            is_enough = measure != "mean_reward" and bound >= _AS_GOOD_AS_ALL
            verdicts["ours", measure] = ours > bound or (is_enough and ours == bound)
        for measure, bound in _LEAST_ON_DEFAULT.items():
            column = "ours_on_default"
            verdicts[column, measure] = self.mean(column, measure) >= bound
        return verdicts


@dataclass(frozen=True)
class Table11:
    """The thesis's numbers beside those of the baselines, the experts and chance.

    Attributes:
      episodes: number of episodes for each number of ours.
      seed: the episodes' seed.
      comparisons: one line for each environment.
    """

    episodes: int
    seed: int
    comparisons: tuple[Line, ...]

    @property
    def is_passed(self) -> bool:
        """Whether every cell is good enough."""
        return all(self._verdicts())

    @property
    def verdict(self) -> str:
        """The verdict in words: every cell is good enough, or how many are not."""
        verdicts = self._verdicts()
        if all(verdicts):
            return "PASS: every cell"
        return f"FAIL: {verdicts.count(False)} of {len(verdicts)} cells"

    def _verdicts(self) -> list[bool]:
        return [each for line in self.comparisons for each in line.verdicts().values()]

    def lines(self, reward_digits: int = 2) -> list[list[str]]:
        """Return cells for people: environment, measure, thesis, then `COLUMNS`.

        There is a line per environment and measure, with so many digits of rewards. A
        dash stands where there is no baseline; PASS or FAIL follows what is judged.
        """
        lines = []
        for line in self.comparisons:
            verdicts = line.verdicts()
            for measure, bound in asdict(line.thesis).items():
                is_share = measure != "mean_reward"
                digits = 2 if is_share else reward_digits
                cells = []
                for column in ("thesis", *COLUMNS):
                    value = bound if column == "thesis" else line.mean(column, measure)
                    cell = format_number(value, percent=is_share, digits=digits)
                    if (column, measure) in verdicts:
                        cell += " PASS" if verdicts[column, measure] else " FAIL"
                    cells.append(cell)
                lines.append([line.environment, measure.replace("_", " "), *cells])
        return lines

    def to_markdown(self) -> str:
        """Return the table, how it was made, and the verdict as Markdown."""
        heads = ["environment", "measure", "thesis", *column_names()]
        table = markdown_table(heads, self.lines(), words=2)
        return f"{table}\n\n{self.about()}\n{NOTE}\n\n{self.verdict}\n"

    def about(self) -> str:
        """Return how the numbers were made, in two sentences."""
        return (
            f"Our numbers are means over {self.episodes} episodes of seed {self.seed},"
            " the thesis's (2023, Table 11) over 200 trials. Columns without `default`"
            " use the thesis's starts (`paper`)."
        )

    def to_json(self) -> str:
        """Return all statistics and verdicts as JSON, with null for NaN."""
        environments = {}
        for line in self.comparisons:
            entry: dict[str, Any] = {"thesis": line.thesis}
            for column in COLUMNS:
                report = line.reports.get(column)
                entry[column] = report and report.summary()
            entry["passed"] = {}
            for (column, measure), is_passed in line.verdicts().items():
                entry["passed"].setdefault(column, {})[measure] = is_passed
            environments[line.environment] = entry
        return to_json(
            {
                "table": "table11",
                "episodes": self.episodes,
                "seed": self.seed,
                "verdict": self.verdict,
                "is_passed": self.is_passed,
                "note": NOTE,
                "environments": environments,
            }
        )


def reproduce_table11(
    episodes: int = 200,
    seed: int = 0,
    *,
    env_ids: Sequence[str] | None = None,
    num_threads: int = 0,
    on_progress: OnProgress = None,
) -> Table11:
    """Play baselines, experts, random and idle arms beside the thesis's numbers.

    The numbers are the same for any `num_threads`.

    Args:
      episodes: number per environment and policy.
      seed: the episodes' seed.
      env_ids: environments of the table; None for all eight.
      num_threads: physics threads, 0 for one per CPU.
      on_progress: called with the share that is done, 0 to 1.

    Raises:
      KeyError: if an environment is not in the table.
      TypeError: if a number is not an integer.
      ValueError: if a number is out of range, `env_ids` is empty, or a baseline is
        damaged or does not fit.
    """
    episodes = check_count("episodes", episodes, at_least=1)
    check_callback("on_progress", on_progress)
    if env_ids is not None and not env_ids:
        raise ValueError("env_ids is empty; name environments, or None for all eight")
    jobs: list[tuple[str, str]] = []
    for env_id in dict.fromkeys(THESIS if env_ids is None else env_ids):
        look_up("environment", env_id, THESIS)
        shipped = is_shipped("baseline", env_id)
        if shipped:
            load_policy(env_id)  # One that is damaged shows before the work.
        jobs += [
            (env_id, column)
            for column, (policy, _) in COLUMNS.items()
            if shipped or policy != "baseline"
        ]
    reports: dict[str, dict[str, Report]] = {}
    parts = parts_of(on_progress, [1] * len(jobs))
    for (env_id, column), part in zip(jobs, parts, strict=True):
        policy, randomization = COLUMNS[column]
        reports.setdefault(env_id, {})[column] = evaluate(
            make_task(env_id, randomization=randomization),
            policy,
            episodes=episodes,
            seed=seed,
            num_threads=num_threads,
            on_progress=part,
        )
    lines = [Line(env_id, THESIS[env_id], own) for env_id, own in reports.items()]
    return Table11(episodes, seed, tuple(lines))


def column_names() -> list[str]:
    """Return the names of `COLUMNS` for people."""
    return [column.replace("_", " ") for column in COLUMNS]
