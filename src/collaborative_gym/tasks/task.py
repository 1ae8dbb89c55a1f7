"""The base of tasks: a world to build, facts to measure, rewards and a goal."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, Literal, Self, TypeVar

import numpy as np

from collaborative_gym.control import ActionMode, Command, Motion, get_mode
from collaborative_gym.errors import check_count, check_kind, look_up
from collaborative_gym.math import Array
from collaborative_gym.motion import Chains
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.scene.grasps import get_grasp
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.randomization import Randomization, presets
from collaborative_gym.tasks.settings import check_settings

Blocks = Mapping[str, Array]
"""Named parts of an observation, (num_envs, *shape) each, in order."""

Terms = Mapping[str, Array]
"""Named parts of a reward, (num_envs,) each."""

Kept = Literal["mean", "greatest"]
"""The value of a fact over an episode's steps that metrics keep."""

LEVEL = np.array([1.0, 1.0, 0.0])
"""Axes along which an object on a table may move."""

_STILL = 0.02  # share of its speed limit below which a joint stands still; our choice

STYLE_DRAWS = 3
"""Count of numbers that each episode draws for the styles of an expert."""

WRENCHES = "off", "raw", "compensated"
"""Values of `TaskConfig.wrench`."""

RANDOMIZATIONS = presets(Randomization())
"""The presets of tasks that have none of their own."""


@dataclass(frozen=True)
class TaskConfig:
    """Settings that every task has; a task may add its own.

    Attributes:
      randomization: how episode starts are drawn.
      placements: where the arms are mounted, or None for the task's rule.
      max_episode_steps: control steps of an episode.
      wrench: whether robots observe force and torque at their wrists, as `envs.wrists`
        describes: "off", "raw", or "compensated" for the weight of hand and tool.
      pad_force: whether robots observe the force in N with which each of two pads
        presses a held object; it is 0 unless `grasp` is "pinch" or "friction".
      action: what actions mean, by the name of an action mode, such as "joints" or
        "tcp"; `control.list_modes` has them.
      grasp: how hands hold things, where a task has grips: "magnet", "suction",
        "pinch" or "friction"; `scene.grasps` describes them.
    """

    randomization: Randomization = field(default_factory=Randomization)
    placements: tuple[Placement, ...] | None = None
    max_episode_steps: int = 200
    action: str = "joints"
    wrench: str = "off"
    pad_force: bool = False
    grasp: str = "magnet"

    def __post_init__(self) -> None:
        check_settings(self)
        check_kind("action", self.action, str, "the name of an action mode")
        get_mode(self.action)
        check_kind("grasp", self.grasp, str, "the name of a grasp")
        get_grasp(self.grasp)
        check_kind("wrench", self.wrench, str, "the name of a kind of wrench")
        look_up("wrench mode", self.wrench, dict.fromkeys(WRENCHES))
        if self.max_episode_steps is not None:  # Where a task has a rule of its own.
            check_count("max_episode_steps", self.max_episode_steps, 1, 10**9)
        how, placements = self.randomization, self.placements
        check_kind("randomization", how, Randomization, "a Randomization")
        if placements is not None:
            checked = _check_placements("placements", placements)
            object.__setattr__(self, "placements", checked)


def _check_placements(name: str, given: Any) -> tuple[Placement, ...]:
    check_kind(name, given, Sequence, "a Placement for each arm")
    for placement in given:
        check_kind(f"each of {name}", placement, Placement, "a Placement")
    return tuple(given)


def columns(what: str, by_agent: Mapping[str, Array]) -> dict[str, Array]:
    """Return one array of each agent as blocks, such as "robot_1 joints"."""
    return {f"{agent} {what}": rows for agent, rows in by_agent.items()}


def named_facts(facts: Any) -> Mapping[str, Any]:
    """Return a task's facts by their names, or none if they have no names."""
    return facts if isinstance(facts, Mapping) else getattr(facts, "__dict__", {})


ConfigT = TypeVar("ConfigT", bound=TaskConfig)
FactsT = TypeVar("FactsT")


