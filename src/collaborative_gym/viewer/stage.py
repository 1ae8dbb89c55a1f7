"""The worlds on a page: shapes, lights, labels, contact forces and cameras."""

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
import viser

from collaborative_gym import math
from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.policies import name_policy
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.shapes import surfaces

_SKY, _FOG = (171, 190, 211), (165, 185, 208)
"""Colours of a page's sky and of its haze, which a page draws lighter, like the sky."""

_HAZE = (30.0, 60.0)  # distances at which things begin to fade and have faded, in m
_ABOVE = 0.2  # height of a label above its arm, in m

_BRIGHT = 2.5
"""Factor of lights that a page adds up before it makes them lighter for the screen, and
MuJoCo after, so that what is lit and what is in the shade look alike in both."""

_FORCE = (210, 40, 30)
_ARROW: Any = {"shaft_radius": 0.006, "head_radius": 0.016, "head_length": 0.04}
"""Colour of contact forces, and sizes of their arrows in m."""

NEWTONS_PER_METRE = 300.0
"""Contact force whose arrow is 1 m long."""

_WEAK = 0.5  # least contact force that is drawn, in N

_TALL, _COVERED = 0.75, 0.9
"""A picture that is narrower than this share of its height is that of a phone, whose
panel covers so much of its lower half."""

_LOW = 480
"""Height in pixels below which even a wide picture is that of a phone, without keys."""

_WIDE = 1.6  # width of all worlds together as a share of their depth

_FROM: Mapping[str, tuple[float, float, float]] = {
    "front": (1.0, 0.0, 0.4),
    "back": (-1.0, 0.0, 0.4),
    "left": (0.0, -1.0, 0.4),
    "right": (0.0, 1.0, 0.4),
    # Not quite upright, where it would have no upper side.
    "above": (0.01, 0.0, 1.0),
}
"""Directions from the middle of the arms to a camera."""

_HANDS, _WORLD = "hands", "one world"
"""Views of the hands alone, and of the world that is read."""

_GRID = [np.array([1.0, 0.0, height]) for height in np.linspace(0.5, 2.0, 16)]
"""Directions from the middle of several worlds to a camera that overlooks them. In one
of them it can stand nearest: there they fill the picture."""

_MARGIN = 0.4  # margin of a picture around the middles of an arm's parts, in m

_APART = 1.8, 1.0
"""Distance between the bodies of two worlds behind and beside one another, in m."""


