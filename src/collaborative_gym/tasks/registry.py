"""Environment ids, and how a task is made from one."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import gymnasium

from collaborative_gym import errors
from collaborative_gym.plugins import note_registration
from collaborative_gym.robots import Robot, get_robot
from collaborative_gym.tasks.declared import check_class
from collaborative_gym.tasks.identity import ON_PLAYING, Identity
from collaborative_gym.tasks.task import Randomization, Task


@dataclass(frozen=True)
class EnvSpec:
    """A registered environment.

    Attributes:
      env_id: its versioned id.
      task: the task's class.
      robots: names of its arms, in the order of the agents.
      settings: fields of the task's config that differ from their defaults.
    """

    env_id: str
    task: type[Task]
    robots: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)


_ENVS: dict[str, EnvSpec] = {}
_TASKS: dict[str, type[Task]] = {}

_ELSEWHERE = {"seed": "; reset() takes it", "num_envs": "; cg.make_vec takes it"}
"""What messages add on options that are often given to `make`."""


def register_task(name: str, task: type[Task]) -> None:
    """Let `make` build a task by name with any robots.

    Raises:
      ValueError: if the name is taken, or not one word.
    """
    errors.check_word("name", name)
    check_class(task)
    if name in _TASKS:
        raise ValueError(f"task {name!r} is registered already")
    _TASKS[name] = task
    note_registration()


def register_env(spec: EnvSpec) -> None:
    """Let `make` and Gymnasium build an environment by its id.

    Raises:
      ValueError: if the id is taken, or not of the form `Name-v0`.
    """
    errors.check_kind("environment", spec, EnvSpec, "an EnvSpec")
    errors.check_name("the id", spec.env_id)
    if all(spec.task is not known for known in _TASKS.values()):  # and checked there
        check_class(spec.task)
    errors.check_kind("robots", spec.robots, (tuple, list), "a sequence of names")
    for robot in spec.robots:
        errors.check_name("each of robots", robot)
    errors.check_kind("settings", spec.settings, Mapping, "a dictionary")
    if not re.fullmatch(r"([\w:.-]+/)?[\w:.-]+-v\d+", spec.env_id):
        raise ValueError(
            f"environment id {spec.env_id!r} is not a name and a version, as in"
            f" '{spec.env_id.partition('-v')[0] or 'Name'}-v0'"
        )
    if spec.env_id in _ENVS:
        raise ValueError(f"environment {spec.env_id!r} is registered already")
    gymnasium.register(
        spec.env_id,
        entry_point="collaborative_gym.envs.gymnasium:GymnasiumEnv",
        vector_entry_point="collaborative_gym.envs.gymnasium_vector:GymnasiumVectorEnv",
        kwargs={"env_id": spec.env_id},
    )
    _ENVS[spec.env_id] = spec
    note_registration()


def register_teams(
    name: str,
    task: type[Task],
    *,
    pandas: Sequence[int],
    mixed: Sequence[int] = (3,),
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Register a task's teams of so many Pandas, and of so many arms of three kinds."""
    teams = {f"Pandas{count}": ("panda",) * count for count in pandas}
    teams |= {f"Mixed{n}": ("panda", "sawyer", "jaco", "panda")[:n] for n in mixed}
    for team, robots in teams.items():
        register_env(EnvSpec(f"{name}{team}-v0", task, robots, settings or {}))


def list_envs() -> tuple[str, ...]:
    """Return the ids of all environments."""
    return tuple(_ENVS)


def list_tasks() -> tuple[str, ...]:
    """Return the names of all tasks."""
    return tuple(_TASKS)


def get_env(env_id: str) -> EnvSpec:
    """Return a registered environment.

    Raises:
      KeyError: if there is none of that id.
    """
    return errors.look_up("environment", env_id, _ENVS)


def find_env(task: Task) -> str | None:
    """Return the id that is most like a task with these robots, if there is any."""
    here = Identity.of(task)
    alike = {
        env_id: here.differences(Identity.of(make_task(env_id)), ignore=ON_PLAYING)
        for env_id, spec in _ENVS.items()
        if spec.task is type(task) and spec.robots == here.robot_names
    }
    # Among those that are equally like it, the one by which it was made.
    cost = {env_id: (len(alike[env_id]), env_id != task.name) for env_id in alike}
    return min(cost, key=lambda env_id: cost[env_id], default=None)


