"""How hands hold objects: by a magnet, in a cup, or between pads.

`grasps` says what each of them bears. What a hand holds is found by its `Hands`.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene.handles import Arm, Grip
from collaborative_gym.sim.sim import EnvIds, Sim

_TURN = np.radians(3.0)  # by how much a held thing turns before it slips round

_STIFFNESS = 20e3
"""Of cups and pads, in N/m, which give way by a few mm as things slip. Our choice."""

_YIELDS = 0.05  # time in s in which a bond gives way, as MuJoCo's `solref` has it


class Grasp:
    """A way to hold an object in a hand: here a magnet, from which the others differ.

    Attributes:
      memory: how many numbers the state keeps of each grip while it holds.
      closes: whether the fingers close to the thing's width while they hold.
      draws: whether a thing is drawn to the tcp, and does not stay where it was taken.
      touches: whether fingers collide with things, and hold nothing but by contacts.
      presses: whether two pads press what they hold.
    """

    memory, closes, draws, touches, presses = 0, True, True, False, False

    def add(self, spec: mujoco.MjSpec, grip: Grip, robot: Robot) -> None:
        """Add what a grip needs to a world that has the robot and its palm."""
        spec.add_equality(
            name=grip.name,
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=grip.palm,
            name2=grip.site,
            active=False,
            # The tcp and the site are apart when the grip starts, by the threshold at
            # most. They come together in about two control steps, not with a jerk.
            solref=[_YIELDS, 1.0],
        )

    def strength(self, robot: Robot) -> float:
        """Return the greatest force that a hand bears in every direction, in N.

        Raises:
          ValueError: if the arm's hand cannot hold anything so.
        """
        return robot.gripper.holding_force

    def load(self, force: Array, axis: Array) -> Array:
        """Return the load of forces, (...), in N, to compare with the strength.

        Args:
          force: of hands on what they hold, (..., 3), in N.
          axis: along which the hands approach, (..., 3), in the same frames.
        """
        return math.norm(force)

    def resolve(
        self, grips: Sequence[Grip], model: mujoco.MjModel, arms: Mapping[str, Arm]
    ) -> "Hands":
        """Return the hands of a compiled world, whose arms are given by agent."""
        return Bonds(self, grips, model, arms)


class Patch(Grasp):
    """A grasp that keeps an object's pose in the hand, by a patch of this `size` in m.

    It remembers the place and quaternion of the thing's site in the frame of the hand.
    """

    memory, draws = 7, False
    size: float

    def add(self, spec: mujoco.MjSpec, grip: Grip, robot: Robot) -> None:
        # It is moved to where the thing was taken. MuJoCo would not look where it is,
        # if it were compiled at the frame of its body.
        away = {"pos": (0.1, 0.2, 0.3), "quat": (0.5, 0.5, 0.5, 0.5)}
        spec.body(grip.palm).add_site(name=grip.held, **away)
        bond = spec.add_equality(
            name=grip.name,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=grip.held,
            name2=grip.site,
            active=False,
            solref=[_YIELDS, 1.0],
        )
        bond.data[10] = self.size


class Pinch(Patch):
    """Two pads that press."""

    presses, size, _friction = True, 0.02, 1.0

    def strength(self, robot: Robot) -> float:
        if not robot.gripper.pad_force:
            raise ValueError(
                f"robot {robot.name!r} has no fingers to pinch with; give its gripper"
                " joints and a force, or take another grasp"
            )
        return 2.0 * self._friction * robot.gripper.pad_force


class Suction(Patch):
    """A cup that sucks, and whose fingers stay open."""

    closes = False
    size, _vacuum, _friction = 0.04, 0.6 * 101_325.0, 0.5

    def strength(self, robot: Robot) -> float:
        # Of the directions, that of the least force is in the middle of the cone.
        sucks = self._vacuum * np.pi * self.size**2 / 4
        return float(self._friction * sucks / (1.0 + self._friction**2) ** 0.5)

    def load(self, force: Array, axis: Array) -> Array:
        xp = math.array_namespace(force)
        pull = -math.dot(force, axis)
        along = xp.sqrt(xp.maximum(math.dot(force, force) - pull**2, 0.0))
        return (along + self._friction * pull) / (1.0 + self._friction**2) ** 0.5


class Hands:
    """What hands hold in the worlds of a compiled model; subclasses say how.

    Args:
      grasp: how they hold.
      grips: what they can hold.
      model: the compiled world.
      arms: its arms, by agent.
    """

    def __init__(
        self,
        grasp: Grasp,
        grips: Sequence[Grip],
        model: mujoco.MjModel,
        arms: Mapping[str, Arm],
    ):
        self.grasp, self._grips = grasp, grips
        tcps = [arms[grip.agent].tcp for grip in grips]
        self._places, self._quats = model.site_pos[tcps], model.site_quat[tcps]
        names = [f"{grip.agent}/tcp" for grip in grips], [grip.site for grip in grips]
        self._tcp, self._tcp_quat, self._site, self._site_quat = (
            columns(model, [f"{name}.{what}" for name in own])
            for own in names
            for what in ("position", "quat")
        )
        self._find(model, [arms[grip.agent].robot for grip in grips])

    def _find(self, model: mujoco.MjModel, robots: Sequence[Robot]) -> None:
        """Find in the model what the hands of these robots, one a grip, hold by."""
        raise NotImplementedError

    def is_held(self, sim: Sim) -> Array:
        """Return which grips hold, (num_envs, grips) booleans."""
        raise NotImplementedError

    def hold(self, sim: Sim, holds: Array, env_ids: EnvIds = None) -> None:
        """Hold these things, and let go of all others.

        Args:
          sim: the worlds.
          holds: (worlds, grips) booleans.
          env_ids: the worlds; None for all, if their sensors are current.
        """
        raise NotImplementedError

    def renew(self, sim: Sim) -> None:
        """Put the holding constraints to where the worlds' states remember them."""

    def pad_forces(self, sensordata: Array, eq_active: Array) -> Array:
        """Return the force with which each of two pads presses, (..., grips), in N.

        Args:
          sensordata: of a world that had `Scene.add_pad_sensors`, (..., n).
          eq_active: which of its constraints are on, (..., neq).
        """
        raise NotImplementedError

    def gaps(self, sensordata: Array) -> Array:
        """Return how far tcps are from what they can hold, (..., grips), in m."""
        return math.norm(sensordata[..., self._tcp] - sensordata[..., self._site])

    def ways(self, sim: Sim) -> Array:
        """Return the ways from tcps to where hands hold, (num_envs, grips, 3), in m."""
        raise NotImplementedError


