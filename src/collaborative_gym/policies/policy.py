"""Policies by name: scripted ones, shipped ones, and those of a training run."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box

from collaborative_gym.blocks import split_columns
from collaborative_gym.envs.gymnasium import SingleAgent
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, check_flag, look_up, shown, unknown
from collaborative_gym.math import Array
from collaborative_gym.policies import scripted
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.onnx import SUFFIX, OnnxNetwork
from collaborative_gym.tasks.registry import disturbed, find_env, list_envs
from collaborative_gym.tasks.task import Task

Policy = Callable[[Mapping[str, Array]], Mapping[str, Array]]
"""From observations to actions, both by agent, with one row per world."""

AnyPolicy = str | Path | Policy | Mapping[str, str | Path | Policy]
"""A policy, or its name or path for `load_policy`, or one of these for each agent."""

SHIPPED = {
    "baseline": Path(__file__).parents[1] / "baselines",
    "ego": Path(__file__).parents[1] / "egos",
}
"""Folders of shipped policies by kind: a baseline does its task with itself, and an ego
with partners of many kinds."""

POLICY_FILE = "policy.safetensors"
"""Policy in the folder of a training run."""

_PLAYERS = "players"
"""Folder, in that of a run with several players, of a policy for each."""


def load_policy(policy: AnyPolicy, env: Any = None, *, any_env: bool = False) -> Any:
    """Return a policy, ready to play.

    A network of a file sees only the observations of its own agents. If several agents
    have the same file, it is loaded once.

    Args:
      policy: one of these, or a dictionary with one for each agent, such as
        `{"robot_1": "baseline", "robot_2": "runs/mine"}`: a name, such as "expert",
        "baseline", "ego", "random", "idle" or an environment's id, of which
        docs/concepts.md has a list; a path to a policy file, to the folder of a
        training run or of one of its players ("runs/league/main-3"), or to a network in
        ONNX (docs/clients.md); a function from observations to actions; or a model of
        Stable-Baselines3 that commands all robots. "limp" and "absent" are for one
        agent, which the worlds' randomization must name too; `evaluate` does this.
      env: the environment to play: a `VectorEnv`, or an environment of this package
        with the interface of PettingZoo, Gymnasium or Stable-Baselines3, whose
        observations and actions the policy then takes and returns. Without it, you can
        give an id or a path, and the policy plays a `VectorEnv`.
      any_env: whether a trained policy may play another environment than its own, if
        its observations and actions have the same blocks.

    Raises:
      FileNotFoundError: if there is no such file, or none is shipped.
      KeyError: if there is no such policy or agent.
      TimeoutError: if a network in ONNX does not answer.
      TypeError: if it is of another kind, or needs an environment.
      ValueError: if a file is damaged, is for another environment or has no network for
        an agent, or an agent has no policy.
    """
    own = getattr(env, "unwrapped", env)
    vector_env = getattr(own, "vector_env", own)
    if vector_env is None:
        found, is_name = None, policy in _NAMES or _style(policy)
        if isinstance(policy, str | Path) and not is_name:
            found = _load_file(policy)
        if not isinstance(found, NetworkPolicy):
            raise TypeError(f"{shown(policy)} needs an environment; pass env too")
        return found
    if not isinstance(vector_env, VectorEnv):
        raise TypeError(
            "policies play a VectorEnv, or a PettingZoo or Gymnasium environment of"
            f" this package, got {shown(env)}"
        )
    act = as_policy(policy, vector_env, any_env=any_env)
    if own is vector_env:
        return act
    # Where one agent commands all robots, there is one space and not one for each.
    is_joint = isinstance(getattr(own, "observation_space", None), Box)
    if is_joint:
        act = _joined(act, vector_env)
    agents = () if is_joint else vector_env.agents
    return act if hasattr(own, "num_envs") else _for_one_world(act, agents)


def as_policy(policy: AnyPolicy, env: VectorEnv, *, any_env: bool = False) -> Policy:
    """Return a policy as `load_policy` does, for a `VectorEnv`.

    Raises:
      Exception: as `load_policy` does.
    """
    any_env = check_flag("any_env", any_env)
    if not isinstance(policy, Mapping):
        return commanding(env.agents, policy, env, any_env)
    leaders = [
        (commanding(agents, given, env, any_env), agents)
        for given, agents in group_agents(policy, env)
    ]
    return lambda observations: {
        agent: actions
        for leader, agents in leaders
        for agent, actions in _of(agents, leader(observations)).items()
    }


def as_played(task: Task, policy: AnyPolicy) -> Task:
    """Return a task with the arms limp or absent whose policy is "limp" or "absent"."""
    given = (
        policy if isinstance(policy, Mapping) else dict.fromkeys(task.agents, policy)
    )
    states = {
        state: tuple(agent for agent in task.agents if given.get(agent) == state)
        for state in STATES
    }
    return disturbed(task, **states) if any(states.values()) else task


def group_agents(policy: AnyPolicy, env: VectorEnv) -> list[tuple[Any, list[str]]]:
    """Return each policy once, with the agents that it commands.

    Raises:
      KeyError: if there is no such agent.
      ValueError: if an agent has no policy.
    """
    if not isinstance(policy, Mapping):
        return [(policy, list(env.agents))]
    for agent in policy:
        look_up("agent", agent, dict.fromkeys(env.agents))
    groups: dict[object, tuple[Any, list[str]]] = {}
    for agent in env.agents:
        if agent not in policy:
            raise ValueError(
                f"there is no policy for the agent {agent}; name one for each of"
                f' {", ".join(env.agents)}, "idle" for one that holds still'
            )
        given = policy[agent]
        same = Path(given) if isinstance(given, str | Path) else id(given)
        groups.setdefault(same, (given, []))[1].append(agent)
    return list(groups.values())


def named_policies(
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy],
) -> dict[str, AnyPolicy]:
    """Return policies by the names of a dictionary, or else by their own.

    Raises:
      TypeError: if they are neither a list nor a dictionary.
      ValueError: if two have one name.
    """
    if isinstance(policies, Mapping):
        return {str(name): policy for name, policy in policies.items()}
    if isinstance(policies, str) or not isinstance(policies, Sequence):
        raise TypeError(
            "policies must be a list of policies, or a dictionary with a name for each,"
            f" got {shown(policies)}"
        )
    names = [name_policy(policy) for policy in policies]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"{names.count(name)} policies are named {name!r}; give each once, or"
                " in Python a dictionary with a name for each"
            )
    return dict(zip(names, policies, strict=True))


def name_policy(policy: AnyPolicy) -> str:
    """Return the name of a policy, as the command line takes it if it can."""
    if isinstance(policy, Mapping):
        return " ".join(f"{agent}={name_policy(own)}" for agent, own in policy.items())
    if isinstance(policy, str | Path):
        return str(policy)
    return getattr(policy, "__name__", type(policy).__name__)


def split_word(word: str) -> tuple[str, str]:
    """Return the seat, if any, and the policy of "robot_2=FILE" or "FILE"."""
    seat, _, policy = word.partition("=")
    return (seat, policy) if policy and seat.isidentifier() else ("", word)


def commanding(
    agents: Sequence[str], policy: Any, env: VectorEnv, any_env: bool
) -> Policy:
    """Return the policy of these agents, and maybe of others.

    Raises:
      Exception: as `load_policy` does.
    """
    policy = read_policy(policy, env)
    if isinstance(policy, str):
        if policy in STATES:
            _check_state(policy, agents, env)
        style = _style(policy)
        return scripted.expert_policy(env, style) if style else _BY_ENV[policy](env)
    if isinstance(policy, OnnxNetwork):
        return policy.commanding(agents, env)
    if isinstance(policy, NetworkPolicy):
        policy = policy.serving(agents)
        policy.check(env, any_env=any_env)
    if callable(policy):
        return cast(Policy, policy)
    if hasattr(policy, "predict"):
        return _predicting(policy, env)
    raise TypeError(
        f"policy must be one of {', '.join(map(repr, _NAMES))}, a path, a function from"
        " observations to actions, or one of these for each agent, got"
        f" {shown(policy)}"
    )


def _check_state(state: str, agents: Sequence[str], env: VectorEnv) -> None:
    for agent in agents:
        if agent not in getattr(env.task.config.randomization, state):
            raise ValueError(
                f"{agent} is not {state} in these worlds; make them with a"
                f' randomization that has {state}=("{agent}",)'
            )


def read_policy(policy: Any, env: VectorEnv) -> Any:
    """Return the networks of a name or a path, and anything else as it is.

    Raises:
      Exception: as `load_policy` does.
    """
    if not isinstance(policy, str | Path) or policy in _BY_ENV or _style(policy):
        return policy
    if policy not in SHIPPED:
        return _load_file(policy)
    robots = ", ".join(robot.name for robot in env.task.robots.values())
    title = f"{type(env.task).__name__} with {robots}"
    return _load_shipped(str(policy), find_env(env.task), title)


def _style(policy: object) -> str:
    kind, _, style = str(policy).partition(":")
    return style if kind == "expert" else ""


def _of(agents: Sequence[str], actions: Any) -> dict[str, Array]:
    if not isinstance(actions, Mapping) or not actions.keys() >= set(agents):
        raise ValueError(
            f"the policy of {' and '.join(agents)} returned {shown(actions)}; it must"
            " return a dictionary with actions of its own agents"
        )
    return {agent: actions[agent] for agent in agents}


def _load_file(name: str | Path) -> NetworkPolicy | OnnxNetwork:
    if name in list_envs():
        return _load_shipped("baseline", str(name))
    path = Path(name)
    if path.is_dir():
        if not (path / POLICY_FILE).exists():
            raise FileNotFoundError(
                f"{path} has no {POLICY_FILE}; give the folder of one training run,"
                " which has it from its first validation on: the next comes after"
                " validation_interval (250,000) steps or at the end; --resume goes on"
            )
        return NetworkPolicy.load(path / POLICY_FILE)
    if path.exists():
        return OnnxNetwork(path) if path.suffix == SUFFIX else NetworkPolicy.load(path)
    players = (path.parent / _PLAYERS).glob("*.safetensors")
    if names := {file.stem: file for file in players}:
        return NetworkPolicy.load(look_up("player", path.name, names))
    if path.suffix or len(path.parts) > 1:
        raise FileNotFoundError(
            f"no policy file {path} exists, nor a training run's folder of this name"
        )
    shipped = [each for each in list_envs() if is_shipped("baseline", each)]
    wrong = unknown("policy", name, [*_NAMES, *shipped]).partition(";")[0]
    raise UnknownName(
        f"{wrong}; policies: {', '.join(_NAMES)}, a file, a training run's folder, or"
        " the id of an environment with a baseline"
    )


def player_file(name: str) -> Path:
    """Return the path of a player's policy in the folder of its run."""
    return Path(_PLAYERS, f"{name}.safetensors")