class Stage:
    """A session's worlds in a page's scene, which is cleared before.

    It shows these worlds, in rows, until the session plays others. `views` are the
    names of the places of a camera, that of the task or of all worlds first.

    Raises:
      ValueError: if a world has something that the page cannot draw.
    """

    def __init__(self, server: viser.ViserServer, session: Session):
        self.env, self._session, self._server = session.env, session, server
        self._model = model = self.env.world.drawn_model
        self._worlds = [mujoco.MjData(model) for _ in range(self.env.num_envs)]
        self._pulls: dict[int, mujoco.MjvPerturb] = {}
        self._places = np.zeros((len(self._worlds), 3))
        self._move()
        for data in self._worlds:
            mujoco.mj_forward(model, data)
        self._places = _rows(len(self._worlds), self._data.xpos)
        own = [model.camera(i).name for i in range(model.ncam)]
        views = [CAMERA, *filter(None, own), _HANDS, *_FROM]
        views[1:1] = [_WORLD] * (len(self._worlds) > 1)
        self.views = tuple(dict.fromkeys(views))
        owners = [model.body(i).name.partition("/")[0] for i in range(model.nbody)]
        self._arms = {
            agent: [i for i, owner in enumerate(owners) if owner == agent]
            for agent in self.env.agents
        }
        scene = server.scene
        scene.reset()
        self._pullable: list[tuple[Any, Callable[[Any], Any]]] = []
        self._lights = _light(scene, model, float(np.ptp(self._places, axis=0).max()))
        self._bodies = self._add_bodies(scene)
        self._labels = {
            agent: scene.add_label(f"/label {agent}", "", anchor="bottom-center")
            for agent in self._arms
        }
        bases = self._data.xpos[[bodies[0] for bodies in self._arms.values()]]
        middle = np.append(bases[:, :2].mean(axis=0), 0.05)
        self._titles = [
            scene.add_label(f"/world {i}", "", position=at, anchor="bottom-center")
            for i, at in enumerate(self._places + middle)
        ]
        none = np.zeros((0, 2, 3))
        self._forces = scene.add_arrows("/forces", none, _FORCE, **_ARROW)
        camera = server.initial_camera
        camera.position, camera.look_at = overview(model, self._data)
        camera.fov = float(np.radians(model.camera(CAMERA).fovy[0]))
        self._slope = float(np.tan(camera.fov / 2))

    def refresh(self, *, labels: bool, forces: bool, shadows: bool) -> None:
        """Show the present state, with names of policies or worlds if `labels`."""
        self._move()
        session = self._session
        data, place = self._data, self._places[session.world]
        positions, wxyzs = self._poses()
        with self._server.atomic():
            for body, nodes in self._bodies.items():
                for node in nodes:
                    node.batched_positions = positions[:, body]
                    node.batched_wxyzs = wxyzs[:, body]
            has_many = len(self._worlds) > 1
            names_arms = labels and not has_many
            for i, title in enumerate(self._titles):
                title.visible = labels and has_many
                is_met = any(session.readings[i].success.values())
                mark = "\u25b8 " if i == session.world else ""  # This one is read.
                title.text = f"{mark}{i + 1}" + " \u2713" * is_met
            for agent, label in self._labels.items():
                label.visible = names_arms
                if names_arms:
                    name = name_policy(session.policies[agent])
                    label.text = f"{agent}: {name}"
                    parts = data.xpos[self._arms[agent]]
                    top = parts[:, 2].max() + _ABOVE
                    label.position = place + np.append(parts[0, :2], top)
            self._forces.visible = forces
            if forces:
                arrows = _arrows(self.env.model, self.env.sim.data(session.world))
                self._forces.points = arrows + place
            for light in self._lights:
                light.cast_shadow = shadows

    def stand(self, client: viser.ClientHandle, view: str) -> np.ndarray:
        """Let a tab look from one of `views`; return the camera's place, (3,) in m."""
        aspect = client.camera.aspect
        has_keys = aspect >= _TALL and client.camera.image_height >= _LOW
        for node, pull in () if has_keys else self._pullable:
            node.on_drag("left")(pull)  # With a finger.
        eye, target = self._place(view, aspect)
        if view != CAMERA:
            # Of several worlds, all other views are of the one that is read.
            place = self._places[self._session.world]
            eye, target = eye + place, target + place
        client.camera.position, client.camera.look_at = eye, target
        return eye

    def _place(self, view: str, aspect: float) -> tuple[np.ndarray, np.ndarray]:
        """Return where a camera sees arms and targets from, and what it looks at."""
        model, data, places = self._model, self._data, self._places
        own, looked_at = overview(model, data)
        if view == _HANDS:
            tcps = [data.site(f"{agent}/tcp").xpos for agent in self._arms]
            shown = np.concatenate([tcps, data.mocap_pos])
        else:
            arms = [data.xpos[own] for own in self._arms.values()]
            # Tables and totes, at the height at which arms work.
            fixed = data.xpos[np.flatnonzero(model.body_weldid == 0)[1:]]
            fixed = np.column_stack([fixed[:, :2], np.full(len(fixed), looked_at[2])])
            shown = np.concatenate([*arms, data.mocap_pos, fixed])
        room = self._slope * np.array([[aspect, 1.0], [aspect, 1.0]])
        room[1, 1] *= 1 - _COVERED * (aspect < _TALL)
        ways, nearest = [own - looked_at], 0.0
        if len(places) > 1 and view == CAMERA:
            shown = np.concatenate([shown + place for place in places])
            ways = _GRID
        elif view == CAMERA:
            nearest = float(np.linalg.norm(own - looked_at))
        elif view in _FROM:
            ways = [np.array(_FROM[view])]
        elif view not in (_WORLD, _HANDS):
            camera = data.camera(view)
            return camera.xpos, camera.xpos - camera.xmat.reshape(3, 3)[:, 2]
        fits = [_fit(shown, way, room, nearest) for way in ways]
        return min(fits, key=lambda fit: float(np.linalg.norm(fit[0] - fit[1])))

    @property
    def _data(self) -> mujoco.MjData:
        return self._worlds[self._session.world]

    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where all bodies are drawn, (worlds, bodies, 3) in m, and (..., 4)."""
        positions = np.array([data.xpos for data in self._worlds])
        wxyzs = np.array([data.xquat for data in self._worlds])
        return positions + self._places[:, None], wxyzs

    def _move(self) -> None:
        sim = self.env.sim
        for i, data in enumerate(self._worlds):
            data.qpos[:], data.mocap_pos[:] = sim.qpos[i], sim.mocap_pos[i]
            mujoco.mj_kinematics(self._model, data)

    def _add_bodies(self, scene: viser.SceneApi) -> dict[int, list[Any]]:
        model = self._model
        moving: dict[int, list[Any]] = {}
        positions, wxyzs = self._poses()
        for body in range(model.nbody):
            name = f"/{model.body(body).name.replace('/', ' ') or body}"
            nodes = [
                scene.add_batched_meshes_simple(
                    f"{name}/{i}",
                    each.vertices,
                    each.faces,
                    # A floor is endless, and one is enough.
                    wxyzs[: 1 if each.is_floor else None, body],
                    positions[: 1 if each.is_floor else None, body],
                    batched_colors=_linear(np.array(each.color) / 255),
                    opacity=None if each.opacity == 1 else each.opacity,
                    cast_shadow=each.opacity == 1,
                    side="front" if each.opacity == 1 else "double",
                    lod="off",
                )
                for i, each in enumerate(surfaces(model, body))
            ]
            is_free = model.body_weldid[body] > 0
            if is_free or model.body_mocapid[body] >= 0:
                moving[body] = nodes
            for node in nodes if is_free else ():
                self._pullable.append((node, pull := self._puller(body)))
                node.on_drag("left", modifier="cmd/ctrl")(pull)
        return moving

    def _puller(self, body: int) -> Callable[[Any], Any]:

        # Not a plain function: those may be called out of order.
        async def pull(event: viser.SceneNodeDragEvent) -> None:
            session, client = self._session, event.client_id
            pulling = self._pulls.get(client)
            world = min(event.instance_index or 0, len(self._worlds) - 1)
            place = self._places[world]
            if event.phase == "start":
                session.look(world)
                data = self._worlds[world]
                offset = event.start_position - place - data.xpos[body]
                perturb = mujoco.MjvPerturb()
                perturb.select = body
                perturb.active = mujoco.mjtPertBit.mjPERT_TRANSLATE.value
                perturb.localpos = math.rotate(math.conjugate(data.xquat[body]), offset)
                perturb.refselpos = event.end_position - place
                session.perturb = self._pulls[client] = perturb
            elif pulling is None:
                return  # Another of its pulls has ended.
            elif event.phase == "update":
                pulling.refselpos = event.end_position - place
            else:
                del self._pulls[client]
                if session.perturb is pulling:
                    session.perturb = None

        return pull


def _fit(
    shown: np.ndarray, way: np.ndarray, room: np.ndarray, nearest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a camera sees points from, and what it looks at, (3,) in m each.

    The points are (points, 3), and in the middle of its picture; `way` leads to it, and
    `room` is what it sees per metre of depth right and up, and left and down, (2, 2).
    """
    back = way / np.linalg.norm(way)
    right = np.cross([0.0, 0.0, 1.0], way)
    right /= np.linalg.norm(right)
    axes, middle = np.stack([right, np.cross(back, right)]), shown.mean(axis=0)
    depths, places = (shown - middle) @ back, (shown - middle) @ axes.T
    ends = np.stack([places, -places]) + _MARGIN
    needed = (depths[:, None] + ends / room[:, None]).max(axis=1)
    distance = max(np.average(needed, axis=0, weights=room).max(), nearest)
    gaps = room * (distance - needed)
    middle = middle + (gaps[1] - gaps[0]) / 2 @ axes
    return middle + distance * back, middle


