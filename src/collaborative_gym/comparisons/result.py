"""What came of a comparison of runs: tables, JSON, CSV, Markdown, marl-eval's JSON."""

import csv
import io
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from collaborative_gym.comparisons.grouping import Group, Grouping
from collaborative_gym.comparisons.runs import VALIDATION
from collaborative_gym.evaluation.intervals import (
    Estimate,
    chance_of,
    iqm_of,
    mean_of,
    median_of,
    share_of,
)
from collaborative_gym.evaluation.report import format_interval, without_nan
from collaborative_gym.evaluation.table import escaped, markdown_table

_GOAL = 0.9
"""Completion that counts as learned."""

_SHARES = ("completion", "performance", "points")
"""Measures from 0 to 1, which can be put together over environments."""

_POINTS = 51
"""Scores at which a performance profile is told."""

Table = tuple[str, list[str], list[list[str]]]
"""A title, the columns' heads, and the lines' cells, for people."""


@dataclass(frozen=True)
class Entry:
    """One of those that are compared: a group, or a method over environments.

    Attributes:
      environment: which, or how many.
      method: what tells it from others there; empty where nothing does.
      groups: one for each environment.
    """

    environment: str
    method: str
    groups: tuple[Group, ...]

    def scores(self, measure: str) -> list[np.ndarray]:
        """Return the last validations by environment, each (runs, 1)."""
        return [group.scores(measure) for group in self.groups]

    @property
    def num_runs(self) -> int:
        """How many runs it has."""
        return sum(len(group.runs) for group in self.groups)


@dataclass(frozen=True)
class Aggregates:
    """What the scores of runs come to, with intervals over seeds.

    Attributes:
      iqm: interquartile mean, that of the middle half.
      median: the middle one.
      mean: the mean.
    """

    iqm: Estimate
    median: Estimate
    mean: Estimate


@dataclass(frozen=True)
class Reached:
    """When runs first completed 90 % of a validation's episodes.

    Attributes:
      runs: how many did so.
      steps: the median of the environment steps that it took; infinite where half of
        the runs never did.
      core_seconds: the median of the CPU time that it took, in s; NaN where it is not
        known.
    """

    runs: int
    steps: Estimate
    core_seconds: Estimate


