"""The choices of a viewer: environments, arms, policies and starts."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from urllib.parse import parse_qs, urlencode

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_count, look_up
from collaborative_gym.policies import AnyPolicy, as_played, as_policy, name_policy
from collaborative_gym.policies.policy import (
    SCRIPTED,
    SHIPPED,
    STATES,
    Policy,
    shipped_kinds,
)
from collaborative_gym.policies.scripted import STYLES
from collaborative_gym.rng import check_seed
from collaborative_gym.robots import Robot, list_robots
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import disturbed, get_env, list_envs, make_task
from collaborative_gym.tasks.task import Task

LINK = "/play/"
"""Beginning of the paths of links."""

_OWN = "own"
"""Name of the starts that the viewer was opened with, if they are no preset."""


@dataclass(frozen=True)
class Choice:
    """An episode and its policies, by names; arms and policies in the agents' order."""

    env: str
    robots: tuple[str, ...]
    policies: tuple[str, ...]
    randomization: str
    seed: int = 0
    episode: int = 0

    @property
    def title(self) -> str:
        """Environment and policies."""
        return f"{self.env}: {', '.join(dict.fromkeys(self.policies))}"

    @property
    def link(self) -> str:
        """Path of a page's address that opens this start."""
        return LINK + urlencode(vars(self), doseq=True)


