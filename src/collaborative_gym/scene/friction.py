"""Hands that hold by friction alone: fingers press, and contacts do the rest."""

from collections.abc import Mapping, Sequence

import mujoco

from collaborative_gym.math import Array, array_namespace
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene.contacts import DEEPEST, add_contact_sensor
from collaborative_gym.scene.handles import Arm, Grip
from collaborative_gym.scene.hands import Hands, Pinch, columns
from collaborative_gym.sim.sim import Sim

_FRICTION = 1.0, 0.01, 0.0005  # along a pad, about its normal in m, and rolling in m


class Friction(Pinch):
    """Contacts of fingers, with friction on elliptic cones.

    Jaws that slide are coupled, as those of the Franka Hand and of Sawyer's gripper are
    by one motor. Without that, a thing between them would drift to one side.
    """

    memory, touches = 0, True

    def add(self, spec: mujoco.MjSpec, grip: Grip, robot: Robot) -> None:
        option = spec.option
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
        joints = [f"{grip.agent}/{name}" for name in robot.gripper.joints]
        thing = spec.site(grip.site).parent
        while thing.parent != spec.worldbody:
            thing = thing.parent
        tree = mujoco.mjtObj.mjOBJ_XBODY, thing.name
        for i, joint in enumerate(map(spec.joint, joints)):
            finger = joint.parent
            for geom in finger.find_all(mujoco.mjtObj.mjOBJ_GEOM):
                geom.priority, geom.condim, geom.friction = 1, 4, _FRICTION
            place = mujoco.mjtObj.mjOBJ_XBODY, finger.name
            add_contact_sensor(spec, f"{grip.name} by {i}", place, tree, fields=DEEPEST)
            slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
            name = f"{joints[i]} as {joints[0]}"
            if i and slides and spec.equality(name) is None:
                spec.add_equality(
                    name=name,
                    type=mujoco.mjtEq.mjEQ_JOINT,
                    objtype=mujoco.mjtObj.mjOBJ_JOINT,
                    name1=joint.name,
                    name2=joints[0],
                    data=[0.0, 1.0] + 10 * [0.0],
                )

    def resolve(
        self, grips: Sequence[Grip], model: mujoco.MjModel, arms: Mapping[str, Arm]
    ) -> "Fingers":
        return Fingers(self, grips, model, arms)


class Fingers(Hands):
    """Hands that hold what two of their fingers touch."""

    def _find(self, model: mujoco.MjModel, robots: Sequence[Robot]) -> None:
        self._touches, self._normals = [], []
        felt = [model.sensor(i).name for i in range(model.nsensor)]
        for grip, robot in zip(self._grips, robots, strict=True):
            count = len(robot.gripper.joints)
            names = [f"{grip.name} by {i}" for i in range(count)]
            self._touches.append(columns(model, names)[:, 0])
            names = [f"{grip.name} pressed by {i}" for i in range(count)]
            if names[0] in felt:
                self._normals.append(columns(model, names)[:, ::3].ravel())

    def is_held(self, sim: Sim) -> Array:
        xp, sensed = sim.xp, sim.sensordata
        counts = [
            xp.sum(xp.astype(sensed[:, own] < 0.0, xp.int64), axis=1)
            for own in self._touches
        ]
        return xp.stack(counts, axis=1) > 1

    def pad_forces(self, sensordata: Array, eq_active: Array) -> Array:
        xp = array_namespace(sensordata)
        normals = (xp.abs(sensordata[..., own]) for own in self._normals)
        return xp.stack([xp.sum(own, axis=-1) / 2 for own in normals], axis=-1)

    def ways(self, sim: Sim) -> Array:
        sensed = sim.sensordata
        return sensed[:, self._site] - sensed[:, self._tcp]
