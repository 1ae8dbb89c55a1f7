"""Poke: one arm holds a stick, the other a square ring, and the stick goes in the hole.

robot_1 holds the stick (0.2 m long). robot_2 holds the ring, called donut (outer side
0.24 m, hole 0.16 m). Both objects are fixed in the grippers, so nothing is gripped or
released. The arms start turned aside, with each object out of the other arm's reach.
They must meet half-way: robot_2 presents the ring, and robot_1 aligns the stick.

Randomized: where each object starts (position along every axis, turn about the
vertical) and every joint angle.

Reward of each agent:

- `distance`: minus the distance from the stick's middle to the ring's centre, in m.
- `angle`: -0.8 |cos a|, where a is the angle between the stick and the ring's plane.
- `effort`: minus 0.01 times the Euclidean norm of the agent's own action; in other
  action modes, of what the action asks of the joints.
- `inside`: 1 while the stick is inside (the distance is below 0.065 m and |cos a| is
  below 0.2), else 0.

Success: for 0.5 s, the distance is below 0.09 m and the stick's axis crosses the ring's
plane within the hole. Arms that observe nothing may reach this state by chance, but
rarely keep it. The distance alone is not enough, because it is as small when the stick
lies flat on the ring. The term `inside` does not test the crossing, because its bounds
imply it: the axis then crosses the plane within 0.067 m of both the ring's centre and
the stick's middle. The hole's sides are 0.08 m away, the stick's ends 0.1 m.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import solve_pose
from collaborative_gym.objects.donut import BAR, HOLE, THICKNESS, donut
from collaborative_gym.objects.stick import LENGTH, SIDE, stick
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Arm, Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import poke as player
from collaborative_gym.tasks.experts.poke import DONUT, DONUT_AHEAD, STICK, STICK_AHEAD
from collaborative_gym.tasks.holding import start_holding
from collaborative_gym.tasks.randomization import Randomization, presets
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.task import Blocks, Task, TaskConfig, Terms

_SUCCESS_DISTANCE = 0.09  # m
_INSIDE_DISTANCE, _INSIDE_COSINE = 0.065, 0.2  # m, and of the angle to the plane

_STARTS = Randomization(
    joint_noise=0.15, object_position=0.15, object_yaw=float(np.radians(45))
)
"""So far apart that no motion fits many of them: see benchmarks/blind.py."""

_YAW = float(np.radians(60))  # of the bases, away from x and towards each other
_TILT = float(np.radians(45))  # of the hands, downwards
_AROUND = float(np.radians(120))  # of the ring, where no hand is in a stick's way
_ASKEW = 0.2  # rad about each axis, how far a stick leans that has missed the hole

# How the ring sits in its gripper, which is as wide open as the stick's.
_DONUT_QUAT = (np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0)  # normal along the tcp's y

Pose = tuple[np.ndarray, np.ndarray]
"""Position, and quaternion or direction of the z axis."""


@dataclass(frozen=True)
class PokeFacts:
    """Facts of Poke; a pose is a position and a quaternion."""

    joints: dict[str, Array]  # angles by agent, (num_envs, joints), in rad
    stick: tuple[Array, Array]  # pose of its middle
    donut: tuple[Array, Array]  # pose of the ring's centre, its z along the normal
    offset: Array  # (num_envs, 3) from ring to stick in the ring's frame, in m
    axis: Array  # (num_envs, 3) direction of the stick in the ring's frame
    distance: Array  # (num_envs,) length of `offset`, in m
    cosine: Array  # (num_envs,) |cos| of the angle between stick and ring's plane
    is_threaded: Array  # (num_envs,) whether the stick's axis passes through the hole


class Poke(Task[TaskConfig, PokeFacts]):
    """Put the stick of one arm through the ring of the other.

    Attributes:
      goal: by agent, where the tcp is when stick and ring meet: its position, and its
        direction or quaternion.
      postures: by agent, joint angles there; of the stick's arm, those in which it
        waits before the hole, in rad.
    """

    success_for = 5
    randomizations = presets(_STARTS)
    units: ClassVar[Mapping[str, str]] = {"distance": "m"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "stick": POSE,
        "donut": POSE,
    }
    styles = player.STYLES
    expert, styled = player.expert, player.styled

    def mounts(self) -> tuple[Placement, ...]:
        """Return bases 0.8 of both reaches apart, turned 60 degrees to each other."""
        robots = self.robots.values()
        half = 0.4 * sum(robot.reach for robot in robots)
        heights = [robot.base_height for robot in robots]
        return _opposite((-half, heights[0]), (half, heights[1]))

    def build(self, scene: Scene) -> None:
        for agent, place in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=place, holds=THICKNESS)
        stick_spec, donut_spec = stick(), donut()
        stick_spec.body("stick").pos = (0, 0, STICK_AHEAD)
        donut_spec.body("donut").pos = (0, 0, DONUT_AHEAD)
        donut_spec.body("donut").quat = _DONUT_QUAT
        scene.add_tool(STICK, "stick", child=stick_spec)
        scene.add_tool(DONUT, "donut", child=donut_spec)
        scene.add_pose_sensor("stick", f"{STICK}/stick/stick")
        scene.add_pose_sensor("donut", f"{DONUT}/donut/donut")
        teams.add_team_camera(scene, self.placements, below=0.6)

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        start, self.goal = _lay_out(self.placements, self.robots)
        self._start, self._spread, self.postures = {}, {}, {}
        for agent, arm in scene.arms.items():
            angles = solve_pose(sim.model, arm, goal=start[agent], start=arm.robot.home)
            self._start[agent] = angles
            self._spread[agent] = _spread(sim.model, arm, angles)
            goal = self.goal[agent]
            self.postures[agent] = solve_pose(sim.model, arm, goal=goal, start=angles)
        # The stick waits before the hole, in a posture from which it can go in.
        place, into = self.goal[STICK]
        self.postures[STICK] = solve_pose(
            sim.model,
            scene.arms[STICK],
            goal=(place - player.WAIT * into, into),
            start=self.postures[STICK],
        )
        # The stick's orientation in the ring's frame there.
        ring = math.multiply(self.goal[DONUT][1], np.array(_DONUT_QUAT))
        hand = _tcp_turn(sim.model, scene.arms[STICK], self.postures[STICK])
        self._lined_up = math.multiply(math.conjugate(ring), hand)

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        bounds = self.config.randomization
        for agent, arm in self.scene.arms.items():
            # To first order, which will do for a start drawn at random.
            moved = rng.within(bounds.moves, 4)
            angles = self._start[agent] + math.dot(moved[:, None], self._spread[agent])
            angles = angles + rng.within(bounds.joint_noise, arm.num_joints)
            self.scene.bend(sim, env_ids, agent=agent, angles=angles)

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """The arms have met, and the stick's tip is on the ring, beside the hole."""
        moves = rng.within(self.config.randomization.moves, 4)
        missed = rng.within([_ASKEW, _ASKEW, _AROUND, BAR / 2], 4)
        moved, postures = np.concatenate([moves, missed], axis=1), self.postures
        start_holding(
            self, sim, env_ids, self._resting, rng=rng, moved=moved, postures=postures
        )

    def _resting(self, moved: np.ndarray) -> list[Pose]:
        """Return the poses of both tcps where the stick's tip is on the ring.

        Of each row, `moved` has the ring's moves along x, y, z and its turn; how far
        the stick leans about the ring's x and y; on which side its tip is, in rad from
        the bar that is farthest from the ring's hand; and how far it is from the
        middle of its bar, outwards.
        """
        place, quat = self.goal[DONUT]
        place = place + moved[:, :3]
        quat = math.multiply(math.from_yaw(moved[:, 3]), quat)
        ring = math.multiply(quat, np.array(_DONUT_QUAT))
        middle, zero = place + DONUT_AHEAD * math.axis_z(quat), 0.0 * moved[:, 0]
        lean = np.stack([moved[:, 4], moved[:, 5], zero], axis=1)
        turned = math.multiply(math.from_rotation_vector(lean), self._lined_up)
        axis = math.axis_z(turned)
        # Around the hole on a square. The ring's hand is in the direction of its y.
        tip = np.stack([np.sin(moved[:, 6]), -np.cos(moved[:, 6]), zero], axis=1)
        tip *= ((HOLE + BAR) / 2 + moved[:, 7:]) / np.abs(tip).max(axis=1)[:, None]
        # However the stick is turned, no corner of its tip is deeper in the ring.
        tip[:, 2] -= THICKNESS / 2 + SIDE / 2**0.5 * math.norm(axis[:, :2])
        tcp = tip - (LENGTH / 2 + STICK_AHEAD) * axis
        stick = middle + math.rotate(ring, tcp), math.multiply(ring, turned)
        return [stick, (place, quat)]

    def measure(self, sim: Sim) -> PokeFacts:
        stick_pose, donut_pose = sim.pose("stick"), sim.pose("donut")
        into_ring = math.conjugate(donut_pose[1])
        offset = math.rotate(into_ring, stick_pose[0] - donut_pose[0])
        axis = math.rotate(into_ring, math.axis_z(stick_pose[1]))
        return PokeFacts(
            joints=self.joints(sim),
            stick=stick_pose,
            donut=donut_pose,
            offset=offset,
            axis=axis,
            distance=math.norm(offset),
            cosine=math.norm(axis[:, :2]),
            is_threaded=is_threaded(offset, axis),
        )

    def observe(self, facts: PokeFacts) -> dict[str, Blocks]:
        stick, donut = math.pose(*facts.stick), math.pose(*facts.donut)
        joints = facts.joints.items()
        return {a: {"joints": own, "stick": stick, "donut": donut} for a, own in joints}

    def reward(self, facts: PokeFacts, commands: Commands) -> dict[str, Terms]:
        xp = array_namespace(facts.distance)
        is_lined_up = facts.cosine < _INSIDE_COSINE
        is_inside = is_lined_up & (facts.distance < _INSIDE_DISTANCE)
        return {
            agent: {
                "distance": -facts.distance,
                "angle": -0.8 * facts.cosine,
                "effort": -0.01 * math.norm(commands[agent].moves),
                "inside": xp.where(is_inside, 1.0, 0.0),
            }
            for agent in self.agents
        }

    def success(self, facts: PokeFacts) -> Array:
        return facts.is_threaded & (facts.distance < _SUCCESS_DISTANCE)

    def shortfall(self, facts: PokeFacts) -> Array:
        xp = array_namespace(facts.distance)
        return xp.where(self.success(facts), 0.0, facts.distance)


