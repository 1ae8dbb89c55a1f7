"""Loads that an arm can hold by its torque limits, and in which postures.

A load at the tcp asks each joint for a torque that is the load's weight times the
joint's lever. The links are gravity compensated: the whole limit is left for it.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.motion.solver import Goal, Postures, descend, simulated
from collaborative_gym.robots import Robot
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import Arm, Placement, Scene
from collaborative_gym.sim.cpu import CpuSim

UP = np.array([0.0, 0.0, 1.0])
"""The direction in which an arm pulls to hold a weight."""

_SHARPNESS = 8  # exponent of the mean that stands for the greatest torque in slopes
_FIRST_MOVES, _MOVES = 40, 20  # steps of a search at the first and later path points
_LIMIT_ROOM = 0.15  # rad from their limits, where joints stay in strong postures
_TOLERANCE = 0.005  # m, greatest miss of a point that counts as reached
_STARTS = 16  # postures from which each of some positions is searched
_WAYPOINTS, _TRIES = 5, 128  # points of a way, postures from which it is searched
_QUICK_TRIES = 12  # postures from which each of several ways is searched roughly
_REDUNDANT = 7  # joints of an arm that can turn its elbow while its hand stays
_DIPS = np.radians([25.0, 40.0, 60.0, 80.0])  # below level, of hands that keep so
_CLEARANCE = 0.08  # m, least height of an elbow above what the arm stands on


@dataclass(frozen=True)
class Way:
    """The way of an arm that carries a load along a straight line."""

    load: float  # kg that it can hold all along
    angles: np.ndarray  # at each waypoint, (waypoints, joints), in rad
    approach: np.ndarray  # direction of the tcp's z axis at the first waypoint, (3,)

    def at_most(self, load: float) -> "Way":
        """Return the same way, on which the hand holds no more than a load, in kg."""
        return replace(self, load=min(self.load, load))

    def at(self, progress: Array) -> np.ndarray:
        """Return joint angles (n, joints) at shares (n,) of the way."""
        place = np.clip(progress, 0.0, 1.0) * (len(self.angles) - 1)
        before = np.minimum(place.astype(int), len(self.angles) - 2)
        weight = (place - before)[:, None]
        return (1 - weight) * self.angles[before] + weight * self.angles[before + 1]


def torque_shares(robot: Robot, jacobian: Array, pull: Array = UP) -> Array:
    """Return joint torques per kg hung on the tcp, as signed shares of their limits.

    Jacobians are (n, 6, joints); the arm pulls against the load in a direction (3,).
    """
    levers = math.dot(jacobian[:, :3].swapaxes(1, 2), pull)
    return levers * (GRAVITY / np.array(robot.torque_limits))


def relief(robot: Robot, jacobian: Array, pull: Array = UP) -> Array:
    """Return the directions of joint motion that most relieve the arm of a load.

    They are (n, joints) unit vectors, downhill on a smooth maximum of `torque_shares`.
    """
    levers, axes = jacobian[:, :3], jacobian[:, 3:]
    shares = torque_shares(robot, jacobian, pull)
    size = np.abs(shares) / np.abs(shares).max(axis=1, keepdims=True)
    weight = size ** (_SHARPNESS - 1) * np.sign(shares)
    weight = weight / np.array(robot.torque_limits)
    # Turning joint j moves the lever of joint i by axis_j x lever_i if j comes before i
    # on the way to the tcp, else by axis_i x lever_j. The table holds row i, column j
    # of the component along the pull.
    turned = math.cross(np.asarray(pull), axes.swapaxes(1, 2))
    before = math.dot(levers.swapaxes(1, 2)[:, :, None], turned[:, None])
    count = levers.shape[2]
    table = np.where(np.tri(count, dtype=bool), before, before.transpose(0, 2, 1))
    slope = (weight[:, :, None] * table).sum(axis=1)
    return -slope / np.maximum(math.norm(slope), 1e-9)[:, None]


Positions = tuple[tuple[float, float, float], ...]
"""Of a tcp, in the frame of its arm's base, in m."""


def from_base(place: Placement, points: np.ndarray) -> Positions:
    """Return points (n, 3) in the frame of a base, to the micrometre."""
    back = math.from_yaw(np.array(-place.yaw))
    return rounded(math.rotate(back, points - np.array(place.position)))


def rounded(points: np.ndarray) -> Positions:
    """Return points (n, 3) to the micrometre, as arguments of what is cached."""
    return tuple((x, y, z) for x, y, z in (points.round(6) + 0.0).tolist())


