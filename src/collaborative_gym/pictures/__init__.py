"""Pictures and videos of worlds."""

import ctypes
import os
import sys


def choose_backend() -> None:
    """Select EGL on Linux without a display, where MUJOCO_GL does not say otherwise.

    MuJoCo reads the variable when it is imported; if that was before, its choice is
    replaced. Without EGL's library nothing is: MuJoCo could not be imported.
    """
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or has_display or "MUJOCO_GL" in os.environ:
        return
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return
    os.environ["MUJOCO_GL"] = "egl"
    if "mujoco" in sys.modules:
        from mujoco.egl import GLContext
        from mujoco.rendering.classic import gl_context

        gl_context.GLContext = GLContext
