"""MuJoCo's own window onto a session."""

import os
import sys
import threading
import warnings
from collections.abc import Iterable
from copy import copy

import glfw  # MuJoCo's window stands on it.
import mujoco
import numpy as np

from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.viewer.session import FASTEST, SLOWEST, Session

_FASTER = 1.25  # factor of the speed for one press of a key
_PATIENCE = 5.0  # longest time to wait for the last picture, in s

_HELP = (
    ("Space", "pause, or go on"),
    ("Right", "do one step"),
    ("Backspace", "start this episode again"),
    ("Enter", "next episode"),
    ("Up, Down", "faster, slower"),
    ("double click", "choose an object"),
    ("Ctrl and right drag", "pull it"),
)


class Window:
    """A window that shows a session, which ends with it, and passes on the user's keys.

    Raises:
      RuntimeError: if no window can be opened; says why.
    """

    def __init__(self, session: Session):
        _check_display()
        # Imported here because it opens the windowing system.
        from mujoco import viewer

        self._session = session
        self._model = model = copy(session.env.world.drawn_model)
        model.vis.global_.fovy = model.camera(CAMERA).fovy[0]
        self._data = mujoco.MjData(model)
        others = set(threading.enumerate())
        self._window = viewer.launch_passive(
            model,
            self._data,
            key_callback=self._press,
            show_left_ui=False,
            show_right_ui=False,
        )
        self._threads = set(threading.enumerate()) - others
        mujoco.mj_forward(model, self._data)
        # A free camera where the task's own stands, so that the mouse can turn it.
        camera, (position, target) = self._window.cam, overview(model, self._data)
        forward = target - position
        camera.lookat[:], camera.distance = target, np.linalg.norm(forward)
        camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
        camera.elevation = np.degrees(np.arcsin(forward[2] / camera.distance))
        self._window.opt.sitegroup[:] = 0

    def refresh(self) -> None:
        """Bring the window up to date. Only the session's thread may call this."""
        session, window, data = self._session, self._window, self._data
        if not window.is_running():
            session.end()
            return
        sim, perturb = session.env.sim, window.perturb
        with window.lock():
            data.qpos[:], data.mocap_pos[:] = sim.qpos[0], sim.mocap_pos[0]
            mujoco.mj_forward(self._model, data)
        session.perturb = perturb if perturb.active else None
        state = "paused" if session.is_paused else f"speed {session.speed:.2f}"
        state = session.reading.trouble or state
        window.set_texts(
            [
                _text(mujoco.mjtGridPos.mjGRID_TOPRIGHT, session.reading.rows),
                _text(mujoco.mjtGridPos.mjGRID_BOTTOMLEFT, (*_HELP, (state, ""))),
            ]
        )
        window.sync()

    def close(self) -> None:
        """Close the window."""
        self._window.close()
        # A process that ends while the window is still drawn ends with an X error.
        for thread in self._threads:
            thread.join(_PATIENCE)

    def _press(self, key: int) -> None:
        session = self._session
        go_on = session.play if session.is_paused else session.pause
        moves = {glfw.KEY_SPACE: go_on, glfw.KEY_RIGHT: session.step}
        moves |= {glfw.KEY_BACKSPACE: session.reset, glfw.KEY_ENTER: session.next}
        if key in moves:
            moves[key]()
        elif key == glfw.KEY_UP:
            session.speed = min(session.speed * _FASTER, FASTEST)
        elif key == glfw.KEY_DOWN:
            session.speed = max(session.speed / _FASTER, SLOWEST)


def _text(place: int, rows: Iterable[tuple[str, str]]) -> tuple[int, int, str, str]:
    names, values = zip(*rows, strict=True)
    font = mujoco.mjtFontScale.mjFONTSCALE_100
    return font, place, "\n".join(names), "\n".join(values)


def _check_display() -> None:
    """Raise RuntimeError if no window can be opened; MuJoCo would wait for ever."""
    variables = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(map(os.environ.get, variables)):
        raise RuntimeError("there is no display to open a window on")
    if sys.platform == "darwin":
        return  # There MuJoCo itself says what is missing.
    with warnings.catch_warnings(action="ignore"):
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, False)
            window = glfw.create_window(64, 64, "", None, None)
            glfw.terminate()
    if not window:
        raise RuntimeError("no window can be opened on the display")
