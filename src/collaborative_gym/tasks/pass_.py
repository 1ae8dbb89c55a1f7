"""Pass: one robot picks a cube and hands it over to another, who brings it to a target.

Two robots stand side by side. Each has a table: an arm that stands on a pedestal has
the table in front of it, any other arm stands on its near end. The cube (0.04 m, 0.05
kg) lies on robot_1's table. The target hangs in the air in front of robot_2. A grip
holds the cube's centre at the tool centre point and lets the cube turn. For a moment
both robots may hold it. Then robot_1 must let go: if robot_2 tears the cube out of its
hand, robot_2 loses it, too.

Agents: `robot_1` picks and hands over, `robot_2` takes over and carries.

Randomised: the joints of both arms, the cube's place on the table (x and y) and its
turn about the vertical, the target's place along each axis.

Reward of each agent: robot_2 is "near" while its tool centre point is within
`handover_threshold` (0.05 m) of the cube's centre.

- `reach` of robot_1: minus the distance from its tool centre point to the cube, in m;
  0.2 while robot_2 is near.
- `handover` of robot_1: minus the distance from robot_2's tool centre point to the
  cube.
- `grip` of robot_1: 0.1 while it asks for a grip within `picking_threshold` (0.03 m) of
  the cube; while robot_2 is near, -0.1 if it asks for a grip; else 0.
- `reach` of robot_2: minus the distance from its tool centre point to the cube, in m.
- `carry` of robot_2: minus the distance from the cube to the target, in m.
- `grip` of robot_2: 0.1 while it is near and asks for a grip, else 0.
- `effort` of both: minus 0.01 times the Euclidean norm of the joints' part of the
  action; in another action mode, of the joint changes that the action comes to.
- `success` of both: 1 while the goal is reached, else 0.

Success: the cube is within `success_radius` of the target and robot_2 holds it. The
thesis asks only for the distance. The second condition rules out that robot_1 throws
the cube through the target; a search found that its arm can do that. robot_1 cannot
carry the cube to the target: it stays 0.27 m or more outside the radius. robot_2 cannot
pick the cube up from robot_1's table: it is 0.18 m or more too far away. This holds for
all starts that the default randomisation draws, for every pair of Sawyer, Panda and
Jaco.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Command
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import Chains, hold, quickest_way
from collaborative_gym.objects.cube import cube
from collaborative_gym.objects.table import table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import SHOULDER, Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.experts import pass_ as player
from collaborative_gym.tasks.experts.pass_ import ACROSS, BEYOND, DOWN, PICKING
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
    presets,
)

_CUBE = "cube/centre"
_CUBE_SIZE = 0.04  # m
_GRIP_WIDTH = 0.05  # m; a cube turned by 15 degrees fits between the fingers
_TABLE_HEIGHT = 0.64  # m, of a table that no arm stands on
_TABLE_END = 1.1  # m, x of the tables' far ends
_GRID = 25  # places along either side of a table where the cube may lie
_BEFORE = 1.7  # tangent of 60 degrees to either side
_AT_EASE = 1.05  # times as far away an arm must reach; at the very end it is slow
_LIFTED = 0.1  # m, how high the hand is free above a cube that it picks up
_SHORT_OF_MEETING = 1 / 3  # share of its way there, where robot_2 leaves robot_1 room
_OUT = np.array([1.0, 0.0, 0.0])
# Orientations (w x y z) of a hand. The hands meet head on, one closing along x and the
# other along z, so that their fingers pass one another.
_GIVING = np.array([-0.5, 0.5, 0.5, 0.5])
_TAKING = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])


@dataclass(frozen=True)
class PassConfig(TaskConfig):
    """Settings of Pass.

    Attributes:
      success_radius: distance of the cube to the target that counts as there, in m.
      picking_threshold: greatest distance at which robot_1 can grip the cube, in m.
      handover_threshold: greatest distance at which robot_2 can grip the cube, in m.
    """

    success_radius: float = bounded(0.12, 0.001, 10.0)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)
    handover_threshold: float = bounded(0.05, 0.0, 1.0)


@dataclass(frozen=True)
class PassFacts:
    """What Pass looks at, (num_envs, ...) each; poses as in `Sim`."""

    joints: dict[str, Array]  # angles by agent, in rad
    tcp: dict[str, tuple[Array, Array]]  # pose of each agent's tcp
    holds: dict[str, Array]  # by agent, whether its grip holds the cube
    to_cube: dict[str, Array]  # distance from its tcp to the cube's centre, in m
    cube: tuple[Array, Array]  # its pose
    target: Array  # its position
    to_target: Array  # distance from the cube's centre to the target, in m


class Pass(Task[PassConfig, PassFacts]):
    """Hand a cube over, from one arm to the other, and take it to a target.

    Attributes:
      cube_start: nominal place of the cube, (3,).
      meeting: where to hand over: on the cube's way, at ease for both arms, (3,).
      angles: by agent, joint angles above the cube and at the meeting; of robot_2 aside
        of the meeting, there and at the target, (poses, joints), in rad.
      hands: by agent, the quaternion of its hand at each of these, (1, 4).
    """

    gripping = True
    randomizations = presets(Randomization(joint_noise=0.1))
    config_class = PassConfig
    units: ClassVar[Mapping[str, str]] = {"to_cube": "m", "to_target": "m"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "end effector": POSE,
        "cube": POSE,
        "target": "m",
    }
    styles = player.STYLES
    expert, styled = player.expert, player.styled

    def mounts(self) -> tuple[Placement, ...]:
        """Return places that are farther apart, the longer the reach is."""
        placements = []
        for side, robot in zip((-1, 1), self.robots.values(), strict=True):
            y = side * min(0.7, 0.71 * robot.reach)
            if robot.stand == "pedestal":
                placements.append(Placement((0.8 - 0.635 * robot.reach, y, 1.0)))
            else:
                placements.append(Placement((0.55, y, 0.62)))
        return tuple(placements)

    def build(self, scene: Scene) -> None:
        giver, taker = self.agents
        bases = {agent: place.position for agent, place in self.placements.items()}
        width = bases[taker][1] - bases[giver][1] - 0.2
        heights, self._tops = {}, {}
        for agent, (x, y, z) in bases.items():
            before = self.robots[agent].stand == "pedestal"
            near, heights[agent] = (0.5, _TABLE_HEIGHT) if before else (x - 0.2, z)
            place = self.placements[agent]
            scene.add_robot(agent, self.robots[agent], placement=place, stand=before)
            top = table(_TABLE_END - near, width, height=heights[agent])
            scene.add(f"{agent}_table", top, position=((_TABLE_END + near) / 2, y, 0.0))
            corner = np.array([_TABLE_END - near, width]) / 2 - _CUBE_SIZE
            middle = np.array([(_TABLE_END + near) / 2, y])
            self._tops[agent] = middle - corner, middle + corner
        x = min(bases[giver][0] + 0.635 * self.robots[giver].reach, _TABLE_END - 0.1)
        self._rests = {a: height + _CUBE_SIZE / 2 for a, height in heights.items()}
        y = bases[giver][1] + 0.1
        self.cube_start = np.array([x, y, self._rests[giver]])
        self._target = np.array([1.2, bases[taker][1], 1.3])
        scene.add("cube", cube(_CUBE_SIZE), position=self.cube_start)
        scene.add_target("target", self.config.success_radius)
        picks, hands = self.config.picking_threshold, self.config.handover_threshold
        for agent, threshold in ((giver, picks), (taker, hands)):
            scene.add_grip(agent, _CUBE, threshold=threshold, width=_GRIP_WIDTH)
        scene.add_camera((2.45, 0, 1.68), (0, 1, 0, -0.34, 0, 0.94))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        giver, taker = self.agents
        self.meeting = meeting = self._find_meeting()
        above = self.cube_start - 0.25 * DOWN
        aside = meeting + 0.3 * ACROSS - 0.1 * DOWN
        radial = self._target - np.array(self.placements[taker].position) - SHOULDER
        ends = [_OUT, radial / math.norm(radial), -ACROSS]
        ways = {giver: [], taker: []}
        # A hand grips as well if it is turned by half a turn about its approach.
        for turn in np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]):
            hands = PICKING, _GIVING, _TAKING
            pick, give, take = (math.multiply(hand, turn) for hand in hands)
            ways[giver].append([(above, pick), (meeting, give)])
            before = [(aside, take), (meeting, take)]
            ways[taker] += [[*before, (self._target, end)] for end in ends]
        self.angles, self.hands = {}, {}
        for taking, (agent, arm) in enumerate(scene.arms.items()):
            i, self.angles[agent] = quickest_way(sim.model, arm, ways=ways[agent])
            self.hands[agent] = [hand[None] for _, hand in ways[agent][i]]
            scene.postures[agent] = self.angles[agent][taking]

    @cached_property
    def _in_reach(self) -> np.ndarray:
        """Places on both tables from which an arm can pick up the cube, (n, 3) in m."""
        found = []
        for agent, arm in self.scene.arms.items():
            (x, y), (far, left) = self._tops[agent]
            if agent != self.agents[0]:
                # What lies nearer to robot_1 is for that arm to pick up.
                y = max(y, self.meeting[1] + BEYOND)
            steps = np.mgrid[x : far : _GRID * 1j, y : left : _GRID * 1j]
            base = np.array(self.placements[agent].position[:2])
            ahead, aside = away = steps.reshape(2, -1) - base[:, None]
            # Straight ways to what lies beside a base lead into it.
            away = away.T[np.abs(aside) < _BEFORE * ahead]
            near = np.tile(self.angles[agent][0], (len(away), 1))
            chains, reached = Chains(self.model, [arm]), np.ones(len(away), bool)
            for above, share in ((_LIFTED, 1.0), (0.0, _AT_EASE)):
                z = self._rests[agent] + above
                goals = [(np.insert(base + share * away, 2, z, axis=1), PICKING)]
                [near], there = hold(chains, goals, near=[near])
                reached &= there
            places = np.insert(base + away, 2, self._rests[agent], axis=1)
            found.append(places[reached])
        return np.concatenate(found)

    def _find_meeting(self) -> np.ndarray:
        place = (self.cube_start + self._target) / 2
        for _ in range(50):
            for agent, placement in self.placements.items():
                shoulder = np.array(placement.position) + SHOULDER
                arm = place - shoulder
                easy = 0.8 * self.robots[agent].reach
                place = shoulder + arm * min(1.0, easy / math.norm(arm))
        return place

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        spread = self.config.randomization
        starts = {agent: angles[0] for agent, angles in self.angles.items()}
        self.start_arms(sim, env_ids, rng=rng, angles=starts)
        place = self.cube_start + rng.within(spread.object_position * LEVEL, 3)
        quat = math.from_yaw(rng.within(spread.object_yaw))
        self.scene.place(sim, env_ids, name="cube", position=place, quat=quat)
        place = self._target + rng.within(spread.target_position, 3)
        self.scene.place(sim, env_ids, name="target", position=place)

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """The hands are open on their ways, and the cube lies before one of the arms.

        No arm can bring back what fell on the floor, so it never lies there.
        """
        angles = {}
        for agent, most in zip(self.agents, (1.0, _SHORT_OF_MEETING), strict=True):
            before, meeting = self.angles[agent][:2]
            angles[agent] = before + rng.uniform(0.0, most, 1) * (meeting - before)
        self.start_arms(sim, env_ids, rng=rng, angles=angles)
        place = self._in_reach[rng.uniform(0, len(self._in_reach)).astype(int)]
        quat = math.from_yaw(rng.within(np.pi))
        self.scene.place(sim, env_ids, name="cube", position=place, quat=quat)

    def measure(self, sim: Sim) -> PassFacts:
        tcp = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        cube_pose, target = sim.pose(_CUBE), sim.pose("target")[0]
        return PassFacts(
            joints=self.joints(sim),
            tcp=tcp,
            holds={agent: self.scene.holds(sim, agent) for agent in self.agents},
            to_cube={a: math.distance(tcp[a][0], cube_pose[0]) for a in self.agents},
            cube=cube_pose,
            target=target,
            to_target=math.distance(cube_pose[0], target),
        )

    def observe(self, facts: PassFacts) -> dict[str, Blocks]:
        xp, kind = array_namespace(facts.target), facts.target.dtype
        hands = {agent: math.pose(*pose) for agent, pose in facts.tcp.items()}
        grips = {a: xp.astype(held, kind)[:, None] for a, held in facts.holds.items()}
        shared = {
            **columns("end effector", hands),
            **columns("gripping", grips),
            "cube": math.pose(*facts.cube),
            "target": facts.target,
        }
        return {a: {"joints": facts.joints[a], **shared} for a in self.agents}

    def reward(
        self, facts: PassFacts, commands: dict[str, Command]
    ) -> dict[str, Terms]:
        xp = array_namespace(facts.target)
        giver, taker = self.agents
        zero = xp.zeros_like(facts.to_target)
        picking = facts.to_cube[giver] < self.config.picking_threshold
        handing = facts.to_cube[taker] < self.config.handover_threshold
        grip, shared = {}, {}
        for agent, command in commands.items():
            effort = -0.01 * math.norm(command.moves)
            arrived = xp.where(self.success(facts), zero + 1.0, zero)
            shared[agent] = {"effort": effort, "success": arrived}
            grip[agent] = xp.where(command.grips, zero + 0.1, zero)
        incentive = xp.where(picking, grip[giver], zero)
        return {
            giver: {
                # Near robot_2's hand, letting go never costs robot_1 anything.
                "reach": xp.where(handing, zero + 0.2, -facts.to_cube[giver]),
                "handover": -facts.to_cube[taker],
                "grip": xp.where(handing, -grip[giver], incentive),
                **shared[giver],
            },
            taker: {
                "reach": -facts.to_cube[taker],
                "carry": -facts.to_target,
                "grip": xp.where(handing, grip[taker], zero),
                **shared[taker],
            },
        }

    def success(self, facts: PassFacts) -> Array:
        near = facts.to_target < self.config.success_radius
        return near & facts.holds[self.agents[1]]

    def shortfall(self, facts: PassFacts) -> Array:
        xp = array_namespace(facts.to_target)
        taker = self.agents[1]
        missing = xp.where(facts.holds[taker], 0.0, facts.to_cube[taker])
        return xp.where(self.success(facts), 0.0, facts.to_target + missing)


_GIVER = Placement((0.0, -0.7, 1.0))
_SAWYERS = {"placements": (_GIVER, Placement((0.0, 0.7, 1.0)))}
_WITH_JACO = {
    "placements": (_GIVER, Placement((0.55, 0.7, 0.62))),
    "handover_threshold": 0.045,
}
register_task("Pass", Pass)
register_env(EnvSpec("PassTaskSawyers-v0", Pass, ("sawyer", "sawyer"), _SAWYERS))
register_env(EnvSpec("PassTaskJacoSawyer-v0", Pass, ("sawyer", "jaco"), _WITH_JACO))
