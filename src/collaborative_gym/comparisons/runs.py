"""Training runs, read from their folders, and grouped by the settings that differ."""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from collaborative_gym.errors import check_kind
from collaborative_gym.files import SealedRows, read_sealed
from collaborative_gym.learning.config import foreign
from collaborative_gym.learning.folder import CONFIG, PROGRESS

VALIDATION = "validation/"
"""Beginning of the columns with the measures of a validation."""

_REMEDY = (
    "continue the run, which writes it anew (train --resume), or leave the run out"
)
"""Remedy of a damaged file."""

_NO_SETTINGS = ("seed", "layout", "observation_sizes", "action_sizes", "start.metadata")
"""Settings that follow from others, or that make no groups."""

_NAMELESS = "algorithm", "mode"  # settings that need no name beside their value

_MOST_NAMED = 3
"""Settings in a method's name, even if fewer would distinguish the groups."""


@dataclass(frozen=True)
class TrainedRun:
    """A run as its folder has it, finished or not."""

    folder: Path
    identity: Mapping[str, Any]  # of its environment, as plain dictionaries
    settings: Mapping[str, Any]  # all others that its algorithm uses, by dotted name
    seed: int
    total_steps: int  # environment steps that it was to take
    rows: tuple[Mapping[str, float], ...]
    """Updates with a validation: `steps`, `core_seconds` where it is known, and the
    validation's means, such as `validation/completion`."""

    @classmethod
    def read(cls, folder: Path) -> "TrainedRun":
        """Return the run of a folder.

        Raises:
          OSError: if a file is missing or cannot be read.
          ValueError: if one is damaged; names it.
        """
        content = read_sealed(folder / CONFIG, _REMEDY)
        try:
            seed, identity = int(content["seed"]), dict(content.pop("identity"))
            total = int(content["hyperparameters"]["total_steps"])
        except (LookupError, TypeError, ValueError) as error:
            raise ValueError(
                f"{folder / CONFIG} is not from a training run: {error!r}"
            ) from None
        rows = tuple(
            {
                name: float(cell)
                for name, cell in row.items()
                if name in ("steps", "core_seconds") or name.startswith(VALIDATION)
            }
            for row in SealedRows.read(folder / PROGRESS, _REMEDY)
            if any(name.startswith(VALIDATION) for name in row)
        )
        algorithm = content.get("algorithm", "ppo")
        unused = {f"hyperparameters.{name}" for name in foreign(algorithm)}
        settings = {
            name.removeprefix("hyperparameters."): value
            for name, value in flat(content).items()
            if not (name in unused or name.startswith(_NO_SETTINGS))
        }
        return cls(folder, identity, settings, seed, total, rows)

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """Measures of each of its validations, such as "completion"."""
        shared = [n for n in in_all(self.rows[::-1]) if n.startswith(VALIDATION)]
        return tuple(name.removeprefix(VALIDATION) for name in shared)


def find_runs(paths: Sequence[str | Path]) -> list[TrainedRun]:
    """Return the runs in folders, at any depth, each once.

    Raises:
      FileNotFoundError: if there is no run in one of the folders.
      TypeError: if one is not a path.
      ValueError: if a file is damaged, or there is no folder.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        check_kind("each run", path, (str, Path), "a folder's name")
        own = sorted(Path(path).rglob(CONFIG)) if str(path) else []
        own = [config.parent for config in own if (config.parent / PROGRESS).is_file()]
        if not own:
            raise FileNotFoundError(
                f"there is no training run in {str(path)!r}; give folders that `train`"
                " wrote, or one that has them in it"
            )
        found |= {folder.resolve(): folder for folder in own}
    if not found:
        raise ValueError("there is nothing to compare; give folders of training runs")
    return [TrainedRun.read(folder) for folder in found.values()]


def in_all(lists: Iterable[Collection[str]]) -> tuple[str, ...]:
    """Return the names that all lists have, in the order of the first."""
    first, *others = lists
    return tuple(name for name in first if all(name in each for each in others))


def flat(content: Any, name: str = "") -> dict[str, Any]:
    """Return nested dictionaries as one, by dotted names."""
    if not isinstance(content, Mapping):
        return {name: content}
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= flat(value, f"{name}.{key}" if name else key)
    return found


def differing(contents: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the names whose values differ, with these values as texts.

    A name that some contents lack is compared among the others, because a later version
    of the package brought it.
    """
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for content in contents for name in content):
        texts = [as_text(content[name]) for content in contents if name in content]
        if len({*texts}) > 1:
            found[name] = list(dict.fromkeys(texts))
    return found


