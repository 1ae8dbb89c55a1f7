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
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Command, Motion
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import quickest_way, reach, settling, standoff
from collaborative_gym.objects.cube import cube
from collaborative_gym.objects.table import table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import SHOULDER, Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.registry import EnvSpec, register_env, register_task
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import LEVEL, Blocks, Task, TaskConfig, Terms, columns

_CUBE = "cube/centre"
_CUBE_SIZE = 0.04  # m
_GRIP_WIDTH = 0.05  # m; a cube turned by 15 degrees fits between the fingers
_TABLE_HEIGHT = 0.64  # m, of a table that no arm stands on
_TABLE_END = 1.1  # m, x of the tables' far ends

_CLOSE = 0.8  # share of the greatest distance of a grip at which the expert grips
# How a hand comes before the cube, in m. One that takes it 6 mm aside passes the
# giver's fingers by less than 1 mm.
_ABOVE = {"slack": 0.01, "least": 0.0, "most": 0.06}
_ASIDE = {"slack": 0.002, "least": 0.0, "most": 0.1}
_ARRIVED = 0.05  # m from the meeting at which robot_2 follows the cube
_POINT = (0.0, 0.0, 0.0)
# Where styles hand over, in m from the meeting, about as far away as learners chose to:
# middle and half axes of an ellipsoid in which each episode draws a place.
_ELSEWHERE = {
    "nearer": ((-0.2, 0.0, 0.0), _POINT, "0.2 m nearer to the arms' bases"),
    "farther": ((0.15, 0.0, 0.0), _POINT, "0.15 m farther from the arms' bases"),
    "lower": ((0.0, 0.0, -0.2), _POINT, "0.2 m lower"),
    "higher": ((0.0, 0.0, 0.2), _POINT, "0.2 m higher"),
    "first-side": ((0.0, -0.15, 0.0), _POINT, "0.15 m nearer to robot_1"),
    "second-side": ((0.0, 0.15, 0.0), _POINT, "0.15 m nearer to robot_2"),
    "anywhere": ((-0.05, 0.0, 0.0), (0.15, 0.15, 0.2), "where each episode draws"),
}
_NEAR_MEETING = 0.3  # m
_BEYOND = 0.05  # m from the meeting across, from which on robot_2 picks up the cube

# Directions, and orientations (w x y z) of a hand. The hands meet head on, one closing
# along x and the other along z, so that their fingers pass one another.
_DOWN = np.array([0.0, 0.0, -1.0])
_ACROSS = np.array([0.0, 1.0, 0.0])
_OUT = np.array([1.0, 0.0, 0.0])
_PICKING = np.array([0.0, 0.5**0.5, 0.5**0.5, 0.0])
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
    """What Pass looks at, (num_envs, ...) each.

    Attributes:
      joints: arm joint angles by agent, in rad.
      tcp: position and quaternion of each agent's tcp.
      holds: by agent, whether its grip holds the cube.
      to_cube: by agent, distance from its tcp to the cube's centre, in m.
      cube: position and quaternion of the cube.
      target: position of the target.
      to_target: distance from the cube's centre to the target, in m.
    """

    joints: dict[str, Array]
    tcp: dict[str, tuple[Array, Array]]
    holds: dict[str, Array]
    to_cube: dict[str, Array]
    cube: tuple[Array, Array]
    target: Array
    to_target: Array