def greatest_load(robot: Robot, positions: Positions) -> float:
    """Return the greatest mass in kg that an arm can hold at one of some positions."""
    return max(greatest_loads(robot, positions))


def strength(robot: Robot) -> float:
    """Return the load of an arm well within its reach, in kg, to compare arms.

    Raises:
      ValueError: if it does not come there.
    """
    place = (0.6 * robot.reach, 0.0, 0.3)
    held = greatest_load(robot, (place,))
    if not held:
        raise ValueError(
            f"{robot.name} does not come to {np.round(place, 2).tolist()} as seen from"
            f" its base, well within its reach of {robot.reach:g} m; correct the reach,"
            " or the ranges of its joints"
        )
    return held


@lru_cache(maxsize=256)
def greatest_loads(robot: Robot, positions: Positions) -> tuple[float, ...]:
    """Return the greatest mass in kg that an arm can hold at each of some positions.

    The first joint reaches its torque limit then, in the strongest posture found. It is
    0 if the arm does not reach the position.
    """
    paths = np.repeat(np.array(positions)[:, None], _STARTS, axis=0)
    loads = strong_paths(robot, paths)[0].reshape(len(positions), _STARTS)
    return tuple(loads.max(axis=1).tolist())


def strong_paths(
    robot: Robot, positions: Array, *, approaches: Array | None = None, pull: Array = UP
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how much an arm can hold along paths of its tcp, and in which postures.

    Each path is searched once, from a random posture: repeat a path to search it more
    thoroughly. The postures along a path follow one another without a jump. All is in
    the frame of the arm's base, in m and kg.

    Args:
      robot: the arm.
      positions: (n, points, 3) of the tcp.
      approaches: (n, 3) directions to which the tcp's z axis keeps along each path;
        None leaves the orientation free.
      pull: direction in which the arm pulls against the load, (3,).

    Returns:
      The loads (n,) at the weakest point of each path, 0 where the arm misses a point,
      joint angles (n, points, joints), and the tcp's quaternions (n, points, 4).
    """
    model, arm = alone(robot)
    sim = CpuSim(model, len(positions), num_threads=1)
    low, high = arm.joint_range
    room = np.minimum(_LIMIT_ROOM, (high - low) / 4)
    low, high = low + room, high - room
    bounds = np.maximum(low, -np.pi), np.minimum(high, 2 * np.pi)
    posture = np.random.default_rng(0).uniform(*bounds, (sim.num_envs, len(low)))
    postures = simulated(sim, arm, (low, high))
    loads, angles, quats = np.full(len(positions), np.inf), [], []
    for i in range(positions.shape[1]):
        moves = _FIRST_MOVES if i == 0 else _MOVES
        goal = positions[:, i], approaches
        posture, held = _strengthen(postures, arm.robot, posture, goal, moves, pull)
        loads = np.minimum(loads, held)
        angles.append(posture)
        quats.append(np.array(sim.pose("arm/tcp")[1]))
    return loads, np.stack(angles, axis=1), np.stack(quats, axis=1)


@lru_cache(maxsize=16)
def alone(robot: Robot) -> tuple[mujoco.MjModel, Arm]:
    """Return a world of one arm, whose base is at the origin."""
    scene = Scene()
    scene.add_robot("arm", robot, placement=Placement((0.0, 0.0, 0.0)), stand=False)
    return scene.compile(), scene.arms["arm"]


def _strengthen(
    postures: Postures, robot: Robot, start: Array, goal: Goal, moves: int, pull: Array
) -> tuple[np.ndarray, np.ndarray]:
    """Return strong postures with the tcp at positions, and what they hold."""

    def nullspace(step: int, angle: Array, rows: Array, jacobian: Array) -> Array:
        # The last moves only restore the position.
        return 0.3 * max(0.0, 1 - step / (moves - 6)) * relief(robot, jacobian, pull)

    angles, _ = descend(
        postures,
        start,
        goal=goal,
        steps=moves,
        bound=lambda error: np.clip(error, -0.3, 0.3),
        nullspace=nullspace,
    )
    here, _, jacobian = postures.at(angles, np.arange(len(angles)))
    shares = np.abs(torque_shares(robot, jacobian, pull)).max(axis=1)
    is_there = math.distance(goal[0], here) < _TOLERANCE
    return angles, np.where(is_there, 1 / shares, 0.0)


@lru_cache(maxsize=64)
def strongest_way(
    robot: Robot, *, start: tuple[float, float, float], end: tuple[float, float, float]
) -> Way:
    """Return how an arm carries most from one position of its tcp to another.

    It leaves out ways on which the gripper points up, back to the arm or far aside, and
    ways that do not start with a grasp from above. Of nearly equal ways it takes the
    one with the least joint motion. An arm with fewer than seven joints, whose hand
    follows from its elbow, keeps the hand's direction, and its elbow up.

    Args:
      robot: the arm.
      start: where the load is gripped, in the frame of the arm's base, in m.
      end: where it is brought.

    Raises:
      ValueError: if the arm has no such way.
    """
    share = np.linspace(0.0, 1.0, _WAYPOINTS)[:, None]
    path = (1 - share) * np.array(start) + share * np.array(end)
    loads, angles, quats = _search_ways(robot, np.tile(path, (_TRIES, 1, 1)))
    if not loads.any():
        raise ValueError(
            f"{robot.name} cannot carry a load from {start} to {end} as seen from its"
            " base; mount it nearer or choose an arm with a longer reach"
        )
    motion = np.abs(np.diff(angles, axis=1)).max(axis=(1, 2))
    best = np.where(loads >= 0.95 * loads.max(), motion, np.inf).argmin()
    return Way(float(loads[best]), angles[best], math.axis_z(quats[best, 0]))


def mounted_way(robot: Robot, place: Placement, line: tuple[Array, Array]) -> Way:
    """Return the `strongest_way` of a mounted arm, its approach in the world frame.

    Args:
      robot: the arm.
      place: where it is mounted.
      line: start and end (3,) of its tcp, in the world frame, in m.
    """
    start, end = from_base(place, np.array(line))
    way = strongest_way(robot, start=start, end=end)
    turn = math.from_yaw(np.array(place.yaw))
    return replace(way, approach=math.rotate(turn, way.approach))


@lru_cache(maxsize=64)
def way_loads(robot: Robot, lines: tuple[Positions, ...]) -> tuple[float, ...]:
    """Return about how much an arm carries along lines of its tcp, in kg.

    It is the load of `strongest_way`, or less, found by a search a tenth as long; 0
    where the arm has no such way.

    Args:
      robot: the arm.
      lines: start and end of each, as `strongest_way` takes them.
    """
    paths = np.repeat(np.array(lines), _QUICK_TRIES, axis=0)
    loads = _search_ways(robot, paths)[0].reshape(len(lines), _QUICK_TRIES)
    return tuple(loads.max(axis=1).tolist())


def _search_ways(robot: Robot, paths: Array) -> tuple[Array, Array, Array]:
    """Return paths as `strong_paths` does, with loads of 0 on ways that do not fit.

    The paths (n, points, 3) all begin in the same direction from the arm's base.
    """
    ahead = np.array([*paths[0, 0, :2], 0.0]) / np.hypot(*paths[0, 0, :2])
    if len(robot.joints) < _REDUNDANT:
        # Left free, the hand would turn aside to where it is nearer to the load.
        dip = np.resize(_DIPS, len(paths))[:, None]
        directions = np.cos(dip) * ahead - np.sin(dip) * (0.0, 0.0, 1.0)
        loads, angles, quats = strong_paths(robot, paths, approaches=directions)
        loads = np.where(_stays_above(robot, angles, paths), loads, 0.0)
    else:
        loads, angles, quats = strong_paths(robot, paths)
    return np.where(_points_ahead(quats, ahead), loads, 0.0), angles, quats


def _stays_above(robot: Robot, angles: np.ndarray, paths: Array) -> np.ndarray:
    """Return on which ways no elbow is lower than both the load and the arm's table."""
    model, arm = alone(robot)
    data = mujoco.MjData(model)
    # The first joint that carries another one stays where it is.
    elbows = model.dof_jntid[arm.dof][2:]
    stays = np.ones(len(angles), bool)
    for i, (way, path) in enumerate(zip(angles, paths, strict=True)):
        for posture, point in zip(way, path, strict=True):
            data.qpos[arm.qpos] = posture
            mujoco.mj_kinematics(model, data)
            lowest = data.xanchor[elbows, 2].min(initial=np.inf)
            stays[i] &= lowest > min(_CLEARANCE, point[2])
    return stays


def _points_ahead(quats: Array, ahead: Array) -> np.ndarray:
    """Return on which ways the gripper points ahead, and at first down."""
    x, y, z = np.moveaxis(math.axis_z(quats), -1, 0)
    along, aside = x * ahead[0] + y * ahead[1], x * ahead[1] - y * ahead[0]
    fit = (along > -0.1) & (np.abs(aside) < 0.5) & (z < 0.3)
    return fit.all(axis=1) & (z[:, 0] < -0.3)
