"""Contacts, forces, torques and energy of arms, in every physics step.

It is read from MuJoCo's own sensors and fields, and changes no bit of the physics. An
episode has these measures, each the greatest over its physics steps unless said
otherwise:

- `contact_depth_arms`: how deep two arms are in one another, in m.
- `contact_depth_objects`: how deep a loose thing is in an arm, in what is fixed or in
  another loose thing, in m.
- `contact_depth_furniture`: how deep an arm is in what is fixed, in m.
- `contact_force_arms`, `contact_force_objects`, `contact_force_furniture`: the net
  force of all contacts between two of these, in N.
- `torque_limit_share`: the share of their time that joints are at 99 % of their torque
  limit or above, the mean over the joints.
- `torque_over_limit`: the torque that a physics step applies to a joint, over its
  limit. It is MuJoCo's `actuator_force`, from the state before the step and never above
  the limit, less what the implicit step takes off as the joint moves. That can add to
  the torque, most where a joint is hit, so the mean over a step may pass the limit.
- `speed_over_limit`: a joint's speed over its limit.
- `energy`: the sum over joints and physics steps of abs(torque x turn), in J, by the
  torque that the step applies. A motor that brakes gives nothing back.
- `energy_commanded`: the same by `actuator_force`, of which a step applies a part.
- `clearance`: the least distance between two arms at the ends of control steps, in m,
  and at most 1 m; minus their greatest depth where they touched.
- `internal_force`: how hard arms push against each other on what they hold, in N.
- `wrist_force`, `wrist_torque`: the greatest force and torque that an arm feels at its
  wrist, in N and N m, `compensated` as `envs.wrists` says.
- `internal_force_mean`: its mean over the time in which two arms or more hold it.
- `pad_force`: the greatest force with which each of a hand's two pads presses what it
  holds, in N: the gripper's force in `pinch`, half of the normal forces of all contacts
  of its fingers in `friction`, and 0 in other grasps.

Tools are parts of their arms. Shapes that cannot collide have no clearance.

We defined the internal force ourselves. Arms pull at one thing with forces f_i, whose
sum is F. An arm may bear any share of F, from nothing to all. So only the distance of
its f_i from the line between 0 and F works against the others. The greatest of these
distances counts. For two arms it is the same: 0 if they pull in one direction, and the
smaller force if they pull in opposite directions. Other definitions (Williams and
Khatib, "The virtual linkage", 1993) divide forces along lines between the grasps, which
arms that grip at one point do not have.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.control import ActionMode
from collaborative_gym.envs.wrists import Wrists
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene, contacts
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.sim.sim import EnvIds
from collaborative_gym.timing import SIM_DT, SUBSTEPS

_BLANK = {
    **{f"contact_depth_{kind}": 0.0 for kind in contacts.DEPTHS},
    **{f"contact_force_{kind}": 0.0 for kind in contacts.DEPTHS},
    "torque_limit_share": 0.0,
    "torque_over_limit": 0.0,
    "speed_over_limit": 0.0,
    "energy": 0.0,
    "energy_commanded": 0.0,
    "clearance": 1.0,
    "wrist_force": 0.0,
    "wrist_torque": 0.0,
    "internal_force": 0.0,
    "internal_force_mean": 0.0,
    "pad_force": 0.0,
}
"""The clearance with which an episode begins; larger ones are not measured."""

STRAIN = tuple(_BLANK)
"""The names of the measures, in their order."""

_HELD_STEPS = "strain: held steps"

BLANK = {f"strain: {name}": value for name, value in _BLANK.items()} | {_HELD_STEPS: 0}
"""Names at the beginning of an episode's rows."""

_AT_LIMIT = 0.99
"""A joint with at least this share of its torque limit counts as at the limit."""

_IN_A_BOX = 4
"""How many shapes of an arm, one after the other, have a box around them together."""

