"""Joint angles that put tcps at poses: one pose, several arms at once, or a way."""

from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.motion.once import found_once
from collaborative_gym.motion.solver import (
    DAMPING,
    Chains,
    descend,
    greatest,
    joint_change,
    simulated,
)
from collaborative_gym.motion.steering import shortened
from collaborative_gym.scene import Arm
from collaborative_gym.sim.cpu import CpuSim

_Poses = Sequence[tuple[Array, Array]]
_Ways = Sequence[Sequence[tuple[ArrayLike, ArrayLike]]]

_DRAWS = 24, 96  # from how many postures `central_pose` chooses, at first and then
_LONG = 2.0  # s from a posture to another pose, with which it draws once more
_WAY_TRIES = 10  # starts that `quickest_way` tries for each pose
_WAYS_DRAWN = 256  # postures with which `safest_way` begins
_ROOM = 0.1  # rad that it leaves to the joints' limits
_ON_THE_WAY = 6  # postures between two poses at which it asks for touches
_ANY_POSE = 6  # an arm of fewer joints cannot take every pose within its reach
_FAR_TRIES = 60  # postures of whole ranges, from which an error's remedy is tried
_EXACT = 1e-4  # by how much in m and rad the poses of `hold` may be missed


@found_once
def solve_pose(
    model: mujoco.MjModel,
    arm: Arm,
    *,
    goal: tuple[ArrayLike, ArrayLike],
    start: ArrayLike,
    tries: int = 20,
) -> np.ndarray:
    """Return joint angles that put an arm's tcp at a pose.

    Args:
      model: the compiled world.
      arm: whose tcp.
      goal: world position (3,) in m, and quaternion (4,) or approach direction (3,).
      start: joint angles to begin with; the solution stays near them if it can.
      tries: how many starts to try; those after the first are drawn around `start`.

    Raises:
      ValueError: if no try comes within 1 mm and 0.01 rad.
    """
    found, missed = _search(model, arm, goal=goal, starts=_around(arm, start, tries))
    if found is None:
        raise _unreached(model, arm, goal=goal, missed=missed)
    return found


def _around(arm: Arm, start: ArrayLike, tries: int) -> np.ndarray:
    """Return joint angles at which to begin, (tries, joints); the first are `start`."""
    rng = np.random.default_rng(0)
    spreads = [0.0] + [0.2 + i / tries for i in range(1, tries)]
    drawn = [rng.uniform(-s, s, arm.num_joints) for s in spreads]
    return np.asarray(start) + np.array(drawn)


def _search(
    model: mujoco.MjModel, arm: Arm, *, goal: tuple[ArrayLike, ArrayLike], starts: Array
) -> tuple[np.ndarray | None, np.ndarray]:
    """Return joint angles for a pose, None if there are none, and the error (6,)."""
    position, orientation = (np.asarray(part, float) for part in goal)
    sim = CpuSim(model, len(starts), num_threads=1)
    nearest, least = np.inf, np.zeros(6)
    # The first try is mostly enough; the others run side by side.
    for some in np.split(starts, [1])[: len(starts)]:
        middle = np.clip(some, *arm.joint_range)
        angles, missed = descend(
            simulated(sim, arm),
            middle,
            goal=(position, orientation),
            steps=100,
            is_there=lambda error: _in_tolerances(error) < 0.1,
            bound=_within_sight,
            nullspace=lambda step, angle, rows, _, middle=middle: (
                0.02 * (middle[rows] - angle)
            ),
        )
        misses = _in_tolerances(missed)
        best = int(np.argmax(misses < 1.0)) if (misses < 1.0).any() else misses.argmin()
        if misses[best] < nearest:
            nearest, least = misses[best], missed[best]
        if nearest < 1.0:
            return np.clip(angles[best], *arm.joint_range), least
    return None, least


