"""Trained policies: small networks in a file, run by NumPy alone."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import unknown
from collaborative_gym.files import replacing
from collaborative_gym.math import Array

OBSERVATION_LIMIT = 5.0
"""Networks see observations in standard deviations, cut off at this many."""

_FORMAT = 1
"""Number of the file format; a file of another one is refused."""

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "tanh": np.tanh,
}
"""What may stand between the layers."""


@dataclass(frozen=True)
class Part:
    """A network of a policy: from some agents' observations to their actions.

    Attributes:
      agents: whose observations it sees, one after the other, and whom it commands.
      weights: name of its weights. Parts of one name share them.
      identity: its place among the parts that share its weights, which it is told
        after the observations, one-hot; None where it has weights of its own.
    """

    agents: tuple[str, ...]
    weights: str
    identity: int | None = None


@dataclass(frozen=True)
class Weights:
    """What a network has learned.

    Attributes:
      mean: of its inputs, (n,) float32.
      std: of its inputs, (n,) float32.
      layers: a weight (outputs, inputs) and a bias (outputs,) each, float32.
    """

    mean: np.ndarray
    std: np.ndarray
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]


class NetworkPolicy:
    """A trained policy, without its noise: from observations to the mean actions.

    A world's action does not depend on the other worlds of the batch, to the bit.

    Args:
      parts: its networks.
      weights: by name.
      activation: one of `ACTIVATIONS`.
      facts: what else the file tells of it, such as environment, robots, mode, seed,
        steps and hyperparameters.

    Attributes:
      facts: what it was trained for, and how.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        weights: Mapping[str, Weights],
        activation: str,
        facts: Mapping[str, Any],
    ):
        self.facts = dict(facts)
        self._parts = tuple(parts)
        self._weights = dict(weights)
        self._activation = activation
        self._sharing = {
            name: sum(part.weights == name for part in parts) for name in weights
        }

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
        """Return actions by agent, (num_envs, k) float32 in [-1, 1]."""
        actions = {}
        for part in self._parts:
            rows = np.concatenate(
                [np.asarray(observations[agent], np.float32) for agent in part.agents],
                axis=1,
            )
            if part.identity is not None:
                rows = with_identity(rows, part.identity, self._sharing[part.weights])
            out = np.clip(self._forward(rows, self._weights[part.weights]), -1.0, 1.0)
            sizes = [self.facts["action_sizes"][agent] for agent in part.agents]
            blocks = np.split(out, np.cumsum(sizes)[:-1], axis=1)
            actions |= dict(zip(part.agents, blocks, strict=True))
        return actions

    def _forward(self, rows: np.ndarray, weights: Weights) -> np.ndarray:
        limit = np.float32(OBSERVATION_LIMIT)
        x = np.clip((rows - weights.mean) / weights.std, -limit, limit)
        # A product of its own for each row: in one of all rows, BLAS would add up in an
        # order that depends on how many there are.
        x = x[:, None]
        for i, (weight, bias) in enumerate(weights.layers):
            if i:
                x = ACTIVATIONS[self._activation](x)
            x = x @ weight.T + bias
        return x[:, 0]

    def check(self, env: VectorEnv) -> None:
        """Raise unless the policy fits the environment's agents and spaces.

        Raises:
          ValueError: says what differs.
        """
        for kind, spaces in (
            ("observation", env.single_observation_spaces),
            ("action", env.single_action_spaces),
        ):
            own = self.facts[f"{kind}_sizes"]
            sizes = {agent: space.shape[0] for agent, space in spaces.items()}
            if own != sizes:
                raise ValueError(
                    f"this policy is for {self.facts['environment']} with"
                    f" {', '.join(self.facts['robots'])}: its {kind} sizes are"
                    f" {_listed(own)}, the environment's {_listed(sizes)}"
                )

    def save(self, path: str | Path) -> None:
        """Write it into a safetensors file, whole or not at all."""
        tensors = {}
        for name, weights in self._weights.items():
            tensors |= {f"{name}/mean": weights.mean, f"{name}/std": weights.std}
            for i, (weight, bias) in enumerate(weights.layers):
                tensors |= {f"{name}/{i}/weight": weight, f"{name}/{i}/bias": bias}
        tensors = {
            name: np.ascontiguousarray(tensor, np.float32)
            for name, tensor in tensors.items()
        }
        description = {
            "format": _FORMAT,
            "parts": [asdict(part) for part in self._parts],
            "activation": self._activation,
            "facts": self.facts,
        }
        with replacing(path) as partial:
            text = json.dumps(description)
            partial.write_bytes(save(tensors, {"collaborative_gym": text}))

    @classmethod
    def load(cls, path: str | Path) -> "NetworkPolicy":
        """Return the policy of a file.

        Raises:
          FileNotFoundError: if there is no such file.
          ValueError: if it is damaged or not of this format.
        """
        try:
            with safe_open(path, framework="numpy") as file:
                text = (file.metadata() or {}).get("collaborative_gym")
                names = list(file.keys())
                tensors = {name: file.get_tensor(name) for name in names}
        except SafetensorError as error:
            raise ValueError(f"{path} is no policy, or is damaged: {error}") from error
        description = {} if text is None else json.loads(text)
        if description.get("format") != _FORMAT:
            raise ValueError(
                f"{path} is no policy of this version: its format is"
                f" {description.get('format')}, not {_FORMAT}"
            )
        parts = [
            Part(tuple(part["agents"]), part["weights"], part["identity"])
            for part in description["parts"]
        ]
        names = dict.fromkeys(part.weights for part in parts)
        weights = {name: _weights(tensors, name) for name in names}
        return cls(parts, weights, description["activation"], description["facts"])


def with_identity(observations: np.ndarray, i: int, count: int) -> np.ndarray:
    """Return observations followed by a one-hot that tells the i-th of `count`."""
    one_hot = np.zeros((len(observations), count), observations.dtype)
    one_hot[:, i] = 1.0
    return np.concatenate([observations, one_hot], axis=1)


def check_activation(name: str) -> None:
    """Raise unless it is the name of an activation.

    Raises:
      ValueError: names those that there are.
    """
    if name not in ACTIVATIONS:
        raise ValueError(unknown("activation", name, ACTIVATIONS))


def _weights(tensors: Mapping[str, np.ndarray], name: str) -> Weights:
    count = sum(key.startswith(f"{name}/") for key in tensors) // 2 - 1
    layers = tuple(
        (tensors[f"{name}/{i}/weight"], tensors[f"{name}/{i}/bias"])
        for i in range(count)
    )
    return Weights(tensors[f"{name}/mean"], tensors[f"{name}/std"], layers)


def _listed(sizes: Mapping[str, int]) -> str:
    return ", ".join(f"{agent} {size}" for agent, size in sizes.items())
