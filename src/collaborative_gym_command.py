"""The command `collaborative-gym`, which Ctrl-C ends silently even while it loads."""

import os
import signal


def main() -> int:
    """Run the command line and return its exit status."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from collaborative_gym.cli.main import main as run

    signal.signal(signal.SIGINT, before)
    return run()
