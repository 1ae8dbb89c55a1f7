"""The networks of a learner, in torch."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from collaborative_gym.blocks import Layout, SetColumns
from collaborative_gym.learning.config import ELEMENT_SIZES, Hyperparameters
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
        sets = [at for _, at in learner.seen(layout).values()]
        if learner.network == "flat":
            sets = [None] * len(networks)
        self.nets = nn.ModuleList(
            perceptron(inputs, outputs, hyperparameters, gain=0.01)
            if at is None
            else SetNetwork(inputs, outputs, hyperparameters, gain=0.01, at=at)
            for (inputs, outputs), at in zip(networks.values(), sets, strict=True)
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
            layers = *each.element, *each.layers
            for layer, (weight, bias) in zip(_linears(net), layers, strict=True):
                layer.weight.data.copy_(torch.from_numpy(weight))
                layer.bias.data.copy_(torch.from_numpy(bias))
        mean, std = ([getattr(each, name) for each in own] for name in ("mean", "std"))
        mean, std = (torch.from_numpy(np.concatenate(each)) for each in (mean, std))
        return mean, std

    def weights(self, mean: Tensor, std: Tensor) -> dict[str, Weights]:
        """Return the networks as arrays, by name.

        Args:
          mean: subtracted from a row of observations.
          std: the row's divisor after that.
        """
        found, start = {}, 0
        for name, size, net in zip(self._names, self._inputs, self.nets, strict=True):
            layers = [(_array(of.weight), _array(of.bias)) for of in _linears(net)]
            columns = slice(start, start + size)
            ends = _array(mean[columns]), _array(std[columns])
            of_element = len(ELEMENT_SIZES) if isinstance(net, SetNetwork) else 0
            element, trunk = tuple(layers[:of_element]), tuple(layers[of_element:])
            found[name] = Weights(*ends, trunk, element)
            start += size
        return found


class SetNetwork(nn.Module):
    """A network on normalized rows, of which some columns are a set.

    Layers of one kind look at each element beside the other numbers. The mean and the
    maximum of their outputs take the set's place.

    Args:
      inputs: width of the rows.
      outputs: how many numbers come out.
      hyperparameters: of the layers.
      gain: of the last layer.
      at: where the set is.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        hyperparameters: Hyperparameters,
        *,
        gain: float,
        at: SetColumns,
    ):
        super().__init__()
        self._at = at
        own, (*hidden, said) = inputs - at.count * at.width, ELEMENT_SIZES
        seen = own + at.width - 1
        narrow = replace(hyperparameters, hidden_sizes=tuple(hidden))
        self.element = perceptron(seen, said, narrow, gain=2**0.5)
        self.trunk = perceptron(own + 2 * said, outputs, hyperparameters, gain)

    def forward(self, rows: Tensor) -> Tensor:
        """Return its output for each row."""
        at = self._at
        before, inside = rows[:, : at.start], rows[:, at.start : at.stop]
        own = torch.cat([before, rows[:, at.stop :]], dim=1)
        elements = inside.view(-1, at.count, at.width)
        there = elements[:, :, :1] > 0.5
        # Places that are empty in all rows cost nothing.
        used = there.any(dim=0)[:, 0]
        elements, there = elements[:, used], there[:, used]
        beside = own[:, None].expand(-1, elements.shape[1], -1)
        said = self.element(torch.cat([beside, elements[:, :, 1:]], dim=2))
        count = there.sum(dim=1)
        mean = (said * there).sum(dim=1) / count.clamp(min=1)
        nothing = said.new_zeros(len(rows), said.shape[2])
        greatest = nothing
        if said.shape[1]:
            greatest = said.masked_fill(~there, -torch.inf).amax(dim=1)
        greatest = torch.where(count > 0, greatest, nothing)
        return self.trunk(torch.cat([own, mean, greatest], dim=1))


class TeamNetwork(nn.Module):
    """A network on rows of several agents, with a network for sets on each part.

    The outputs are pooled, so that they do not grow with the square of the team.

    Args:
      seen: width and set of each agent's part of a row.
      outputs: how many numbers come out.
      hyperparameters: of the layers.
    """

    def __init__(
        self,
        seen: Sequence[tuple[int, SetColumns]],
        outputs: int,
        hyperparameters: Hyperparameters,
    ):
        super().__init__()
        self._widths = [width for width, _ in seen]
        # Agents that see alike share one.
        self._kinds = [list(dict.fromkeys(seen)).index(own) for own in seen]
        *hidden, features = hyperparameters.hidden_sizes
        first = replace(hyperparameters, hidden_sizes=tuple(hidden) or (features,))
        self.agents = nn.ModuleList(
            SetNetwork(width, features, first, gain=2**0.5, at=at)
            for width, at in dict.fromkeys(seen)
        )
        self.team = perceptron(features, outputs, hyperparameters, gain=1.0)

    def forward(self, rows: Tensor) -> Tensor:
        """Return its output for each row."""
        parts = zip(self._kinds, rows.split(self._widths, dim=1), strict=True)
        found = torch.stack([self.agents[kind](part) for kind, part in parts])
        return self.team(found.mean(dim=0))


def _linears(net: nn.Module) -> list[nn.Linear]:
    return [layer for layer in net.modules() if isinstance(layer, nn.Linear)]


def perceptron(
    inputs: int, outputs: int, hyperparameters: Hyperparameters, gain: float
) -> nn.Sequential:
    """Return a perceptron with orthogonal weights, the last ones scaled by `gain`."""
    layers: list[nn.Module] = []
    activation = _ACTIVATIONS[hyperparameters.activation]
    for width in hyperparameters.hidden_sizes:
        layers += [_linear(inputs, width, 2**0.5), activation()]
        inputs = width
    return nn.Sequential(*layers, _linear(inputs, outputs, gain))


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def _array(tensor: Tensor):
    return tensor.detach().float().cpu().numpy().copy()
