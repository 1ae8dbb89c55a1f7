"""Trained policies: small networks in a file, run by NumPy alone."""

import hashlib
import json
import zipfile
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from collaborative_gym.blocks import Layout, SetColumns, find_set, split_columns
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import unknown
from collaborative_gym.files import check_regular, replacing
from collaborative_gym.math import Array
from collaborative_gym.tasks.identity import ON_PLAYING, Identity

OBSERVATION_LIMIT = 5.0
"""Bound of the networks' inputs, in standard deviations of the observations."""

_FORMATS = 2, 3, 4
"""Numbers of the file formats; others are refused. The first has only the sizes of
observations and actions, the others have all blocks, and the last also networks for
sets."""

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

    Each layer has a weight (outputs, inputs) and a bias (outputs,). A network for sets
    has layers for each element too: they get the other inputs and the element, and
    their outputs are pooled, as mean and maximum, in the set's place.
    """

    mean: np.ndarray
    std: np.ndarray
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    element: tuple[tuple[np.ndarray, np.ndarray], ...] = ()

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of its inputs, and of the outputs of each layer."""
        layers = *self.element, *self.layers
        return len(self.mean), *(len(bias) for _, bias in layers)


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
        self._sets = {
            part.weights: find_set(layout.observation[part.agents[0]])
            for part in parts
            if self.weights[part.weights].element
        }
        for part in parts:
            self._check_widths(part)

    def __call__(self, observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
        """Return actions of its agents, (num_envs, k) float32 in [-1, 1] each."""
        actions = {}
        for part in self._parts:
            seen = [self._rows(agent, observations[agent]) for agent in part.agents]
            rows = np.concatenate(seen, axis=1)
            if part.index is not None:
                rows = with_index(rows, part.index, part.count)
            out = np.clip(self._forward(rows, part), -1.0, 1.0)
            actions |= split_columns(out, {a: self._outputs[a] for a in part.agents})
        return actions

    def _rows(self, agent: str, observation: Array) -> np.ndarray:
        rows, size = np.asarray(observation, np.float32), self._inputs[agent]
        if rows.ndim != 2 or rows.shape[1] != size:
            raise ValueError(
                f"the observation of {agent} has shape {rows.shape}, not (num_envs,"
                f" {size}); for one world alone, load the policy with its environment"
            )
        return rows

    def _forward(self, rows: np.ndarray, part: Part) -> np.ndarray:
        weights, limit = self.weights[part.weights], np.float32(OBSERVATION_LIMIT)
        x = np.clip((rows - weights.mean) / weights.std, -limit, limit)
        if weights.element:
            x = self._pooled(x, weights, self._sets[part.weights])
        return self._through(x, weights.layers)

    def _pooled(self, x: np.ndarray, weights: Weights, at: SetColumns) -> np.ndarray:
        """Return normalized rows with its elements' pooled outputs in a set's place."""
        own = np.delete(x, np.s_[at.start : at.stop], axis=1)
        elements = x[:, at.start : at.stop].reshape(len(x), at.count, at.width)
        there = elements[:, :, :1] > 0.5
        total = np.zeros((len(x), len(weights.element[-1][1])), np.float32)
        greatest = np.full_like(total, -np.inf)
        for i in np.flatnonzero(there.any(axis=0)):
            inputs = np.concatenate([own, elements[:, i, 1:]], axis=1)
            said = self._through(inputs, weights.element)
            total = total + np.where(there[:, i], said, np.float32(0.0))
            greatest = np.where(there[:, i], np.maximum(greatest, said), greatest)
        count = there.sum(axis=1).astype(np.float32)
        mean = total / np.maximum(count, np.float32(1.0))
        greatest = np.where(count > 0.0, greatest, np.float32(0.0))
        return np.concatenate([own, mean, greatest], axis=1)

    def _through(
        self, x: np.ndarray, layers: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> np.ndarray:
        # A product of its own for each row: in one of all rows, BLAS would add up in an
        # order that depends on how many there are.
        x = x[:, None]
        for i, (weight, bias) in enumerate(layers):
            if i:
                x = ACTIVATIONS[self.activation](x)
            x = x @ weight.T + bias
        return x[:, 0]

    def _check_widths(self, part: Part) -> None:
        """Raise ValueError unless the layers lead from its numbers to its actions."""
        weights = self.weights[part.weights]
        inputs = sum(self._inputs[agent] for agent in part.agents) + part.count
        outputs = sum(self._outputs[agent] for agent in part.agents)
        shapes: list[Any] = [(inputs,), (inputs,)]
        trunk = inputs
        if weights.element:
            at = self._sets[part.weights]
            own = inputs - at.count * at.width
            shapes += _shapes(own + at.width - 1, weights.element)
            trunk = own + 2 * len(weights.element[-1][1])
        shapes += _shapes(trunk, weights.layers)
        layers = *weights.element, *weights.layers
        found = [array.shape for array in (weights.mean, weights.std, *chain(*layers))]
        if found != shapes or shapes[-1] != (outputs,):
            raise ValueError(
                f"a network from {inputs} to {outputs} numbers has arrays of shapes"
                f" {found}"
            )

    @property
    def suits_any_team(self) -> bool:
        """Whether one network for sets commands each robot, whichever its place."""
        names = {part.weights for part in self._parts}
        alike = all(p.index is None and len(p.agents) == 1 for p in self._parts)
        return alike and len(names) == 1 and bool(self.weights[names.pop()].element)

    def serving(self, agents: Collection[str]) -> "NetworkPolicy":
        """Return the policy of these agents alone.

        They may be others than those that it was trained for, if it suits any team.

        Raises:
          ValueError: if it lacks a network for one, or one commands others, too.
        """
        if self.suits_any_team:
            served, first = copy(self), self._parts[0]
            served._parts = tuple(replace(first, agents=(a,)) for a in agents)
            kinds = self.layout.observation, self.layout.action
            [own] = first.agents
            served.layout = Layout(*(dict.fromkeys(agents, k[own]) for k in kinds))
            served._inputs = served.layout.observation_sizes
            served._outputs = served.layout.action_sizes
            served.agents = tuple(agents)
            return served
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
                    " together; give it all of these or none"
                )
        served = copy(self)
        served._parts, served.agents = tuple(parts), tuple(agents)
        return served

    def check(self, env: VectorEnv, *, any_env: bool = False) -> None:
        """Raise ValueError unless the policy is for this environment; say what differs.

        Starts and lengths of episodes may differ; with `any_env` all but the blocks.
        """
        here, own = Identity.of(env.task), self.identity
        if self.suits_any_team:
            own = own.with_team_of(here)
        differences = here.differences(own, ignore=ON_PLAYING)
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
        tensors = {}
        for name, weights in self.weights.items():
            tensors |= {f"{name}/mean": weights.mean, f"{name}/std": weights.std}
            for at, layers in (name, weights.layers), (_element(name), weights.element):
                for i, (weight, bias) in enumerate(layers):
                    tensors |= {f"{at}/{i}/weight": weight, f"{at}/{i}/bias": bias}
        tensors = {n: np.ascontiguousarray(t, np.float32) for n, t in tensors.items()}
        # What was read without blocks is written so too, and keeps its digest.
        has_names = self.layout.has_names
        parts = [asdict(part) for part in self._parts]
        for part in () if has_names else parts:
            del part["count"]
        has_sets = any(weights.element for weights in self.weights.values())
        description = {
            "format": _FORMATS[has_names + has_sets],
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
                f" {', '.join(map(str, _FORMATS))}"
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


def _element(name: str) -> str:
    """Return under which name a file has the layers for the elements of a set."""
    return f"{name}/element"


def _weights(tensors: Mapping[str, np.ndarray], name: str) -> Weights:
    def layers(at: str) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        count = sum(f"{at}/{i}/weight" in tensors for i in range(len(tensors)))
        return tuple(
            (tensors[f"{at}/{i}/weight"], tensors[f"{at}/{i}/bias"])
            for i in range(count)
        )

    mean, std = tensors[f"{name}/mean"], tensors[f"{name}/std"]
    return Weights(mean, std, layers(name), layers(_element(name)))


def _shapes(inputs: int, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[Any]:
    """Return the shapes of arrays that lead from so many numbers on."""
    shapes: list[tuple[int, ...]] = []
    for before, after in pairwise([inputs, *(len(weight) for weight, _ in layers)]):
        shapes += [(after, before), (after,)]
    return shapes


def _digest(text: str, tensors: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(text.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tensor.shape}".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()


def _and(agents: Collection[str]) -> str:
    return " and ".join(agents)
