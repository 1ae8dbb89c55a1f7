"""Off-screen pictures of a world."""

import os
import sys
import warnings
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym.errors import check_count, look_up
from collaborative_gym.scene.surroundings import CAMERA

T = TypeVar("T")

_NEAR, _CUT = 1.7, 0.8  # m, to a body in a close-up, and what of it is cut away

_LENS, _NEARER = 0.5, 0.6  # shares of its angle that it keeps, and of those when near

_LEFT = 0.15  # m, of all hands from a body; a close-up may then show another one

_AT_REST, _FADING = 1e-3, 0.75  # m, of motion in pictures, whose weights fade
_RESTS = 0.3  # m, by which a body that rests counts as farther from hands

_TURNS, _HEIGHTS = (0, 30, -30, 60, -60, 90, -90), (25, 45, 65)
"""How far aside from the overview, and how high, a close-up may look from, in deg."""

_WIDE, _CLEAR = 0.08, 0.12  # m, of what a close-up shows, and of what cannot hide it
_CALM = 0.3  # gain for which it cuts to another side: on its way it would cut arms open

_SHADED = 0.5  # share of the width in which shadows are drawn that a close-up needs

_LAMPS, _ASIDE = 4, 0.03
"""How many pictures one is the mean of, and how far aside the lamp shines in them."""

_drawing = ThreadPoolExecutor(1, "drawing")
"""The thread that draws. It begins with the first picture."""

_drawn_in: set[int] = set()
"""Ids of the process that has drawn, and of forks of it that tried to."""

_inherited: list[Any] = []
"""Renderers of the parent of this forked process, which are never freed."""


class Camera:
    """An off-screen renderer that looks through a world's `overview` camera.

    Any thread may use it. A graphics context belongs to one thread, so that all of a
    process's pictures are drawn in the same one, one after the other. The model is that
    of `World.drawn_model`; sides are in pixels. With names of bodies it shows a
    close-up from the same side, of the one that hands are nearest to till they leave.

    Raises:
      KeyError: if there is no such body.
      TypeError: if a side is not an integer.
      ValueError: if a side is below 1, or above that of the model's off-screen buffer.
      RuntimeError: if no renderer can start, as in a fork of a process that has drawn.
    """

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, bodies: Sequence[str] = ()
    ):
        names = {model.body(i).name: i for i in range(1, model.nbody)}
        self._bodies = [look_up("body", body, names) for body in bodies]
        self._shown, sites = 0, range(model.nsite)
        self._best = -1
        self._places, self._moved = np.zeros(0), np.zeros(len(bodies))
        self._tcps = [i for i in sites if model.site(i).name.endswith("/tcp")]
        visual = model.vis.global_
        self.size = (
            check_count("width", width, 1, visual.offwidth),
            check_count("height", height, 1, visual.offheight),
        )
        # Share of the camera's height that a picture wider than 16:9 shows.
        self._share = min(1.0, 16 / 9 * self.size[1] / self.size[0])
        self._model = model
        self._data = mujoco.MjData(model)
        # Group 2 is what is seen, group 3 what collides.
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = (1, 1, 1, 0, 0, 0)
        self._options.sitegroup[:] = 0
        clip = model.vis.map.shadowclip * (_SHADED if bodies else 1.0)
        self._shaded = clip * model.stat.extent
        self._renderer = _in_thread(_start, model, *self.size, clip)
        # If it is given up without `close`, the thread that finds it may not free it.
        self._free = weakref.finalize(self, _free, self._renderer, os.getpid())

    def picture(
        self, qpos: ArrayLike, mocap_pos: ArrayLike, zoom: float = 0.0
    ) -> np.ndarray:
        """Return a (height, width, 3) uint8 picture; zoom, 0 to 1, nears close-ups.

        Raises:
          RuntimeError: in a process that was forked off since the first picture.
        """
        return _in_thread(self._draw, qpos, mocap_pos, zoom)

    def close(self) -> None:
        """Free the renderer."""
        self._free()

    def _draw(self, qpos: ArrayLike, mocap_pos: ArrayLike, zoom: float) -> np.ndarray:
        self._data.qpos[:], self._data.mocap_pos[:] = qpos, mocap_pos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        middle, camera, lens = self._model.stat.center, CAMERA, 1.0
        if self._bodies:
            camera, lens = self._near(), _LENS * (zoom * _NEARER + 1 - zoom)
            middle = camera.lookat
        self._renderer.update_scene(self._data, camera, self._options)
        for eye in self._renderer.scene.camera:
            eye.frustum_bottom *= self._share
            eye.frustum_top *= self._share
            # Of a close-up, what stands between is cut away, such as another arm.
            cut = _CUT / eye.frustum_near if self._bodies else 1.0
            eye.frustum_near *= cut
            for side in "bottom", "top", "center", "width":
                name = f"frustum_{side}"
                setattr(eye, name, cut * lens * getattr(eye, name))
        return self._softened(middle)

    def _softened(self, middle: np.ndarray) -> np.ndarray:
        """Return a mean of pictures, whose shadows fade and whose edges are smooth."""
        scene, total = self._renderer.scene, np.zeros((*self.size[::-1], 3))
        # Shadows lie about its axis; a floor beyond them is speckled towards the lamp.
        far = 2 * self._model.stat.extent + self._shaded * np.array([0.5, 0.5, 0.0])
        lamps = [(lamp, lamp.dir.copy()) for lamp in scene.lights if lamp.castshadow]
        # Lamp and pixels go aside to points far from one another.
        i = np.arange(_LAMPS)
        away = _ASIDE * np.sqrt((i + 0.5) / _LAMPS)
        aside = away * [np.cos(2.4 * i), np.sin(2.4 * i), 0.0 * i]
        shifts = np.diff(np.outer([0.755, 0.57], i) % 1, prepend=0.5)
        for away, (right, up) in zip(aside.T, shifts.T, strict=True):
            for lamp, ahead in lamps:
                lamp.dir = (ahead + away) / np.linalg.norm(ahead + away)
                lamp.pos = middle - far * lamp.dir
            for eye in scene.camera:
                pixel = (eye.frustum_top - eye.frustum_bottom) / self.size[1]
                eye.frustum_center += right * pixel
                eye.frustum_top += up * pixel
                eye.frustum_bottom += up * pixel
            total += self._renderer.render()
        return np.rint(total / _LAMPS).astype(np.uint8)

    def _near(self) -> mujoco.MjvCamera:
        places = self._data.xpos[self._bodies]
        if self._tcps:
            away = places[:, None] - self._data.site_xpos[self._tcps]
            gaps = np.linalg.norm(away, axis=-1).min(axis=1)
            # What hands hold is shown until they have left it and it rests.
            is_left = gaps[self._shown] > max(_LEFT, 1.25 * gaps.min())
            rests = self._rest(places)
            if (is_left and rests[self._shown]) or self._best < 0:
                self._shown, self._best = int((gaps + _RESTS * rests).argmin()), -1
        near, (far, middle) = mujoco.MjvCamera(), overview(self._model, self._data)
        near.lookat, near.distance = places[self._shown], _NEAR
        ahead = np.degrees(np.arctan2(*(middle - far)[1::-1]))
        looks = np.array([(turn, up) for up in _HEIGHTS for turn in _TURNS])
        costs = 0.1 * np.abs(np.radians(looks[:, 0])) + np.radians(looks[:, 1]) / 6
        costs += [self._hidden(near.lookat, ahead + turn, up) for turn, up in looks]
        if self._best < 0 or costs[self._best] > costs.min() + _CALM:
            self._best = int(costs.argmin())
        near.azimuth, near.elevation = (ahead, 0.0) + looks[self._best] * (1, -1)
        return near

    def _rest(self, places: np.ndarray) -> np.ndarray:
        """Return which of the bodies have hardly moved in the last pictures."""
        before, self._places = self._places if self._places.size else places, places
        moved = np.linalg.norm(places - before, axis=1)
        self._moved = np.maximum(_FADING * self._moved, moved)
        return self._moved < _AT_REST

    def _hidden(self, body: np.ndarray, azimuth: float, up: float) -> float:
        """Return which share of a body's place is hidden from there, in degrees."""
        turn, up = np.radians([azimuth, up])
        across = np.array([-np.sin(turn), np.cos(turn), 0.0])
        flat = np.cos(up) * np.array([np.cos(turn), np.sin(turn)])
        ahead = np.append(flat, -np.sin(up))
        solid, found = np.array([0, 0, 0, 1, 0, 0], np.uint8), np.zeros(1, np.int32)
        sides = 0 * across, across, -across, np.cross(across, ahead)
        eyes = [body + _WIDE * side - _NEAR * ahead for side in sides]
        ray = ahead, solid, 1, -1, found
        gaps = [mujoco.mj_ray(self._model, self._data, eye, *ray) for eye in eyes]
        return float(np.mean([0 <= gap < _NEAR - _CLEAR for gap in gaps]))


