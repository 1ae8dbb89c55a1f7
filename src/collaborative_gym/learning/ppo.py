"""A learner on skrl's PPO."""

from collections.abc import Sequence
from typing import Any

import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.memories.torch import RandomMemory
from skrl.resources.schedulers.torch import KLAdaptiveLR

from collaborative_gym.learning.collector import Rollout
from collaborative_gym.learning.learner import Scaler, SkrlLearner

_LOSSES = {
    "policy_loss": "Loss / Policy loss",
    "value_loss": "Loss / Value loss",
    "entropy_loss": "Loss / Entropy loss",
    "std": "Policy / Standard deviation",
}
"""skrl's names of the numbers of `UPDATE` that it reports itself."""

_ESTIMATES = "returns", "advantages"  # columns that skrl fills in itself


class PPOLearner(SkrlLearner):
    """A critic of observations, and updates that stay near the policy."""

    def _make_agent(self) -> PPO:
        self._value = self._critic("observations")
        self._memory = _Memory(memory_size=1, device=self._device)
        return PPO(
            models={"policy": self._policy, "value": self._value},
            memory=self._memory,
            device=self._device,
            cfg=self._configured(self._config()),
            **self._spaces,
        )

    def _left_out(self) -> dict[str, Any]:
        return {"scheduler": self._agent.scheduler}

    def learn(
        self, rollouts: Sequence[Rollout], *, critic_alone: bool = False
    ) -> dict[str, float]:
        """Learn from rollouts; see `SkrlLearner.learn`."""
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
        # Rollouts are collected elsewhere, so skrl did not see what came last.
        agent._current_next_observations = last
        agent.update(timestep=0, timesteps=0)
        agent.enable_models_training_mode(False)
        # skrl leaves out a loss that has no weight.
        numbers = {
            name: float(agent.tracking_data.get(tag, [0.0])[-1])
            for name, tag in _LOSSES.items()
        }
        agent.tracking_data.clear()
        numbers["kl"] = self._modules["scheduler"].kl
        numbers["learning_rate"] = agent.optimizer.param_groups[0]["lr"]
        numbers["weight_norm"] = self._weight_norm(self._value)
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

    @torch.no_grad()
    def _columns(self, rollout: Rollout) -> dict[str, torch.Tensor]:
        """Return the columns that skrl learns from, (steps, rows, ...) each."""
        kept = self._tensors(rollout)
        finals, late = kept.pop("final_observations"), kept["truncated"]
        discount = self._hyperparameters.discount
        kept["rewards"][late] += discount * self._values(finals)[:, 0]
        observations = kept.pop("observations")
        kept["actions"] = torch.cat([kept["actions"], kept.pop("advice")], dim=-1)
        # Step by step, so that little memory is used at once.
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

    def _config(self) -> PPO_CFG:
        numbers = self._hyperparameters
        collected = self._rows * numbers.rollout_steps
        return PPO_CFG(
            rollouts=numbers.rollout_steps,
            learning_epochs=numbers.epochs,
            mini_batches=max(1, round(collected / numbers.minibatch_size)),
            gae_lambda=numbers.gae_lambda,
            learning_rate_scheduler=_Scheduler,
            learning_rate_scheduler_kwargs={
                "kl_threshold": numbers.target_kl,
                "min_lr": numbers.min_learning_rate,
                "max_lr": numbers.max_learning_rate,
            },
            value_preprocessor=Scaler,
            value_preprocessor_kwargs={"size": 1, "device": self._device},
            ratio_clip=numbers.clip,
            # With a clip the critic follows large first changes of returns so slowly
            # that the policy learns from noise: Pass stood still for 0.6 M steps.
            value_clip=0.0,
            # The policy itself weighs what skrl takes for its entropy.
            entropy_loss_scale=float(
                max(numbers.entropy, numbers.action_penalty, numbers.imitation) > 0
            ),
            value_loss_scale=numbers.value_weight,
            # Where time is up, the last value counts on: it is part of the reward
            # already, and what follows is of another episode.
            time_limit_bootstrap=True,
        )


class _Memory(RandomMemory):
    """Holds what one update learns from, of any number of rows."""

    def hold(self, columns: dict[str, torch.Tensor]) -> None:
        """Hold columns, (steps, rows, ...) each, in place of the former ones."""
        self.tensors = columns
        self.tensors_view = {name: each.flatten(0, 1) for name, each in columns.items()}

    def __len__(self) -> int:
        return len(self.tensors_view["actions"])


class _Scheduler(KLAdaptiveLR):
    """Adapts the learning rate to how far the policy moves, and notes how far.

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