def _unreached(
    model: mujoco.MjModel, arm: Arm, *, goal: tuple[ArrayLike, ArrayLike], missed: Array
) -> ValueError:
    """Return the error of a pose that was not found; its remedy was tried."""
    low, high = arm.joint_range
    drawn = np.random.default_rng(0).uniform(low, high, (_FAR_TRIES, len(low)))
    position, orientation = ((np.asarray(own).round(3) + 0.0).tolist() for own in goal)
    remedy = "mount it nearer or choose an arm with a longer reach"
    found, _ = _search(model, arm, goal=goal, starts=drawn)
    if found is not None:
        remedy = (
            "postures far from where the search began do it, such as"
            f" {found.round(2).tolist()}: choose a home, or a start, nearer to those"
        )
    elif (count := arm.num_joints) < _ANY_POSE:
        remedy += f", or one of {_ANY_POSE} joints: {count} do not take every pose"
    away, turn = math.norm(missed[:3]), math.norm(missed[3:])
    return ValueError(
        f"{arm.robot.name} cannot bring its tcp to {position} with orientation"
        f" {orientation} (the best try was {1000 * away:.3g} mm and {turn:.3g} rad"
        f" away; 1 mm and 0.01 rad are allowed); {remedy}"
    )


def _in_tolerances(error: Array) -> np.ndarray:
    """Return errors as multiples of 1 mm and 0.01 rad, the greater of the two."""
    return np.maximum(math.norm(error[:, :3]) / 1e-3, math.norm(error[:, 3:]) / 1e-2)


def _within_sight(error: Array) -> np.ndarray:
    """Return errors cut to what is nearly linear in the joint angles."""
    parts = shortened(error[:, :3], 0.2), shortened(error[:, 3:], 0.6)
    return np.concatenate(parts, axis=1)


