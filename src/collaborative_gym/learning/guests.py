"""Guests: policies that play beside the learners, and do not learn themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.casting import Casting
from collaborative_gym.math import Array
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import commanding

Odds = Mapping[str, float]
"""By name, how often one is drawn; the sum is 1."""


@dataclass(frozen=True)
class Invitation:
    """The policies that may be guests in a rollout.

    Attributes:
      policies: by name, a policy or its name for `load_policy`.
      odds: by the member that learns in a world, then by the guest's seat.
    """

    policies: Mapping[str, str | NetworkPolicy] = field(default_factory=dict)
    odds: Mapping[str, Mapping[str, Odds]] = field(default_factory=dict)


NOBODY = Invitation()


class Guests:
    """Seats guests in worlds, each for one episode, and acts for them.

    The networks run in NumPy, one batch for each policy and seat. Eight of them take
    6 % of the CPU time of collecting (`benchmarks/guests.py`); torch took 1.4 ms for
    256 rows where NumPy took 1.8.

    Args:
      env: the worlds.
      casting: who sits where.

    Attributes:
      names: who sits in each seat, by world; empty before a guest was drawn.
    """

    def __init__(self, env: VectorEnv, casting: Casting):
        self._env = env
        self._seats = casting.seats
        casts = casting.spread(env.num_envs)
        self.names = [[name or "" for name in cast] for cast in casts]
        # By seat, the worlds where a guest sits in it.
        self._free = {
            seat: np.flatnonzero([cast[i] is None for cast in casts])
            for i, seat in enumerate(self._seats)
        }
        self._hosts = [next((n for n in cast if n is not None), "") for cast in casts]
        self._invitation = NOBODY
        self._policies: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._groups: dict[tuple[str, str], np.ndarray] = {}

    def invite(self, invitation: Invitation) -> None:
        """Draw guests from an invitation from now on; those that are seated stay."""
        before, self._invitation = self._invitation.policies, invitation
        self._policies = {
            key: policy
            for key, policy in self._policies.items()
            if before[key[0]] is invitation.policies[key[0]]
        }

    def draw(self, worlds: np.ndarray, rng: np.random.Generator) -> None:
        """Seat new guests in worlds whose episodes start."""
        for i, (seat, free) in enumerate(self._free.items()):
            for world in np.intersect1d(free, worlds):
                odds = self._invitation.odds[self._hosts[world]][seat]
                name = rng.choice(list(odds), p=list(odds.values()))
                self.names[world][i] = str(name)
        self._group()

    def seat(self, names: list[list[str]]) -> None:
        """Seat these guests by name, in all worlds and seats."""
        self.names = names
        everywhere = np.arange(self._env.num_envs)
        self._free = dict.fromkeys(self._seats, everywhere)
        self._group()

    def act(
        self,
        observations: Mapping[str, Array],
        actions: Mapping[str, np.ndarray],
        advice: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Write the guests' actions into `actions`, and their advice into `advice`.

        The expert's advice may be no best response to a guest. So the actions of the
        guest's own policy for the others' places replace it, or NaN where there are
        several guests, or one whose policy commands nobody else.

        Args:
          observations: of all worlds, by agent.
          actions: (num_envs, k) by agent.
          advice: the expert's, as `actions`; None without an expert.
        """
        scripted: dict[str, Any] = {}  # by name, in all worlds

        def write(name: str, agents: Sequence[str], worlds: Array, into: Any) -> None:
            """Write a guest's actions for some agents in some worlds."""
            policy = self._policy(name, agents)
            if isinstance(policy, NetworkPolicy):
                chosen = policy({a: observations[a][worlds] for a in agents})
                rows: Any = slice(None)
            else:
                if name not in scripted:
                    scripted[name] = policy(observations)
                chosen, rows = scripted[name], worlds
            for agent in agents:
                into[agent][worlds] = np.asarray(chosen[agent])[rows]

        for (name, seat), worlds in self._groups.items():
            write(name, self._seats[seat], worlds, actions)
        if advice is None:
            return
        guests = np.zeros(self._env.num_envs, int)
        for worlds in self._groups.values():
            guests[worlds] += 1
        silent = guests > 1
        for (name, seat), worlds in self._groups.items():
            others = [agent for agent in advice if agent not in self._seats[seat]]
            if self._answers(name, others):
                write(name, others, worlds, advice)
            else:
                silent[worlds] = True
        for each in advice.values():
            each[silent] = np.nan

    def _answers(self, name: str, agents: Sequence[str]) -> bool:
        policy = self._invitation.policies[name]
        if isinstance(policy, NetworkPolicy):
            return set(agents) <= set(policy.agents)
        return isinstance(policy, str) and policy.partition(":")[0] == "expert"

    def state_dict(self) -> dict[str, Any]:
        """Return who is seated, nothing where no guests are."""
        return {"seated": [list(names) for names in self.names]} if self._seats else {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        if self._seats:
            self.names = [list(names) for names in state["seated"]]
            self._group()

    def _group(self) -> None:
        groups: dict[tuple[str, str], list[int]] = {}
        for i, (seat, free) in enumerate(self._free.items()):
            for world in free:
                groups.setdefault((self.names[world][i], seat), []).append(int(world))
        self._groups = {key: np.array(worlds) for key, worlds in groups.items()}

    def _policy(self, name: str, agents: Sequence[str]) -> Any:
        key = name, tuple(agents)
        if key not in self._policies:
            given = self._invitation.policies[name]
            self._policies[key] = commanding(agents, given, self._env, False)
        return self._policies[key]