def shipped_file(kind: str, env_id: str) -> Path:
    """Return the path of an environment's policy of a kind, if it is shipped."""
    return SHIPPED[kind] / f"{env_id}.safetensors"


def is_shipped(kind: str, env_id: str) -> bool:
    """Return whether a policy of a kind is shipped for an environment."""
    return shipped_file(kind, env_id).exists()


def shipped_kinds(env_id: str) -> list[str]:
    """Return the kinds of policies that are shipped for an environment."""
    return [kind for kind in SHIPPED if is_shipped(kind, env_id)]


def _load_shipped(kind: str, env_id: str | None, title: str = "") -> NetworkPolicy:
    """Return an environment's policy of a kind; `title` names one without an id."""
    if env_id is None or not is_shipped(kind, env_id):
        raise FileNotFoundError(
            f"no {kind} is shipped for {env_id or title}; give the path of a policy"
            " that you trained"
        )
    return NetworkPolicy.load(shipped_file(kind, env_id))


def _predicting(model: Any, env: VectorEnv) -> Policy:
    """Return the deterministic policy of a model of Stable-Baselines3, for all robots.

    Observations go through the model's `VecNormalize`, if it has one, as it is then.
    A model that was trained with it and loaded from a file needs it, as in
    `PPO.load(path, VecNormalize.load(...))`.

    Raises:
      ValueError: if the model's spaces are not those of all robots side by side.
    """
    agents = SingleAgent(env)
    for name in ("observation_space", "action_space"):
        given, own = getattr(model, name).shape, getattr(agents, name).shape
        if given != own:
            raise ValueError(
                f"the model's {name.replace('_', ' ')} has shape {given}; that of all"
                f" robots of {env.task.name} side by side is {own}"
            )
    normalizer = model.get_vec_normalize_env()

    def act(observations: Mapping[str, Array]) -> dict[str, Array]:
        rows = agents.joined(observations)
        if normalizer is not None:
            rows = normalizer.normalize_obs(rows)
        return agents.split(model.predict(rows, deterministic=True)[0])

    return act


