"""The identity of an environment, a value that files keep and that can be compared.

A policy, a checkpoint or a state of one environment would fail silently on another. So
each carries the `Identity` of its environment. Some differences do not matter:
`ON_PLAYING` names those for a policy, `ON_STATE` those for a state of worlds. A
training run that continues allows none.
"""

import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError, canonicalize

import mujoco
import numpy as np

from collaborative_gym.errors import counted
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.task import Task

ON_PLAYING = ("name", "randomization", "max_episode_steps", "versions")
"""Settings that may differ when a policy plays: world and goal stay the same."""

ON_STATE = ("name",)
"""Settings that may differ between worlds that take each other's states."""

_EARLIER = {"action": "joints", "grasp": "magnet", "pad_force": False}
"""Settings of a time when there was no other choice."""


@dataclass(frozen=True)
class Identity:
    """What an environment is.

    Attributes:
      name: the environment id or task's name by which it was made.
      task: name of the task's class.
      robots: by agent, the arm's `name` and a `digest` of its value and model file.
      config: all settings as plain dictionaries, lists, numbers and texts.
      versions: of this package and of MuJoCo.
    """

    name: str
    task: str
    robots: Mapping[str, Mapping[str, str]]
    config: Mapping[str, Any]
    versions: Mapping[str, str]

    @classmethod
    def of(cls, task: Task) -> "Identity":
        """Return the identity of a task, here and now."""
        return cls(
            name=task.name,
            task=type(task).__name__,
            robots={
                agent: {
                    "name": robot.name,
                    "digest": _digest(robot, robot.model_file.stat().st_mtime_ns),
                }
                for agent, robot in task.robots.items()
            },
            config=_plain(task.config),
            versions={
                "collaborative_gym": version("collaborative-gym"),
                "mujoco": mujoco.__version__,
            },
        )

    @property
    def title(self) -> str:
        """Its name, for messages."""
        return f"{self.name} with {counted(self.robot_names)}"

    @property
    def robot_names(self) -> tuple[str, ...]:
        """The arms' names, in the order of the agents."""
        return tuple(robot["name"] for robot in self.robots.values())

    @property
    def action(self) -> str:
        """The name of its action mode."""
        return {**_EARLIER, **self.config}["action"]

    @property
    def grasp(self) -> str:
        """The name of its grasp."""
        return {**_EARLIER, **self.config}["grasp"]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain dictionaries, lists, numbers and texts."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Identity":
        """Return the identity that `to_dict` wrote.

        Raises:
          ValueError: if something is missing, or of another kind.
        """
        try:
            robots = {
                str(agent): {key: str(robot[key]) for key in ("name", "digest")}
                for agent, robot in content["robots"].items()
            }
            config, versions = dict(content["config"]), dict(content["versions"])
            name, task = str(content["name"]), str(content["task"])
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"this is not the identity of an environment: {error!r}"
            ) from None
        return cls(name, task, robots, config, versions)

    def with_team_of(self, other: "Identity") -> "Identity":
        """Return it with the robots of another one, if it has all of their kinds."""
        own = list(self.robots.values())
        if all(robot in own for robot in other.robots.values()):
            return replace(self, robots=other.robots)
        return self

    def differences(
        self, other: "Identity", *, ignore: Collection[str] = ()
    ) -> list[str]:
        """Return the differences, such as "pot_mass is 3.0, not None".

        Settings that only one of them has are not compared: a later version brought
        them. Without an action mode, it is joint changes; without a grasp, a magnet.

        Args:
          other: what this one should be.
          ignore: attributes and settings that may differ, such as `ON_PLAYING`.
        """
        found: list[str] = []
        if "name" not in ignore:
            found += _differing("environment", self.name, other.name)
        if self.task != other.task:
            # Settings of another task say nothing.
            return [*found, *_differing("task", self.task, other.task)]
        if self.robots.keys() != other.robots.keys():
            found += _differing("robots", self.robot_names, other.robot_names)
        else:
            for agent, robot in self.robots.items():
                wanted = other.robots[agent]
                if robot["name"] != wanted["name"]:
                    found.append(f"{agent} is {robot['name']}, not {wanted['name']}")
                elif robot != wanted:
                    found.append(f"{agent} is another arm of the name {robot['name']}")
        if self.robot_names != other.robot_names:
            # Other arms stand elsewhere, which says nothing more.
            ignore = {*ignore, "placements"}
        own, others = ({**_EARLIER, **each.config} for each in (self, other))
        own = {name: value for name, value in own.items() if name not in ignore}
        found += _differing("", own, others)
        if "versions" not in ignore:
            found += _differing("version of", self.versions, other.versions, " ")
        return found


def _differing(
    name: str, value: Any, wanted: Any, separator: str = "."
) -> Iterator[str]:
    """Yield a sentence for each number or text, at any depth, that differs."""
    if isinstance(value, Mapping) and isinstance(wanted, Mapping):
        for key in (key for key in value if key in wanted):
            inner = f"{name}{separator}{key}" if name else str(key)
            yield from _differing(inner, value[key], wanted[key], separator)
    elif value != wanted:
        yield f"{name} is {_short(value)}, not {_short(wanted)}"


def _short(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return str(float(f"{value:.6g}"))
    return json.dumps(value).replace("null", "None")


def _plain(value: Any) -> Any:
    """Return a setting as plain dictionaries, lists, numbers and texts."""
    if is_dataclass(value):
        return {each.name: _plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return getattr(value, "__qualname__", None) or str(value)


@lru_cache
def _digest(robot: Robot, changed: int) -> str:
    """Return a short digest that differs between arms of one name.

    It stays for as long as the model file was last `changed` at that time. Fields that
    are left at their defaults do not count, so that a new field changes nothing. What
    only people read in the model file does not count either.
    """
    content = {
        each.name: _plain(getattr(robot, each.name))
        for each in fields(robot)
        if each.init and getattr(robot, each.name) != each.default
    }
    for what_people_read in ("model_file", "title", "look"):
        content.pop(what_people_read, None)
    # Numbers that were filled in may differ by rounding on another machine.
    rounded = json.loads(json.dumps(content), parse_float=lambda x: f"{float(x):.6g}")
    text = json.dumps(rounded, sort_keys=True) + _model(robot.model_file)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _model(file: Path) -> str:
    """Return what MuJoCo reads in a model file, with what it includes in its place."""
    text = file.read_text()
    with suppress(ParseError):  # MuJoCo reads files that are not quite XML.
        text = canonicalize(text, strip_text=True)

    def included(found: re.Match[str]) -> str:
        return re.sub("^<.*?>|<[^>]*>$", "", _model(file.with_name(found[1])))

    return re.sub('<include file="(.*?)"></include>', included, text)