def as_text(value: Any) -> str:
    """Return a setting's value for people, such as "256 x 256" or "none"."""
    if isinstance(value, list | tuple):
        simple = all(isinstance(each, int | float | str) for each in value)
        of = " + " if any(isinstance(each, str) for each in value) else " x "
        return (of.join(map(str, value)) if simple else json.dumps(value)) or "none"
    return "none" if value in ("", None) else str(value)


@dataclass(frozen=True)
class Group:
    """Runs that differ by their seeds alone.

    Attributes:
      environment: its name, with differences from others of that name.
      method: the settings that tell it apart from other groups in an environment. Of
        many settings it has only as many as that takes, and "..." for the others.
      runs: by seed.
    """

    environment: str
    method: str
    runs: tuple[TrainedRun, ...]

    @property
    def title(self) -> str:
        """Environment and method."""
        return ": ".join(filter(None, (self.environment, self.method)))

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """Measures of all validations of its runs."""
        return in_all(run.measures for run in self.runs)

    @cached_property
    def steps(self) -> np.ndarray:
        """Environment steps after which all of its runs had a validation, ascending."""
        of_each = [{int(row["steps"]) for row in run.rows} for run in self.runs]
        return np.array(sorted(set.intersection(*of_each)), int)

    def values(self, measure: str) -> np.ndarray:
        """Return a measure of the validations, (runs, steps)."""
        found = []
        for run in self.runs:
            by_steps = {int(row["steps"]): row for row in run.rows}
            found.append([by_steps[n][VALIDATION + measure] for n in self.steps])
        return np.array(found)

    def scores(self, measure: str) -> np.ndarray:
        """Return a measure of the last validation that all runs have, (runs, 1)."""
        return self.values(measure)[:, -1:]


@dataclass(frozen=True)
class Grouping:
    """Groups of runs, and the settings with their values that tell them apart.

    `differences` are within an environment, and make the methods. `of_environments` are
    from one environment to another alone, as recipes have them; they are not compared.
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
    by_key = {}
    for run in runs:
        # Of teams, because a name that some lack is compared among the others.
        size = {"num_robots": len(run.identity["robots"])}
        by_key[_key(run)] = flat(run.identity) | size
    named: dict[str, str] = {}
    for key, identity in by_key.items():
        alike = [i for i in by_key.values() if i["name"] == identity["name"]]
        differences = differing(alike)
        # The digest of an arm's files says little beside anything else.
        names = [n for n in differences if not n.endswith(".digest")] or differences
        words = _words(identity, names)
        named[key] = f"{identity['name']} ({words})" if words else identity["name"]
    return named


def _key(run: TrainedRun) -> str:
    return json.dumps(run.identity, sort_keys=True)


def _enough(contents: Sequence[Mapping[str, Any]], names: Iterable[str]) -> list[str]:
    """Return the first names whose values tell the contents apart as all names do.

    Those of `_NAMELESS` come first, and always.
    """
    names = sorted(names, key=lambda name: name not in _NAMELESS)

    def told_apart(by: Sequence[str]) -> int:
        return len({tuple(as_text(each.get(n)) for n in by) for each in contents})

    least = sum(name in _NAMELESS for name in names)
    found: list[str] = []
    for i, name in enumerate(names):
        if i < least or told_apart([*found, name]) > told_apart(found):
            found.append(name)
    return found if len(names) > _MOST_NAMED else names


def _words(settings: Mapping[str, Any], names: Sequence[str] | Mapping) -> str:
    words = []
    for name in names:
        if name in settings:
            # Among a name's parts, the first ones say where, and "name" says nothing.
            *_, last = name.removesuffix(".name").split(".")
            value = as_text(settings[name])
            words.append(value if name in _NAMELESS else f"{last} {value}")
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
