"""Drives of the arms' joints.

The law of the servos stands here alone: what they ask of their motors, how far they
yield, and how their targets move when a joint is to turn.
"""

from typing import Any

import mujoco
import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene import STOP, Arm
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE, SIM_DT, SUBSTEPS

_LOST, _MOVING = 0.3, 0.0025
"""Greatest share of a load that servos let go of, and the change of an angle, in rad,
from which they do so. Both are our choice; see `lost_load`."""

_RAMP = 0.03
"""Time in which a joint's reference speed goes from rest to full, in s. Shorter asks
for more torque than the motors have; longer turns too little in one control step."""

FULL = 0.1
"""How far a finger is from its target, in m or rad, as its servo presses with all its
force. Our choice."""

_SPEED_MARGIN = 1.04  # reference over a joint's speed limit, to make up for the ramp
_SLACK = 1.0 + 0.5 * _RAMP / CONTROL_DT  # a joint must also come to rest at a limit


def add_servos(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Let a servo turn each joint of an arm.

    A position servo whose target moves at the commanded speed, as MuJoCo's intvelocity
    actuator; `Servo.command` keeps the limits of the speed.

    Nothing else brakes a joint, so a motor brakes with its limit at most, however fast
    something turns it. Drives that short the windings of such a motor keep to their
    peak current, too (Kollmorgen, "AKD User Manual", "Dynamic Braking").
    """
    rows = zip(
        robot.joints, robot.torque_limits, robot.stiffness, robot.damping, strict=True
    )
    for name, torque, stiffness, damping in rows:
        spec.add_actuator(
            name=f"{agent}/{name}",
            target=f"{agent}/{name}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
            gainprm=[stiffness] + [0.0] * 9,
            biasprm=[0.0, -stiffness, -damping] + [0.0] * 7,
            forcelimited=True,
            forcerange=(-torque, torque),
        )


def add_fingers(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Let soft servos move an arm's fingers, unless they are fixed.

    Fingers are light, and a grip is a constraint.
    """
    force = robot.gripper.force
    for name in robot.gripper.joints:
        joint = f"{agent}/{name}"
        if spec.joint(joint) is None:
            continue
        finger = spec.add_actuator(
            name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        finger.set_to_position(kp=force / FULL, dampratio=1.0)
        finger.forcelimited = True
        finger.forcerange = [-force, force]


Gains = tuple[Array, Array]


class Servo:
    """The servos that `add_servos` gave an arm of some worlds.

    Attributes:
      gains: stiffness in N m/rad and damping in N m s/rad, (num_envs, joints) each, or
        (1, joints) where they are the same in all worlds.
      full: greatest speed that is asked for, (joints,), in rad/s.
      low: least angles to go to, (joints,), in rad.
      high: greatest angles to go to, likewise.
    """

    def __init__(self, arm: Arm, sim: Sim):
        robot, xp = arm.robot, sim.xp
        limits = np.array(robot.velocity_limits)
        full = np.minimum(MAX_CHANGE / CONTROL_DT, limits)
        first = int(sim.model.actuator_actadr[arm.servos.start])
        self._arm, self._act = arm, slice(first, first + arm.num_joints)
        self.gains: Gains = xp.asarray([robot.stiffness]), xp.asarray([robot.damping])
        self._torque = xp.asarray(robot.torque_limits)
        self.full, self._fastest = xp.asarray(full), xp.asarray(_SPEED_MARGIN * limits)
        self.low = xp.asarray(arm.joint_range[0] + STOP)
        self.high = xp.asarray(arm.joint_range[1] - STOP)
        # How far a speed may have changed by each physics step and by the one after the
        # last, in rad/s. It is the same in all worlds, but rows are quicker.
        ramp = np.arange(1.0, SUBSTEPS + 2)[:, None] * (full * SIM_DT / _RAMP)
        ramp = np.stack([ramp] * sim.num_envs, axis=1)
        self._least, self._most = xp.asarray(-ramp), xp.asarray(ramp)

    def hold(self, sim: Sim, env_ids: EnvIds) -> None:
        """Make the servos of these worlds hold the present angles."""
        sim.act[env_ids, self._act] = sim.qpos[env_ids, self._arm.qpos]

    def torques(self, sim: Sim, gains: Gains | None = None) -> Array:
        """Return the torques that the servos ask for, (num_envs, joints), in N m."""
        angle, speed = sim.qpos[:, self._arm.qpos], sim.qvel[:, self._arm.dof]
        stiffness, damping = gains or self.gains
        return stiffness * (sim.act[:, self._act] - angle) - damping * speed

    def yields(self, before: Array, speed: Array, dt: float, env_ids: EnvIds) -> Array:
        """Return the torque that servos lose in a step; see `ActionMode.yields`."""
        rows = [each if len(each) == 1 else each[env_ids] for each in self.gains]
        stiffness, damping = (each[:, None] for each in rows)
        return stiffness * dt * speed + damping * (speed - before)

    def speed(self, sim: Sim) -> Array:
        """Return the speed from which the reference goes on, (num_envs, joints)."""
        return sim.qvel[:, self._arm.dof]

    def turn_against(self, torque: Array) -> Array:
        """Return by how much more a joint must turn to exert a torque, in rad."""
        stiffness, damping = self.gains
        return torque / (stiffness + damping / CONTROL_DT)

    def command(self, sim: Sim, controls: Array, change: Array) -> None:
        """Write how the targets move during a control step that turns the joints.

        The reference speed ramps from the measured one to that which brings the joint
        to its new angle in time. The servo's target leads the reference angle by
        damping / stiffness times the speed, which turns damping into feedback on the
        speed error, and by most of what the servo yields to its present load.
        """
        arm, xp, full, fastest = self._arm, sim.xp, self.full, self._fastest
        angle = sim.qpos[:, arm.qpos]
        speed = self.speed(sim)
        stiffness, damping = self.gains
        lead = damping / stiffness + xp.zeros_like(angle)  # Quicker, as above.
        kept = 1.0 - lost_load(change, xp)
        change = xp.maximum(change, (self.low - angle) / _SLACK)
        change = xp.minimum(change, (self.high - angle) / _SLACK)
        load = stiffness * (sim.act[:, self._act] - angle) - damping * speed
        load = xp.minimum(xp.maximum(load, -self._torque), self._torque)
        load = load * kept / stiffness
        start = xp.minimum(xp.maximum(speed, -full), full)
        ramp = xp.abs(change / CONTROL_DT - start) / full * _RAMP
        final = (change - start * ramp / 2) / (CONTROL_DT - ramp / 2)
        final = xp.minimum(xp.maximum(final, -fastest), fastest)
        # The reference speed of each physics step, and of the one after the last.
        ramped = xp.minimum(xp.maximum(final - start, self._least), self._most)
        reference = start + ramped
        ahead = lead / SIM_DT * (reference[1:] - reference[:-1])
        sim.act[:, self._act] = angle + lead * reference[0] + load
        controls[:, :, arm.servos] = xp.moveaxis(reference[:-1] + ahead, 0, 1)


def lost_load(change: Array, xp: Any = np) -> Array:
    """Return the share of its load that an arm drops in a step, (num_envs, 1).

    An arm that is not asked to move keeps the torques that it exerts. An arm that moves
    lets go of a part. If it kept all, two arms that push against each other on a thing
    would do so until an action happened to undo it, and the joint angles do not show
    such a force. So the force halves in 0.2 s, and an arm must act to hold a weight.
    """
    greatest = xp.max(xp.abs(change), axis=1)[:, None]
    return _LOST * xp.minimum(greatest / _MOVING, 1.0)