_RECORDS = (
    "actuator_force",
    "actuator_velocity",
    "qvel",
    "sensordata",
    "cfrc_ext",
    "cfrc_int",
    "eq_active",
)
"""MuJoCo's fields that are read of every physics step."""


_TOGETHER: dict[str, Callable[..., np.ndarray]] = dict.fromkeys(STRAIN, np.max) | {
    "torque_limit_share": np.mean,
    "energy": np.sum,
    "energy_commanded": np.sum,
    "internal_force_mean": np.mean,
    _HELD_STEPS: np.any,
}
"""What many steps come to. In an episode, a mean is the sum over its steps first."""


def add_strain_sensors(scene: Scene) -> None:
    """Add to a scene that is not compiled yet what `Strain` reads."""
    spec = scene.spec
    pairs = contacts.contact_pairs(spec, scene.robots)
    for kind in contacts.DEPTHS:
        for i, pair in enumerate(pairs[kind]):
            contacts.add_contact_sensor(spec, f"{kind} net {i}", *pair)
    sites = {spec.site(b.name1).parent.name: b.name1 for b in _bonds(scene)}
    for body, site in sites.items():
        contacts.add_contact_sensor(
            spec, f"{body} net", (mujoco.mjtObj.mjOBJ_BODY, body)
        )
        # Nobody reads it, but because of it MuJoCo computes `cfrc_ext` and `cfrc_int`.
        spec.add_sensor(
            name=f"{body} force",
            type=mujoco.mjtSensor.mjSENS_FORCE,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site,
        )


def _bonds(scene: Scene) -> list[mujoco.MjsEquality]:
    """Return the constraints that bind a site of an arm to what it holds."""
    return [
        equality
        for equality in scene.spec.equalities
        if equality.objtype == mujoco.mjtObj.mjOBJ_SITE
        and equality.name1.split("/")[0] in scene.robots
    ]


@dataclass(frozen=True)
class _Held:
    """Something that arms can hold."""

    tool: int | None  # id of its body, if it is a part of one arm, which holds it, too
    # Of each arm that can hold it: ids of the constraint and of the hand's body, and
    # where the net force of this body's contacts is in `sensordata`.
    bonds: list[tuple[int, int, slice]]


