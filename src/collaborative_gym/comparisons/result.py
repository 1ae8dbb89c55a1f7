"""The comparison of runs: tables, JSON, CSV, Markdown, marl-eval's JSON."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from collaborative_gym.comparisons.runs import (
    VALIDATION,
    Group,
    Grouping,
    TrainedRun,
    find_runs,
    group_runs,
    in_all,
)
from collaborative_gym.errors import check_kind, look_up
from collaborative_gym.evaluation import intervals
from collaborative_gym.evaluation.intervals import Estimate
from collaborative_gym.evaluation.report import format_interval, is_share
from collaborative_gym.evaluation.table import escaped, markdown_table, to_csv, to_json

_GOAL = 0.9  # completion that counts as learned
_POINTS = 51  # number of scores at which a performance profile has a value

Table = tuple[str, list[str], list[list[str]]]
"""A title, the columns' heads, and the lines' cells, for people."""


@dataclass(frozen=True)
class Entry:
    """A group, or a method over environments, with a group for each of these.

    The method is empty where there is only one; `environment` is the name of the only
    environment, or the number of them.
    """

    environment: str
    method: str
    groups: tuple[Group, ...]

    def scores(self, measure: str) -> list[np.ndarray]:
        """Return the last validations by environment, each (runs, 1)."""
        return [group.scores(measure) for group in self.groups]

    @property
    def num_runs(self) -> int:
        """Number of its runs."""
        return sum(len(group.runs) for group in self.groups)


@dataclass(frozen=True)
class Aggregates:
    """Interquartile mean, median and mean of scores, with intervals over seeds."""

    iqm: Estimate
    median: Estimate
    mean: Estimate


@dataclass(frozen=True)
class Reached:
    """First validations of which a share of `_GOAL` was completed."""

    runs: int  # number of runs with such a validation
    steps: Estimate  # median until then; infinite if half of the runs have none
    core_seconds: Estimate  # median of the CPU time; NaN where it is not known


@dataclass(frozen=True)
class Comparison:
    """Results of groups of training runs.

    The score of a run is its mean in the last validation that all runs of its group
    have. Intervals are 95 % intervals over the runs of one environment: Student's t for
    means, Yuen's for interquartile means, order statistics for medians, Wilson's for
    shares of runs and for equal scores, DeLong's for probabilities. A group of one run
    has no interval, and a median needs five runs for one.

    Attributes:
      grouping: the groups, and their differences.
      measures: of all validations.
      measure: of `profiles` and `improvements`.
      notes: about runs that have not come to their end.
    """

    grouping: Grouping
    measures: tuple[str, ...]
    measure: str
    notes: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """Runs that differ by their seeds alone."""
        return self.grouping.groups

    @cached_property
    def environments(self) -> tuple[str, ...]:
        """Names of the environments."""
        return tuple(dict.fromkeys(group.environment for group in self.groups))

    @cached_property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods; one empty name where only environments differ."""
        return tuple(dict.fromkeys(group.method for group in self.groups))

    @cached_property
    def contestants(self) -> dict[str, Entry]:
        """The methods over the environments that have all of them, by name.

        Where there is one method, the environments.
        """
        if len(self.methods) == 1:
            return {g.environment: Entry(g.environment, "", (g,)) for g in self.groups}
        by = {(group.environment, group.method): group for group in self.groups}
        shared = [
            each
            for each in self.environments
            if all((each, method) in by for method in self.methods)
        ]
        where = shared[0] if len(shared) == 1 else f"{len(shared)} environments"
        return {
            method: Entry(where, method, tuple(by[each, method] for each in shared))
            for method in (self.methods if shared else ())
        }

    @cached_property
    def entries(self) -> tuple[Entry, ...]:
        """All groups, and the methods over several environments where there are."""
        own = [Entry(each.environment, each.method, (each,)) for each in self.groups]
        together = [e for e in self.contestants.values() if len(e.groups) > 1]
        return (*own, *together)

    def aggregates(self, entry: Entry, measure: str) -> Aggregates:
        """Return the aggregates of an entry's scores."""
        strata, share = entry.scores(measure), is_share(measure)
        return Aggregates(
            intervals.iqm_of(strata, is_share=share)[0],
            intervals.median_of(strata)[0],
            intervals.mean_of(strata, is_share=share)[0],
        )

    def curve(self, group: Group, measure: str) -> list[Estimate]:
        """Return the interquartile mean of a group's validations, by `group.steps`."""
        return intervals.iqm_of([group.values(measure)], is_share=is_share(measure))

    @cached_property
    def levels(self) -> np.ndarray:
        """The scores at which profiles have values, ascending."""
        ends = 0.0, 1.0
        if not is_share(self.measure):
            scores = np.concatenate([each for e in self._scores.values() for each in e])
            ends = scores.min(), scores.max()
        return np.linspace(*ends, _POINTS)

    @cached_property
    def _scores(self) -> dict[str, list[np.ndarray]]:
        return {n: e.scores(self.measure) for n, e in self.contestants.items()}

    @cached_property
    def profiles(self) -> dict[str, list[Estimate]]:
        """By contestant, the share of runs that score at least each of `levels`."""
        return {
            name: intervals.share_of(np.concatenate(scores) >= self.levels)
            for name, scores in self._scores.items()
        }

    @cached_property
    def improvements(self) -> dict[tuple[str, str], Estimate]:
        """Probability that a run of the first contestant beats one of the second.

        It is the mean over environments, and a tie counts a half.
        """
        found = {}
        for (one, first), (other, second) in combinations(self._scores.items(), 2):
            # Of several environments, each has runs of both.
            pairs = zip(map(np.ravel, first), map(np.ravel, second), strict=True)
            found[one, other] = intervals.chance_of(pairs)
        return found

    def reached(self, group: Group) -> Reached | None:
        """Return when runs learned the task; None where nothing can be completed."""
        measure = VALIDATION + "completion"
        if measure not in group.runs[0].rows[0]:
            return None
        firsts = [
            next((row for row in run.rows if row[measure] >= _GOAL), None)
            for run in group.runs
        ]
        medians = []
        for name in ("steps", "core_seconds"):
            taken = [row.get(name, math.nan) if row else math.inf for row in firsts]
            medians += intervals.median_of([np.array(taken)[:, None]])
        return Reached(sum(map(bool, firsts)), *medians)

    @cached_property
    def statement(self) -> str:
        """The number of runs and their differences, as sentences."""
        runs = [run for group in self.groups for run in group.runs]
        seeds = sorted({run.seed for run in runs})
        first = f"{len(runs)} run{'s' * (len(runs) > 1)}, seed{'s' * (len(seeds) > 1)}"
        lines = [f"{first} {', '.join(map(str, seeds))}."]
        named = dict(self.grouping.differences)
        if len(self.environments) > 1:
            named = {"environment": list(self.environments), **named}
        differing, of_environments = (
            "; ".join(f"{name} ({', '.join(v)})" for name, v in each.items())
            for each in (named, self.grouping.of_environments)
        )
        if len(runs) > 1:
            lines.append(f"They differ in {differing or 'nothing else'}.")
        if of_environments:
            lines.append(
                f"Only between environments do these differ: {of_environments}."
            )
        if not self.contestants:
            lines.append("No environment has runs of all, so nothing more is compared.")
        return "\n".join([*lines, *self.notes])

    def tables(self) -> Iterator[Table]:
        """Yield tables for people."""
        heads = ["environment", "method", "runs"]
        for measure in self.measures:
            lines = []
            for entry in self.entries:
                if len(entry.groups) == 1 or is_share(measure):
                    own = self.aggregates(entry, measure)
                    cells = (_cell(each, measure) for each in (own.iqm, own.median))
                    lines.append([*self._cells(entry), *cells])
            ends = ["interquartile mean (95 %)", "median (95 %)"]
            yield f"{measure} in the last validation", [*heads, *ends], lines
        lines = []
        for group, entry in zip(self.groups, self.entries, strict=False):
            reached = self.reached(group)
            if reached is not None:
                took = map(_counted, (reached.steps, reached.core_seconds))
                runs = f"{reached.runs} of {entry.num_runs}"
                lines.append([*self._cells(entry)[:2], runs, *took])
        if lines:
            medians = ["median steps (95 %)", "median core-seconds (95 %)"]
            yield f"to {100 * _GOAL:.0f} % completion", [*heads, *medians], lines
        lines = [
            [one, other, _cell(chance, "points")]
            for (one, other), chance in self.improvements.items()
        ]
        if lines:
            heads = ["a run of", "beats one of", "with probability (95 %)"]
            yield f"probability of improvement, {self.measure}", heads, lines

    def _cells(self, entry: Entry) -> list[str]:
        last = [group.steps[-1] for group in entry.groups]
        steps = " to ".join(f"{n / 1e6:.3g} M" for n in sorted({min(last), max(last)}))
        runs = f"{entry.num_runs} (of {steps} steps)"
        return [entry.environment, entry.method or "-", runs]

    def to_markdown(self) -> str:
        """Return the statement and the tables as Markdown."""
        parts = [escaped(line) for line in self.statement.split("\n")]
        for title, heads, lines in self.tables():
            parts += [f"**{escaped(title)}**", markdown_table(heads, lines)]
        return "\n\n".join(parts) + "\n"

    def to_csv(self) -> str:
        """Return the learning curves, a row for each group, measure and validation."""
        heads = ["environment", "method", "runs", "measure", "steps"]
        heads += ["iqm", "iqm_low", "iqm_high", "median", "mean"]
        rows = []
        for group, measure in product(self.groups, self.measures):
            first = group.environment, group.method, len(group.runs), measure
            values = group.values(measure)
            for i, at in enumerate(self.curve(group, measure)):
                others = np.median(values[:, i]), np.mean(values[:, i])
                iqm = at.value, at.low, at.high
                rows.append([*first, group.steps[i], *iqm, *others])
        return to_csv(heads, rows)

    def to_json(self) -> str:
        """Return everything as JSON, with null for NaN and for never."""
        content = {
            "differences": self.grouping.differences,
            "of_environments": self.grouping.of_environments,
            "notes": self.notes,
            "measure": self.measure,
            "groups": [self._plain(group) for group in self.groups],
            "scores": [
                {"environment": entry.environment, "method": entry.method}
                | {m: self.aggregates(entry, m) for m in self.measures}
                for entry in self.entries
            ],
            "levels": self.levels.tolist() if self.contestants else [],
            "profiles": self.profiles,
            "improvements": [
                {"one": one, "other": other, **asdict(chance)}
                for (one, other), chance in self.improvements.items()
            ],
        }
        return to_json(content, indent=1)

    def _plain(self, group: Group) -> dict[str, Any]:
        return {
            "environment": group.environment,
            "method": group.method,
            "runs": {str(run.folder): run.seed for run in group.runs},
            "steps": group.steps.tolist(),
            "validations": {m: group.values(m).tolist() for m in self.measures},
            "reached": self.reached(group),
        }

    def to_marl_eval(self) -> str:
        """Return the validations as the JSON that the package id-marl-eval reads.

        Its tasks are the environments, its algorithms the methods, and its runs have
        the seeds as names. Its `absolute_metrics` are those of the last validation. It
        wants equal numbers of runs and validations, and each method everywhere.
        """
        tasks: dict[str, Any] = {}
        for group in self.groups:
            # Its own code refuses commas.
            method = (group.method or "ppo").replace(",", ";")
            values = {m: group.values(m) for m in self.measures}
            for i, run in enumerate(group.runs):
                steps: dict[str, Any] = {
                    f"step_{k + 1}": {"step_count": int(count)}
                    | {m: [float(of[i, k])] for m, of in values.items()}
                    for k, count in enumerate(group.steps)
                }
                last = {m: [float(of[i, -1])] for m, of in values.items()}
                steps["absolute_metrics"] = last
                methods = tasks.setdefault(group.environment, {})
                methods.setdefault(method, {})[f"seed_{run.seed}"] = steps
        return json.dumps({"collaborative_gym": tasks}, indent=1) + "\n"