def overview(
    model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the `overview` camera stands and what it looks at, (3,) in m each.

    The camera of `data` must be current.
    """
    camera = data.camera(CAMERA)
    forward = -camera.xmat.reshape(3, 3)[:, 2]
    distance = np.dot(model.stat.center - camera.xpos, forward)
    return camera.xpos, camera.xpos + distance * forward


def _start(
    model: mujoco.MjModel, width: int, height: int, clip: float
) -> mujoco.Renderer:
    before, model.vis.map.shadowclip = model.vis.map.shadowclip, clip
    try:
        with warnings.catch_warnings(action="ignore"):  # The error says it all.
            return mujoco.Renderer(model, height, width)
    except Exception as error:
        raise RuntimeError(
            "no off-screen renderer can start here; on Debian or Ubuntu install one"
            " with 'apt-get install libegl1 libgl1-mesa-dri' and set MUJOCO_GL=egl"
            f" (MuJoCo says: {error})"
        ) from error
    finally:
        model.vis.map.shadowclip = before


def _in_thread(job: Callable[..., T], *arguments: Any) -> T:
    """Return the result of a job that is done in the thread that draws.

    Raises:
      RuntimeError: in a process forked off since pictures were drawn; it would hang.
    """
    _drawn_in.add(os.getpid())
    if len(_drawn_in) > 1:
        raise RuntimeError(
            "pictures were drawn before this process was forked, and cannot be drawn in"
            " it too; start it with multiprocessing.get_context('spawn')"
        )
    return _drawing.submit(job, *arguments).result()


def _free(renderer: mujoco.Renderer, process: int) -> None:
    """Free a renderer in the thread that draws, but not in a process forked off."""
    if process != os.getpid():
        _inherited.append(renderer)
        return
    with suppress(RuntimeError):  # At the end of a process no job can begin any more.
        _drawing.submit(renderer.close)


def _forget_display() -> None:
    """Let a forked process end without EGL, whose locks may be held for ever there."""
    if _drawn_in and "mujoco.egl" in sys.modules:
        vars(sys.modules["mujoco.egl"])["EGL_DISPLAY"] = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_display)
