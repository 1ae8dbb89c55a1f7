"""The networks of a learner, in torch."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from collaborative_gym.blocks import Layout
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.team import Learner
from collaborative_gym.policies.network import Weights

MEMORY = 400_000
"""Rows after which a normalization has forgotten most of them, because the first
returns are far from the later ones."""

LOG_STD_LIMITS = (-20.0, 2.0)
"""Bounds of the logarithm of the actions' standard deviation."""

_ACTIVATIONS = {"relu": nn.ReLU, "elu": nn.ELU, "tanh": nn.Tanh}


class Bounded(torch.autograd.Function):
    """Values that are kept from -1 to 1, such as actions as the worlds do them.

    A value further out can still learn to come back (after the inverted gradients of
    Hausknecht and Stone 2016, arXiv 1511.04143).
    """

    @staticmethod
    def forward(ctx, unbounded: Tensor):
        """Return the values within the bounds."""
        ctx.save_for_backward(unbounded)
        return unbounded.clamp(-1.0, 1.0)

    @staticmethod
    def backward(ctx, *gradients: Tensor):
        """Return the gradient, zero where a step would lead further out."""
        (unbounded,), (gradient,) = ctx.saved_tensors, gradients
        # A step goes against the gradient.
        is_outwards = (unbounded.abs() > 1.0) & (unbounded * gradient < 0.0)
        return gradient.masked_fill(is_outwards, 0.0)


class Actor(nn.Module):
    """Gaussian actions on a learner's rows of normalized observations.

    Each network's mean depends on its own part of the row alone. A grip's is kept
    within a limit; its sign, which alone commands a grip, stays.

    Args:
      learner: whom it commands.
      layout: of the agents' observations and actions.
      hyperparameters: of the networks and the first actions.

    Attributes:
      nets: the networks, in the order of the learner's parts.
      log_std: of each component of a row of actions.
    """

    def __init__(
        self, learner: Learner, layout: Layout, hyperparameters: Hyperparameters
    ):
        super().__init__()
        networks = learner.networks(layout)
        self._names = list(networks)
        self._inputs = [inputs for inputs, _ in networks.values()]
        self.nets = nn.ModuleList(
            perceptron(inputs, outputs, hyperparameters, gain=0.01)
            for inputs, outputs in networks.values()
        )
        is_grip = learner.is_grip(layout)
        std = np.where(
            is_grip, hyperparameters.initial_grip_std, hyperparameters.initial_std
        )
        self.log_std = nn.Parameter(torch.from_numpy(std).float().log())
        self._grip_limit = hyperparameters.grip_limit
        self.is_grip: Tensor
        self.register_buffer("is_grip", torch.from_numpy(is_grip), persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the mean actions of the rows."""
        blocks = rows.split(self._inputs, dim=1)
        means = [net(block) for net, block in zip(self.nets, blocks, strict=True)]
        mean = torch.cat(means, dim=1)
        if not self._grip_limit:
            return mean
        limited = self._grip_limit * Bounded.apply(mean / self._grip_limit)
        return torch.where(self.is_grip, limited, mean)

    def load(self, weights: Mapping[str, Weights]) -> tuple[Tensor, Tensor]:
        """Take over networks, by name; return their normalization of a row.

        Returns:
          The mean that is subtracted from a row of observations, and the divisor.
        """
        own = [weights[name] for name in self._names]
        for net, each in zip(self.nets, own, strict=True):
            linear = [layer for layer in net.modules() if isinstance(layer, nn.Linear)]
            for layer, (weight, bias) in zip(linear, each.layers, strict=True):
                layer.weight.data.copy_(torch.from_numpy(weight))
                layer.bias.data.copy_(torch.from_numpy(bias))
        mean, std = ([getattr(each, name) for each in own] for name in ("mean", "std"))
        return torch.from_numpy(np.concatenate(mean)), torch.from_numpy(
            np.concatenate(std)
        )

    def weights(self, mean: Tensor, std: Tensor) -> dict[str, Weights]:
        """Return the networks as arrays, by name.

        Args:
          mean: subtracted from a row of observations.
          std: the row's divisor after that.
        """
        found, start = {}, 0
        for name, size, net in zip(self._names, self._inputs, self.nets, strict=True):
            layers = tuple(
                (_array(layer.weight), _array(layer.bias))
                for layer in net.modules()
                if isinstance(layer, nn.Linear)
            )
            columns = slice(start, start + size)
            found[name] = Weights(_array(mean[columns]), _array(std[columns]), layers)
            start += size
        return found


def perceptron(
    inputs: int, outputs: int, hyperparameters: Hyperparameters, gain: float
) -> nn.Sequential:
    """Return a perceptron with orthogonal weights, the last ones scaled by `gain`."""
    layers: list[nn.Module] = []
    for width in hyperparameters.hidden_sizes:
        layers += [
            _linear(inputs, width, 2**0.5),
            _ACTIVATIONS[hyperparameters.activation](),
        ]
        inputs = width
    return nn.Sequential(*layers, _linear(inputs, outputs, gain))


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def _array(tensor: Tensor):
    return tensor.detach().float().cpu().numpy().copy()
