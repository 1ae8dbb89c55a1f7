"""A task's definition, tried out once before anything is built on it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from collaborative_gym.blocks import Block, Layout
from collaborative_gym.errors import unknown
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import SHOULDER, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Blocks, Task, Terms

_NUMBERS = "bool", "integral", "real floating"
"""Kinds of numbers of which a block may be."""

_HAND = 0.3  # what a hand, and what it holds, add to an arm's rated reach, in m


@dataclass(frozen=True)
class Definition:
    """What follows from a task and its world."""

    layout: Layout  # the blocks of observations and the parts of actions
    observation_spaces: dict[str, Box]  # of one world's flat view, by agent
    action_spaces: dict[str, Box]  # of one world, by agent
    reward_terms: dict[str, tuple[str, ...]]  # names of a reward's parts, by agent
    sides: dict[str, tuple[str, ...]]  # the agents of each side, by its name


def try_out(task: Task, scene: Scene, sim: Sim) -> Definition:
    """Return what follows from a task's definition, tried out at an episode's start.

    Raises:
      ValueError: if the task's methods return something that cannot be used, or a
        target is out of every arm's reach; says what to change.
    """
    name, mode = type(task).__name__, task.action_mode
    tried = np.arange(min(sim.num_envs, 2))
    sim.memory = task.remember(sim.num_envs)
    task.reset(sim, tried, rng=EpisodeRandom(0 * tried, tried))
    mode.start(tried)
    sim.forward()
    _check_targets(name, task, scene, sim)
    facts = task.measure(sim)
    blocks = task.observe(facts)
    _check_blocks(name, task, blocks, tried, sim)
    idle = {a: sim.xp.asarray(rows) for a, rows in mode.idle(sim.num_envs).items()}
    terms = task.reward(facts, mode.commands(idle))
    _check_terms(name, task, terms, tried, sim)
    sides = _sides(name, task)
    for method in ("success", "performing"):
        given = getattr(task, method)(facts)
        if method == "performing" and given is None:
            continue
        for what, mask in _by_side(f"{name}.{method}()", given, sides):
            _check_mask(what, mask, sim)
    _check_score(f"{name}.score()", task.score(facts), sides, tried, sim)
    _check_over(f"{name}.over()", task.over(facts), tried, sim)
    layout = Layout(
        {
            agent: {b: _block(task, b, rows, sim.xp) for b, rows in own.items()}
            for agent, own in ((agent, blocks[agent]) for agent in task.agents)
        },
        {agent: mode.parts(agent) for agent in task.agents},
    )
    seen, done = layout.observation_sizes.items(), layout.action_sizes.items()
    return Definition(
        layout=layout,
        observation_spaces={a: Box(-np.inf, np.inf, (n,), np.float32) for a, n in seen},
        action_spaces={a: Box(-1.0, 1.0, (n,), np.float32) for a, n in done},
        reward_terms={agent: tuple(terms[agent]) for agent in task.agents},
        sides=sides,
    )


def _check_targets(name: str, task: Task, scene: Scene, sim: Sim) -> None:
    """Raise if a target is so far away that no arm can bring anything there."""
    if scene.tools:
        return  # How far they reach is not known here.
    bases = {a: np.array(p.position) for a, p in task.placements.items()}
    for target, places in scene.targets(sim).items():
        place = np.array([float(places[0, i]) for i in range(3)])
        room = {
            agent: task.robots[agent].reach
            + _HAND
            - float(np.linalg.norm(place - bases[agent] - SHOULDER))
            for agent in task.agents
        }
        if max(room.values()) < 0.0:
            listed = ", ".join(
                f"{agent}'s by {-missing:.2f} m" for agent, missing in room.items()
            )
            raise ValueError(
                f"{name}: {target!r} at {np.round(place, 2).tolist()} is out of every"
                f" arm's reach ({listed}); put it nearer to an arm, or mount an arm"
                " nearer to it"
            )


def _check_blocks(
    name: str, task: Task, blocks: Mapping[str, Blocks], tried: np.ndarray, sim: Sim
) -> None:
    for what, rows in _each(f"{name}.observe()", "block", task, blocks):
        shape, kind = np.shape(rows), getattr(rows, "dtype", type(rows).__name__)
        if len(shape) < 2 or shape[0] != sim.num_envs:
            raise ValueError(
                f"{what} has shape {shape}; it needs a row for each world,"
                f" ({sim.num_envs}, k) or with more axes: index one number per world"
                " as [:, None]"
            )
        if not hasattr(rows, "dtype") or not sim.xp.isdtype(kind, _NUMBERS):
            raise ValueError(
                f"{what} is of type {kind}; it must be an array of real numbers,"
                " integers or booleans"
            )
        _check_finite(what, rows, tried, sim)


def _block(task: Task, name: str, rows: Array, xp: Any) -> Block:
    """Return what a checked block is."""
    is_real = xp.isdtype(rows.dtype, "real floating")
    dtype = "float32" if is_real else str(rows.dtype).removeprefix("torch.")
    words = [w for w in name.split() if w not in task.agents and not w.isdigit()]
    units = task.block_units
    unit = units.get(name, units.get(" ".join(words), ""))
    return Block(name, tuple(rows.shape[1:]), dtype, unit)


def _check_terms(
    name: str, task: Task, terms: Mapping[str, Terms], tried: np.ndarray, sim: Sim
) -> None:
    for what, values in _each(f"{name}.reward()", "term", task, terms):
        if np.shape(values) != (sim.num_envs,):
            raise ValueError(
                f"{what} has shape {np.shape(values)}; it needs one number for"
                f" each world, ({sim.num_envs},)"
            )
        _check_finite(what, values, tried, sim)


def _each(
    method: str, kind: str, task: Task, given: Any
) -> Iterator[tuple[str, Array]]:
    """Yield what to call each named array that a method returned, and the array."""
    if not isinstance(given, Mapping):
        raise ValueError(
            f"{method} returns a {type(given).__name__}; it must return a dictionary"
            f" with an entry for each of {', '.join(task.agents)}"
        )
    for agent in given:
        if agent not in task.agents:
            raise ValueError(f"{method}: {unknown('agent', agent, task.agents)}")
    for agent in task.agents:
        if agent not in given:
            raise ValueError(f"{method} has no entry for {agent}; add one")
    for agent in task.agents:
        named = given[agent]
        if not isinstance(named, Mapping) or not named:
            raise ValueError(
                f"{method}: the entry of {agent} is {_kind(named)}; it must be a"
                " dictionary of named arrays"
            )
        for name, array in named.items():
            yield f"{method}: {kind} {name!r} of {agent}", array


def _kind(thing: Any) -> str:
    """Return what something is, without what may be hundreds of numbers in it."""
    if isinstance(thing, Mapping):
        return "an empty dictionary"
    shape = f" of shape {thing.shape}" if hasattr(thing, "shape") else ""
    return f"of type {type(thing).__name__}{shape}"


def _sides(name: str, task: Task) -> dict[str, tuple[str, ...]]:
    try:
        sides = {f"side_{i + 1}": tuple(own) for i, own in enumerate(task.sides)}
    except TypeError:
        sides = {}
    members = [str(agent) for own in sides.values() for agent in own]
    if sorted(members) != sorted(task.agents) or not all(sides.values()):
        raise ValueError(
            f"{name}.sides is {task.sides!r}; each of {', '.join(task.agents)} must be"
            " on exactly one side, and no side empty"
        )
    return sides


def _by_side(what: str, given: Any, sides: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return what to call the array of each side, and the array."""
    if len(sides) == 1:
        return [(what, given)]
    if not isinstance(given, tuple) or len(given) != len(sides):
        raise ValueError(
            f"{what} is {_kind(given)}; a task of {len(sides)} sides returns a tuple"
            " with an array for each, in the order of its sides"
        )
    return [(f"{what} of {side}", own) for side, own in zip(sides, given, strict=True)]


