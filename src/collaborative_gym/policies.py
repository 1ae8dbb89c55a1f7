"""Policies: what turns observations into actions."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, unknown
from collaborative_gym.math import Array
from collaborative_gym.rng import Stream, episode_generator

Policy = Callable[[Mapping[str, Array]], Mapping[str, Array]]
"""From observations to actions, both by agent, with one row per world."""


def load_policy(name: str, env: Any) -> Policy:
    """Return a policy for an environment.

    Args:
      name: "expert", the task's scripted expert, which looks at the state of the worlds
        and not at the observations; or "random", uniform actions, the same for an
        episode of a seed in any batch.
      env: a `VectorEnv`, or a PettingZoo environment of this package. Actions have the
        form that its `step` takes.

    Raises:
      KeyError: if there is no such policy.
      TypeError: if it is for another kind of environment.
    """
    if name not in _POLICIES:
        raise UnknownName(unknown("policy", name, _POLICIES))
    vector_env = getattr(env, "vector_env", env)
    if not isinstance(vector_env, VectorEnv):
        raise TypeError(
            "policies play a VectorEnv or a PettingZoo environment of this package,"
            f" got {env!r}"
        )
    policy = _POLICIES[name](vector_env)
    return policy if vector_env is env else _for_one_world(policy)


def as_policy(policy: str | Policy, env: VectorEnv) -> Policy:
    """Return a policy as it is, or the one of a name as `load_policy` does.

    Raises:
      KeyError: if there is no policy of that name.
      TypeError: if it is neither a name nor a function.
    """
    if isinstance(policy, str):
        return load_policy(policy, env)
    if not callable(policy):
        raise TypeError(
            f"policy must be {' or '.join(map(repr, _POLICIES))}, or a function from"
            f" observations to actions, got {policy!r}"
        )
    return policy


def _for_one_world(policy: Policy) -> Policy:
    """Return a policy over observations and actions without the axis of worlds."""

    def act(observations: Mapping[str, Array]) -> dict[str, Array]:
        batch = {agent: row[None] for agent, row in observations.items()}
        return {agent: rows[0] for agent, rows in policy(batch).items()}

    return act


def _expert(env: VectorEnv) -> Policy:
    return lambda observations: env.expert()


class _Random:
    """Uniform actions that an episode's own generator draws, all at its first step."""

    def __init__(self, env: VectorEnv):
        self._env = env
        self._length = env.task.config.max_episode_steps
        self._sizes = {
            agent: space.shape[0] for agent, space in env.single_action_spaces.items()
        }
        columns = sum(self._sizes.values())
        self._actions = np.zeros((env.num_envs, self._length, columns), np.float32)
        self._drawn = np.full((env.num_envs, 2), -1)

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, Array]:
        progress = self._env.progress
        playing = np.stack([progress["seed"], progress["episode"]], axis=1)
        for i in np.flatnonzero((playing != self._drawn).any(axis=1)):
            seed, episode = playing[i]
            rng = episode_generator(seed, episode, Stream.POLICY)
            self._actions[i] = rng.uniform(-1.0, 1.0, self._actions.shape[1:])
        self._drawn = playing
        now = self._actions[np.arange(len(playing)), progress["step"]]
        ends = np.cumsum(list(self._sizes.values()))[:-1]
        return dict(zip(self._sizes, np.split(now, ends, axis=1), strict=True))


_POLICIES: dict[str, Callable[[VectorEnv], Policy]] = {
    "expert": _expert,
    "random": _Random,
}
