"""Worlds under Gymnasium's contracts, in which one agent commands all robots.

Its observation is the observations of all robots one after the other, its action
likewise, and its reward the sum of theirs.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from collaborative_gym.envs.pettingzoo import (
    RENDERING,
    check_can_render,
    check_render_mode,
    first_row,
    fresh_seed,
)
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.math import Array
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization

_VECTOR_METADATA = {**RENDERING, "autoreset_mode": AutoresetMode.SAME_STEP}

_STEP_INFO = ("success", "diverged", "reward_terms")
"""What is reported at every step."""


class GymnasiumEnv(gymnasium.Env):
    """A `VectorEnv` of one world as a Gymnasium environment.

    The info of a step has `success`, `diverged` and `reward_terms` by agent; in the
    episode's last step also `metrics`, as `VectorEnv` describes them, with None for
    NaN.

    Args:
      env_id: an id from `list_envs` or a task's name from `list_tasks`.
      robots: the arms in the order of the agents, by name or value; None for the
        environment's own.
      render_mode: "rgb_array", or None for no pictures.
      randomization: how starts are drawn, "default", "paper" or a value.
      **settings: other fields of the task's config.

    Attributes:
      vector_env: the batch of one.
    """

    metadata = RENDERING

    def __init__(
        self,
        env_id: str,
        robots: Sequence[str | Robot] | None = None,
        *,
        render_mode: str | None = None,
        randomization: str | Randomization = "default",
        **settings: Any,
    ):
        check_render_mode(render_mode, RENDERING["render_modes"])
        self.render_mode = render_mode
        task = make_task(env_id, robots, randomization, **settings)
        self.vector_env = VectorEnv(task, 1, num_threads=1, auto_reset=False)
        self._agents = _SingleAgent(self.vector_env)
        self.observation_space = self._agents.observation_space
        self.action_space = self._agents.action_space
        self._has_seed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Args:
          seed: starts its episode 0; None goes on to the next episode of the present
            seed, which is drawn afresh if none was ever given.
          options: not used.

        Returns:
          Observation and info.
        """
        super().reset(seed=seed)
        if seed is None and not self._has_seed:
            seed = fresh_seed()
        observations, _ = self.vector_env.reset(seed)
        self._has_seed = True
        return self._agents.joined(observations)[0], {}

    def step(
        self, action: Array
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Do one control step.

        Args:
          action: of all robots, each component in [-1, 1].

        Returns:
          Observation, reward, terminated, truncated and info. The observation that
          ends an episode is its own last one.

        Raises:
          ValueError: if the action is not what the space says; nothing is changed.
          RuntimeError: before the first `reset`, after an episode's end, after `close`.
        """
        if np.shape(action) != self.action_space.shape:
            raise ValueError(
                f"the action has shape {np.shape(action)}, not"
                f" {self.action_space.shape}: {self._agents.describe_action()}"
            )
        observations, rewards, terminated, _, infos = self.vector_env.step(
            self._agents.split(np.asarray(action)[None])
        )
        is_terminated = bool(self._agents.shared(terminated)[0])
        ended = bool(infos["ended"][0])
        names = (*_STEP_INFO, "metrics") if ended else _STEP_INFO
        info = first_row({name: infos[name] for name in names})
        reward = sum(float(each[0]) for each in rewards.values())
        observation = self._agents.joined(observations)[0]
        return observation, reward, is_terminated, ended and not is_terminated, info

    def render(self) -> np.ndarray:
        """Return a picture, (480, 640, 3) uint8.

        Raises:
          RuntimeError: without a render mode, and if no renderer can start.
        """
        check_can_render(self.render_mode)
        return self.vector_env.render()

    def close(self) -> None:
        """Free the renderer. No other call is allowed afterwards."""
        self.vector_env.close()


class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):
    """A `VectorEnv` as a Gymnasium vector environment that resets in the same step.

    Infos are Gymnasium's: arrays by world, each with a mask under the same name after
    an underscore. `success`, `diverged` and `reward_terms` are of the worlds whose
    episode goes on; those that ended have theirs in `final_info`, with `metrics`, and
    their last observations in `final_obs`.

    Args:
      env_id: an id from `list_envs` or a task's name from `list_tasks`.
      num_envs: how many worlds.
      num_threads: physics threads, 0 for one per CPU.
      robots: the arms in the order of the agents, by name or value; None for the
        environment's own.
      render_mode: "rgb_array", or None for no pictures.
      randomization: how starts are drawn, "default", "paper" or a value.
      **settings: other fields of the task's config.

    Attributes:
      vector_env: the batch, with dictionaries by agent.
    """

    metadata = _VECTOR_METADATA
    closed = True  # until all is made: Gymnasium closes what is thrown away

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        *,
        num_threads: int = 0,
        robots: Sequence[str | Robot] | None = None,
        render_mode: str | None = None,
        randomization: str | Randomization = "default",
        **settings: Any,
    ):
        check_render_mode(render_mode, RENDERING["render_modes"])
        self.render_mode = render_mode
        task = make_task(env_id, robots, randomization, **settings)
        self.vector_env = VectorEnv(task, num_envs, num_threads=num_threads)
        self._agents = _SingleAgent(self.vector_env)
        self.num_envs = num_envs
        self.single_observation_space = self._agents.observation_space
        self.single_action_space = self._agents.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._has_seed = False
        self.closed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every world.

        Args:
          seed: starts its episodes 0, 1, 2 ...; None goes on to each world's next
            episode of the present seed, which is drawn afresh if none was ever given.
          options: not used.

        Returns:
          Observations (num_envs, k) and infos.
        """
        super().reset(seed=seed)
        if seed is None and not self._has_seed:
            seed = fresh_seed()
        observations, _ = self.vector_env.reset(seed)
        self._has_seed = True
        return self._agents.joined(observations), {}

    def step(
        self, actions: Array
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Do one control step in every world.

        Args:
          actions: of all robots, (num_envs, k), each component in [-1, 1].

        Returns:
          Observations, rewards, terminated, truncated and infos.

        Raises:
          ValueError: if the actions are not what the space says; no world is changed.
          RuntimeError: before the first `reset` and after `close`.
        """
        if np.shape(actions) != self.action_space.shape:
            raise ValueError(
                f"the actions have shape {np.shape(actions)}, not"
                f" {self.action_space.shape}: {self._agents.describe_action()}"
            )
        observations, rewards, terminated, truncated, infos = self.vector_env.step(
            self._agents.split(np.asarray(actions))
        )
        return (
            self._agents.joined(observations),
            np.sum([each.astype(np.float64) for each in rewards.values()], axis=0),
            self._agents.shared(terminated),
            self._agents.shared(truncated),
            self._infos(infos),
        )

    def render(self) -> tuple[np.ndarray, ...]:
        """Return a picture of each world, (480, 640, 3) uint8.

        Raises:
          RuntimeError: without a render mode, and if no renderer can start.
        """
        check_can_render(self.render_mode)
        return tuple(self.vector_env.render(i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free the renderer; `close` calls this."""
        self.vector_env.close()

    def _infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        ended = infos["ended"]
        step_info = {name: infos[name] for name in _STEP_INFO}
        if not ended.any():
            return _masked(step_info, ~ended)
        final = self._agents.joined(infos["final_observation"])
        final_obs = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(ended):
            final_obs[i] = final[i]
        final_info = {**step_info, "metrics": infos["metrics"]}
        return {
            **_masked(step_info, ~ended),
            "final_obs": final_obs,
            "_final_obs": ended.copy(),
            "final_info": _masked(final_info, ended),
            "_final_info": ended.copy(),
        }


class _SingleAgent:
    """Joins the agents of a `VectorEnv` into one and takes its actions apart."""

    def __init__(self, env: VectorEnv):
        if len(env.sides) > 1:
            raise ValueError(
                f"one agent cannot command the {len(env.sides)} sides of"
                f" {type(env.task).__name__}, which are opponents; use make() or"
                " make_vec(), where each robot has its agent"
            )
        self._sizes = {
            agent: space.shape[0] for agent, space in env.single_action_spaces.items()
        }
        spaces = env.single_observation_spaces.values()
        observation_size = sum(space.shape[0] for space in spaces)
        self.observation_space = Box(-np.inf, np.inf, (observation_size,), np.float32)
        self.action_space = Box(-1.0, 1.0, (sum(self._sizes.values()),), np.float32)

    def joined(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the observations of all agents side by side."""
        return np.concatenate(list(observations.values()), axis=1)

    def split(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        """Return each agent's columns of the actions."""
        ends = np.cumsum(list(self._sizes.values()))
        return dict(zip(self._sizes, np.split(actions, ends[:-1], 1), strict=True))

    def shared(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return what is the same for all agents."""
        return next(iter(values.values()))

    def describe_action(self) -> str:
        """Return how many components each agent has."""
        return ", ".join(f"{size} of {agent}" for agent, size in self._sizes.items())


def _masked(info: Mapping[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return an info with a mask beside each entry, as Gymnasium's vectors have it."""
    masked = {}
    for name, value in info.items():
        is_group = isinstance(value, Mapping)
        masked[name] = _masked(value, mask) if is_group else value
        masked[f"_{name}"] = mask.copy()
    return masked
