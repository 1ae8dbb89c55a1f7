"""What turns the joints of arms, and what brakes them."""

from typing import Any

import mujoco
import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.robots.robot import Robot

_BRAKE_FROM = 1.1
"""Speed from which on a joint is braked, over its limit; free motion stays below."""

_BRAKE_GAIN = 40.0
"""Slope of the brake's torque over the speed, in torque limits per speed limit."""

_LOST, _MOVING = 0.3, 0.0025
"""Greatest share of a load that servos let go of, and the change of an angle, in rad,
from which they do so. Both are our choice; see `lost_load`."""

_NO_LIMIT = 1e6
"""A torque in N m that is never reached."""


def add_servos(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Let a servo turn each joint of an arm.

    A position servo whose target moves at the commanded speed, as MuJoCo's intvelocity
    actuator; the controller keeps the limits of the speed.
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


def add_finger(spec: mujoco.MjSpec, joint: str, *, force: float) -> None:
    """Let a soft servo move a finger: fingers are light, and a grip is a constraint.

    Args:
      spec: the world.
      joint: the finger's.
      force: its limit, in N or N m.
    """
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
