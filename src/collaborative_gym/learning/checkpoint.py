"""Everything that a training run needs to go on, in one file."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from collaborative_gym.files import replacing
from collaborative_gym.learning.config import Hyperparameters, Mode

LAST, BEST = "last.pt", "best.pt"
"""Names of the files in a run's folder."""

_FORMAT = "collaborative_gym training 1"


@dataclass(frozen=True)
class Settings:
    """What a run was started with.

    Attributes:
      environment: the environment's id, or the task's name.
      robots: the arms' names, in the order of the agents.
      randomization: bounds of the episodes' starts.
      mode: who learns what.
      seed: of the run.
      backend: the library that learns.
      observation_sizes: by agent.
      action_sizes: by agent.
      hyperparameters: how it learns.
    """

    environment: str
    robots: tuple[str, ...]
    randomization: Mapping[str, float]
    mode: Mode
    seed: int
    backend: str
    observation_sizes: Mapping[str, int]
    action_sizes: Mapping[str, int]
    hyperparameters: Hyperparameters

    @property
    def title(self) -> str:
        """What to call the run."""
        robots = ", ".join(self.robots)
        return f"{self.environment} ({robots}), {self.mode}, seed {self.seed}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain lists, dictionaries, numbers and texts."""
        content = asdict(self)
        content["robots"] = list(self.robots)
        sizes = content["hyperparameters"]["hidden_sizes"]
        content["hyperparameters"]["hidden_sizes"] = list(sizes)
        return content

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Settings":
        """Return what `to_dict` was made of."""
        numbers = dict(content["hyperparameters"])
        numbers["hidden_sizes"] = tuple(numbers["hidden_sizes"])
        return cls(
            **{
                **content,
                "robots": tuple(content["robots"]),
                "hyperparameters": Hyperparameters(**numbers),
            }
        )


@dataclass(frozen=True)
class Checkpoint:
    """A run at the end of an update.

    Attributes:
      settings: what it was started with.
      backend: the backend's state.
      rows: what `Monitor` has shown so far.
      best: the validated return of the best policy so far, and its `steps`; empty
        before the first validation.
      seconds: time that the run has taken so far.
    """

    settings: Settings
    backend: dict[str, Any]
    rows: list[dict[str, float]]
    best: dict[str, float]
    seconds: float

    def save(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
          OSError: if it cannot be written; a file that was there before is untouched.
        """
        content = {
            "format": _FORMAT,
            "settings": self.settings.to_dict(),
            "backend": self.backend,
            "rows": self.rows,
            "best": self.best,
            "seconds": self.seconds,
        }
        # In memory first: torch's own writing hides that a disk is full.
        whole = BytesIO()
        torch.save(content, whole)
        with replacing(path) as partial, open(partial, "wb") as file:
            try:
                file.write(whole.getbuffer())
                # Else it may be empty in its place if the power fails.
                file.flush()
                os.fsync(file.fileno())
            except OSError as error:
                raise OSError(f"cannot write {path}: {error.strerror}") from error

    @classmethod
    def load(cls, path: Path) -> "Checkpoint":
        """Return the run of a file.

        Raises:
          FileNotFoundError: if there is no such file.
          ValueError: if it is damaged, or no checkpoint of this version.
        """
        if not path.is_file():
            raise FileNotFoundError(f"no checkpoint {path}")
        try:
            # Only data: a file from elsewhere cannot run code.
            content = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # torch raises many kinds for a damaged file.
            reason = str(error).partition("\n")[0]
            raise ValueError(
                f"{path} is no checkpoint, or is damaged: {reason}"
            ) from error
        found = content.get("format") if isinstance(content, dict) else None
        if found != _FORMAT:
            raise ValueError(
                f"{path} is no checkpoint of this version: its format is {found!r}, not"
                f" {_FORMAT!r}"
            )
        try:
            return cls(
                Settings.from_dict(content["settings"]),
                content["backend"],
                content["rows"],
                content["best"],
                content["seconds"],
            )
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"{path} is no checkpoint of this version: {error}"
            ) from error
