"""Lift: two robots lift a pot that is too heavy for one.

The pot stands on a table between the robots. Each robot grips its handle. Together they
lift the pot to a target above the table and keep it level.

Agents: `robot_1` stands at -y and takes the handle at -y, `robot_2` stands at +y and
takes the other. Both observe everything.

Randomised: the arms' start, the pot's place and turn on the table, the target.

Reward of each agent:

- `reach`: minus the distance from its tool centre point to its handle, in m.
- `lift`: -2 times the distance from the pot's middle to the target, in m.
- `tilt`: -0.2 (|roll| + |pitch|) of the pot, in rad.
- `effort`: minus 0.01 times the Euclidean norm of its joints' part of the action; in
  another action mode, of the joint changes that the action comes to.
- `grip`: 0.1 while it asks for a grip within `picking_threshold` (0.03 m) of its
  handle, else 0.

Success: the pot's middle is within 0.15 m of the target, level within 15 degrees and
slower than 0.3 m/s, while both arms grip it.

The pot's mass follows from the arms, so that no arm can hold it alone. `lift_mass` says
how, and `benchmarks/lift_capacity.py` measures it in simulation. The distance alone is
not enough for success: one arm can swing the pot past the target while the other arm
only holds its handle. But then the pot is tilted or fast.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Command
from collaborative_gym.errors import check_numbers
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import greatest_load, solve_pose, turn_fingers
from collaborative_gym.motion.lift_mass import weigh
from collaborative_gym.objects.pot import HANDLE_WIDTH, pot
from collaborative_gym.objects.table import table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.experts import lift as player
from collaborative_gym.tasks.experts.lift import GRIP_OFFSETS, START, WAY_OFFSETS
from collaborative_gym.tasks.holding import start_holding
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import (
    LEVEL,
    Blocks,
    Randomization,
    Task,
    TaskConfig,
    Terms,
    columns,
    face_to_face,
    presets,
)

_TABLE_HEIGHT = 0.64  # m
_STANDOFF = 0.12  # m from the handle, against the approach, where an arm starts
_LEAST_MISS, _FARTHEST_MISS = 1.25, 0.1  # of the distance of a grip; m
_NEAREST, _FARTHEST = 0.36, 0.85  # from an arm to its handle, as shares of its reach


@dataclass(frozen=True)
class LiftConfig(TaskConfig):
    """Settings of Lift.

    Attributes:
      target: where the pot is to go, in m, or None for the task's rule.
      pot_mass: in kg, or None for the task's rule.
      success_radius: distance to the target that counts as there, in m.
      success_tilt: tilt of the pot that counts as level, in rad.
      success_speed: speed of the pot that counts as slow, in m/s.
      picking_threshold: greatest distance at which a grip starts, in m.
    """

    target: tuple[float, float, float] | None = None
    pot_mass: float | None = bounded(None, 0.01, 1000.0)
    success_radius: float = bounded(0.15, 0.001, 10.0)
    success_tilt: float = bounded(float(np.radians(15.0)), 0.001, 1.5)
    success_speed: float = bounded(0.3, 0.001, 100.0)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.target is not None:
            target = check_numbers("target", self.target, 3)
            object.__setattr__(self, "target", target)


@dataclass(frozen=True)
class LiftFacts:
    """What Lift looks at, (num_envs, ...) each; poses as in `Sim`."""

    joints: dict[str, Array]  # angles by agent, in rad
    gripping: dict[str, Array]  # whether the agent's grip holds
    handles: dict[str, tuple[Array, Array]]  # pose of the agent's own handle
    tcps: dict[str, tuple[Array, Array]]  # poses
    pot: tuple[Array, Array]  # pose of its middle
    target: Array  # its position
    to_handle: dict[str, Array]  # distance of the agent's tcp to its handle, in m
    to_target: Array  # distance of the pot to the target, in m
    tilt: Array  # |roll| + |pitch| of the pot, in rad
    speed: Array  # of the pot's middle, in m/s


class Lift(Task[LiftConfig, LiftFacts]):
    """Lift a pot that is too heavy for one arm to a target, and keep it level.

    Attributes:
      target: nominal place of the target, (3,).
      pot_mass: in kg.
      weighing: what the arms can carry, alone and together.
      ways: by agent, how the arm lifts its handle to the target.
    """

    gripping = True
    randomizations = presets(Randomization(joint_noise=0.12))
    units: ClassVar[Mapping[str, str]] = {
        "to_handle": "m",
        "to_target": "m",
        "tilt": "rad",
        "speed": "m/s",
    }
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "handle": POSE,
        "tcp": POSE,
        "pot": POSE,
        "target": "m",
    }
    styles = player.STYLES
    expert, styled = player.expert, player.styled
    config_class = LiftConfig

    def mounts(self) -> tuple[Placement, ...]:
        """Return arms face to face, the weaker one nearer to the pot.

        What an arm can carry falls about as one over its distance. So both are put
        where they can carry the same, as far as their reach allows.
        """
        strength = {
            agent: greatest_load(robot, ((0.6 * robot.reach, 0.0, 0.3),))
            for agent, robot in self.robots.items()
        }
        least, most = min(strength.values()), max(strength.values())
        far = min(_FARTHEST, 0.8 * (most / least) ** 0.5)
        distances, heights = [], []
        for agent, robot in self.robots.items():
            share = max(_NEAREST, far * strength[agent] / most)
            distances.append(float(share * robot.reach + GRIP_OFFSETS[1, 1]))
            at_floor = robot.stand == "pedestal"
            heights.append(robot.base_height if at_floor else _TABLE_HEIGHT)
        return face_to_face(distances, heights)

    def build(self, scene: Scene) -> None:
        self._weigh()
        for agent, placement in self.placements.items():
            x, y, z = placement.position
            robot = self.robots[agent]
            own = robot.stand == "pedestal" or self.config.placements is not None
            scene.add_robot(agent, robot, placement=placement, stand=own)
            if not own and abs(y) > 0.55:
                # Push the arm's table back to the pot's table, which it would overlap.
                place = (x, np.sign(y) * max(abs(y), 0.9), 0.0)
                turn = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
                scene.add(f"{agent}_stand", table(height=z), position=place, quat=turn)
        scene.add("table", table())
        balance = float(np.dot(self.weighing.shares, GRIP_OFFSETS[:, 1]))
        scene.add("pot", pot(self.pot_mass, balance), position=START)
        scene.add_pose_sensor("pot", "pot/pot")
        scene.add_velocity_sensor("pot", "pot/pot")
        for agent, handle in self._handles.items():
            threshold = self.config.picking_threshold
            scene.add_grip(agent, handle, threshold=threshold, width=HANDLE_WIDTH)
        radius = self.config.success_radius
        scene.add_target("target", radius)
        scene.add_camera((2.25, 0.0, 1.62), (0, 1, 0, -0.22, 0, 1))

    @property
    def _handles(self) -> dict[str, str]:
        return {agent: f"pot/handle_{i + 1}" for i, agent in enumerate(self.agents)}

    def _weigh(self) -> None:
        """Find the target, the arms' ways to it and the mass of the pot."""
        placements = tuple(self.placements.values())
        lowest = min(placement.position[2] for placement in placements)
        self.target = np.array(self.config.target or (0.0, 0.0, lowest + 0.45))
        self.weighing = weigh(
            tuple(self.robots.values()),
            placements,
            ends=[(START + offset, self.target + offset) for offset in WAY_OFFSETS],
            target=self.target,
            radius=self.config.success_radius,
        )
        given = self.config.pot_mass
        self.pot_mass = self.weighing.pot_mass if given is None else given
        self.ways = dict(zip(self.agents, self.weighing.ways, strict=True))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        model = sim.model
        self._start, bar = {}, np.array([1.0, 0.0, 0.0])
        for i, (agent, arm) in enumerate(scene.arms.items()):
            way = self.ways[agent]
            angles = turn_fingers(model, arm, angles=way.angles, bar=bar)
            self.ways[agent] = replace(way, angles=angles)
            goal = START + GRIP_OFFSETS[i] - _STANDOFF * way.approach, way.approach
            self._start[agent] = solve_pose(model, arm, goal=goal, start=angles[0])
            scene.postures[agent] = self.ways[agent].at(np.array([0.5]))[0]

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        bounds = self.config.randomization
        self.start_arms(sim, env_ids, rng=rng, angles=self._start)
        quat = math.from_yaw(rng.within(bounds.object_yaw))
        place = START + rng.within(bounds.object_position * LEVEL, 3)
        self.scene.place(sim, env_ids, name="pot", position=place, quat=quat)
        shift = rng.within(bounds.target_position, 3)
        self.scene.place(sim, env_ids, name="target", position=self.target + shift)

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """One arm holds its handle, and the other has missed its own by some cm."""
        agents, moves = self.agents, self.config.randomization.moves
        pot_moved = rng.within(moves * [1.0, 1.0, 0.0, 1.0], 4)
        misses = rng.uniform(0, len(agents)).astype(int)
        angle, least = (
            rng.uniform(0, np.pi),
            _LEAST_MISS * self.config.picking_threshold,
        )
        far = rng.uniform(least, max(least, _FARTHEST_MISS))[:, None]
        # Beside or above the bar, which is along x; below it, fingers meet the table.
        aside = far * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
        misses = np.arange(len(agents)) == misses[:, None]
        missed = (misses[:, :, None] * aside[:, None]).reshape(len(misses), -1)

        def grasps(moved: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
            place, quat = START + moved[:, :3], math.from_yaw(moved[:, 3])
            handles = place + math.rotate(quat, GRIP_OFFSETS[:, None])
            missed = moved[:, 4:].reshape(len(moved), -1, 3)
            return [
                (handles[i] + missed[:, i], self.ways[agent].approach)
                for i, agent in enumerate(agents)
            ]

        moved = np.concatenate([pot_moved, missed], axis=1)
        postures = {agent: self.ways[agent].angles[0] for agent in agents}
        moved = start_holding(
            self, sim, env_ids, grasps, rng=rng, moved=moved, postures=postures
        )
        place, quat = START + moved[:, :3], math.from_yaw(moved[:, 3])
        self.scene.place(sim, env_ids, name="pot", position=place, quat=quat)
        for i, grip in enumerate(self.scene.grips):
            held = self.model.equality(grip.name).id
            sim.eq_active[env_ids, held] = sim.xp.asarray(~misses[:, i])

    def measure(self, sim: Sim) -> LiftFacts:
        handles = {agent: sim.pose(site) for agent, site in self._handles.items()}
        tcps = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        to_handle = {a: math.distance(tcps[a][0], handles[a][0]) for a in self.agents}
        pose, (target, _) = sim.pose("pot"), sim.pose("target")
        roll, pitch = math.roll_pitch(pose[1])
        xp = array_namespace(roll)
        return LiftFacts(
            joints=self.joints(sim),
            gripping={agent: self.scene.holds(sim, agent) for agent in self.agents},
            handles=handles,
            tcps=tcps,
            pot=pose,
            target=target,
            to_handle=to_handle,
            to_target=math.distance(pose[0], target),
            tilt=xp.abs(roll) + xp.abs(pitch),
            speed=math.norm(sim.velocity("pot")[0]),
        )

    def observe(self, facts: LiftFacts) -> dict[str, Blocks]:
        xp = array_namespace(facts.target)
        kind = facts.target.dtype
        grips = {a: xp.astype(g, kind)[:, None] for a, g in facts.gripping.items()}
        handles = {agent: math.pose(*pose) for agent, pose in facts.handles.items()}
        tcps = {agent: math.pose(*pose) for agent, pose in facts.tcps.items()}
        blocks = {
            **columns("joints", facts.joints),
            **columns("gripping", grips),
            **columns("handle", handles),
            **columns("tcp", tcps),
            "pot": math.pose(*facts.pot),
            "target": facts.target,
        }
        return dict.fromkeys(self.agents, blocks)

    def reward(
        self, facts: LiftFacts, commands: dict[str, Command]
    ) -> dict[str, Terms]:
        xp = array_namespace(facts.to_target)
        terms = {}
        for agent in self.agents:
            command, near = commands[agent], facts.to_handle[agent]
            wants = command.grips & (near < self.config.picking_threshold)
            terms[agent] = {
                "reach": -near,
                "lift": -2.0 * facts.to_target,
                "tilt": -0.2 * facts.tilt,
                "effort": -0.01 * math.norm(command.moves),
                "grip": 0.1 * xp.astype(wants, near.dtype),
            }
        return terms

    def success(self, facts: LiftFacts) -> Array:
        config = self.config
        is_there = facts.to_target < config.success_radius
        is_level = facts.tilt < config.success_tilt
        is_slow = facts.speed < config.success_speed
        return reduce(and_, facts.gripping.values(), is_there & is_level & is_slow)

    def shortfall(self, facts: LiftFacts) -> Array:
        xp = array_namespace(facts.to_target)
        tilted = xp.maximum(facts.tilt - self.config.success_tilt, 0.0)
        too_fast = xp.maximum(facts.speed - self.config.success_speed, 0.0)
        # In m; what a radian and a metre per second count is our choice.
        missing = facts.to_target + 0.3 * tilted + 0.1 * too_fast
        for agent, held in facts.gripping.items():
            missing = missing + xp.where(held, 0.0, facts.to_handle[agent])
        return xp.where(self.success(facts), 0.0, missing)


_SAWYERS = {
    "placements": (
        Placement((0.22, -1.2, 1.0), np.pi / 2),
        Placement((-0.22, 1.2, 1.0), -np.pi / 2),
    ),
    "target": (0.0, 0.0, 1.5),
    "picking_threshold": 0.02,
}
_JACOS = {
    "placements": face_to_face((0.9, 0.9), (0.65, 0.6)),
    "target": (0.0, 0.0, 1.2),
    "picking_threshold": 0.04,
}
register_task("Lift", Lift)
register_env(EnvSpec("LiftTaskSawyers-v0", Lift, ("sawyer", "sawyer"), _SAWYERS))
register_env(EnvSpec("LiftTaskJacos-v0", Lift, ("jaco", "jaco"), _JACOS))
