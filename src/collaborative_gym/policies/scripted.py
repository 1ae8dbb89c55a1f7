"""Policies that nobody trained."""

from collections.abc import Mapping

import numpy as np

from collaborative_gym.blocks import split_columns
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import look_up
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeDraws, Stream

STYLES = {
    "late": "it holds still for two seconds first",
    "slow": "it moves at half its speed",
}
"""Styles of every task's expert; tasks may have more of their own."""

_LATE = 20  # control steps for which a late expert holds still


def expert_policy(env: VectorEnv, style: str = ""):
    """Return the task's scripted expert, which looks at the worlds' state.

    Its style is one of `STYLES` or of the task's `styles`, or empty for the usual one.

    Raises:
      KeyError: if there is no such style; names those that exist.
    """
    if style:
        look_up("expert style", style, {**STYLES, **env.task.styles})
    own, pace = "" if style in STYLES else style, 0.5 if style == "slow" else 1.0
    if style != "late":
        return lambda observations: env.expert(own, pace=pace)
    still = env.idle()

    def act(observations: Mapping[str, Array]) -> dict[str, Array]:
        is_still = (env.progress["step"] < _LATE)[:, None]
        return {a: np.where(is_still, still[a], x) for a, x in env.expert().items()}

    return act


def idle_policy(env: VectorEnv):
    """Return a policy that holds still with an open grip."""
    still = env.idle()
    return lambda observations: still


def gripping_policy(env: VectorEnv):
    """Return a policy that holds still and grips things within reach of its hand.

    As long as it holds nothing, it opens its hand every other step to close it anew.
    """
    if not env.task.gripping:
        return idle_policy(env)

    def act(observations: Mapping[str, Array]) -> dict[str, Array]:
        closes = env.progress["step"] % 2 == 0
        return env.idle({a: closes | held for a, held in _held(env).items()})

    return act


def frozen_policy(env: VectorEnv):
    """Return a policy that holds still and keeps what it holds."""
    return lambda observations: env.idle(_held(env) if env.task.gripping else False)


def _held(env: VectorEnv) -> dict[str, Array]:
    able = {grip.agent for grip in env.scene.grips}
    nothing = dict.fromkeys(env.agents, np.zeros(env.num_envs, bool))
    return nothing | {agent: env.scene.holds(env.sim, agent) for agent in able}


class RandomPolicy:
    """Uniform actions that an episode's own generator draws, all at its first step."""

    def __init__(self, env: VectorEnv):
        self._env = env
        self._sizes = env.world.definition.layout.action_sizes
        size = env.task.config.max_episode_steps, sum(self._sizes.values())
        self._actions = EpisodeDraws(env.num_envs, size, Stream.POLICY)

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, Array]:
        """Return actions by agent for the present step of each world."""
        progress = self._env.progress
        actions = self._actions.now(progress)
        now = actions[np.arange(len(actions)), progress["step"]]
        return split_columns(now, self._sizes)
