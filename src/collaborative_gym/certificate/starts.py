"""States from which a task is tried: starts, and moments on the expert's way."""

from collections.abc import Sequence

import numpy as np

from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv

_MOST_TRIES = 4
"""How many episodes are looked at, at most, for each state that is wanted."""


def find_starts(
    env: VectorEnv, seed: int, count: int, fractions: Sequence[float]
) -> dict[float, EnvState]:
    """Return states on the expert's way to the goal, up to `count` for each fraction.

    They are from the first episodes of a seed, in their order. An episode is left out
    if the goal is met already at that moment, or if the expert does not meet it.

    Args:
      env: worlds that do not reset themselves.
      seed: whose episodes.
      count: how many states of each fraction.
      fractions: of the time in which the expert reaches the goal; 0 for the very start,
        where no episode is left out.
    """
    found: dict[float, list[EnvState]] = {fraction: [] for fraction in fractions}
    sizes = dict.fromkeys(fractions, 0)
    for first in range(0, _MOST_TRIES * count, env.num_envs):
        episodes = range(first, first + env.num_envs)
        wanted = [f for f in fractions if sizes[f] < count]
        if not wanted:
            break
        for fraction, state in _on_the_way(env, seed, episodes, wanted).items():
            found[fraction].append(state)
            sizes[fraction] += len(state.physics)
    return {
        fraction: first.join(*others).rows(np.arange(min(count, sizes[fraction])))
        for fraction, (first, *others) in found.items()
    }


def _on_the_way(
    env: VectorEnv, seed: int, episodes: range, fractions: Sequence[float]
) -> dict[float, EnvState]:
    """Return the states of these episodes, one world each."""
    later = [fraction for fraction in fractions if fraction > 0.0]
    met_at = _times_to_goal(env, seed, episodes) if later else np.zeros(env.num_envs)
    env.reset(seed=seed, episodes=episodes)
    found = {f: [env.get_state()] for f in fractions if f == 0.0}
    # A moment after the start and before the goal; never if the goal is not reached.
    moments = {f: np.maximum(1.0, np.floor(f * met_at)) for f in later}
    found |= {f: [env.get_state(np.arange(0))] for f in later}
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