def _rows(count: int, bodies: np.ndarray) -> np.ndarray:
    """Return where worlds stand in rows, the first at the origin, (count, 3) in m.

    The bodies of one are at (bodies, 3). Later rows are farther from the camera.
    """
    apart = np.ptp(bodies[:, :2], axis=0) + _APART
    columns = min(count, round(np.sqrt(_WIDE * count * apart[0] / apart[1])))
    columns = -(-count // -(-count // columns))  # No more than the rows need.
    along = np.stack([-(np.arange(count) // columns), np.arange(count) % columns], 1)
    return np.pad(along * apart, ((0, 0), (0, 1)))


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


def _linear(color: np.ndarray) -> np.ndarray:
    """Return the light of an sRGB colour, 0 to 1, of which a page makes it again."""
    return np.where(color < 0.04, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def _light(
    scene: viser.SceneApi, model: mujoco.MjModel, width: float
) -> list[viser.DirectionalLightHandle]:
    """Light a page's scene about as MuJoCo does, and return what casts shadows.

    The haze begins behind worlds that are so wide, in m.
    """
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.set_background_image(np.full((2, 2, 3), _SKY, np.uint8))
    near, far = _HAZE
    scene.configure_fog(near + 3 * width, far + 3 * width, color=_FOG)
    ambient, *own = (
        float(np.pi * _BRIGHT * _linear(each.mean()))
        for each in (model.vis.headlight.ambient, *model.light_diffuse)
    )
    scene.add_light_ambient("/ambient", intensity=ambient)
    lights = [
        scene.add_light_directional(
            f"/light {i}", intensity=own[i], position=tuple(-5.0 * model.light_dir[i])
        )
        for i in range(model.nlight)
    ]
    # None casts one yet: a page that does without would draw it while it loads.
    return [lights[i] for i in np.flatnonzero(model.light_castshadow)]
