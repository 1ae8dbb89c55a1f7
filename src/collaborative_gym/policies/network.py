"""Trained policies: small networks in a file, run by NumPy alone."""

import hashlib
import json
import zipfile
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from collaborative_gym.blocks import Layout, split_columns
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import unknown
from collaborative_gym.files import check_regular, replacing
from collaborative_gym.math import Array
from collaborative_gym.tasks.identity import ON_PLAYING, Identity

OBSERVATION_LIMIT = 5.0
"""Bound of the networks' inputs, in standard deviations of the observations."""

_FORMATS = 2, 3
"""Numbers of the file formats; others are refused. The former has only the sizes of
observations and actions, the latter all blocks."""

_KEY = "collaborative_gym"
"""Entry of a file's metadata with its digest and, right after it, its description."""

_DIGEST_LENGTH = 64

_TRAINING = b"collaborative_gym training"
"""Beginning of the checkpoints of training runs."""

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "tanh": np.tanh,
}
"""Functions between the layers."""


@dataclass(frozen=True)
class Part:
    """A network of a policy: from some agents' observations to their actions."""

    agents: tuple[str, ...]  # in the order of their observations and actions
    weights: str  # name of its weights; parts of one name share them
    index: int | None = None  # among parts that share weights; a one-hot input
    count: int = 0  # number of parts that share its weights, where it has an index


