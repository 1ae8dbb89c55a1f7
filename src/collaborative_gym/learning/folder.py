"""The folder of a run, in which one process at a time may write."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree

from collaborative_gym.files import make_folder, naming
from collaborative_gym.policies.policy import POLICY_FILE, player_file

try:
    import fcntl
except ImportError:  # On Windows, where nothing keeps two runs apart.
    fcntl = None

LAST, BEST = "last.pt", "best.pt"
"""Checkpoints: the last one, and the one of the best policy."""

CONFIG, CURVE, LOCK, PROGRESS = "config.json", "curve.png", "run.lock", "progress.csv"

LEAGUE_FILE, RATINGS = "league.json", "ratings.png"
"""Files about the players of a league."""

_FILES = (LAST, BEST, CONFIG, CURVE, PROGRESS, LEAGUE_FILE, RATINGS)


@contextmanager
def claimed(folder: Path, wanted: str | None = None) -> Iterator[None]:
    """Keep other runs out of a folder, which is made if it is missing, for a while.

    The lock is the kernel's, which frees it however the process ends. Files that a
    killed run had half written are removed.

    Args:
      folder: the folder.
      wanted: a file that must be there already, if any.

    Raises:
      BlockingIOError: if a run is under way in it; names the process.
      FileNotFoundError: if the file that is wanted is not there.
      OSError: if nothing can be written there.
    """
    if wanted is not None and not (folder / wanted).is_file():
        raise no_checkpoint(folder / wanted)
    with naming(folder / LOCK):
        make_folder(folder)
        # The file stays: a run that waits for it would otherwise hold no lock.
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        _lock(descriptor, folder)
        for name in (*_FILES, POLICY_FILE):
            for partial in folder.glob(f".{Path(name).stem}.*.partial"):
                rmtree(partial, ignore_errors=True)
        for partial in (folder / player_file("")).parent.glob(".*.partial"):
            rmtree(partial, ignore_errors=True)
        yield
    finally:
        os.close(descriptor)


def no_checkpoint(path: Path) -> FileNotFoundError:
    """Return the error where a checkpoint is missing."""
    return FileNotFoundError(
        f"there is no checkpoint {path}; give the folder of a run, or start it again if"
        " it was stopped before its first update"
    )


def _lock(descriptor: int, folder: Path) -> None:
    with naming(folder / LOCK):
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            process = os.pread(descriptor, 20, 0).decode() or "another process"
            raise BlockingIOError(
                f"{process} is at work in {folder}; let it end, or choose another"
                " folder"
            ) from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()}".encode())
