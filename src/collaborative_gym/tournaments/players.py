"""Who plays in a tournament, and which of them can sit together."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import naming, shown
from collaborative_gym.policies import AnyPolicy, Policy, name_policy
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.onnx import SUFFIX
from collaborative_gym.policies.policy import (
    commanding,
    group_agents,
    read_policy,
)

_LONGEST_NAME = 200
"""Letters of a player's name: more than a column of a table has room for."""


@dataclass(frozen=True)
class Player:
    """A policy under a name of its own.

    Attributes:
      name: of the player.
      policies: what commands each agent.
      mark: names of scripted policies and digests of trained ones, which differ from
        those of other policies under the same name. None where there is a function,
        since nobody can say whether it is the same one.
    """

    name: str
    policies: Mapping[str, Policy]
    mark: str | None

    def misfit(self, agents: Collection[str]) -> str:
        """Return why it cannot command these agents and no others; empty if it can."""
        for policy in {id(own): own for own in self.policies.values()}.values():
            asked = [agent for agent in agents if self.policies[agent] is policy]
            if asked and isinstance(policy, NetworkPolicy):
                try:
                    policy.serving(asked)
                except ValueError as error:
                    return str(error)
        return ""


def enter(
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy],
    env: VectorEnv,
    *,
    any_env: bool = False,
) -> list[Player]:
    """Return the players, with all that they need read from their files.

    Args:
      policies: as `tournament` takes them.
      env: what is to be played.
      any_env: whether a trained policy may play another environment than its own.

    Raises:
      Exception: as `load_policy` does; names the player.
      TypeError: if they are neither a list nor a dictionary.
      ValueError: if there are fewer than two, or two of one name.
    """
    if not isinstance(policies, Mapping):
        if isinstance(policies, str | Path) or not isinstance(policies, Sequence):
            raise TypeError(
                "policies must be a list of policies, or a dictionary with a name for"
                f" each, got {shown(policies)}"
            )
        names = [name_policy(policy) for policy in policies]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(
                    f"{names.count(name)} policies are named {name!r}; give each once,"
                    " or in Python a dictionary with a name for each"
                )
        policies = dict(zip(names, policies, strict=True))
    if len(policies) < 2:
        listed = ", ".join(map(str, policies)) or "none"
        raise ValueError(
            f"a tournament needs two policies or more, got {len(policies)} ({listed})"
        )
    for name in map(str, policies):
        if not 0 < len(name) <= _LONGEST_NAME:
            raise ValueError(
                f"a player's name, which its policy gives or you, must have 1 to"
                f" {_LONGEST_NAME} letters, got {shown(name)}"
            )
    return [
        _enter(str(name), policy, env, any_env) for name, policy in policies.items()
    ]


def _enter(name: str, policy: AnyPolicy, env: VectorEnv, any_env: bool) -> Player:
    policies: dict[str, Policy] = {}
    marks: dict[str, str | None] = {}
    with naming(f"player {name!r}"):
        for given, agents in group_agents(policy, env):
            own = read_policy(given, env)
            if isinstance(own, NetworkPolicy):
                own.check(env, any_env=any_env)
            else:
                own = commanding(agents, own, env, any_env)
            policies |= dict.fromkeys(agents, own)
            marks |= dict.fromkeys(agents, _mark(given, own))
    mark = "; ".join(f"{agent} {marks[agent]}" for agent in env.agents)
    return Player(name, policies, None if None in marks.values() else mark)


def _mark(given: Any, found: Policy) -> str | None:
    if isinstance(found, NetworkPolicy):
        return found.digest
    if isinstance(given, str | Path) and Path(given).suffix == SUFFIX:
        return hashlib.sha256(Path(given).read_bytes()).hexdigest()
    return str(given) if isinstance(given, str | Path) else None