def compare(
    runs: str | Path | Sequence[str | Path], *, measure: str | None = None
) -> Comparison:
    """Return the results of training runs, grouped by the settings that differ.

    Runs with the same settings and different seeds are a group, and intervals are over
    their seeds. The differences are those of the settings with which the runs started.

    Args:
      runs: the folder of a run, or one that has runs in it at any depth, or several.
      measure: measure of the validations for performance profiles and probabilities of
        improvement; None for "completion", or the first that the runs have.

    Raises:
      FileNotFoundError: if there is no run in one of the folders.
      KeyError: if the validations have no such measure.
      OSError: if a file cannot be read.
      TypeError: if a folder is not a path.
      ValueError: if there is nothing to compare, a file is damaged, or a run doubled.
    """
    kinds = str, Path, Sequence
    check_kind("runs", runs, kinds, "a folder's name, or several")
    found = find_runs([runs] if isinstance(runs, str | Path) else runs)
    validated = [run for run in found if run.rows]
    if not validated:
        raise ValueError(
            f"there is no validation yet in {len(found)} of {len(found)} runs; let them"
            " train for longer: one comes every validation_interval (250,000) steps"
        )
    grouping = group_runs(validated)
    measures = _measures(grouping)
    if measure is None:
        measure = next(filter(is_share, measures), measures[0])
    else:
        look_up("measure", measure, dict.fromkeys(measures))
    return Comparison(grouping, measures, measure, _notes(found))


