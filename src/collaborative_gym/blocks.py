"""Blocks: the named parts of which observations and actions are made."""

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

POSE = "m; quaternion"
"""Unit of a position and, after it, a quaternion x, y, z, w."""


@dataclass(frozen=True)
class Block:
    """A named part of an observation or of an action.

    Attributes:
      name: empty where a policy file knows its size alone.
      shape: of its array in one world.
      dtype: "float32" for real numbers of any precision, else its own, such as "uint8".
      unit: of its numbers; empty if they have none.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str = "float32"
    unit: str = ""

    @property
    def size(self) -> int:
        """Number of its numbers in the flat view."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class SetColumns:
    """Where the flat view has a set, as `tasks.teams.mates_block` makes it.

    Attributes:
      start: column at which it begins.
      count: number of its elements, with places for nobody.
      width: of an element; its first number is 1, or 0 for nobody.
    """

    start: int
    count: int
    width: int

    @property
    def stop(self) -> int:
        """Column after its last."""
        return self.start + self.count * self.width


_KINDS = "observation", "action"

Blocks = Mapping[str, Block]
"""Blocks by name, in the order in which the flat view has them."""


def columns_of(blocks: Blocks, name: str) -> np.ndarray:
    """Return a mask of the block `name` in the flat view, (k,) booleans."""
    return np.concatenate([np.full(b.size, b.name == name) for b in blocks.values()])


def find_set(blocks: Blocks) -> SetColumns:
    """Return where the flat view has its block of two axes, which is a set.

    Raises:
      ValueError: if not exactly one block is a set.
    """
    found, start = [], 0
    for block in blocks.values():
        if len(block.shape) == 2:
            found.append(SetColumns(start, *block.shape))
        start += block.size
    if len(found) != 1:
        raise ValueError(
            f"network=set needs observations with one set, a block of two axes, such as"
            f" mates; these have {len(found)} among {', '.join(blocks)}"
        )
    return found[0]


def split_columns(rows: np.ndarray, sizes: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Return the columns of rows (n, k) by agent, side by side in these sizes."""
    ends = np.cumsum(list(sizes.values()))[:-1]
    return dict(zip(sizes, np.split(rows, ends, axis=1), strict=True))


@dataclass(frozen=True)
class Layout:
    """Blocks of the observations and parts of the actions, by agent.

    Actions have the part `moves`, and `grip` where the task has gripping.
    """

    observation: Mapping[str, Blocks]
    action: Mapping[str, Blocks]

    @classmethod
    def of_sizes(
        cls, observation: Mapping[str, int], action: Mapping[str, int]
    ) -> "Layout":
        """Return a layout of which only the sizes by agent are known."""
        sizes = observation, action
        return cls(*({a: {"": Block("", (n,))} for a, n in s.items()} for s in sizes))

    @cached_property
    def observation_sizes(self) -> dict[str, int]:
        """Sizes of the agents' observations in the flat view."""
        return _sizes(self.observation)

    @cached_property
    def action_sizes(self) -> dict[str, int]:
        """Sizes of the agents' actions."""
        return _sizes(self.action)

    @property
    def has_names(self) -> bool:
        """Whether more is known than sizes."""
        both = *self.observation.values(), *self.action.values()
        return any("" not in blocks for blocks in both)

    def differences(self, other: "Layout", agents: Collection[str]) -> list[str]:
        """Return the differences from another layout for some agents, in words."""
        found: list[str] = []
        for kind in _KINDS:
            own, others = getattr(self, kind), getattr(other, kind)
            for agent in agents:
                what = f"the {kind} of {agent}"
                found += _differences(what, own.get(agent, {}), others.get(agent, {}))
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain lists and dictionaries."""
        if not self.has_names:
            sizes = self.observation_sizes, self.action_sizes
            return dict(zip(("observation_sizes", "action_sizes"), sizes, strict=True))
        return {
            kind: {
                agent: [asdict(block) for block in blocks.values()]
                for agent, blocks in getattr(self, kind).items()
            }
            for kind in _KINDS
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Layout":
        """Return the layout of a `to_dict`, which may have other entries."""
        if "observation" not in content:
            return cls.of_sizes(content["observation_sizes"], content["action_sizes"])
        kinds = (content[kind].items() for kind in _KINDS)
        return cls(*({agent: _read(own) for agent, own in kind} for kind in kinds))


def _sizes(by_agent: Mapping[str, Blocks]) -> dict[str, int]:
    return {a: sum(b.size for b in own.values()) for a, own in by_agent.items()}


def _read(listed: list[dict[str, Any]]) -> Blocks:
    read = [Block(**{**each, "shape": tuple(each["shape"])}) for each in listed]
    return {block.name: block for block in read}


def _differences(what: str, own: Blocks, other: Blocks) -> list[str]:
    if "" in own or "" in other:
        here, there = _sizes({"own": own, "other": other}).values()
        return [] if here == there else [f"{what} has {here} numbers, not {there}"]
    found = [f"{what} has no block {name!r}" for name in other if name not in own]
    found += [f"{what} has an extra block {n!r}" for n in own if n not in other]
    for name in [name for name in own if name in other]:
        for detail, value in vars(own[name]).items():
            wanted = getattr(other[name], detail)
            if value != wanted:
                found.append(
                    f"{what} has a block {name!r} of {detail} {value!r}, not {wanted!r}"
                )
    if not found and list(own) != list(other):
        found = [f"{what} has its blocks in another order: {', '.join(own)}"]
    return found
