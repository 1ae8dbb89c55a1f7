"""What a training run is started with, and whether it may go on with what is asked."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from collaborative_gym.errors import UnknownName, check_kind, unknown
from collaborative_gym.learning.config import Hyperparameters, Mode, recipe
from collaborative_gym.learning.seeds import training_seed
from collaborative_gym.learning.team import Sizes, make_learners
from collaborative_gym.rng import check_seed
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import Task

BACKENDS = ("skrl", "ray")

_MAY_CHANGE = {"total_steps", "validation_interval", "validation_episodes"}
"""Hyperparameters that a run may go on with another value of; steps only of more."""


@dataclass(frozen=True)
class Settings:
    """What a run was started with.

    Attributes:
      identity: of its environment.
      mode: who learns what.
      seed: of the run.
      backend: what collects.
      observation_sizes: by agent.
      action_sizes: by agent.
      hyperparameters: how it learns.
      partners: policies of the agents that do not learn.
    """

    identity: Identity
    mode: Mode
    seed: int
    backend: str
    observation_sizes: Mapping[str, int]
    action_sizes: Mapping[str, int]
    hyperparameters: Hyperparameters
    partners: Mapping[str, str] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Where the run goes unless told otherwise."""
        return Path("runs", f"{self.identity.name}-{self.mode}-seed{self.seed}")

    @property
    def title(self) -> str:
        """What to call the run."""
        robots = ", ".join(self.identity.robot_names)
        return f"{self.identity.name} ({robots}), {self.mode}, seed {self.seed}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain lists, dictionaries, numbers and texts."""
        content = asdict(self)
        sizes = content["hyperparameters"]["hidden_sizes"]
        content["hyperparameters"]["hidden_sizes"] = list(sizes)
        return content

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Settings":
        """Return what `to_dict` was made of."""
        identity = Identity.from_dict(content["identity"])
        hyperparameters = Hyperparameters(**content["hyperparameters"])
        own = {"identity": identity, "hyperparameters": hyperparameters}
        return cls(**{**content, **own})


def settle(
    task: Task,
    started: Settings | None,
    *,
    mode: Mode | None,
    seed: int | None,
    backend: str | None,
    hyperparameters: Hyperparameters | None,
    partners: Mapping[str, str] | None = None,
) -> Settings:
    """Return the settings of a run; what is None holds as it was, or as is usual.

    Args:
      task: what to learn.
      started: settings of a run to go on with, None for a new one.
      mode: who learns what.
      seed: of the run.
      backend: what collects.
      hyperparameters: how it learns.
      partners: policies of the agents that do not learn.

    Raises:
      KeyError: if there is no such agent.
      TypeError: if something is of another kind.
      ValueError: if something is unknown or out of range, the robots do not fit the
        mode, or a run cannot go on so; says what differs.
    """
    if hyperparameters is not None:
        kind = "cg.Hyperparameters(...), or left out for the environment's recipe"
        check_kind("hyperparameters", hyperparameters, Hyperparameters, kind)
    if started is not None:
        mode = started.mode if mode is None else mode
        seed = started.seed if seed is None else seed
        backend = started.backend if backend is None else backend
        hyperparameters = hyperparameters or started.hyperparameters
        partners = started.partners if partners is None else partners
    sizes = Sizes.of(task)
    settings = Settings(
        identity=Identity.of(task),
        mode="collaborative" if mode is None else mode,
        seed=check_seed(0 if seed is None else seed),
        backend="skrl" if backend is None else backend,
        observation_sizes=sizes.observation,
        action_sizes=sizes.action,
        hyperparameters=hyperparameters or recipe(task.name),
        partners=_checked_partners(partners or {}, task),
    )
    if settings.backend not in BACKENDS:
        raise ValueError(unknown("backend", settings.backend, BACKENDS))
    training_seed(settings.seed)
    make_learners(settings.mode, sizes.without(settings.partners))
    if started is not None:
        _check_same(settings, started)
    return settings


def _checked_partners(partners: Any, task: Task) -> dict[str, str]:
    """Return the partners; `load_policy` says whether there are such policies."""
    check_kind("partners", partners, Mapping, "a dictionary of policies by agent")
    for agent in partners:
        if agent not in task.agents:
            raise UnknownName(f"partners: {unknown('agent', agent, task.agents)}")
        check_kind(f"the partner {agent}", partners[agent], str, "a policy's name")
    if len(partners) == len(task.agents):
        raise ValueError(
            f"partners has a policy for each of {', '.join(partners)}, so that nobody"
            " learns; leave one out"
        )
    return dict(partners)


def _check_same(settings: Settings, started: Settings) -> None:
    """Raise unless a run that was started otherwise may go on with these settings."""
    found = settings.identity.differences(started.identity)
    for name in (
        "mode",
        "seed",
        "backend",
        "observation_sizes",
        "action_sizes",
        "partners",
    ):
        found += _differing(name, getattr(settings, name), getattr(started, name))
    own, asked = asdict(started.hyperparameters), asdict(settings.hyperparameters)
    for name, value in asked.items():
        is_lower = name == "total_steps" and value < own[name]
        if is_lower or name not in _MAY_CHANGE:
            found += _differing(name, value, own[name])
    if found:
        raise ValueError(
            f"this run cannot go on so: {'; '.join(found)}; leave out what differs to"
            " go on with it, or start another run"
        )


def _differing(name: str, given: object, kept: object) -> list[str]:
    return [] if given == kept else [f"{name} is {given}, not {kept}"]
