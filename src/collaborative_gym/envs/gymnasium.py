"""One world under Gymnasium's contract, in which one agent commands all robots.

Its observation is the observations of all robots one after the other, its action
likewise, and its reward the sum of theirs.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from collaborative_gym.blocks import split_columns
from collaborative_gym.envs.faces import RENDERING, OneWorld, first_row, step_info
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.math import Array
from collaborative_gym.rng import check_seed
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization


class GymnasiumEnv(OneWorld, gymnasium.Env):
    """A `VectorEnv` of one world as a Gymnasium environment.

    The info always has `success`, `diverged`, `reward_terms` by agent, and `metrics` of
    the episode until now, as `VectorEnv` describes them, with None for NaN.

    Args:
      env_id: an id from `list_envs` or a task's name from `list_tasks`.
      robots: as in `make`.
      render_mode: "rgb_array", or None for no pictures.
      randomization: as in `make`.
      strain: as in `make`.
      **settings: as in `make`.

    Attributes:
      vector_env: the batch of one.
    """

    metadata = RENDERING

    def __init__(
        self,
        env_id: str,
        robots: str | Robot | Sequence[str | Robot] | None = None,
        *,
        render_mode: str | None = None,
        randomization: str | Randomization = "default",
        strain: bool = False,
        **settings: Any,
    ):
        task = make_task(env_id, robots, randomization=randomization, **settings)
        how = {"num_threads": 1, "auto_reset": False, "strain": strain}
        self._face(task, 1, render_mode, **how)
        self._agents = SingleAgent(self.vector_env)
        self.observation_space = self._agents.observation_space
        self.action_space = self._agents.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Args:
          seed: starts its episode 0; None starts the next episode of the present
            seed, which is drawn afresh if none was ever given.
          options: not used.

        Returns:
          Observation and info.
        """
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        observations, infos = self._begin(seed)
        return self._agents.joined(observations)[0], first_row(step_info(infos))

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
        actions = self._agents.split(np.asarray(action)[None])
        observations, rewards, terminated, _, infos = self.vector_env.step(actions)
        is_terminated = bool(self._agents.shared(terminated)[0])
        ended = bool(infos["ended"][0])
        info = first_row(step_info(infos))
        reward = sum(float(each[0]) for each in rewards.values())
        observation = self._agents.joined(observations)[0]
        return observation, reward, is_terminated, ended and not is_terminated, info


class SingleAgent:
    """Joins the agents of a `VectorEnv` into one and takes its actions apart."""

    def __init__(self, env: VectorEnv):
        if len(env.sides) > 1:
            raise ValueError(
                f"one agent cannot command the {len(env.sides)} sides of"
                f" {type(env.task).__name__}, which are opponents; use make() or"
                " make_vec(), where each robot has its agent"
            )
        layout = env.world.definition.layout
        self._sizes = layout.action_sizes
        seen, done = sum(layout.observation_sizes.values()), sum(self._sizes.values())
        self.observation_space = Box(-np.inf, np.inf, (seen,), np.float32)
        self.action_space = Box(-1.0, 1.0, (done,), np.float32)

    def joined(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the observations of all agents side by side."""
        return np.concatenate(list(observations.values()), axis=1)

    def split(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        """Return each agent's columns of the actions."""
        return split_columns(actions, self._sizes)

    def shared(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the value that all agents share."""
        return next(iter(values.values()))

    def describe_action(self) -> str:
        """Return how many components each agent has."""
        return ", ".join(f"{size} of {agent}" for agent, size in self._sizes.items())
