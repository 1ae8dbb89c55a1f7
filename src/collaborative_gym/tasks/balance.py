"""Balance: two arms hold a board by its ends and keep a ball on its middle.

The board (0.8 x 1.5 m, 1 kg) is fixed in robot_1's hand and welded to robot_2's tcp, so
both arms move with every tilt. One arm can tilt it alone, against the servos of the
other. So the task measures how well two arms cooperate, not whether they must. The ball
rolls without slipping. On slopes below 0.075 it rests. In the two-Sawyer environment a
vertical force acts on a random point of the board; it is a new one at every step,
up to 10 N up or down.

Randomised: where on the board the ball starts; where the board starts (position along
every axis, turn about the vertical, always level) and the posture in which each arm
holds it. The start angles come from the nominal ones plus noise, by inverse kinematics.

Reward of each agent:

- `distance`: minus the distance between the centres of ball and board, in m.
- `fell`: -1 once the ball has left the board, else 0. A ball that has left it never
  counts as back.

Success: that distance is below 0.09 m while the ball is on the board. The centres are
0.06 m apart when the ball lies in the middle, so the ball must be within 0.067 m of the
middle along the board.

The thesis starts the board 0.7 or 0.6 m above the floor. At 0.7 m, a Sawyer that is
mounted as in the thesis has its handle at the end of its reach, where it cannot make
two in five of the moves and tilts that the task needs. At 0.6 m the handle is out of
reach. So the board starts at 0.95 m.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Command, Motion
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.objects.ball import RADIUS, ball
from collaborative_gym.objects.board import (
    BAR,
    HANDLE,
    HANDLES,
    LENGTH,
    THICKNESS,
    WIDTH,
    board,
)
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import Blocks, Task, TaskConfig, Terms, columns

_BALL_START = np.array([0.2, 0.45])  # m, bounds along the board
REST_HEIGHT = THICKNESS / 2 + RADIUS
_ROLLING_SLOPE = 0.075  # slope on which the ball just rolls on: 0.003 m / radius

# The expert's way with the ball.
_APPROACH = 1.0  # 1/s, wanted speed over distance
_FASTEST = 0.35  # m/s
_CALM = 0.05  # m/s; when less is wanted, the ball is left to stop by itself
_GAIN = 0.35  # s/m, slope over missing speed
_PULL = 7 / 5 / 9.81  # s2/m, slope over acceleration of a full ball that rolls
_STEEPEST = 0.16
_LONGEST_MOVE = 0.03  # m, missing at a time
_LARGEST_TURN = 0.08  # rad, missing at a time; with more, the ball lifts off


@dataclass(frozen=True)
class BalanceConfig(TaskConfig):
    """Settings of Balance.

    Attributes:
      success_distance: between the centres of ball and board, in m.
      board_height: of the board's centre above the floor at the nominal start, in m.
      push: greatest vertical force on the board, a new one at every step, in N.
    """

    success_distance: float = bounded(0.09, 0.001, 10.0)
    board_height: float = bounded(0.95, 0.0, 10.0)
    push: float = bounded(0.0, 0.0, 1000.0)


@dataclass(frozen=True)
class BalanceFacts:
    """What Balance looks at.

    Attributes:
      joints: arm joint angles by agent, (num_envs, joints), in rad.
      ball: position and quaternion of the ball.
      ball_velocity: its linear and angular velocity.
      board: position and quaternion of the board's centre.
      offset: (num_envs, 3) from the board's to the ball's centre, in the board's frame.
      distance: (num_envs,) length of `offset`, in m.
      fell: (num_envs,) whether the ball has ever left the board.
    """

    joints: dict[str, Array]
    ball: tuple[Array, Array]
    ball_velocity: tuple[Array, Array]
    board: tuple[Array, Array]
    offset: Array
    distance: Array
    fell: Array


class Balance(Task[BalanceConfig, BalanceFacts]):
    """Keep a ball on the middle of a board that two arms hold."""

    config_class = BalanceConfig
    units: ClassVar[Mapping[str, str]] = {"distance": "m"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "ball": POSE,
        "ball linear velocity": "m/s",
        "ball angular velocity": "rad/s",
        "board": POSE,
        "target": "m",
        "target velocity": "m/s",
    }
    success_after = 5
    performance_from_start = True

    def mounts(self) -> tuple[Placement, ...]:
        """Return bases 0.7 of each reach behind the handles, facing each other."""
        return tuple(
            Placement(
                (0.0, side * (HANDLE + 0.7 * robot.reach), robot.base_height),
                -side * np.pi / 2,
            )
            for side, robot in zip((-1.0, 1.0), self.robots.values(), strict=True)
        )

    @property
    def marked_radius(self) -> float:
        """Radius of the disc on the board in which the ball is to lie, in m."""
        return float(np.sqrt(self.config.success_distance**2 - REST_HEIGHT**2))

    def build(self, scene: Scene) -> None:
        first, second = self.agents
        for agent, placement in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=placement, holds=BAR)
        # A free board with two welds would move in the same way, but take more time.
        tool = _held(board(marked_radius=self.marked_radius))
        scene.add_tool(first, "board", child=tool)
        tcp = scene.spec.site(f"{second}/{self.robots[second].tcp}")
        scene.add_weld(tcp.name, f"{first}/board/{HANDLES[1]}")
        for body in (tcp.parent, *tcp.parent.find_all(mujoco.mjtObj.mjOBJ_BODY)):
            plate = f"{first}/board/board"
            scene.spec.add_exclude(bodyname1=body.name, bodyname2=plate)
        above = (0.0, 0.0, self.config.board_height + REST_HEIGHT)
        scene.add("ball", ball(), position=above)
        # With MuJoCo's own settings rolling friction is a creep: a ball rolls down
        # slopes on which it should rest, along some directions more than others.
        scene.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        scene.spec.option.impratio = 100.0
        scene.add_pose_sensor("board", f"{first}/board/board")
        scene.add_pose_sensor("ball", "ball/ball")
        scene.add_velocity_sensor("ball", "ball/ball")
        scene.add_camera((2.9, 0, 1.85), (0, 1, 0, -0.34, 0, 1))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        model = sim.model
        self._chains = motion.Chains(model, list(scene.arms.values()))
        prefix = f"{self.agents[0]}/board"
        self._board = model.body(f"{prefix}/board").id
        self.centre = np.array([0.0, 0.0, self.config.board_height])
        self._handle = {}
        self._posture = {}
        for agent, name in zip(self.agents, HANDLES, strict=True):
            site = model.site(f"{prefix}/{name}")
            self._handle[agent] = site.pos.copy(), site.quat.copy()
            poses = [self._grasp(agent, *pose) for pose in self.poses()]
            self._posture[agent] = motion.central_pose(
                model, scene.arms[agent], poses=poses
            )
        scene.postures |= self._posture

    def poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the board's nominal pose and those that an arm should have at hand."""
        poses = [(self.centre, math.from_rotation_vector(np.zeros(3)))]
        for x, y, turn in product((-1.0, 1.0), repeat=3):
            moved = self.centre + 0.05 * np.array([x, y, x * y * turn])
            poses.append((moved, math.from_yaw(np.array(np.radians(15) * turn))))
        for x, y in product((-1.0, 1.0), repeat=2):
            tilt = _STEEPEST * np.array([x, y, 0.0])
            poses.append((self.centre, math.from_rotation_vector(tilt)))
        return poses

    def remember(self, num_envs: int) -> dict[str, Array]:
        memory: dict[str, Array] = {"fell": self.xp.zeros(num_envs, dtype=bool)}
        if self.config.push > 0:
            # Force and its point along the board's x and y, for every step.
            shape = num_envs, self.config.max_episode_steps, 3
            memory["pushes"] = self.xp.zeros(shape, dtype=self.xp.float64)
        return memory

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        bounds = self.config.randomization
        moves = np.array([bounds.object_position] * 3 + [bounds.object_yaw])
        moved = rng.within(moves, 4)
        noise = {
            agent: rng.within(bounds.joint_noise, len(posture))
            for agent, posture in self._posture.items()
        }
        rolled = rng.within(_BALL_START, 2)
        near = {agent: self._posture[agent] + noise[agent] for agent in noise}
        place, quat = self._take_hold(sim, env_ids, moved, near)
        resting = np.full((len(rolled), 1), REST_HEIGHT)
        on_board = math.rotate(quat, np.concatenate([rolled, resting], axis=1))
        place = place + on_board
        self.scene.place(sim, env_ids, name="ball", position=place, quat=quat)
        if self.config.push > 0:
            span = np.array([self.config.push, WIDTH / 2, LENGTH / 2])
            size = (self.config.max_episode_steps, 3)
            sim.memory["pushes"][env_ids] = sim.xp.asarray(rng.within(span, size))

    def _take_hold(
        self,
        sim: Sim,
        env_ids: np.ndarray,
        moved: np.ndarray,
        near: dict[str, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Let the arms hold a level board in these worlds, and return its poses.

        Args:
          sim: the worlds.
          env_ids: which of them.
          moved: (worlds, 4) how far the board is from its nominal place along x, y, z
            and about z; halved until all arms reach it.
          near: by agent, angles (worlds, joints) near which to hold it.
        """
        angles, moved = motion.hold_moved(
            self._chains,
            lambda moved: [
                self._grasp(agent, *self._board_at(moved)) for agent in near
            ],
            moved=moved,
            near=list(near.values()),
        )
        for agent, found in zip(near, angles, strict=True):
            arm = self.scene.arms[agent]
            sim.qpos[env_ids, arm.qpos] = sim.xp.asarray(found)
        return self._board_at(moved)

    def _board_at(self, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses of a level board, moved so far from its nominal place."""
        return self.centre + moved[:, :3], math.from_yaw(moved[:, 3])

    def _grasp(
        self, agent: str, place: np.ndarray, quat: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the tcp's pose at its handle of a board there."""
        handle_place, handle_quat = self._handle[agent]
        grasp_place = place + math.rotate(quat, handle_place)
        return grasp_place, math.multiply(quat, handle_quat)

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        if self.config.push > 0:
            push = sim.memory["pushes"][sim.xp.arange(sim.num_envs), steps]
            force = push[:, 0]
            along = [push[:, 1], push[:, 2], sim.xp.zeros_like(force)]
            point = sim.xp.stack(along, axis=1)
            lever = math.rotate(sim.pose("board")[1], point)
            sim.xfrc_applied[:, self._board, 2] = force
            sim.xfrc_applied[:, self._board, 3] = lever[:, 1] * force
            sim.xfrc_applied[:, self._board, 4] = -lever[:, 0] * force

    def measure(self, sim: Sim) -> BalanceFacts:
        ball_pose, board_pose = sim.pose("ball"), sim.pose("board")
        into_board = math.conjugate(board_pose[1])
        offset = math.rotate(into_board, ball_pose[0] - board_pose[0])
        xp = array_namespace(offset)
        off = (
            (xp.abs(offset[:, 0]) > WIDTH / 2)
            | (xp.abs(offset[:, 1]) > LENGTH / 2)
            | (offset[:, 2] < THICKNESS / 2)
        )
        fell = sim.memory["fell"] | off
        sim.memory["fell"] = fell
        return BalanceFacts(
            joints=self.joints(sim),
            ball=ball_pose,
            ball_velocity=sim.velocity("ball"),
            board=board_pose,
            offset=offset,
            distance=math.norm(offset),
            fell=xp.asarray(fell, copy=True),
        )

    def observe(self, facts: BalanceFacts) -> dict[str, Blocks]:
        blocks = {
            **columns("joints", facts.joints),
            "ball": math.pose(*facts.ball),
            "ball linear velocity": facts.ball_velocity[0],
            "ball angular velocity": facts.ball_velocity[1],
            "board": math.pose(*facts.board),
        }
        return dict.fromkeys(self.agents, blocks)

    def reward(
        self, facts: BalanceFacts, commands: dict[str, Command]
    ) -> dict[str, Terms]:
        xp = array_namespace(facts.distance)
        terms = {
            "distance": -facts.distance,
            "fell": xp.where(facts.fell, -1.0, 0.0),
        }
        return dict.fromkeys(self.agents, terms)

    def success(self, facts: BalanceFacts) -> Array:
        return (facts.distance < self.config.success_distance) & ~facts.fell

    def shortfall(self, facts: BalanceFacts) -> Array:
        xp = array_namespace(facts.distance)
        missing = facts.distance + xp.where(facts.fell, 1.0, 0.0)
        return xp.where(self.success(facts), 0.0, missing)

    def performing(self, facts: BalanceFacts) -> Array:
        return ~facts.fell

    def expert(self, sim: Sim, facts: BalanceFacts) -> dict[str, Motion]:
        """Bring the board to its place, tilted so that the ball rolls on its course.

        Both arms do their part of the board's motion, at the pace of the slower one.
        """
        place, quat = facts.board
        missing = np.clip(self.place(facts) - place, -_LONGEST_MOVE, _LONGEST_MOVE)
        turn = motion.rotation_error(quat, _orientation(facts, self.course(facts)))
        turn = np.clip(turn, -_LARGEST_TURN, _LARGEST_TURN)
        next_quat = math.multiply(math.from_rotation_vector(turn), quat)
        motions = {}
        for agent in self.agents:
            grasp = self._grasp(agent, place + missing, next_quat)
            motions[agent] = Motion(self._change(sim, agent, grasp), in_step=True)
        return motions

    def place(self, facts: BalanceFacts) -> Array:
        """Return where the expert brings the board's centre, (3,) or by world, in m."""
        return self.centre

    def course(self, facts: BalanceFacts) -> tuple[Array, Array, Array]:
        """Return the way the ball is to go, and its velocity and acceleration then.

        They are (num_envs, 3) each, in the board's frame.
        """
        still = np.zeros_like(facts.offset)
        return -facts.offset, still, still

    def _change(self, sim: Sim, agent: str, grasp: tuple[Array, Array]) -> np.ndarray:
        """Return the joint changes that put a tcp at a grasp."""
        arm = self.scene.arms[agent]
        place, quat = sim.pose(f"{agent}/tcp")
        turn = motion.rotation_error(quat, grasp[1])
        error = np.concatenate([grasp[0] - place, turn], axis=1)
        jacobian = np.concatenate(sim.jacobian(arm.hand, place), axis=1)[:, :, arm.dof]
        angle = np.asarray(sim.qpos[:, arm.qpos])
        low, high = arm.joint_range
        lean = 0.3 * (self._posture[agent] - angle)
        room = low - angle, high - angle
        change = motion.joint_change(jacobian, error, lean=lean, room=room)
        return motion.settling(sim, arm, change=change)


def _held(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Place a board in the frame of the tcp that holds its first handle."""
    handle, body = spec.site(HANDLES[0]), spec.body("board")
    inverse = math.conjugate(np.array(handle.quat))
    body.quat = inverse
    body.pos = -math.rotate(inverse, np.array(handle.pos))
    return spec


def _orientation(facts: BalanceFacts, course: tuple[Array, Array, Array]) -> np.ndarray:
    """Return the orientation of the board that rolls the ball on its course."""
    way, velocity, acceleration = (vector[:, :2] for vector in course)
    into_board = math.conjugate(facts.board[1])
    speed = math.rotate(into_board, facts.ball_velocity[0])[:, :2]
    wanted = motion.shortened(velocity + _APPROACH * way, _FASTEST)
    # Rolling on takes a slope of its own besides that of the acceleration.
    ahead = motion.shortened(wanted / _CALM, 1.0)
    slope = _GAIN * (wanted - speed) + _ROLLING_SLOPE * ahead
    slope = motion.shortened(slope + _PULL * acceleration, _STEEPEST)
    # The ball rolls to where the board's normal leans.
    zero = np.zeros(len(slope))
    return math.from_rotation_vector(
        np.stack([-slope[:, 1], slope[:, 0], zero], axis=1)
    )


register_task("Balance", Balance)
register_env(
    EnvSpec(
        "BalanceTaskSawyers-v0",
        Balance,
        ("sawyer", "sawyer"),
        {
            "push": 10.0,
            "placements": (
                Placement((0.0, -1.8, 1.0), np.pi / 2),
                Placement((0.0, 1.8, 1.0), -np.pi / 2),
            ),
        },
    )
)
register_env(
    EnvSpec(
        "BalanceTaskJacoSawyer-v0",
        Balance,
        ("jaco", "sawyer"),
        {
            "placements": (
                Placement((0.0, -1.4, 0.65), np.pi / 2),
                Placement((0.0, 1.8, 1.0), -np.pi / 2),
            )
        },
    )
)
