"""A mode whose actions are joint torques, and the motors that exert them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from array_api_compat import array_namespace

from collaborative_gym.control import modes
from collaborative_gym.control.drives import add_fingers
from collaborative_gym.errors import check_number
from collaborative_gym.math import Array
from collaborative_gym.quiet import quiet
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import CONTROL_DT

_TOP = 0.95
"""Speed at which a motor has no torque left, over the joint's speed limit. A joint that
is near it gains a tenth more in a physics step at most."""

_FRICTION = 0.2
"""Share of its torque limit that a motor loses at the joint's speed limit, in
proportion to the speed. Our choice, of the size of what strain wave gears lose.
Without it, an arm of which nothing is asked would never come to rest."""

_GAIN, _TOGETHER, _KEPT = 0.5, 1.5, 0.7
"""Shares of what an expert's motion lacks of its speed, of an arm alone and of one in
step, which turns the others as well, and of what held an arm back, that the next
torques make up for. With 0.7, arms that lift a pot swing; with 0.5 for arms in step,
every second ball that Sawyers balance falls."""

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)  # all that decides a world's future
_FEEDFORWARD = 4  # MuJoCo's bit for a motor's only input, a torque


class Torques(modes.ActionMode):
    """A torque of each joint, as a share of its limit, held over the control step.

    The mode compensates gravity of the arm's links and fingers, as torque control of
    real arms does. With an action of zeros, an arm floats until its motors' friction
    stops it. Only an action's torques bear a tool or a load. Real drives take a new
    torque every 1 to 10 ms; a policy that acts every 0.1 s can only hold each torque.
    Near the speed limit, torque falls linearly to zero, as on a DC motor's curve.
    """

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        super().__init__(scene, sim, gripping)
        self._data = mujoco.MjData(sim.model)
        self._motors = {a: _Motors(arm.robot, sim.xp) for a, arm in self.arms.items()}

    @classmethod
    def add_drives(cls, scene: Scene) -> None:
        for agent, robot in scene.robots.items():
            _Motors(robot, np).add(scene.spec, agent, robot)
            for body in robot.spec().bodies[1:]:
                # Servos bear the weight of fingers, which here would bend the arm.
                scene.spec.body(f"{agent}/{body.name}").gravcomp = 1.0
            add_fingers(scene.spec, agent, robot)

    def drive(self, controls: Array, commands: Mapping[str, modes.Command]) -> None:
        for agent, arm in self.arms.items():
            torque = commands[agent].moves * self._motors[agent].limit
            controls[:, :, arm.servos] = torque[:, None]

    def torques(self, sim: Sim, agent: str) -> Array:
        arm = self.arms[agent]
        asked, speed = sim.ctrl[:, arm.servos], sim.qvel[:, arm.dof]
        return self._motors[agent].torque(asked, speed)

    def yields(
        self, torque: Array, before: Array, speed: Array, dt: float, env_ids: EnvIds
    ) -> Array:
        parts, start = [], 0
        for agent, motors in self._motors.items():
            own = slice(start, start := start + self.arms[agent].num_joints)
            steep = motors.steepness(torque[..., own], before[..., own])
            parts.append(steep * (speed[..., own] - before[..., own]))
        return array_namespace(speed).concat(parts, axis=-1)

    def encode(
        self, motions: Mapping[str, modes.Motion], pace: float = 1.0
    ) -> dict[str, np.ndarray]:
        pace = check_number("pace", pace, at_least=0.0, at_most=1.0)
        self._check_motions(motions)
        # What must be slower is the motion; a torque bears loads as well.
        excess = {
            agent: np.abs(motions[agent].change / arm.stride).max(axis=1)
            for agent, arm in self.arms.items()
        }
        together = [excess[agent] for agent in self.arms if motions[agent].in_step]
        slowed = {}
        for agent, motion in motions.items():
            peak = np.max(together if motion.in_step else [excess[agent]], axis=0)
            share = pace / np.maximum(1.0, peak)[:, None]
            slowed[agent] = replace(motion, change=share * motion.change)
        return super().encode(slowed)

    def moves(self, motions: Mapping[str, modes.Motion]) -> modes.Encoded:
        """Return torques by inverse dynamics, clipped; see `ActionMode.moves`."""
        sim, moves = self._sim, {}
        felt = [self._felt(i, state) for i, state in enumerate(sim.get_state())]
        for agent, arm in self.arms.items():
            motion, motors = motions[agent], self._motors[agent]
            rows = zip(*(row[agent] for row in felt), strict=True)
            inertia, lever, torque, back = map(np.stack, rows)
            mass = np.broadcast_to(np.asarray(motion.mass, float), len(felt))[:, None]
            inertia = inertia + mass[:, None] * (lever.swapaxes(1, 2) @ lever)
            speed, wanted = sim.qvel[:, arm.dof], motion.change / CONTROL_DT
            share = _TOGETHER if motion.in_step else _GAIN
            gain = share * (wanted - speed)[..., None] / CONTROL_DT
            # The weight of a load is known, all else that holds back is felt.
            load = np.where(mass > 0.0, GRAVITY * mass * lever[:, 2], _KEPT * back)
            torque = torque + load + (inertia @ gain)[..., 0]
            torque = torque + motors.friction * (speed + wanted) / 2
            moves[agent] = np.clip(torque / motors.limit, -1.0, 1.0)
        return moves, dict.fromkeys(self.arms, np.ones(sim.num_envs))

    def _felt(
        self, env_id: int, state: np.ndarray
    ) -> dict[str, tuple[np.ndarray, ...]]:
        """Return the dynamics of each arm, by agent.

        It is its inertia (joints, joints), the levers of its tcp (3, joints), and two
        torques (joints,) in N m: what going on takes, and what holds it back.
        """
        model, data, felt = self._sim.own_model(env_id), self._data, {}
        with quiet():
            mujoco.mj_setState(model, data, state, _STATE)
            mujoco.mj_forward(model, data)
        inertia, lever = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        # Gravity and its compensation are in these two.
        torque = data.qfrc_bias - data.qfrc_passive
        for agent, arm in self.arms.items():
            mujoco.mj_jacSite(model, data, lever, None, arm.tcp)
            own, back = arm.dof, -data.qfrc_constraint[arm.dof]
            felt[agent] = inertia[own, own], lever[:, own].copy(), torque[own], back
        return felt


class _Motors:
    """The motors of an arm's joints.

    Attributes:
      limit: their greatest torques, (joints,), in N m.
      friction: torque that they lose by speed, (joints,), in N m s/rad.
    """

    def __init__(self, robot: Robot, xp: Any):
        self.limit = xp.asarray(robot.torque_limits)
        limits = xp.asarray(robot.velocity_limits)
        self.friction = _FRICTION * self.limit / limits
        self._top, self._steep = _TOP * limits, xp.asarray(robot.damping)

    def add(self, spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
        """Give the joints of an arm their motors.

        Near the top speed torque falls as steeply as the servos' damping is, which is
        as steep as the physics time step allows.
        """
        for name, torque, friction, top, steep in zip(
            robot.joints, self.limit, self.friction, self._top, self._steep, strict=True
        ):
            joint = f"{agent}/{name}"
            motor = spec.add_actuator(
                name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            # One volt at the top speed, and current by a controller of the torque.
            constant = 1.0 / top
            motor.set_to_dcmotor(
                motorconst=[constant, constant],
                resistance=constant**2 / steep,
                saturation=[torque, 0.0, 0.0],
                controller=[0.0, 0.0, friction, 0.0, 0.0, 1.0],
                ctrlspec=_FEEDFORWARD,
            )

    def torque(self, asked: Array, speed: Array) -> Array:
        """Return the torques that motors exert, (..., joints), in N m."""
        xp = array_namespace(speed)
        low, high = self._line(speed)
        torque = asked - self.friction * speed
        return xp.minimum(xp.maximum(torque, low), high)

    def steepness(self, torque: Array, speed: Array) -> Array:
        """Return by how much torques fall with speed, (..., joints), in N m s/rad."""
        xp = array_namespace(speed)
        low, high = self._line(speed)
        near = 1e-9 * self.limit
        is_on_line = (torque >= high - near) | (torque <= low + near)
        return xp.where(is_on_line, self._steep, self.friction)

    def _line(self, speed: Array) -> tuple[Array, Array]:
        """Return the least and greatest torques that the voltage allows, in N m."""
        low, high = -self._top - speed, self._top - speed
        return self._steep * low, self._steep * high


modes.register_mode("torques", Torques)
