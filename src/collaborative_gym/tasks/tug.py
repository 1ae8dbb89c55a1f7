"""Tug: two arms hold a bar by its ends, and each pulls it over a line of its own.

Agents: `robot_1` at -y with the line at -y, and its opponent `robot_2` at +y with the
other line. Each observes the world from where it stands, so equal arms observe the same
in either seat. Each feels the torques of its own joints, not the other arm's.

A knob at each end of the bar turns freely in the hand, so an arm chooses its posture
while it pulls. The posture decides how hard it can pull: a joint pulls with its torque
limit over its lever about the line of pull. An arm that is commanded to move loses part
of its torques in every step, so it must keep pulling. An arm that is not commanded to
move keeps its torques, up to the limits of its motors. The hands never lose the bar. If
grips could tear, the weaker gripper would always tear first, and a jerk would win.

Randomized: where the bar starts (along every axis, and its turn about the vertical)
and the posture in which each arm holds it.

Reward of each agent:

- `win`: 10 for the winner and -10 for the loser, once, else 0.
- `way`: twice the speed of the bar towards the agent's line, in m/s. Shaping.
- `effort`: -0.01 times the length of the action; in other action modes, of what it asks
  of the joints. Shaping.

Success of a side: the bar's middle is past its line. The episode then ends. If time
runs out, it is a draw. Performance counts how long the bar is on the side's half.

Each line is 0.14 of the arms' mean reach away from the start of the bar. Unequal arms
get a handicap by their strengths. An arm's strength is the pull that its torque limits
can hold along the whole path of its hand, in the strongest postures found. The
distances of the two lines have the ratio of the strengths and keep their mean. This
alone is not enough, because an arm that is pulled out of its posture gets weaker: a
Panda's expert then won all episodes against a Sawyer's. A constant force, like a weight
on a rope, therefore also pulls the bar to the weaker side. It is 2.057 times the
difference of the strengths; this factor gives a Panda and a Sawyer even chances.

Other unequal pairs are not fair. With the same rule, a Panda's expert wins about 172 of
200 episodes against a Jaco's, and a Sawyer's about 136. For even chances, the force
must be right within 1 %, because the arm that is ahead has the stronger posture.
Torque limits do not predict it that well, and no single factor is right for all pairs.
If chances must be even, use equal arms, or a Panda and a Sawyer.

When the expert plays against itself, one side wins in all of 1,000 episodes of two
Pandas and in 948 of two Sawyers, after 2 s (median). The first seat wins 49.6 % of
them. Between a Panda and a Sawyer, the Panda's expert wins 49.9 % from the first
seat and 47.3 % from the second.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from operator import or_
from typing import ClassVar

import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion.loads import strong_paths
from collaborative_gym.objects.bar import KNOB, KNOBS, LENGTH, bar, line
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import SHOULDER, Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import tug as player
from collaborative_gym.tasks.holding import start_holding
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import Blocks, Task, TaskConfig, Terms

_CENTRE = np.array([0.0, 0.0, 1.0])
"""Where the bar's middle starts, at the height of all arms' shoulders, in m."""

_FAR = 0.68
"""Distance from an arm to its knob at the start, as a share of its reach. Arms that are
nearer end in postures in which neither wins; so do Sawyers that are farther."""

_SLOPE = np.radians(30.0)
"""Slope of the hands at the start; a Panda's hand cannot be level there."""

_POINTS, _TRIES = 9, 96
"""Points of the way on which a strength is sought, and from how many postures."""

_HELP = 2.057
"""The pull for a weaker arm, as a multiple of what its strength is less. The expert of
a Panda wins 497 of 1,000 episodes against that of a Sawyer; of 256 it wins 160 with
2.049 and 103 with 2.06."""

_COLOURS = {"orange": (0.85, 0.45, 0.10, 0.9), "blue": (0.15, 0.45, 0.85, 0.9)}


@dataclass(frozen=True)
class TugConfig(TaskConfig):
    """Settings of Tug.

    Attributes:
      line: mean distance of the lines from where the bar starts, in m, or None for 0.14
        of the arms' mean reach.
    """

    line: float | None = bounded(None, 0.06, 0.3)


@dataclass(frozen=True)
class TugFacts:
    """Facts of Tug, by agent but for the bar; (num_envs, ...) each."""

    joints: dict[str, Array]  # angles, in rad
    speeds: dict[str, Array]  # of the joints, in rad/s
    loads: dict[str, Array]  # torques of the joints' servos, as shares of their limits
    tcps: dict[str, Array]  # positions
    bar: Array  # position of its middle
    velocity: Array  # of its middle, in m/s
    missing: dict[str, Array]  # from the middle to the agent's line, < 0 past it, in m


