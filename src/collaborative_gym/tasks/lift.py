"""Lift: two to eight robots lift a pot that needs all of them.

The pot stands on a table between the robots. Each robot grips its handle. Together they
lift the pot to a target above the table and keep it level.

Agents: with two arms, `robot_1` stands at -y and takes the handle at -y, and `robot_2`
stands at +y and takes the other. Both observe everything, unless `egocentric` is set.
Larger teams stand evenly around a round pot, `robot_1` at -y and the others
counterclockwise. Each of their robots observes its own arm, its handle (turned as if it
were the first) and the vector from the pot to the target, in the frame of its own base.
For each mate, the block `mates` has: whether there is one, whether it grips, the
distance from its tool centre point to its handle, and how far its handle is above the
robot's own. The observation has the same form in every seat and team size.

Randomized: the arms' start, the pot's position and turn on the table, the target.

Reward of each agent:

- `reach`: minus the distance from its tool centre point to its handle, in m.
- `lift`: -2 times the distance from the pot's middle to the target, in m.
- `tilt`: -0.2 (|roll| + |pitch|) of the pot, in rad.
- `effort`: minus 0.01 times the Euclidean norm of its joints' part of the action; in
  other action modes, of what the action asks of the joints.
- `grip`: 0.1 while it asks for a grip within `picking_threshold` (0.03 m) of its
  handle, else 0.

Success: the pot's middle is within 0.15 m of the target, level within 15 degrees and
slower than 0.3 m/s, while both arms grip it. With three or more arms: within 0.08 m and
4 degrees, while all arms grip it.

Coordination, until success: `stage` is the greatest share of arms that gripped. `idle`
is the mean share of arms that waited, with an empty hand and no joint faster than 2 %
of its limit. `handle_spread` is the greatest difference of the handles' heights, in m.

The pot's mass depends on the arms, so that the pot is too heavy once any one of them
is missing. `lift_mass` and `team_mass` compute the mass, and
`benchmarks/lift_capacity.py` measures it in simulation for two arms. The distance alone
is not enough for success: one of two arms can swing the pot past the target while the
other only holds its handle. But then the pot is tilted or fast. The larger a team, the
less it needs each arm. The pot's mass is the geometric mean of two loads: what all arms
carry level, and what the best team without one arm carries. It is at least 0.6 of the
first load:

| Pandas | all carry | all but one | all / all but one | at best | pot |
| --- | --- | --- | --- | --- | --- |
| 3 | 51 kg | 0 kg | | | 31 kg |
| 4 | 69 kg | 40 kg | 1.69 | 2.00 | 53 kg |
| 6 | 103 kg | 80 kg | 1.29 | 1.50 | 91 kg |
| 8 | 137 kg | 119 kg | 1.15 | 1.33 | 128 kg |

"At best" is the ratio for arms that carry the same everywhere. The expert never
succeeds if one arm is idle, gripping or limp, or stops once it holds its handle
(`benchmarks/teams.py --faults`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.errors import check_numbers
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import solve_pose, strength, turn_fingers
from collaborative_gym.motion.lift_mass import weigh
from collaborative_gym.motion.team_mass import spread, weigh_team
from collaborative_gym.objects.pot import (
    HANDLE_WIDTH,
    bar_directions,
    grip_radius,
    handle_directions,
    handle_places,
    pot,
    ring_pot,
)
from collaborative_gym.objects.table import round_table, table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import lift as player
from collaborative_gym.tasks.experts.lift import START
from collaborative_gym.tasks.holding import start_holding
from collaborative_gym.tasks.randomization import Randomization, presets
from collaborative_gym.tasks.registry import (
    EnvSpec,
    register_env,
    register_task,
    register_teams,
)
from collaborative_gym.tasks.settings import bounded, filled
from collaborative_gym.tasks.task import (
    LEVEL,
    Blocks,
    Kept,
    Task,
    TaskConfig,
    Terms,
    columns,
)

_TABLE_HEIGHT = 0.64  # m
_STANDOFF = 0.12  # m from the handle, against the approach, where an arm starts
_LEAST_MISS, _FARTHEST_MISS = 1.25, 0.1  # of the distance of a grip; m
_NEAREST, _FARTHEST = 0.36, 0.85  # from an arm to its handle, as shares of its reach
_BEYOND = 0.03  # m by which an arm reaches farther than its handle, if pots are moved
_HEIGHT = 0.45  # m from the lowest base up to the target

_SUCCESS = {2: (0.15, float(np.radians(15.0)))}
"""Radius in m and tilt in rad within which a pot is there and level, by arms."""

_TEAM_SUCCESS = 0.08, float(np.radians(4.0))
"""Those of larger teams. Within more, all arms but one could have the pot there."""


@dataclass(frozen=True)
class LiftConfig(TaskConfig):
    """Settings of Lift.

    Attributes:
      target: where the pot is to go, in m, or None for the task's rule.
      pot_mass: in kg, or None for the task's rule.
      success_radius: distance to the target that counts as there, in m; None for 0.15
        with two arms and 0.08 with more.
      success_tilt: tilt of the pot that counts as level, in rad; None for 15 degrees
        with two arms and 4 with more.
      success_speed: speed of the pot that counts as slow, in m/s.
      picking_threshold: greatest distance at which a grip starts, in m.
      egocentric: whether each robot sees its own handle and its mates in the frame of
        its own base; None for False with two arms and True with more.
    """

    target: tuple[float, float, float] | None = None
    pot_mass: float | None = bounded(None, 0.01, 1000.0)
    success_radius: float = bounded(None, 0.001, 10.0)
    success_tilt: float = bounded(None, 0.001, 1.5)
    success_speed: float = bounded(0.3, 0.001, 100.0)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)
    egocentric: bool | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.target is not None:
            target = check_numbers("target", self.target, 3)
            object.__setattr__(self, "target", target)


@dataclass(frozen=True)
class LiftFacts:
    """Facts of Lift, (num_envs, ...) each; poses as in `Sim`."""

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
    stage: Array  # share of the arms that grip
    idle: Array  # share of the arms that wait
    handle_spread: Array  # from the lowest handle's height to the highest, in m


class Lift(Task[LiftConfig, LiftFacts]):
    """Lift a pot that needs all arms to a target, and keep it level.

    Attributes:
      target: nominal place of the target, (3,).
      handles: from the pot's middle to the handle of each agent, (agents, 3), in m.
      pot_mass: in kg.
      weighing: what the arms can carry, all of them and without each.
      ways: by agent, how the arm lifts its handle to the target.
    """

    robot_counts = range(2, teams.MOST_MATES + 2)
    gripping = True
    randomizations = presets(Randomization(joint_noise=0.12))
    units: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("to_handle", "to_target", "handle_spread"), "m"),
        **{"tilt": "rad", "speed": "m/s"},
    }
    coordination: ClassVar[Mapping[str, Kept]] = {
        "stage": "greatest",
        "idle": "mean",
        "handle_spread": "greatest",
    }
    block_units: ClassVar[Mapping[str, str]] = {
        **{"joints": "rad", "target": "m", "to_target": "m"},
        **dict.fromkeys(("handle", "tcp", "pot"), POSE),
    }
    styles = player.STYLES
    expert, styled = player.expert, player.styled
    config_class = LiftConfig

    def _take(self, config: LiftConfig) -> None:
        count = len(self.agents)
        radius, tilt = _SUCCESS.get(count, _TEAM_SUCCESS)
        own = {"success_radius": radius, "success_tilt": tilt, "egocentric": count > 2}
        super()._take(filled(config, **own))
        self.handles = handle_places(count)

    def mounts(self) -> tuple[Placement, ...]:
        """Return arms around the pot that face it, the weaker ones nearer.

        Two arms are put where they can carry the same, as far as their reach allows:
        what an arm can carry falls about as one over its distance. Larger teams stand
        where each arm is needed most, which `spread` searches.
        """
        heights = tuple(
            robot.base_height if robot.stand == "pedestal" else _TABLE_HEIGHT
            for robot in self.robots.values()
        )
        radius = grip_radius(len(heights))
        return teams.around([far + radius for far in self._distances(heights)], heights)

    def _distances(self, heights: tuple[float, ...]) -> tuple[float, ...]:
        """Return how far the arms stand from their handles, in m."""
        robots = tuple(self.robots.values())
        if len(robots) > 2:
            ends = START[2], self._target(min(heights))[2]
            start, end = (z + self.handles[0, 2] for z in ends)
            radius = self.config.success_radius
            return spread(robots, heights, start=start, end=end, radius=radius)
        strengths = [strength(robot) for robot in robots]
        least, most = min(strengths), max(strengths)
        far = min(_FARTHEST, 0.8 * (most / least) ** 0.5)
        shares = (max(_NEAREST, far * own / most) for own in strengths)
        pairs = zip(shares, robots, strict=True)
        return tuple(share * robot.reach for share, robot in pairs)

    def _target(self, lowest: float) -> np.ndarray:
        return np.array(self.config.target or (0.0, 0.0, lowest + _HEIGHT))

    def build(self, scene: Scene) -> None:
        if scene.grasp.touches:
            raise ValueError("Lift's handles collide with nothing; give grasp='pinch'")
        self._weigh(scene)
        self._frames = teams.Frames(self.placements)
        self._spins = teams.seat_turns(self.placements)
        self._add_arms(scene)
        (x, y), count = self.weighing.centre, len(self.agents)
        if count == 2:
            scene.add("table", table())
            scene.add("pot", pot(self.pot_mass, y), position=START)
        else:
            scene.add("table", round_table(grip_radius(count) + 0.02))
            vessel = ring_pot(count, self.pot_mass, balance=(x, y))
            scene.add("pot", vessel, position=START)
        teams.add_team_camera(scene, self.placements, below=0.2 * (count == 2))
        scene.add_pose_sensor("pot", "pot/pot")
        scene.add_velocity_sensor("pot", "pot/pot")
        for agent, handle in self._handles.items():
            threshold = self.config.picking_threshold
            scene.add_grip(agent, handle, threshold=threshold, width=HANDLE_WIDTH)
        scene.add_target("target", self.config.success_radius)

    def _add_arms(self, scene: Scene) -> None:
        for i, (agent, placement) in enumerate(self.placements.items()):
            (x, y, z), robot = placement.position, self.robots[agent]
            own = robot.stand == "pedestal" or self.config.placements is not None
            scene.add_robot(agent, robot, placement=placement, stand=own)
            if len(self.agents) > 2:
                scene.paint_hand(agent, teams.COLOURS[(1, 3, 4, 7, 6, 0, 5, 2)[i]])
            if own:
                continue
            if len(self.agents) > 2:
                teams.add_stand(scene, agent, placement)
            elif abs(y) > 0.55:
                # Push the arm's table back to the pot's table, which it would overlap.
                place = (x, np.sign(y) * max(abs(y), 0.9), 0.0)
                turn = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
                scene.add(f"{agent}_stand", table(height=z), position=place, quat=turn)

    @property
    def _handles(self) -> dict[str, str]:
        return {agent: f"pot/handle_{i + 1}" for i, agent in enumerate(self.agents)}

    def _weigh(self, scene: Scene) -> None:
        """Find the target, the arms' ways to it and the mass of the pot."""
        placements = tuple(self.placements.values())
        self.target = self._target(min(place.position[2] for place in placements))
        reached = self.handles - _BEYOND * handle_directions(len(placements))
        team = tuple(self.robots.values()), placements
        where = {
            "ends": [(START + at, self.target + at) for at in reached],
            "target": self.target,
            "handles": self.handles,
            "radius": self.config.success_radius,
            "grasps": [scene.grasp.strength(r) for r in team[0]],
        }
        if len(placements) == 2:
            self.weighing = weigh(*team, **where)
        else:
            tilt = self.config.success_tilt
            self.weighing = weigh_team(*team, **where, tilt=tilt)
        given = self.config.pot_mass
        self.pot_mass = self.weighing.pot_mass if given is None else given
        self.ways = dict(zip(self.agents, self.weighing.ways, strict=True))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        model = sim.model
        self._start, self._bars = {}, bar_directions(len(self.agents))
        for i, (agent, arm) in enumerate(scene.arms.items()):
            way = self.ways[agent]
            angles = turn_fingers(model, arm, angles=way.angles, bar=self._bars[i])
            self.ways[agent] = replace(way, angles=angles)
            goal = START + self.handles[i] - _STANDOFF * way.approach, way.approach
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
        """All arms but one hold their handles, and it has missed its own by some cm."""
        agents, moves = self.agents, self.config.randomization.moves
        pot_moved = rng.within(moves * [1.0, 1.0, 0.0, 1.0], 4)
        misses = rng.uniform(0, len(agents)).astype(int)
        angle, least = rng.uniform(0, np.pi), self.config.picking_threshold
        least *= _LEAST_MISS
        far = rng.uniform(least, max(least, _FARTHEST_MISS))[:, None]
        # Along or above the bar; below it, fingers meet the table.
        along, up = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
        aside = far[:, None] * (along * self._bars + up * [0.0, 0.0, 1.0])
        misses = np.arange(len(agents)) == misses[:, None]
        missed = (misses[:, :, None] * aside).reshape(len(misses), -1)

        def grasps(moved: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
            place, quat = START + moved[:, :3], math.from_yaw(moved[:, 3])
            handles = place + math.rotate(quat, self.handles[:, None])
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
        self.scene.hands.hold(sim, sim.xp.asarray(~misses), env_ids)

    def measure(self, sim: Sim) -> LiftFacts:
        handles = {agent: sim.pose(site) for agent, site in self._handles.items()}
        tcps = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        pose, (target, _), xp = sim.pose("pot"), sim.pose("target"), sim.xp
        here, there = ([place for place, _ in x.values()] for x in (tcps, handles))
        # All distances at once, which takes hardly longer than one.
        here, there = xp.stack([*here, pose[0]]), xp.stack([*there, target])
        *to_handle, to_target = math.distance(here, there)
        roll, pitch = math.roll_pitch(pose[1])
        gripping = {agent: self.scene.holds(sim, agent) for agent in self.agents}
        grips = xp.stack(list(gripping.values()))
        spread = xp.max(there[:-1], axis=0) - xp.min(there[:-1], axis=0)
        return LiftFacts(
            joints=self.joints(sim),
            gripping=gripping,
            handles=handles,
            tcps=tcps,
            pot=pose,
            target=target,
            to_handle=dict(zip(self.agents, to_handle, strict=True)),
            to_target=to_target,
            tilt=xp.abs(roll) + xp.abs(pitch),
            speed=math.norm(sim.velocity("pot")[0]),
            stage=xp.mean(1.0 * grips, axis=0),
            idle=self.share_idle(sim, gripping.values()),
            handle_spread=spread[:, 2],
        )

    def observe(self, facts: LiftFacts) -> dict[str, Blocks]:
        xp = array_namespace(facts.target)
        kind = facts.target.dtype
        grips = {a: xp.astype(g, kind)[:, None] for a, g in facts.gripping.items()}
        if self.config.egocentric:
            return {a: self._seen_by(a, facts, grips) for a in self.agents}
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

    def _seen_by(self, agent: str, facts: LiftFacts, grips: dict[str, Array]) -> Blocks:
        """Return an agent's observation, in the frame of its base.

        Its own handle counts as the first, and mates are seen from there.
        """
        xp, frames = array_namespace(facts.target), self._frames
        place, turn = facts.handles[agent][0], facts.pot[1]
        spin = xp.asarray(self._spins[agent], dtype=turn.dtype)
        turn = math.multiply(turn, xp.broadcast_to(spin, turn.shape))
        rows = []
        for mate in teams.mates_of(self.agents, agent):
            gap, above = facts.to_handle[mate], facts.handles[mate][0] - place
            parts = [grips[mate], gap[:, None], above[:, 2:]]
            rows.append(xp.concat(parts, axis=1))
        return {
            "joints": teams.alike(facts.joints[agent]),
            "gripping": grips[agent],
            "tcp": math.pose(*frames.pose(agent, facts.tcps[agent])),
            "handle": math.pose(*frames.pose(agent, (place, turn))),
            "to_target": frames.direction(agent, facts.target - facts.pot[0]),
            "mates": teams.mates_block(rows),
        }

    def reward(self, facts: LiftFacts, commands: Commands) -> dict[str, Terms]:
        xp, terms = array_namespace(facts.to_target), {}
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
    "placements": teams.face_to_face((0.9, 0.9), (0.65, 0.6)),
    "target": (0.0, 0.0, 1.2),
    "picking_threshold": 0.04,
}
register_task("Lift", Lift)
register_env(EnvSpec("LiftTaskSawyers-v0", Lift, ("sawyer", "sawyer"), _SAWYERS))
register_env(EnvSpec("LiftTaskJacos-v0", Lift, ("jaco", "jaco"), _JACOS))
_TEAM = {"egocentric": True}
register_teams("Lift", Lift, pandas=(2, 3, 4, 6, 8), mixed=(3, 4), settings=_TEAM)
