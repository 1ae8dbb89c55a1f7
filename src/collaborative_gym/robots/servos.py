"""Torque limits and servo gains, from model files, for arms that do not name theirs.

A servo's damping is what holds a joint to its speed. At the physics time step, damping
beyond twice the joint's inertia over the time step chatters; half of that follows
commands well and leaves room for postures in which the inertia is less. A joint too
light for its motor has next to no damping then, so rotors are made heavy enough. With
these rules Sawyer, Panda and Jaco follow commands as well as with gains found by hand
(`python benchmarks/servo.py --computed`).
"""

import mujoco
import numpy as np

from collaborative_gym.robots.checks import at_home
from collaborative_gym.robots.data import RobotData
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE, SIM_DT

_RISE = 0.02
"""Least time in s that a joint takes from rest to full speed at its torque limit."""

_ROTOR_RISE = 0.01  # least time in s that its rotor alone takes


def torque_limits(robot: RobotData, spec: mujoco.MjSpec) -> tuple[float, ...]:
    """Return the torque limits of the model file, in N m.

    Raises:
      ValueError: if it has none for a joint.
    """
    limits = []
    for name in robot.joints:
        low, high = spec.joint(name).actfrcrange
        limits.append(float(min(-low, high)))
        if not limits[-1] > 0:
            raise ValueError(
                f"its model file has no torque limit for joint {name!r}; pass"
                ' torque_limits, or give it in the file (<limit effort="..."> in URDF,'
                " actuatorfrcrange of the joint or forcerange of its actuator in MJCF)"
            )
    return tuple(limits)


def gains(
    robot: RobotData, model: mujoco.MjModel
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return rotor inertias in kg m2, and velocity gains of the servos in N m s/rad.

    The inertias are those of the robot or else of the model file, where it has any.
    """
    data = at_home(robot, model, robot.gripper.open_position)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dofs = [int(model.joint(name).dofadr[0]) for name in robot.joints]
    own = model.dof_armature[dofs]
    links = np.diag(full)[dofs] - own
    speed = np.minimum(robot.velocity_limits, MAX_CHANGE / CONTROL_DT)
    push = np.array(robot.torque_limits) / speed
    rotors = np.maximum(_RISE * push - links, _ROTOR_RISE * push)
    armature = robot.armature or tuple(np.where(own > 0, own, rotors).tolist())
    return armature, tuple(((links + np.array(armature)) / SIM_DT).tolist())
