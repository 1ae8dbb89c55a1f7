"""MuJoCo's warnings, kept off the terminal and out of the user's folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

import mujoco

_lock = Lock()
_within: list[mujoco.MjLogConfig] = []
"""How MuJoCo logged before, once for each thread that wants it quiet."""


@contextmanager
def quiet() -> Iterator[None]:
    """Let MuJoCo neither print its warnings nor write MUJOCO_LOG.TXT for a while.

    Whoever calls it reads the counts of warnings and reports them. Simulations of the
    user's own warn as before, unless they run in another thread at the same moment; so
    does a handler that the user gave MuJoCo.
    """
    with _lock:
        _within.append(_within[0] if _within else mujoco.MjLogConfig.get())
        silent = mujoco.MjLogConfig.get()
        silent.logto_console = silent.logto_file = False
        silent.set()
    try:
        yield
    finally:
        with _lock:
            usual = _within.pop()
            if not _within:
                usual.set()
