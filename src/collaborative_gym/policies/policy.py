"""Policies by name: scripted ones, shipped ones, and those of a training run."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, unknown
from collaborative_gym.math import Array
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.scripted import RandomPolicy, expert_policy
from collaborative_gym.tasks.registry import find_env, list_envs

Policy = Callable[[Mapping[str, Array]], Mapping[str, Array]]
"""From observations to actions, both by agent, with one row per world."""

BASELINES = Path(__file__).parents[1] / "baselines"
"""Where the shipped policies and their cards are, by environment id."""

POLICY_FILE = "policy.safetensors"
"""Name of the policy in the folder of a training run."""


def load_policy(name: str | Path, env: Any = None) -> Policy:
    """Return a policy.

    Args:
      name: an environment id, for its baseline, the trained policy that is shipped; a
        path to a policy file or to the folder of a training run; "baseline", that of
        `env`; "expert", the task's scripted expert, which looks at the state of the
        worlds and not at the observations; or "random", uniform actions, the same for
        an episode of a seed in any batch.
      env: a `VectorEnv`, or a PettingZoo environment of this package, which the policy
        must fit. Actions have the form that its `step` takes; without it, that of
        `VectorEnv.step`. "baseline", "expert" and "random" need it.

    Raises:
      FileNotFoundError: if there is no such file, or the environment has no baseline.
      KeyError: if there is no such policy.
      TypeError: if it is for another kind of environment, or needs one.
      ValueError: if the file is damaged, or does not fit the environment.
    """
    vector_env = getattr(env, "vector_env", env)
    if vector_env is not None and not isinstance(vector_env, VectorEnv):
        raise TypeError(
            "policies play a VectorEnv or a PettingZoo environment of this package,"
            f" got {env!r}"
        )
    policy = _load(name, vector_env)
    return policy if vector_env is env else _for_one_world(policy)


def as_policy(policy: str | Path | Policy, env: VectorEnv) -> Policy:
    """Return a policy as it is, or the one of a name as `load_policy` does.

    Raises:
      FileNotFoundError: if there is no such file, or the environment has no baseline.
      KeyError: if there is no policy of that name.
      TypeError: if it is neither a name nor a function.
      ValueError: if it does not fit the environment.
    """
    if isinstance(policy, str | Path):
        return load_policy(policy, env)
    if not callable(policy):
        raise TypeError(
            f"policy must be one of {', '.join(map(repr, _BY_ENV))}, a path, or a"
            f" function from observations to actions, got {policy!r}"
        )
    if isinstance(policy, NetworkPolicy):
        policy.check(env)
    return policy


def _load(name: str | Path, env: VectorEnv | None) -> Policy:
    if name in _BY_ENV:
        if env is None:
            raise TypeError(f"{name!r} needs an environment; pass env too")
        return _BY_ENV[str(name)](env)
    policy = _load_file(name)
    if env is not None:
        policy.check(env)
    return policy


def _load_file(name: str | Path) -> NetworkPolicy:
    """Return the policy of an environment id or a path."""
    if name in list_envs():
        path = BASELINES / f"{name}.safetensors"
        if not path.exists():
            raise FileNotFoundError(f"no baseline is shipped for {name}")
        return NetworkPolicy.load(path)
    path = Path(name)
    if path.is_dir():
        if not (path / POLICY_FILE).exists():
            raise FileNotFoundError(
                f"{path} has no {POLICY_FILE}; training writes it at its first"
                " validation"
            )
        return NetworkPolicy.load(path / POLICY_FILE)
    if path.exists():
        return NetworkPolicy.load(path)
    if path.suffix or len(path.parts) > 1:
        raise FileNotFoundError(f"no policy file {path}")
    raise UnknownName(unknown("policy", name, [*_BY_ENV, *list_envs()]))


def _baseline(env: VectorEnv) -> Policy:
    env_id = find_env(env.task)
    if env_id is None:
        robots = ", ".join(robot.name for robot in env.task.robots.values())
        raise FileNotFoundError(
            f"no baseline is shipped for {type(env.task).__name__} with {robots}; give"
            " the path of a policy that you trained"
        )
    policy = _load_file(env_id)
    policy.check(env)
    return policy


def _for_one_world(policy: Policy) -> Policy:
    """Return a policy over observations and actions without the axis of worlds."""

    def act(observations: Mapping[str, Array]) -> dict[str, Array]:
        batch = {agent: row[None] for agent, row in observations.items()}
        return {agent: rows[0] for agent, rows in policy(batch).items()}

    return act


_BY_ENV: dict[str, Callable[[VectorEnv], Policy]] = {
    "baseline": _baseline,
    "expert": expert_policy,
    "random": RandomPolicy,
}