class Menu:
    """The choices: those of the package, and the world and policies of a viewer.

    With `any_env`, trained policies may play other environments than their own.

    Attributes:
      envs, robots: names of the choices.
      tasks: the environments of each task, by its name.
    """

    def __init__(
        self,
        env: VectorEnv,
        policies: Mapping[str, AnyPolicy],
        *,
        any_env: bool = False,
    ):
        self._task, self._any_env = _without_states(env.task, policies), any_env
        self._policies: dict[str, Any] = {name: name for name in (*SCRIPTED, *STATES)}
        for policy in policies.values():
            self._policies[name_policy(policy)] = policy
        self._robots: dict[str, str | Robot] = {name: name for name in list_robots()}
        self._robots |= {robot.name: robot for robot in env.task.robots.values()}
        self.envs = tuple(dict.fromkeys([*list_envs(), env.task.name]))
        self.robots = tuple(self._robots)
        self.tasks: dict[str, list[str]] = {}
        for name in self.envs:
            task = get_env(name).task if name in list_envs() else type(env.task)
            self.tasks.setdefault(task.__name__, []).append(name)
        presets = self._task.randomizations.values()
        self._has_own = self._task.config.randomization not in presets
        self._settings = _changed(self._task)

    def randomizations(self, env: str) -> tuple[str, ...]:
        """Return the names of an environment's starts."""
        task = make_task(env) if env in list_envs() else self._task
        has_mishaps = type(task).mishap is not Task.mishap
        names = [n for n, s in task.randomizations.items() if has_mishaps or not s.lost]
        return *names, *[_OWN] * self._has_own

    def policies(self, choice: Choice) -> tuple[str, ...]:
        """Return the names of policies for the arms of a choice."""
        # A viewer that was started with shipped ones also goes where there are none.
        given = [name for name in self._policies if name not in SHIPPED]
        names = [*given, *self._styles(choice)]
        names[1:1] = self._shipped(choice)
        return tuple(dict.fromkeys(names))

    def chosen(self, env: VectorEnv, policies: Mapping[str, AnyPolicy]) -> Choice:
        """Return the choice that plays, by its world and the policy of each agent."""
        task = _without_states(env.task, policies)
        presets = task.randomizations.items()
        names = {value: name for name, value in presets}
        return Choice(
            env=env.task.name,
            robots=_arms(env.task),
            policies=tuple(name_policy(policies[agent]) for agent in env.agents),
            randomization=names.get(task.config.randomization, _OWN),
            seed=int(env.progress["seed"][0]),
            episode=int(min(env.progress["episode"])),
        )

    def moved(self, choice: Choice, env: str) -> Choice:
        """Return the choice of another environment, with its own arms.

        The same policies go on if they can play there, else the expert plays, and so do
        the same starts, else the usual ones.
        """
        starts = choice.randomization
        if starts not in self.randomizations(env):
            starts = "default"
        robots = self._usual(env)
        return self._able(replace(choice, env=env, robots=robots, randomization=starts))

    def turned(self, choice: Choice, task: str) -> Choice:
        """Return the choice of a task's first environment that these policies know."""
        helping = (n if n in SHIPPED else "expert" for n in choice.policies)
        same = replace(choice, policies=(*helping,))
        found = [self.moved(same, env) for env in self.tasks[task]]
        able = (own for own in found if {*own.policies} <= {*same.policies})
        return next(able, found[0])

    def drawn(self, choice: Choice, randomization: str) -> Choice:
        """Return the choice of other starts."""
        return replace(choice, randomization=randomization)

    def led(self, choice: Choice, policy: str, *agents: int) -> Choice:
        """Return the choice of another policy for agents, by their indices."""
        return replace(choice, policies=_put(choice.policies, policy, agents))

    def armed(self, choice: Choice, robot: str, *agents: int) -> Choice:
        """Return the choice of another arm for agents, by their indices.

        It is the task's environment with these arms, if there is one. The same policies
        go on if they can play with it; else the expert plays.
        """
        given = self._policies if self._any_env else ()
        robots = _put(choice.robots, robot, agents)
        alike = next(own for own in self.tasks.values() if choice.env in own)
        able = (env for env in (choice.env, *alike) if self._usual(env) == robots)
        env = next(able, choice.env)
        return self._able(replace(choice, env=env, robots=robots), given)

    def read(self, link: str) -> Choice:
        """Return the choice of a link; parts that it lacks are the usual ones.

        Raises:
          KeyError: if it names something else than a choice.
          ValueError: if it is not a link, or its numbers do not fit.
        """
        parts = parse_qs(link.removeprefix(LINK), strict_parsing=True)
        env = _one_of("environment", parts.get("env", [""])[0], self.envs)
        robots = tuple(
            _one_of("robot", name, self.robots)
            for name in parts.get("robots", self._usual(env))
        )
        drawn = parts.get("randomization", ["default"])[0]
        choice = Choice(
            env=env,
            robots=robots,
            policies=("expert",) * len(robots),
            randomization=_one_of("randomization", drawn, self.randomizations(env)),
            seed=check_seed(int(parts.get("seed", ["0"])[0])),
            episode=check_count("episode", int(parts.get("episode", ["0"])[0]), 0),
        )
        names, able = parts.get("policies", choice.policies), self.policies(choice)
        if len(names) == 1:
            names *= len(robots)
        if len(names) != len(robots):
            raise ValueError(
                f"the link names {len(names)} policies for {len(robots)} robots"
            )
        policies = tuple(_one_of("policy", name, able) for name in names)
        return replace(choice, policies=policies)

    def load(
        self, choice: Choice, env: VectorEnv
    ) -> tuple[VectorEnv, Policy, dict[str, AnyPolicy]]:
        """Return the world of a choice, its policy, and the policy of each agent.

        The world is `env`, the present one, where that is the one of the choice.

        Raises:
          Exception: as `make_vec` and `load_policy` do.
        """
        task = self._make(choice)
        given = [self._policies.get(name, name) for name in choice.policies]
        policies = dict(zip(task.agents, given, strict=True))
        task = as_played(task, policies)
        if Identity.of(task).differences(env.identity):
            env = VectorEnv(task, env.num_envs, num_threads=1, auto_reset=False)
        return env, as_policy(policies, env, any_env=self._any_env), policies

    def _make(self, choice: Choice) -> Task:
        own, starts = self._task, choice.randomization
        randomization = own.config.randomization
        presets = {**own.randomizations, _OWN: randomization}
        names = choice.env, choice.robots, presets.get(starts)
        if names == (own.name, _arms(own), randomization):
            return own
        robots = [self._robots[name] for name in choice.robots]
        drawn = randomization if starts == _OWN else starts
        make = partial(make_task, choice.env, robots, randomization=drawn)
        kept: dict[str, Any] = {}
        for name, value in self._settings.items():
            # What another task does not take, such as a grasp without grips, stays.
            with suppress(LookupError, TypeError, ValueError):
                make(**kept, **{name: value})
                kept[name] = value
        return make(**kept)

    def _able(self, choice: Choice, given: Iterable[str] = ()) -> Choice:
        """Return the choice with the expert for each policy that cannot play there.

        Policies of `given` can, besides the scripted and the shipped ones.
        """
        able = {*SCRIPTED, *STATES, *self._styles(choice), *given} - SHIPPED.keys()
        able.update(self._shipped(choice))
        names = [name if name in able else "expert" for name in choice.policies]
        names += names[:1] * len(choice.robots)
        return replace(choice, policies=tuple(names[: len(choice.robots)]))

    def _styles(self, choice: Choice) -> list[str]:
        # Not every environment has every kind of starts.
        task = self._make(replace(choice, randomization="default"))
        return [f"expert:{each}" for each in {**STYLES, **task.styles}]

    def _usual(self, env: str) -> tuple[str, ...]:
        return _arms(make_task(env) if env in list_envs() else self._task)

    def _shipped(self, choice: Choice) -> list[str]:
        playing = set()
        if (choice.env, choice.robots) == (self._task.name, _arms(self._task)):
            # Policies that play already may go on, shipped for this environment or not.
            playing = SHIPPED.keys() & self._policies.keys()
        if choice.robots == self._usual(choice.env):
            playing.update(shipped_kinds(choice.env))
        return [kind for kind in SHIPPED if kind in playing]


def _changed(task: Task) -> dict[str, Any]:
    """Return the settings of a task that are not those of its name, but its starts."""
    usual = type(task.config)()
    with suppress(LookupError):  # A task of the user's may have no name to make it by.
        usual = make_task(task.name, list(task.robots.values())).config
    changed = {n: v for n, v in vars(task.config).items() if v != getattr(usual, n)}
    return {name: own for name, own in changed.items() if name != "randomization"}


def _without_states(task: Task, policies: Mapping[str, AnyPolicy]) -> Task:
    """Return a task without the limp and absent arms that its policies ask for."""
    starts = task.config.randomization
    kept = {s: [a for a in getattr(starts, s) if policies.get(a) != s] for s in STATES}
    return disturbed(task, **kept)


def _put(names: tuple[str, ...], name: str, at: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(name if i in at else old for i, old in enumerate(names))


def _arms(task: Task) -> tuple[str, ...]:
    return tuple(robot.name for robot in task.robots.values())


def _one_of(kind: str, given: str, names: tuple[str, ...]) -> str:
    return look_up(kind, given, dict(zip(names, names, strict=True)))