def hold(
    chains: Chains, goals: _Poses, *, near: Sequence[Array], patience: int | None = None
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return joint angles near others that put several tcps exactly at poses.

    It is Newton's method with the smallest joint changes, so the free motion of each
    arm stays as it is. It is quick where `near` is less than about a radian off.

    Args:
      chains: the arms' kinematics.
      goals: for each arm, positions (n, 3) in m and quaternions (n, 4), or directions
        (n, 3) of its approach in the goals of all arms, or one for all n.
      near: for each arm, angles (n, joints) to begin with, in rad.
      patience: steps in which a row's worst coordinate must fall by a tenth, or the row
        stops; None for no such rule.

    Returns:
      The angles for each arm, and whether all its arms are there, (n,).
    """
    count, most = len(near[0]), chains.low.shape[1]
    arm = np.repeat(np.arange(len(near)), count)
    start = np.zeros((len(near), count, most))
    positions, turns = (np.zeros((*start.shape[:2], np.shape(p)[-1])) for p in goals[0])
    for i, (goal, angles) in enumerate(zip(goals, near, strict=True)):
        start[i, :, : angles.shape[1]] = angles
        positions[i], turns[i] = goal
    postures = chains.of(arm)
    angles, missed = descend(
        postures,
        np.clip(start.reshape(-1, most), postures.low, postures.high),
        goal=(positions.reshape(-1, 3), turns.reshape(start[..., 0].size, -1)),
        steps=20,
        is_there=lambda error: greatest(error) < 1e-6,
        change=partial(joint_change, damping=0.01, longest=0.5, rounds=1),
        patience=patience,
    )
    each = zip(angles.reshape(start.shape), near, strict=True)
    found = [own[:, : asked.shape[1]] for own, asked in each]
    return found, greatest(missed).reshape(-1, count).max(axis=0) < _EXACT


def hold_moved(
    chains: Chains,
    grasps: Callable[[np.ndarray], _Poses],
    *,
    moved: np.ndarray,
    near: Sequence[Array],
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return joint angles that hold a moved thing, and how far it is moved then.

    Args:
      chains: the arms' kinematics.
      grasps: returns each arm's goal, as `hold` takes them, of a thing so moved.
      moved: (n, k) how far from its nominal place; halved until all arms reach it.
      near: as in `hold`.
    """
    held, there = [np.array(angles) for angles in near], np.array(moved)
    left = np.arange(len(moved))
    for shares in (1.0,), (0.5, 0.25, 0.0):  # One call costs less than three.
        tries = np.concatenate([share * moved[left] for share in shares])
        starts = [np.tile(angles[left], (len(shares), 1)) for angles in near]
        # Where an arm's range ends, Newton's method crawls.
        found, reached = hold(chains, grasps(tries), near=starts, patience=4)
        met = reached.reshape(len(shares), -1)
        first = np.where(met.any(axis=0), met.argmax(axis=0), len(shares) - 1)
        rows = first * len(left) + np.arange(len(left))
        there[left] = tries[rows]
        for angles, own in zip(held, found, strict=True):
            angles[left] = own[rows]
        left = left[~met.any(axis=0)]
        if not len(left):
            break
    return held, there


@found_once
def central_pose(
    model: mujoco.MjModel, arm: Arm, *, poses: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return joint angles for the first pose from which the others are soonest reached.

    Many postures are drawn around the arm's home, and more where none will do. Among
    those that touch nothing, it is the one from which the slowest joint needs the least
    time to the farthest of the other poses. Each pose out of reach counts as one second
    more. A nearly singular posture is taken only if there is no other.

    Args:
      model: the compiled world.
      arm: whose tcp.
      poses: positions (3,) in m and quaternions (4,) in the world frame, or directions
        (3,) of the approach.

    Raises:
      ValueError: if the first pose is out of reach.
    """
    chains = Chains(model, [arm])
    for draws in _DRAWS:
        rng, times, longest = np.random.default_rng(0), np.zeros(draws), np.zeros(draws)
        spreads = [0.0] + [0.3 + 1.5 * i / draws for i in range(1, draws)]
        drawn = np.array([rng.uniform(-s, s, arm.num_joints) for s in spreads])
        start = np.array(arm.robot.home) + drawn
        [angles], fits = hold(chains, poses[:1], near=[start])
        for pose in poses[1:]:
            [there], reached = hold(chains, [pose], near=[angles])
            slowest = (np.abs(there - angles) / arm.robot.velocity_limits).max(axis=1)
            times = np.maximum(times, slowest) + ~reached
            longest = np.maximum(longest, slowest)
        rows = np.zeros(draws, int)
        jacobian = chains.of(rows).at(angles, rows)[2]
        # There, the damping of steering would be most of what moves the tcp.
        times += 1e3 * (np.linalg.svd(jacobian)[1].min(axis=1) < DAMPING)
        times[~fits | _touches(model, arm, angles)] = np.inf
        best = times.argmin()
        if longest[best] < _LONG:
            break
    if np.isinf(times[best]):
        return solve_pose(model, arm, goal=poses[0], start=arm.robot.home)
    return angles[best]


@found_once
def quickest_way(
    model: mujoco.MjModel, arm: Arm, *, ways: _Ways
) -> tuple[int, np.ndarray]:
    """Return the way on which an arm moves fastest from the first pose to the last.

    Ways that lead a joint closer than 0.2 rad to a limit are the last resort.

    It returns the way's index, and the joint angles at its poses, (poses, joints).

    Args:
      model: the compiled world.
      arm: whose tcp.
      ways: each a sequence of goals as for `solve_pose`.

    Raises:
      ValueError: if the arm can go none of the ways.
    """
    low, high = arm.joint_range
    best, least, failure = None, np.inf, None
    # Ways may begin alike; each beginning is solved once.
    solved: dict[bytes, tuple[np.ndarray | None, np.ndarray]] = {}
    for i, way in enumerate(ways):
        angles, key = [np.array(arm.robot.home)], b""
        for pose in way:
            key += np.concatenate(pose).tobytes()
            if key not in solved:
                starts = _around(arm, angles[-1], _WAY_TRIES)
                solved[key] = _search(model, arm, goal=pose, starts=starts)
            found, missed = solved[key]
            if found is None:
                failure = pose, missed
                break
            angles.append(found)
        else:
            found = np.array(angles[1:])
            room = np.minimum(found - low, high - found).min()
            steps = (np.abs(np.diff(found, axis=0)) / arm.stride).max(axis=1).sum()
            cost = steps + (1e3 * (0.2 - room) if room < 0.2 else 0.0)
            if cost < least:
                best, least = (i, found), cost
    if best is None:
        if failure is None:
            raise ValueError("no way was given")
        raise _unreached(model, arm, goal=failure[0], missed=failure[1])
    return best


@found_once
def safest_way(
    model: mujoco.MjModel, arm: Arm, *, ways: _Ways
) -> tuple[int, np.ndarray]:
    """Return a way on which an arm touches nothing, from the first pose to the last.

    It is the quickest from home that stays 0.1 rad away from the joints' limits, of
    those that begin with one of many drawn postures. The arm touches neither itself nor
    what is mounted. Arguments and results are those of `quickest_way`.

    Raises:
      ValueError: if no such way is found.
    """
    chains, rng = Chains(model, [arm]), np.random.default_rng(0)
    low, high = arm.joint_range
    bounds = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    drawn = rng.uniform(*bounds, (_WAYS_DRAWN, arm.num_joints))
    found: list[tuple[float, int, np.ndarray]] = []
    # Ways may begin alike; each beginning is solved once. Rows are (n, poses, joints).
    solved: dict[bytes, np.ndarray] = {}
    for i, way in enumerate(ways):
        rows, key = drawn[:, None], b""
        for pose in way:
            key += np.concatenate(pose).tobytes()
            if key not in solved and len(rows):
                place, turn = (np.tile(part, (len(rows), 1)) for part in pose)
                [there], fits = hold(chains, [(place, turn)], near=[rows[:, -1]])
                fits &= (np.minimum(there - low, high - there) > _ROOM).all(axis=1)
                solved[key] = np.concatenate([rows, there[:, None]], axis=1)[fits]
            rows = solved.get(key, rows)
        rows[:, 0] = arm.robot.home
        steps = (np.abs(np.diff(rows, axis=1)) / arm.stride).max(axis=2).sum(axis=1)
        rows = rows[:, 1:]
        found += [(step, i, row) for step, row in zip(steps, rows, strict=True)]
    shares = np.linspace(0.0, 1.0, _ON_THE_WAY)[:, None, None]
    for _, i, poses in sorted(found, key=lambda each: each[0]):
        between = poses[:-1] + shares * np.diff(poses, axis=0)
        if not _touches(model, arm, between.reshape(-1, arm.num_joints)).any():
            return i, poses
    first, last = (
        np.round(np.asarray(ways[0][end][0], float), 3).tolist() for end in (0, -1)
    )
    raise ValueError(
        f"{arm.robot.name} finds no way from {first} to {last} that is free and within"
        " its joints' limits; mount it nearer or choose another arm"
    )


def turn_fingers(
    model: mujoco.MjModel, arm: Arm, *, angles: np.ndarray, bar: np.ndarray
) -> np.ndarray:
    """Return postures whose fingers close across a bar.

    Only the last joint is turned, and only where it turns the gripper about its
    approach and its range allows it.

    Args:
      model: the compiled world.
      arm: whose fingers.
      angles: (n, joints) postures, in rad.
      bar: (3,) its direction in the world frame.
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


def _touches(model: mujoco.MjModel, arm: Arm, angles: np.ndarray) -> np.ndarray:
    """Return at which angles (n, joints) an arm touches itself or what is mounted."""
    data, touches = mujoco.MjData(model), np.zeros(len(angles), bool)
    for i, angle in enumerate(angles):
        data.qpos[arm.qpos] = angle
        mujoco.mj_forward(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        is_own = model.body_rootid[bodies] == model.body_rootid[arm.hand]
        is_fixed = model.body_weldid[bodies] == 0
        touches[i] = np.any(is_own.any(axis=1) & (is_own | is_fixed).all(axis=1))
    return touches
