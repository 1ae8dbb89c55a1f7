"""The saved state of worlds, and whether it may be put into others."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym.errors import check_flag, check_kind
from collaborative_gym.math import Array
from collaborative_gym.robots import Robot
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.identity import ON_STATE, Identity
from collaborative_gym.tasks.task import TaskConfig


@dataclass(frozen=True)
class EnvState:
    """What `VectorEnv.set_state` needs to continue episodes bit for bit."""

    physics: Array  # rows of the backend's state
    memory: Mapping[str, Array]  # rows of the task's memory, by name
    progress: Mapping[str, Array]  # rows of the episodes' counters and sums, by name
    identity: Identity  # what the environment is from which it was taken

    def map(self, change: Callable[..., Any], *others: "EnvState") -> "EnvState":
        """Return the state of what `change` makes of each array, and of the others'."""

        def changed(part: str) -> dict[str, Any]:
            own, *rest = (getattr(each, part) for each in (self, *others))
            return {n: change(own[n], *(each[n] for each in rest)) for n in own}

        physics = change(self.physics, *(each.physics for each in others))
        return EnvState(physics, changed("memory"), changed("progress"), self.identity)

    def rows(self, which: Array) -> "EnvState":
        """Return some rows, in this order."""
        return self.map(lambda array: array[which])

    def join(self, *others: "EnvState") -> "EnvState":
        """Return the rows of all, one below the other."""
        return self.map(lambda *parts: np.concatenate(parts), *others)


def take(
    sim: Sim, progress: Mapping[str, Array], rows: Array, identity: Identity
) -> EnvState:
    """Return a copy of the state of these worlds, in this order."""
    order = np.argsort(rows)
    physics = sim.get_state(rows[order])[np.argsort(order)]
    memory, counts = (
        {n: array[rows] for n, array in part.items()} for part in (sim.memory, progress)
    )
    return EnvState(physics, memory, counts, identity)


def put(state: EnvState, sim: Sim, progress: dict[str, Array], rows: Array) -> None:
    """Put the rows of a state into these worlds, as new arrays of all of them."""
    order = np.argsort(rows)
    sim.set_state(state.physics[order], rows[order])
    every = np.arange(sim.num_envs)
    for kept, given in (sim.memory, state.memory), (progress, state.progress):
        for name, array in given.items():
            kept[name] = kept[name][every]
            kept[name][rows] = array


def check_state(
    state: EnvState, blank: EnvState, max_steps: int, *, from_another: bool = False
) -> None:
    """Raise unless a state may be put into worlds whose present state is `blank`.

    Raises:
      TypeError: if it is not a state.
      ValueError: if it is of another environment, unless it may be from another, does
        not fit, or cannot be the state of any world.
    """
    from_another = check_flag("from_another", from_another)
    if not isinstance(state, EnvState):
        raise TypeError(f"state must come from get_state(), got {type(state)}")
    check_kind("the state's identity", state.identity, Identity, "an Identity")
    differs = state.identity.differences(blank.identity, ignore=ON_STATE)
    if differs and not from_another:
        raise ValueError(
            f"the state is from another environment: {'; '.join(differs)}; pass"
            " from_another=True to play it here anyway"
        )
    for part, given, own in (
        ("memory", state.memory, blank.memory),
        ("progress", state.progress, blank.progress),
        ("physics", {"rows": state.physics}, {"rows": blank.physics}),
    ):
        check_kind(f"the state's {part}", given, Mapping, "a dictionary of arrays")
        shapes = {name: np.shape(array) for name, array in given.items()}
        needed = {name: tuple(array.shape) for name, array in own.items()}
        for name in {**needed, **shapes}:
            given_shape, own_shape = shapes.get(name), needed.get(name)
            if given_shape != own_shape:
                raise ValueError(
                    f"the state does not fit these worlds: its {part} {name!r} has"
                    f" shape {given_shape}, not {own_shape}; take it from an"
                    " environment with the same id and options, and give as many"
                    " env_ids as it has rows"
                )
        for name, array in given.items():
            _check_rows(part, name, np.asarray(array), np.asarray(own[name]).dtype)
    _check_counts(state.progress, max_steps)


def _check_rows(part: str, name: str, rows: np.ndarray, wanted: np.dtype) -> None:
    if rows.dtype.kind != wanted.kind:
        raise ValueError(
            f"the state's {part} {name!r} is of type {rows.dtype}, not {wanted}"
        )
    # What a task remembers may be infinite, such as the least distance so far.
    is_sane = rows == rows if part == "memory" else np.isfinite(rows)
    if not is_sane.all():
        raise ValueError(
            f"the state's {part} {name!r} is not finite; take it from get_state()"
        )


def _check_counts(progress: Mapping[str, Array], max_steps: int) -> None:
    step, length = np.asarray(progress["step"]), np.asarray(progress["length"])
    last = 2**63 - 1
    has_ended = np.asarray(progress["terminated"]) | np.asarray(progress["truncated"])
    bounds: dict[str, tuple[int, Any]] = {"seed": (0, last), "episode": (0, last)}
    bounds |= {"step": (0, max_steps - 1 + has_ended), "length": (0, step)}
    for name in progress:
        if name.endswith(("performing_steps", "goal_steps")):
            bounds[name] = (0, length)
        elif name.endswith("first_success"):
            bounds[name] = (-1, length)
    for name, (low, high) in bounds.items():
        counts = np.asarray(progress[name])
        if not ((counts >= low) & (counts <= high)).all():
            raise ValueError(
                f"the state's progress {name!r} is {counts.tolist()}, which no episode"
                f" of {max_steps} steps comes to; take it from get_state()"
            )


def made_anew(
    kind: type,
    task: tuple[type, tuple[Robot, ...], TaskConfig, str],
    options: dict[str, Any],
    state: EnvState | None,
) -> Any:
    """Return an environment like the one, in this state, that was copied or pickled."""
    task_class, arms, config, name = task
    same = task_class(arms, config)
    same.name = name
    env = kind(same, **options)
    if state is not None:
        env.set_state(state)
    return env
