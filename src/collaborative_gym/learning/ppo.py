"""A learner on skrl's PPO."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.resources.schedulers.torch import KLAdaptiveLR
from torch import nn

from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.collector import ActorState, Rollout
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.networks import (
    LOG_STD_LIMITS,
    MEMORY,
    Actor,
    perceptron,
)
from collaborative_gym.learning.team import Learner, Sizes
from collaborative_gym.policies.network import (
    OBSERVATION_LIMIT,
    NetworkPolicy,
    Weights,
)

_LOSSES = {
    "policy_loss": "Loss / Policy loss",
    "value_loss": "Loss / Value loss",
    "entropy_loss": "Loss / Entropy loss",
    "std": "Policy / Standard deviation",
}
"""What skrl calls those of `UPDATE` that it reports itself."""

_ESTIMATES = "returns", "advantages"
"""Columns that skrl fills in itself."""


class PPOLearner:
    """Networks and optimiser of one learner, on rows of its agents.

    Args:
      learner: whom it commands, and how.
      sizes: of the agents' spaces.
      hyperparameters: how it learns.
      device: of torch.
      casting: who sits where; None for this learner alone.
    """

    def __init__(
        self,
        learner: Learner,
        sizes: Sizes,
        hyperparameters: Hyperparameters,
        device: str,
        casting: Casting | None = None,
    ):
        self.learner = learner
        self._device = device
        self._discount = hyperparameters.discount
        rows = (casting or Casting()).num_rows(learner, hyperparameters.num_envs)
        size = learner.observation_size(sizes)
        observations = Box(-np.inf, np.inf, (size,), np.float32)
        actions = Box(-1.0, 1.0, (learner.action_size(sizes),), np.float32)
        spaces = {"observation_space": observations, "action_space": actions}
        self._policy = _Policy(learner, sizes, hyperparameters, device, spaces)
        self._value = _Value(size, hyperparameters, device, spaces)
        self._memory = _Memory(memory_size=1, device=device)
        self._agent = _PPO(
            models={"policy": self._policy, "value": self._value},
            memory=self._memory,
            device=device,
            cfg=_config(hyperparameters, rows, observations, device),
            **spaces,
        )
        self._agent.init()
        # All that an update changes; skrl itself leaves the scheduler out.
        self._modules: dict[str, Any] = {
            **self._agent.checkpoint_modules,
            "scheduler": self._agent.scheduler,
        }

    def acting(self) -> ActorState:
        """Return what players act with."""
        state = self._policy.actor.state_dict()
        actor = {name: each.cpu() for name, each in state.items()}
        mean, std = self._normalization()
        return {"actor": actor, "mean": mean.cpu(), "std": std.cpu()}

    def start(self, policy: NetworkPolicy) -> None:
        """Begin with what a policy has learned."""
        mean, std = self._policy.actor.load(policy.weights)
        scaler = self._modules["observation_preprocessor"]
        scaler.running_mean.copy_(mean)
        scaler.running_variance.copy_((std - scaler.epsilon).square())
        self.hold_statistics()

    def hold_statistics(self) -> None:
        """Standardize observations as now for good.

        What is learned already leans on it: where a policy is sure of itself, a drift
        of 2 % changes its actions more than an update may.
        """
        self._modules["observation_preprocessor"].is_held = True

    def learn(
        self, rollouts: Sequence[Rollout], *, critic_alone: bool = False
    ) -> dict[str, float]:
        """Learn from rollouts, one beside the other, and return losses and rates.

        Args:
          rollouts: what was collected.
          critic_alone: whether the policy stays as it is.
        """
        self._hold_policy(critic_alone)
        columns = [self._columns(rollout) for rollout in rollouts]
        joined = {
            name: torch.cat([each[name] for each in columns], dim=1)
            for name in columns[0]
        }
        agent = self._agent
        agent.enable_models_training_mode(True)
        last = joined.pop("next_observations")[0]
        unknown = {name: torch.empty_like(joined["values"]) for name in _ESTIMATES}
        self._memory.hold(joined | unknown)
        agent.learn(last)
        agent.enable_models_training_mode(False)
        # skrl leaves out a loss that has no weight.
        numbers = {
            name: float(agent.tracking_data.get(tag, [0.0])[-1])
            for name, tag in _LOSSES.items()
        }
        agent.tracking_data.clear()
        numbers["kl"] = self._modules["scheduler"].kl
        numbers["learning_rate"] = agent.optimizer.param_groups[0]["lr"]
        with torch.no_grad():
            weights = [*self._policy.parameters(), *self._value.parameters()]
            numbers["weight_norm"] = float(nn.utils.get_total_norm(weights))
        return numbers

    def _hold_policy(self, held: bool) -> None:
        """Keep the policy as it is during updates, or let it learn."""
        scheduler = self._modules["scheduler"]
        if scheduler.is_held and not held:
            # A rate at which a new critic learns makes a policy forget all it knows.
            for group in self._agent.optimizer.param_groups:
                group["lr"] = scheduler.min_lr
        self._policy.requires_grad_(not held)
        scheduler.is_held = held

    def quieten(self, factor: float) -> None:
        """Multiply the standard deviation of the actions."""
        self._policy.actor.log_std.data += math.log(factor)

    def weights(self) -> dict[str, Weights]:
        """Return the policy's networks as arrays, by name."""
        return self._policy.actor.weights(*self._normalization())

    def state_dict(self) -> dict[str, Any]:
        """Return everything that an update changes."""
        return {name: module.state_dict() for name, module in self._modules.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        for name, module in self._modules.items():
            module.load_state_dict(state[name])

    def _normalization(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what is taken from observations, and what they are divided by then."""
        scaler = self._modules["observation_preprocessor"]
        std = scaler.running_variance.float().sqrt() + scaler.epsilon
        return scaler.running_mean.float(), std

    @torch.no_grad()
    def _columns(self, rollout: Rollout) -> dict[str, torch.Tensor]:
        """Return what skrl learns from, (steps, rows, ...) each."""
        # Copies, since what Ray hands over must not be written to.
        kept = {
            name: torch.tensor(array, device=self._device)
            for name, array in vars(rollout).items()
        }
        finals, late = kept.pop("final_observations"), kept["truncated"]
        kept["rewards"][late] += self._discount * self._values(finals)[:, 0]
        observations = kept.pop("observations")
        # Step by step, so that little is held at once.
        values = torch.stack([self._values(rows) for rows in observations])
        kept = {n: x if x.ndim == 3 else x[..., None] for n, x in kept.items()}
        return {
            **kept,
            "observations": observations[:-1],
            "values": values[:-1],
            "next_observations": observations[-1:],
        }

    def _values(self, observations: torch.Tensor) -> torch.Tensor:
        rows = self._modules["observation_preprocessor"](observations)
        found, _ = self._value.act({"observations": rows}, role="value")
        return self._modules["value_preprocessor"](found, inverse=True)


class _Memory(RandomMemory):
    """Holds what one update learns from, of any number of rows."""

    def hold(self, columns: dict[str, torch.Tensor]) -> None:
        """Hold these, (steps, rows, ...) each, in place of others."""
        self.tensors = columns
        self.tensors_view = {name: each.flatten(0, 1) for name, each in columns.items()}

    def __len__(self) -> int:
        return len(self.tensors_view["actions"])


class _PPO(PPO):
    """skrl's PPO on rollouts that others collect."""

    def learn(self, next_observations: torch.Tensor) -> None:
        """Learn from what its memory holds, after which these were observed."""
        self._current_next_observations = next_observations
        self.update(timestep=0, timesteps=0)


class _Policy(GaussianMixin, Model):
    """The learner's actor, as skrl knows policies."""

    def __init__(
        self,
        learner: Learner,
        sizes: Sizes,
        hyperparameters: Hyperparameters,
        device: str,
        spaces: Mapping[str, Box],
    ):
        Model.__init__(self, device=device, **spaces)
        low, high = LOG_STD_LIMITS
        GaussianMixin.__init__(self, min_log_std=low, max_log_std=high)
        self.actor = Actor(learner, sizes, hyperparameters)

    def compute(self, inputs: Mapping[str, torch.Tensor], role: str = ""):
        return self.actor(inputs["observations"]), {"log_std": self.actor.log_std}


class _Value(DeterministicMixin, Model):
    """The critic, over all that its learner observes."""

    def __init__(
        self,
        size: int,
        hyperparameters: Hyperparameters,
        device: str,
        spaces: Mapping[str, Box],
    ):
        Model.__init__(self, device=device, **spaces)
        DeterministicMixin.__init__(self)
        self.net = perceptron(size, 1, hyperparameters, gain=1.0)

    def compute(self, inputs: Mapping[str, torch.Tensor], role: str = ""):
        return self.net(inputs["observations"]), {}


class _Scheduler(KLAdaptiveLR):
    """Adapts the learning rate to how far the policy moves, and tells how far it did.

    Attributes:
      kl: Kullback-Leibler divergence of the last epoch.
      is_held: whether the learning rate stays as it is.
    """

    kl = 0.0
    is_held = False

    def step(self, kl: torch.Tensor | float | None = None, *, epoch=None) -> None:
        if kl is None:  # torch's first step, which changes nothing.
            return
        self.kl = float(kl)
        if self.kl_threshold and not self.is_held:
            super().step(kl, epoch=epoch)


class _Scaler(RunningStandardScaler):
    """Standardizes by the last `MEMORY` rows or so, not by all since the beginning.

    Later it is the last half of them: a policy that has become sure of itself is
    changed by statistics that drift.

    Attributes:
      is_held: whether it stays as it is.
    """

    is_held = False

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.seen: torch.Tensor
        self.register_buffer("seen", self.current_count.clone())

    def _parallel_variance(self, *args) -> None:
        if self.is_held:
            return
        super()._parallel_variance(*args)
        self.seen = self.seen + args[2]
        most = (self.seen / 2.0).clamp(min=MEMORY)
        self.current_count = torch.minimum(self.current_count, most)


def _config(
    hyperparameters: Hyperparameters, rows: int, observations: Box, device: str
) -> PPO_CFG:
    collected = rows * hyperparameters.rollout_steps
    config = PPO_CFG(
        rollouts=hyperparameters.rollout_steps,
        learning_epochs=hyperparameters.epochs,
        mini_batches=max(1, round(collected / hyperparameters.minibatch_size)),
        discount_factor=hyperparameters.discount,
        gae_lambda=hyperparameters.gae_lambda,
        learning_rate=hyperparameters.learning_rate,
        learning_rate_scheduler=_Scheduler,
        learning_rate_scheduler_kwargs={
            "kl_threshold": hyperparameters.target_kl,
            "min_lr": hyperparameters.min_learning_rate,
            "max_lr": hyperparameters.max_learning_rate,
        },
        observation_preprocessor=_Scaler,
        observation_preprocessor_kwargs={
            "size": observations,
            "clip_threshold": OBSERVATION_LIMIT,
            "device": device,
        },
        value_preprocessor=_Scaler,
        value_preprocessor_kwargs={"size": 1, "device": device},
        grad_norm_clip=hyperparameters.max_grad_norm,
        ratio_clip=hyperparameters.clip,
        # With a clip the critic follows the first, large changes of the returns so
        # slowly that the policy learns from noise: Pass stood still for 0.6 M steps.
        value_clip=0.0,
        entropy_loss_scale=hyperparameters.entropy,
        value_loss_scale=hyperparameters.value_weight,
        # Where time is up, the last value counts on: it is part of the reward already,
        # and what follows is of another episode.
        time_limit_bootstrap=True,
    )
    config.experiment.write_interval = 0
    config.experiment.checkpoint_interval = 0
    return config
