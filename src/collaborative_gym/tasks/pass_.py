"""Pass: arms hand a cube on, from one to the next, and the last brings it to a target.

Two to eight arms stand side by side, each with a table. An arm on a pedestal has the
table in front of it; any other arm stands on the table's near end. The cube (0.04 m,
0.05 kg) lies on robot_1's table. A grip holds the cube's centre at the tool centre
point and lets the cube turn. For a moment, both robots may hold it. Then the giver must
let go: if the receiver tears the cube out of its hand, both lose it.

With two arms, the target hangs in the air in front of robot_2. Three or more arms form
a relay: the cube goes through all hands to its target on the last table. From four arms
on, a second cube follows, with its own target. Only neighbours reach each other, at one
place between them. In relays each arm observes, in its own base's frame: its own cube,
which is the one in its hand or else the first that it has not passed on; the vectors to
this cube, and from it to the hand-over or the target; the share of cubes left. For each
mate, the block `mates` has: whether there is one, its distance in seats divided by 7,
whether it grips, the vector from the arm's own tool centre point to the mate's, and the
mate's distance from the arm's cube. The robot observes each component x, in m, of the
vectors to cube and goal, and this distance, as log(1 + 100 |x|) with the sign of x. The
observation has the same form in every seat and relay.

Agents: `robot_1` picks the cube up and hands it over; the last arm takes it and carries
  it to the target; the arms between them take it and hand it on.

Randomized: the joints of the arms, the cubes' positions on the table (x and y) and
turns about the vertical, the targets' positions (in a relay, x and y).

Reward of each agent: the next arm is "near" while its tool centre point is within
`handover_threshold` (0.05 m) of the cube's centre. In a relay, "the cube" is the
agent's own cube, and distances are capped at 1 m. If this cube is already beyond the
next hand, the next arm counts as near, at a distance of 0.

- `reach`: minus the distance from its tool centre point to the cube, in m; 0.2 while
  the next arm is near.
- `handover` of all but the last: minus the distance from the next arm's tool centre
  point to the cube.
- `carry` of the last: minus the distance from the cube to the target, in m.
- `grip`: 0.1 while it asks for a grip within `handover_threshold` of the cube (robot_1:
  `picking_threshold`, 0.03 m); while the next arm is near, -0.1 if it asks for a grip;
  else 0.
- `effort`: minus 0.01 times the Euclidean norm of the joints' part of the action; in
  other action modes, of what the action asks of the joints.
- `success`: 1 while the goal is reached, else 0.
- `waiting`, where there are two cubes: -3 for each that waits behind the agent's own.

Success: with two arms, the cube is within `success_radius` of the target and robot_2
holds it. The thesis requires only the distance. The second condition prevents robot_1
from throwing the cube to the target, as a search once did. In every pair of Sawyer,
Panda and Jaco, robot_1 stays 0.27 m or more short of the target, and robot_2 stays 0.18
m short of robot_1's table.

In a relay, each cube must lie still within 0.06 m of its target, in no hand. Before
that, every arm must have held it, in order, and at the end of some control step
together with the arm before it. A cube thrown, or left on a table for the next arm,
does not count.

Coordination: `stage` is the share of hands that the cubes have been through; `idle` is
the mean share of arms that waited, as in [Lift](lift.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import quickest_way, safest_way
from collaborative_gym.objects.cube import cube
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import SHOULDER, Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import registry, teams
from collaborative_gym.tasks.experts import pass_ as player
from collaborative_gym.tasks.experts.pass_ import ACROSS, BEYOND, DOWN
from collaborative_gym.tasks.handing import (
    GIVING,
    PICKING,
    TAKING,
    Row,
    either_way,
    handed_on,
    of,
    own_thing,
    stand_in_row,
)
from collaborative_gym.tasks.randomization import Randomization, presets
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

_CUBE_SIZE = 0.04  # m
_GRIP_WIDTH = 0.05  # m; a cube turned by 15 degrees fits between the fingers
_SHORT_OF_MEETING = 1 / 3  # share of its way there, where robot_2 leaves robot_1 room
_ARMS_FOR_TWO = 4  # arms of a relay from which on two cubes are under way
_APART = 0.3  # m between two cubes, so that a hand has room beside the other one
_CLEAR = 0.4, 0.15  # m, of a lost cube from an arm's base, and from another cube
_COLOURS = (0.9, 0.45, 0.13, 1.0), (0.16, 0.47, 0.82, 1.0)  # of cubes, and of two goals
_HOVER = 0.15  # m above the targets, to where the last arm swings
_STEPS_PER_ARM = 60  # control steps; a Jaco turns with a cube in about 40
_AT_REST, _ON_TABLE = 0.05, 0.005  # m/s and m above it, of a cube that lies there
_BY_RULE: Any = None  # of a setting that the number of arms sets

_FARTHEST, _WAITING = 1.0, 3.0
"""Distance beyond which a relay's rewards fall no more, in m, and what each cube costs
an arm that waits behind its own. So an arm gains by passing one on."""


@dataclass(frozen=True)
class PassConfig(TaskConfig):
    """Settings of Pass.

    Attributes:
      max_episode_steps: control steps of an episode; None for 200, or 60 for each arm
        of a relay and each further cube, if that is more.
      success_radius: distance of a cube to its target that counts as there, in m; None
        for 0.12, or 0.06 in a relay.
      picking_threshold: greatest distance at which robot_1 can grip a cube, in m.
      handover_threshold: greatest distance at which the others can, in m.
      relay: whether the rules of a relay hold; None for True with three and more.
    """

    max_episode_steps: int = _BY_RULE
    success_radius: float = bounded(None, 0.001, 10.0)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)
    handover_threshold: float = bounded(0.05, 0.0, 1.0)
    relay: bool | None = None


@dataclass(frozen=True)
class PassFacts:
    """What Pass looks at, (num_envs, ...) each; poses as in `Sim`.

    An arm's own cube is the one that `own_thing` says.
    """

    joints: dict[str, Array]  # angles by agent, in rad
    tcp: dict[str, tuple[Array, Array]]  # pose of each agent's tcp
    holds: dict[str, Array]  # by agent, whether its grip holds a cube
    grips: dict[str, Array]  # by agent, which cubes its grip holds, (num_envs, cubes)
    own: Array  # the index of each agent's own cube, (num_envs, agents)
    to_cube: dict[str, Array]  # distance from its tcp to its cube's centre, in m
    to_next: dict[str, Array]  # from the next agent's tcp to its cube's centre, in m
    cubes: tuple[Array, Array]  # poses, (num_envs, cubes, 3) and (num_envs, cubes, 4)
    targets: Array  # their positions, (num_envs, cubes, 3)
    to_target: Array  # from the last agent's cube to its target, in m
    handed: Array  # how many arms have had each cube in order, (num_envs, cubes)
    put: Array  # which cubes lie at their targets after that, (num_envs, cubes)
    stage: Array  # share of the hands that the cubes have been through
    idle: Array  # share of the arms that wait


class Pass(Task[PassConfig, PassFacts]):
    """Hand a cube on, from arm to arm, and take it to a target.

    Attributes:
      cube_start: nominal place of the first cube, (3,).
      targets: nominal places of the targets, (3,) each.
      meetings: where each arm but the last hands over, at ease for both, (3,).
      angles: by agent, joint angles, (poses, joints), in rad: above the cube, or of all
        but robot_1 aside of where they take it and there; and where they bring it.
      hands: by agent, the quaternion of its hand at each of these, (1, 4).
      picks: by agent, a hand that picks from its table, and joint angles with it there.
      thresholds: by agent, the greatest distance at which it can grip a cube, in m.
    """

    robot_counts = range(2, teams.MOST_MATES + 2)
    gripping = True
    randomizations = presets(Randomization(joint_noise=0.1))
    config_class = PassConfig
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("to_cube", "to_next", "to_target"), "m"
    )
    coordination: ClassVar[Mapping[str, Kept]] = {"stage": "greatest", "idle": "mean"}
    block_units: ClassVar[Mapping[str, str]] = {
        **{"joints": "rad", "target": "m"},
        **dict.fromkeys(("end effector", "tcp", "cube"), POSE),
    }
    styles = player.STYLES
    expert, styled = player.expert, player.styled

    def _take(self, config: PassConfig) -> None:
        """Take settings, with those that are None set by the number of arms."""
        count = len(self.agents)
        relay = count > 2 if config.relay is None else config.relay
        cubes = 2 if relay and count >= _ARMS_FOR_TWO else 1
        steps = max(200, _STEPS_PER_ARM * (count + cubes - 1) if relay else 0)
        radius = 0.06 if relay else 0.12
        usual = {"max_episode_steps": steps, "success_radius": radius, "relay": relay}
        super()._take(filled(config, **usual))
        names = ("cube", "target"), ("cube_2", "target_2")
        self.cubes, self._goals = zip(*names[:cubes], strict=True)

    def mounts(self) -> tuple[Placement, ...]:
        return stand_in_row(self.robots.values())

    def build(self, scene: Scene) -> None:
        self._row = row = Row(self.robots, self.placements, _CUBE_SIZE)
        row.add_to(scene)
        config, first, last = self.config, self.agents[0], self.agents[-1]
        aside = [_APART * i for i in range(len(self.cubes))]
        self._starts = [row.before(first, 0.1 - each) for each in aside]
        self.cube_start = self._starts[0]
        self.targets = [np.array([1.2, self.placements[last].position[1], 1.3])]
        if config.relay:
            self.targets = [row.before(last, each - 0.1) for each in reversed(aside)]
        for i, (name, rgba) in enumerate(zip(self.cubes, _COLOURS, strict=False)):
            own = {"rgba": rgba} if len(self.cubes) > 1 else {}
            scene.add(name, cube(_CUBE_SIZE, rgba=rgba), position=self._starts[i])
            scene.add_target(self._goals[i], config.success_radius, **own)
            if config.relay:
                scene.add_velocity_sensor(name, f"{name}/centre")
        self.thresholds = dict.fromkeys(self.agents, config.handover_threshold)
        self.thresholds[first] = config.picking_threshold
        for agent, most in self.thresholds.items():
            for name in self.cubes:
                site = f"{name}/centre"
                scene.add_grip(agent, site, threshold=most, width=_GRIP_WIDTH)
        across = [place.position[1] for place in self.placements.values()]
        more = max(0.0, across[-1] - across[0] - 1.4)
        eye = 2.45 + 0.66 * more, (across[0] + across[-1]) / 2, 1.68 + 0.24 * more
        scene.add_camera(eye, (0, 1, 0, -0.34, 0, 0.94))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._frames = teams.Frames(self.placements)
        across = [place.position[1] for place in self.placements.values()]
        spots = [self.cube_start, *(np.array([1.2, y, 1.3]) for y in across[1:])]
        self.meetings = self._row.meetings(spots)
        self.angles, self.hands, self.picks = {}, {}, {}
        relay = self.config.relay
        # Two arms go as they ever did, to the bit.
        find_way = safest_way if relay else quickest_way
        for i, (agent, arm) in enumerate(scene.arms.items()):
            places, comes = self._entry(i)
            ways = [
                [*((place, hand) for place in places), end]
                for hand in either_way(comes)
                for end in self._ends(i)
            ]
            chosen, self.angles[agent] = find_way(sim.model, arm, ways=ways)
            self.hands[agent] = [hand[None] for _, hand in ways[chosen]]
            scene.postures[agent] = self.angles[agent][min(i, 1)]
            picking = self.hands[agent][0][0] if relay else PICKING
            self.picks[agent] = picking, self.angles[agent][0]
            if relay and i > 0:
                self.picks[agent] = self._row.picking(sim.model, arm, agent=agent)

    def _entry(self, i: int) -> tuple[list[np.ndarray], np.ndarray]:
        """Return where an arm's hand comes to its cube, and its quaternion."""
        if i == 0:
            return [self.cube_start - 0.25 * DOWN], PICKING
        meeting = self.meetings[i - 1]
        return [meeting + 0.3 * ACROSS - 0.1 * DOWN, meeting], TAKING[i % 2]

    def _ends(self, i: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return poses of the hand of which an arm may bring its cube to one."""
        if i < len(self.meetings):
            return [(self.meetings[i], hand) for hand in either_way(GIVING[i % 2])]
        if self.config.relay:
            over = np.mean(self.targets, axis=0) - _HOVER * DOWN
            return [(over, hand) for hand in either_way(PICKING)]
        [target], base = self.targets, self.placements[self.agents[i]].position
        radial = target - np.array(base) - SHOULDER
        ends = np.eye(3)[0], radial / math.norm(radial), -ACROSS
        return [(target, end) for end in ends]

    @cached_property
    def _in_reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Where a lost cube may lie, (n, 3) in m, and indices of who picks it up."""
        found, owners = [], []
        for i, (agent, arm) in enumerate(self.scene.arms.items()):
            # What lies nearer to the arm before is for that arm to pick up.
            right = self.meetings[i - 1][1] + BEYOND if i else -np.inf
            places = self._row.in_reach(
                self.model, arm, agent=agent, right=right, start=self.picks[agent]
            )
            if self.config.relay:
                base = np.array(self.placements[agent].position)
                places = places[math.distance(places, base) > _CLEAR[0]]
            for other in self._starts[1:]:
                places = places[math.distance(places, other) > _CLEAR[1]]
            found.append(places)
            owners.append(np.full(len(places), i))
        return np.concatenate(found), np.concatenate(owners)

    def remember(self, num_envs: int) -> dict[str, Array]:
        # How many arms have had each cube in order.
        shape = num_envs, len(self.cubes)
        return {"handed": self.xp.zeros(shape, dtype=self.xp.float64)}

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        spread = self.config.randomization
        starts = {agent: angles[0] for agent, angles in self.angles.items()}
        self.start_arms(sim, env_ids, rng=rng, angles=starts)
        for name, nominal in zip(self.cubes, self._starts, strict=True):
            place = nominal + rng.within(spread.object_position * LEVEL, 3)
            quat = math.from_yaw(rng.within(spread.object_yaw))
            self.scene.place(sim, env_ids, name=name, position=place, quat=quat)
        axes = LEVEL if self.config.relay else np.ones(3)
        for name, nominal in zip(self._goals, self.targets, strict=True):
            place = nominal + rng.within(spread.target_position * axes, 3)
            self.scene.place(sim, env_ids, name=name, position=place)

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """Hands are open on their ways, and a cube lies before the arm that lost it.

        No arm can bring back what fell on the floor, so it never lies there.
        """
        angles = {}
        for i, agent in enumerate(self.agents):
            before, meeting = self.angles[agent][:2]
            most = 1.0 if i == 0 else _SHORT_OF_MEETING
            angles[agent] = before + rng.uniform(0.0, most, 1) * (meeting - before)
        self.start_arms(sim, env_ids, rng=rng, angles=angles)
        places, owners = self._in_reach
        drawn = rng.uniform(0, len(places)).astype(int)
        quat = math.from_yaw(rng.within(np.pi))
        self.scene.place(sim, env_ids, name="cube", position=places[drawn], quat=quat)
        sim.memory["handed"][env_ids, 0] = sim.xp.asarray(owners[drawn] + 1.0)

    def measure(self, sim: Sim) -> PassFacts:
        xp, agents, before = sim.xp, self.agents, sim.memory["handed"]
        tcp = {agent: sim.pose(f"{agent}/tcp") for agent in agents}
        sites = [f"{name}/centre" for name in self.cubes]
        poses = [sim.pose(site) for site in sites]
        places, quats = (xp.stack(list(x), axis=1) for x in zip(*poses, strict=True))
        targets = xp.stack([sim.pose(name)[0] for name in self._goals], axis=1)
        grips = {
            a: xp.stack([self.scene.holds(sim, a, site=site) for site in sites], axis=1)
            for a in agents
        }
        holds = {agent: xp.any(held, axis=1) for agent, held in grips.items()}
        handed = sim.memory["handed"] = handed_on(before, [*grips.values()])
        to_targets, is_held = math.distance(places, targets), sum(grips.values()) > 0
        near = ~is_held & (to_targets < self.config.success_radius)
        put = near & (handed == len(agents)) & self._lies(sim, places, targets)
        own, to_cube, to_next = [], {}, {}
        for i, agent in enumerate(agents):
            follows = handed > i + 1 if i + 1 < len(agents) else put
            own.append(own_thing(grips[agent], follows))
            place = of(places, own[i])
            to_cube[agent] = math.distance(tcp[agent][0], place)
            if i + 1 < len(agents):
                to_next[agent] = math.distance(tcp[agents[i + 1]][0], place)
        return PassFacts(
            joints=self.joints(sim),
            tcp=tcp,
            holds=holds,
            grips=grips,
            own=xp.stack(own, axis=1),
            to_cube=to_cube,
            to_next=to_next,
            cubes=(places, quats),
            targets=targets,
            to_target=of(to_targets, own[-1]),
            handed=handed,
            put=put,
            stage=xp.mean(handed, axis=1) / len(agents),
            idle=self.share_idle(sim, holds.values()),
        )

    def _lies(self, sim: Sim, places: Array, targets: Array) -> Array:
        above = places[..., 2] - targets[..., 2]
        if not self.config.relay:
            return above < -np.inf
        speeds = [math.norm(sim.velocity(name)[0]) for name in self.cubes]
        return (sim.xp.stack(speeds, axis=1) < _AT_REST) & (above < _ON_TABLE)

    def observe(self, facts: PassFacts) -> dict[str, Blocks]:
        xp, kind = array_namespace(facts.targets), facts.targets.dtype
        grips = {a: xp.astype(held, kind)[:, None] for a, held in facts.holds.items()}
        if self.config.relay:
            return {a: self._seen_by(a, facts, grips) for a in self.agents}
        hands = {agent: math.pose(*pose) for agent, pose in facts.tcp.items()}
        places, quats = facts.cubes
        shared = {
            **columns("end effector", hands),
            **columns("gripping", grips),
            "cube": math.pose(places[:, 0], quats[:, 0]),
            "target": facts.targets[:, 0],
        }
        return {a: {"joints": facts.joints[a], **shared} for a in self.agents}

    def _seen_by(self, agent: str, facts: PassFacts, grips: dict[str, Array]) -> Blocks:
        """Return what an arm of a relay sees in the frame of its base."""
        xp, frames = array_namespace(facts.targets), self._frames
        i, tcp = self.agents.index(agent), facts.tcp[agent]
        which = facts.own[:, i]
        own, goal = [of(x, which) for x in facts.cubes], of(facts.targets, which)
        if i < len(self.meetings):
            goal = goal * 0.0 + xp.asarray(self.meetings[i], dtype=goal.dtype)
        gaps = {
            mate: teams.fine(math.distance(there, own[0])[:, None])
            for mate, (there, _) in facts.tcp.items()
        }
        mates = teams.hands_block(frames, agent, tcps=facts.tcp, grips=grips, more=gaps)
        return {
            "joints": teams.alike(facts.joints[agent]),
            "gripping": grips[agent],
            "tcp": math.pose(*frames.pose(agent, tcp)),
            "cube": math.pose(*frames.pose(agent, (own[0], own[1]))),
            "to_cube": teams.fine(frames.direction(agent, own[0] - tcp[0])),
            "to_goal": teams.fine(frames.direction(agent, goal - own[0])),
            "cubes left": self._left(i, facts)[:, None] / len(self.cubes),
            "mates": mates,
        }

    def reward(self, facts: PassFacts, commands: Commands) -> dict[str, Terms]:
        xp, config = array_namespace(facts.to_target), self.config
        zero, terms = xp.zeros_like(facts.to_target), {}
        farthest = zero + (_FARTHEST if config.relay else np.inf)
        arrived = xp.where(self.success(facts), zero + 1.0, zero)
        for i, (agent, command) in enumerate(commands.items()):
            near = xp.minimum(facts.to_cube[agent], farthest)
            gone = of((facts.handed > i + 2) | facts.put, facts.own[:, i])
            is_last = i == len(self.meetings)
            onwards = facts.to_target if is_last else facts.to_next[agent]
            far = xp.minimum(onwards, farthest)
            handing = gone if is_last else gone | (far < config.handover_threshold)
            grip = xp.where(command.grips, zero + 0.1, zero)
            incentive = xp.where(near < self.thresholds[agent], grip, zero)
            terms[agent] = {
                # Near the next hand, letting go never costs an arm anything.
                "reach": xp.where(handing, zero + 0.2, -near),
                "carry" if is_last else "handover": xp.where(gone, zero, -far),
                "grip": xp.where(handing, -grip, incentive),
                "effort": -0.01 * math.norm(command.moves),
                "success": arrived,
            }
            if len(self.cubes) > 1:
                others = xp.maximum(self._left(i, facts) - 1.0, zero)
                terms[agent]["waiting"] = -_WAITING * others
        return terms

    def _left(self, i: int, facts: PassFacts) -> Array:
        xp = array_namespace(facts.targets)
        left = ~facts.put if i == len(self.meetings) else facts.handed < i + 2
        return xp.sum(xp.astype(left, facts.targets.dtype), axis=1)

    def success(self, facts: PassFacts) -> Array:
        if self.config.relay:
            return array_namespace(facts.put).all(facts.put, axis=1)
        near = facts.to_target < self.config.success_radius
        return near & facts.holds[self.agents[-1]]

    def shortfall(self, facts: PassFacts) -> Array:
        xp, last = array_namespace(facts.to_target), self.agents[-1]
        if self.config.relay:
            count = len(self.agents)
            far = math.distance(facts.cubes[0], facts.targets) / (2.0 * count)
            missing = 1.0 - facts.handed / count + far
            return xp.mean(xp.where(facts.put, 0.0, missing), axis=1)
        missing = xp.where(facts.holds[last], 0.0, facts.to_cube[last])
        return xp.where(self.success(facts), 0.0, facts.to_target + missing)


_GIVER = Placement((0.0, -0.7, 1.0))
_SAWYERS = {"placements": (_GIVER, Placement((0.0, 0.7, 1.0)))}
_WITH_JACO = {
    "placements": (_GIVER, Placement((0.55, 0.7, 0.62))),
    "handover_threshold": 0.045,
}
registry.register_task("Pass", Pass)
registry.register_env(
    registry.EnvSpec("PassTaskSawyers-v0", Pass, ("sawyer", "sawyer"), _SAWYERS)
)
registry.register_env(
    registry.EnvSpec("PassTaskJacoSawyer-v0", Pass, ("sawyer", "jaco"), _WITH_JACO)
)
for grasp in ("pinch", "friction"):
    own, name = {**_SAWYERS, "grasp": grasp}, f"Pass{grasp.title()}Sawyers-v0"
    registry.register_env(registry.EnvSpec(name, Pass, ("sawyer", "sawyer"), own))
registry.register_teams("Pass", Pass, pandas=[3, 4, 6])
