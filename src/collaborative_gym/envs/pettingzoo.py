"""One world as a PettingZoo parallel environment."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv

from collaborative_gym.envs.faces import RENDERING, OneWorld, first_row, step_info
from collaborative_gym.errors import look_up, shown
from collaborative_gym.math import Array
from collaborative_gym.tasks.task import Task

ByAgent = dict[str, Any]

_METADATA = {"name": "collaborative_gym", "is_parallelizable": True, **RENDERING}


class PettingZooEnv(OneWorld, ParallelEnv):
    """A `VectorEnv` of one world under PettingZoo's contract.

    An agent's info always has `success`, `diverged`, its `reward_terms`, and `metrics`
    of the episode until now, as `VectorEnv` describes them, with None for NaN. Where a
    task has several sides, they are those of the agent's own.

    Args:
      task: what to do, from `cg.task`.
      render_mode: "rgb_array", or None for no pictures.
      name: what the environment calls itself.
      strain: as in `make`.

    Raises:
      KeyError: if there is no such render mode.

    Attributes:
      vector_env: the batch of one.
      possible_agents: the agents' names.
      agents: those whose episode has not ended: all of them, or none.
      state_space: space of `state`.
      render_mode: as given.
    """

    metadata = _METADATA

    def __init__(
        self,
        task: Task,
        render_mode: str | None = None,
        *,
        name: str = "",
        strain: bool = False,
    ):
        self.metadata = {**_METADATA, "name": name or type(task).__name__}
        how = {"num_threads": 1, "auto_reset": False, "strain": strain}
        self._face(task, 1, render_mode, **how)
        self.possible_agents = list(self.vector_env.agents)
        self.agents: list[str] = []
        self.observation_spaces = {**self.vector_env.single_observation_spaces}
        self.action_spaces = {**self.vector_env.single_action_spaces}
        boxes = self.vector_env.single_observation_spaces.values()
        size = sum(box.shape[0] for box in boxes)
        self.state_space = Box(-np.inf, np.inf, (size,), np.float32)
        self._observations: ByAgent = {}

    def observation_space(self, agent: str) -> Box:
        """Return the space of an agent's observations."""
        return look_up("agent", agent, self.vector_env.single_observation_spaces)

    def action_space(self, agent: str) -> Box:
        """Return the space of an agent's actions."""
        return look_up("agent", agent, self.vector_env.single_action_spaces)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, ByAgent]:
        """Start an episode.

        Args:
          seed: starts its episode 0; None starts the next episode of the present
            seed, which is drawn afresh if none was ever given.
          options: not used.

        Returns:
          Observations and infos by agent.
        """
        observations, infos = self._begin(seed)
        self.agents = list(self.possible_agents)
        self._observations = _row(observations)
        return dict(self._observations), self._infos(infos)

    def step(
        self, actions: Mapping[str, Array]
    ) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        """Do one control step.

        Args:
          actions: by agent, (k,), each component in [-1, 1].

        Returns:
          Observations, rewards, terminated, truncated and infos by agent. The
          observations that end an episode are its own last ones.

        Raises:
          ValueError: if the actions are not what the spaces say; nothing is changed.
          RuntimeError: before the first `reset`, after an episode's end, after `close`.
        """
        batch = self._batch_of_one(actions)
        observations, *earned, infos = self.vector_env.step(batch)
        self._observations = _row(observations)
        if infos["ended"][0]:
            self.agents = []
        rewards, terminated, truncated = (
            {agent: rows.item() for agent, rows in own.items()} for own in earned
        )
        observations, infos = dict(self._observations), self._infos(infos)
        return observations, rewards, terminated, truncated, infos

    def state(self) -> np.ndarray:
        """Return the observations of all agents in one array."""
        if not self._observations:
            raise RuntimeError("call reset() before state()")
        return np.concatenate(list(self._observations.values()))

    def _infos(self, infos: Mapping[str, Any]) -> ByAgent:
        row = first_row(step_info(infos))
        by_agent = {}
        for side, agents in self.vector_env.sides.items():
            for agent in agents:
                info = _of_side(row, side)
                info["reward_terms"] = row["reward_terms"][agent]
                info["metrics"] = _of_side(row["metrics"], side)
                by_agent[agent] = info
        return {agent: by_agent[agent] for agent in self.possible_agents}

    def _batch_of_one(self, actions: Mapping[str, Array]) -> Mapping[str, Array]:
        if not isinstance(actions, Mapping):
            return actions
        for agent, space in self.action_spaces.items():
            if agent in actions and np.shape(actions[agent]) != space.shape:
                raise ValueError(
                    f"the action of {agent} has shape {np.shape(actions[agent])}, not"
                    f" {space.shape}; got {shown(actions[agent])}"
                )
        return {agent: np.asarray(action)[None] for agent, action in actions.items()}


def _row(observations: Mapping[str, np.ndarray]) -> ByAgent:
    return {agent: array[0] for agent, array in observations.items()}


def _of_side(by_name: Mapping[str, Any], side: str) -> ByAgent:
    """Return values; of those that each side has, the values of one side."""
    return {
        name: value[side] if isinstance(value, dict) and side in value else value
        for name, value in by_name.items()
    }
