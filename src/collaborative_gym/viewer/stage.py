"""The world on a page: shapes, lights, labels, contact forces and cameras."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import viser

from collaborative_gym import math
from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.policies import name_policy
from collaborative_gym.viewer import cameras
from collaborative_gym.viewer.guard import PULL
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.shapes import add_geom

_SKY = (230, 235, 240)
"""Colour of the page's sky, into which the floor fades."""

_HAZE = (15.0, 40.0)
"""Distances at which things begin to fade, and at which they have, in m."""

_ABOVE = 0.2
"""How far above an arm its label is, in m."""

_FORCE = (210, 40, 30)
"""Colour of contact forces."""

NEWTONS_PER_METRE = 100.0
"""The contact force whose arrow is 1 m long."""

_WEAK = 0.5
"""Contact forces below this are not drawn, in N."""


class Stage:
    """A session's world in a page's scene, which is cleared before.

    Args:
      server: the page's server.
      session: what is shown, until it plays another world.

    Attributes:
      env: the world.
      views: names of the places where a camera may stand.

    Raises:
      ValueError: if the world has something that the page cannot draw.
    """

    def __init__(self, server: viser.ViserServer, session: Session):
        self.env, self._session, self._server = session.env, session, server
        self._model = model = self.env.scene.compile_to_draw()
        self._data = mujoco.MjData(model)
        self._pulls: dict[int, mujoco.MjvPerturb] = {}
        self._move()
        mujoco.mj_forward(model, self._data)
        self.views = cameras.views(model)
        self._arms = {
            agent: [i for i in range(model.nbody) if _is_of(agent, model.body(i).name)]
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
        """Show the present state.

        Args:
          labels: whether a label over each arm says who plays it.
          forces: whether contact forces are arrows.
          shadows: whether there are any.
        """
        self._move()
        data = self._data
        with self._server.atomic():
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
            for agent, label in self._labels.items():
                label.visible = labels
                if labels:
                    label.text = (
                        f"{agent}: {name_policy(self._session.policies[agent])}"
                    )
                    label.position = self._above(agent)
            self._forces.visible = forces
            if forces:
                self._forces.points = _arrows(self.env.model, self.env.sim.data(0))
            for light in self._lights:
                light.cast_shadow = shadows

    def stand(self, client: viser.ClientHandle, view: str) -> np.ndarray:
        """Let a tab look from one of `views`, so that the arms are in view.

        Returns:
          Where its camera stands, (3,) in m.
        """
        arms = np.concatenate(
            [self._data.xpos[bodies] for bodies in self._arms.values()]
        )
        hands = self._data.site_xpos[
            [self._model.site(f"{agent}/tcp").id for agent in self._arms]
        ]
        eye, target = cameras.stand(
            view,
            self._model,
            self._data,
            arms=arms,
            hands=hands,
            aspect=client.camera.aspect,
        )
        client.camera.position, client.camera.look_at = eye, target
        return eye

    def _move(self) -> None:
        """Bring what is drawn to where the world is."""
        sim, data = self.env.sim, self._data
        data.qpos[:], data.mocap_pos[:] = sim.qpos[0], sim.mocap_pos[0]
        mujoco.mj_kinematics(self._model, data)

    def _above(self, agent: str) -> np.ndarray:
        """Return the place of an arm's label, (3,) in m."""
        places = self._data.xpos[self._arms[agent]]
        return np.append(places[0, :2], places[:, 2].max() + _ABOVE)

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


def _is_of(agent: str, body: str) -> bool:
    return body.startswith(f"{agent}/")


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
