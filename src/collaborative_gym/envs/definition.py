"""A task's definition, tried out once before anything is built on it."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from collaborative_gym.blocks import Block, Layout
from collaborative_gym.control import Commands
from collaborative_gym.envs.starts import draw_starts
from collaborative_gym.envs.wrists import FELT, felt_blocks
from collaborative_gym.errors import unknown
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import SHOULDER, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Task, named_facts

_NUMBERS = "bool", "integral", "real floating"  # kinds of which a block may be
_FARTHEST = 50.0  # distance of an object, in m; beyond it a place is in mm
_MEMORY = "it must give arrays by name, each with a row for each world"
_HAND, _TOOL = 0.3, 1.3  # what a hand, and its tool, add to an arm's reach, in m


@dataclass(frozen=True)
class Definition:
    """What follows from a task and its world."""

    layout: Layout  # the blocks of observations and the parts of actions
    observation_spaces: dict[str, Box]  # of one world's flat view, by agent
    action_spaces: dict[str, Box]  # of one world, by agent
    reward_terms: dict[str, tuple[str, ...]]  # names of a reward's parts, by agent
    sides: dict[str, tuple[str, ...]]  # the agents of each side, by its name


def try_out(task: Task, scene: Scene, sim: Sim, feel: Callable) -> Definition:
    """Return the consequences of a task's definition, tried at an episode's start.

    `feel` is `World.feel`.

    Raises:
      ValueError: if the task's methods return something that cannot be used, something
        starts inside something else, or no arm reaches a target; says what to change.
    """
    rows, mode = np.arange(min(sim.num_envs, 2)), task.action_mode
    trial = Trial(task, sim, rows)
    trial.check_grips(scene)
    for count in 1, sim.num_envs:
        trial.check_memory(task.remember(count), count)
    sim.memory = task.remember(sim.num_envs)
    draw_starts(task, sim, mode, rows, EpisodeRandom(0 * rows, rows))
    sim.forward()
    trial.check_targets(scene)
    idle = {a: sim.xp.asarray(rows) for a, rows in mode.idle(sim.num_envs).items()}
    blocks, terms = trial.check(task.measure(sim), mode.commands(idle))
    for agent, felt in feel(sim).items():
        blocks = {**blocks, agent: {**blocks[agent], **felt_blocks(task.config, felt)}}
    named = {
        agent: {name: trial.block(name, each) for name, each in blocks[agent].items()}
        for agent in task.agents
    }
    layout = Layout(named, {agent: mode.parts(agent) for agent in task.agents})
    seen, done = layout.observation_sizes.items(), layout.action_sizes.items()
    return Definition(
        layout=layout,
        observation_spaces={a: Box(-np.inf, np.inf, (n,), np.float32) for a, n in seen},
        action_spaces={a: Box(-1.0, 1.0, (n,), np.float32) for a, n in done},
        reward_terms={agent: tuple(terms[agent]) for agent in task.agents},
        sides=trial.sides,
    )


class Trial:
    """Checks what methods return of all worlds, or of those that just `started`."""

    def __init__(self, task: Task, sim: Sim, started: np.ndarray | None = None):
        self._name, self._task, self._sim = type(task).__name__, task, sim
        self._rows, self._when = slice(None), ""
        if started is not None:
            self._rows, self._when = started, " at the start of an episode"
        self.sides = self._sides()

    def check(self, facts: Any, commands: Commands) -> tuple[Any, Any]:
        """Return blocks and terms; raise ValueError if a return cannot be used."""
        task = self._task
        if facts is None:
            raise ValueError(f"{self._name}.measure() returns nothing")
        self.check_memory(self._sim.memory, self._sim.num_envs, "measure")
        blocks, terms = task.observe(facts), task.reward(facts, commands)
        self._check_blocks(blocks)
        self._check_terms(terms)
        self.check_masks("success", task.success(facts))
        performing, over = task.performing(facts), task.over(facts)
        for method, mask in (("performing", performing), ("over", over)):
            if mask is not None:
                self.check_masks(method, mask)
        if self._when and over is not None and self._sim.xp.any(over[self._rows]):
            raise ValueError(
                f"{self._name}.over() ends an episode at its start; begin episodes in"
                " a state that is not over"
            )
        self._check_score(task.score(facts))
        self._check_coordination(facts)
        return blocks, terms

    def check_memory(self, memory: Any, worlds: int, method: str = "remember") -> None:
        """Raise unless a method gives arrays to remember, as `remember` does."""
        what = f"{self._name}.{method}()"
        if not isinstance(memory, Mapping):
            raise ValueError(f"{what} is {_kind(memory)}; {_MEMORY}")
        if odd := memory.keys() ^ (own := self._task.remember(worlds)).keys():
            said = f"measure() and remember() differ in {sorted(odd)}"
            raise ValueError(f"{self._name}: {said}")
        for name, array in memory.items():
            if not hasattr(array, "dtype") or np.shape(array)[:1] != (worlds,):
                said = f"{name!r} is {_kind(array)} for {worlds} world(s)"
                raise ValueError(f"{what}: {said}; {_MEMORY}")
            made, first = (f"{x.dtype} {x.shape}" for x in (array, own[name]))
            if made != first:
                said = f"makes sim.memory[{name!r}] {made}, which was {first}"
                raise ValueError(f"{what} {said} in remember(); keep type and shape")

    def check_grips(self, scene: Scene) -> None:
        """Raise unless a scene has grips where actions close them, and only there."""
        if bool(scene.grips) != self._task.gripping:
            does = "adds" if scene.grips else "adds no"
            raise ValueError(
                f"{self._name}.build() {does} grips, but {self._name}.gripping is"
                f" {self._task.gripping}; set `gripping = {bool(scene.grips)}`"
            )

    def check_targets(self, scene: Scene) -> None:
        """Raise if a target is so far away that no arm can bring anything there."""
        targets = scene.targets(self._sim)
        for name, place in (scene.objects(self._sim) | targets).items():
            if (far := max(abs(float(place[0, i])) for i in range(3))) > _FARTHEST:
                raise ValueError(
                    f"{self._name}: {name!r} is {far:.0f} m away; give m, not mm"
                )
        task, placements = self._task, self._task.placements
        for target, places in targets.items():
            place, missing = np.array([float(places[0, i]) for i in range(3)]), {}
            for agent, placement in placements.items():
                far = np.linalg.norm(place - np.array(placement.position) - SHOULDER)
                more = _TOOL if scene.tools else _HAND
                missing[agent] = float(far) - task.robots[agent].reach - more
            if min(missing.values()) > 0.0:
                listed = [f"{agent}'s by {far:.2f} m" for agent, far in missing.items()]
                raise ValueError(
                    f"{self._name}: {target!r} at {np.round(place, 2).tolist()} is out"
                    f" of every arm's reach ({', '.join(listed)}); put it nearer to an"
                    " arm, or mount an arm nearer to it"
                )

    def _check_blocks(self, blocks: Any) -> None:
        worlds = self._sim.num_envs
        for what, rows in self._each("observe", "block", blocks):
            shape = np.shape(rows)
            if len(shape) < 2 or shape[0] != worlds or 0 in shape:
                raise ValueError(
                    f"{what} has shape {shape}; it needs a row for each world,"
                    f" ({worlds}, k) or with more axes: index one number per world as"
                    " [:, None]"
                )
            self._check_finite(what, rows)

    def block(self, name: str, rows: Array) -> Block:
        """Return the kind of a checked block."""
        task = self._task
        is_real = self._sim.xp.isdtype(rows.dtype, "real floating")
        dtype = "float32" if is_real else str(rows.dtype).removeprefix("torch.")
        units = FELT | dict(task.block_units)
        unit = units.get(name, units.get(plain_name(name, task.agents), ""))
        return Block(name, tuple(rows.shape[1:]), dtype, unit)

    def _check_terms(self, terms: Any) -> None:
        for what, values in self._each("reward", "term", terms):
            self._check_numbers(what, values)

    def check_masks(self, method: str, given: Any) -> None:
        """Raise unless a method gives a bool for each world, or for each of a side."""
        for what, mask in self._by_side(method, given):
            kind = getattr(mask, "dtype", type(mask).__name__)
            worlds = self._sim.num_envs
            if np.shape(mask) != (worlds,) or kind != self._sim.xp.bool:
                raise ValueError(
                    f"{what} is {kind} of shape {np.shape(mask)}; it needs a bool for"
                    f" each world, ({worlds},), as a comparison gives"
                )

    def _check_score(self, points: Any) -> None:
        if points is None:
            return
        if len(self.sides) == 1:
            raise ValueError(
                f"{self._name}.score() is for tasks of several sides; a single one is"
                " judged by success() and reward()"
            )
        for what, gained in self._by_side("score", points):
            self._check_numbers(what, gained)

    def _check_coordination(self, facts: Any) -> None:
        facts, what = named_facts(facts), f"{self._name}.coordination"
        if self._task.coordination and len(self.sides) > 1:
            raise ValueError(f"{what} is for tasks of one side; leave it out")
        for name in self._task.coordination:
            if name not in facts:
                raise ValueError(f"{what}: {unknown('fact', name, facts)}")
            self._check_numbers(f"{what}: {name}", facts[name])
            values: Any = facts[name][self._rows]
            # A share of what has a goal may exceed it later, as BalancePath's lap does.
            most = np.inf if self._task.units.get(name) or not self._when else 1 + 1e-9
            if self._sim.xp.any(wrong := (values < 0.0) | (values > most)):
                raise ValueError(
                    f"{what}: {name} is {values[wrong][0]:.3g}; it must be at least 0,"
                    " and at most 1 unless `units` has its unit"
                )

    def _sides(self) -> dict[str, tuple[str, ...]]:
        task = self._task
        try:
            sides = {f"side_{i + 1}": tuple(own) for i, own in enumerate(task.sides)}
        except TypeError:
            sides = {}
        members = [str(agent) for own in sides.values() for agent in own]
        if sorted(members) != sorted(task.agents) or not all(sides.values()):
            raise ValueError(
                f"{self._name}.sides is {task.sides!r}; each of"
                f" {', '.join(task.agents)} must be on exactly one side, and no side"
                " empty"
            )
        return sides

    def _each(self, method: str, kind: str, given: Any) -> Iterator[tuple[str, Array]]:
        """Yield what to call each named array that a method returned, and the array."""
        method, agents = f"{self._name}.{method}()", self._task.agents
        if not isinstance(given, Mapping):
            raise ValueError(
                f"{method} returns a {type(given).__name__}; it must return a"
                f" dictionary with an entry for each of {', '.join(agents)}"
            )
        for agent in given:
            if agent not in agents:
                raise ValueError(f"{method}: {unknown('agent', agent, agents)}")
        for agent in agents:
            if agent not in given:
                raise ValueError(f"{method} has no entry for {agent}; add one")
            named = given[agent]
            if not isinstance(named, Mapping) or not named:
                raise ValueError(
                    f"{method}: the entry of {agent} is {_kind(named)}; it must be a"
                    " dictionary of named arrays"
                )
            for name, array in named.items():
                yield f"{method}: {kind} {name!r} of {agent}", array

    def _by_side(self, method: str, given: Any) -> list[tuple[str, Any]]:
        what, sides = f"{self._name}.{method}()", self.sides
        if len(sides) == 1 or method == "over":
            return [(what, given)]
        if not isinstance(given, tuple) or len(given) != len(sides):
            raise ValueError(
                f"{what} is {_kind(given)}; a task of {len(sides)} sides returns a"
                " tuple with an array for each, in the order of its sides"
            )
        return [(f"{what} of {s}", own) for s, own in zip(sides, given, strict=True)]

    def _check_numbers(self, what: str, values: Any) -> None:
        shape, worlds = np.shape(values), self._sim.num_envs
        if shape != (worlds,):
            raise ValueError(
                f"{what} has shape {shape}; it needs one number for each world,"
                f" ({worlds},)"
            )
        self._check_finite(what, values)

    def _check_finite(self, what: str, values: Any) -> None:
        xp, kind = self._sim.xp, getattr(values, "dtype", type(values).__name__)
        if isinstance(kind, str) or not xp.isdtype(kind, _NUMBERS):
            raise ValueError(
                f"{what} is of type {kind}; it must be an array of real numbers,"
                " integers or booleans"
            )
        if not xp.all(xp.isfinite(values[self._rows])):
            raise ValueError(
                f"{what} is not finite{self._when}; look for a division by zero, or for"
                " a place that reset() does not write"
            )


def plain_name(name: str, agents: Collection[str]) -> str:
    """Return a block's name without agents and numbers, as `block_units` has it."""
    return " ".join(w for w in name.split() if w not in agents and not w.isdigit())


def _kind(thing: Any) -> str:
    """Return a short description of a value, without hundreds of numbers."""
    if isinstance(thing, Mapping):
        return "an empty dictionary"
    shape = f" of shape {thing.shape}" if hasattr(thing, "shape") else ""
    return f"of type {type(thing).__name__}{shape}"
