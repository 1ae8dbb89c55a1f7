"""What arms feel at their wrists: the wrench of all that is beyond the last joint.

A wrench is the force that hand, tool and what they hold or touch exert on the arm, in
N, and after it the torque, in N m: along the axes of the tcp, and about it. So a mass m
that hangs at rest from the tcp gives a force of m g downwards and no torque.

`raw` has the weight of hand and tool in it. `compensated` has not: it takes off what
hand and tool of the model weigh as they are turned, as controllers of real sensors do.
What their inertia exerts in motion stays in both.
"""

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.robots.model_file import kinematics
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim

WRENCH, UNIT = "wrench", "N; N m"
"""Name and unit of its block in observations, (num_envs, 6)."""

_KINDS = mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE


def add_wrist_sensors(scene: Scene) -> None:
    """Add to a scene that is not compiled yet what `Wrists` reads."""
    for agent, robot in scene.robots.items():
        spec = robot.spec()
        link = spec.joint(robot.joints[-1]).parent.name
        data = kinematics(spec, {})
        body, tcp, quat = data.body(link), data.site(robot.tcp), np.zeros(4)
        axes = body.xmat.reshape(3, 3).T
        mujoco.mju_mat2Quat(quat, (axes @ tcp.xmat.reshape(3, 3)).ravel())
        place = axes @ (tcp.xpos - body.xpos)
        wrist = scene.spec.body(f"{agent}/{link}")
        wrist.add_site(name=_sensor(agent), pos=place, quat=quat)
        for kind in _KINDS:
            scene.spec.add_sensor(
                name=_sensor(agent, kind),
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=_sensor(agent),
            )


class Wrists:
    """Reads the wrenches of worlds whose scene had `add_wrist_sensors`.

    Args:
      scene: the compiled scene.
      model: the compiled world.
      is_raw: whether the weight of hand and tool is in them.
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel, *, is_raw: bool):
        self._is_raw, self._gravity = is_raw, np.array(model.opt.gravity)
        self._agents, data = tuple(scene.arms), mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        self._columns, self._masses, self._centres = {}, {}, {}
        for agent, arm in scene.arms.items():
            names = *(_sensor(agent, kind) for kind in _KINDS), f"{agent}/tcp.quat"
            starts = [int(model.sensor(name).adr[0]) for name in names]
            ends = [a + size for a, size in zip(starts, (3, 3, 4), strict=True)]
            self._columns[agent] = [*map(slice, starts, ends)]
            link = int(model.site_bodyid[model.site(_sensor(agent)).id])
            axes = data.site_xmat[arm.tcp].reshape(3, 3).T
            centre = data.subtree_com[link] - data.site_xpos[arm.tcp]
            self._masses[agent] = model.body_subtreemass[link]
            self._centres[agent] = axes @ centre

    def read(self, sim: Sim) -> dict[str, Array]:
        """Return the present wrenches by agent, (num_envs, 6)."""
        sim.feel()
        return self.sensed(sim.sensordata)

    def sensed(self, sensordata: Array) -> dict[str, Array]:
        """Return the wrenches of sensor values (..., n) by agent, (..., 6)."""
        xp, found = math.array_namespace(sensordata), {}
        for agent in self._agents:
            force, torque, quat = (sensordata[..., own] for own in self._columns[agent])
            # MuJoCo's are what the arm exerts.
            force, torque = -force, -torque
            if not self._is_raw:
                down = math.rotate(math.conjugate(quat), xp.asarray(self._gravity))
                weight = self._masses[agent] * down
                centre = xp.asarray(self._centres[agent])
                force = force - weight
                torque = torque - math.cross(centre, weight)
            found[agent] = xp.concat([force, torque], axis=-1)
        return found


def _sensor(agent: str, kind: mujoco.mjtSensor | None = None) -> str:
    """Return the name of the site at an agent's wrist, or that of a sensor there."""
    # A model file is unlikely to give this name to a site of its own.
    return f"{agent}/wrist that feels" + (f" {kind.name}" if kind else "")
