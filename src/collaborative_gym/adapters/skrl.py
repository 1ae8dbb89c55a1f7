"""A `VectorEnv` under skrl's multi-agent contract, for skrl's own trainers."""

from collections.abc import Mapping
from typing import Any

import torch
from gymnasium.spaces import Box
from skrl.envs.wrappers.torch import MultiAgentEnvWrapper

from collaborative_gym.envs.vector_env import VectorEnv

ByAgent = dict[str, torch.Tensor]


class SkrlEnv(MultiAgentEnvWrapper):
    """A `VectorEnv` as skrl's wrapped multi-agent environment, all worlds at once.

    The state, which MAPPO's critics see, has the observations of all robots side by
    side. In a batch that resets itself, skrl estimates the value after an episode's
    last step from the first observation of the next episode. So its
    `time_limit_bootstrap` is a guess; `collaborative_gym.train` uses the right one.

    Args:
      env: the worlds, from `make_vec`.
    """

    def __init__(self, env: VectorEnv):
        super().__init__(env)
        self._observations: ByAgent = {}
        boxes = env.single_observation_spaces.values()
        size = sum(box.shape[0] for box in boxes)
        self._state_space = Box(-float("inf"), float("inf"), (size,))

    @property
    def possible_agents(self) -> list[str]:
        return list(self._env.agents)

    @property
    def observation_spaces(self) -> dict[str, Box]:
        return self._env.single_observation_spaces

    @property
    def action_spaces(self) -> dict[str, Box]:
        return self._env.single_action_spaces

    @property
    def state_spaces(self) -> dict[str, Box]:
        """Space of one world's state, the same for all agents."""
        return dict.fromkeys(self.possible_agents, self._state_space)

    def reset(self) -> tuple[ByAgent, dict[str, Any]]:
        observations, infos = self._env.reset()
        self._observations = self._tensors(observations)
        return self._observations, _to_log(infos)

    def step(
        self, actions: ByAgent
    ) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, dict[str, Any]]:
        """Do one control step.

        Args:
          actions: by agent, (num_envs, k).

        Returns:
          Observations, rewards, terminated and truncated by agent, the last three
          (num_envs, 1), and infos. Of these, `episode` is what skrl's trainers log, the
          means of `completion`, `performance` and `return` over ended episodes.
        """
        by_agent = {agent: given.cpu().numpy() for agent, given in actions.items()}
        observations, rewards, terminated, truncated, infos = self._env.step(by_agent)
        self._observations = self._tensors(observations)
        earned, over, late = map(self._columns, (rewards, terminated, truncated))
        return self._observations, earned, over, late, _to_log(infos)

    def state(self) -> ByAgent:
        """Return the observations of all agents side by side, for each of them."""
        state = torch.cat([*self._observations.values()], dim=1)
        return dict.fromkeys(self.possible_agents, state)

    def render(self, *_: Any, **__: Any) -> Any:
        return self._env.render()

    def close(self) -> None:
        self._env.close()

    def _tensors(self, arrays: Mapping[str, Any]) -> ByAgent:
        return {
            a: torch.as_tensor(rows, device=self.device) for a, rows in arrays.items()
        }

    def _columns(self, arrays: Mapping[str, Any]) -> ByAgent:
        return {agent: own[:, None] for agent, own in self._tensors(arrays).items()}


def _to_log(infos: Mapping[str, Any]) -> dict[str, Any]:
    """Return infos with the means over ended episodes in the place skrl looks for."""
    means, ended = {}, infos["ended"]
    for name in ("completion", "performance", "return") if ended.any() else ():
        given = infos["metrics"][name]
        by_side = given if isinstance(given, Mapping) else {"": given}
        for side, values in by_side.items():
            means[f"{side} {name}".strip()] = torch.tensor(values[ended].mean())
    return {**infos, "episode": means}
