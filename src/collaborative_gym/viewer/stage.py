"""The world on a page: shapes, lights, labels, contact forces and cameras."""

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
import viser

from collaborative_gym import math
from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.policies import name_policy
from collaborative_gym.viewer.guard import PULL
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.shapes import add_geom

_SKY = (230, 235, 240)
"""Colour of the page's sky, into which the floor fades."""

_HAZE = (15.0, 40.0)
"""Distances at which things begin to fade and have faded, in m."""

_ABOVE = 0.2
"""Height of a label above its arm, in m."""

_FORCE = (210, 40, 30)
"""Colour of contact forces."""

_HINT = "Ctrl-drag a thing to pull at it"
"""What newcomers do not find out by themselves; on a Mac it is Cmd."""

NEWTONS_PER_METRE = 100.0
"""Contact force whose arrow is 1 m long."""

_WEAK = 0.5
"""Least contact force that is drawn, in N."""

_FROM: Mapping[str, tuple[float, float, float]] = {
    "front": (1.0, 0.0, 0.4),
    "back": (-1.0, 0.0, 0.4),
    "left": (0.0, -1.0, 0.4),
    "right": (0.0, 1.0, 0.4),
    # Not quite upright, where it would have no upper side.
    "above": (0.01, 0.0, 1.0),
}
"""Directions from the middle of the arms to a camera."""

_HANDS = "hands"
"""View of the hands alone."""

_MARGIN = 0.4
"""Margin of a picture around the middles of an arm's parts, in m."""


class Stage:
    """A session's world in a page's scene, which is cleared before.

    It shows this world until the session plays another. `views` are the names of the
    places of a camera, the task's own first.

    Raises:
      ValueError: if the world has something that the page cannot draw.
    """

    def __init__(self, server: viser.ViserServer, session: Session):
        self.env, self._session, self._server = session.env, session, server
        self._model = model = self.env.world.drawn_model
        self._data = mujoco.MjData(model)
        self._pulls: dict[int, mujoco.MjvPerturb] = {}
        self._move()
        mujoco.mj_forward(model, self._data)
        own = [model.camera(i).name for i in range(model.ncam)]
        views = [CAMERA, *filter(None, own), _HANDS, *_FROM]
        self.views = tuple(dict.fromkeys(views))
        owners = [model.body(i).name.partition("/")[0] for i in range(model.nbody)]
        self._arms = {
            agent: [i for i, owner in enumerate(owners) if owner == agent]
            for agent in self.env.agents
        }
        scene = server.scene
        scene.reset()
        self._lights = _light(scene, model)
        self._frames = self._add_bodies(scene)
        self._labels = {
            agent: scene.add_label(f"/label {agent}", "", anchor="bottom-center")
            for agent in self._arms
        }
        # On the floor, between the arms, until somebody has pulled.
        self._hint = scene.add_label("/hint", _HINT, anchor="bottom-center")
        bases = self._data.xpos[[bodies[0] for bodies in self._arms.values()]]
        self._hint.position = (*bases[:, :2].mean(axis=0), 0.05)
        self._forces = scene.add_arrows(
            "/forces",
            np.zeros((0, 2, 3)),
            _FORCE,
            shaft_radius=0.006,
            head_radius=0.016,
            head_length=0.04,
        )
        camera = server.initial_camera
        camera.position, camera.look_at = overview(model, self._data)
        camera.fov = float(np.radians(model.camera(CAMERA).fovy[0]))

    def refresh(self, *, labels: bool, forces: bool, shadows: bool) -> None:
        """Show the present state, with a policy's name over each arm if `labels`."""
        self._move()
        data = self._data
        with self._server.atomic():
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
            self._hint.visible = labels and not self._session.was_pulled
            for agent, label in self._labels.items():
                label.visible = labels
                if labels:
                    name = name_policy(self._session.policies[agent])
                    label.text = f"{agent}: {name}"
                    places = data.xpos[self._arms[agent]]
                    top = places[:, 2].max() + _ABOVE
                    label.position = np.append(places[0, :2], top)
            self._forces.visible = forces
            if forces:
                self._forces.points = _arrows(self.env.model, self.env.sim.data(0))
            for light in self._lights:
                light.cast_shadow = shadows

    def stand(self, client: viser.ClientHandle, view: str) -> np.ndarray:
        """Let a tab look from one of `views`; return the camera's place, (3,) in m."""
        eye, target = self._place(view, client.camera.aspect)
        client.camera.position, client.camera.look_at = eye, target
        return eye

    def _place(self, view: str, aspect: float) -> tuple[np.ndarray, np.ndarray]:
        """Return where a camera stands so that the arms are in view, and its target."""
        model, data = self._model, self._data
        own, looked_at = overview(model, data)
        if view == _HANDS:
            shown = data.site_xpos[[model.site(f"{a}/tcp").id for a in self._arms]]
        else:
            shown = np.concatenate([data.xpos[own] for own in self._arms.values()])
        if view == CAMERA:
            eye, target = own, looked_at
        elif view in (_HANDS, *_FROM):
            target = (shown.min(axis=0) + shown.max(axis=0)) / 2
            eye = target + np.array(_FROM.get(view, own - looked_at))
        else:
            camera = data.camera(view)
            return camera.xpos, camera.xpos - camera.xmat.reshape(3, 3)[:, 2]
        back = (eye - target) / np.linalg.norm(eye - target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        away = shown - target
        slope = np.tan(np.radians(model.camera(CAMERA).fovy[0]) / 2)
        wide = (np.abs(away @ right) + _MARGIN) / (slope * aspect)
        high = (np.abs(away @ np.cross(back, right)) + _MARGIN) / slope
        needed = float(np.max(away @ back + np.maximum(wide, high)))
        nearest = np.linalg.norm(eye - target) if view == CAMERA else 0.0
        return target + max(needed, nearest) * back, target

    def _move(self) -> None:
        """Move the drawn bodies to the world's state."""
        sim, data = self.env.sim, self._data
        data.qpos[:], data.mocap_pos[:] = sim.qpos[0], sim.mocap_pos[0]
        mujoco.mj_kinematics(self._model, data)

    def _add_bodies(self, scene: viser.SceneApi) -> dict[int, viser.FrameHandle]:
        """Draw all bodies, and return the frames of those that move."""
        model, data = self._model, self._data
        frames: dict[int, viser.FrameHandle] = {}
        for body in range(model.nbody):
            name = f"/{model.body(body).name.replace('/', ' ') or body}"
            frame = scene.add_frame(
                name, False, position=data.xpos[body], wxyz=data.xquat[body]
            )
            first, count = model.body_geomadr[body], model.body_geomnum[body]
            is_free = model.body_weldid[body] > 0
            if is_free or model.body_mocapid[body] >= 0:
                frames[body] = frame
            pull = self._puller(body, frame)
            for geom in range(first, first + count):
                for node in add_geom(scene, f"{name}/{geom}", model, geom):
                    if is_free:
                        node.on_drag("left", modifier=PULL)(pull)
        return frames

    def _puller(self, body: int, frame: viser.FrameHandle) -> Callable[[Any], Any]:
        """Return the callback of the mice that pull at a body."""

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


def _arrows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the contact forces as arrows from where they act, (arrows, 2, 3) in m."""
    arrows, force = [], np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        mujoco.mj_contactForce(model, data, i, force)
        if np.linalg.norm(force[:3]) > _WEAK:
            along = contact.frame.reshape(3, 3).T @ force[:3] / NEWTONS_PER_METRE
            arrows.append([contact.pos, contact.pos + along])
    return np.array(arrows).reshape(-1, 2, 3)


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
