"""Hockey: air hockey between two arms, or between two pairs.

Each side stands behind its goal and plays with mallets. The puck glides without
friction. The field is 1.1 m long and 0.64 m wide, and a goal is 0.4 m wide. A goal
counts once the whole puck has crossed the goal line, whoever hit it last. Then the puck
is served from the centre line towards the side that conceded the goal. If the puck
stays on one half for 15 s, this is a foul, even if nobody can reach the puck. Then the
puck is served to the other side. Serves start where no mallet is in the way.

Agents: one or two arms per side; `side_1` is at negative x. With two arms per side, the
table is twice as wide, and each arm reaches its half of it.

Randomized: the side that gets the first serve; the position of every serve on the
centre line, and its speed (0.3 to 0.7 m/s towards the side, up to 0.3 m/s across);
where each mallet starts along x and y, and the posture in which its arm holds it.
Inverse kinematics finds the start angles from the nominal ones plus noise.

Each side observes the world in its own frame, in which it plays towards +x. The other
side's frame is rotated by half a turn. The seats are therefore alike, and one policy
plays in both. `clock` is how long the puck has been on a half, above 0 on the others'.

Reward of each agent:

- `goal`: 10 for a goal of its side, -10 for a goal of the other side. The sum over both
  sides is zero.
- `drive`: 0.2 times the puck's speed towards the other goal, at most 2 m/s either way
  (shaping).
- `near`: -0.3 times the distance between puck and mallet in m, while the puck is on the
  agent's half, else 0 (shaping).
- `height`: -2 times the distance of the mallet from its hovering height, at most 0.3 m
  (shaping).
- `upright`: -0.3 (1 - cos a), where a is the tilt of the mallet (shaping).
- `effort`: -0.01 times the length of the action; in other action modes, of what it asks
  of the joints (shaping).

Success of a side: it scores. Its completion says whether it scored in the episode; its
performance is the share of the episode in which it led. The metric `score` counts its
goals. The side with more goals at the end wins.

An episode lasts 40 s. In this time, most matches of the expert against itself are
decided: of 1,696 with Pandas, side_1 won 528 and side_2 491, so side_1 won 49 to 55 %
of the decided ones.

An object that bounces reverses its direction within one physics step and keeps 0.8 of
its speed. Before that, it may enter the other object as far as it moves in 0.01 s. Air
drag takes some of the speed, and so does the arm behind a mallet. The table has the
speed after a bounce divided by the speed before, and the depth (`python
benchmarks/hockey.py --worlds 8 --steps 60`):

| m/s | off a cushion | off a mallet that is held | deepest, mm |
| ---: | ---: | ---: | ---: |
| 0.2 | 0.80 | 0.76 | 2 |
| 1 | 0.80 | 0.76 | 10 |
| 3 | 0.78 | 0.74 | 28 |
| 5 | 0.79 | 0.74 | 47 |

Above 5 m/s, MuJoCo's speculative contacts keep things from passing through one another.
Arms that chase the puck at full speed, whatever is in their way, give it 5 m/s. None of
144 shots at 3 to 7 m/s left the table. Unlike the other tasks, Hockey needs MuJoCo's
integrator `implicitfast` for this. The puck collides as a sphere that is taller than
the disc in the picture, so a mallet lifted by less than 0.1 m still touches it.

No term asks a player to be gentle. The shipped baseline, from a league, drives mallets
into cushions and the table: the hardest contact of an episode is 12 kN on average and
21 kN at worst, and a physics step applies up to 14 times a motor's limit (`python
benchmarks/strain.py HockeyPandas-v0`). The scripted player: below 0.5 kN and 2 times.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import Chart, hold
from collaborative_gym.objects.mallet import GRIP, mallet
from collaborative_gym.objects.mallet import HEIGHT as MALLET_HEIGHT
from collaborative_gym.objects.mallet import RADIUS as MALLET
from collaborative_gym.objects.puck import RADIUS as PUCK
from collaborative_gym.objects.puck import puck
from collaborative_gym.objects.rink import HALF_LENGTH, HEIGHT, MOUNT, rink
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.experts import hockey as player
from collaborative_gym.tasks.experts.hockey import AREA_MIDDLE, AREA_SIZE, HOVER
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import Blocks, Task, TaskConfig, Terms
from collaborative_gym.timing import SIM_DT

_LANE = 0.64  # m, width of the table for each arm of a side
_HALF_GOAL = 0.2  # m, likewise
_BEHIND_GOAL = 0.2  # m, from a goal's line to the arms
_START = np.array([-0.38, 0.0])  # m, where a mallet starts in its lane
_SERVES = 64  # drawn for an episode; then they begin anew
_SLOWEST, _QUICKEST, _ACROSS = 0.3, 0.7, 0.3  # m/s
_PLACES = 3  # on the centre line, from which a serve takes the first that is free
_CLEAR = PUCK + MALLET + 0.02  # m from a mallet, where a place is free
_DOWN = np.array([0.0, 0.0, -1.0])
_COLOURS = {"red": (0.85, 0.18, 0.16, 1.0), "blue": (0.15, 0.35, 0.85, 1.0)}


@dataclass(frozen=True)
class HockeyConfig(TaskConfig):
    """Settings of Hockey.

    Attributes:
      max_episode_steps: control steps of an episode.
      restitution: speed of the puck after a bounce over that before it.
      foul_after: how long the puck may be on one half, in s.
    """

    max_episode_steps: int = 400
    restitution: float = bounded(0.8, 0.0, 1.0)
    foul_after: float = bounded(15.0, 0.1, 1e6)


@dataclass(frozen=True)
class HockeyFacts:
    """Facts of Hockey, in the frame of the table, whose origin is on the ice."""

    joints: dict[str, Array]  # angles by agent, (num_envs, joints), in rad
    joint_speeds: dict[str, Array]  # likewise, in rad/s
    mallet: dict[str, tuple[Array, Array]]  # place of its lower face, and quaternion
    puck: Array  # (num_envs, 2) in m
    puck_velocity: Array  # (num_envs, 2) in m/s
    goal: Array  # (num_envs,) 1 where side_1 has just scored, -1 where side_2 has
    half: Array  # (num_envs,) -1 where the puck is on the half of side_1, else 1
    clock: Array  # (num_envs,) how long it has been there, in s
    lead: Array  # (num_envs,) goals of side_1 less those of side_2


class Hockey(Task[HockeyConfig, HockeyFacts]):
    """Score more goals than the other side.

    Attributes:
      charts: by agent, joint angles with which the mallet hovers over its lane.
    """

    robot_counts = (2, 4)
    config_class = HockeyConfig
    performance_from_start = True
    expert = player.expert
    colours = tuple(_COLOURS)
    units: ClassVar[Mapping[str, str]] = {"clock": "s"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "joint speeds": "rad/s",
        "mallet": "m",
        "puck": "m",
        **{"puck velocity": "m/s", "clock": "s"},
    }

    @property
    def sides(self) -> tuple[tuple[str, ...], ...]:
        half = len(self.agents) // 2
        return self.agents[:half], self.agents[half:]

    @property
    def turns(self) -> dict[str, float]:
        """1 where an agent's frame is the table's, -1 where it is turned round."""
        return dict.fromkeys(self.sides[0], 1.0) | dict.fromkeys(self.sides[1], -1.0)

    @property
    def lanes(self) -> dict[str, float]:
        """The y of each agent's lane, in its own frame, in m."""
        count = len(self.sides[0])
        lanes = _LANE * (np.arange(count) - (count - 1) / 2)
        return dict(zip(self.agents, np.tile(lanes, 2), strict=True))

    @property
    def half_sizes(self) -> tuple[float, float]:
        """Half of the table's width and half of a goal's, in m."""
        count = len(self.sides[0])
        return count * _LANE / 2, count * _HALF_GOAL

    def mounts(self) -> tuple[Placement, ...]:
        """Return blocks behind the goals, facing each other."""
        x, z = HALF_LENGTH + _BEHIND_GOAL, HEIGHT + MOUNT
        lanes = self.lanes
        return tuple(
            Placement((-way * x, way * lanes[agent], z), 0.0 if way > 0 else np.pi)
            for agent, way in self.turns.items()
        )

    def build(self, scene: Scene) -> None:
        for agent, placement in self.placements.items():
            robot = self.robots[agent]
            scene.add_robot(agent, robot, placement=placement, holds=GRIP, stand=False)
            colour = _COLOURS[self.colours[self.turns[agent] < 0]]
            scene.paint_hand(agent, colour)
            scene.add_tool(agent, "mallet", child=mallet(colour))
            scene.add_pose_sensor(f"{agent} mallet", f"{agent}/mallet/mallet")
        ice, (half_width, half_goal) = (0.0, 0.0, HEIGHT), self.half_sizes
        blocks = [placement.position[:2] for placement in self.placements.values()]
        table = rink(half_width, half_goal, mounts=blocks)
        scene.add("rink", table, position=ice)
        scene.add("puck", puck(self.config.restitution), position=ice)
        scene.spec.add_exclude(bodyname1="puck/puck", bodyname2="rink/lintels")
        scene.add_pose_sensor("puck", "puck/puck")
        scene.add_velocity_sensor("puck", "puck/puck")
        # Its contacts turn the puck round within a step; `discrete` would stop it.
        scene.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        scene.spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SPECULATIVE
        far = 0.82 + 0.6 * half_width
        eye = 0, -1.27 * far, HEIGHT + 0.14 + 1.3 * far
        scene.add_camera(eye, (1, 0, 0, 0, 0.71, 0.7))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        model = sim.model
        self.charts = {}
        for agent, arm in scene.arms.items():
            edges = np.diag(self.turns[agent] * AREA_SIZE)
            middle, along = (
                self._hand(agent, AREA_MIDDLE),
                np.pad(edges, [(0, 0), (0, 1)]),
            )
            chart = Chart(model, arm, middle=middle, along=along, approach=_DOWN)
            self.charts[agent] = chart
        joints = [model.joint(f"puck/{axis}") for axis in "xy"]
        self._place = [int(joint.qposadr[0]) for joint in joints]
        self._speed = [int(joint.dofadr[0]) for joint in joints]

    def _hand(self, agent: str, place: np.ndarray) -> np.ndarray:
        """Return where a tcp is if its mallet hovers at places (..., 2) of its lane."""
        flat = self.turns[agent] * (place + np.array([0.0, self.lanes[agent]]))
        height = np.full((*flat.shape[:-1], 1), HEIGHT + HOVER + MALLET_HEIGHT)
        return np.concatenate([flat, height], axis=-1)

    def remember(self, num_envs: int) -> dict[str, Array]:
        xp = self.xp
        # Serves: places in the frame of the side that receives, speeds along and
        # across. The half on which the puck is, and since when. What the referee has
        # seen: a goal of either side, and to whom to serve (1 towards +x), if at all.
        zero = xp.zeros(num_envs, dtype=xp.float64)
        names = ("served", "half", "since", "lead", "goal", "call")
        serves = xp.zeros((num_envs, _SERVES, _PLACES + 2), dtype=xp.float64)
        return {"serves": serves, **{name: zero + 0.0 for name in names}}

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        bounds, memory, xp = self.config.randomization, sim.memory, sim.xp
        goals, near = [], []
        for agent, arm in self.scene.arms.items():
            place = _START + rng.within(bounds.object_position, 2)
            angles = self.charts[agent].at((place - AREA_MIDDLE) / AREA_SIZE)
            near.append(angles + rng.within(bounds.joint_noise, arm.num_joints))
            goals.append((self._hand(agent, place), _DOWN))
        found, _ = hold(self.chains, goals, near=near)
        for agent, angles in zip(self.agents, found, strict=True):
            self.scene.bend(sim, env_ids, agent=agent, angles=angles)
        wide = self.half_sizes[0] - 2 * PUCK
        low = [-wide] * _PLACES + [_SLOWEST, -_ACROSS]
        high = [wide] * _PLACES + [_QUICKEST, _ACROSS]
        serves = rng.uniform(low, high, (_SERVES, _PLACES + 2))
        first = np.where(rng.uniform(-1.0, 1.0) < 0.0, -1.0, 1.0)
        memory["serves"][env_ids] = xp.asarray(serves)
        memory["served"][env_ids] = 1.0
        memory["half"][env_ids] = xp.asarray(first)
        start = first[:, None] * serves[:, 0]
        sim.qpos[env_ids, self._place[1]] = xp.asarray(start[:, 0])
        for column, speed in zip((_PLACES, _PLACES + 1), self._speed, strict=True):
            sim.qvel[env_ids, speed] = xp.asarray(start[:, column])

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        xp, memory, to = sim.xp, sim.memory, sim.memory["call"]
        is_called = to != 0
        if not xp.any(is_called):
            return
        worlds = xp.arange(sim.num_envs)
        number = xp.astype(memory["served"], xp.int64) % _SERVES
        serve = to[:, None] * memory["serves"][worlds, number]
        places = serve[:, :_PLACES]
        is_free = places == places
        for agent in self.agents:
            mallet = sim.pose(f"{agent} mallet")[0]
            away = mallet[:, :1] ** 2 + (places - mallet[:, 1:2]) ** 2
            is_free = is_free & (away > _CLEAR**2)
        chosen = xp.argmax(xp.astype(is_free, xp.int64), axis=1)
        x, y = self._place
        sim.qpos[:, x] = xp.where(is_called, 0.0, sim.qpos[:, x])
        sim.qpos[:, y] = xp.where(is_called, places[worlds, chosen], sim.qpos[:, y])
        for column, speed in zip((_PLACES, _PLACES + 1), self._speed, strict=True):
            before = sim.qvel[:, speed]
            sim.qvel[:, speed] = xp.where(is_called, serve[:, column], before)
        memory["served"] = memory["served"] + is_called
        memory["half"] = xp.where(is_called, to, memory["half"])
        memory["since"] = xp.where(is_called, sim.time, memory["since"])
        memory["lead"] = memory["lead"] + xp.where(is_called, memory["goal"], 0.0)

    def measure(self, sim: Sim) -> HockeyFacts:
        xp, memory, ice = sim.xp, sim.memory, sim.xp.asarray([0.0, 0.0, HEIGHT])
        puck = sim.pose("puck")[0][:, :2]
        x, before = puck[:, 0], memory["half"]
        half = xp.where(x == 0.0, before, xp.sign(x))
        since = xp.where(half == before, memory["since"], sim.time)
        clock = sim.time - since
        goal = xp.where(xp.abs(x) > HALF_LENGTH + PUCK, half, 0.0)
        # Times are sums of physics steps, and so are rounded.
        is_foul = clock > self.config.foul_after - SIM_DT / 2
        call = xp.where(goal == 0.0, xp.where(is_foul, -half, 0.0), goal)
        memory |= {"half": half, "since": since, "goal": goal, "call": call}
        mallets, speeds = {}, {}
        for agent, arm in self.scene.arms.items():
            place, quat = sim.pose(f"{agent} mallet")
            mallets[agent] = place - ice, quat
            speeds[agent] = xp.asarray(sim.qvel[:, arm.dof], copy=True)
        return HockeyFacts(
            joints=self.joints(sim),
            joint_speeds=speeds,
            mallet=mallets,
            puck=puck,
            puck_velocity=sim.velocity("puck")[0][:, :2],
            goal=goal + 0.0,
            half=half + 0.0,
            clock=clock,
            lead=memory["lead"] + goal,
        )

    def observe(self, facts: HockeyFacts) -> dict[str, Blocks]:
        xp, seen = array_namespace(facts.puck), {}
        for agent, way in self.turns.items():
            turn = xp.asarray([way, way, 1.0])
            place, quat = facts.mallet[agent]
            # Those of the own side first.
            own, other = self.sides if way > 0 else self.sides[::-1]
            others = [facts.mallet[a][0] for a in (*own, *other) if a != agent]
            seen[agent] = {
                "joints": facts.joints[agent],
                "joint speeds": facts.joint_speeds[agent],
                "mallet": turn * place,
                "mallet axis": turn * math.axis_z(quat),
                "puck": way * facts.puck,
                "puck velocity": way * facts.puck_velocity,
                **{f"mallet {i + 1}": way * x[:, :2] for i, x in enumerate(others)},
                # How near a foul is; below 0 where it would be the own side's.
                "clock": (way * facts.half * facts.clock)[:, None]
                / self.config.foul_after,
            }
        return seen

    def reward(self, facts: HockeyFacts, commands: Commands) -> dict[str, Terms]:
        xp, terms = array_namespace(facts.puck), {}
        for agent, way in self.turns.items():
            place, quat = facts.mallet[agent]
            far = math.distance(place[:, :2], facts.puck)
            speed = way * facts.puck_velocity[:, 0]
            height = xp.abs(place[:, 2] - HOVER)
            speed = xp.minimum(xp.maximum(speed, -2.0 + 0 * speed), 2.0 + 0 * speed)
            terms[agent] = {
                "goal": 10.0 * way * facts.goal,
                "drive": 0.2 * speed,
                "near": xp.where(way * facts.half < 0.0, -0.3 * far, 0.0),
                "height": -2.0 * xp.where(height < 0.3, height, 0.3),
                "upright": -0.3 * (1.0 + math.axis_z(quat)[:, 2]),
                "effort": -0.01 * math.norm(commands[agent].moves),
            }
        return terms

    def score(self, facts: HockeyFacts) -> tuple[Array, ...]:
        xp = array_namespace(facts.goal)
        return tuple(xp.where(scored, 1.0, 0.0) for scored in self.success(facts))

    def success(self, facts: HockeyFacts) -> tuple[Array, ...]:
        return facts.goal > 0.0, facts.goal < 0.0

    def performing(self, facts: HockeyFacts) -> tuple[Array, ...]:
        return facts.lead > 0.0, facts.lead < 0.0


register_task("Hockey", Hockey)
register_env(EnvSpec("HockeyPandas-v0", Hockey, ("panda", "panda")))
register_env(EnvSpec("HockeySawyers-v0", Hockey, ("sawyer", "sawyer")))
register_env(EnvSpec("HockeyPandaSawyer-v0", Hockey, ("panda", "sawyer")))
register_env(EnvSpec("HockeyDoubles-v0", Hockey, ("panda",) * 4))
