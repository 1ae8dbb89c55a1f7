"""Runs put into groups by whatever differs between them but their seeds."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from collaborative_gym.comparisons.runs import (
    VALIDATION,
    TrainedRun,
    differing,
    flat,
    told,
)

_TOLD_ALONE = "algorithm", "mode"
"""Settings whose values say what they are."""

_MOST_NAMED = 3
"""Settings that a name may have if fewer would tell the groups apart."""


@dataclass(frozen=True)
class Group:
    """Runs that differ by their seeds alone.

    Attributes:
      environment: the name of their environment, with what tells it apart from others
        of that name.
      method: what tells their settings apart from those of other groups in an
        environment. Of many settings it has only as many as that takes, and "..." for
        the others.
      runs: by seed.
    """

    environment: str
    method: str
    runs: tuple[TrainedRun, ...]

    @property
    def title(self) -> str:
        """What to call it."""
        return ": ".join(filter(None, (self.environment, self.method)))

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """What the validations of all of its runs measured."""
        first, *others = (run.measures for run in self.runs)
        return tuple(name for name in first if all(name in each for each in others))

    @cached_property
    def steps(self) -> np.ndarray:
        """Environment steps after which all of its runs had a validation, ascending."""
        of_each = [{int(row["steps"]) for row in run.rows} for run in self.runs]
        return np.array(sorted(set.intersection(*of_each)), int)

    def values(self, measure: str) -> np.ndarray:
        """Return what the validations measured, (runs, steps)."""
        return np.array(
            [
                [by_steps[steps][VALIDATION + measure] for steps in self.steps]
                for run in self.runs
                for by_steps in [{int(row["steps"]): row for row in run.rows}]
            ]
        )

    def scores(self, measure: str) -> np.ndarray:
        """Return what the last validation measured that all runs have, (runs, 1)."""
        return self.values(measure)[:, -1:]


@dataclass(frozen=True)
class Grouping:
    """Groups, and what tells them apart.

    Attributes:
      groups: of all runs.
      differences: settings that differ within an environment, which make the methods,
        with their values.
      of_environments: settings that differ from one environment to another alone, as
        recipes do; they are not compared.
    """

    groups: tuple[Group, ...]
    differences: Mapping[str, list[str]]
    of_environments: Mapping[str, list[str]]


def group_runs(runs: Sequence[TrainedRun]) -> Grouping:
    """Return runs in groups.

    Raises:
      ValueError: if two are of one group and seed, or have no validation in common.
    """
    environments = _environments(runs)
    by_environment: dict[str, list[TrainedRun]] = {}
    for run in runs:
        by_environment.setdefault(environments[_key(run)], []).append(run)
    differences: dict[str, list[str]] = {}
    for own in by_environment.values():
        for name, values in differing([run.settings for run in own]).items():
            known = differences.setdefault(name, [])
            known += [value for value in values if value not in known]
    members: dict[tuple[str, str], list[TrainedRun]] = {}
    named = _enough([run.settings for run in runs], differences)
    for environment, own in by_environment.items():
        for run in own:
            words = _words(run.settings, named)
            if len(named) < len(differences):
                words += ", ..."
            members.setdefault((environment, words), []).append(run)
    groups = tuple(
        _checked(Group(*names, tuple(sorted(own, key=lambda run: run.seed))))
        for names, own in members.items()
    )
    of_all = differing([run.settings for run in runs])
    others = {name: of_all[name] for name in of_all if name not in differences}
    return Grouping(groups, differences, others)


def _environments(runs: Sequence[TrainedRun]) -> dict[str, str]:
    """Return what to call the environments, by `_key`."""
    by_key = {_key(run): run.identity for run in runs}
    named: dict[str, str] = {}
    for key, identity in by_key.items():
        alike = [i for i in by_key.values() if i["name"] == identity["name"]]
        differences = differing([flat(each) for each in alike])
        # The digest of an arm's files says little beside anything else.
        names = [n for n in differences if not n.endswith(".digest")] or differences
        words = _words(flat(identity), names)
        named[key] = f"{identity['name']} ({words})" if words else identity["name"]
    return named


def _key(run: TrainedRun) -> str:
    return json.dumps(run.identity, sort_keys=True)


def _enough(contents: Sequence[Mapping[str, Any]], names: Iterable[str]) -> list[str]:
    """Return the first of the names whose values tell the contents apart as all do.

    Values that say what they are come first, and always.
    """
    names = sorted(names, key=lambda name: name not in _TOLD_ALONE)

    def told_apart(by: Sequence[str]) -> int:
        return len({tuple(told(each.get(name)) for name in by) for each in contents})

    least = sum(name in _TOLD_ALONE for name in names)
    found: list[str] = []
    for i, name in enumerate(names):
        if i < least or told_apart([*found, name]) > told_apart(found):
            found.append(name)
    return found if len(names) > _MOST_NAMED else names


def _words(settings: Mapping[str, Any], names: Sequence[str] | Mapping) -> str:
    """Return what these settings are, such as "collaborative, discount 0.9"."""
    words = []
    for name in names:
        if name in settings:
            # Among a name's parts, the first ones say where, and "name" says nothing.
            *_, last = name.removesuffix(".name").split(".")
            value = told(settings[name])
            words.append(value if name in _TOLD_ALONE else f"{last} {value}")
    return ", ".join(words)


def _checked(group: Group) -> Group:
    for one, other in zip(group.runs, group.runs[1:], strict=False):
        if one.seed == other.seed:
            raise ValueError(
                f"{one.folder} and {other.folder} have the same settings and the seed"
                f" {one.seed}, and would count twice; give one of them"
            )
    if not len(group.steps):
        raise ValueError(
            f"no number of steps is validated in all {len(group.runs)} runs of"
            f" {group.title}; give runs with one validation_interval"
        )
    return group
