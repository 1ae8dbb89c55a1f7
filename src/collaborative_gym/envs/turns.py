"""Turns in which threads use an environment, and the end of a call that fails."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Turns:
    """Lets one thread at a time use an environment, in the process that made it."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._lock, self._visitor = threading.RLock(), ""
        self._is_changing = False

    @contextmanager
    def take(
        self, keep: Callable[[], Callable[[], None]] | None = None
    ) -> Iterator[None]:
        """Let the calling thread in, and undo what fails by what `keep` returned.

        The same thread may come in again, as a watcher that draws a picture does.

        Raises:
          RuntimeError: in another process, while another thread is inside, or for a
            change in the middle of another change.
        """
        # A fork has copies of the locks, but none of the threads that step the physics.
        if os.getpid() != self._process:
            raise RuntimeError(
                "this environment belongs to the process that made it, and cannot be"
                " used in one that was forked from it; make another here, or start"
                " processes by the method 'spawn'"
            )
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                f"thread {self._visitor!r} is inside this environment, which serves one"
                " thread at a time; make one for each thread, or take turns by a lock"
            )
        outer, put_back = self._is_changing, None
        try:
            self._visitor = threading.current_thread().name
            if keep is not None:
                if outer:
                    raise RuntimeError(
                        "the environment is in the middle of a step; a watcher may"
                        " look and draw, but not step, reset or set the state"
                    )
                put_back, self._is_changing = keep(), True
            yield
        except BaseException:
            if put_back is not None:
                put_back()
            raise
        finally:
            self._is_changing = outer
            self._lock.release()
