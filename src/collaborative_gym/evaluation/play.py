"""The evaluation of a policy, also disturbed, over episodes of a seed."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import fields
from typing import Any

import numpy as np

from collaborative_gym.envs.metrics import OF_SIDES
from collaborative_gym.envs.strain import STRAIN
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_callback, check_count
from collaborative_gym.evaluation.report import (
    ACTION_CHANGE,
    Report,
    Score,
    Statistic,
    Worst,
    are_one_episode,
    is_share,
)
from collaborative_gym.policies import (
    AnyPolicy,
    Policy,
    as_played,
    as_policy,
    name_policy,
)
from collaborative_gym.rng import check_seed
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import as_task, disturbed
from collaborative_gym.tasks.task import Randomization, Task

_MOST_DELAY = 100  # greatest delay, in control steps: ten seconds
_MOST_ENVS = 64  # default number of worlds; more are hardly faster on a CPU

OnProgress = Callable[[float], object] | None
"""Called with the share that is done, 0 to 1."""

DISTURBANCES: Mapping[str, Sequence[str]] = {
    "none": (),
    "starts": ("joint_noise", "object_position", "object_yaw", "target_position"),
    "link mass": ("link_mass",),
    "payload": ("payload",),
    "friction": ("friction",),
    "torque": ("lost_torque",),
    "delay": ("delay", "delayed"),
    "lost actions": ("lost_actions",),
    "noise": ("position_noise", "angle_noise"),
    "all": tuple(field.name for field in fields(Randomization)),
}
"""Fields of the randomization `hard` by the name of a disturbance, which leaves the
others as in `default`."""


def evaluate(
    env: str | Task,
    policy: AnyPolicy = "expert",
    *,
    episodes: int = 200,
    seed: int = 0,
    delay: int = 0,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    on_progress: OnProgress = None,
) -> Report:
    """Play the first episodes of a seed, each once, and report how they went.

    The numbers are the same for any `num_envs` and `num_threads`.

    Args:
      env: an environment id, a task's name, or a task.
      policy: a name or path for `load_policy`, such as "baseline", a function from
        observations to actions, by agent with a row per world, or one for each agent.
      episodes: number of episodes.
      seed: the episodes' seed.
      delay: number of control steps by which each action comes late; the robots hold
        still before the first.
      num_envs: worlds that play at the same time; None for at most 64.
      num_threads: physics threads, 0 for one per CPU.
      any_env: whether a trained policy may play another environment than its own.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      FileNotFoundError: if there is no such policy file or baseline.
      KeyError: if a name is unknown.
      TypeError: if the policy or a number is of another kind.
      ValueError: if a number is out of range, or the policy does not fit.
    """
    episodes, seed = check_count("episodes", episodes, at_least=1), check_seed(seed)
    delay = check_count("delay", delay, 0, _MOST_DELAY)
    check_callback("on_progress", on_progress)
    task = as_played(as_task(env), policy)
    if delay:
        task = disturbed(task, delay=delay, delayed=1.0)
    num_envs = worlds_for(episodes, num_envs)
    vector_env = VectorEnv(
        task, num_envs, seed=seed, num_threads=num_threads, strain=True
    )
    with closing(vector_env):
        act = as_policy(policy, vector_env, any_env=any_env)
        started = time.perf_counter()
        rows, steps = play_episodes(vector_env, act, episodes, seed, on_progress)
        rate = steps * num_envs / (time.perf_counter() - started)
    settings = {
        "identity": Identity.of(task).to_dict(),
        "policy": name_policy(policy),
        "delay": delay,
        "episodes": episodes,
        "seed": seed,
    }
    # Episodes that start alike are one episode, from which nothing can be inferred.
    different = rows[:1] if are_one_episode(rows) else rows
    agents, sides = vector_env.agents, vector_env.sides
    return Report(
        environment=task.name,
        settings=settings,
        sides={side: _score(different, side, len(sides) > 1) for side in sides},
        returns={agent: _statistic(different, f"{agent}/return") for agent in agents},
        episodes=tuple(rows),
        steps_per_second=rate,
        strain={name: Worst.of(name, rows) for name in (*STRAIN, ACTION_CHANGE)},
        coordination={
            name: (task.units.get(name, ""), _statistic(different, name))
            for name in task.coordination
        },
    )


def measure_robustness(
    env: str | Task,
    policy: AnyPolicy = "expert",
    *,
    episodes: int = 100,
    seed: int = 0,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    on_progress: OnProgress = None,
) -> dict[str, Report]:
    """Return the report of an evaluation with each of `DISTURBANCES`, by its name.

    All arguments are those of `evaluate`; `episodes` are played with each disturbance.
    Each of them disturbs an episode in the same way alone and together with the others.

    Raises:
      Exception: as `evaluate` does.
    """
    task = as_task(env)
    hard = task.randomizations["hard"]
    parts = parts_of(on_progress, [1] * len(DISTURBANCES))
    reports = {}
    for (name, changed), part in zip(DISTURBANCES.items(), parts, strict=True):
        reports[name] = evaluate(
            disturbed(task, **{field: getattr(hard, field) for field in changed}),
            policy,
            episodes=episodes,
            seed=seed,
            num_envs=num_envs,
            num_threads=num_threads,
            any_env=any_env,
            on_progress=part,
        )
    return reports


def worlds_for(episodes: int, num_envs: int | None = None) -> int:
    """Return `num_envs`, at most one for each episode, or as many as suit them."""
    if num_envs is not None:
        return min(check_count("num_envs", num_envs, 1), episodes)
    return math.ceil(episodes / math.ceil(episodes / _MOST_ENVS))


def play_episodes(
    env: VectorEnv,
    policy: Policy,
    episodes: int,
    seed: int,
    on_progress: OnProgress = None,
) -> tuple[list[dict[str, Any]], int]:
    """Return the `episode_row`s of a seed's first episodes, in order, and the steps.

    The steps are those of the whole batch. `on_progress` is called after each of them
    with the share that is done, 0 to 1.
    """
    rows: dict[int, dict[str, Any]] = {}
    steps = math.ceil(episodes / env.num_envs) * env.task.config.max_episode_steps
    observations, _ = env.reset(seed=seed)
    split, done = env.action_mode.split, 0
    before, changes = 0.0, np.zeros(env.num_envs)
    while len(rows) < episodes:
        actions = policy(observations)
        observations, _, _, _, infos = env.step(actions)
        done += 1
        moved = [split(np.asarray(actions[agent], float))[0] for agent in env.agents]
        moves = np.clip(np.concatenate(moved, axis=1), -1.0, 1.0)
        changes += np.abs(moves - before).mean(axis=1)
        fresh = infos["ended"][:, None]
        before = np.where(fresh, 0.0, moves)
        for i in np.flatnonzero(infos["ended"]):
            row = episode_row(infos, int(i))
            row[ACTION_CHANGE] = float(changes[i]) / row["length"]
            changes[i] = 0.0
            # The worlds' last round may play more episodes than were asked for.
            if row["episode"] < episodes:
                rows[row["episode"]] = row
        if on_progress is not None:
            # Fewer steps are enough where a task ends episodes before their time.
            on_progress(1.0 if len(rows) == episodes else min(1.0, done / steps))
    return [rows[episode] for episode in range(episodes)], done


def episode_row(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the `Report`'s row of the episode that world i has ended.

    Args:
      infos: of the step that ended it, from `VectorEnv.step`.
      i: the world, one of those in `infos["ended"]`.
    """
    metrics = infos["metrics"]
    row: dict[str, Any] = {name: int(metrics[name][i]) for name in ("episode", "seed")}
    for name in OF_SIDES:
        given = metrics.get(name, {})
        by_side = given if isinstance(given, Mapping) else {"": given}
        for side, values in by_side.items():
            value = float(values[i])
            # Control steps of 0.1 s add up to 0.30000000000000004 and the like.
            value = round(value, 6) if name == "time_to_success" else value
            row[f"{side}/{name}" if side else name] = value
    row["length"] = int(metrics["length"][i])
    row["diverged"] = bool(infos["diverged"][i])
    for agent, total in metrics["returns"].items():
        row[f"{agent}/return"] = float(total[i])
        for name, term in metrics["reward_terms"][agent].items():
            row[f"{agent}/{name}"] = float(term[i])
    for kind in "coordination", "strain":
        for name, values in metrics.get(kind, {}).items():
            row[name] = float(values[i])
    return row


def _score(rows: Sequence[Mapping[str, Any]], side: str, is_divided: bool) -> Score:
    columns = (f"{side}/{name}" if is_divided else name for name in OF_SIDES)
    return Score(*(_statistic(rows, name) for name in columns if name in rows[0]))


def _statistic(rows: Sequence[Mapping[str, Any]], column: str) -> Statistic:
    values = [row[column] for row in rows]
    at_least = 0.0 if column.endswith("time_to_success") else -math.inf
    return Statistic.of(values, is_share=is_share(column), at_least=at_least)


def parts_of(on_progress: OnProgress, sizes: Sequence[float]) -> list[OnProgress]:
    """Return callbacks for the progress of parts of these sizes within the whole."""
    if on_progress is None:
        return [None] * len(sizes)

    def part(i: int) -> OnProgress:
        done = sum(sizes[:i])
        return lambda share: on_progress((done + share * sizes[i]) / sum(sizes))

    return [part(i) for i in range(len(sizes))]
