"""All that a training run needs to go on, in one file."""

import os
from dataclasses import dataclass, field
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from collaborative_gym.files import replacing
from collaborative_gym.learning.folder import BEST, LAST, no_checkpoint
from collaborative_gym.learning.settings import Settings

_FORMAT = b"collaborative_gym training 6\n"
"""Begins the file. The SHA-256 of the rest comes next, then the rest, torch's own."""


@dataclass(frozen=True)
class Checkpoint:
    """A run at the end of an update.

    Attributes:
      settings: with which it was started.
      backend: the state of learners and worlds, from `Run.state_dict`.
      rows: of `Monitor` so far.
      best: the validated return of the best policy so far, and its `steps`; empty
        before the first validation.
      seconds: time that the run has taken so far.
      pool: the state of its pool of guests.
    """

    settings: Settings
    backend: dict[str, Any]
    rows: list[dict[str, float]]
    best: dict[str, float]
    seconds: float
    pool: dict[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
          OSError: if it cannot be written; a file that was there before is untouched.
        """
        content = vars(self) | {"settings": self.settings.to_dict()}
        # In memory first: torch's own writing hides that a disk is full.
        whole = BytesIO()
        torch.save(content, whole)
        with replacing(path) as partial, open(partial, "wb") as file:
            file.write(_FORMAT + sha256(whole.getbuffer()).digest())
            file.write(whole.getbuffer())
            # Otherwise the file may be empty if the power fails.
            file.flush()
            os.fsync(file.fileno())

    @classmethod
    def load(cls, path: Path) -> "Checkpoint":
        """Return the run of a file.

        Raises:
          FileNotFoundError: if there is no such file.
          ValueError: if a bit of it is damaged, or it is not of this version.
        """
        if not path.is_file():
            raise no_checkpoint(path)
        whole = path.read_bytes()
        start = len(_FORMAT) + sha256().digest_size
        if not whole.startswith(_FORMAT):
            raise _unusable(path, "no checkpoint of this version, or damaged")
        rest = memoryview(whole)[start:]
        if sha256(rest).digest() != whole[len(_FORMAT) : start]:
            raise _unusable(path, "damaged: its content does not match its digest")
        try:
            # Only data: a file from elsewhere cannot run code.
            content = torch.load(BytesIO(rest), "cpu", weights_only=True)
            content["settings"] = Settings.from_dict(content["settings"])
            return cls(**content)
        except Exception as error:  # torch raises many kinds.
            reason = str(error).partition("\n")[0]
            what = f"no checkpoint of this version ({reason})"
            raise _unusable(path, what) from error


def _unusable(path: Path, reason: str) -> ValueError:
    other = BEST if path.name == LAST else LAST
    return ValueError(
        f"{path} is {reason}; copy {other} over it to go on from there, or start"
        " another run"
    )
