"""How much an arm can hold, from its joint torque limits, and how it carries that.

A load at the tcp asks each joint for a torque that is the load's weight times the
joint's lever. The arm's links are gravity compensated, so that the whole torque limit
is there for the load.
"""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.motion.kinematics import aim, joint_change
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Arm, Placement, Scene
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.sim.sim import Sim

GRAVITY = 9.81
"""m/s2, MuJoCo's default."""

_SHARPNESS = 8
"""Exponent of the mean that stands for the greatest torque where a slope is needed."""

_FIRST_MOVES, _MOVES = 40, 20
"""Steps of a search for a strong posture, at the first and at later path points."""

_LIMIT_ROOM = 0.15
"""How far from their limits joints stay in strong postures, in rad."""

_TOLERANCE = 0.005
"""Greatest miss of a point that counts as reached, in m."""

_WAYPOINTS, _TRIES = 5, 128
"""Points of a way, and from how many postures it is searched."""

_REDUNDANT = 7
"""Joints from which on an arm can turn its elbow while the hand stays as it is."""

_DIPS = np.radians([25.0, 40.0, 60.0, 80.0])
"""How far down the gripper points where it is held to a direction, in rad."""

_CLEARANCE = 0.08
"""Least height in m of an arm's elbow above what the arm stands on."""

_YIELD = 0.5
"""Share of an unneeded torque that `carry` lets go in a step."""


@dataclass(frozen=True)
class Way:
    """How an arm carries a load along a straight line.

    Attributes:
      load: the mass in kg that it can hold all along.
      angles: joint angles at each waypoint, (waypoints, joints), in rad.
      approach: direction of the tcp's z axis at the first waypoint, (3,).
    """

    load: float
    angles: np.ndarray
    approach: np.ndarray

    def at(self, progress: Array) -> np.ndarray:
        """Return joint angles (n, joints) at shares (n,) of the way."""
        place = np.clip(progress, 0.0, 1.0) * (len(self.angles) - 1)
        before = np.minimum(place.astype(int), len(self.angles) - 2)
        weight = (place - before)[:, None]
        return (1 - weight) * self.angles[before] + weight * self.angles[before + 1]


def torque_shares(arm: Arm, translation: Array) -> Array:
    """Return joint torques per kg hung on the tcp, as signed shares of their limits.

    Args:
      arm: whose tcp.
      translation: (n, 3, nv) Jacobian of the tcp's position.
    """
    return translation[:, 2, arm.dof] * (GRAVITY / np.array(arm.robot.torque_limits))


def relief(arm: Arm, translation: Array, rotation: Array) -> Array:
    """Return the direction of joint motion that most relieves the arm of a load.

    Args:
      arm: whose tcp.
      translation: (n, 3, nv) Jacobian of the tcp's position.
      rotation: (n, 3, nv) Jacobian of its orientation.

    Returns:
      (n, joints) unit vectors, downhill on a smooth maximum of `torque_shares`.
    """
    levers, axes = translation[:, :, arm.dof], rotation[:, :, arm.dof]
    shares = torque_shares(arm, translation)
    size = np.abs(shares) / np.abs(shares).max(axis=1, keepdims=True)
    weight = size ** (_SHARPNESS - 1) * np.sign(shares)
    weight = weight / np.array(arm.robot.torque_limits)
    # Turning joint j moves the lever of joint i by axis_j x lever_i if j comes before i
    # on the way to the tcp, else by axis_i x lever_j. The table holds row i, column j
    # of the z component.
    before = axes[:, 0, None, :] * levers[:, 1, :, None]
    before = before - axes[:, 1, None, :] * levers[:, 0, :, None]
    count = levers.shape[2]
    table = np.where(np.tri(count, dtype=bool), before, before.transpose(0, 2, 1))
    slope = (weight[:, :, None] * table).sum(axis=1)
    return -slope / np.maximum(math.norm(slope), 1e-9)[:, None]


@lru_cache(maxsize=256)
def greatest_load(
    robot: Robot, positions: tuple[tuple[float, float, float], ...], tries: int = 16
) -> float:
    """Return the greatest mass in kg that an arm can hold at one of some positions.

    Args:
      robot: the arm.
      positions: of the tcp, in the frame of the arm's base, in m.
      tries: postures to start the search from at each position.

    Returns:
      The mass at which the first joint reaches its torque limit, in the strongest
      posture found; 0 if the arm reaches none of the positions.
    """
    paths = np.repeat(np.array(positions)[:, None], tries, axis=0)
    return float(strong_paths(robot, paths)[0].max())