def _for_one_world(
    act: Callable[[Any], Any], agents: Sequence[str]
) -> Callable[[Any], Any]:
    """Return a policy over observations and actions without the axis of worlds."""

    def act_once(observations: Any) -> Any:
        if isinstance(observations, tuple):
            why = "a policy takes observations alone: observations, infos = env.reset()"
            raise TypeError(why)
        if not agents:
            return act(observations[None])[0]
        if not isinstance(observations, Mapping) or {*agents} - observations.keys():
            why = f"observations must be a dictionary with those of {', '.join(agents)}"
            raise TypeError(f"{why}, got {shown(observations)}")
        batch = {agent: row[None] for agent, row in observations.items()}
        return {agent: rows[0] for agent, rows in act(batch).items()}

    return act_once


def _joined(policy: Policy, env: VectorEnv) -> Callable[[np.ndarray], np.ndarray]:
    """Return a policy over all agents' observations and actions, side by side."""
    sizes = env.world.definition.layout.observation_sizes

    def act(observations: np.ndarray) -> np.ndarray:
        actions = policy(split_columns(np.asarray(observations), sizes))
        return np.concatenate([actions[agent] for agent in env.agents], axis=1)

    return act


_BY_ENV: dict[str, Callable[[VectorEnv], Policy]] = {
    "expert": scripted.expert_policy,
    "random": scripted.RandomPolicy,
    "idle": scripted.idle_policy,
    "gripping": scripted.gripping_policy,
    "frozen": scripted.frozen_policy,
}

SCRIPTED = tuple(_BY_ENV)
"""Names of every task's policies."""

STATES = {"limp": scripted.gripping_policy, "absent": scripted.idle_policy}
"""Policies of arms in a state that no action puts them into, but the randomization."""

_BY_ENV |= STATES
_NAMES = (*SHIPPED, *_BY_ENV)
