"""The films of the tour that `make demo` takes."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from collaborative_gym.evaluation.machine import cores
from collaborative_gym.pictures import recording

_SHEET_SIZE = (480, 360)
"""Width and height of one picture of the contact sheet, in pixels."""


def film(policies: Mapping[str, str], folder: Path) -> Iterator[Path]:
    """Record environments, several at a time, and yield the files.

    The last file is a contact sheet of all of them.

    Args:
      policies: who plays, by environment id.
      folder: where the files go.
    """
    jobs = [
        (env_id, policy, folder / f"{env_id}.mp4")
        for env_id, policy in policies.items()
    ]
    spawn = multiprocessing.get_context("spawn")
    pictures = []
    # Leaving the pool early, as Ctrl-C does, ends its processes at once.
    with spawn.Pool(min(cores(), len(jobs)), _begin_worker) as pool:
        for (*_, output), picture in zip(jobs, pool.imap(_film_one, jobs), strict=True):
            pictures.append(picture)
            yield output
        pool.close()
        pool.join()
    yield recording.contact_sheet(
        pictures, list(policies), folder / "contact_sheet.png"
    )


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and clean up when the parent ends this process."""
    # Mesa's software renderer: there is a process per CPU already.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _film_one(job: tuple[str, str, Path]) -> np.ndarray:
    """Record one video and return the picture for the contact sheet."""
    env_id, policy, output = job
    recording.record(env_id, output, policy=policy)
    return recording.picture(env_id, policy, size=_SHEET_SIZE)
