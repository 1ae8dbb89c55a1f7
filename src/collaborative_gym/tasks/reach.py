"""Reach: arms in one cell go to goals of their own and never touch one another.

Two to eight arms of any kind stand in a ring and face its middle. Each has `goals`
goals in its pedestal's colour. The next one appears once its tcp has come to rest
within `radius` of the current one. Goals lie beyond the middle between two arms, on
alternating sides, and neighbours turn to each other at the same time. Their paths
cross, so one must wait or go round. An arm with no goal left must stay out of the way.
Nothing is gripped. The episode ends if arms touch after a control step.

Randomized: every goal (along every axis) and every joint angle.

Reward of each agent:

- `distance`: 10 times the distance, in m, by which its tcp came nearer to its goal.
- `goal`: 5 for a goal that is reached, else 0.
- `touch`: -20 if the arm touches another one, else 0.
- `effort`: -0.01 times the Euclidean norm of the agent's own action; in other action
  modes, of what the action asks of the joints.

Success: every arm has reached its goals and touched no other. The episode then ends.

Coordination: `stage` is the share of all goals that were reached; `idle` is the mean
share of arms that waited, as in [Lift](lift.md).

The observation has the same form for teams of all sizes. `mates` is a set of seven
elements, one for each mate in the order of the ring, the others zeros. Each has: 1 for
its presence; 1 if the mate's number is higher, else -1 (the lower number goes first if
both have reached equally many goals); the share of the mate's goals that is left; and
where its tcp, elbow and goal are. Positions are in the frame of the robot's own base;
`goal` and `mates` are relative to its tcp.

The difficulty is teamwork. When two paths cross, the expert sends one arm first. If it
ignores others, it touches another arm in most episodes. Each goal is within reach of
another arm, too, so no team can divide the cell (`python benchmarks/reach.py`, 100
episodes of `default`):

| environment | gives way | looks at nobody | goals that others reach |
| --- | ---: | ---: | ---: |
| ReachPandas2-v0 | 100 % | 39 % | 100 % |
| ReachMixed3-v0 | 100 % | 40 % | 100 % |
| ReachPandas4-v0 | 100 % | 17 % | 100 % |
| ReachPandas8-v0 | 97 % | 5 % | 100 % |
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from operator import and_, or_
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import solve_pose
from collaborative_gym.objects.pedestal import pedestal
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.scene.contacts import depth_sensors
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import reach as player
from collaborative_gym.tasks.experts.reach import approach
from collaborative_gym.tasks.randomization import Randomization, presets
from collaborative_gym.tasks.registry import register_task, register_teams
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import LEVEL, Blocks, Kept, Task, TaskConfig, Terms

_STARTS = Randomization(target_position=0.15)

_HEIGHT = 0.75  # m, of the bases
_QUARTERS = 4
"""Places of a ring for fewer arms, too, whose neighbours would face each other."""

_AHEAD, _BACK = 0.5, 0.32
"""Shares of its reach from an arm to its place, and to where its tcp starts."""

_GAP, _OVER = 0.3, 0.65
"""Distance between the places of neighbours, in m, and how far on the way to its
neighbour's place an arm's goal is: an arm that has neighbours must cross their ways."""

_LOW, _HIGH = 0.32, 0.45
"""Heights of the places and of the starts above the bases, in m."""

_TIER = 0.09  # how far above or below their places neighbours meet, in m
_DRAWS = 12  # from how many places each goal is chosen


@dataclass(frozen=True)
class ReachConfig(TaskConfig):
    """Settings of Reach.

    Attributes:
      goals: how many each robot has.
      radius: distance of a tcp from its goal that counts as there, in m.
      at_rest: speed of a tcp below which it is at rest, in m/s.
      apart: distance between the goals of two robots, in m. The next goal is the first
        of 12 drawn places that is so far from the others' goals, or else the farthest.
    """

    goals: int = bounded(3, 1, 100)
    radius: float = bounded(0.05, 0.005, 0.2)
    at_rest: float = bounded(0.1, 0.001, 10.0)
    apart: float = bounded(0.2, 0.0, 1.0)


@dataclass(frozen=True)
class ReachFacts:
    """What Reach looks at, by agent; (num_envs, ...) each, in the world's frame."""

    joints: dict[str, Array]  # angles, in rad
    tcps: dict[str, tuple[Array, Array]]  # poses
    velocities: dict[str, Array]  # of the tcps, (num_envs, 3) in m/s
    elbows: dict[str, Array]  # places of the middle joints
    goals: dict[str, Array]  # places of the present goals, or of the last ones
    distance: dict[str, Array]  # from tcp to goal, in m
    nearer: dict[str, Array]  # by how much that fell in this step, in m
    reached: dict[str, Array]  # whether a goal has just been reached
    done: dict[str, Array]  # how many goals have been reached
    touches: dict[str, Array]  # whether the arm touches another one
    stage: Array  # share of all goals that have been reached
    idle: Array  # share of the arms that wait


