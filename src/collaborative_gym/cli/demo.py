"""The pictures and films of the tour that `make demo` takes."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from collaborative_gym.evaluation import table11
from collaborative_gym.evaluation.machine import cores
from collaborative_gym.pictures import recording
from collaborative_gym.policies.policy import is_shipped
from collaborative_gym.tasks.registry import make_task

_SHEET_SIZE = (480, 270)
"""Width and height of one picture of the contact sheet, in pixels."""

_GAME, _GAME_STEPS, _GAME_EPISODE = "HockeyPandas-v0", 100, 6
"""A game, its control steps, and an episode in which the baseline scores a goal."""

_FILM_SIZE = (640, 360)  # width and height of a film, in pixels

_SECONDS = 6.0
"""Least length of a film, in s. Without a graphics card, a second of it takes
two seconds of a core."""


def program() -> str:
    """Return the words that call the command line again as it was called."""
    path = Path(sys.argv[0])
    is_script = path.name == "collaborative-gym"
    return str(path) if is_script else "python -m collaborative_gym"


def players() -> dict[str, str]:
    """Return who plays, by environment id: the baseline, or the expert without one."""
    return {env_id: _best(env_id) for env_id in table11.THESIS}


def _best(env_id: str) -> str:
    return "baseline" if is_shipped("baseline", env_id) else "expert"


def draw(folder: Path) -> Iterator[Path]:
    """Draw all environments, then film them and a game; yield each file.

    The first file is a contact sheet of pictures, which takes seconds.

    Args:
      folder: where the files go.
    """
    cast = players()
    sides = {"robot_1": _best(_GAME), "robot_2": "expert"}
    films = [
        (env_id, policy, folder / f"{env_id}.mp4")
        for env_id, policy in (*cast.items(), (_GAME, sides))
    ]
    spawn = multiprocessing.get_context("spawn")
    # Leaving the pool early, as Ctrl-C does, ends its processes at once.
    with spawn.Pool(min(cores(), len(films)), _begin_worker) as pool:
        draw_one = partial(recording.picture, size=_SHEET_SIZE)
        pictures = pool.starmap(draw_one, cast.items(), chunksize=1)
        yield recording.contact_sheet(pictures, [*cast], folder / "contact_sheet.png")
        yield from pool.imap(_film_one, films)
        pool.close()
        pool.join()


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and clean up when the parent ends this process."""
    # Mesa's software renderer: there is a process per CPU already.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _film_one(job: tuple[str, str | dict[str, str], Path]) -> Path:
    env_id, policy, output = job
    task = make_task(env_id)
    what: dict[str, Any] = {"seconds": _SECONDS}
    if env_id == _GAME:
        task = make_task(env_id, max_episode_steps=_GAME_STEPS)
        what = {"only_episodes": [_GAME_EPISODE]}
    return recording.record(task, output, policy=policy, size=_FILM_SIZE, **what)
