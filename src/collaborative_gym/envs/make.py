"""Environments by their id."""

from collections.abc import Sequence
from typing import Any

from collaborative_gym.envs.pettingzoo import PettingZooEnv
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Randomization, Task


def make(
    env: str | Task,
    robots: str | Robot | Sequence[str | Robot] | None = None,
    *,
    render_mode: str | None = None,
    randomization: str | Randomization | None = None,
    strain: bool = False,
    **settings: Any,
) -> PettingZooEnv:
    """Return a PettingZoo parallel environment.

    Args:
      env: an id from `list_envs`, a task's name from `list_tasks`, or a task from
        `cg.task`. With a task, give only `render_mode` and `strain` besides.
      robots: the arms in the order of the agents, by name or value, or one for all;
        None for the environment's own.
      render_mode: "rgb_array" lets `render` return pictures.
      randomization: how starts are drawn: a preset ("default", "paper", "wide", "hard",
        "lost") or a value; None for "default".
      strain: whether to measure the strain, too; see `VectorEnv`.
      **settings: `num_robots` (how many arms of one kind), or fields of the config.

    Raises:
      KeyError: if there is no such environment, robot, preset or setting.
      ValueError: if the task cannot be done with these robots.
    """
    task = as_task(env, robots, randomization=randomization, **settings)
    return PettingZooEnv(task, render_mode, name=task.name, strain=strain)


def make_vec(
    env: str | Task,
    num_envs: int,
    *,
    seed: int = 0,
    num_threads: int = 0,
    robots: str | Robot | Sequence[str | Robot] | None = None,
    randomization: str | Randomization | None = None,
    strain: bool = False,
    **settings: Any,
) -> VectorEnv:
    """Return many worlds of an environment.

    Args:
      env: as in `make`; a task has its own robots, randomization and settings.
      num_envs: how many worlds.
      seed: the first episodes' seed.
      num_threads: physics threads, 0 for one per CPU.
      robots: as in `make`.
      randomization: as in `make`.
      strain: as in `make`.
      **settings: as in `make`.

    Raises:
      KeyError: if there is no such environment, robot, preset or setting.
      ValueError: if the task cannot be done with these robots.
    """
    task = as_task(env, robots, randomization=randomization, **settings)
    return VectorEnv(task, num_envs, seed=seed, num_threads=num_threads, strain=strain)
