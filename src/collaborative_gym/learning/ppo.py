"""A learner on skrl's PPO."""

from collections.abc import Mapping
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

from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.networks import (
    LOG_STD_LIMITS,
    MEMORY,
    Actor,
    perceptron,
)
from collaborative_gym.learning.team import Learner, Sizes
from collaborative_gym.policies.network import OBSERVATION_LIMIT, Weights

_LOSSES = {
    "policy_loss": "Loss / Policy loss",
    "value_loss": "Loss / Value loss",
    "entropy_loss": "Loss / Entropy loss",
    "std": "Policy / Standard deviation",
}
"""What skrl calls the numbers that an update reports."""


class PPOLearner:
    """Networks, optimiser and memory of one learner, on rows of its agents.

    Args:
      learner: whom it commands, and how.
      sizes: of the agents' spaces.
      hyperparameters: how it learns.
      device: of torch.
    """

    def __init__(
        self,
        learner: Learner,
        sizes: Sizes,
        hyperparameters: Hyperparameters,
        device: str,
    ):
        self.learner = learner
        self._sizes = sizes
        self._device = device
        rows = learner.num_rows(hyperparameters.num_envs)
        size = learner.observation_size(sizes)
        observations = Box(-np.inf, np.inf, (size,), np.float32)
        actions = Box(-1.0, 1.0, (learner.action_size(sizes),), np.float32)
        spaces = {"observation_space": observations, "action_space": actions}
        self._policy = _Policy(learner, sizes, hyperparameters, device, spaces)
        self._value = _Value(size, hyperparameters, device, spaces)
        self._memory = RandomMemory(
            memory_size=hyperparameters.rollout_steps, num_envs=rows, device=device
        )
        self._agent = PPO(
            models={"policy": self._policy, "value": self._value},
            memory=self._memory,
            device=device,
            cfg=_config(hyperparameters, rows, observations, device),
            **spaces,
        )
        self._agent.init()
        self._agent.enable_training_mode(True)
        # All that an update changes; skrl itself leaves the scheduler out.
        self._modules: dict[str, Any] = {
            **self._agent.checkpoint_modules,
            "scheduler": self._agent.scheduler,
        }

    def act(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return sampled actions by agent."""
        self._observations = self._tensor(self.learner.observations(observations))
        with torch.no_grad():
            self._actions, _ = self._agent.act(
                self._observations, None, timestep=0, timesteps=0
            )
        return self.learner.actions(self._actions.cpu().numpy(), self._sizes)

    def record(
        self,
        rewards: Mapping[str, np.ndarray],
        final_observations: Mapping[str, np.ndarray],
        terminated: Mapping[str, np.ndarray],
        truncated: Mapping[str, np.ndarray],
    ) -> None:
        """Keep what came of the last actions, by agent as `VectorEnv.step` gives it.

        Args:
          rewards: (num_envs,) each.
          final_observations: those before the ended worlds were reset.
          terminated: (num_envs,) bool each, where nothing more was to come.
          truncated: (num_envs,) bool each, where time was up and the last observation's
            value counts on.
        """
        agent = self.learner.agents[0]  # A world ends for all of its agents.
        over = self._tensor(self.learner.per_row(terminated[agent]))[:, None]
        late = self._tensor(self.learner.per_row(truncated[agent]))[:, None]
        earned = self._tensor(self.learner.rewards(rewards).astype(np.float32))
        self._agent.record_transition(
            observations=self._observations,
            states=None,  # type: ignore[arg-type]  # There are none, and skrl allows it.
            actions=self._actions,
            rewards=earned[:, None],
            next_observations=self._tensor(
                self.learner.observations(final_observations)
            ),
            next_states=None,  # type: ignore[arg-type]
            terminated=over,
            truncated=late & ~over,
            infos=None,
            timestep=0,
            timesteps=0,
        )

    def update(self) -> dict[str, float]:
        """Learn from what was recorded, and return the losses and rates by name."""
        agent = self._agent
        agent.enable_models_training_mode(True)
        agent.update(timestep=0, timesteps=0)
        agent.enable_models_training_mode(False)
        self._memory.reset()
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

    def weights(self) -> dict[str, Weights]:
        """Return the policy's networks as arrays, by name."""
        scaler = self._modules["observation_preprocessor"]
        std = scaler.running_variance.float().sqrt() + scaler.epsilon
        return self._policy.actor.weights(scaler.running_mean, std)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that an update changes."""
        return {name: module.state_dict() for name, module in self._modules.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        for name, module in self._modules.items():
            module.load_state_dict(state[name])

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device)


class _Policy(GaussianMixin, Model):
    """The learner's actor, as skrl knows policies, with noise that may last."""

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
        stays = hyperparameters.persistence(learner.is_grip(sizes))
        self._persistence = torch.from_numpy(stays).float().to(device)
        rows = learner.num_rows(hyperparameters.num_envs)
        self.noise: torch.Tensor
        self.register_buffer("noise", torch.randn(rows, self.num_actions))

    def act(self, inputs: Mapping[str, torch.Tensor], *, role: str = ""):
        """Return actions that the policy's noise moves away from their mean."""
        actions, outputs = super().act(dict(inputs), role=role)
        if "taken_actions" in inputs:
            return actions, outputs
        fresh = (1.0 - self._persistence**2).sqrt() * torch.randn_like(self.noise)
        self.noise = self._persistence * self.noise + fresh
        normal = self.distribution(role=role)
        actions = normal.mean + normal.stddev * self.noise
        outputs["log_prob"] = normal.log_prob(actions).sum(dim=1, keepdim=True)
        return actions, outputs

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
    """

    kl = 0.0

    def step(self, kl: torch.Tensor | float | None = None, *, epoch=None) -> None:
        if kl is None:  # torch's first step, which changes nothing.
            return
        self.kl = float(kl)
        if self.kl_threshold:
            super().step(kl, epoch=epoch)


class _Scaler(RunningStandardScaler):
    """Standardizes by the last `MEMORY` rows or so, not by all since the beginning."""

    def _parallel_variance(self, *args) -> None:
        super()._parallel_variance(*args)
        self.current_count = self.current_count.clamp(max=MEMORY)


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
        # Where time is up, the last value counts on.
        time_limit_bootstrap=True,
    )
    config.experiment.write_interval = 0
    config.experiment.checkpoint_interval = 0
    return config
