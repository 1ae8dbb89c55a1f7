"""How the experts of Balance and BalancePath play.

They bring the board to a place, tilted so that the ball rolls on its course. Both arms
do their part of the board's motion, at the pace of the slower one.
"""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion.solver import tcp_jacobian
from collaborative_gym.sim.sim import Sim
from collaborative_gym.timing import CONTROL_DT

if TYPE_CHECKING:
    from collaborative_gym.tasks.balance import Balance, BalanceFacts
    from collaborative_gym.tasks.balance_path import BalancePathFacts

STEEPEST = 0.16  # greatest slope of the board
_ROLLING_SLOPE = 0.075  # slope on which the ball just rolls on: 0.003 m / radius
_APPROACH = 1.0  # 1/s, wanted speed over distance
_FASTEST = 0.35  # m/s
_CALM = 0.05  # m/s; when less is wanted, the ball is left to stop by itself
_GAIN = 0.35  # s/m, slope over missing speed
_PULL = 7 / 5 / 9.81  # s2/m, slope over acceleration of a full ball that rolls
_LONGEST_MOVE = 0.03  # m, missing at a time
_LARGEST_TURN = 0.08  # rad, missing at a time; with more, the ball lifts off
_LONGEST_RISE = 0.027  # m, missing at a time; more leaves slow arms no speed to tilt
_LAG = 0.15  # s by which a board that rises comes later than a control step


def expert(self: "Balance", sim: Sim, facts: "BalanceFacts") -> dict[str, Motion]:
    """Return motions that let the ball rest on the middle of a board that stays."""
    still = np.zeros_like(facts.offset)
    return _roll(self, sim, facts, self.centre, [-facts.offset, still, still])


def path_expert(
    self: "Balance", sim: Sim, facts: "BalancePathFacts"
) -> dict[str, Motion]:
    """Return motions that lead the ball after its target on a board that rises."""
    place, velocity, acceleration = facts.coming
    # A ball on the floor cannot be led.
    rise = np.where(facts.fell, 0.0, (place + _LAG * velocity - facts.ball[0])[:, 2])
    centre = np.tile(self.centre, (len(rise), 1))
    centre[:, 2] = facts.board[0][:, 2] + np.clip(rise, -_LONGEST_RISE, _LONGEST_RISE)
    way = place - facts.ball[0] - CONTROL_DT * facts.ball_velocity[0]
    into_board = math.conjugate(facts.board[1])
    course = [math.rotate(into_board, each) for each in (way, velocity, acceleration)]
    return _roll(self, sim, facts, centre, course)


def _roll(
    task: "Balance", sim: Sim, facts: "BalanceFacts", centre: Array, course: list[Array]
) -> dict[str, Motion]:
    """Return motions that bring the board to a place and roll the ball on a course.

    The course is the ball's way, and its velocity and acceleration then, (num_envs, 3)
    each, in the board's frame; the place is that of the board's centre.
    """
    place, quat = facts.board
    missing = np.clip(centre - place, -_LONGEST_MOVE, _LONGEST_MOVE)
    turn = motion.rotation_error(quat, _orientation(facts, course))
    turn = np.clip(turn, -_LARGEST_TURN, _LARGEST_TURN)
    next_quat = math.multiply(math.from_rotation_vector(turn), quat)
    motions = {}
    for agent, arm in task.scene.arms.items():
        goal = task.grasp(agent, place + missing, next_quat)
        hand = sim.pose(f"{agent}/tcp")
        error = [goal[0] - hand[0], motion.rotation_error(hand[1], goal[1])]
        angle, (low, high) = np.asarray(sim.qpos[:, arm.qpos]), arm.joint_range
        change = motion.joint_change(
            tcp_jacobian(sim, arm, hand[0]),
            np.concatenate(error, axis=1),
            nullspace=0.3 * (task.postures[agent] - angle),
            room=(low - angle, high - angle),
        )
        change = motion.settling(sim, arm, change=change)
        motions[agent] = Motion(change, in_step=True)
    return motions


def _orientation(facts: "BalanceFacts", course: list[Array]) -> np.ndarray:
    way, velocity, acceleration = (vector[:, :2] for vector in course)
    into_board = math.conjugate(facts.board[1])
    speed = math.rotate(into_board, facts.ball_velocity[0])[:, :2]
    wanted = motion.shortened(velocity + _APPROACH * way, _FASTEST)
    # Rolling on takes a slope of its own besides that of the acceleration.
    ahead = motion.shortened(wanted / _CALM, 1.0)
    slope = _GAIN * (wanted - speed) + _ROLLING_SLOPE * ahead
    slope = motion.shortened(slope + _PULL * acceleration, STEEPEST)
    # The ball rolls to where the board's normal leans.
    normal = np.stack([-slope[:, 1], slope[:, 0], np.zeros(len(slope))], axis=1)
    return math.from_rotation_vector(normal)