class Tug(Task[TugConfig, TugFacts]):
    """Pull the bar over your own line, against the other arm.

    Attributes:
      lines: distance of each agent's line from where the bar starts, in m.
      help: force along y on the bar, for the weaker arm, in N.
    """

    config_class = TugConfig
    performance_from_start = True
    expert = player.expert
    colours = tuple(_COLOURS)
    units: ClassVar[Mapping[str, str]] = {"missing": "m"}
    block_units: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("joints", "other joints"), "rad"),
        **dict.fromkeys(("joint speeds", "other joint speeds"), "rad/s"),
        **dict.fromkeys(("tcp", "other tcp", "bar"), "m"),
        "bar velocity": "m/s",
        "missing to own and other line": "m",
    }

    @property
    def ways(self) -> dict[str, float]:
        """The direction along y in which each agent pulls, -1 or 1."""
        return dict(zip(self.agents, (-1.0, 1.0), strict=True))

    @property
    def sides(self) -> tuple[tuple[str, ...], ...]:
        return tuple((agent,) for agent in self.agents)

    def mounts(self) -> tuple[Placement, ...]:
        """Return arms face to face, their shoulders at the height of the bar."""
        far = [LENGTH / 2 + _FAR * robot.reach for robot in self.robots.values()]
        return teams.face_to_face(far, [float(_CENTRE[2] - SHOULDER[2])] * 2)

    def build(self, scene: Scene) -> None:
        self._check_placements()
        self.lines, self.help = self._handicap()
        for agent, placement in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=placement, holds=KNOB)
        scene.add("bar", bar(), position=_CENTRE)
        lines = zip(self.agents, KNOBS, _COLOURS.values(), strict=True)
        for agent, knob, colour in lines:
            tcp = f"{agent}/{self.robots[agent].tcp}"
            scene.add_weld(tcp, f"bar/{knob}", turns=True)
            place = _CENTRE + np.array([0.0, self.ways[agent] * self.lines[agent], 0.0])
            scene.add(f"{agent}_line", line(colour), position=place)
            scene.paint_hand(agent, (*colour[:3], 1.0))
        scene.add_pose_sensor("bar", "bar/bar")
        scene.add_velocity_sensor("bar", "bar/bar")
        teams.add_team_camera(scene, self.placements)

    def _check_placements(self) -> None:
        first, second = self.placements.values()
        if not first.position[1] < 0.0 < second.position[1]:
            raise ValueError(
                "Tug needs robot_1 at negative y and robot_2 at positive y, got"
                f" {first.position} and {second.position}"
            )

    def _handicap(self) -> tuple[dict[str, float], float]:
        robots = list(self.robots.values())
        mean = self.config.line
        if mean is None:
            mean = 0.14 * float(np.mean([robot.reach for robot in robots]))
        pulls = [1.0 for _ in robots]
        if len({robot.name for robot in robots}) > 1:
            pulls = [strength(robot) for robot in robots]
        shares = np.array(pulls) / np.mean(pulls)
        lines = dict(zip(self.agents, (mean * shares).tolist(), strict=True))
        # What helps one arm is against the other.
        return lines, -_HELP * float(np.dot(pulls, list(self.ways.values())))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._bar = sim.model.body("bar/bar").id
        self._knob, self._approach, self._posture = {}, {}, {}
        for agent, knob in zip(self.agents, KNOBS, strict=True):
            arm, robot = scene.arms[agent], self.robots[agent]
            inwards = 0.0, -self.ways[agent] * np.cos(_SLOPE), -np.sin(_SLOPE)
            self._knob[agent] = sim.model.site(f"bar/{knob}").pos.copy()
            self._approach[agent] = np.array(inwards)
            goal = _CENTRE + self._knob[agent], self._approach[agent]
            self._posture[agent] = motion.solve_pose(
                sim.model, arm, goal=goal, start=robot.home
            )

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        moved, near = rng.within(self.config.randomization.moves, 4), self._posture
        moved = start_holding(
            self, sim, env_ids, self._grasps, rng=rng, moved=moved, postures=near
        )
        place, quat = _CENTRE + moved[:, :3], math.from_yaw(moved[:, 3])
        self.scene.place(sim, env_ids, name="bar", position=place, quat=quat)

    def _grasps(self, moved: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return where and how the arms hold a bar moved along x, y, z and about z."""
        place, quat = _CENTRE + moved[:, :3], math.from_yaw(moved[:, 3])
        knobs = [place + math.rotate(quat, self._knob[agent]) for agent in self.agents]
        ways = [math.rotate(quat, self._approach[agent]) for agent in self.agents]
        return list(zip(knobs, ways, strict=True))

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        sim.xfrc_applied[:, self._bar, 1] = self.help

    def measure(self, sim: Sim) -> TugFacts:
        xp, place = sim.xp, sim.pose("bar")[0]
        speeds, loads, missing = {}, {}, {}
        for agent, arm in self.scene.arms.items():
            speeds[agent] = xp.asarray(sim.qvel[:, arm.dof], copy=True)
            asked = self.action_mode.torques(sim, agent)
            share = asked / xp.asarray(arm.robot.torque_limits)
            loads[agent] = xp.minimum(xp.maximum(share, -1.0), 1.0)
            missing[agent] = self.lines[agent] - self.ways[agent] * place[:, 1]
        return TugFacts(
            joints=self.joints(sim),
            speeds=speeds,
            loads=loads,
            tcps={agent: sim.pose(f"{agent}/tcp")[0] for agent in self.agents},
            bar=place,
            velocity=sim.velocity("bar")[0],
            missing=missing,
        )

    def observe(self, facts: TugFacts) -> dict[str, Blocks]:
        xp, seen = array_namespace(facts.bar), {}
        centre = xp.asarray(_CENTRE)
        for agent in self.agents:
            [other] = [each for each in self.agents if each != agent]
            lines = [facts.missing[agent], facts.missing[other]]
            seen[agent] = {
                "joints": facts.joints[agent],
                "joint speeds": facts.speeds[agent],
                "joint loads": facts.loads[agent],
                "tcp": self._own(agent, facts.tcps[agent] - centre),
                "bar": self._own(agent, facts.bar - centre),
                "bar velocity": self._own(agent, facts.velocity),
                "missing to own and other line": xp.stack(lines, axis=1),
                "other joints": facts.joints[other],
                "other joint speeds": facts.speeds[other],
                "other tcp": self._own(agent, facts.tcps[other] - centre),
            }
        return seen

    def _own(self, agent: str, vector: Array) -> Array:
        """Return vectors (num_envs, 3) ahead of an agent, to its left and upwards."""
        way, (x, y, z) = self.ways[agent], (vector[:, i] for i in range(3))
        return array_namespace(vector).stack([-way * y, way * x, z], axis=1)

    def reward(self, facts: TugFacts, commands: Commands) -> dict[str, Terms]:
        xp, terms = array_namespace(facts.bar), {}
        for agent in self.agents:
            [other] = [each for each in self.agents if each != agent]
            won = xp.where(facts.missing[agent] < 0.0, 10.0, 0.0)
            lost = xp.where(facts.missing[other] < 0.0, 10.0, 0.0)
            terms[agent] = {
                "win": won - lost,
                "way": 2.0 * self.ways[agent] * facts.velocity[:, 1],
                "effort": -0.01 * math.norm(commands[agent].moves),
            }
        return terms

    def success(self, facts: TugFacts) -> tuple[Array, ...]:
        return tuple(facts.missing[agent] < 0.0 for agent in self.agents)

    def performing(self, facts: TugFacts) -> tuple[Array, ...]:
        return tuple(self.ways[a] * facts.bar[:, 1] > 0.0 for a in self.agents)

    def over(self, facts: TugFacts) -> Array:
        return reduce(or_, self.success(facts))


@lru_cache(maxsize=64)
def strength(robot: Robot) -> float:
    """Return the pull in N that an arm can hold all along the way of its hand in Tug.

    Raises:
      ValueError: if the arm cannot go that way.
    """
    shares = np.linspace(_FAR + 0.14, _FAR - 0.14, _POINTS)
    path = np.zeros((_POINTS, 3))
    path[:, 0], path[:, 2] = shares * robot.reach, SHOULDER[2]
    pull = np.array([-1.0, 0.0, 0.0])
    loads, _, _ = strong_paths(robot, np.tile(path, (_TRIES, 1, 1)), pull=pull)
    if not loads.any():
        raise ValueError(
            f"{robot.name} cannot pull a bar from {path[0, 0]:.2f} to {path[-1, 0]:.2f}"
            " m before its base; choose an arm with a longer reach"
        )
    return float(GRAVITY * loads.max())


register_task("Tug", Tug)
register_env(EnvSpec("TugPandas-v0", Tug, ("panda", "panda")))
register_env(EnvSpec("TugSawyers-v0", Tug, ("sawyer", "sawyer")))
register_env(EnvSpec("TugPandaSawyer-v0", Tug, ("panda", "sawyer")))