class Strain:
    """Measures the strain of episodes; the scene had `add_strain_sensors`.

    Attributes:
      depths: by kind of contact, how deep the deepest was in the physics steps that
        were counted last, (num_envs,) in m.
      internal_force: the mean over those steps, (num_envs,) in N.
      energy: what they took, (num_envs,) in J.
    """

    def __init__(self, scene: Scene, sim: CpuSim, mode: ActionMode):
        self._sim, self._mode, model = sim, mode, sim.model
        self._scene = scene
        arms = list(scene.arms.values())
        self._servos = np.r_[*(arm.servos for arm in arms)]
        self._dofs = np.r_[*(arm.dof for arm in arms)]
        self._speed = np.concatenate([arm.robot.velocity_limits for arm in arms])
        sensors = contacts.depth_sensors(model).items()
        self._deep = {kind: model.sensor_adr[ids] for kind, ids in sensors}
        self._forces = {
            kind: _columns(model, f"{kind} net") for kind in contacts.DEPTHS
        }
        self._held = _held(scene, model)
        self._wrists = Wrists(scene, model, is_raw=False)
        self._pairs, self._radii = _pairs(scene, model), model.geom_rbound
        self._boxes = _Boxes(model, self._pairs)
        self._data = mujoco.MjData(model)
        self._centres = sim.geom_xpos
        self._records: dict[str, np.ndarray] = {}
        self.depths = dict.fromkeys(contacts.DEPTHS, np.zeros(sim.num_envs))
        self.internal_force = np.zeros(sim.num_envs)
        self.energy = np.zeros(sim.num_envs)

    def records(self, substeps: int) -> dict[str, np.ndarray]:
        """Return the arrays that so many physics steps are to be recorded in."""
        if not self._records or self._records["qvel"].shape[1] != substeps:
            for name in _RECORDS:
                field = getattr(self._data, name)
                shape = (self._sim.num_envs, substeps, *field.shape)
                self._records[name] = np.zeros(shape, field.dtype)
        return self._records

    def count(self, rows: dict[str, Array], moved: Array) -> None:
        """Bring episodes' rows up to the recorded physics steps, where they `moved`."""
        found = self._found(self._records, slice(None), SIM_DT)
        for refined in self._sim.refined:
            env_ids, steps = refined.env_ids, refined.steps
            short = SIM_DT / refined.records["qvel"].shape[1]
            for name, values in self._found(refined.records, env_ids, short).items():
                found[name][env_ids, steps] = _TOGETHER[name](values, axis=1)
        self.depths |= {
            kind: found[f"contact_depth_{kind}"].max(axis=1)
            for kind in contacts.DEPTHS
            if f"contact_depth_{kind}" in found
        }
        self.energy = found["energy"].sum(axis=1)
        if self._held:
            self.internal_force = found["internal_force"].mean(axis=1)
            held_steps = np.where(moved, found.pop(_HELD_STEPS).sum(axis=1), 0)
            rows[_HELD_STEPS] = rows[_HELD_STEPS] + held_steps
        for name, values in found.items():
            row = f"strain: {name}"
            if _TOGETHER[name] is np.max:
                most = np.where(moved, values.max(axis=1), 0.0)
                rows[row] = np.maximum(rows[row], most)
                continue
            # Step by step, so that bits do not depend on how many are recorded.
            for step in values.T:
                rows[row] = rows[row] + np.where(moved, step, 0.0)

    def _found(
        self, records: dict[str, np.ndarray], env_ids: EnvIds, dt: float
    ) -> dict[str, np.ndarray]:
        """Return by name what recorded steps of `dt` s come to, (worlds, steps)."""
        sensed = records["sensordata"]
        torque = records["actuator_force"][:, :, self._servos]
        speed = records["qvel"][:, :, self._dofs]
        turn = np.abs(speed) * dt
        limit = self._sim.limits(self._servos)
        limit = (limit if len(limit) == 1 else limit[env_ids])[:, None]
        before = records["actuator_velocity"][:, :, self._servos]
        yields = self._mode.yields(torque, before, speed, dt, env_ids)
        # At its limit a torque does not depend on the state.
        applied = np.abs(torque - np.where(np.abs(torque) < limit, yields, 0.0))
        torque = np.abs(torque)
        limit = np.maximum(limit, 1e-9)  # Those of a limp arm are 0.
        found = {
            "speed_over_limit": np.max(np.abs(speed) / self._speed, axis=2),
            "energy": math.dot(applied, turn),
            "energy_commanded": math.dot(torque, turn),
            "torque_limit_share": (torque >= _AT_LIMIT * limit).mean(axis=2),
            "torque_over_limit": np.max(applied / limit, axis=2),
        }
        if self._scene.grips:
            forces = self._scene.hands.pad_forces(sensed, records["eq_active"])
            found["pad_force"] = forces.max(axis=-1)
        felt = np.stack([*self._wrists.sensed(sensed).values()])
        for name, own in zip(("force", "torque"), np.split(felt, 2, -1), strict=True):
            found[f"wrist_{name}"] = math.norm(own).max(axis=0)
        for kind in contacts.DEPTHS:
            if len(self._deep[kind]):
                depth = -sensed[:, :, self._deep[kind]]
                found[f"contact_depth_{kind}"] = depth.max(axis=2)
                force = math.norm(sensed[:, :, self._forces[kind]])
                found[f"contact_force_{kind}"] = force.max(axis=2)
        return found | self._found_held(records, env_ids)

    def _found_held(
        self, records: dict[str, np.ndarray], env_ids: EnvIds
    ) -> dict[str, np.ndarray]:
        """Return the internal forces, as `_found` does; nothing if arms never hold."""
        if not self._held:
            return {}
        forces, is_held = [], []
        for held in self._held:
            forces.append(self._internal_force(held, records, env_ids))
            bonds = [bond for bond, _, _ in held.bonds]
            arms = records["eq_active"][:, :, bonds].sum(axis=2)
            is_held.append(arms + (held.tool is not None) >= 2)
        force, held_steps = np.max(forces, axis=0), np.any(is_held, axis=0)
        mean = np.where(held_steps, force, 0.0)
        found = {"internal_force": force, "internal_force_mean": mean}
        return found | {_HELD_STEPS: held_steps}

    def _internal_force(
        self, held: _Held, records: dict[str, np.ndarray], env_ids: EnvIds
    ) -> np.ndarray:
        """Return the internal force on a thing, (worlds, steps), in N."""
        outer, forces = records["cfrc_ext"][:, :, :, 3:], []
        applied = self._sim.xfrc_applied[env_ids]
        for _, hand, contact in held.bonds:
            # Contacts of the hand and outer forces act on it, too.
            force = -(outer[:, :, hand] + records["sensordata"][:, :, contact])
            forces.append(force + applied[:, None, hand, :3])
        if held.tool is not None:
            forces.append(records["cfrc_int"][:, :, held.tool, 3:])
        return internal_force(forces)

    def count_clearance(self, rows: dict[str, Array], moved: Array) -> None:
        """Bring the rows of the clearance up to the present state; see `count`.

        Most parts of arms are ruled out by the boxes around them, and most pairs of
        shapes by the spheres around those.
        """
        model, data = self._sim.model, self._data
        least = rows["strain: clearance"] = rows["strain: clearance"].copy()
        bound = np.where((least > 0.0) & moved, least, -np.inf)
        near, pairs = np.nonzero(self._boxes.apart(self._centres) < bound[:, None])
        worlds = np.repeat(near, self._boxes.counts[pairs])
        pairs = np.concatenate(
            [*(self._boxes.pairs[k] for k in pairs), np.zeros(0, int)]
        )
        one, other = self._pairs[:, pairs]
        gaps = math.distance(self._centres[worlds, one], self._centres[worlds, other])
        gaps -= self._radii[one] + self._radii[other]
        closer = np.flatnonzero(gaps < bound[worlds])
        closer = closer[np.lexsort((gaps[closer], worlds[closer]))]
        parts = (part[closer].tolist() for part in (worlds, gaps, one, other))
        now, nearest = -1, 0.0
        for i, gap, *pair in zip(*parts, strict=True):
            if i != now:
                data.qpos[:] = self._sim.qpos[i]
                mujoco.mj_kinematics(model, data)
                now, nearest = i, float(least[i])
            if gap < nearest:
                nearest = mujoco.mj_geomDistance(model, data, *pair, nearest, None)
                least[i] = nearest