def _check_mask(what: str, mask: Any, sim: Sim) -> None:
    kind = getattr(mask, "dtype", type(mask).__name__)
    if np.shape(mask) != (sim.num_envs,) or kind != sim.xp.bool:
        raise ValueError(
            f"{what} is {kind} of shape {np.shape(mask)}; it needs a bool for each"
            f" world, ({sim.num_envs},), as a comparison gives"
        )


def _check_score(
    what: str, points: Any, sides: Mapping[str, Any], tried: np.ndarray, sim: Sim
) -> None:
    if points is None:
        return
    if len(sides) == 1:
        raise ValueError(
            f"{what} is for tasks of several sides; a single one is judged by success()"
            " and reward()"
        )
    for own, gained in _by_side(what, points, sides):
        if np.shape(gained) != (sim.num_envs,):
            raise ValueError(
                f"{own} is {_kind(gained)}; it needs one number for each world,"
                f" ({sim.num_envs},)"
            )
        _check_finite(own, gained, tried, sim)


def _check_over(what: str, over: Any, tried: np.ndarray, sim: Sim) -> None:
    if over is None:
        return
    _check_mask(what, over, sim)
    if sim.xp.any(over[tried]):
        raise ValueError(
            f"{what} ends an episode at its very start; let it begin with a state that"
            " is not over"
        )


def _check_finite(what: str, values: Array, tried: np.ndarray, sim: Sim) -> None:
    if not sim.xp.all(sim.xp.isfinite(sim.xp.asarray(values)[tried])):
        raise ValueError(
            f"{what} is not finite at the start of an episode; look for a division by"
            " zero, or for a place that reset() does not write"
        )