def is_threaded(offset: Array, axis: Array) -> Array:
    """Return whether a stick placed so in the ring's frame passes through its hole."""
    xp = array_namespace(offset)
    slope = xp.where(xp.abs(axis[:, 2]) < 1e-6, 1e-6, axis[:, 2])
    # How far ahead of its middle the stick's axis meets the ring's plane.
    ahead = -offset[:, 2] / slope
    crossing = xp.abs(offset + ahead[:, None] * axis)
    is_in_hole = (crossing[:, 0] < HOLE / 2) & (crossing[:, 1] < HOLE / 2)
    return is_in_hole & (xp.abs(ahead) < LENGTH / 2)


def _opposite(
    first: tuple[float, float], second: tuple[float, float]
) -> tuple[Placement, Placement]:
    return Placement((0.0, *first), _YAW), Placement((0.0, *second), -_YAW)


def _lay_out(
    placements: dict[str, Placement], robots: dict[str, Robot]
) -> tuple[dict[str, Pose], dict[str, Pose]]:
    """Return where the tcps start, and where they meet.

    Both start aside of the line between the bases. They meet near where it is divided
    as their reaches, and at right angles.
    """
    first, second = (np.array(placements[agent].position) for agent in robots)
    reaches = [robot.reach for robot in robots.values()]
    line = (second - first) * (1.0, 1.0, 0.0)
    span = np.linalg.norm(line)
    along = line / span
    aside = np.cross(along, (0.0, 0.0, 1.0))
    up = np.array([0.0, 0.0, 1.0])
    middle = (first + second) / 2
    outwards = _tilted(aside)
    bases = zip((first, second), reaches, strict=True)
    starts = [base + 0.65 * reach * aside + 0.4 * up for base, reach in bases]
    share = reaches[0] / sum(reaches) - 0.5
    meeting = middle + share * line + 0.15 * span * aside + 0.2 * up
    into = _tilted((along + aside) / np.sqrt(2))
    level = (aside - along) / np.sqrt(2)
    across = np.cos(_TILT) * level + np.sin(_TILT) * np.cross(into, level)
    start = {STICK: (starts[0], outwards)}
    start[DONUT] = starts[1], _tcp_quat(along, outwards)
    goal = {STICK: (meeting - STICK_AHEAD * into, into)}
    goal[DONUT] = meeting - DONUT_AHEAD * across, _tcp_quat(into, across)
    return start, goal


