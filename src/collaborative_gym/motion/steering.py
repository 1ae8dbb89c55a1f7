"""Joint changes that bring tcps to goals, a control step at a time, in many worlds."""

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.motion import solver
from collaborative_gym.scene import Arm
from collaborative_gym.sim.sim import Sim
from collaborative_gym.timing import CONTROL_DT

_GAIN, _BRAKE = 0.45, 0.1
"""Shares of a missing change, and of the present motion against it, that `settling`
asks for. With actions that are done at once, a miss falls to 0.61 in a step, and with
actions that are a control step late to 0.58; no other pair has both as small."""

_REACHING, _CARRYING, _CALM = 0.2, 0.8, 0.2
"""Gains towards the posture: of `reach`, of `carry`, and of `carry` where it is calm;
`settling` leaves a part."""

_NEAR = 0.05
"""Distance of a tcp to its goal, in m, below which a posture counts less and less."""

_FARTHEST = 0.2
"""Greatest way of a tcp that `reach` plans at a time, in m; thrice that in rad."""


def shortened(vector: Array, longest: float) -> Array:
    """Return vectors no longer than `longest`, their directions kept."""
    length = math.norm(vector)[..., None]
    return vector * np.minimum(1.0, longest / np.maximum(length, 1e-9))


def reach(
    sim: Sim,
    arm: Arm,
    *,
    tcp: tuple[Array, Array],
    goal: tuple[Array, Array],
    posture: Array,
) -> Array:
    """Return joint changes that bring a tcp towards a pose, by resolved-rate control.

    The posture counts less the nearer the goal is, where the arm rests (`settling`).

    Args:
      sim: the worlds.
      arm: whose tcp.
      tcp: its position (num_envs, 3) and quaternion (num_envs, 4).
      goal: where it should go, (num_envs, 3), and its quaternion there (num_envs, 4)
        or the direction of its approach (num_envs, 3).
      posture: joint angles to prefer, (joints,), in rad.

    Returns:
      (num_envs, joints) in rad, also more than the joints can do in a step.
    """
    position, orientation = goal
    missing = shortened(position - tcp[0], _FARTHEST)
    turn = shortened(solver.rotation_error(tcp[1], orientation), 3 * _FARTHEST)
    jacobian = solver.tcp_jacobian(sim, arm, tcp[0])
    error = np.concatenate([missing, turn], axis=1)
    if orientation.shape[-1] == 3:
        jacobian, error = solver.without_spin(jacobian, error, math.axis_z(tcp[1]))
    size = np.maximum(math.norm(missing), math.norm(turn) / 3)
    share = _REACHING * np.minimum(1.0, size / _NEAR)
    change = _with_posture(sim, arm, jacobian, error, posture, share)
    return settling(sim, arm, change=change)


def settling(sim: Sim, arm: Arm, *, change: Array) -> Array:
    """Return the part of a joint change that comes to its goal without swinging.

    The whole change would bring the joint there at once, and past it where actions come
    late: the measured angle does not show the actions that are still under way.

    Args:
      sim: the worlds.
      arm: whose joints.
      change: (num_envs, joints) from the present angles to the goal, in rad.
    """
    return _GAIN * change - _BRAKE * CONTROL_DT * sim.qvel[:, arm.dof]


def _with_posture(
    sim: Sim, arm: Arm, jacobian: Array, error: Array, posture: Array, share: Array
) -> np.ndarray:
    """Return joint changes that make up for an error and go a share to a posture."""
    angle = np.asarray(sim.qpos[:, arm.qpos])
    low, high = arm.joint_range
    nullspace = np.clip(share[:, None] * (posture - angle), -arm.stride, arm.stride)
    room = low - angle, high - angle
    return solver.joint_change(jacobian, error, nullspace=nullspace, room=room)


def standoff(
    offset: Array, approach: Array, *, slack: float, least: float, most: float
) -> Array:
    """Return the distance that a hand keeps from its goal until the two are aligned.

    Args:
      offset: (num_envs, 3) from the goal to the hand, in m.
      approach: (3,) direction in which the hand goes to its goal.
      slack: distance from the line of approach that does not matter, in m.
      least: smallest result, in m.
      most: greatest result, in m.

    Returns:
      (num_envs, 1) in m: twice the distance from the line beyond the slack.
    """
    along = math.dot(offset, approach)[:, None]
    aside = math.norm(offset - along * approach)
    return np.clip(2.0 * (aside - slack), least, most)[:, None]


def carry(
    sim: Sim,
    arm: Arm,
    *,
    tcp: Array,
    goal: Array,
    posture: Array,
    is_loaded: Array,
    is_calm: bool = False,
) -> np.ndarray:
    """Return joint changes that bring a tcp and its load to a goal, near a posture.

    They relax what arms that hold one thing exert on each other. Without a
    load the posture counts less the nearer the goal is, where it rests (`settling`).

    Args:
      sim: the worlds.
      arm: whose tcp.
      tcp: (num_envs, 3) where it is.
      goal: (num_envs, 3) where it should go, in m.
      posture: (num_envs, joints) angles to keep to, in rad.
      is_loaded: (num_envs,) where the tcp bears a load.
      is_calm: whether it comes to the posture slowly. As joints turn, a tcp leaves its
        line a little, and arms that hold one thing push one another.

    Returns:
      (num_envs, joints) in rad, not limited.
    """
    rows = sim.jacobian(arm.hand, tcp)[0][:, :, arm.dof]
    nearness = np.minimum(1.0, math.distance(goal, tcp) / _NEAR)
    share = (_CALM if is_calm else _CARRYING) * np.where(is_loaded, 1.0, nearness)
    change = _with_posture(sim, arm, rows, goal - tcp, posture, share)
    return settling(sim, arm, change=change)
