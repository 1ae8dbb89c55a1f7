"""A learner on skrl's SAC."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from skrl.agents.torch.sac import SAC, SAC_CFG
from skrl.memories.torch import RandomMemory

from collaborative_gym.learning.collector import Rollout
from collaborative_gym.learning.learner import SkrlLearner

_LOSSES = {
    "policy_loss": "Loss / Policy loss",
    "value_loss": "Loss / Critic loss",
    "entropy_weight": "Coefficient / Entropy coefficient",
}
"""skrl's names of the numbers of `UPDATE` that it reports itself."""


class SACLearner(SkrlLearner):
    """Two critics of actions, which learn from a replay memory.

    The policy's noise has one standard deviation for all states, as in skrl's own
    examples, so that players act as PPO's do and policies are the same files.
    """

    def _make_agent(self) -> "_SAC":
        self._critics = {
            name: self._critic("observations", "taken_actions")
            for name in ("critic_1", "critic_2", "target_critic_1", "target_critic_2")
        }
        size = self._hyperparameters.replay_size
        self._memory = _Memory(memory_size=size, device=self._device, replacement=True)
        return _SAC(
            models={"policy": self._policy, **self._critics},
            memory=self._memory,
            device=self._device,
            cfg=self._configured(self._config()),
            **self._spaces,
        )

    def _left_out(self) -> dict[str, Any]:
        return {"entropy": self._agent, "memory": self._memory}

    def learn(
        self, rollouts: Sequence[Rollout], *, critic_alone: bool = False
    ) -> dict[str, float]:
        """Learn from rollouts; see `SkrlLearner.learn`."""
        for rollout in rollouts:
            transitions = self._transitions(rollout)
            self._scaler(transitions["observations"], train=True)
            self._memory.add(transitions)
        numbers = {}
        if len(self._memory) >= self._hyperparameters.warmup:
            self._policy.requires_grad_(not critic_alone)
            numbers = self._update()
        numbers["learning_rate"] = self._hyperparameters.learning_rate
        numbers["std"] = float(self._policy.actor.log_std.detach().exp().mean())
        numbers["weight_norm"] = self._weight_norm(*self._critics.values())
        return numbers

    def _update(self) -> dict[str, float]:
        agent, scaler = self._agent, self._scaler
        held, scaler.is_held = scaler.is_held, True  # Each row counts once.
        agent.write_interval = 1  # Else skrl reports no losses.
        agent.enable_models_training_mode(True)
        agent.update(timestep=0, timesteps=0)
        agent.enable_models_training_mode(False)
        scaler.is_held = held
        tracked = {name: agent.tracking_data[tag] for name, tag in _LOSSES.items()}
        numbers = {name: sum(each) / len(each) for name, each in tracked.items()}
        agent.tracking_data.clear()
        return numbers

    def _transitions(self, rollout: Rollout) -> dict[str, torch.Tensor]:
        """Return the columns of the memory, (steps x rows, ...) each."""
        kept = self._tensors(rollout)
        following = kept["observations"][1:].clone()
        # Those of the worlds are of the next episode.
        following[kept["truncated"]] = kept["final_observations"]
        columns = {
            "observations": kept["observations"][:-1],
            "actions": kept["actions"].clamp(-1.0, 1.0),
            "rewards": kept["rewards"][..., None],
            "next_observations": following,
            "terminated": kept["terminated"][..., None],
        }
        return {name: each.flatten(0, 1) for name, each in columns.items()}

    def _config(self) -> SAC_CFG:
        numbers = self._hyperparameters
        # Entropy of a Gaussian of this standard deviation in each component.
        entropy = 0.5 * math.log(2.0 * math.pi * math.e) + math.log(numbers.target_std)
        return SAC_CFG(
            gradient_steps=numbers.gradient_steps,
            batch_size=numbers.minibatch_size,
            polyak=numbers.polyak,
            # So much that noise grows at first, to a standard deviation of 0.45. With
            # 0.01, Poke's validation after 50,000 steps was -600, not -164.
            initial_entropy_value=0.2,
            target_entropy=entropy * self._spaces["action_space"].shape[0],
        )


class _Memory(RandomMemory):
    """The last transitions, of any number of rows at a time."""

    def add(self, columns: dict[str, torch.Tensor]) -> None:
        """Put columns, (rows, ...) each, in place of the oldest rows."""
        # skrl's own spreads the columns of several rows over different places.
        count, start = len(columns["rewards"]), self.memory_index
        places = torch.arange(start, start + count) % self.memory_size
        for name, each in columns.items():
            self.tensors_view[name][places] = each
        self.filled = self.filled or start + count >= self.memory_size
        self.memory_index = (start + count) % self.memory_size

    def state_dict(self) -> dict[str, Any]:
        """Return the rows that it holds."""
        held = len(self)
        rows = {name: each[:held].clone() for name, each in self.tensors_view.items()}
        return {"rows": rows, "index": self.memory_index}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        for name, rows in state["rows"].items():
            self.tensors_view[name][: len(rows)] = rows
        self.memory_index = state["index"]
        self.filled = len(state["rows"]["rewards"]) == self.memory_size


class _SAC(SAC):
    """skrl's SAC, whose entropy coefficient can be saved."""

    def state_dict(self) -> dict[str, Any]:
        """Return the entropy coefficient and its logarithm.

        Both, because before the first update one is not quite the other's exponential.
        """
        return {
            "log_coefficient": self.log_entropy_coefficient.detach().clone(),
            "coefficient": torch.as_tensor(self._entropy_coefficient).detach().clone(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        self.log_entropy_coefficient.data.copy_(state["log_coefficient"])
        self._entropy_coefficient = state["coefficient"].clone()
