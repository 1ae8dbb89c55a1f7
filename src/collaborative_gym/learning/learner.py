"""The base of the learners on skrl, whatever their algorithm."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from torch import nn

from collaborative_gym.blocks import Layout, SetColumns
from collaborative_gym.learning import networks
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.collector import ActorState, Rollout
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.team import Learner
from collaborative_gym.policies.network import OBSERVATION_LIMIT, NetworkPolicy, Weights


class SkrlLearner(ABC):
    """Networks and optimisers of one learner, on rows of its agents.

    A subclass makes skrl's agent, with critics and a memory, and learns.

    Args:
      learner: whom it commands, and how.
      layout: of the agents' observations and actions.
      hyperparameters: how it learns.
      device: of torch.
      casting: who sits where; None for this learner alone.
    """

    def __init__(
        self,
        learner: Learner,
        layout: Layout,
        hyperparameters: Hyperparameters,
        device: str,
        casting: Casting | None = None,
    ):
        self.learner = learner
        self._hyperparameters = hyperparameters
        self._device = device
        casting = casting or Casting()
        self._rows = casting.num_rows(learner, hyperparameters.num_envs)
        size = learner.observation_size(layout)
        self._spaces = {
            "observation_space": Box(-np.inf, np.inf, (size,), np.float32),
            "action_space": Box(-1.0, 1.0, (learner.action_size(layout),), np.float32),
        }
        self._seen = tuple(learner.seen(layout).values())
        actor = networks.Actor(learner, layout, hyperparameters)
        self._policy = Policy(actor, hyperparameters, device, self._spaces)
        self._agent = self._make_agent()
        self._agent.init()
        modules: Mapping[str, Any] = self._agent.checkpoint_modules
        self._modules = {**modules, **self._left_out()}

    @abstractmethod
    def _make_agent(self) -> Any:
        """Return skrl's agent, before its own `init`."""

    @abstractmethod
    def _left_out(self) -> dict[str, Any]:
        """Return modules, by name, that skrl's own checkpoints leave out."""

    @abstractmethod
    def learn(
        self, rollouts: Sequence[Rollout], *, critic_alone: bool = False
    ) -> dict[str, float]:
        """Learn from rollouts, one beside the other, and return losses and rates.

        Args:
          rollouts: of all collectors.
          critic_alone: whether the policy stays as it is.
        """

    def acting(self) -> ActorState:
        """Return the state that players act with."""
        state = self._policy.actor.state_dict()
        actor = {name: each.cpu() for name, each in state.items()}
        mean, std = self._normalization()
        return {"actor": actor, "mean": mean.cpu(), "std": std.cpu()}

    def start(self, policy: NetworkPolicy) -> None:
        """Begin with the networks and the normalization of a policy."""
        mean, std = self._policy.actor.load(policy.weights)
        scaler = self._scaler
        scaler.running_mean.copy_(mean)
        scaler.running_variance.copy_((std - scaler.epsilon).square())
        self.hold_statistics()

    def hold_statistics(self) -> None:
        """Standardize observations as now for good.

        The policy depends on it: if it is sure of itself, a drift of 2 % changes its
        actions more than an update may.
        """
        self._scaler.is_held = True

    def scale_noise(self, factor: float) -> None:
        """Multiply the standard deviation of the actions."""
        self._policy.actor.log_std.data += math.log(factor)

    def weights(self) -> dict[str, Weights]:
        """Return the policy's networks as arrays, by name."""
        return self._policy.actor.weights(*self._normalization())

    def state_dict(self) -> dict[str, Any]:
        """Return everything that an update changes."""
        return {name: module.state_dict() for name, module in self._modules.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        for name, module in self._modules.items():
            module.load_state_dict(state[name])

    def _critic(self, *names: str) -> "Critic":
        return Critic(
            names, self._hyperparameters, self._device, self._spaces, self._seen
        )

    @property
    def _scaler(self) -> "Scaler":
        return self._modules["observation_preprocessor"]

    def _configured(self, config: Any) -> Any:
        """Return skrl's settings, with those that all algorithms have."""
        numbers = self._hyperparameters
        config.discount_factor = numbers.discount
        config.learning_rate = numbers.learning_rate
        config.grad_norm_clip = numbers.max_grad_norm
        config.observation_preprocessor = Scaler
        config.observation_preprocessor_kwargs = {
            "size": self._spaces["observation_space"],
            "clip_threshold": OBSERVATION_LIMIT,
            "device": self._device,
            "seen": self._seen,
        }
        config.experiment.write_interval = 0
        config.experiment.checkpoint_interval = 0
        return config

    def _normalization(self) -> tuple[torch.Tensor, torch.Tensor]:
        scaler = self._scaler
        std = scaler.running_variance.float().sqrt() + scaler.epsilon
        return scaler.running_mean.float(), std

    def _tensors(self, rollout: Rollout) -> dict[str, torch.Tensor]:
        # Copies, because nobody may write to what Ray hands over.
        return {
            name: torch.tensor(array, device=self._device)
            for name, array in vars(rollout).items()
        }

    def _weight_norm(self, *models: nn.Module) -> float:
        weights = [p for model in (self._policy, *models) for p in model.parameters()]
        with torch.no_grad():
            return float(nn.utils.get_total_norm(weights))


class Policy(GaussianMixin, Model):
    """The learner's actor, as skrl knows policies.

    Attributes:
      imitation: weight of the expert's advice beside the actions that PPO learns from.
    """

    def __init__(
        self,
        actor: networks.Actor,
        hyperparameters: Hyperparameters,
        device: str,
        spaces: Mapping[str, Box],
    ):
        Model.__init__(self, device=device, **spaces)
        low, high = networks.LOG_STD_LIMITS
        GaussianMixin.__init__(self, min_log_std=low, max_log_std=high)
        self.actor = actor
        self._entropy = hyperparameters.entropy
        self._action_penalty = hyperparameters.action_penalty
        self.imitation = hyperparameters.imitation
        self._advice = torch.empty(0)

    def act(self, inputs: Mapping[str, torch.Tensor], *, role: str = ""):
        """Return sampled actions, and the outputs that skrl asks for."""
        given = dict(inputs)
        if "taken_actions" in given:
            both = given["taken_actions"].tensor_split([self.num_actions], dim=1)
            given["taken_actions"], self._advice = both
        actions, outputs = super().act(given, role=role)
        return networks.Bounded.apply(actions), outputs

    def compute(self, inputs: Mapping[str, torch.Tensor], role: str = ""):
        """Return mean actions, and the logarithm of their standard deviation."""
        return self.actor(inputs["observations"]), {"log_std": self.actor.log_std}

    def get_entropy(self, *, role: str = "") -> torch.Tensor:
        """Return the term that PPO's loss rewards: entropy, less penalties."""
        means = self.distribution(role=role).mean
        arms = means[:, ~self.actor.is_grip]
        penalty = self._action_penalty * arms.square().mean(dim=1, keepdim=True)
        if self.imitation:
            missed = (means - self._advice).nan_to_num().square()
            penalty = penalty + self.imitation * missed.mean(dim=1, keepdim=True)
        return self._entropy * super().get_entropy(role=role) - penalty


class Critic(DeterministicMixin, Model):
    """A critic over rows of inputs, joined in the order of their names.

    Args:
      names: of its inputs, as skrl calls them.
      hyperparameters: of the network.
      device: of torch.
      spaces: of observations and actions.
      seen: as `Scaler` takes it; with sets, of observations alone.
    """

    def __init__(
        self,
        names: Sequence[str],
        hyperparameters: Hyperparameters,
        device: str,
        spaces: Mapping[str, Box],
        seen: Sequence[tuple[int, SetColumns | None]] = (),
    ):
        Model.__init__(self, device=device, **spaces)
        DeterministicMixin.__init__(self)
        self._names = names
        widths = {
            "observations": spaces["observation_space"].shape[0],
            "taken_actions": spaces["action_space"].shape[0],
        }
        size = sum(widths[name] for name in names)
        sets = [(width, at) for width, at in seen if at is not None]
        if sets:
            self.net = networks.TeamNetwork(sets, 1, hyperparameters)
        else:
            self.net = networks.perceptron(size, 1, hyperparameters, gain=1.0)

    def compute(self, inputs: Mapping[str, torch.Tensor], role: str = ""):
        """Return the value of each row."""
        return self.net(torch.cat([inputs[name] for name in self._names], dim=1)), {}


class Scaler(RunningStandardScaler):
    """Standardizes by the last `MEMORY` rows or so, not by all since the beginning.

    Later it is the last half of all rows, because statistics that drift change a policy
    that has become sure of itself.

    The elements of a set have one mean and one variance, so that it does not matter in
    which place an element is; the number that says whether there is one stays.

    Args:
      seen: width of each part of a row, and where its set is, if it has one.

    Attributes:
      is_held: whether it stays as it is.
    """

    is_held = False

    def __init__(
        self, *args, seen: Sequence[tuple[int, SetColumns | None]] = (), **kwargs
    ):
        super().__init__(*args, **kwargs)
        self.seen: torch.Tensor
        self.register_buffer("seen", self.current_count.clone())
        starts = accumulate((width for width, _ in seen), initial=0)
        self._sets = [
            replace(at, start=start + at.start)
            for start, (_, at) in zip(starts, seen, strict=False)
            if at is not None
        ]

    def _parallel_variance(self, *args) -> None:
        if self.is_held:
            return
        mean, variance, count = args
        for at in self._sets:
            mean, variance = _pooled(mean, variance, at)
        super()._parallel_variance(mean, variance, count)
        self.seen = self.seen + count
        most = (self.seen / 2.0).clamp(min=networks.MEMORY)
        self.current_count = torch.minimum(self.current_count, most)


def _pooled(
    mean: torch.Tensor, variance: torch.Tensor, at: SetColumns
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return moments of columns, in which all elements of a set have those of all.

    Nobody's place is all zeros, so that sums over places are sums over elements.
    """
    inside, shape = slice(at.start, at.stop), (at.count, at.width)
    means = mean[inside].view(shape)
    squares = variance[inside].view(shape) + means.square()
    share = means[:, 0].sum().clamp(min=1e-9)
    first = means.sum(dim=0) / share
    second = (squares.sum(dim=0) / share - first.square()).clamp(min=0.0)
    first[0], second[0] = 0.0, 1.0
    mean, variance = mean.clone(), variance.clone()
    mean[inside], variance[inside] = first.repeat(at.count), second.repeat(at.count)
    return mean, variance
