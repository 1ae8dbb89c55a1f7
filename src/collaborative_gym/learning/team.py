"""Learners: which robots learn together in a mode."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from collaborative_gym.blocks import Layout, SetColumns, columns_of, find_set
from collaborative_gym.errors import unknown
from collaborative_gym.learning.config import MODES, Mode, Network
from collaborative_gym.policies.network import Part, with_index


@dataclass(frozen=True)
class Learner:
    """Parts of the policy that learn together, with one critic.

    Its rows are worlds, with the observations and actions of all its agents and the
    mean reward of its team. If it is `stacked`, each of its agents has a block of rows
    of its own instead, and its own reward; the agent's index is an input, unless its
    networks are for sets.

    Attributes:
      name: of the learner.
      agents: whom it commands.
      parts: its networks.
      stacked: whether its agents' rows stand below one another.
      network: what its networks do with an observation.
      team: the agents whose mean reward counts; none for its own.
      member: whose policy it learns, where several do.
    """

    name: str
    agents: tuple[str, ...]
    parts: tuple[Part, ...]
    stacked: bool = False
    network: Network = "flat"
    team: tuple[str, ...] = ()
    member: str = ""

    def observation_size(self, layout: Layout) -> int:
        """Return the width of its rows of observations."""
        return self._width(layout.observation_sizes) + self._indices

    @property
    def _indices(self) -> int:
        return self.parts[0].count if self.stacked else 0

    def action_size(self, layout: Layout) -> int:
        """Return the width of its rows of actions."""
        return self._width(layout.action_sizes)

    def _width(self, sizes: Mapping[str, int]) -> int:
        return sum(sizes[agent] for agent in self._side_by_side)

    @property
    def _side_by_side(self) -> tuple[str, ...]:
        return self.agents[:1] if self.stacked else self.agents

    def seen(self, layout: Layout) -> dict[str, tuple[int, SetColumns | None]]:
        """Return by agent, for those side by side in a row, what its part of it is.

        It has the part's width and, where networks are for sets, where its set is.
        """
        is_set = self.network == "set"
        return {
            agent: (
                layout.observation_sizes[agent] + self._indices,
                find_set(layout.observation[agent]) if is_set else None,
            )
            for agent in self._side_by_side
        }

    def networks(self, layout: Layout) -> dict[str, tuple[int, int]]:
        """Return inputs and outputs of each network of its policy, by name.

        Inputs stand side by side in its rows of observations, outputs in its actions.
        """
        if self.stacked:
            ends = self.observation_size(layout), self.action_size(layout)
            return {self.parts[0].weights: ends}
        inputs, outputs = layout.observation_sizes, layout.action_sizes
        return {
            part.weights: (
                sum(inputs[agent] for agent in part.agents),
                sum(outputs[agent] for agent in part.agents),
            )
            for part in self.parts
        }

    def is_grip(self, layout: Layout) -> np.ndarray:
        """Return which columns of its actions grip, (action_size,) bool."""
        own = [columns_of(layout.action[a], "grip") for a in self._side_by_side]
        return np.concatenate(own)

    def observations(self, by_agent: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return rows of observations."""
        if not self.stacked:
            return np.concatenate([by_agent[agent] for agent in self.agents], axis=1)
        rows = [by_agent[agent] for agent in self.agents]
        if count := self._indices:
            rows = [with_index(each, i, count) for i, each in enumerate(rows)]
        return np.concatenate(rows)

    def action_rows(self, by_agent: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return rows of actions."""
        by_order = [by_agent[agent] for agent in self.agents]
        return np.concatenate(by_order, axis=0 if self.stacked else 1)

    def rewards(self, by_agent: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the reward of each row."""
        if self.stacked:
            return np.concatenate([by_agent[agent] for agent in self.agents])
        team = self.team or self.agents
        return np.mean([by_agent[agent] for agent in team], axis=0)

    def actions(
        self, rows: np.ndarray, layout: Layout, ends: Sequence[int] | None = None
    ) -> dict[str, np.ndarray]:
        """Return the actions by agent of its rows.

        Args:
          rows: (rows, action_size).
          layout: of the agents' observations and actions.
          ends: of all blocks but the last, where it is stacked; None for equal ones.
        """
        if self.stacked:
            blocks = np.split(rows, len(self.agents) if ends is None else ends)
        else:
            widths = [layout.action_sizes[agent] for agent in self.agents]
            blocks = np.split(rows, np.cumsum(widths)[:-1], axis=1)
        return dict(zip(self.agents, blocks, strict=True))


def make_learners(
    mode: Mode,
    layout: Layout,
    sides: Sequence[Sequence[str]] = (),
    *,
    seats: Mapping[str, tuple[str, ...]] | None = None,
    member: str = "",
    network: Network = "flat",
) -> tuple[Learner, ...]:
    """Return the learners of a mode; no reward adds up agents of several sides.

    Args:
      mode: which policies and critics learn.
      layout: of all agents' observations and actions.
      sides: agents that share a goal, from `Task.sides`; none for all.
      seats: the agents that learn together, by a name for them; None for sides.
      member: whose policy is learned; stands before the learners' names.
      network: what the networks do with an observation.

    Raises:
      ValueError: if there is no such mode, a shared policy does not fit, or an
        observation has no set for networks that need one.
    """
    sides = [tuple(side) for side in sides] or [tuple(layout.observation)]
    if seats is None:
        seats = {f"side_{i + 1}": side for i, side in enumerate(sides)}
        if len(sides) == 1:
            seats = {"team": sides[0]}
    agents = [agent for own in seats.values() for agent in own]
    teams = {agent: side for side in sides for agent in side}
    if network == "set":
        _check_sets(mode, layout, agents)
    if mode == "collaborative":
        found = [
            (seat, own, tuple(Part((a,), a) for a in own), teams[own[0]])
            for seat, own in seats.items()
        ]
    elif mode == "independent":
        found = [(a, (a,), (Part((a,), a),), ()) for a in agents]
    elif mode == "centralized":
        found = [(seat, own, (Part(own, seat),), ()) for seat, own in seats.items()]
    elif mode == "shared":
        _check_equal("observations", {a: layout.observation_sizes[a] for a in agents})
        _check_equal("actions", {a: layout.action_sizes[a] for a in agents})
        found = [("shared", tuple(agents), _shared_parts(agents, network), ())]
    else:
        raise ValueError(unknown("mode", mode, MODES))
    before = f"{member}/" if member else ""
    return tuple(
        Learner(before + name, own, parts, mode == "shared", network, team, member)
        for name, own, parts, team in found
    )


def _shared_parts(agents: Sequence[str], network: Network) -> tuple[Part, ...]:
    if network == "set":
        return tuple(Part((agent,), "shared") for agent in agents)
    count = len(agents)
    return tuple(Part((a,), "shared", i, count) for i, a in enumerate(agents))


def _check_equal(kind: str, sizes: Mapping[str, int]) -> None:
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{size} for {agent}" for agent, size in sizes.items())
        raise ValueError(
            "a shared policy needs robots with equal spaces, but the sizes of their"
            f" {kind} are {listed}; choose another mode, or robots of one kind"
        )


def _check_sets(mode: Mode, layout: Layout, agents: Sequence[str]) -> None:
    if mode == "centralized":
        raise ValueError(
            "network=set is for policies of one robot each; choose the mode shared,"
            " collaborative or independent"
        )
    for agent in agents:
        find_set(layout.observation[agent])
