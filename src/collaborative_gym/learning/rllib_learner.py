"""What RLlib learns with: the networks of one learner, and PPO's loss on them."""

# RLlib is optional, and its annotations differ from what its code takes and returns.
# pyright: reportMissingImports=false, reportOptionalMemberAccess=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportReturnType=false
# pyright: reportIndexIssue=false, reportPrivateImportUsage=false

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import torch
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch import TorchRLModule
from torch import Tensor, nn

from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.networks import (
    LOG_STD_LIMITS,
    MEMORY,
    Actor,
    perceptron,
)
from collaborative_gym.policies.network import OBSERVATION_LIMIT, Weights

ADVANTAGES, RETURNS = "advantages", "returns"
"""Columns of a batch, beside RLlib's own."""

_LR_FACTOR, _KL_FACTOR = 1.5, 2.0
"""How far the learning rate moves at once, and how far beside its target the divergence
must be for that."""


class TeamModule(TorchRLModule, ValueFunctionAPI):
    """Policies and critic of one learner, on rows of its agents.

    The critic sees the whole row, each network of the actor its own part. Both see
    observations in standard deviations; what was seen so far is part of the state.

    `model_config` has `learner`, `sizes` and `hyperparameters`.
    """

    def setup(self) -> None:
        """Make the networks, with weights from torch's own generator."""
        learner, sizes = self.model_config["learner"], self.model_config["sizes"]
        self.hyperparameters: Hyperparameters = self.model_config["hyperparameters"]
        size = learner.observation_size(sizes)
        self.actor = Actor(learner, sizes, self.hyperparameters)
        self.critic = perceptron(size, 1, self.hyperparameters, gain=1.0)
        self.observations = Normalization(size)
        self.returns = Normalization(1)

    def _forward(self, batch: Mapping[str, Any], **kwargs: Any) -> dict[str, Tensor]:
        rows = self.observations(batch[Columns.OBS])
        rows = rows.clamp(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
        mean = self.actor(rows)
        log_std = self.actor.log_std.clamp(*LOG_STD_LIMITS).expand_as(mean)
        inputs = torch.cat([mean, log_std], dim=1)
        return {Columns.ACTION_DIST_INPUTS: inputs, Columns.EMBEDDINGS: rows}

    def compute_values(
        self, batch: Mapping[str, Any], embeddings: Tensor | None = None
    ) -> Tensor:
        """Return the values of the rows, (rows,)."""
        values = self.standard_values(batch, embeddings)
        return self.returns.restore(values[:, None])[:, 0]

    def standard_values(
        self, batch: Mapping[str, Any], embeddings: Tensor | None = None
    ) -> Tensor:
        """Return the values in standard deviations of the returns, (rows,)."""
        if embeddings is None:
            rows = self.observations(batch[Columns.OBS])
            embeddings = rows.clamp(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
        return self.critic(embeddings)[:, 0]

    def weights(self) -> dict[str, Weights]:
        """Return the policy's networks as arrays, by name."""
        return self.actor.weights(self.observations.mean, self.observations.std)


class Normalization(nn.Module):
    """Mean and deviation of rows, of the last `MEMORY` or so.

    Args:
      size: width of a row.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int):
        super().__init__()
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.ones((), dtype=torch.float64))

    @property
    def std(self) -> Tensor:
        """The deviation, never zero."""
        return self.variance.sqrt() + 1e-8

    def watch(self, rows: Tensor) -> None:
        """Bring mean and deviation up to date, from rows (rows, size)."""
        rows = rows.double()
        difference = rows.mean(dim=0) - self.mean
        total = self.count + len(rows)
        spread = self.variance * self.count + rows.var(dim=0, correction=0) * len(rows)
        spread += difference**2 * self.count * len(rows) / total
        self.mean += difference * len(rows) / total
        self.variance.copy_(spread / total)
        self.count.copy_(total.clamp(max=MEMORY))

    def forward(self, rows: Tensor) -> Tensor:
        """Return rows in standard deviations."""
        return (rows - self.mean.float()) / self.std.float()

    def restore(self, rows: Tensor) -> Tensor:
        """Return what `forward` made these rows of."""
        return rows * self.std.float() + self.mean.float()


class TeamPPOLearner(PPOTorchLearner):
    """RLlib's PPO learner, for batches that have advantages and returns already.

    Unlike RLlib's own it normalizes observations and returns, adapts each module's
    learning rate to the Kullback-Leibler divergence after every epoch instead of adding
    it to the loss, and does not clip the critic's loss. A module's results get the
    numbers of `Iteration`.
    """

    def configure_optimizers_for_module(self, module_id: str, config=None) -> None:
        """Register Adam, with a learning rate that RLlib leaves alone."""
        parameters = self.get_parameters(self.module[module_id])
        optimizer = torch.optim.Adam(parameters, lr=self.config.lr)
        self.register_optimizer(
            module_id=module_id, optimizer=optimizer, params=parameters
        )

    def update(self, *, training_data, minibatch_size: int, **kwargs: Any):
        """Do an update's epochs; see `Learner.update`."""
        batch = training_data.batch = self._convert_batch_type(training_data.batch)
        for name, rows in batch.policy_batches.items():
            module = self.module[name].unwrapped()
            module.observations.watch(rows[Columns.OBS])
            module.returns.watch(rows[RETURNS][:, None])
            spread = rows[ADVANTAGES].std(correction=0) + 1e-8
            rows[ADVANTAGES] = (rows[ADVANTAGES] - rows[ADVANTAGES].mean()) / spread
            self._minibatches = math.ceil(len(rows) / minibatch_size)
        self._applied = 0
        self._losses: dict[str, list[Tensor]] = defaultdict(list)
        self._divergences: dict[str, list[Tensor]] = defaultdict(list)
        self._divergence: dict[str, float] = {}
        return super().update(
            training_data=training_data, minibatch_size=minibatch_size, **kwargs
        )

    def compute_loss_for_module(
        self, *, module_id: str, config, batch: Mapping[str, Tensor], fwd_out
    ) -> Tensor:
        """Return PPO's loss of a minibatch."""
        module = self.module[module_id].unwrapped()
        numbers = module.hyperparameters
        distribution = module.get_train_action_dist_cls().from_logits(
            fwd_out[Columns.ACTION_DIST_INPUTS]
        )
        moved = distribution.logp(batch[Columns.ACTIONS]) - batch[Columns.ACTION_LOGP]
        ratio = moved.exp()
        clipped = ratio.clamp(1.0 - numbers.clip, 1.0 + numbers.clip)
        advantages = batch[ADVANTAGES]
        policy = -torch.min(advantages * ratio, advantages * clipped).mean()
        # The mean over an action's components, so that the weight fits any robot.
        size = batch[Columns.ACTIONS].shape[1]
        entropy = -numbers.entropy * distribution.entropy().mean() / size
        values = module.standard_values(batch, fwd_out[Columns.EMBEDDINGS])
        targets = module.returns(batch[RETURNS][:, None])[:, 0]
        value = numbers.value_weight * nn.functional.mse_loss(values, targets)
        self._losses[module_id].append(torch.stack([policy, value, entropy]).detach())
        with torch.no_grad():
            self._divergences[module_id].append((ratio - 1.0 - moved).mean())
        return policy + value + entropy

    def apply_gradients(self, gradients_dict) -> None:
        """Do a gradient step, and after an epoch's last adapt the learning rates."""
        super().apply_gradients(gradients_dict)
        self._applied += 1
        if self._applied % self._minibatches == 0:
            for name, divergences in self._divergences.items():
                self._divergence[name] = float(torch.stack(divergences).mean())
                self._adapt(name, self._divergence[name])
            self._divergences.clear()

    def _adapt(self, module_id: str, divergence: float) -> None:
        numbers = self.module[module_id].unwrapped().hyperparameters
        for group in self.get_optimizer(module_id).param_groups:
            if not numbers.target_kl:
                continue
            if divergence > numbers.target_kl * _KL_FACTOR:
                group["lr"] = max(group["lr"] / _LR_FACTOR, numbers.min_learning_rate)
            elif divergence < numbers.target_kl / _KL_FACTOR:
                group["lr"] = min(group["lr"] * _LR_FACTOR, numbers.max_learning_rate)

    def after_gradient_based_update(self, *, timesteps: dict[str, Any]) -> None:
        """Report the update's numbers."""
        super().after_gradient_based_update(timesteps=timesteps)
        for name, losses in self._losses.items():
            module = self.module[name].unwrapped()
            policy, value, entropy = torch.stack(losses).mean(dim=0).tolist()
            with torch.no_grad():
                std = module.actor.log_std.clamp(*LOG_STD_LIMITS).exp().mean()
                norm = nn.utils.get_total_norm(list(module.parameters()))
            numbers = {
                "policy_loss": policy,
                "value_loss": value,
                "entropy_loss": entropy,
                "std": float(std),
                "kl": self._divergence[name],
                "learning_rate": self.get_optimizer(name).param_groups[0]["lr"],
                "weight_norm": float(norm),
            }
            self.metrics.log_dict(numbers, key=name, window=1)