class Reach(Task[ReachConfig, ReachFacts]):
    """Bring every hand to its goals in turn, and touch no other arm.

    Attributes:
      rests: by agent, where its tcp starts, (3,), in m.
      postures: by agent, joint angles in the middle of its goals, in rad.
    """

    robot_counts = range(2, 9)
    config_class = ReachConfig
    randomizations = presets(_STARTS)
    units: ClassVar[Mapping[str, str]] = {
        **{"distance": "m", "nearer": "m", "stage": "", "idle": ""}
    }
    coordination: ClassVar[Mapping[str, Kept]] = {"stage": "greatest", "idle": "mean"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "tcp": "m",
        "tcp velocity": "m/s",
        "goal": "m",
        "mates": "present; share; share; m",
    }
    expert = player.expert

    def mounts(self) -> tuple[Placement, ...]:
        """Return a ring, or a part of it, whose arms' places are equally far apart."""
        step, places = 2 * np.pi / max(len(self.agents), _QUARTERS), []
        angles, inner = step * np.arange(len(self.agents)), _GAP / 2 / np.sin(step / 2)
        for angle, robot in zip(angles, self.robots.values(), strict=True):
            far = inner + _AHEAD * robot.reach
            x, y = np.round([far * np.cos(angle), far * np.sin(angle)], 12).tolist()
            places.append(Placement((x, y, _HEIGHT), angle + np.pi))
        return tuple(places)

    def build(self, scene: Scene) -> None:
        places = self.placements
        for (agent, place), colour in zip(places.items(), teams.COLOURS, strict=False):
            robot = self.robots[agent]
            scene.add_robot(agent, robot, placement=place, stand=False, holds=0.02)
            x, y, height = place.position
            stand = pedestal(height, rgba=colour)
            scene.add(f"{agent}_stand", stand, position=(x, y, 0), quat=place.quat)
            middle = robot.joints[len(robot.joints) // 2]
            scene.spec.joint(f"{agent}/{middle}").parent.add_site(name=f"{agent}/elbow")
            scene.add_pose_sensor(f"{agent}/elbow", f"{agent}/elbow")
            scene.add_velocity_sensor(f"{agent}/tcp", f"{agent}/{robot.tcp}")
            scene.add_target(f"{agent} goal", self.config.radius, rgba=colour)
            scene.paint_hand(agent, colour)  # It hides the goal that it has reached.
        teams.add_team_camera(scene, places, below=0.1, tall=0.8)

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._frames = teams.Frames(self.placements)
        self.rests, self.postures, self.starts = {}, {}, {}
        own: list[np.ndarray] = []
        # Equal arms have equal angles, as each stands in front of its own place.
        found: dict[Robot, list[np.ndarray]] = {}
        for agent, arm in scene.arms.items():
            place, robot = self.placements[agent], arm.robot
            base = np.array(place.position)
            ahead = np.array([np.cos(place.yaw), np.sin(place.yaw), 0.0])
            rest = base + _BACK * robot.reach * ahead + (0.0, 0.0, _HIGH)
            own.append(base + _AHEAD * robot.reach * ahead + (0.0, 0.0, _LOW))
            if robot not in found:
                angles, found[robot] = np.array(robot.home), []
                for there in rest, own[-1]:
                    goal = there, approach((there - base) * LEVEL, robot.reach)
                    angles = solve_pose(sim.model, arm, goal=goal, start=angles)
                    found[robot].append(angles)
            self.rests[agent] = rest
            self.starts[agent], self.postures[agent] = found[robot]
            scene.postures[agent] = self.postures[agent]
        # Neighbours turn to each other, one above the other, and then to those on
        # their other sides.
        count, self._nominal = len(own), {}
        for i, agent in enumerate(self.agents):
            steps = (-1) ** (i + np.arange(self.config.goals))
            mates = i + steps
            if 2 < count < _QUARTERS:  # The ends of the row then stay at home.
                mates = np.where((mates < 0) | (mates >= count), i, mates)
            over = _OVER * (np.array(own)[mates % count] - own[i])
            self._nominal[agent] = own[i] + over + (0.0, 0.0, (-1) ** i * _TIER)
        sensors = depth_sensors(sim.model)["arms"]
        self._depths = sim.model.sensor_adr[sensors]

    def remember(self, num_envs: int) -> dict[str, Array]:
        xp, count = self.xp, len(self.agents)
        zero = xp.zeros((num_envs, count), dtype=xp.float64)
        shape = num_envs, count, self.config.goals, _DRAWS, 3
        # Where goals may be, how many have been reached before this step, which one is
        # reached in it, and the distances when it began.
        return {
            "places": xp.zeros(shape, dtype=xp.float64),
            **{name: zero + 0.0 for name in ("done", "reached", "before")},
        }

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        self.start_arms(sim, env_ids, rng=rng, angles=self.starts)
        bound = self.config.randomization.target_position
        shape = self.config.goals, _DRAWS, 3
        goals: list[np.ndarray] = []
        for i, agent in enumerate(self.agents):
            drawn = self._nominal[agent][:, None] + rng.within(bound, shape)
            sim.memory["places"][env_ids, i] = sim.xp.asarray(drawn)
            rests = [r for a, r in self.rests.items() if a != agent]
            goals.append(self._apart(drawn[:, 0], [*goals, *rests]))
            self.scene.place(sim, env_ids, name=f"{agent} goal", position=goals[-1])

    def _apart(self, drawn: Array, others: list[Array]) -> Array:
        """Return the first of drawn places that is apart from others, or the farthest.

        Drawn are (worlds, n, 3), the others (worlds, 3) or (3,).
        """
        if not others:
            return drawn[:, 0]
        xp = array_namespace(drawn)
        gaps = [math.distance(drawn, other[..., None, :]) for other in others]
        least = reduce(xp.minimum, gaps)
        enough = xp.where(least < self.config.apart, least, self.config.apart)
        return drawn[xp.arange(len(drawn)), xp.argmax(enough, axis=1)]

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        xp, memory, last = sim.xp, sim.memory, self.config.goals - 1
        done = memory["done"] + memory["reached"]
        goals = {agent: sim.pose(f"{agent} goal")[0] for agent in self.agents}
        is_next = (memory["reached"] > 0) & (done <= last)
        index = xp.astype(xp.where(done < last, done, last), xp.int64)
        before, worlds = [], xp.arange(sim.num_envs)
        for i, agent in enumerate(self.agents):
            if xp.any(is_next[:, i]):
                drawn = memory["places"][worlds, i, index[:, i]]
                others = [goal for name, goal in goals.items() if name != agent]
                others += [xp.asarray(r) for a, r in self.rests.items() if a != agent]
                place = self._apart(drawn, others)
                goals[agent] = xp.where(is_next[:, i : i + 1], place, goals[agent])
                everywhere = np.arange(sim.num_envs)
                name, place = f"{agent} goal", goals[agent]
                self.scene.place(sim, everywhere, name=name, position=place)
            tcp = sim.pose(f"{agent}/tcp")[0]
            before.append(math.distance(tcp, goals[agent]))
        memory["done"], memory["before"] = done, xp.stack(before, axis=1)

    def measure(self, sim: Sim) -> ReachFacts:
        xp, memory, config = sim.xp, sim.memory, self.config
        tcps = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        goals = {agent: sim.pose(f"{agent} goal")[0] for agent in self.agents}
        speeds = {agent: sim.velocity(f"{agent}/tcp")[0] for agent in self.agents}
        far, nearer, reached, done = {}, {}, {}, {}
        for i, agent in enumerate(self.agents):
            far[agent] = math.distance(tcps[agent][0], goals[agent])
            nearer[agent] = memory["before"][:, i] - far[agent]
            is_still = math.norm(speeds[agent]) < config.at_rest
            is_there = (far[agent] < config.radius) & is_still
            reached[agent] = is_there & (memory["done"][:, i] < config.goals)
            done[agent] = memory["done"][:, i] + reached[agent]
        rows = [xp.astype(own, xp.float64) for own in reached.values()]
        memory["reached"] = xp.stack(rows, axis=1)
        return ReachFacts(
            joints=self.joints(sim),
            tcps=tcps,
            velocities=speeds,
            elbows={agent: sim.pose(f"{agent}/elbow")[0] for agent in self.agents},
            goals=goals,
            distance=far,
            nearer=nearer,
            reached=reached,
            done=done,
            touches=self._touches(sim),
            stage=xp.mean(xp.stack(list(done.values())), axis=0) / config.goals,
            idle=self.share_idle(sim),
        )

    def _touches(self, sim: Sim) -> dict[str, Array]:
        pairs = list(combinations(self.agents, 2))
        deep = sim.sensordata[:, self._depths] < 0.0
        return {
            agent: reduce(or_, (deep[:, i] for i, p in enumerate(pairs) if agent in p))
            for agent in self.agents
        }

    def observe(self, facts: ReachFacts) -> dict[str, Blocks]:
        seen, own = {}, self._frames
        for agent in self.agents:
            tcp = facts.tcps[agent][0]
            seen[agent] = {
                "joints": facts.joints[agent],
                "tcp": own.place(agent, tcp),
                "tcp velocity": own.direction(agent, facts.velocities[agent]),
                "goal": own.direction(agent, facts.goals[agent] - tcp),
                "goals left": self._left(facts, agent),
                "mates": self._mates(agent, facts),
            }
        return seen

    def _mates(self, agent: str, facts: ReachFacts) -> Array:
        """Return seat, goals left, and places of tcp, elbow and goal of each mate.

        They are (num_envs, 7, 12); see `mates_block`.
        """
        tcp, mates = facts.tcps[agent][0], teams.mates_of(self.agents, agent)
        places = [
            place - tcp
            for mate in mates
            for place in (facts.tcps[mate][0], facts.elbows[mate], facts.goals[mate])
        ]
        turned = self._frames.directions(agent, places)
        xp, rows = array_namespace(tcp), []
        for i, mate in enumerate(mates):
            left = self._left(facts, mate)
            after = 0.0 * left + np.sign(teams.away(self.agents, agent, mate))
            rows.append(xp.concat([after, left, *turned[3 * i : 3 * i + 3]], axis=1))
        return teams.mates_block(rows)

    def _left(self, facts: ReachFacts, agent: str) -> Array:
        """Return the share of an agent's goals that are left, (num_envs, 1)."""
        return (1.0 - facts.done[agent] / self.config.goals)[:, None]

    def reward(self, facts: ReachFacts, commands: Commands) -> dict[str, Terms]:
        terms, goals = {}, self.config.goals
        for agent in self.agents:
            reached, done = facts.reached[agent], facts.done[agent]
            xp = array_namespace(done)
            # A robot has a goal if it had one when the step began.
            has_goal = reached | (done < goals)
            terms[agent] = {
                "distance": xp.where(has_goal, 10.0 * facts.nearer[agent], 0.0),
                "goal": xp.where(reached, 5.0, 0.0),
                "touch": xp.where(facts.touches[agent], -20.0, 0.0),
                "effort": -0.01 * math.norm(commands[agent].moves),
            }
        return terms

    def success(self, facts: ReachFacts) -> Array:
        done = facts.done.values()
        finished = reduce(and_, (own >= self.config.goals for own in done))
        return finished & ~reduce(or_, facts.touches.values())

    def shortfall(self, facts: ReachFacts) -> Array:
        xp, goals = array_namespace(*facts.done.values()), self.config.goals
        missing = 0.0
        for agent in self.agents:
            left = goals - facts.done[agent]
            # What a goal counts beside a metre is our choice.
            missing = missing + left + xp.where(left > 0, facts.distance[agent], 0.0)
        missing = missing / (goals * len(self.agents))
        touches = reduce(or_, facts.touches.values())
        return xp.where(self.success(facts), 0.0, missing + xp.where(touches, 1.0, 0.0))

    def over(self, facts: ReachFacts) -> Array:
        return self.success(facts) | reduce(or_, facts.touches.values())


register_task("Reach", Reach)
register_teams("Reach", Reach, pandas=[2, 4, 8])