class Pass(Task[PassConfig, PassFacts]):
    """Hand a cube over, from one arm to the other, and take it to a target."""

    gripping = True
    config_class = PassConfig
    units: ClassVar[Mapping[str, str]] = {"to_cube": "m", "to_target": "m"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "end effector": POSE,
        "cube": POSE,
        "target": "m",
    }
    styles: ClassVar[Mapping[str, str]] = {
        style: f"they hand over {where}" for style, (*_, where) in _ELSEWHERE.items()
    }

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
        heights = {}
        for agent, (x, y, z) in bases.items():
            before = self.robots[agent].stand == "pedestal"
            near, heights[agent] = (0.5, _TABLE_HEIGHT) if before else (x - 0.2, z)
            place = self.placements[agent]
            scene.add_robot(agent, self.robots[agent], placement=place, stand=before)
            top = table(_TABLE_END - near, width, height=heights[agent])
            scene.add(f"{agent}_table", top, position=((_TABLE_END + near) / 2, y, 0.0))
        x = min(bases[giver][0] + 0.635 * self.robots[giver].reach, _TABLE_END - 0.1)
        z = heights[giver] + _CUBE_SIZE / 2
        self._cube_start = np.array([x, bases[giver][1] + 0.1, z])
        self._target = np.array([1.2, bases[taker][1], 1.3])
        scene.add("cube", cube(_CUBE_SIZE), position=self._cube_start)
        scene.add_target("target", self.config.success_radius)
        picks, hands = self.config.picking_threshold, self.config.handover_threshold
        for agent, threshold in ((giver, picks), (taker, hands)):
            scene.add_grip(agent, _CUBE, threshold=threshold, width=_GRIP_WIDTH)
        scene.add_camera((2.45, 0, 1.68), (0, 1, 0, -0.34, 0, 0.94))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._meeting = meeting = self._find_meeting()
        giver, taker = self.agents
        above = self._cube_start - 0.25 * _DOWN
        aside = meeting + 0.3 * _ACROSS - 0.1 * _DOWN
        radial = self._target - np.array(self.placements[taker].position) - SHOULDER
        ends = [_OUT, radial / math.norm(radial), -_ACROSS]
        ways = {giver: [], taker: []}
        # A hand grips as well if it is turned by half a turn about its approach.
        for turn in np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]):
            hands = _PICKING, _GIVING, _TAKING
            pick, give, take = (math.multiply(hand, turn) for hand in hands)
            ways[giver].append([(above, pick), (meeting, give)])
            before = [(aside, take), (meeting, take)]
            ways[taker] += [[*before, (self._target, end)] for end in ends]
        self._angles, self._hands = {}, {}
        for agent, arm in scene.arms.items():
            i, self._angles[agent] = quickest_way(sim.model, arm, ways=ways[agent])
            self._hands[agent] = [hand[None] for _, hand in ways[agent][i]]

    def _find_meeting(self) -> np.ndarray:
        """Return where to hand over: on the cube's way, at ease for both arms."""
        place = (self._cube_start + self._target) / 2
        for _ in range(50):
            for agent, placement in self.placements.items():
                shoulder = np.array(placement.position) + SHOULDER
                arm = place - shoulder
                easy = 0.8 * self.robots[agent].reach
                place = shoulder + arm * min(1.0, easy / math.norm(arm))
        return place

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        spread = self.config.randomization
        starts = {agent: angles[0] for agent, angles in self._angles.items()}
        self.start_arms(sim, env_ids, rng=rng, angles=starts)
        place = self._cube_start + rng.within(spread.object_position * LEVEL, 3)
        quat = math.from_yaw(rng.within(spread.object_yaw))
        self.scene.place(sim, env_ids, name="cube", position=place, quat=quat)
        place = self._target + rng.within(spread.target_position, 3)
        self.scene.place(sim, env_ids, name="target", position=place)

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
        xp = array_namespace(facts.target)
        kind = facts.target.dtype
        shared = {
            **columns("end effector", {a: math.pose(*p) for a, p in facts.tcp.items()}),
            **columns(
                "gripping",
                {a: xp.astype(held, kind)[:, None] for a, held in facts.holds.items()},
            ),
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

    def expert(self, sim: Sim, facts: PassFacts) -> dict[str, Motion]:
        return self._hand_over(sim, facts, np.zeros(3))

    def styled(
        self, sim: Sim, facts: PassFacts, *, style: str, draws: np.ndarray
    ) -> dict[str, Motion]:
        """Return motions for a hand-over elsewhere."""
        middle, spread, _ = _ELSEWHERE[style]
        # In a ball, because arms do not reach into all corners.
        inside = draws / np.maximum(math.norm(draws), 1.0)[:, None]
        return self._hand_over(sim, facts, middle + np.multiply(spread, inside))

    def _hand_over(
        self, sim: Sim, facts: PassFacts, shift: np.ndarray
    ) -> dict[str, Motion]:
        """Return motions for a hand-over so far from the usual meeting."""
        meeting = self._meeting + shift
        return {
            "robot_1": self._give(sim, facts, meeting),
            "robot_2": self._take(sim, facts, meeting),
        }

    def _give(self, sim: Sim, facts: PassFacts, meeting: np.ndarray) -> Motion:
        """Return robot_1's motion: pick from above, bring to the meeting, let go."""
        giver, taker = self.agents
        position, place = facts.tcp[giver][0], facts.cube[0]
        holds = facts.holds[giver][:, None]
        taken = facts.holds[taker][:, None] | self._is_beyond(facts)
        gap = np.where(holds, 0.1, standoff(position - place, _DOWN, **_ABOVE))
        lifted = position[:, 2:] > self._cube_start[2] + 0.03
        # Elsewhere it goes straight, once it is near the posture of the usual meeting.
        is_usual = (meeting == self._meeting).all()
        near = math.distance(place, self._meeting) < _NEAR_MEETING
        straight = holds & lifted & ~is_usual & near[:, None]
        goal = np.where(straight, meeting, place - gap * _DOWN)
        goal = np.where(taken, meeting - 0.15 * _ACROSS, goal)
        hand = np.where(taken | straight, self._hands[giver][1], self._hands[giver][0])
        angles = np.where(holds, self._angles[giver][1], self._angles[giver][0])
        swings = holds & lifted & ~taken & ~straight
        change = self._move(sim, facts, giver, goal, hand, angles, swings)
        grips = _grips(facts, giver, self.config.picking_threshold)
        return Motion(change, grips & ~facts.holds[taker])

    def _take(self, sim: Sim, facts: PassFacts, meeting: np.ndarray) -> Motion:
        """Return robot_2's motion: wait at the meeting, grip, carry to the target."""
        giver, taker = self.agents
        (position, quat), holds = facts.tcp[taker], facts.holds[taker][:, None]
        is_there = math.distance(facts.cube[0], meeting) < _ARRIVED
        offered = (facts.holds[giver] & is_there)[:, None]
        place = np.where(offered, facts.cube[0], meeting)
        gap = standoff(position - facts.cube[0], -_ACROSS, **_ASIDE)
        carries = holds & (math.distance(position, facts.tcp[giver][0]) > 0.08)[:, None]
        goal = place + np.where(holds, 0.15, gap) * _ACROSS
        goal = np.where(carries, facts.target, goal)
        picks = ~holds & self._is_beyond(facts)
        above = standoff(position - facts.cube[0], _DOWN, **_ABOVE)
        goal = np.where(picks, facts.cube[0] - above * _DOWN, goal)
        hand = np.where(picks, _PICKING, self._hands[taker][1])
        hand = np.where(carries, quat, hand)
        angles = np.where(carries, self._angles[taker][2], self._angles[taker][1])
        swings = carries & (math.distance(position, facts.target) > 0.3)[:, None]
        change = self._move(sim, facts, taker, goal, hand, angles, swings)
        return Motion(change, _grips(facts, taker, self.config.handover_threshold))

    def _is_beyond(self, facts: PassFacts) -> np.ndarray:
        """Return where robot_1 has lost the cube on robot_2's side, (num_envs, 1)."""
        across = math.dot(facts.cube[0] - self._meeting, _ACROSS)
        return ((across > _BEYOND) & ~facts.holds[self.agents[0]])[:, None]

    def _move(
        self, sim: Sim, facts: PassFacts, agent: str, goal, hand, angles, swings
    ) -> np.ndarray:
        """Return joint changes straight to a pose, or to the angles where `swings`."""
        arm = self.scene.arms[agent]
        straight = reach(
            sim, arm, tcp=facts.tcp[agent], goal=(goal, hand), posture=angles
        )
        swing = settling(sim, arm, change=angles - facts.joints[agent])
        return np.where(swings, swing, straight)


def _grips(facts: PassFacts, agent: str, threshold: float) -> Array:
    """Return where the expert's hand holds the cube, or is close enough to grip."""
    return facts.holds[agent] | (facts.to_cube[agent] < _CLOSE * threshold)


_GIVER = Placement((0.0, -0.7, 1.0))
_SAWYERS = {"placements": (_GIVER, Placement((0.0, 0.7, 1.0)))}
_WITH_JACO = {
    "placements": (_GIVER, Placement((0.55, 0.7, 0.62))),
    "handover_threshold": 0.045,
}

register_task("Pass", Pass)
register_env(EnvSpec("PassTaskSawyers-v0", Pass, ("sawyer", "sawyer"), _SAWYERS))
register_env(EnvSpec("PassTaskJacoSawyer-v0", Pass, ("sawyer", "jaco"), _WITH_JACO))
