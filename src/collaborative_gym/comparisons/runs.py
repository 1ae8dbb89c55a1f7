"""Runs that are there, read from their folders, and what they differ in."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from collaborative_gym.errors import check_kind
from collaborative_gym.files import SealedRows, read_sealed
from collaborative_gym.learning.config import foreign
from collaborative_gym.learning.folder import CONFIG, PROGRESS

VALIDATION = "validation/"
"""Begins the columns of what a validation measured."""

_REMEDY = (
    "continue the run, which writes it anew (train --resume), or leave the run out"
)
"""What to do about a damaged file."""

_NO_SETTINGS = ("seed", "layout", "observation_sizes", "action_sizes", "start.metadata")
"""Settings that follow from others, or that shall not tell runs apart."""


@dataclass(frozen=True)
class TrainedRun:
    """A run as its folder has it, finished or not.

    Attributes:
      folder: where it is.
      identity: its environment's, as plain dictionaries.
      settings: all else that it was started with but its seed, by dotted name, without
        what means nothing to its algorithm.
      seed: of the run.
      total_steps: environment steps that it was to take.
      rows: of the updates after which there was a validation, with `steps`,
        `core_seconds` where it is known, and the validation's means, such as
        `validation/completion`.
    """

    folder: Path
    identity: Mapping[str, Any]
    settings: Mapping[str, Any]
    seed: int
    total_steps: int
    rows: tuple[Mapping[str, float], ...]

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
        rows = tuple(_validations(folder / PROGRESS))
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
        """What each of its validations measured, such as "completion"."""
        names = (n for n in self.rows[-1] if n.startswith(VALIDATION))
        shared = [n for n in names if all(n in row for row in self.rows)]
        return tuple(name.removeprefix(VALIDATION) for name in shared)


def find_runs(paths: Sequence[str | Path]) -> list[TrainedRun]:
    """Return the runs in folders, at any depth, each once.

    Args:
      paths: folders of runs, or folders that have such in them.

    Raises:
      FileNotFoundError: if there is no run in one of them.
      TypeError: if one is not a path.
      ValueError: if a file is damaged, or there is no path.
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


def flat(content: Any, name: str = "") -> dict[str, Any]:
    """Return nested dictionaries as one, by dotted names."""
    if not isinstance(content, Mapping):
        return {name: content}
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= flat(value, f"{name}.{key}" if name else key)
    return found


def differing(contents: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return as texts the values of all names whose values differ.

    A name that some do not have is compared among the others, because a later version
    of the package brought it.

    Args:
      contents: with a value by name.
    """
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for content in contents for name in content):
        texts = [told(content[name]) for content in contents if name in content]
        if len({*texts}) > 1:
            found[name] = list(dict.fromkeys(texts))
    return found


def told(value: Any) -> str:
    """Return a setting's value for people, such as "256 x 256" or "none"."""
    if isinstance(value, list | tuple):
        simple = all(isinstance(each, int | float | str) for each in value)
        of = " + " if any(isinstance(each, str) for each in value) else " x "
        return (of.join(map(str, value)) if simple else json.dumps(value)) or "none"
    return "none" if value in ("", None) else str(value)


def _validations(path: Path) -> Iterator[Mapping[str, float]]:
    """Yield what a run's file tells of its validations."""
    for row in SealedRows.read(path, _REMEDY):
        kept = {
            name: float(cell)
            for name, cell in row.items()
            if name in ("steps", "core_seconds") or name.startswith(VALIDATION)
        }
        if any(name.startswith(VALIDATION) for name in kept):
            yield kept
