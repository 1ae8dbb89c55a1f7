"""Training on this machine, with skrl."""

from collections.abc import Sequence
from typing import Any

import torch

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.backend import Iteration, training_seed
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import Learner, Sizes
from collaborative_gym.learning.worlds import (
    full_episodes,
    load_worlds,
    save_worlds,
)
from collaborative_gym.policies.network import Weights
from collaborative_gym.tasks.task import Task


class SkrlBackend:
    """Worlds in this process and a learner for each group of robots that the mode has.

    It draws from torch's own generators, which the caller seeds.

    Args:
      task: what to learn.
      learners: who learns what.
      sizes: of the agents' spaces.
      seed: of the run.
      hyperparameters: how it learns.
      device: of torch.
      num_threads: physics threads, 0 for one per CPU.
    """

    def __init__(
        self,
        task: Task,
        learners: Sequence[Learner],
        sizes: Sizes,
        seed: int,
        hyperparameters: Hyperparameters,
        device: str = "cpu",
        num_threads: int = 0,
    ):
        self.steps = 0
        self._rollout_steps = hyperparameters.rollout_steps
        self._device = device
        self._assistance = Assistance(hyperparameters.assistance)
        num_envs = hyperparameters.num_envs
        self._env = VectorEnv(
            task, num_envs, seed=training_seed(seed), num_threads=num_threads
        )
        self._learners = [
            PPOLearner(learner, sizes, hyperparameters, device) for learner in learners
        ]
        self._observations, _ = self._env.reset(stagger=True)

    def advance(self) -> Iteration:
        """Collect one rollout in every world, and learn from it."""
        episodes = []
        for _ in range(self._rollout_steps):
            actions = {}
            for learner in self._learners:
                actions |= learner.act(self._observations)
            self._assistance.carry(self._env)
            self._observations, rewards, *ends, infos = self._env.step(actions)
            for learner in self._learners:
                learner.record(rewards, infos["final_observation"], *ends)
            episodes += full_episodes(infos)
        self._assistance.adapt(episodes)
        numbers = {learner.learner.name: learner.update() for learner in self._learners}
        self.steps += self._rollout_steps * self._env.num_envs
        return Iteration(episodes, numbers)

    def weights(self) -> dict[str, Weights]:
        """Return what the networks have learned so far, by name."""
        found = {}
        for learner in self._learners:
            found |= learner.weights()
        return found

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on, bit for bit on a CPU."""
        cuda = torch.cuda.get_rng_state_all() if self._device != "cpu" else []
        return {
            "steps": self.steps,
            "assistance": self._assistance.share,
            "learners": {
                each.learner.name: each.state_dict() for each in self._learners
            },
            "generator": torch.get_rng_state(),
            "cuda_generators": cuda,
            "worlds": save_worlds(self._env),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        for learner in self._learners:
            learner.load_state_dict(state["learners"][learner.learner.name])
        self._observations = load_worlds(self._env, state["worlds"])
        self.steps = state["steps"]
        self._assistance.share = state["assistance"]
        torch.set_rng_state(state["generator"])
        if self._device != "cpu" and state["cuda_generators"]:
            torch.cuda.set_rng_state_all(state["cuda_generators"])

    def close(self) -> None:
        """Free the worlds."""
        self._env.close()
