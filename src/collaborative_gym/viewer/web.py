"""A web page onto a session: the world, the controls and what is measured."""

import html
import io
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import mujoco
import numpy as np
import viser

from collaborative_gym import math
from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.viewer.address import free_port, is_loopback, name_for_browser
from collaborative_gym.viewer.guard import PULL, start_server
from collaborative_gym.viewer.reading import Reading
from collaborative_gym.viewer.session import FASTEST, SLOWEST, Session
from collaborative_gym.viewer.shapes import add_geom

_SKY = (230, 239, 248)
"""Colour of the page's sky, into which the floor fades."""

_HAZE = (15.0, 40.0)
"""Distances at which things begin to fade, and at which they have, in m."""


class Page:
    """A web server whose page shows a session and forwards what its users do.

    Any number of browsers may watch; they share the controls. The session does not
    notice whether any does.

    Args:
      session: what is shown.
      title: what the page says it shows.
      host: address to listen on.
      port: the port; where it is taken, or 0, the next one that is free.

    Attributes:
      url: where the page is.
      is_public: whether other machines may reach it.

    Raises:
      OSError: if it cannot listen there.
      RuntimeError: if the installed viser cannot be guarded from foreign pages.
      ValueError: if the world has something that the page cannot draw.
    """

    def __init__(self, session: Session, title: str, host: str, port: int):
        port = free_port(host, port)
        self._session = session
        self._model = session.env.scene.compile_to_draw()
        self._data = mujoco.MjData(self._model)
        self._said: Reading | None = None
        self._pulls: dict[int, mujoco.MjvPerturb] = {}
        with redirect_stdout(io.StringIO()):  # It announces itself.
            self._server = start_server(host, port)
        self.is_public = not is_loopback(host)
        self.url = f"http://{name_for_browser(host)}:{self._server.get_port()}"
        try:
            self._set_scene()
            self._add_panel(title)
        except BaseException:
            self.close()
            raise

    def refresh(self) -> None:
        """Bring all pages up to date. Only the session's thread may call this."""
        sim, data = self._session.env.sim, self._data
        data.qpos[:], data.mocap_pos[:] = sim.qpos[0], sim.mocap_pos[0]
        mujoco.mj_kinematics(self._model, data)
        with self._server.atomic():
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
        self._play.label = "Play" if self._session.is_paused else "Pause"
        if self._said is not self._session.reading:
            self._said = self._session.reading
            self._panel.content = _table(self._said)

    def close(self) -> None:
        """Stop the server and leave all pages."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def _set_scene(self) -> None:
        model, data, scene = self._model, self._data, self._server.scene
        mujoco.mj_forward(model, data)
        camera = self._server.initial_camera
        camera.position, camera.look_at = overview(model, data)
        camera.fov = float(np.radians(model.camera(CAMERA).fovy[0]))
        self._lights = _light(scene, model)
        self._frames: dict[int, viser.FrameHandle] = {}
        for body in range(model.nbody):
            name = f"/{model.body(body).name.replace('/', ' ') or body}"
            frame = scene.add_frame(
                name, False, position=data.xpos[body], wxyz=data.xquat[body]
            )
            first, count = model.body_geomadr[body], model.body_geomnum[body]
            is_free = model.body_weldid[body] > 0
            if is_free or model.body_mocapid[body] >= 0:
                self._frames[body] = frame
            pull = self._puller(body, frame)
            for geom in range(first, first + count):
                for node in add_geom(scene, f"{name}/{geom}", model, geom):
                    if is_free:
                        node.on_drag("left", modifier=PULL)(pull)

    def _puller(self, body: int, frame: viser.FrameHandle) -> Callable[[Any], Any]:
        """Return what follows the mice that pull at a body."""

        # Not a plain function: those may be called out of order.
        async def pull(event: viser.SceneNodeDragEvent) -> None:
            session, client = self._session, event.client_id
            pulling = self._pulls.get(client)
            if event.phase == "start":
                offset = np.subtract(event.start_position, frame.position)
                perturb = mujoco.MjvPerturb()
                perturb.select = body
                perturb.active = mujoco.mjtPertBit.mjPERT_TRANSLATE.value
                perturb.localpos = math.rotate(math.conjugate(frame.wxyz), offset)
                perturb.refselpos = event.end_position
                session.perturb = self._pulls[client] = perturb
            elif pulling is None:
                return  # Another of its pulls has ended.
            elif event.phase == "update":
                pulling.refselpos = event.end_position
            else:
                del self._pulls[client]
                if session.perturb is pulling:
                    session.perturb = None

        return pull

    def _add_panel(self, title: str) -> None:
        session, gui = self._session, self._server.gui
        gui.set_panel_label(title)
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._play = gui.add_button("Pause", hint="Let time stand still, or go on")
        step = gui.add_button("Step", hint="Do one control step and pause")
        reset = gui.add_button("Reset", hint="Start this episode again")
        following = gui.add_button("Next episode")
        self._speed = speed = gui.add_slider(
            "Speed", SLOWEST, FASTEST, 0.1, session.speed
        )
        shadows = gui.add_checkbox(
            "Shadows", True, hint="Slow where there is no graphics card"
        )
        self._panel = gui.add_html("")
        gui.add_markdown(
            "To pull at an object, drag it with Ctrl (on a Mac Cmd) held down."
        )
        self._play.on_click(
            lambda _: session.play() if session.is_paused else session.pause()
        )
        step.on_click(lambda _: session.step())
        reset.on_click(lambda _: session.reset())
        following.on_click(lambda _: session.next())

        @speed.on_update
        def _(_: object) -> None:
            session.speed = min(max(speed.value, SLOWEST), FASTEST)

        @shadows.on_update
        def _(_: object) -> None:
            for light in self._lights:
                light.cast_shadow = shadows.value


def _light(
    scene: viser.SceneApi, model: mujoco.MjModel
) -> list[viser.DirectionalLightHandle]:
    """Light a page's scene about as MuJoCo lights the world.

    Returns:
      The lights that cast shadows.
    """
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.set_background_image(np.full((2, 2, 3), _SKY, np.uint8))
    scene.configure_fog(*_HAZE, color=_SKY)
    ambient = model.vis.headlight.ambient.mean()
    scene.add_light_ambient("/ambient", intensity=float(np.pi * ambient))
    lights = [
        scene.add_light_directional(
            f"/light {i}",
            intensity=float(np.pi * model.light_diffuse[i].mean()),
            cast_shadow=bool(model.light_castshadow[i]),
            position=tuple(-5.0 * model.light_dir[i]),
        )
        for i in range(model.nlight)
    ]
    return [light for light in lights if light.cast_shadow]


def _table(reading: Reading) -> str:
    """Return a reading as HTML."""
    rows = "".join(
        f'<tr><td style="padding-left:{name.startswith(" "):d}em">{html.escape(name)}'
        f'<td style="text-align:right;white-space:nowrap">{html.escape(value)}'
        for name, value in reading.rows
    )
    style = "width:100%;padding:0 0.8em;font-size:0.85em;line-height:1.4"
    return f'<table style="{style}">{rows}</table>'
