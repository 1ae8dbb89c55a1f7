"""States to try a task from, many tries, and how near to the goal each came."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies import Policy

Cast = Callable[[np.ndarray], Policy]
"""Function from tries, one in each world of the environment, to their policy."""

_FAR = 1e3
"""Shortfall of a world before anything counts: farther than any is from its goal."""

_REST, _PATIENCE = 5e-4, 10
"""A round is over if joints are slower than this, in rad/s or m/s, and no shortfall
changes by so much, for so many control steps in all of its worlds."""

_MOST_TRIES = 4  # most episodes that the expert plays for each state that is wanted


class Results(NamedTuple):
    """Results of tries, (tries,) each.

    `completed` says whether the goal was reached, as `evaluate` counts it; `nearest` is
    the least `Task.shortfall` on the way. `converged` says whether the search for what
    was played has converged; None without a search.
    """

    completed: np.ndarray
    nearest: np.ndarray
    converged: bool | None = None


def play(
    env: VectorEnv,
    starts: EnvState,
    which: np.ndarray,
    cast: Cast,
    *,
    steps: int | None = None,
    on_step: Callable[[int], object] | None = None,
) -> Results:
    """Play on from states, each try in a world of its own, as many rounds as it takes.

    A round ends early where the goal is reached in all of its worlds, or nothing moves.

    Args:
      env: worlds that do not reset themselves.
      starts: states in which tries begin.
      which: (tries,) rows of `starts`.
      cast: gives the policy.
      steps: most control steps; None for the whole episode.
      on_step: called after each control step with the steps of all worlds.
    """
    rounds = []
    for first in range(0, len(which), env.num_envs):
        # The last round's worlds that are left over try again what others have tried.
        tries = np.arange(first, first + env.num_envs) % len(which)
        begun = starts.rows(which[tries])
        rounds.append(_play_round(env, begun, cast(tries), steps, on_step))
    completed, nearest = (np.concatenate(each) for each in zip(*rounds, strict=True))
    return Results(completed[: len(which)], nearest[: len(which)])


def _play_round(
    env: VectorEnv,
    starts: EnvState,
    policy: Policy,
    steps: int | None,
    on_step: Callable[[int], object] | None,
) -> tuple[np.ndarray, np.ndarray]:
    task, observations = env.task, env.set_state(starts, from_another=True)
    nearest = now = np.full(env.num_envs, _FAR)
    completed, rested = np.zeros(env.num_envs, bool), 0
    for _ in range(steps or task.config.max_episode_steps):
        observations, *_, infos = env.step(policy(observations))
        counts = (infos["step"] > task.success_after) & ~infos["diverged"]
        before, now = now, np.where(counts, task.shortfall(env.facts), _FAR)
        nearest = np.minimum(nearest, now)
        completed = infos["metrics"]["completion"] > 0.0
        if on_step is not None:
            on_step(env.num_envs)
        left = ~(completed | infos["ended"])
        moves = np.abs(env.sim.qvel[left]).max(initial=0.0)
        moves = max(moves, np.abs(now - before)[left].max(initial=0.0))
        rested = rested + 1 if moves < _REST else 0
        if not left.any() or rested > _PATIENCE:
            break
    return completed, np.where(completed, 0.0, nearest)


def find_starts(
    env: VectorEnv, seed: int, count: int, fractions: Sequence[float]
) -> dict[float, EnvState]:
    """Return states on the expert's way to the goal, up to `count` for each fraction.

    They are from the first episodes of a seed, in their order. An episode is left out
    if the goal is met already at that moment, or if the expert does not meet it. The
    worlds must not reset themselves. Fractions are of the time in which the expert
    reaches the goal; 0 is the very start, where no episode is left out.
    """
    found: dict[float, EnvState] = {}
    for first in range(0, _MOST_TRIES * count, env.num_envs):
        episodes = range(first, first + env.num_envs)
        wanted = [f for f in fractions if f not in found or _size(found[f]) < count]
        for fraction, more in _on_the_way(env, seed, episodes, wanted).items():
            found[fraction] = found[fraction].join(more) if fraction in found else more
    return {f: own.rows(np.arange(min(count, _size(own)))) for f, own in found.items()}


def _on_the_way(
    env: VectorEnv, seed: int, episodes: range, fractions: Sequence[float]
) -> dict[float, EnvState]:
    if not fractions:
        return {}
    later = [fraction for fraction in fractions if fraction > 0.0]
    met_at = _times_to_goal(env, seed, episodes) if later else np.zeros(env.num_envs)
    env.reset(seed=seed, episodes=episodes)
    # A moment after the start and before the goal; never if the goal is not reached.
    moments = {f: np.maximum(1.0, np.floor(f * met_at)) for f in later}
    found = {f: [env.get_state(np.arange(0) if f else None)] for f in fractions}
    last = max((np.nanmax(moments[f], initial=0.0) for f in later), default=0.0)
    for step in range(1, int(last) + 1):
        env.step(env.expert())
        is_met = np.asarray(env.task.success(env.facts))
        for fraction, moment in moments.items():
            now = np.flatnonzero((moment == step) & ~is_met)
            found[fraction].append(env.get_state(now))
    states = {f: first.join(*others) for f, (first, *others) in found.items()}
    return {
        fraction: state.rows(np.argsort(state.progress["episode"]))
        for fraction, state in states.items()
    }


def _size(states: EnvState) -> int:
    return len(states.physics)


def _times_to_goal(env: VectorEnv, seed: int, episodes: range) -> np.ndarray:
    """Return in which control step the expert first meets the goal, NaN if never."""
    env.reset(seed=seed, episodes=episodes)
    met_at = np.full(env.num_envs, np.nan)
    for step in range(1, env.task.config.max_episode_steps + 1):
        *_, infos = env.step(env.expert())
        is_first = np.isnan(met_at) & (infos["metrics"]["completion"] > 0.0)
        met_at[is_first] = step
        if not np.isnan(met_at).any() or infos["ended"].all():
            break
    return met_at
