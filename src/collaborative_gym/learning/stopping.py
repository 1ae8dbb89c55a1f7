"""Ctrl-C ends a run once the update under way is done and saved."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_ANSWER = b"\nstopping after the current update; Ctrl-C again stops at once\n"


@contextmanager
def ctrl_c(then: str) -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C sets while the context lasts; a second one interrupts.

    An answer comes at once, on standard error, because an update may take a while.

    Args:
      then: how the run is continued; the end of a `KeyboardInterrupt`'s words.
    """
    pressed = threading.Event()

    def press(*_: object) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        # A signal may come in the middle of a write, which a stream would not stand.
        with suppress(OSError):
            os.write(2, _ANSWER)

    # Only the main thread may set what a signal does. A signal that is ignored, as in
    # the background, or that the caller handles, stays so.
    is_ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if is_ours:
        signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(f"{str(stop) or 'stopped at once'}; {then}") from None
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
