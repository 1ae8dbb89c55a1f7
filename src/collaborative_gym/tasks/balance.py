"""Balance: two to eight arms hold a board and keep a ball on its middle.

The board (1 kg, with two arms 0.8 x 1.5 m) is fixed in robot_1's hand and welded to the
tcps of the others, so all arms move with every tilt. One arm alone can tilt it, against
the servos of the others. The task therefore measures how well arms cooperate, not
whether they must. The ball rolls without slipping, and rests on slopes below 7.5 %. In
the two-Sawyer environment, a vertical force acts on a random point of the board. It
changes at every step and is up to 10 N up or down.

Agents: with two arms, `robot_1` holds the board at -y and `robot_2` at +y; both observe
everything except the other's joints. Three or more arms stand evenly around a round
board (1.2 m), `robot_1` at -y and the others counterclockwise. Each observes its
joints, ball and board in the frame of its own base, with the board turned as if its
handle were the first. For each mate, the block `mates` has whether there is one and the
vector from the robot's own handle to the mate's, in m.

Randomized: where on the board the ball starts; where the board starts (position along
every axis, turn about the vertical, always level) and the posture in which each arm
holds it. Inverse kinematics finds the start angles from the nominal ones plus noise.

Reward of each agent:

- `distance`: minus the distance between the centres of ball and board, in m.
- `fell`: -1 once the ball has left the board, even if it returns, else 0.

Success: for 2 s, this distance is below 0.09 m and the ball is on the board. A ball
that rolls across the middle by chance leaves sooner. The centres are 0.06 m apart when
the ball lies in the middle, so the ball must be within 0.067 m of it along the board.

The thesis starts the board 0.7 or 0.6 m above the floor. At 0.7 m, a Sawyer mounted as
in the thesis has its handle at the end of its reach. There it cannot make 40 %
of the moves and tilts that the task needs. At 0.6 m the handle is out of reach. Here
the board starts at 0.95 m.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.objects.ball import RADIUS, ball
from collaborative_gym.objects.board import (
    BAR,
    THICKNESS,
    board,
    handle_radius,
    is_off,
    within,
)
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import balance as player
from collaborative_gym.tasks.holding import start_holding
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded, filled
from collaborative_gym.tasks.task import Blocks, Task, TaskConfig, Terms, columns

_BALL_START = np.array([0.2, 0.45])  # m, bounds along a board of two
_TEAM_BALL_START = np.array([0.3, 0.3])  # m, along a round one
_FASTEST = 0.6  # m/s, of a ball that already rolls
REST_HEIGHT = THICKNESS / 2 + RADIUS


@dataclass(frozen=True)
class BalanceConfig(TaskConfig):
    """Settings of Balance.

    Attributes:
      success_distance: between the centres of ball and board, in m.
      board_height: of the board's centre above the floor at the nominal start, in m.
      push: greatest vertical force on the board, a new one at every step, in N.
      egocentric: whether each robot sees in the frame of its own base; None for False
        with two arms and True with more.
    """

    success_distance: float = bounded(0.09, 0.001, 10.0)
    board_height: float = bounded(0.95, 0.0, 10.0)
    push: float = bounded(0.0, 0.0, 1000.0)
    egocentric: bool | None = None


@dataclass(frozen=True)
class BalanceFacts:
    """Facts of Balance; a pose is a position and a quaternion."""

    joints: dict[str, Array]  # angles by agent, (num_envs, joints), in rad
    ball: tuple[Array, Array]  # pose
    ball_velocity: tuple[Array, Array]  # linear and angular
    board: tuple[Array, Array]  # pose of its centre
    offset: Array  # (num_envs, 3) from board to ball in the board's frame, in m
    distance: Array  # (num_envs,) length of `offset`, in m
    fell: Array  # (num_envs,) whether the ball has ever left the board


class Balance(Task[BalanceConfig, BalanceFacts]):
    """Keep a ball on the middle of a board that all arms hold.

    Attributes:
      centre: nominal place of the board's centre, (3,).
      postures: of each arm, in the middle of what it needs to do, in rad.
    """

    robot_counts = range(2, teams.MOST_MATES + 2)
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
    success_for = 20
    performance_from_start = True
    expert = player.expert

    def _take(self, config: BalanceConfig) -> None:
        super()._take(filled(config, egocentric=len(self.agents) > 2))

    def mounts(self) -> tuple[Placement, ...]:
        """Return bases 0.7 of each reach behind the handles, facing the middle."""
        robots, radius = self.robots.values(), handle_radius(len(self.agents))
        far = [radius + 0.7 * robot.reach for robot in robots]
        return teams.around(far, [robot.base_height for robot in robots])

    @property
    def marked_radius(self) -> float:
        """Radius of the disc on the board in which the ball is to lie, in m."""
        return float(np.sqrt(self.config.success_distance**2 - REST_HEIGHT**2))

    def build(self, scene: Scene) -> None:
        first, *others = self.agents
        for agent, placement in self.placements.items():
            robot = self.robots[agent]
            is_slim = len(others) > 1 and robot.stand == "table"
            scene.add_robot(
                agent, robot, placement=placement, holds=BAR, stand=not is_slim
            )
            if is_slim:
                teams.add_stand(scene, agent, placement)
        # A free board with a weld for each would move in the same way, but slower.
        tool = board(marked_radius=self.marked_radius, count=len(self.agents))
        scene.add_tool(first, "board", child=_held(tool))
        for i, agent in enumerate(others):
            tcp = scene.spec.site(f"{agent}/{self.robots[agent].tcp}")
            scene.add_weld(tcp.name, f"{first}/board/handle_{i + 2}")
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
        teams.add_team_camera(scene, self.placements, tall=0.35, steep=True)

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        model = sim.model
        prefix = f"{self.agents[0]}/board"
        self._board = model.body(f"{prefix}/board").id
        joint = model.body("ball/ball").jntadr[0]
        self._ball = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        self.centre = np.array([0.0, 0.0, self.config.board_height])
        self._frames = teams.Frames(self.placements)
        self._spins = teams.seat_turns(self.placements)
        self._handles, self.postures = {}, {}
        for i, (agent, arm) in enumerate(scene.arms.items()):
            site = model.site(f"{prefix}/handle_{i + 1}")
            self._handles[agent] = site.pos.copy(), site.quat.copy()
            poses = [self.grasp(agent, *pose) for pose in self.poses()]
            self.postures[agent] = motion.central_pose(model, arm, poses=poses)
        scene.postures |= self.postures

    def poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the board's nominal pose and those that an arm should have at hand."""
        poses = [(self.centre, math.from_rotation_vector(np.zeros(3)))]
        for x, y, turn in product((-1.0, 1.0), repeat=3):
            moved = self.centre + 0.05 * np.array([x, y, x * y * turn])
            poses.append((moved, math.from_yaw(np.array(np.radians(15) * turn))))
        for x, y in product((-1.0, 1.0), repeat=2):
            tilt = player.STEEPEST * np.array([x, y, 0.0])
            poses.append((self.centre, math.from_rotation_vector(tilt)))
        return poses

    def grasp(
        self, agent: str, place: np.ndarray, quat: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose of a tcp at its handle of a board that is there."""
        handle_place, handle_quat = self._handles[agent]
        grasp_place = place + math.rotate(quat, handle_place)
        return grasp_place, math.multiply(quat, handle_quat)

    def remember(self, num_envs: int) -> dict[str, Array]:
        memory: dict[str, Array] = {"fell": self.xp.zeros(num_envs, dtype=bool)}
        if self.config.push > 0:
            # Force and its point along the board's x and y, for every step.
            shape = num_envs, self.config.max_episode_steps, 3
            memory["pushes"] = self.xp.zeros(shape, dtype=self.xp.float64)
        return memory

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        moved = rng.within(self.config.randomization.moves, 4)

        def board_at(moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self.centre + moved[:, :3], math.from_yaw(moved[:, 3])

        def grasps(moved: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
            return [self.grasp(agent, *board_at(moved)) for agent in self.agents]

        moved = start_holding(
            self, sim, env_ids, grasps, rng=rng, moved=moved, postures=self.postures
        )
        is_pair = len(self.agents) == 2
        rolled = rng.within(_BALL_START if is_pair else _TEAM_BALL_START, 2)
        place, quat = board_at(moved)
        resting = np.full((len(rolled), 1), REST_HEIGHT)
        place = place + math.rotate(quat, np.concatenate([rolled, resting], axis=1))
        self.scene.place(sim, env_ids, name="ball", position=place, quat=quat)
        if self.config.push > 0:
            span = np.array([self.config.push, *within(len(self.agents))])
            size = (self.config.max_episode_steps, 3)
            sim.memory["pushes"][env_ids] = sim.xp.asarray(rng.within(span, size))

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """The ball already rolls, to any side."""
        speed, angle = rng.uniform(0.0, _FASTEST, 1), rng.within(np.pi)
        zero = np.zeros(len(angle))
        ahead = speed * np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
        # A free joint turns about its own axes, and moves along those of the world.
        turn = math.cross(np.array([0.0, 0.0, 1.0]), ahead) / RADIUS
        place, first = self._ball
        quat = np.asarray(sim.qpos[env_ids, place + 3 : place + 7])
        velocity = np.concatenate([math.rotate(quat, ahead), turn], axis=1)
        sim.qvel[env_ids, first : first + 6] = sim.xp.asarray(velocity)

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        if self.config.push > 0:
            push = sim.memory["pushes"][sim.xp.arange(sim.num_envs), steps]
            force = push[:, 0]
            along = [push[:, 1], push[:, 2], sim.xp.zeros_like(force)]
            lever = math.rotate(sim.pose("board")[1], sim.xp.stack(along, axis=1))
            sim.xfrc_applied[:, self._board, 2] = force
            sim.xfrc_applied[:, self._board, 3] = lever[:, 1] * force
            sim.xfrc_applied[:, self._board, 4] = -lever[:, 0] * force

    def measure(self, sim: Sim) -> BalanceFacts:
        ball_pose, board_pose = sim.pose("ball"), sim.pose("board")
        into_board = math.conjugate(board_pose[1])
        offset = math.rotate(into_board, ball_pose[0] - board_pose[0])
        xp = array_namespace(offset)
        off = is_off(offset, len(self.agents))
        fell = sim.memory["fell"] = sim.memory["fell"] | off
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
        if self.config.egocentric:
            return {agent: self._seen_by(agent, facts) for agent in self.agents}
        blocks = {
            **columns("joints", facts.joints),
            "ball": math.pose(*facts.ball),
            "ball linear velocity": facts.ball_velocity[0],
            "ball angular velocity": facts.ball_velocity[1],
            "board": math.pose(*facts.board),
        }
        return dict.fromkeys(self.agents, blocks)

    def _seen_by(self, agent: str, facts: BalanceFacts) -> Blocks:
        """Return an agent's observation, in the frame of its base.

        The ball's turn says nothing and is left out.
        """
        frames, (place, quat) = self._frames, facts.board
        xp, own = array_namespace(place), self._handles[agent][0]
        rows = []
        for mate in teams.mates_of(self.agents, agent):
            apart = xp.asarray(self._handles[mate][0] - own, dtype=place.dtype)
            apart = math.rotate(quat, xp.broadcast_to(apart, place.shape))
            rows.append(apart)
        spin = xp.asarray(self._spins[agent], dtype=quat.dtype)
        turned = math.multiply(quat, xp.broadcast_to(spin, quat.shape))
        linear, angular = facts.ball_velocity
        return {
            "joints": teams.alike(facts.joints[agent]),
            "ball": frames.place(agent, facts.ball[0]),
            "ball linear velocity": frames.direction(agent, linear),
            "ball angular velocity": frames.direction(agent, angular),
            "board": math.pose(*frames.pose(agent, (place, turned))),
            "mates": teams.mates_block(frames.directions(agent, rows)),
        }

    def reward(self, facts: BalanceFacts, commands: Commands) -> dict[str, Terms]:
        fell = array_namespace(facts.distance).where(facts.fell, -1.0, 0.0)
        terms = {"distance": -facts.distance, "fell": fell}
        return dict.fromkeys(self.agents, terms)

    def success(self, facts: BalanceFacts) -> Array:
        return (facts.distance < self.config.success_distance) & ~facts.fell

    def shortfall(self, facts: BalanceFacts) -> Array:
        xp = array_namespace(facts.distance)
        missing = facts.distance + xp.where(facts.fell, 1.0, 0.0)
        return xp.where(self.success(facts), 0.0, missing)

    def performing(self, facts: BalanceFacts) -> Array:
        return ~facts.fell


def _held(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    handle, body = spec.site("handle_1"), spec.body("board")
    inverse = math.conjugate(np.array(handle.quat))
    body.quat = inverse
    body.pos = -math.rotate(inverse, np.array(handle.pos))
    return spec


_SAWYERS = {"push": 10.0, "placements": teams.face_to_face((1.8, 1.8), (1.0, 1.0))}
_WITH_JACO = {"placements": teams.face_to_face((1.4, 1.8), (0.65, 1.0))}
register_task("Balance", Balance)
register_env(EnvSpec("BalanceTaskSawyers-v0", Balance, ("sawyer", "sawyer"), _SAWYERS))
register_env(
    EnvSpec("BalanceTaskJacoSawyer-v0", Balance, ("jaco", "sawyer"), _WITH_JACO)
)
