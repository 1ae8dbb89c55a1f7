"""The evaluation of a policy, over episodes that depend on the seed alone."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, check_count, unknown
from collaborative_gym.evaluation.report import Report, Statistic
from collaborative_gym.math import Array
from collaborative_gym.policies import Policy, as_policy
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Randomization, Task, name_agents

_MOST_ENVS = 64
"""Worlds beside one another unless told otherwise; more run hardly faster on a CPU."""


def evaluate(
    env: str | Task,
    policy: str | Path | Policy = "expert",
    episodes: int = 200,
    seed: int = 0,
    robots: Sequence[str | Robot] | None = None,
    randomization: str | Randomization | None = None,
    num_envs: int | None = None,
    num_threads: int = 0,
    idle: Sequence[str] = (),
    on_progress: Callable[[float], object] | None = None,
) -> Report:
    """Play the first episodes of a seed, each once, and report how they went.

    The numbers are the same for any `num_envs` and `num_threads`.

    Args:
      env: an environment id, a task's name, or a task.
      policy: a name or path for `load_policy`, such as "baseline", or a function from
        observations to actions, both by agent with one row per world.
      episodes: how many.
      seed: which episodes.
      robots: other arms than the environment's own, in the order of the agents.
      randomization: how starts are drawn, a preset's name or a value; None for
        "default".
      num_envs: worlds to play in beside one another; None for at most 64.
      num_threads: physics threads, 0 for one per CPU.
      idle: agents that hold still with an open grip, whatever the policy says.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      FileNotFoundError: if there is no such policy file or baseline.
      KeyError: if a name is unknown.
      TypeError: if the policy, a number or `idle` is of another kind.
      ValueError: if a number is out of range, the policy does not fit the environment,
        or `robots` or `randomization` is given beside a task, which has its own.
    """
    check_count("episodes", episodes, at_least=1)
    if isinstance(idle, str):
        raise TypeError(f"idle must be a list of agents, such as [{idle!r}]")
    task = as_task(env, robots, randomization)
    for agent in idle:
        if agent not in task.agents:
            raise UnknownName(unknown("agent", agent, task.agents))
    if num_envs is None:
        num_envs = math.ceil(episodes / math.ceil(episodes / _MOST_ENVS))
    vector_env = VectorEnv(task, num_envs, seed=seed, num_threads=num_threads)
    act = as_policy(policy, vector_env)
    act = _holding_still(act, vector_env, idle)
    steps = math.ceil(episodes / num_envs) * task.config.max_episode_steps
    started = time.perf_counter()
    rows, steps_done = _play(vector_env, act, episodes, seed, steps, on_progress)
    duration = time.perf_counter() - started
    settings = _settings(task, policy, episodes, seed, idle)
    rate = steps_done * num_envs / duration
    vector_env.close()
    return _report(env if isinstance(env, str) else _name(task), settings, rows, rate)


def _holding_still(policy: Policy, env: VectorEnv, idle: Sequence[str]) -> Policy:
    """Return the policy with the actions of idle agents replaced."""
    still = {agent: env.idle()[agent] for agent in idle}

    def act(observations: Mapping[str, Array]) -> Mapping[str, Array]:
        actions = policy(observations)
        # The environment refuses what is no mapping, and says what to give.
        return {**actions, **still} if isinstance(actions, Mapping) else actions

    return act


def _play(
    env: VectorEnv,
    policy: Policy,
    episodes: int,
    seed: int,
    steps: int,
    on_progress: Callable[[float], object] | None,
) -> tuple[list[dict[str, Any]], int]:
    """Return the rows of the episodes, in order, and how many steps it took."""
    rows: dict[int, dict[str, Any]] = {}
    observations, _ = env.reset(seed=seed)
    done = 0
    while len(rows) < episodes:
        observations, _, _, _, infos = env.step(policy(observations))
        done += 1
        for i in np.flatnonzero(infos["ended"]):
            row = episode_row(infos, int(i))
            # The worlds' last round may play more episodes than were asked for.
            if row["episode"] < episodes:
                rows[row["episode"]] = row
        if on_progress is not None:
            on_progress(min(1.0, done / steps))
    return [rows[episode] for episode in range(episodes)], done


def episode_row(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return what is known of the episode that world i has ended, as a `Report` has it.

    Args:
      infos: what the step that ended it gave, from `VectorEnv.step`.
      i: the world, one of those in `infos["ended"]`.
    """
    metrics = infos["metrics"]
    row: dict[str, Any] = {
        "episode": int(metrics["episode"][i]),
        "seed": int(metrics["seed"][i]),
        "return": float(metrics["return"][i]),
        "completion": float(metrics["completion"][i]),
        "performance": float(metrics["performance"][i]),
        "time_to_success": round(float(metrics["time_to_success"][i]), 6),
        "length": int(metrics["length"][i]),
        "diverged": bool(infos["diverged"][i]),
    }
    for agent, total in metrics["returns"].items():
        row[f"{agent}/return"] = float(total[i])
        for name, term in metrics["reward_terms"][agent].items():
            row[f"{agent}/{name}"] = float(term[i])
    return row


def _settings(
    task: Task,
    policy: str | Path | Policy,
    episodes: int,
    seed: int,
    idle: Sequence[str],
) -> dict[str, Any]:
    """Return what decides the numbers, as a `Report` has it."""
    return {
        "robots": [robot.name for robot in task.robots.values()],
        "randomization": asdict(task.config.randomization),
        "policy": str(policy) if isinstance(policy, str | Path) else _name(policy),
        "episodes": episodes,
        "seed": seed,
        "idle": list(idle),
        "mujoco": mujoco.__version__,
    }


def _report(
    environment: str,
    settings: dict[str, Any],
    rows: list[dict[str, Any]],
    steps_per_second: float,
) -> Report:
    def statistic(column: str) -> Statistic:
        return Statistic.of([row[column] for row in rows])

    agents = name_agents(len(settings["robots"]))
    return Report(
        environment=environment,
        settings=settings,
        mean_reward=statistic("return"),
        completion=statistic("completion"),
        performance=statistic("performance"),
        time_to_success=statistic("time_to_success"),
        returns={agent: statistic(f"{agent}/return") for agent in agents},
        episodes=tuple(rows),
        steps_per_second=steps_per_second,
    )


def _name(thing: Any) -> str:
    return getattr(thing, "__name__", type(thing).__name__)