def _tilted(direction: np.ndarray) -> np.ndarray:
    """Return a horizontal direction turned down by the tilt of the hands."""
    return np.cos(_TILT) * direction - np.array([0.0, 0.0, np.sin(_TILT)])


def _tcp_quat(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the quaternion of a tcp whose y and z axes point like this."""
    quat = np.zeros(4)
    axes = np.stack([np.cross(y, z), y, z], axis=1)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    return quat


def _tcp_turn(model: mujoco.MjModel, arm: Arm, angles: np.ndarray) -> np.ndarray:
    data, quat = mujoco.MjData(model), np.zeros(4)
    data.qpos[arm.qpos] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mju_mat2Quat(quat, data.site_xmat[arm.tcp])
    return quat


def _spread(model: mujoco.MjModel, arm: Arm, angles: np.ndarray) -> np.ndarray:
    """Return joint changes per m of a tcp along x, y, z and per rad about z."""
    data = mujoco.MjData(model)
    data.qpos[arm.qpos] = angles
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], arm.tcp)
    return np.linalg.pinv(jacobian[:, arm.dof])[:, [0, 1, 2, 5]]


_SAWYERS = {"placements": _opposite((-1.0, 1.0), (1.0, 1.0))}
_MIXED = {"placements": _opposite((-1.0, 0.65), (0.8, 1.0))}
register_task("Poke", Poke)
register_env(EnvSpec("PokeTaskSawyers-v0", Poke, ("sawyer", "sawyer"), _SAWYERS))
register_env(EnvSpec("PokeTaskPandaSawyer-v0", Poke, ("panda", "sawyer"), _MIXED))
