"""Many tries from given states, and how near to the goal each came."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies import Policy

Cast = Callable[[np.ndarray], Policy]
"""A function that returns who plays these tries, one in each world of the
environment."""

_FAR = 1e3
"""Farther than any world is from its goal."""

_REST, _PATIENCE = 5e-4, 10
"""If joints are slower than this, in rad/s or m/s, and no shortfall changes by so much,
for so many control steps in all worlds of a round, nothing more will happen."""


@dataclass(frozen=True)
class Outcome:
    """What came of tries.

    Attributes:
      completed: (tries,) whether the goal was reached, as `evaluate` counts it.
      nearest: (tries,) least `Task.shortfall` on the way.
    """

    completed: np.ndarray
    nearest: np.ndarray


def play(
    env: VectorEnv,
    starts: EnvState,
    which: np.ndarray,
    cast: Cast,
    *,
    steps: int | None = None,
    on_step: Callable[[int], object] | None = None,
) -> Outcome:
    """Play on from states, each try in a world of its own, as many rounds as it takes.

    A round ends early where the goal is reached in all of its worlds, or nothing moves.

    Args:
      env: worlds that do not reset themselves.
      starts: where tries begin.
      which: (tries,) rows of `starts`.
      cast: who plays.
      steps: how many control steps at most; None for the whole episode.
      on_step: called after each control step with the steps of all worlds.
    """
    completed, nearest = [], []
    for first in range(0, len(which), env.num_envs):
        # The last round's worlds that are left over try again what others have tried.
        tries = np.arange(first, first + env.num_envs) % len(which)
        begun = starts.rows(which[tries])
        outcome = _play_round(env, begun, cast(tries), steps, on_step)
        completed.append(outcome.completed)
        nearest.append(outcome.nearest)
    rows = slice(len(which))
    return Outcome(np.concatenate(completed)[rows], np.concatenate(nearest)[rows])


def _play_round(
    env: VectorEnv,
    starts: EnvState,
    policy: Policy,
    steps: int | None,
    on_step: Callable[[int], object] | None,
) -> Outcome:
    task, observations = env.task, env.set_state(starts)
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
    return Outcome(completed, np.where(completed, 0.0, nearest))
