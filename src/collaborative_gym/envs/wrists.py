"""Wrenches at the arms' wrists: of all that is beyond the last joint.

A wrench is the force that hand, tool and what they hold or touch exert on the arm, in
N, and after it the torque, in N m: along the axes of the tcp, and about it. So a mass m
that hangs at rest from the tcp gives a force of m g downwards and no torque.

`raw` contains the weight of hand and tool. `compensated` subtracts the weight of the
model's hand and tool in their present orientation, as controllers of real sensors do.
Both contain inertial forces.
"""

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.robots.model_file import kinematics
from collaborative_gym.scene import Scene
from collaborative_gym.tasks.task import TaskConfig

FELT = {"wrench": "N; N m", "pad force": "N"}
"""Names and units of the blocks in observations, (num_envs, 6) and (num_envs, 1)."""

_NAME = "{}/wrist that feels"  # which a model file is unlikely to give to a site
_SENSES = mujoco.mjtSensor
_KINDS = {"force": _SENSES.mjSENS_FORCE, "torque": _SENSES.mjSENS_TORQUE}


def add_wrist_sensors(scene: Scene) -> None:
    """Add to a scene that is not compiled yet what `Wrists` reads."""
    for agent, robot in scene.robots.items():
        spec, name, quat = robot.spec(), _NAME.format(agent), np.zeros(4)
        link = spec.joint(robot.joints[-1]).parent.name
        data = kinematics(spec, {})
        body, tcp = data.body(link), data.site(robot.tcp)
        axes = body.xmat.reshape(3, 3).T
        mujoco.mju_mat2Quat(quat, (axes @ tcp.xmat.reshape(3, 3)).ravel())
        wrist = scene.spec.body(f"{agent}/{link}")
        wrist.add_site(name=name, pos=axes @ (tcp.xpos - body.xpos), quat=quat)
        at = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": name}
        for what, kind in _KINDS.items():
            scene.spec.add_sensor(name=f"{name}: {what}", type=kind, **at)


def felt_blocks(config: TaskConfig, felt: Array) -> dict[str, Array]:
    """Return by name what an arm feels, (num_envs, k), of what is switched on."""
    wrench, pads = felt[:, :6], felt[:, -1:]
    on = (wrench, config.wrench != "off"), (pads, config.pad_force)
    return {name: rows for name, (rows, is_on) in zip(FELT, on, strict=True) if is_on}


class Wrists:
    """Reads wrenches, raw or compensated, in worlds that had `add_wrist_sensors`."""

    def __init__(self, scene: Scene, model: mujoco.MjModel, *, is_raw: bool):
        self._is_raw, self._gravity = is_raw, np.array(model.opt.gravity)
        self._wrists, data = {}, mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for agent, arm in scene.arms.items():
            name = _NAME.format(agent)
            sensors = *(f"{name}: {what}" for what in _KINDS), f"{agent}/tcp.quat"
            starts = [int(model.sensor(sensor).adr[0]) for sensor in sensors]
            ends = [a + size for a, size in zip(starts, (3, 3, 4), strict=True)]
            link = int(model.site(name).bodyid[0])
            centre = data.subtree_com[link] - data.site_xpos[arm.tcp]
            centre = data.site_xmat[arm.tcp].reshape(3, 3).T @ centre
            columns = [*map(slice, starts, ends)]
            self._wrists[agent] = columns, float(model.body_subtreemass[link]), centre

    def sensed(self, sensordata: Array) -> dict[str, Array]:
        """Return the wrenches of sensor values (..., n) by agent, (..., 6)."""
        xp, found = math.array_namespace(sensordata), {}
        for agent, (columns, mass, centre) in self._wrists.items():
            force, torque, quat = (sensordata[..., own] for own in columns)
            # MuJoCo's are what the arm exerts.
            force, torque = -force, -torque
            if not self._is_raw:
                down = math.rotate(math.conjugate(quat), xp.asarray(self._gravity))
                force = force - mass * down
                torque = torque - math.cross(xp.asarray(centre), mass * down)
            found[agent] = xp.concat([force, torque], axis=-1)
        return found
