"""What turns the joints of arms, and what brakes them.

The law of the servos stands here alone: what they ask of their motors, how far they
yield, and how their targets move when a joint is to turn.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene import STOP, Arm
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE, SIM_DT, SUBSTEPS

_BRAKE_FROM = 1.1
"""Speed from which on a joint is braked, over its limit; free motion stays below."""

_BRAKE_GAIN = 40.0
"""Slope of the brake's torque over the speed, in torque limits per speed limit."""

_LOST, _MOVING = 0.3, 0.0025
"""Greatest share of a load that servos let go of, and the change of an angle, in rad,
from which they do so. Both are our choice; see `lost_load`."""

_NO_LIMIT = 1e6
"""A torque in N m that is never reached."""

_RAMP = 0.03
"""Time in which a joint's reference speed goes from rest to full, in s. Shorter asks
for more torque than the motors have; longer turns too little in one control step."""

_SPEED_MARGIN = 1.04
"""How far the reference may pass a joint's speed limit to make up for the ramp."""

_SLACK = 1.0 + 0.5 * _RAMP / CONTROL_DT
"""A joint that arrives at a limit must also come to rest there."""


def add_servos(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Let a servo turn each joint of an arm.

    A position servo whose target moves at the commanded speed, as MuJoCo's intvelocity
    actuator; `Servo.command` keeps the limits of the speed.
    """
    rows = zip(
        robot.joints, robot.torque_limits, robot.stiffness, robot.damping, strict=True
    )
    for name, torque, stiffness, damping in rows:
        joint = f"{agent}/{name}"
        bias, torques = (0.0, -stiffness, -damping), (-torque, torque)
        servo = _add(spec, joint, joint, gain=stiffness, bias=bias, torques=torques)
        servo.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR


def add_brakes(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Brake joints that something else turns faster than their motors may.

    Real drives short the windings of a motor that turns too fast. Then the torque grows
    with the speed, and the motor's limit does not hold for it. Here one actuator brakes
    each direction of turning, and never pushes.
    """
    rows = zip(robot.joints, robot.torque_limits, robot.velocity_limits, strict=True)
    for name, torque, speed in rows:
        joint, slope = f"{agent}/{name}", _BRAKE_GAIN * torque / speed
        start = slope * _BRAKE_FROM * speed
        for way, bias, torques in (
            ("forwards", (start, 0.0, -slope), (-_NO_LIMIT, 0.0)),
            ("backwards", (-start, 0.0, -slope), (0.0, _NO_LIMIT)),
        ):
            brake = f"{joint}/brake {way}"
            _add(spec, joint, brake, gain=0.0, bias=bias, torques=torques)


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
        finger.set_to_position(kp=force / 0.1, dampratio=1.0)
        finger.forcelimited = True
        finger.forcerange = [-force, force]


def _add(
    spec: mujoco.MjSpec,
    joint: str,
    name: str,
    *,
    gain: float,
    bias: tuple[float, float, float],
    torques: tuple[float, float],
) -> mujoco.MjsActuator:
    """Add what turns a joint by a gain and a bias, as MuJoCo's manual defines them."""
    return spec.add_actuator(
        name=name,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[gain] + [0.0] * 9,
        biasprm=[*bias] + [0.0] * 7,
        forcelimited=True,
        forcerange=torques,
    )


@dataclass(frozen=True)
class Servo:
    """The servos of one arm; (joints,) arrays of the worlds' kind.

    Attributes:
      arm: whose they are.
      act: their integrated targets in `act`.
      stiffness: in N m/rad.
      damping: in N m s/rad.
      torque: greatest, in N m.
      full: greatest speed that is asked for, in rad/s.
      fastest: greatest reference speed, in rad/s.
      low: least angles to go to, in rad.
      high: greatest angles to go to, in rad.
      ramp: how far a speed may have changed by each physics step and by the one after
        the last, (substeps + 1, num_envs, joints), in rad/s. It is the same in all
        worlds, but NumPy is quicker with a row for each; the same holds for `lead`.
      lead: damping over stiffness, (num_envs, joints), in s.
    """

    arm: Arm
    act: slice
    stiffness: Array
    damping: Array
    torque: Array
    full: Array
    fastest: Array
    low: Array
    high: Array
    ramp: Array
    lead: Array

    @classmethod
    def of(cls, arm: Arm, sim: Sim) -> "Servo":
        """Return the servos that `add_servos` gave an arm of these worlds."""
        robot, xp = arm.robot, sim.xp
        limits = np.array(robot.velocity_limits)
        full = np.minimum(MAX_CHANGE / CONTROL_DT, limits)
        ramp = np.arange(1.0, SUBSTEPS + 2)[:, None] * (full * SIM_DT / _RAMP)
        lead = np.array(robot.damping) / np.array(robot.stiffness)
        first = int(sim.model.actuator_actadr[arm.servos.start])
        return cls(
            arm=arm,
            act=slice(first, first + arm.num_joints),
            stiffness=xp.asarray(robot.stiffness),
            damping=xp.asarray(robot.damping),
            torque=xp.asarray(robot.torque_limits),
            full=xp.asarray(full),
            fastest=xp.asarray(_SPEED_MARGIN * limits),
            low=xp.asarray(arm.joint_range[0] + STOP),
            high=xp.asarray(arm.joint_range[1] - STOP),
            ramp=xp.asarray(np.stack([ramp] * sim.num_envs, axis=1)),
            lead=xp.asarray(np.stack([lead] * sim.num_envs)),
        )

    def hold(self, sim: Sim, env_ids: EnvIds) -> None:
        """Make the servos of these worlds hold the present angles."""
        sim.act[env_ids, self.act] = sim.qpos[env_ids, self.arm.qpos]

    def torques(self, sim: Sim) -> Array:
        """Return what the servos ask of their motors, (num_envs, joints), in N m."""
        angle, speed = sim.qpos[:, self.arm.qpos], sim.qvel[:, self.arm.dof]
        return self.stiffness * (sim.act[:, self.act] - angle) - self.damping * speed

    def yields(self, before: Array, speed: Array, dt: float) -> Array:
        """Return what torque the servos lose as the joints turn during a step, in N m.

        Args:
          before: speeds at the step's beginning, (..., joints), in rad/s.
          speed: those at its end.
          dt: how long it is, in s.
        """
        return self.stiffness * dt * speed + self.damping * (speed - before)

    def turn_against(self, torque: Array) -> Array:
        """Return by how much more a joint must be turned to exert a torque, in rad.

        A change that a joint cannot follow becomes torque: the change times the servo's
        stiffness, and the speed times its damping.
        """
        return torque / (self.stiffness + self.damping / CONTROL_DT)

    def command(self, sim: Sim, controls: Array, change: Array) -> None:
        """Write how the targets move during a control step that turns the joints.

        The reference speed ramps from the measured one to that which brings the joint
        to its new angle in time. The servo's target leads the reference angle by
        damping / stiffness times the speed, which turns damping into feedback on the
        speed error, and by most of what the servo yields to its present load.

        Args:
          sim: the worlds.
          controls: (num_envs, substeps, nu), what is written to.
          change: of the joint angles, (num_envs, joints), in rad.
        """
        arm, xp, full, fastest = self.arm, sim.xp, self.full, self.fastest
        angle, speed = sim.qpos[:, arm.qpos], sim.qvel[:, arm.dof]
        kept = 1.0 - lost_load(change, xp)
        change = xp.maximum(change, (self.low - angle) / _SLACK)
        change = xp.minimum(change, (self.high - angle) / _SLACK)
        load = xp.minimum(xp.maximum(self.torques(sim), -self.torque), self.torque)
        load = load * kept / self.stiffness
        start = xp.minimum(xp.maximum(speed, -full), full)
        ramp = xp.abs(change / CONTROL_DT - start) / full * _RAMP
        final = (change - start * ramp / 2) / (CONTROL_DT - ramp / 2)
        final = xp.minimum(xp.maximum(final, -fastest), fastest)
        # The reference speed of each physics step, and of the one after the last.
        ramped = xp.maximum(final - start, -self.ramp)
        reference = start + xp.minimum(ramped, self.ramp)
        ahead = self.lead / SIM_DT * (reference[1:] - reference[:-1])
        sim.act[:, self.act] = angle + self.lead * reference[0] + load
        controls[:, :, arm.servos] = xp.moveaxis(reference[:-1] + ahead, 0, 1)


def lost_load(change: Array, xp: Any = np) -> Array:
    """Return what share of its load an arm lets go of in a control step.

    An arm that is not asked to move keeps the torques that it exerts. An arm that moves
    lets go of a part. If it kept all, two arms that push against each other on a thing
    would do so until an action happened to undo it, and the joint angles do not show
    such a force. So the force halves in 0.2 s, and an arm must act to hold a weight.

    Args:
      change: of its joints, (num_envs, joints), in rad.
      xp: array API namespace of the change.

    Returns:
      (num_envs, 1) between 0 and 0.3.
    """
    greatest = xp.max(xp.abs(change), axis=1)[:, None]
    return _LOST * xp.minimum(greatest / _MOVING, 1.0)
