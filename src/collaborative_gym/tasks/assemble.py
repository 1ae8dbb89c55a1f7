"""Assemble: two arms put a peg into a block's hole, and a third locks it with a pin.

Three arms stand around the place where they assemble, each with a table to its side.
The block (0.15 kg) lies on robot_1's table, the peg on robot_2's, the pin on robot_3's.
Each arm can hold only its own part. robot_1 must hold the block at the target. The peg
goes into the block's chamfered hole until the collar meets the block, and the pin
through the hole that both then have. Holes are square, and 2 mm wider than their parts.
The pin fits only while the peg is deep enough and at the right angle.

By default, hands `pinch` parts and keep them in the pose in which they took them. A
part that is pushed harder than two pads can bear slips. The grasp `magnet` is refused,
because it would let parts turn. Parts collide with other parts and with arms, except
for fingers that can hold them.

Randomized: the joints of the arms; the parts' positions on the tables (x and y) and
their turns about the vertical; the target's position.

All parts have the same pose once they are assembled. The block's goal is the target.
The goal of peg and pin is the block's pose. While the peg is not in, the pin's goal is
0.14 m in front of this pose.

Each arm observes, in the frame of its own base: its tool centre point; its part; the
motion that its hand still needs to hold the part (`to_part`) and the part to be at its
goal (`to_goal`); how far the block is from its own goal and turned from it; and how far
in the block peg and pin are (0 to 1). A motion is a translation and a rotation vector;
each component x is seen as log(1 + 100 |x|) with its sign, which shows millimetres. For
each other arm, the set `mates` has: 1 for its presence, how many seats away it is (as a
share of 7), whether it grips, and the vector from the robot's own tool centre point to
that arm's.

Reward of each agent:

- `reach`: minus the distance from its tool centre point to its part's knob, in m.
- `bring`: minus the distance of its part from its goal, in m, at most 1, and 0.2 times
  the angle between them, in rad.
- `grip`: 0.1 while it asks for a grip within `picking_threshold` (0.03 m) of the knob.
- `insert`: the depths of peg and pin in the block, 0 to 1 for each.
- `effort`: minus 0.01 times the Euclidean norm of the joints' part of the action; in
  other action modes, of what the action asks of the joints.
- `success`: 1 while the goal is reached, else 0.

Success: for 0.5 s, peg and pin are within 4 mm of their full depth, and the block is
within `success_radius` (0.05 m) of the target. A part's depth is measured from the
mouth of its hole, and counts only while its axis is within 3 mm and 0.1 rad of the
hole's. Parts lie far from the target; an arm that holds still keeps its part there.

Coordination: `stage` is the greatest mean share that peg and pin were in; `idle` is the
mean share of arms that waited, as in [Lift](lift.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import safest_way
from collaborative_gym.objects.assembly import ARM, DEEP, HALF, KNOB, block, peg, pin
from collaborative_gym.objects.table import round_table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import assemble as player
from collaborative_gym.tasks.experts.assemble import HEIGHT, WAIT
from collaborative_gym.tasks.handing import either_way
from collaborative_gym.tasks.registry import register_task, register_teams
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import LEVEL, Blocks, Kept, Task, TaskConfig, Terms

PARTS = "block", "peg", "pin"

_MAKERS = block, peg, pin
_AHEAD, _MOST_AHEAD = 0.68, 0.55  # of its reach, and m, from an arm to its part
_ASIDE = 2.2  # rad about its base, from the target to its table; ends turn by 2.6 rad
_RAISED = 0.17  # m, target above the parts on the tables
_TABLE = 0.27  # m, radius
_ON_THE_WAY = 5  # poses from there to the target
_HOVER = 0.12  # m above its part, where a hand begins
# Directions from the middle to the knobs of the parts, in their frame.
_AXES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_YAW = np.pi / 4  # of what is assembled, so that each knob is before its arm
_BESIDE, _TURNED = 0.003, 0.1  # m and rad, of an axis in a hole
_ENOUGH = 1.0 - 0.004 / np.maximum(DEEP, 0.004)  # shares of their way, for 4 mm less
_SEEN = 4.0  # m and rad, within which parts are seen: one that rolls off goes far
_FAINT = (0.0, 0.7, 0.2, 0.35)  # colour of the goal, which lies over the joint
_LEVER = 0.05  # m; about what two pads bear on a knob that is 0.04 m wide and high


@dataclass(frozen=True)
class AssembleConfig(TaskConfig):
    """Settings of Assemble.

    Attributes:
      action: as in all tasks, but "tcp", in which parts go in straight.
      grasp: as in all tasks, but no magnet.
      success_radius: greatest distance of the block from the target, in m.
      picking_threshold: greatest distance at which a grip starts, in m.
    """

    action: str = "tcp"
    grasp: str = "pinch"
    success_radius: float = bounded(0.05, 0.001, 10.0)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)


@dataclass(frozen=True)
class AssembleFacts:
    """Facts of Assemble, (num_envs, ...) each; poses as in `Sim`, by agent."""

    joints: dict[str, Array]  # angles, in rad
    tcp: dict[str, tuple[Array, Array]]  # poses of the tcps
    holds: dict[str, Array]  # whether a grip holds the part
    knobs: dict[str, tuple[Array, Array]]  # poses of hands that would hold the parts
    parts: dict[str, tuple[Array, Array]]  # poses of the parts
    goals: dict[str, tuple[Array, Array]]  # and of where they go
    to_knob: dict[str, Array]  # distance of the tcp from the knob, in m
    to_goal: dict[str, Array]  # distance of the part from its goal, in m
    turn: dict[str, Array]  # angle between them, in rad
    out: Array  # way that each part lacks, (num_envs, 3), in m
    beside: Array  # distance of its axis from the hole's, likewise
    inside: Array  # share of its way that it is in, likewise; 1 for the block
    stage: Array  # mean share of their way that peg and pin are in
    idle: Array  # share of the arms that wait


class Assemble(Task[AssembleConfig, AssembleFacts]):
    """Put a blue peg into a purple block, and lock it with an orange pin.

    Attributes:
      tables: nominal poses of the parts on their tables, by agent, (3,) and yaw in rad.
      target: nominal place of the target, (3,).
      turns: by agent, how its hand is turned from its knob's, a quaternion (4,).
      angles: by agent, joint angles, (2, joints), in rad: above its part, and where it
        holds it when it is assembled.
    """

    robot_counts = (3,)
    gripping = True
    success_for = 5
    config_class = AssembleConfig
    units: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("to_knob", "to_goal"), "m"),
        **{"turn": "rad", "stage": "", "idle": ""},
    }
    coordination: ClassVar[Mapping[str, Kept]] = {"stage": "greatest", "idle": "mean"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        **dict.fromkeys(("tcp", "part"), POSE),
        "block": "m; rad",
    }
    expert = player.expert

    def _take(self, config: AssembleConfig) -> None:
        if config.grasp == "magnet":
            raise ValueError(
                "Assemble needs a grasp that keeps parts from turning, and a magnet"
                ' does not; give grasp="pinch" or "suction"'
            )
        super()._take(config)

    def mounts(self) -> tuple[Placement, ...]:
        """Return arms around the target, each as far from its part as is at ease."""
        distances, heights = [], []
        for robot, arm in zip(self.robots.values(), (0.0, ARM, ARM), strict=True):
            distances.append(min(_AHEAD * robot.reach, _MOST_AHEAD) + arm)
            tall = robot.stand == "pedestal"
            heights.append(robot.base_height if tall else HEIGHT)
        return teams.around(distances, heights)

    def build(self, scene: Scene) -> None:
        config, low = self.config, HEIGHT + HALF
        scene.solid = True
        self.target, self.tables = np.array([0.0, 0.0, low + _RAISED]), {}
        for i, (agent, robot) in enumerate(self.robots.items()):
            place, name = self.placements[agent], PARTS[i]
            own = robot.stand == "pedestal" or config.placements is not None
            scene.add_robot(agent, robot, placement=place, stand=own)
            if not own:
                teams.add_stand(scene, agent, place)
            # The arm turns to its table about its base, with all that it holds.
            base = np.array([*place.position[:2], low])
            turn = math.from_yaw(np.array(_ASIDE))
            spot = base + math.rotate(turn, np.array([0.0, 0.0, low]) - base)
            self.tables[agent] = spot, _YAW + _ASIDE
            scene.add(name, _MAKERS[i](), position=spot)
            yaw = math.from_yaw(np.array(self.tables[agent][1]))
            middle = spot + math.rotate(yaw, ARM / 2 * _AXES[i])
            top = round_table(_TABLE, height=HEIGHT)
            scene.add(f"{agent}_table", top, position=(*middle[:2], 0.0))
            scene.add_pose_sensor(name, f"{name}/{name}")
            most = config.picking_threshold
            knob = {"threshold": most, "width": KNOB, "lever": _LEVER}
            scene.add_grip(agent, f"{name}/knob", **knob)
        scene.add_target("target", config.success_radius, rgba=_FAINT)
        scene.spec.visual.map.shadowclip = 4.5  # Tables stand around the arms.
        spots = [spot for spot, _ in self.tables.values()]
        teams.add_team_camera(scene, self.placements, below=0.7, also=spots)

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._frames = teams.Frames(self.placements)
        self.turns, self.angles = {}, {}
        self._yaw = math.from_yaw(np.array(_YAW))
        for i, (agent, arm) in enumerate(scene.arms.items()):
            knob = sim.model.site(f"{PARTS[i]}/knob")
            parts, turns = self._way(i), either_way(np.eye(4)[0])
            ways = [[_hand(part, knob, turn) for part in parts] for turn in turns]
            chosen, angles = safest_way(sim.model, arm, ways=ways)
            self.turns[agent] = turns[chosen]
            self.angles[agent] = angles[[1, -1]]
            scene.postures[agent] = angles[1]

    def _way(self, i: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return poses of a part, from its table, above it, to where it is assembled.

        On its way it turns about the base of its arm.
        """
        place, way = self.placements[self.agents[i]], []
        goal = self.target + WAIT * math.rotate(self._yaw, _AXES[i])
        base = np.array(place.position)
        for share in (1.0, *np.linspace(1.0, 0.0, _ON_THE_WAY)):
            turn, yaw = math.from_yaw(np.array([share * _ASIDE, share * _ASIDE + _YAW]))
            low = HEIGHT + HALF + (_HOVER if way else 0.0)
            raised = share * (low - goal[2]) * np.eye(3)[2]
            way.append((base + math.rotate(turn, goal - base) + raised, yaw))
        return way

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        spread = self.config.randomization
        starts = {agent: angles[0] for agent, angles in self.angles.items()}
        self.start_arms(sim, env_ids, rng=rng, angles=starts)
        for name, (spot, yaw) in zip(PARTS, self.tables.values(), strict=True):
            place = spot + rng.within(spread.object_position * LEVEL, 3)
            quat = math.from_yaw(yaw + rng.within(spread.object_yaw))
            self.scene.place(sim, env_ids, name=name, position=place, quat=quat)
        place = self.target + rng.within(spread.target_position, 3)
        self.scene.place(sim, env_ids, name="target", position=place)

    def measure(self, sim: Sim) -> AssembleFacts:
        xp, agents = sim.xp, self.agents
        tcp = {agent: sim.pose(f"{agent}/tcp") for agent in agents}
        parts = dict(zip(agents, map(sim.pose, PARTS), strict=True))
        knobs = {a: self._knob(sim, a, n) for a, n in zip(agents, PARTS, strict=True)}
        holds = {agent: self.scene.holds(sim, agent) for agent in agents}
        out, beside, fits = self._in_block(parts)
        share = xp.clip(1.0 - out / xp.asarray(np.maximum(DEEP, 1e-9)), 0.0, 1.0)
        inside = xp.where(fits, share, 0.0 * share)
        goals = self._goals(sim.pose("target")[0], parts, inside)
        here = {a: (parts[a], goals[a]) for a in agents}
        return AssembleFacts(
            joints=self.joints(sim),
            tcp=tcp,
            holds=holds,
            knobs=knobs,
            parts=parts,
            goals=goals,
            to_knob={a: math.distance(tcp[a][0], knobs[a][0]) for a in agents},
            to_goal={a: math.distance(x[0], y[0]) for a, (x, y) in here.items()},
            turn={a: _angle(x[1], y[1]) for a, (x, y) in here.items()},
            out=out,
            beside=beside,
            inside=inside,
            stage=xp.mean(inside[:, 1:], axis=1),
            idle=self.share_idle(sim, holds.values()),
        )

    def _knob(self, sim: Sim, agent: str, part: str) -> tuple[Array, Array]:
        place, quat = sim.pose(f"{part}/knob")
        turn = sim.xp.asarray(self.turns[agent], dtype=quat.dtype) + 0.0 * quat
        return place, math.multiply(quat, turn)

    def _in_block(
        self, parts: dict[str, tuple[Array, Array]]
    ) -> tuple[Array, Array, Array]:
        """Return how far out each part is, how far beside its hole, and if it fits.

        These are (num_envs, 3) each.
        """
        (place, quat), *_ = parts.values()
        xp, back = array_namespace(place), math.conjugate(quat)
        outs, besides, fits = [], [], []
        for axis, (other, quat) in zip(_AXES, parts.values(), strict=True):
            axis = xp.asarray(axis, dtype=place.dtype) + 0.0 * place
            way = math.rotate(back, other - place)
            turn = math.multiply(back, quat)
            out = math.dot(way, axis)
            beside = math.norm(way - out[:, None] * axis)
            # The pin is round: only its axis counts. The peg must not be turned at all.
            swung = math.norm(math.rotate(turn, axis) - axis)
            turned = math.norm(math.rotation_vector(turn))
            swung = xp.where(axis[:, 1] > 0.0, swung, turned)
            outs.append(out)
            besides.append(beside)
            fits.append((beside < _BESIDE) & (swung < _TURNED))
        return tuple(xp.stack(each, axis=1) for each in (outs, besides, fits))

    def _goals(
        self, target: Array, parts: dict[str, tuple[Array, Array]], inside: Array
    ) -> dict[str, tuple[Array, Array]]:
        """Return where parts go: the block to the target, the others to the block."""
        xp, (place, quat) = array_namespace(target), next(iter(parts.values()))
        yaw = xp.asarray(self._yaw, dtype=quat.dtype) + 0.0 * quat
        waits = xp.where(inside[:, 1] > _ENOUGH[1], 0.0, WAIT)[:, None]
        away = xp.asarray(_AXES[2], dtype=place.dtype) * waits
        goals = (target, yaw), (place, quat), (place + math.rotate(quat, away), quat)
        return dict(zip(self.agents, goals, strict=True))

    def observe(self, facts: AssembleFacts) -> dict[str, Blocks]:
        xp, frames = array_namespace(facts.stage), self._frames
        kind, seen, first = facts.stage.dtype, {}, self.agents[0]
        grips = {a: xp.astype(held, kind)[:, None] for a, held in facts.holds.items()}
        for agent in self.agents:
            tcp, own, goal = facts.tcp[agent], facts.parts[agent], facts.goals[agent]
            part = math.pose(*frames.pose(agent, own))
            seen[agent] = {
                "joints": teams.alike(facts.joints[agent]),
                "gripping": grips[agent],
                "tcp": math.pose(*frames.pose(agent, tcp)),
                "part": xp.clip(part, -_SEEN, _SEEN),
                "to_part": teams.fine(frames.way(agent, tcp, facts.knobs[agent])),
                "to_goal": teams.fine(frames.way(agent, own, goal)),
                # Whoever pushes must see whether the block gives way.
                "block": xp.stack([facts.to_goal[first], facts.turn[first]], axis=1),
                "inside": facts.inside[:, 1:],
                "mates": teams.hands_block(frames, agent, tcps=facts.tcp, grips=grips),
            }
        return seen

    def reward(self, facts: AssembleFacts, commands: Commands) -> dict[str, Terms]:
        xp, terms = array_namespace(facts.stage), {}
        zero = xp.zeros_like(facts.stage)
        arrived = xp.where(self.success(facts), zero + 1.0, zero)
        for agent, command in commands.items():
            far = xp.minimum(facts.to_goal[agent], zero + 1.0)
            near = facts.to_knob[agent] < self.config.picking_threshold
            terms[agent] = {
                "reach": -facts.to_knob[agent],
                "bring": -far - 0.2 * facts.turn[agent],
                "grip": xp.where(command.grips & near, zero + 0.1, zero),
                "insert": 2.0 * facts.stage,
                "effort": -0.01 * math.norm(command.moves),
                "success": arrived,
            }
        return terms

    def success(self, facts: AssembleFacts) -> Array:
        xp = array_namespace(facts.stage)
        enough = xp.asarray(_ENOUGH, dtype=facts.stage.dtype)
        is_in = xp.all(facts.inside >= enough, axis=1)
        return is_in & (facts.to_goal[self.agents[0]] < self.config.success_radius)

    def shortfall(self, facts: AssembleFacts) -> Array:
        xp = array_namespace(facts.stage)
        far = [xp.minimum(each, 0.0 * each + 5.0) for each in facts.to_goal.values()]
        missing = (2.0 * (1.0 - facts.stage) + sum(far)) / (2.0 * len(self.agents))
        return xp.where(self.success(facts), 0.0 * missing, missing)


def _hand(
    part: tuple[np.ndarray, np.ndarray], knob: Any, turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    place, quat = part
    hand = math.multiply(math.multiply(quat, knob.quat), turn)
    return place + math.rotate(quat, knob.pos), hand


def _angle(quat: Array, other: Array) -> Array:
    turn = math.multiply(math.conjugate(quat), other)
    return math.norm(math.rotation_vector(turn))


register_task("Assemble", Assemble)
register_teams("Assemble", Assemble, pandas=[3])