@dataclass(frozen=True)
class Comparison:
    """How groups of training runs did.

    The score of a run is the mean of its last validation, of those that all runs of its
    group have. Intervals are of 95 % and over runs, within each environment: Student's
    t for means, Yuen's for interquartile means, Wilson's for shares of runs and where
    all runs score alike, DeLong's for probabilities, and for medians those between two
    runs. A group of one run has none, and a median none of fewer than five.

    Attributes:
      grouping: the groups, and what they differ in.
      measures: what all validations measured.
      measure: the one of `profiles` and `improvements`.
      notes: what readers must know of runs that have not come to their end.
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
        """The names of all."""
        return tuple(dict.fromkeys(group.environment for group in self.groups))

    @cached_property
    def methods(self) -> tuple[str, ...]:
        """The names of all; one without words where only environments differ."""
        return tuple(dict.fromkeys(group.method for group in self.groups))

    @cached_property
    def contestants(self) -> dict[str, Entry]:
        """Who is compared with whom, by name.

        That is the methods, over the environments in which there are all of them; or
        the environments, where there is one method.
        """
        if len(self.methods) == 1:
            return {g.environment: Entry(g.environment, "", (g,)) for g in self.groups}
        shared = [
            each
            for each in self.environments
            if all((each, method) in self._by for method in self.methods)
        ]
        where = shared[0] if len(shared) == 1 else f"{len(shared)} environments"
        return {
            method: Entry(
                where, method, tuple(self._by[each, method] for each in shared)
            )
            for method in (self.methods if shared else ())
        }

    @cached_property
    def _by(self) -> dict[tuple[str, str], Group]:
        return {(group.environment, group.method): group for group in self.groups}

    @cached_property
    def entries(self) -> tuple[Entry, ...]:
        """All groups, and the methods over several environments where there are."""
        own = [Entry(each.environment, each.method, (each,)) for each in self.groups]
        together = [e for e in self.contestants.values() if len(e.groups) > 1]
        return (*own, *together)

    def aggregates(self, entry: Entry, measure: str) -> Aggregates:
        """Return what the scores of an entry come to."""
        strata, share = entry.scores(measure), is_share(measure)
        return Aggregates(
            iqm_of(strata, is_share=share)[0],
            median_of(strata)[0],
            mean_of(strata, is_share=share)[0],
        )

    def curve(self, group: Group, measure: str) -> list[Estimate]:
        """Return the interquartile mean of a group's validations, by `group.steps`."""
        return iqm_of([group.values(measure)], is_share=is_share(measure))

    @cached_property
    def levels(self) -> np.ndarray:
        """The scores at which profiles are told, ascending."""
        ends = 0.0, 1.0
        if not is_share(self.measure):
            scores = np.concatenate(
                [each for e in self.contestants.values() for each in self._scores(e)]
            )
            ends = scores.min(), scores.max()
        return np.linspace(*ends, _POINTS)

    def _scores(self, entry: Entry) -> list[np.ndarray]:
        return entry.scores(self.measure)

    @cached_property
    def profiles(self) -> dict[str, list[Estimate]]:
        """By contestant, the share of runs that score at least each of `levels`."""
        return {
            name: share_of(np.concatenate(self._scores(entry)) >= self.levels)
            for name, entry in self.contestants.items()
        }

    @cached_property
    def improvements(self) -> dict[tuple[str, str], Estimate]:
        """By two contestants, how likely a run of the first beats one of the second.

        A tie counts a half. It is the mean over environments.
        """
        found = {}
        for one, other in combinations(self.contestants, 2):
            first, second = (self._scores(self.contestants[n]) for n in (one, other))
            # Of several environments, each has runs of both.
            pairs = zip(map(np.ravel, first), map(np.ravel, second), strict=True)
            found[one, other] = chance_of(pairs)
        return found

    def reached(self, group: Group) -> Reached | None:
        """Return when runs learned the task; None where nothing can be completed."""
        if VALIDATION + "completion" not in group.runs[0].rows[0]:
            return None
        firsts = [
            next(
                (row for row in run.rows if row[VALIDATION + "completion"] >= _GOAL), {}
            )
            for run in group.runs
        ]
        medians = []
        for name in ("steps", "core_seconds"):
            taken = [
                first.get(name, math.nan) if first else math.inf for first in firsts
            ]
            medians += median_of([np.array(taken)[:, None]])
        return Reached(sum(map(bool, firsts)), *medians)

    @cached_property
    def statement(self) -> str:
        """What was compared, and what it differs in, as sentences."""
        count = sum(len(group.runs) for group in self.groups)
        seeds = sorted({run.seed for group in self.groups for run in group.runs})
        runs = "1 run" if count == 1 else f"{count} runs"
        seed = "seed" if len(seeds) == 1 else "seeds"
        lines = [f"{runs}, {seed} {', '.join(map(str, seeds))}."]
        named = dict(self.grouping.differences)
        if len(self.environments) > 1:
            named = {"environment": list(self.environments), **named}
        told = "; ".join(f"{name} ({', '.join(v)})" for name, v in named.items())
        if count > 1:
            lines.append(
                f"They differ in {told}." if told else "They differ in nothing else."
            )
        others = self.grouping.of_environments
        if others:
            told = "; ".join(f"{name} ({', '.join(v)})" for name, v in others.items())
            lines.append(f"From one environment to another alone differ {told}.")
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
                    told = (_told(each, measure) for each in (own.iqm, own.median))
                    lines.append([*self._cells(entry), *told])
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
            [one, other, _told(chance, "points")]
            for (one, other), chance in self.improvements.items()
        ]
        if lines:
            heads = ["a run of", "beats one of", "with probability (95 %)"]
            yield f"probability of improvement, {self.measure}", heads, lines

    def _cells(self, entry: Entry) -> list[str]:
        ends = sorted({int(group.steps[-1]) for group in entry.groups})
        steps = " to ".join(
            f"{each / 1e6:.3g} M" for each in dict.fromkeys([ends[0], ends[-1]])
        )
        return [
            entry.environment,
            entry.method or "-",
            f"{entry.num_runs} (of {steps} steps)",
        ]

    def to_markdown(self) -> str:
        """Return the statement and the tables as Markdown."""
        parts = [escaped(line) for line in self.statement.split("\n")]
        for title, heads, lines in self.tables():
            parts += [f"**{escaped(title)}**", markdown_table(heads, lines)]
        return "\n\n".join(parts) + "\n"

    def to_csv(self) -> str:
        """Return the learning curves, a row for each group, measure and validation."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        heads = ["environment", "method", "runs", "measure", "steps"]
        writer.writerow([*heads, "iqm", "iqm_low", "iqm_high", "median", "mean"])
        for group, measure in self._curves():
            first = group.environment, group.method, len(group.runs), measure
            values = group.values(measure)
            for i, at in enumerate(self.curve(group, measure)):
                others = np.median(values[:, i]), np.mean(values[:, i])
                cells = [at.value, at.low, at.high, *map(float, others)]
                cells = ["" if math.isnan(cell) else cell for cell in cells]
                writer.writerow([*first, int(group.steps[i]), *cells])
        return text.getvalue()

    def _curves(self) -> Iterator[tuple[Group, str]]:
        for group in self.groups:
            for measure in self.measures:
                yield group, measure

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
                | {m: asdict(self.aggregates(entry, m)) for m in self.measures}
                for entry in self.entries
            ],
            "levels": self.levels.tolist() if self.contestants else [],
            "profiles": {
                name: [asdict(each) for each in profile]
                for name, profile in self.profiles.items()
            },
            "improvements": [
                {"one": one, "other": other, **asdict(chance)}
                for (one, other), chance in self.improvements.items()
            ],
        }
        return json.dumps(without_nan(content), indent=1) + "\n"

    def _plain(self, group: Group) -> dict[str, Any]:
        reached = self.reached(group)
        return {
            "environment": group.environment,
            "method": group.method,
            "runs": {str(run.folder): run.seed for run in group.runs},
            "steps": group.steps.tolist(),
            "validations": {m: group.values(m).tolist() for m in self.measures},
            "reached": None if reached is None else asdict(reached),
        }

    def to_marl_eval(self) -> str:
        """Return the validations as the JSON that the package id-marl-eval reads.

        Tasks are the environments, algorithms the methods, and names of runs the seeds.
        The `absolute_metrics` are those of the last validation, by which this compares
        too. marl-eval wants as many runs and validations everywhere, and all methods in
        all environments.
        """
        tasks: dict[str, Any] = {}
        for group in self.groups:
            # Its own code refuses commas.
            method = (group.method or "ppo").replace(", ", "; ").replace(",", ";")
            values = {m: group.values(m) for m in self.measures}
            for i, run in enumerate(group.runs):
                steps: dict[str, Any] = {
                    f"step_{k + 1}": {"step_count": int(count)}
                    | {m: [float(of[i, k])] for m, of in values.items()}
                    for k, count in enumerate(group.steps)
                }
                last = {m: [float(of[i, -1])] for m, of in values.items()}
                steps["absolute_metrics"] = last
                algorithms = tasks.setdefault(group.environment, {})
                algorithms.setdefault(method, {})[f"seed_{run.seed}"] = steps
        return json.dumps({"collaborative_gym": tasks}, indent=1) + "\n"


def is_share(measure: str) -> bool:
    """Return whether a measure is from 0 to 1."""
    return measure.rpartition("/")[2] in _SHARES


def _told(number: Estimate, measure: str) -> str:
    """Return a score and its interval for people."""
    ends = number.value, number.low, number.high
    return format_interval(*ends, percent=is_share(measure))


def _counted(number: Estimate) -> str:
    """Return how much it took and its interval for people; a dash where unknown."""
    ends = [number.value] + [number.low, number.high] * (not math.isnan(number.low))
    told = ["never" if math.isinf(end) else f"{end:,.0f}" for end in ends]
    if math.isnan(number.value):
        return "-"
    return told[0] if len(told) == 1 else f"{told[0]} ({told[1]} to {told[2]})"