@dataclass(frozen=True)
class Weights:
    """Weights of a network, and mean and standard deviation of its inputs; float32.

    Each layer has a weight (outputs, inputs) and a bias (outputs,).
    """

    mean: np.ndarray
    std: np.ndarray
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of its inputs, and of the outputs of each layer."""
        return len(self.mean), *(len(bias) for _, bias in self.layers)


class NetworkPolicy:
    """A trained policy, without its noise: from observations to the mean actions.

    A world's action does not depend on the other worlds of the batch, to the bit.

    Args:
      parts: its networks.
      weights: of the networks, by name.
      activation: one of `ACTIVATIONS`, between their layers.
      identity: the environment that it is for.
      layout: the blocks of observations and the parts of actions.
      metadata: how it was trained, such as mode, seed and steps; must fit into JSON.

    Attributes:
      agents: the agents that it commands.
      weights, activation, identity, layout, metadata: as given.

    Raises:
      ValueError: if the parts do not fit the weights or the sizes; when it is called,
        if an observation has another shape than (num_envs, n).
    """

    def __init__(
        self,
        parts: Sequence[Part],
        weights: Mapping[str, Weights],
        *,
        activation: str,
        identity: Identity,
        layout: Layout,
        metadata: Mapping[str, Any],
    ):
        check_activation(activation)
        self.agents = tuple(agent for part in parts for agent in part.agents)
        self.identity = identity
        self.metadata = dict(metadata)
        self._parts = tuple(parts)
        self.weights = dict(weights)
        self.activation = activation
        self.layout = layout
        self._inputs, self._outputs = layout.observation_sizes, layout.action_sizes
        if len(set(self.agents)) != len(self.agents):
            raise ValueError("two networks command one agent")
        for part in parts:
            _check_widths(self.weights[part.weights], *self._widths(part))

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
        """Return actions of its agents, (num_envs, k) float32 in [-1, 1] each."""
        actions = {}
        for part in self._parts:
            weights = self.weights[part.weights]
            seen = [self._rows(agent, observations[agent]) for agent in part.agents]
            rows = np.concatenate(seen, axis=1)
            if part.index is not None:
                rows = with_index(rows, part.index, part.count)
            out = np.clip(self._forward(rows, weights), -1.0, 1.0)
            actions |= split_columns(out, {a: self._outputs[a] for a in part.agents})
        return actions

    def _rows(self, agent: str, observation: Array) -> np.ndarray:
        """Return an agent's observations, (num_envs, n)."""
        rows, size = np.asarray(observation, np.float32), self._inputs[agent]
        if rows.ndim != 2 or rows.shape[1] != size:
            raise ValueError(
                f"the observation of {agent} has shape {rows.shape}, not (num_envs,"
                f" {size}); for one world alone, load the policy with its environment"
            )
        return rows

    def _forward(self, rows: np.ndarray, weights: Weights) -> np.ndarray:
        limit = np.float32(OBSERVATION_LIMIT)
        x = np.clip((rows - weights.mean) / weights.std, -limit, limit)
        # A product of its own for each row: in one of all rows, BLAS would add up in an
        # order that depends on how many there are.
        x = x[:, None]
        for i, (weight, bias) in enumerate(weights.layers):
            if i:
                x = ACTIVATIONS[self.activation](x)
            x = x @ weight.T + bias
        return x[:, 0]

    def _widths(self, part: Part) -> tuple[int, int]:
        """Return how many numbers go into a part and how many come out."""
        inputs = sum(self._inputs[agent] for agent in part.agents) + part.count
        return inputs, sum(self._outputs[agent] for agent in part.agents)

    def serving(self, agents: Collection[str]) -> "NetworkPolicy":
        """Return the policy of these agents alone.

        Raises:
          ValueError: if it has no network for one of them, or one that commands others
            too.
        """
        if missing := [agent for agent in agents if agent not in self.agents]:
            raise ValueError(
                f"this policy commands {_and(self.agents)}, not {_and(missing)}; name"
                " another for that, as in --policy robot_1=A robot_2=B"
            )
        parts = [part for part in self._parts if set(part.agents) & set(agents)]
        for part in parts:
            if not set(part.agents) <= set(agents):
                raise ValueError(
                    f"one network of this policy commands {_and(part.agents)}"
                    " together; let it play all of these or none"
                )
        served = copy(self)
        served._parts, served.agents = tuple(parts), tuple(agents)
        return served

    def check(self, env: VectorEnv, *, any_env: bool = False) -> None:
        """Raise ValueError unless the policy is for this environment; say what differs.

        Starts and lengths of episodes may differ; with `any_env` all but the blocks.
        """
        here = Identity.of(env.task)
        differences = here.differences(self.identity, ignore=ON_PLAYING)
        title = f"this policy is for {self.identity.title}"
        others = env.world.definition.layout.differences(self.layout, self.agents)
        or_else = ", or evaluate this one here with any_env=True (--any-env)"
        if differences and not any_env:
            raise ValueError(
                f"{title}; here {'; '.join(differences)}. Train one for this"
                f" environment{'' if others else or_else}"
            )
        if others:
            raise ValueError(f"{title}; here {'; '.join(others)}")

    @property
    def digest(self) -> str:
        """A digest of all that its file has, unlike that of any other policy."""
        return _digest(*self._content())

    def save(self, path: str | Path) -> None:
        """Write it into a safetensors file, whole or not at all."""
        text, tensors = self._content()
        # In one entry: several would come in any order, and so files would differ.
        with replacing(path) as partial:
            entry = _digest(text, tensors) + text
            partial.write_bytes(save(tensors, {_KEY: entry}))

    def _content(self) -> tuple[str, dict[str, np.ndarray]]:
        """Return its description and its arrays, as they go into a file."""
        tensors = {}
        for name, weights in self.weights.items():
            tensors |= {f"{name}/mean": weights.mean, f"{name}/std": weights.std}
            for i, (weight, bias) in enumerate(weights.layers):
                tensors |= {f"{name}/{i}/weight": weight, f"{name}/{i}/bias": bias}
        tensors = {n: np.ascontiguousarray(t, np.float32) for n, t in tensors.items()}
        # What was read without blocks is written so too, and keeps its digest.
        has_names = self.layout.has_names
        parts = [asdict(part) for part in self._parts]
        for part in () if has_names else parts:
            del part["count"]
        description = {
            "format": _FORMATS[has_names],
            "parts": parts,
            "activation": self.activation,
            "identity": self.identity.to_dict(),
            **self.layout.to_dict(),
            "metadata": self.metadata,
        }
        return json.dumps(description), tensors

    @classmethod
    def load(cls, path: str | Path) -> "NetworkPolicy":
        """Return the policy of a file.

        Raises:
          FileNotFoundError: if there is no such file.
          ValueError: if it is damaged or not of this format.
        """
        check_regular(path)
        try:
            return cls._read(path)
        except OSError:
            raise
        except Exception as error:  # A file may be spoilt in any way.
            if other := _other(path):
                raise ValueError(f"{path} is {other}") from None
            missing = "it has no " if isinstance(error, KeyError) else ""
            reason = missing + str(error).partition("\n")[0]
            raise ValueError(
                f"{path} is not a policy, or is damaged: {reason}; give the"
                " policy.safetensors of a training run, or fetch the file again"
            ) from error

    @classmethod
    def _read(cls, path: str | Path) -> "NetworkPolicy":
        with safe_open(path, framework="numpy") as file:
            entry = (file.metadata() or {}).get(_KEY, "")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        digest, text = entry[:_DIGEST_LENGTH], entry[_DIGEST_LENGTH:]
        description = json.loads(text or "{}")
        if description.get("format") not in _FORMATS:
            raise ValueError(
                f"its format is {description.get('format')}, those of this version are"
                f" {' and '.join(map(str, _FORMATS))}"
            )
        if digest != _digest(text, tensors):
            raise ValueError("its content does not match its digest")
        listed, parts = description["parts"], []
        for part in listed:
            shared = sum(each["weights"] == part["weights"] for each in listed)
            count = 0 if part["index"] is None else shared
            part = {"count": count} | part | {"agents": tuple(part["agents"])}
            parts.append(Part(**part))
        names = dict.fromkeys(part.weights for part in parts)
        return cls(
            parts,
            {name: _weights(tensors, name) for name in names},
            activation=description["activation"],
            identity=Identity.from_dict(description["identity"]),
            layout=Layout.from_dict(description),
            metadata=description["metadata"],
        )


