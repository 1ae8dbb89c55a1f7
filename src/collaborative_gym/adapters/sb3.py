"""A `VectorEnv` as a batch of Stable-Baselines3; one agent commands all robots."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from collaborative_gym.envs.gymnasium import SingleAgent
from collaborative_gym.envs.vector_env import VectorEnv


class SB3VecEnv(VecEnv):
    """A `VectorEnv` under Stable-Baselines3's contract, all worlds at once.

    Observations and actions of the robots stand side by side, and the reward is the sum
    of theirs, as in the Gymnasium environments. In the step that ends an episode, the
    info of its world has `terminal_observation`, `TimeLimit.truncated` and
    `is_success`; Stable-Baselines3 logs the rate of success. Other infos are empty.

    `seed` takes effect at the next `reset`: then all worlds play episodes of that seed.
    Without it, they play episodes of the seed with which the `VectorEnv` was made.

    Args:
      env: the worlds, of a task with one side, from `make_vec`.

    Raises:
      ValueError: if the task has several sides.

    Attributes:
      vector_env: the worlds.
    """

    render_mode: str | None = "rgb_array"

    def __init__(self, env: VectorEnv):
        self.vector_env = env
        self._agents = SingleAgent(env)
        spaces = self._agents.observation_space, self._agents.action_space
        super().__init__(env.num_envs, *spaces)
        self._actions: dict[str, np.ndarray] = {}

    def reset(self) -> np.ndarray:
        observations, _ = self.vector_env.reset(self._seeds[0])
        self._reset_seeds()
        return self._agents.joined(observations)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = self._agents.split(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        observations, rewards, terminated, _, infos = self.vector_env.step(
            self._actions
        )
        ends: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if infos["ended"].any():
            final = self._agents.joined(infos["final_observation"])
            is_terminated = self._agents.shared(terminated)
            for i in np.flatnonzero(infos["ended"]):
                ends[i] = {
                    # By these two it knows that the world goes on, and from where.
                    "terminal_observation": final[i],
                    "TimeLimit.truncated": not is_terminated[i],
                    "is_success": bool(infos["metrics"]["completion"][i]),
                }
        total = np.sum([*rewards.values()], axis=0)
        return self._agents.joined(observations), total, infos["ended"], ends

    def get_images(self) -> list[np.ndarray]:
        return [self.vector_env.render(i) for i in range(self.num_envs)]

    def close(self) -> None:
        self.vector_env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("no world of a batch has anything of its own")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        raise NotImplementedError("no world of a batch has anything of its own")

    def env_is_wrapped(
        self, wrapper_class: type, indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