def columns(model: mujoco.MjModel, names: Sequence[str]) -> np.ndarray:
    """Return where `sensordata` has what sensors of one size read, (names, size)."""
    sensors = [model.sensor(name) for name in names]
    starts = np.array([int(sensor.adr[0]) for sensor in sensors])
    return np.add.outer(starts, np.arange(int(sensors[0].dim[0])))


class Bonds(Hands):
    """Hands that hold by constraints.

    Attributes:
      ids: of the constraints of the grips, (grips,).
      strengths: what each grip bears in every direction, (grips,), in N.
    """

    def _find(self, model: mujoco.MjModel, robots: Sequence[Robot]) -> None:
        grasp, grips = self.grasp, self._grips
        self.strengths = np.array([grasp.strength(robot) for robot in robots])
        pads = [grasp.presses * robot.gripper.pad_force for robot in robots]
        self._pads = np.array(pads)
        self.ids = np.array([model.equality(grip.name).id for grip in grips], int)
        self._axes = math.axis_z(self._quats)
        self._forces = columns(model, [grip.palm for grip in grips])
        if grasp.memory:
            self._held = np.array([model.site(grip.held).id for grip in grips], int)
            # Constraints are as soft as what they hold is light; these are not.
            ends = model.eq_obj1id[self.ids], model.eq_obj2id[self.ids]
            bodies = model.site_bodyid[np.stack(ends)]
            ease, turning = model.body_invweight0[bodies].sum(axis=0).T
            ratios = (turning / ease).tolist()
            for i, grip, ratio in zip(self.ids, grips, ratios, strict=True):
                if grip.lever is not None:
                    model.eq_data[i, 10] = grip.lever * ratio**0.5
            share = 1.0 / (_STIFFNESS * _YIELDS**2 * ease)
            model.eq_solimp[self.ids, :2] = 1.0 / (1.0 + share[:, None])
            numbers = np.arange(len(grips) * grasp.memory)
            self._memory = len(grips) + numbers.reshape(len(grips), grasp.memory)

    def is_held(self, sim: Sim) -> Array:
        return sim.eq_active[:, self.ids] > 0

    def pad_forces(self, sensordata: Array, eq_active: Array) -> Array:
        pads = math.array_namespace(sensordata).asarray(self._pads)
        return pads * (eq_active[..., self.ids] > 0)

    def loads(self, sensordata: Array) -> Array:
        """Return the loads, to compare with the strengths, (..., grips), in N."""
        axes = math.array_namespace(sensordata).asarray(self._axes)
        return self.grasp.load(sensordata[..., self._forces], axes)

    def hold(self, sim: Sim, holds: Array, env_ids: EnvIds = None) -> None:
        rows = np.arange(sim.num_envs)
        if env_ids is not None:
            rows = np.asarray(env_ids)
            sim.forward(rows)
        if self.grasp.memory:
            places = rows[:, None, None], self._memory
            sim.userdata[places] = self._seen(sim, rows, sim.userdata[places])
        sim.eq_active[rows[:, None], self.ids] = holds

    def renew(self, sim: Sim) -> None:
        if self.grasp.memory:
            memory = sim.userdata[:, self._memory]
            sim.expand("site_pos")[:, self._held] = memory[..., :3]
            sim.expand("site_quat")[:, self._held] = memory[..., 3:]

    def ways(self, sim: Sim) -> Array:
        quats = sim.sensordata[:, self._tcp_quat]
        if self.grasp.draws:
            return 0.0 * quats[..., 1:]
        tcps, turns = (sim.xp.asarray(each) for each in (self._places, self._quats))
        place = sim.userdata[:, self._memory][..., :3] - tcps
        return math.rotate(quats, math.rotate(math.conjugate(turns), place))

    def _seen(self, sim: Sim, rows: Array, memory: Array) -> Array:
        """Return where things are in the hands; those that are held, but slip round.

        Args:
          sim: the worlds.
          rows: which of them.
          memory: what they remember, (rows, grips, 7).
        """
        sensed, xp = sim.sensordata[rows], sim.xp
        turn = math.conjugate(sensed[:, self._tcp_quat])
        way = math.rotate(turn, sensed[:, self._site] - sensed[:, self._tcp])
        tcps, turns = xp.asarray(self._places), xp.asarray(self._quats)
        place = tcps + math.rotate(turns, way)
        quat = math.multiply(turn, sensed[:, self._site_quat])
        quat = math.multiply(turns, quat)
        twist = math.multiply(math.conjugate(memory[..., 3:]), quat)
        twist = math.rotation_vector(twist)
        share = _TURN / xp.maximum(math.norm(twist), _TURN)[..., None]
        slipped = math.multiply(quat, math.from_rotation_vector(-share * twist))
        is_held = (sim.eq_active[rows[:, None], self.ids] > 0)[..., None]
        place = xp.where(is_held, memory[..., :3], place)
        return xp.concat([place, xp.where(is_held, slipped, quat)], axis=-1)