def _measures(grouping: Grouping) -> tuple[str, ...]:
    """Return the measures that all validations have, shares first."""
    shared = in_all(group.measures for group in grouping.groups)
    if not shared:
        raise ValueError(
            "the runs' validations have no measure in common; compare those of tasks"
            " with one side and those of opponents apart"
        )
    return tuple(sorted(shared, key=lambda name: not is_share(name)))


def _notes(runs: Sequence[TrainedRun]) -> tuple[str, ...]:
    notes = []
    for run in runs:
        last = int(run.rows[-1]["steps"]) if run.rows else 0
        if not last:
            notes.append(f"{run.folder} is left out: it has no validation yet.")
        elif last < run.total_steps:
            notes.append(
                f"{run.folder} is not finished: its last validation is after"
                f" {last:,} of {run.total_steps:,} steps."
            )
    return tuple(notes)


def _cell(number: Estimate, measure: str) -> str:
    ends = number.value, number.low, number.high
    return format_interval(*ends, percent=is_share(measure))


def _counted(number: Estimate) -> str:
    """Return a large number and its interval for people; a dash where unknown."""
    if math.isnan(number.value):
        return "-"
    ends = number.value, number.low, number.high
    value, low, high = ("never" if math.isinf(n) else f"{n:,.0f}" for n in ends)
    return value if math.isnan(number.low) else f"{value} ({low} to {high})"
