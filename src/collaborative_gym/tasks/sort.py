"""Sort: a belt brings cubes past two to eight arms, each of which has a tote to fill.

The arms stand along the belt on alternating sides, `robot_1` first. Each has a colour,
and a tote beside it that no other arm needs to reach. One or two cubes of each colour
lie on the belt. The first comes in the lane on the arm's own side. All arms except
`robot_1` have a second cube, in the other side's lane, out of their reach. The previous
arm, which stands on that side, must move this cube to the middle of the belt, which
both arms reach. The belt does not wait: a cube that has passed its arm is lost.

Randomized: the joints of the arms; the cubes' positions along and across the belt, and
their turns about the vertical; which of the two cubes in a lane comes first.

Each arm observes three cubes in the frame of its own base: its `own cube`; the `mate's
cube`, which it moves to the middle; and the `moved cube`, its second. For each it sees
the position, and 1 while it must still handle the cube, else zeros. `next cube` is the
one that it handles now: the vector from its tool centre point, 1 if it is the mate's,
and 1 if it is within reach. For each other arm, the block `mates` has: 1 for its
presence, how many seats away it is (as a share of 7), whether it grips, and the vector
from the robot's own tool centre point to that arm's. It is alike for all team sizes.

Reward of each agent: "its cube" is the one in its hand, or else the next one that it
reaches or will reach; distances count up to 1 m.

- `reach`: minus the distance from its tool centre point to its cube, in m.
- `bring`: minus the distance from its cube to the agent's tote, or from the mate's cube
  to the middle of the belt, in m.
- `grip`: 0.1 while it asks for a grip within `picking_threshold` (0.03 m) of its cube.
- `waiting`: -3 for each of its cubes that it has not handled; -4 once the cube is lost.
- `effort`: minus 0.01 times the Euclidean norm of the joints' part of the action; in
  other action modes, of what the action asks of the joints.

Success: every cube lies in the tote of its colour, in no hand. Only its own arm can
fill a tote. Without an arm, its cubes are lost, and so is the one that it should move
for the next arm.

Coordination: `sorted` is the greatest share of cubes in their totes; `idle` is the mean
share of arms that waited, as in [Lift](lift.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import product
from operator import or_
from typing import ClassVar, NamedTuple

import numpy as np

from collaborative_gym import math
from collaborative_gym.blocks import POSE
from collaborative_gym.control import ActionMode, Commands
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.motion import alone, quickest_way
from collaborative_gym.motion.loads import Positions, from_base, greatest_loads, rounded
from collaborative_gym.objects.belt import TOTE, WALL, belt, tote
from collaborative_gym.objects.cube import cube
from collaborative_gym.objects.table import round_table
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import teams
from collaborative_gym.tasks.experts import sort as player
from collaborative_gym.tasks.experts.sort import HEIGHT, MIDDLE, SIZE
from collaborative_gym.tasks.handing import PICKING, either_way, of
from collaborative_gym.tasks.registry import register_task, register_teams
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import Blocks, Kept, Task, TaskConfig, Terms
from collaborative_gym.timing import CONTROL_DT

LANE = 0.28  # m from the middle of the belt to a lane
WINDOW = 0.32  # m along the belt, before and behind an arm, in which it picks up

_EDGE = 0.07  # m from a lane to the edge of the belt
_SEAT = 0.85  # m along the belt from an arm to the next one
_SPARE = 0.05  # m that an arm lacks to the lane at the other side
_ASIDE = 0.58  # of its reach, from an arm along the belt to its tote
_TOTE_FLOOR = 0.6  # m
_COMES = np.array([1.5, 8.0])  # s at which cubes of a lane come to an arm's window
_HOVER = 0.16  # m above what an arm picks up or fills, where it begins
_WIDE = 0.15  # m along the belt from an arm, where it surely picks up
_TILTS = 0.0, 0.4, 0.8  # rad, of a hand that picks up far away
_FARTHEST, _WAITING, _LOST = 1.0, 3.0, 4.0


@dataclass(frozen=True)
class SortConfig(TaskConfig):
    """Settings of Sort.

    Attributes:
      max_episode_steps: control steps of an episode.
      belt_speed: in m/s.
      picking_threshold: greatest distance at which a grip starts, in m.
    """

    max_episode_steps: int = 250
    belt_speed: float = bounded(0.1, 0.01, 0.2)
    picking_threshold: float = bounded(0.03, 0.0, 1.0)


@dataclass(frozen=True)
class SortFacts:
    """Facts of Sort, (num_envs, ...) each; the cubes are those of `Sort.cubes`."""

    joints: dict[str, Array]  # angles by agent, in rad
    tcp: dict[str, tuple[Array, Array]]  # pose of each agent's tcp
    grips: dict[str, Array]  # by agent, which cubes its grip holds, (num_envs, cubes)
    cubes: Array  # places, (num_envs, cubes, 3), in m
    put: Array  # which of them lie in their totes, (num_envs, cubes)
    lost: Array  # which have gone past the arm that must take them next
    to_do: dict[str, Array]  # by agent, which are still its to take or bring
    near: dict[str, Array]  # and which of these it could take now
    own: dict[str, Array]  # the index of the agent's cube, (num_envs,)
    sorted: Array  # share of `put`, (num_envs,)
    idle: Array  # share of the arms that wait, (num_envs,)


class Cube(NamedTuple):
    """A cube on the belt: whose it is, by index, and who must move it before, or -1."""

    owner: int
    mover: int


class Sort(Task[SortConfig, SortFacts]):
    """Take cubes from a belt and put each into the tote of its colour.

    Attributes:
      cubes: the cubes, in the order of their lanes.
      totes: middles of the totes' floors, by agent, (3,).
      angles: by agent, joint angles, (3, joints), in rad: above its lane, where it
        picks up from the middle of the belt, and above its tote.
      hands: by agent, the quaternion of its hand at each of these, (1, 4).
    """

    robot_counts = range(2, teams.MOST_MATES + 2)
    gripping = True
    config_class = SortConfig
    units: ClassVar[Mapping[str, str]] = {"sorted": "", "idle": ""}
    coordination: ClassVar[Mapping[str, Kept]] = {"sorted": "greatest", "idle": "mean"}
    block_units: ClassVar[Mapping[str, str]] = {
        "joints": "rad",
        "tcp": POSE,
        "tote": "m",
    }
    expert = player.expert

    def mounts(self) -> tuple[Placement, ...]:
        """Return arms along the belt, in turn at -y and at +y, that face it."""
        robots, placements = list(self.robots.values()), []
        for i, robot in enumerate(robots):
            side, x = 2 * (i % 2) - 1, _SEAT * (i - (len(robots) - 1) / 2)
            height = robot.base_height if robot.stand == "pedestal" else HEIGHT
            y = side * (_farthest(robot, HEIGHT + SIZE / 2 - height) + _SPARE - LANE)
            placements.append(Placement((x, y, height), -side * np.pi / 2))
        return tuple(placements)

    def build(self, scene: Scene) -> None:
        count, config = len(self.agents), self.config
        self.cubes = [Cube(i, -1) for i in range(count)]
        self.cubes += [Cube(i, i - 1) for i in range(1, count)]
        self._owners = np.array([each.owner for each in self.cubes])
        # Their owners take what nobody needs to move.
        self._movers = np.array(
            [c.owner if c.mover < 0 else c.mover for c in self.cubes]
        )
        bases = np.array([each.position for each in self.placements.values()])
        self._sides, self.seats = np.sign(bases[:, 1]), bases[:, 0]
        travel = config.belt_speed * CONTROL_DT * config.max_episode_steps
        length = np.ptp(self.seats) + 2 * travel + 6.0
        scene.add("belt", belt(length, 2 * (LANE + _EDGE)), position=(0, 0, HEIGHT))
        self.totes = {}
        for i, (agent, robot) in enumerate(self.robots.items()):
            place = self.placements[agent]
            own = robot.stand == "pedestal" or config.placements is not None
            scene.add_robot(agent, robot, placement=place, stand=own)
            scene.paint_hand(agent, teams.COLOURS[i])
            spot = bases[i] + np.array([_ASIDE * robot.reach, 0.0, 0.0])
            self.totes[agent] = spot = np.array([*spot[:2], _TOTE_FLOOR])
            scene.add(f"{agent}_tote", tote(teams.COLOURS[i]), position=spot)
            stand = round_table(TOTE, height=_TOTE_FLOOR - 0.008)
            scene.add(f"{agent}_tote_stand", stand, position=(*spot[:2], 0.0))
            if not own:
                teams.add_stand(scene, agent, place)
        for j, each in enumerate(self.cubes):
            scene.add(f"cube_{j + 1}", cube(SIZE, rgba=teams.COLOURS[each.owner]))
            for i in {each.owner, each.mover} - {-1}:
                site, most = f"cube_{j + 1}/centre", config.picking_threshold
                scene.add_grip(self.agents[i], site, threshold=most, width=0.05)
        wide = np.ptp(self.seats) + 1.5
        scene.spec.stat.extent = wide  # Shadows are sharper than those of a whole belt.
        away = np.array([0.32 * wide + 0.6, -0.38 * wide - 0.6, 0.34 * wide + 0.5])
        across, near = np.array([0.77, 0.64, 0.0]), 0.14 * (count > 3)
        near -= 0.15 * (count == 3)  # The third arm stands on the camera's side.
        eye = (1 - near) * away + 1.5 * abs(near) * across + (0.0, 0.0, 0.6)
        scene.add_camera(eye, (*across, *np.cross(away, across)))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        self._frames = teams.Frames(self.placements)
        cubes = [f"cube_{j + 1}/free" for j in range(len(self.cubes))]
        along = [sim.model.joint(name).dofadr[0] for name in ("belt/slide", *cubes)]
        self._moves = np.array(along)
        self.angles, self.hands = {}, {}
        for i, (agent, place) in enumerate(self.placements.items()):
            x, (*side, _) = self.seats[i], self.totes[agent]
            lane, tote = self._sides[i] * LANE, (*side, _TOTE_FLOOR + WALL + _HOVER)
            low = HEIGHT + SIZE / 2
            spots = [(x, lane, low + _HOVER), (x + _WIDE, 0.0, low), tote]
            spots = from_base(place, np.array(spots))
            self.angles[agent], hands = _stations(self.robots[agent], spots)
            yaw = math.from_yaw(np.array(place.yaw))
            self.hands[agent] = [math.multiply(yaw, hand)[None] for hand in hands]
            scene.postures[agent] = self.angles[agent][0]

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        spread, speed = self.config.randomization, self.config.belt_speed
        starts = {agent: angles[0] for agent, angles in self.angles.items()}
        self.start_arms(sim, env_ids, rng=rng, angles=starts)
        # In each lane, whether the cube for the next arm comes first.
        swapped = rng.uniform(0.0, 1.0, len(self.agents)) < 0.5
        for j, each in enumerate(self.cubes):
            lane = each.owner if each.mover < 0 else each.mover
            later = swapped[:, lane] ^ (each.mover >= 0)
            # The last arm has one cube alone.
            later = later & (lane + 1 < len(self.agents))
            x = self.seats[lane] - WINDOW - speed * _COMES[later.astype(int)]
            nominal = np.array([0.0, self._sides[lane] * LANE, HEIGHT + SIZE / 2])
            bounds = spread.object_position * np.array([1.0, 0.5, 0.0])
            place = nominal + rng.within(bounds, 3)
            place[:, 0] += x
            quat = math.from_yaw(rng.within(spread.object_yaw))
            self.scene.place(
                sim, env_ids, name=f"cube_{j + 1}", position=place, quat=quat
            )
        rows = np.asarray(env_ids)[:, None]
        sim.qvel[rows, self._moves] = speed

    def measure(self, sim: Sim) -> SortFacts:
        xp, grips = sim.xp, self._grips(sim)
        poses = [sim.pose(f"cube_{j + 1}/centre") for j in range(len(self.cubes))]
        places = xp.stack([place for place, _ in poses], axis=1)
        x, across = places[:, :, 0], places[:, :, 1]
        put, on_belt, fell = self._lie(places, reduce(or_, grips.values()))
        # A cube in its owner's lane, or in the middle, waits for its owner.
        owners = xp.asarray(self._owners)
        comes = across * xp.asarray(self._sides[self._owners]) > -MIDDLE
        takers = xp.where(comes, owners, xp.asarray(self._movers))
        behind = x - xp.asarray(self.seats)[takers]
        lost = (on_belt & (behind > WINDOW)) | fell
        to_do, near, own = {}, {}, {}
        for i, agent in enumerate(self.agents):
            moves = xp.asarray([each.mover == i for each in self.cubes])
            mine = (owners == i) | (moves & (~comes | grips[agent]))
            to_do[agent] = mine & ~put & ~lost
            waits = on_belt & (takers == i)
            near[agent] = to_do[agent] & waits & (behind > -WINDOW)
            order = xp.where(grips[agent], 1e3, xp.where(waits, x, x - 50.0))
            own[agent] = xp.argmax(xp.where(to_do[agent], order, -1e3), axis=1)
        return SortFacts(
            joints=self.joints(sim),
            tcp={agent: sim.pose(f"{agent}/tcp") for agent in self.agents},
            grips=grips,
            cubes=places,
            put=put,
            lost=lost,
            to_do=to_do,
            near=near,
            own=own,
            sorted=xp.mean(xp.astype(put, x.dtype), axis=1),
            idle=self.share_idle(sim, (xp.any(own, axis=1) for own in grips.values())),
        )

    def _grips(self, sim: Sim) -> dict[str, Array]:
        never, grips = sim.xp.zeros(sim.num_envs, dtype=sim.xp.bool), {}
        for i, agent in enumerate(self.agents):
            held = [never] * len(self.cubes)
            for j, each in enumerate(self.cubes):
                if i in each:
                    site = f"cube_{j + 1}/centre"
                    held[j] = self.scene.holds(sim, agent, site=site)
            grips[agent] = sim.xp.stack(held, axis=1)
        return grips

    def _lie(self, places: Array, is_held: Array) -> tuple[Array, Array, Array]:
        """Return which cubes lie in their totes, on the belt, and on the floor.

        What falls into its tote is nowhere yet.
        """
        xp, height = array_namespace(places), places[:, :, 2]
        totes = np.array(list(self.totes.values()))[self._owners]
        apart = xp.abs(places - xp.asarray(totes, dtype=places.dtype))
        inside = (apart[:, :, 0] < TOTE) & (apart[:, :, 1] < TOTE)
        put = inside & (height < _TOTE_FLOOR + WALL) & ~is_held
        loose = ~inside & ~is_held
        return put, loose & (height > HEIGHT), loose & (height < HEIGHT)

    def observe(self, facts: SortFacts) -> dict[str, Blocks]:
        return {agent: self._seen_by(agent, facts) for agent in self.agents}

    def _seen_by(self, agent: str, facts: SortFacts) -> Blocks:
        xp, frames = array_namespace(facts.cubes), self._frames
        i, tcp, kind = self.agents.index(agent), facts.tcp[agent], facts.cubes.dtype
        grips = {
            a: xp.astype(xp.any(held, axis=1), kind)[:, None]
            for a, held in facts.grips.items()
        }
        own, busy = facts.own[agent], xp.any(facts.to_do[agent], axis=1)
        way = frames.direction(agent, of(facts.cubes, own) - tcp[0])
        kinds = self.is_mates(agent, own), of(facts.near[agent], own)
        flags = xp.astype(xp.stack(kinds, axis=1), kind)
        now = xp.concat([way, flags], axis=1)
        nothing = xp.zeros_like(facts.cubes[:, 0, :1])
        seen = {"next cube": xp.where(busy[:, None], now, 0.0 * now)}
        for name, wanted in (
            ("own cube", Cube(i, -1)),
            ("mate's cube", Cube(i + 1, i)),
            ("moved cube", Cube(i, i - 1)),
        ):
            seen[name] = xp.concat([nothing] * 4, axis=1)
            if wanted in self.cubes:
                j = self.cubes.index(wanted)
                todo = xp.astype(facts.to_do[agent][:, j], kind)[:, None]
                place = frames.place(agent, facts.cubes[:, j])
                seen[name] = xp.concat([place * todo, todo], axis=1)
        spot = xp.asarray(self.totes[agent], dtype=kind)
        return {
            "joints": teams.alike(facts.joints[agent]),
            "gripping": grips[agent],
            "tcp": math.pose(*frames.pose(agent, tcp)),
            "tote": frames.place(agent, xp.broadcast_to(spot, tcp[0].shape)),
            **seen,
            "mates": teams.hands_block(frames, agent, tcps=facts.tcp, grips=grips),
        }

    def is_mates(self, agent: str, which: Array) -> Array:
        """Return which cubes, of these indices, an agent moves for its mate."""
        movers = [each.mover == self.agents.index(agent) for each in self.cubes]
        return array_namespace(which).asarray(movers)[which]

    def bring_to(self, agent: str, which: Array, tcp: Array) -> Array:
        """Return where an agent brings a cube of these indices, (num_envs, 3), in m."""
        xp, mates = array_namespace(tcp), self.is_mates(agent, which)
        spot = xp.asarray(self.totes[agent], dtype=tcp.dtype) + 0.0 * tcp
        x, zero = tcp[:, 0], 0.0 * tcp[:, 0]
        middle = xp.stack([x, zero, zero + HEIGHT + SIZE / 2], axis=1)
        return xp.where(mates[:, None], middle, spot)

    def reward(self, facts: SortFacts, commands: Commands) -> dict[str, Terms]:
        xp, terms = array_namespace(facts.cubes), {}
        zero = xp.zeros_like(facts.sorted)
        for i, (agent, command) in enumerate(commands.items()):
            own, tcp = facts.own[agent], facts.tcp[agent][0]
            place, busy = of(facts.cubes, own), xp.any(facts.to_do[agent], axis=1)
            far = math.distance(tcp, place)
            way = math.distance(place, self.bring_to(agent, own, place))
            wants = busy & command.grips & (far < self.config.picking_threshold)
            mine = xp.asarray([i in each for each in self.cubes])
            lost = xp.sum(xp.astype(facts.lost & mine, zero.dtype), axis=1)
            left = xp.sum(xp.astype(facts.to_do[agent], zero.dtype), axis=1)
            terms[agent] = {
                "reach": xp.where(busy, -xp.minimum(far, zero + _FARTHEST), zero),
                "bring": xp.where(busy, -xp.minimum(way, zero + _FARTHEST), zero),
                "grip": xp.where(wants, zero + 0.1, zero),
                "waiting": -_WAITING * left - _LOST * lost,
                "effort": -0.01 * math.norm(command.moves),
            }
        return terms

    def success(self, facts: SortFacts) -> Array:
        return array_namespace(facts.put).all(facts.put, axis=1)

    def shortfall(self, facts: SortFacts) -> Array:
        xp, owners = array_namespace(facts.cubes), [c.owner for c in self.cubes]
        totes = np.array(list(self.totes.values()))[owners]
        far = math.distance(facts.cubes, xp.asarray(totes, dtype=facts.cubes.dtype))
        missing = 1.0 + xp.minimum(far, 0.0 * far + 5.0) / 5.0
        return xp.mean(xp.where(facts.put, 0.0 * far, missing), axis=1)


def _farthest(robot: Robot, height: float) -> float:
    """Return how far before its base, at a height over it, an arm reaches, in m."""
    far = robot.reach * np.arange(0.7, 1.15, 0.02)
    places = np.stack([far, 0.0 * far, 0.0 * far + height], axis=1)
    loads = np.array(greatest_loads(robot, rounded(places)))
    return float(far[loads > 0.0].max(initial=0.0))


@lru_cache(maxsize=64)
def _stations(robot: Robot, spots: Positions) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return how an arm is above its lane, at the middle of the belt, above its tote.

    These are joint angles (3, joints), and quaternions of its hand in its base's frame.
    The hand points down, or as little away from the base as the arm needs.

    Raises:
      ValueError: if the arm cannot be there.
    """
    model, arm = alone(robot)
    failure = ValueError("no tilt was given")
    for tilt in _TILTS:
        lean = math.from_rotation_vector(np.array([0.0, -tilt, 0.0]))
        downs = either_way(PICKING)
        # At its tote, an arm has turned by a quarter.
        ends = [math.multiply(math.from_yaw(np.array(np.pi / 2)), d) for d in downs]
        ways = []
        for down, end in product(downs, ends):
            hands = math.multiply(lean, down), math.multiply(lean, down), end
            ways.append(list(zip(np.array(spots), hands, strict=True)))
        try:
            chosen, angles = quickest_way(model, arm, ways=ways)
        except ValueError as error:
            failure = error
        else:
            return angles, [hand for _, hand in ways[chosen]]
    raise failure


register_task("Sort", Sort)
register_teams("Sort", Sort, pandas=[2, 4, 8])
