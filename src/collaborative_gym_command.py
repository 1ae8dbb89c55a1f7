"""The command `collaborative-gym`, which Ctrl-C ends silently even while it loads."""

import os
import signal
import sys


def main() -> int:
    """Run the command line and return its exit status."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    try:
        from collaborative_gym.cli.main import main as run
    except RuntimeError as error:  # of MuJoCo, which reads MUJOCO_GL
        sys.exit(f"error: {error}; give egl, osmesa or glfw, or unset it")
    signal.signal(signal.SIGINT, before)
    return run()