def strong_paths(
    robot: Robot, positions: Array, approaches: Array | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how much an arm can hold along paths of its tcp, and in which postures.

    Each path is searched once, from a random posture: repeat a path to search it more
    thoroughly. The postures along a path follow one another without a jump.

    Args:
      robot: the arm.
      positions: (n, points, 3) of the tcp, in the frame of the arm's base, in m.
      approaches: (n, 3) directions to which the tcp's z axis keeps along each path, in
        the same frame; None leaves the orientation free.

    Returns:
      The loads (n,) in kg at the weakest point of each path, 0 where the arm misses a
      point, the joint angles (n, points, joints), and the orientations of the tcp
      (n, points, 4) that come of them, in the frame of the base.
    """
    scene = Scene()
    scene.add_robot("arm", robot, Placement((0.0, 0.0, 0.0)), stand=False)
    sim = CpuSim(scene.compile(), len(positions), num_threads=1)
    arm = scene.arms["arm"]
    low, high = _range(arm)
    bounds = np.maximum(low, -np.pi), np.minimum(high, 2 * np.pi)
    rng = np.random.default_rng(0)
    sim.qpos[:, arm.qpos] = rng.uniform(*bounds, (sim.num_envs, len(low)))
    loads, angles, quats = np.full(len(positions), np.inf), [], []
    for i in range(positions.shape[1]):
        moves = _FIRST_MOVES if i == 0 else _MOVES
        held = _strengthen(sim, arm, positions[:, i], moves, approaches)
        loads = np.minimum(loads, held)
        angles.append(np.array(sim.qpos[:, arm.qpos]))
        quats.append(np.array(sim.pose("arm/tcp")[1]))
    return loads, np.stack(angles, axis=1), np.stack(quats, axis=1)


@lru_cache(maxsize=64)
def strongest_way(
    robot: Robot, start: tuple[float, float, float], end: tuple[float, float, float]
) -> Way:
    """Return how an arm carries most from one position of its tcp to another.

    Left out are ways on which the gripper points up, back to the arm or far aside, and
    those that start with anything but a grasp from above. Of nearly equal ways the one
    with the least joint motion is taken. An arm with fewer than seven joints, whose
    hand follows from its elbow, keeps the hand's direction, and its elbow up.

    Args:
      robot: the arm.
      start: where the load is gripped, in the frame of the arm's base, in m.
      end: where it is brought.

    Raises:
      ValueError: if the arm has no such way.
    """
    share = np.linspace(0.0, 1.0, _WAYPOINTS)[:, None]
    path = (1 - share) * np.array(start) + share * np.array(end)
    paths = np.tile(path, (_TRIES, 1, 1))
    ahead = np.array([*start[:2], 0.0]) / np.hypot(*start[:2])
    if len(robot.joints) < _REDUNDANT:
        # Left free, the hand would turn aside to where it is nearer to the load.
        dip = np.resize(_DIPS, _TRIES)[:, None]
        directions = np.cos(dip) * ahead - np.sin(dip) * (0.0, 0.0, 1.0)
        loads, angles, quats = strong_paths(robot, paths, directions)
        loads = np.where(_stays_above(robot, angles, path), loads, 0.0)
    else:
        loads, angles, quats = strong_paths(robot, paths)
    loads = np.where(_points_ahead(quats, ahead), loads, 0.0)
    if not loads.any():
        raise ValueError(
            f"{robot.name} cannot carry a load from {start} to {end} as seen from its"
            " base; mount it nearer or choose an arm with a longer reach"
        )
    motion = np.abs(np.diff(angles, axis=1)).max(axis=(1, 2))
    best = np.where(loads >= 0.95 * loads.max(), motion, np.inf).argmin()
    return Way(float(loads[best]), angles[best], math.axis_z(quats[best, 0]))


def _stays_above(robot: Robot, angles: np.ndarray, path: Array) -> np.ndarray:
    """Return on which ways no elbow is lower than both the load and the arm's table."""
    scene = Scene()
    scene.add_robot("arm", robot, Placement((0.0, 0.0, 0.0)), stand=False)
    model = scene.compile()
    arm, data = scene.arms["arm"], mujoco.MjData(model)
    # The first joint that carries another one stays where it is.
    elbows = model.dof_jntid[arm.dof][2:]
    stays = np.ones(len(angles), bool)
    for i, way in enumerate(angles):
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


def turn_fingers(
    model: mujoco.MjModel, arm: Arm, angles: np.ndarray, bar: np.ndarray
) -> np.ndarray:
    """Return postures whose fingers close across a bar.

    Only the last joint is turned, and only where it turns the gripper about its
    approach and its range allows it.

    Args:
      model: the compiled world.
      arm: whose fingers.
      angles: (n, joints) postures, in rad.
      bar: (3,) direction of the bar in the world frame.
    """
    data = mujoco.MjData(model)
    joint = model.dof_jntid[arm.dof.stop - 1]
    low, high = arm.joint_range[:, -1]
    last = (low + high) / 2
    turned = angles.copy()
    for posture in turned:
        data.qpos[arm.qpos] = posture
        mujoco.mj_kinematics(model, data)
        _, closing, approach = data.site_xmat[arm.tcp].reshape(3, 3).T
        same = data.xaxis[joint] @ approach
        wanted = np.cross(approach, bar)
        turn = np.arctan2(np.cross(closing, wanted) @ approach, closing @ wanted)
        options = posture[-1] + same * turn + np.pi * np.arange(-3, 4)
        options = options[(options > low) & (options < high)]
        if abs(same) > 0.999 and len(options):
            last = options[np.abs(options - last).argmin()]
            posture[-1] = last
    return turned


def carry(
    sim: Sim,
    arm: Arm,
    tcp: Array,
    goal: Array,
    posture: Array,
    mass: Array,
) -> np.ndarray:
    """Return joint changes that bring a tcp and its load to a goal, near a posture.

    Torques other than those of the load are let go, as arms that hold one thing would
    else press against each other. Without a load the posture counts less and less the
    nearer the goal is.

    Args:
      sim: the worlds.
      arm: whose tcp.
      tcp: (num_envs, 3) where it is.
      goal: (num_envs, 3) where it should be after the step, in m.
      posture: (num_envs, joints) angles to keep to, in rad.
      mass: (num_envs,) of the load at the tcp in kg, 0 for none.

    Returns:
      (num_envs, joints) in rad, not limited.
    """
    translation, _ = sim.jacobian(arm.hand, tcp)
    angle, robot = np.asarray(sim.qpos[:, arm.qpos]), arm.robot
    low, high = arm.joint_range
    is_loaded = mass[:, None] > 0
    nearness = np.minimum(1.0, math.distance(goal, tcp) / 0.05)[:, None]
    lean = np.where(is_loaded, 0.4, 0.4 * nearness) * (posture - angle)
    lean = np.clip(lean, -0.5 * arm.max_change, 0.5 * arm.max_change)
    room = low - angle, high - angle
    change = joint_change(translation[:, :, arm.dof], goal - tcp, lean, room)
    stiffness, damping = np.array(robot.stiffness), np.array(robot.damping)
    torque = stiffness * (sim.act[:, arm.act] - angle) - damping * sim.qvel[:, arm.dof]
    excess = torque - translation[:, 2, arm.dof] * (GRAVITY * mass[:, None])
    return change - np.where(is_loaded, _YIELD * excess / stiffness, 0.0)


def _strengthen(
    sim: CpuSim, arm: Arm, position: Array, moves: int, approach: Array | None
) -> np.ndarray:
    """Bring an arm's tcp to positions, in strong postures; return what it holds."""
    low, high = _range(arm)
    for i in range(moves):
        missing, translation, rotation = _missing(sim, arm, position)
        # The last moves only restore the position.
        stride = 0.3 * max(0.0, 1 - i / (moves - 6))
        lean = stride * relief(arm, translation, rotation)
        angle = np.asarray(sim.qpos[:, arm.qpos])
        rows, error = translation[:, :, arm.dof], np.clip(missing, -0.3, 0.3)
        if approach is not None:
            quat = sim.pose("arm/tcp")[1]
            aimed, turn = aim(rotation[:, :, arm.dof], quat, approach)
            rows = np.concatenate([rows, aimed], axis=1)
            error = np.concatenate([error, np.clip(turn, -0.6, 0.6)], axis=1)
        room = low - angle, high - angle
        sim.qpos[:, arm.qpos] = angle + joint_change(rows, error, lean, room)
    missing, translation, _ = _missing(sim, arm, position)
    shares = np.abs(torque_shares(arm, translation)).max(axis=1)
    return np.where(math.norm(missing) < _TOLERANCE, 1 / shares, 0.0)


def _range(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint angles in which postures are searched."""
    low, high = arm.joint_range
    room = np.minimum(_LIMIT_ROOM, (high - low) / 4)
    return low + room, high - room


def _missing(
    sim: CpuSim, arm: Arm, position: Array
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far the tcp is from a position, and both its Jacobians."""
    sim.forward()
    here, _ = sim.pose("arm/tcp")
    translation, rotation = sim.jacobian(arm.hand, here)
    return position - here, translation, rotation