def make_task(
    name: str,
    robots: str | Robot | Sequence[str | Robot] | None = None,
    *,
    num_robots: int | None = None,
    randomization: str | Randomization | None = None,
    **settings: Any,
) -> Task:
    """Return a task, ready for an environment to build.

    Args:
      name: an environment id, or a task's name.
      robots: the arms in the order of the agents, by name or value, or one for all. An
        environment id has its own; other arms are mounted by the task's rule.
      num_robots: how many arms of one kind; None for the usual number.
      randomization: how starts are drawn, a preset's name or a value ("default").
      **settings: other fields of the task's config.

    Raises:
      KeyError: if there is no such environment, robot, preset or setting.
      TypeError: if robots is not a sequence.
      ValueError: if the task takes another number of robots, or num_robots goes with
        robots of several kinds.
    """
    tasks = {
        name: EnvSpec(name, task, ("panda",) * task.robot_counts[0])
        for name, task in _TASKS.items()
    }
    spec = errors.look_up_registered("environment", name, {**_ENVS, **tasks})
    arms = _arms(spec, robots, num_robots)
    is_own = robots is None and num_robots is None
    remedy = "; name as many in its EnvSpec" if is_own else ""
    _check_number(name, spec.task, arms, remedy)
    same = tuple(arm.name for arm in arms) == spec.robots
    own = dict(spec.settings) if same else {}
    config = _configure(spec.task, {**own, **settings})
    starts = _randomization(randomization, spec.task.randomizations)
    config = replace(config, randomization=starts)
    task = spec.task(arms, config)
    task.name = name
    return task


def _check_number(
    name: str, task: type[Task], arms: Sequence[Robot], remedy: str = ""
) -> None:
    counts = task.robot_counts
    if len(arms) not in counts:
        given = errors.counted(arm.name for arm in arms)
        numbers = " or ".join(map(str, counts))
        if len(counts) > 2:
            numbers = f"{min(counts)} to {max(counts)}"
        raise ValueError(
            f"{name} needs {numbers} robots, got {len(arms)} ({given}){remedy}"
        )


def _arms(
    spec: EnvSpec,
    robots: str | Robot | Sequence[str | Robot] | None,
    num_robots: int | None,
) -> tuple[Robot, ...]:
    given = spec.robots if robots is None else robots
    usual = len(spec.robots) if isinstance(given, str | Robot) else None
    chosen = (given,) if isinstance(given, str | Robot) else given
    # The order of a set would be chance.
    if isinstance(chosen, bytes) or not isinstance(chosen, Sequence):
        raise TypeError(
            f"robots must be a name, or a sequence of names, got {errors.shown(chosen)}"
        )
    arms = tuple(get_robot(robot) for robot in chosen)
    count = usual if num_robots is None else num_robots
    if count is None:
        return arms
    errors.check_count("num_robots", count, 1, 100)
    if any(arm != arms[0] for arm in arms):
        raise ValueError(
            f"num_robots={count} needs one kind of robot, got"
            f" {', '.join(arm.name for arm in arms)}; name each of them in robots"
        )
    return arms[:1] * count


def as_task(
    env: str | Task,
    robots: str | Robot | Sequence[str | Robot] | None = None,
    *,
    randomization: str | Randomization | None = None,
    **settings: Any,
) -> Task:
    """Return a task as it is, or the one of a name as `make_task` does.

    Raises:
      TypeError: if it is an environment.
      ValueError: if robots, randomization or settings are given beside a task.
    """
    if isinstance(getattr(env, "task", None), Task):
        raise TypeError("this takes an environment's id or a task; give env.task")
    if not isinstance(env, Task):
        return make_task(env, robots, randomization=randomization, **settings)
    if robots is not None or randomization is not None or settings:
        raise ValueError(
            "a task has its own robots, randomization and settings; give them to"
            " cg.task, which makes it"
        )
    return env


def disturbed(task: Task, **changes: Any) -> Task:
    """Return the same task with changes of its randomization's fields."""
    return task.varied(randomization=replace(task.config.randomization, **changes))


def resized(task: Task, count: int) -> Task:
    """Return the same task for another number of its arms.

    Raises:
      ValueError: if it takes another number, or its arms differ or have places.
    """
    kinds = set(task.robots.values())
    if len(kinds) > 1 or task.config.placements is not None:
        raise ValueError(
            "a team of another size needs arms of one kind that the task places"
        )
    arms = tuple(kinds) * count
    _check_number(task.name, type(task), arms)
    other = type(task)(arms, task.given)
    other.name = task.name
    return other


def _configure(task: type[Task], settings: dict[str, Any]):
    valid = [option.name for option in fields(task.config_class)]
    for option in settings:
        if option not in valid:
            names = [*valid, "robots"]
            wrong = errors.unknown("option", option, names)
            wrong += _ELSEWHERE.get(option, "")
            raise errors.UnknownOption(f"{task.__name__} has {wrong}")
    return task.config_class(**settings)


def _randomization(
    given: str | Randomization | None, presets: Mapping[str, Randomization]
) -> Randomization:
    if isinstance(given, Randomization):
        return given
    a = "a preset's name, or a value such as Randomization(joint_noise=0.1)"
    preset = "default" if given is None else given
    errors.check_kind("randomization", preset, str, a)
    return errors.look_up("randomization", preset, presets)