def internal_force(forces: Sequence[Array]) -> Array:
    """Return the internal force of arms' forces (..., 3), in N."""
    total = np.sum(forces, axis=0)
    square = np.maximum(math.dot(total, total), 1e-12)
    spent = []
    for force in forces:
        share = np.clip(math.dot(force, total) / square, 0.0, 1.0)
        spent.append(math.norm(force - share[..., None] * total))
    return np.max(spent, axis=0)


def measured(rows: Mapping[str, Array]) -> dict[str, Array]:
    """Return the strain of episodes, by the names of `STRAIN`, from their rows."""
    strain = {name: rows[f"strain: {name}"] + 0.0 for name in STRAIN}
    strain["torque_limit_share"] /= np.maximum(rows["length"], 1) * SUBSTEPS
    strain["internal_force_mean"] /= np.maximum(rows[_HELD_STEPS], 1)
    depth = strain["contact_depth_arms"]
    touching = np.where(depth > 0.0, -depth, strain["clearance"])
    strain["clearance"] = np.minimum(strain["clearance"], touching)
    return strain


def _columns(model: mujoco.MjModel, start: str) -> np.ndarray:
    """Return where sensors' values are in `sensordata`, (sensors, values)."""
    found = []
    for i in range(model.nsensor):
        if model.sensor(i).name.startswith(start):
            found.append(model.sensor_adr[i] + np.arange(model.sensor_dim[i]))
    return np.array(found)