def _other(path: str | Path) -> str:
    """Return the kind of another file and what to do with it, if it is known."""
    with open(path, "rb") as file:
        if file.read(len(_TRAINING)) == _TRAINING:
            return "a checkpoint of a training run; give the run's folder"
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.rpartition("/")[2] for name in archive.namelist()}
    except zipfile.BadZipFile:
        return ""
    if "_stable_baselines3_version" in names:
        return (
            "a model of Stable-Baselines3, which only that library can load; in Python"
            " give the model, as in cg.evaluate(env, PPO.load(path)), or export it to"
            " ONNX"
        )
    if "data.pkl" in names:
        return (
            "a file of torch, which may run any program; for a training run give its"
            " folder, and export another network to ONNX"
        )
    return ""


def with_index(observations: np.ndarray, i: int, count: int) -> np.ndarray:
    """Return observations followed by a one-hot for the i-th of `count`."""
    one_hot = np.zeros((len(observations), count), observations.dtype)
    one_hot[:, i] = 1.0
    return np.concatenate([observations, one_hot], axis=1)


def check_activation(name: str) -> None:
    """Raise ValueError unless it is the name of an activation."""
    if name not in ACTIVATIONS:
        raise ValueError(unknown("activation", name, ACTIVATIONS))


def _weights(tensors: Mapping[str, np.ndarray], name: str) -> Weights:
    count = sum(key.startswith(f"{name}/") for key in tensors) // 2 - 1
    layers = tuple(
        (tensors[f"{name}/{i}/weight"], tensors[f"{name}/{i}/bias"])
        for i in range(count)
    )
    return Weights(tensors[f"{name}/mean"], tensors[f"{name}/std"], layers)


def _check_widths(weights: Weights, inputs: int, outputs: int) -> None:
    """Raise ValueError unless the layers lead from so many numbers to so many."""
    shapes: list[tuple[int, ...]] = [(inputs,), (inputs,)]
    for before, after in pairwise([inputs, *(len(w) for w, _ in weights.layers)]):
        shapes += [(after, before), (after,)]
    arrays = weights.mean, weights.std, *chain(*weights.layers)
    found = [array.shape for array in arrays]
    if found != shapes or shapes[-1] != (outputs,):
        raise ValueError(
            f"a network from {inputs} to {outputs} numbers has arrays of shapes {found}"
        )


def _digest(text: str, tensors: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(text.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tensor.shape}".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()


def _and(agents: Collection[str]) -> str:
    return " and ".join(agents)