class Task(Generic[ConfigT, FactsT]):
    """The base of all tasks.

    A task has no state; what it must remember between steps is in `Sim.memory`. The
    methods after `measure` are pure functions of the facts. Arrays have a leading
    num_envs axis and may be NumPy's or torch's.

    Attributes:
      name: the environment id or task's name that made it; else that of its class.
      robot_counts: how many arms the task can have; the first is the usual number.
      gripping: whether actions have a grip component.
      config_class: the class of its settings.
      success_after: the goal counts as reached only after this many control steps.
      success_for: the goal counts as reached only once it has been met for this many
        control steps in a row.
      styles: other ways of the expert, a sentence for each by its name.
      performance_from_start: whether performance counts over the whole episode,
        instead of from the step at which the goal was first reached.
      colours: names of the colours of sides that play against each other.
      randomizations: how starts may be drawn, by the names of presets.
      units: units of the facts that are single numbers, by name; viewers show them.
      coordination: facts of the task that say how the arms work together, (num_envs,)
        numbers of at least 0, and what metrics keep of the steps until the goal is
        first reached: "mean" or "greatest". Without a unit they are shares from 0 to 1.
      block_units: of the blocks of observations, by their names; "robot_1 joints" and
        "ball 2" also go by "joints" and "ball".
      agents: the agents' names, "robot_1" and so on.
      robots: the arm of each agent.
      config: the settings.
      given: the settings before the task filled in those that are None.
      worlds: the compiled worlds of this task and its variations.
    """

    robot_counts: Sequence[int] = (2,)
    gripping: bool = False
    config_class: type[TaskConfig] = TaskConfig
    success_after: int = 0
    success_for: int = 1
    performance_from_start: bool = False
    colours: Sequence[str] = ()
    styles: ClassVar[Mapping[str, str]] = {}
    randomizations: ClassVar[Mapping[str, Randomization]] = RANDOMIZATIONS
    units: ClassVar[Mapping[str, str]] = {}
    coordination: ClassVar[Mapping[str, Kept]] = {}
    block_units: ClassVar[Mapping[str, str]] = {}

    def __init__(self, robots: Sequence[Robot], config: ConfigT):
        self.name = type(self).__name__
        self.agents = tuple(f"robot_{i + 1}" for i in range(len(robots)))
        self.robots = dict(zip(self.agents, robots, strict=True))
        self.given = config
        self._take(config)
        self.worlds: dict[bool, Any] = {}

    def __getstate__(self) -> dict[str, Any]:
        # What is compiled belongs to the process; copies are compiled anew.
        return vars(self) | {"worlds": {}}

    def varied(self, **changes: Any) -> Self:
        """Return the same task with other episodes in the same compiled world.

        Args:
          **changes: new values of `randomization` or `max_episode_steps`.

        Raises:
          ValueError: for another setting, which the world may depend on, or for
            mishaps of a task that has none.
        """
        others = changes.keys() - {"randomization", "max_episode_steps"}
        if others:
            raise ValueError(
                f"{', '.join(sorted(others))} may change the world; make another task"
                " with cg.task"
            )
        other = copy(self)
        other.worlds = self.worlds
        other.given = replace(self.given, **changes)
        other._take(replace(self.config, **changes))
        return other

    def _take(self, config: ConfigT) -> None:
        if config.randomization.lost and type(self).mishap is Task.mishap:
            raise ValueError(
                f"{type(self).__name__} has no mishap() after which episodes could"
                ' begin; give another randomization, such as "default", or lost=0.0'
            )
        if config.grasp != TaskConfig.grasp and not self.gripping:
            raise ValueError(
                f"{type(self).__name__} has no grips, so grasp={config.grasp!r} would"
                " change nothing; leave it out"
            )
        self.config = config

    @property
    def sides(self) -> tuple[tuple[str, ...], ...]:
        """The agents that share one goal: all of them, unless a task divides them.

        Every agent is on exactly one side. Where there are several, each side has a
        goal, a return and metrics of its own.
        """
        return (self.agents,)

    @property
    def summary(self) -> str:
        """What the robots are to do: the first line of the class's docstring."""
        return (type(self).__doc__ or self.name).partition("\n")[0]

    @property
    def progress_name(self) -> str | None:
        """The fact of `coordination` that measures progress, if one does."""
        kept = self.coordination
        return next((name for name in kept if kept[name] == "greatest"), None)

    @property
    def placements(self) -> dict[str, Placement]:
        """Where each agent's arm is mounted.

        Raises:
          ValueError: if these arms cannot be placed, or not each has one placement.
        """
        placements = self.config.placements
        if placements is None:
            name = f"what {type(self).__name__}.mounts() returns"
            placements = _check_placements(name, self.mounts())
        if len(placements) != len(self.agents):
            raise ValueError(
                f"got {len(placements)} placements for {len(self.agents)} robots; give"
                " one for each"
            )
        return dict(zip(self.agents, placements, strict=True))

    def mounts(self) -> tuple[Placement, ...]:
        """Return where arms of this reach and base height are mounted.

        Unless a task says otherwise they stand in a row, facing +x and 1.4 m apart,
        so that each easily reaches what is 0.8 m in front of the row.

        Raises:
          ValueError: if no placement lets these arms do the task.
        """
        last, placements = len(self.agents) - 1, []
        for i, robot in enumerate(self.robots.values()):
            x, y = 0.8 - 0.635 * robot.reach, 1.4 * i - 0.7 * last
            placements.append(Placement((x, y, robot.base_height)))
        return tuple(placements)

    def build(self, scene: Scene) -> None:
        """Fill the scene with arms and objects."""
        raise self._missing("build")

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        """Keep what later calls need of the compiled world, such as start poses.

        Args:
          scene: the compiled scene.
          sim: its worlds.
          action_mode: what actions mean; its `torques` are what arms exert.
        """
        self.scene, self.action_mode = scene, action_mode
        self.model, self.xp = sim.model, sim.xp

    def remember(self, num_envs: int) -> dict[str, Array]:
        """Return the `Sim.memory` of that many fresh worlds, arrays of `self.xp`."""
        return {}

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """Write the start of an episode into these worlds, and only these.

        Draws are NumPy's arrays; `start_arms` and the scene's `place` and `bend` turn
        them into what the worlds need.

        Args:
          sim: the worlds, these ones just reset to the model's initial state.
          env_ids: which worlds start an episode.
          rng: their generators, in the same order.
        """
        raise self._missing("reset")

    def mishap(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """Turn starts that `reset` wrote into starts after a mishap that can be undone.

        Tasks without it have no such starts. The arguments are those of `reset`.
        """
        raise self._missing("mishap")

    def start(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        """Write starts by `reset`, and by `mishap` in the share that is `lost`.

        The arguments are those of `reset`.
        """
        self.reset(sim, env_ids, rng=rng)
        # Drawn last, so that other episodes start as they would without it.
        if lost := self.config.randomization.lost:
            rows = np.flatnonzero(rng.uniform(0.0, 1.0) < lost)
            if rows.size:
                self.mishap(sim, env_ids[rows], rng=rng.rows(rows))

    def start_arms(
        self,
        sim: Sim,
        env_ids: np.ndarray,
        *,
        rng: EpisodeRandom,
        angles: Mapping[str, Array] | None = None,
    ) -> None:
        """Put the arms near these angles, as far away as the randomization says.

        Args:
          sim: as in `reset`.
          env_ids: as in `reset`.
          rng: as in `reset`.
          angles: by agent, (joints,) or (worlds, joints), in rad; None for home.
        """
        for agent, arm in self.scene.arms.items():
            start = np.array(arm.robot.home) if angles is None else angles[agent]
            noise = rng.within(self.config.randomization.joint_noise, arm.num_joints)
            self.scene.bend(sim, env_ids, agent=agent, angles=start + noise)

    @cached_property
    def chains(self) -> Chains:
        """The kinematics of its arms, in the order of the agents."""
        return Chains(self.model, list(self.scene.arms.values()))

    def joints(self, sim: Sim) -> dict[str, Array]:
        """Return copies of the arms' joint angles by agent, (num_envs, joints)."""
        arms, asarray = self.scene.arms.items(), sim.xp.asarray
        return {a: asarray(sim.qpos[:, arm.qpos], copy=True) for a, arm in arms}

    def share_idle(self, sim: Sim, holds: Iterable[Array] = ()) -> Array:
        """Return the share of the arms that wait now, (num_envs,).

        They hold nothing, and each of their joints is slower than 2 % of its limit.

        Args:
          sim: the worlds.
          holds: whether each arm holds something, (num_envs,), in the agents' order.
        """
        xp, (slowest, owners) = sim.xp, self._motion
        moves = xp.astype(xp.abs(sim.qvel) > xp.asarray(slowest), xp.float64)
        busy = xp.matmul(moves, xp.asarray(owners)) > 0.0
        if holds := list(holds):
            busy = busy | xp.stack(holds, axis=1)
        return 1.0 - xp.mean(xp.astype(busy, xp.float64), axis=1)

    @cached_property
    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Speeds from which degrees of freedom move, and whose they are, (nv, arms)."""
        slowest = np.full(self.model.nv, np.inf)
        owners = np.zeros((self.model.nv, len(self.agents)))
        for i, agent in enumerate(self.agents):
            arm = self.scene.arms[agent]
            slowest[arm.dof] = _STILL * np.array(arm.robot.velocity_limits)
            owners[arm.dof, i] = 1.0
        return slowest, owners

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        """Write what pushes the worlds during the coming control step.

        Args:
          sim: the worlds.
          steps: (num_envs,) control steps done, less than `max_episode_steps`.
        """

    def measure(self, sim: Sim) -> FactsT:
        """Return everything that the task looks at, computed once per control step.

        A second call in the same state must return the same and leave `sim.memory` as
        it is, because worlds are measured again when others start an episode. It puts
        new arrays into `sim.memory` and never writes into the old ones, because a step
        that fails is undone.
        """
        raise self._missing("measure")

    def observe(self, facts: FactsT) -> dict[str, Blocks]:
        """Return each agent's observation as named blocks."""
        raise self._missing("observe")

    def reward(self, facts: FactsT, commands: dict[str, Command]) -> dict[str, Terms]:
        """Return each agent's reward as named terms; their sum is the reward.

        Args:
          facts: of the state after the control step.
          commands: what each agent's action asked of its arm, in the same terms
            whatever actions mean: `moves` and `grips`.
        """
        raise self._missing("reward")

    def success(self, facts: FactsT) -> Array | tuple[Array, ...]:
        """Return in which worlds the goal is reached now, (num_envs,) booleans.

        A task of several sides returns a tuple of them, in the order of `sides`.
        """
        raise self._missing("success")

    def shortfall(self, facts: FactsT) -> Array:
        """Return how far each world is from the goal, (num_envs,), 0 where it is met.

        It is not part of any reward; `certify` searches by it. The default is 1
        wherever the goal is not met, so the search is blind. A task of several sides
        cannot be certified and needs none.
        """
        return self.xp.where(self.success(facts), 0.0, 1.0)

    def performing(self, facts: FactsT) -> Array | tuple[Array, ...] | None:
        """Return in which worlds this step counts towards performance, like `success`.

        None, as here, counts the steps at which the goal is reached.
        """
        return None

    def score(self, facts: FactsT) -> tuple[Array, ...] | None:
        """Return the points that each side gains in this step, (num_envs,) numbers.

        It is called once per control step; the order is that of `sides`. At the end of
        an episode the side with more points has won, and equal points are a draw. Only
        a task of several sides has a score. Return None, as here, if a side gains one
        point when it first reaches its goal.
        """
        return None

    def over(self, facts: FactsT) -> Array | None:
        """Return which episodes end now, before their time, (num_envs,) booleans.

        Return None, as here, if only time ends an episode.
        """
        return None

    def expert(self, sim: Sim, facts: FactsT) -> dict[str, Motion]:
        """Return a scripted expert's motions, by agent; it may look at the whole state.

        Experts compute with NumPy, and so play on NumPy's worlds only.
        """
        raise self._missing("expert", " or play another policy, such as random")

    def styled(
        self, sim: Sim, facts: FactsT, *, style: str, draws: np.ndarray
    ) -> dict[str, Motion]:
        """Return the expert's motions in one of its `styles`.

        Args:
          sim: the worlds.
          facts: of their present state.
          style: the style's name.
          draws: (num_envs, `STYLE_DRAWS`) numbers from -1 to 1, drawn for each episode,
            for styles that differ from one episode to the next.
        """
        raise self._missing("styled")

    def _missing(self, method: str, otherwise: str = "") -> NotImplementedError:
        near = difflib.get_close_matches(method, vars(type(self)), 1)
        hint = f" (or is {near[0]!r} it?)" if near else ""
        return NotImplementedError(
            f"{type(self).__name__} has no {method}(){hint}; write one{otherwise}"
        )