def _held(scene: Scene, model: mujoco.MjModel) -> list[_Held]:
    held: dict[int, _Held] = {}
    for equality in _bonds(scene):
        bond = model.equality(equality.name).id
        hand = model.body(model.site_bodyid[model.site(equality.name1).id])
        body = int(model.site_bodyid[model.site(equality.name2).id])
        is_tool = model.body(body).name.split("/")[0] in scene.robots
        contact = model.sensor(f"{hand.name} net")
        start = int(contact.adr[0])
        thing = held.setdefault(body, _Held(body if is_tool else None, []))
        thing.bonds.append((bond, hand.id, slice(start, start + 3)))
    return list(held.values())


class _Boxes:
    """Boxes around parts of arms, along the axes of the world.

    Attributes:
      pairs: indices of the pairs of shapes, for each pair of boxes.
      counts: how many these are.
    """

    def __init__(self, model: mujoco.MjModel, pairs: np.ndarray):
        roots = model.body_rootid[model.geom_bodyid]
        shapes = np.unique(pairs)
        self._shapes = shapes = shapes[np.argsort(roots[shapes], kind="stable")]
        _, first, arms = np.unique(
            roots[shapes], return_index=True, return_inverse=True
        )
        begins = (np.arange(len(shapes)) - first[arms]) % _IN_A_BOX == 0
        self._starts, boxes = np.flatnonzero(begins), np.zeros(model.ngeom, int)
        boxes[shapes] = np.cumsum(begins) - 1
        self._radii = model.geom_rbound[shapes, None]
        self._boxes, which = np.unique(boxes[pairs], axis=1, return_inverse=True)
        count = self._boxes.shape[1]
        self.pairs = [np.flatnonzero(which.ravel() == k) for k in range(count)]
        self.counts = np.array([len(own) for own in self.pairs], int)

    def apart(self, centres: np.ndarray) -> np.ndarray:
        """Return at least how far apart each pair of boxes is, (worlds, pairs), in m.

        Centres are those of all shapes, (worlds, shapes, 3).
        """
        if not len(self.pairs):
            return np.zeros((len(centres), 0))
        middles, (one, other) = centres[:, self._shapes], self._boxes
        low = np.minimum.reduceat(middles - self._radii, self._starts, axis=1)
        high = np.maximum.reduceat(middles + self._radii, self._starts, axis=1)
        gaps = np.maximum(low[:, one] - high[:, other], low[:, other] - high[:, one])
        # Rounding must rule out nobody.
        return math.norm(np.maximum(gaps, 0.0)) - 1e-9


def _pairs(scene: Scene, model: mujoco.MjModel) -> np.ndarray:
    """Return ids of shapes of different arms that can touch, (2, pairs)."""
    agents = [model.body(int(body)).name.split("/")[0] for body in model.geom_bodyid]
    excluded = {divmod(int(pair), 1 << 16) for pair in model.exclude_signature}
    pairs = []
    for one, other in combinations(range(model.ngeom), 2):
        bodies = int(model.geom_bodyid[one]), int(model.geom_bodyid[other])
        if (
            {agents[one], agents[other]} <= set(scene.robots)
            and agents[one] != agents[other]
            and model.geom_contype[one] & model.geom_conaffinity[other]
            and not {bodies, bodies[::-1]} & excluded
        ):
            pairs.append((one, other))
    return np.array(pairs, int).reshape(-1, 2).T
