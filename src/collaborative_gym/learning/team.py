"""How a mode divides the robots among learners."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from collaborative_gym.control.actions import grip_columns
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import unknown
from collaborative_gym.learning.config import MODES, Mode
from collaborative_gym.policies.network import Part, with_index
from collaborative_gym.tasks.task import Task


@dataclass(frozen=True)
class Sizes:
    """Components of each agent's spaces.

    Attributes:
      observation: by agent.
      action: by agent.
      gripping: whether the last component of an action grips where it is above zero.
    """

    observation: Mapping[str, int]
    action: Mapping[str, int]
    gripping: bool = False

    def without(self, agents: Collection[str]) -> "Sizes":
        """Return the sizes of all other agents."""
        observation, action = (
            {agent: size for agent, size in sizes.items() if agent not in agents}
            for sizes in (self.observation, self.action)
        )
        return Sizes(observation, action, self.gripping)

    @classmethod
    def of(cls, task: Task) -> "Sizes":
        """Return the sizes of a task's spaces."""
        env = VectorEnv(task, 1, num_threads=1)
        observation, action = (
            {agent: space.shape[0] for agent, space in spaces.items()}
            for spaces in (env.single_observation_spaces, env.single_action_spaces)
        )
        env.close()
        return cls(observation, action, task.gripping)


@dataclass(frozen=True)
class Learner:
    """What learns by itself: parts of the policy, with one critic.

    Its rows are the worlds, and a row has the observations, the actions and the mean
    reward of all its agents. Where it is `stacked`, each of its agents has a block of
    rows of its own instead, told by index.

    Attributes:
      name: what to call it.
      agents: whom it commands.
      parts: its networks.
      stacked: whether its agents' rows stand below one another.
    """

    name: str
    agents: tuple[str, ...]
    parts: tuple[Part, ...]
    stacked: bool = False

    def observation_size(self, sizes: Sizes) -> int:
        """Return the width of its rows of observations."""
        if self.stacked:
            return sizes.observation[self.agents[0]] + len(self.agents)
        return sum(sizes.observation[agent] for agent in self.agents)

    def action_size(self, sizes: Sizes) -> int:
        """Return the width of its rows of actions."""
        if self.stacked:
            return sizes.action[self.agents[0]]
        return sum(sizes.action[agent] for agent in self.agents)

    def networks(self, sizes: Sizes) -> dict[str, tuple[int, int]]:
        """Return inputs and outputs of each network of its policy, by name.

        They stand side by side: the inputs in its rows of observations, the outputs in
        its rows of actions.
        """
        if self.stacked:
            ends = self.observation_size(sizes), self.action_size(sizes)
            return {self.parts[0].weights: ends}
        return {
            part.weights: (
                sum(sizes.observation[agent] for agent in part.agents),
                sum(sizes.action[agent] for agent in part.agents),
            )
            for part in self.parts
        }

    def is_grip(self, sizes: Sizes) -> np.ndarray:
        """Return which columns of its actions grip, (action_size,) bool."""
        agents = self.agents[:1] if self.stacked else self.agents
        columns = []
        for agent in agents:
            columns += list(grip_columns(sizes.action[agent], sizes.gripping))
        return np.array(columns)

    def num_rows(self, num_envs: int) -> int:
        """Return how many rows it has."""
        return num_envs * (len(self.agents) if self.stacked else 1)

    def observations(self, by_agent: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return rows of observations."""
        if not self.stacked:
            return np.concatenate([by_agent[agent] for agent in self.agents], axis=1)
        return np.concatenate(
            [
                with_index(by_agent[agent], i, len(self.agents))
                for i, agent in enumerate(self.agents)
            ]
        )

    def rewards(self, by_agent: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the reward of each row."""
        rewards = [by_agent[agent] for agent in self.agents]
        return np.concatenate(rewards) if self.stacked else np.mean(rewards, axis=0)

    def per_row(self, by_env: np.ndarray) -> np.ndarray:
        """Return for each row what is given by world."""
        return np.tile(by_env, len(self.agents)) if self.stacked else by_env

    def actions(self, rows: np.ndarray, sizes: Sizes) -> dict[str, np.ndarray]:
        """Return the actions by agent that stand in its rows."""
        if self.stacked:
            blocks = np.split(rows, len(self.agents))
        else:
            ends = np.cumsum([sizes.action[agent] for agent in self.agents])[:-1]
            blocks = np.split(rows, ends, axis=1)
        return dict(zip(self.agents, blocks, strict=True))


def make_learners(
    mode: Mode, sizes: Sizes, sides: Sequence[Sequence[str]] = ()
) -> tuple[Learner, ...]:
    """Return the learners of a mode. None has a reward over agents of several sides.

    Args:
      mode: who learns what.
      sizes: of the spaces of the agents that learn.
      sides: agents that share a goal, from `Task.sides`; none for all.

    Raises:
      ValueError: if there is no such mode, or a shared policy does not fit; names the
        sizes.
    """
    agents = tuple(sizes.observation)
    teams = {
        f"side_{i + 1}" if len(sides) > 1 else "team": own
        for i, side in enumerate(sides or (agents,))
        if (own := tuple(agent for agent in side if agent in agents))
    }
    if mode == "collaborative":
        return tuple(
            Learner(name, own, tuple(Part((a,), a) for a in own))
            for name, own in teams.items()
        )
    if mode == "independent":
        return tuple(Learner(a, (a,), (Part((a,), a),)) for a in agents)
    if mode == "centralized":
        return tuple(
            Learner(name, own, (Part(own, name),)) for name, own in teams.items()
        )
    if mode == "shared":
        _check_equal("observations", sizes.observation)
        _check_equal("actions", sizes.action)
        parts = tuple(Part((a,), "shared", i) for i, a in enumerate(agents))
        return (Learner("shared", agents, parts, stacked=True),)
    raise ValueError(unknown("mode", mode, MODES))


def _check_equal(kind: str, sizes: Mapping[str, int]) -> None:
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{size} for {agent}" for agent, size in sizes.items())
        raise ValueError(
            "a shared policy needs robots with equal spaces, but the sizes of their"
            f" {kind} are {listed}; choose another mode, or robots of one kind"
        )
