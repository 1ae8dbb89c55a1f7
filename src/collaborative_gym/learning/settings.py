"""What a run is started with, and whether it may continue with what is asked."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from collaborative_gym.blocks import Layout
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.envs.world import World
from collaborative_gym.errors import check_kind, check_name, unknown
from collaborative_gym.learning.casting import (
    LEAGUE,
    POPULATION,
    SELF,
    Casting,
    make_casting,
)
from collaborative_gym.learning.config import (
    Algorithm,
    Hyperparameters,
    Mode,
    changed,
    foreign,
    recipe,
)
from collaborative_gym.learning.pool import read_guests
from collaborative_gym.learning.team import Learner, make_learners
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import read_policy
from collaborative_gym.rng import check_run_seed
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import Task, TaskConfig

BACKENDS = ("skrl", "ray")

Named = str | Path | Sequence[str | Path] | Mapping[str, str | Path]
"""Names of policies, or of one for each of some seats."""

_MAY_CHANGE = {"total_steps", "validation_interval", "validation_episodes"}
"""Hyperparameters that a run may change when it continues; steps may only grow."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a run was started with.

    Attributes:
      identity: of its environment.
      algorithm: what learns.
      mode: who learns what.
      seed: of the run.
      backend: what collects.
      layout: of observations and actions.
      hyperparameters: how it learns.
      opponents: who plays against what is learned, as `make_casting` knows them.
      partners: who plays with it.
      start_from: the policy with which it began, as it was named; nothing for networks
        drawn by chance.
      start: that policy's `digest`, the `environment` and `randomization` in which it
        was trained, and how, its `metadata`.
    """

    identity: Identity
    algorithm: Algorithm = "ppo"
    mode: Mode
    seed: int
    backend: str
    layout: Layout
    hyperparameters: Hyperparameters
    opponents: tuple[str, ...] = ()
    partners: tuple[str, ...] = ()
    start_from: str = ""
    start: Mapping[str, Any] = field(default_factory=dict)

    def casting(self, task: Task) -> Casting:
        """Return who sits where in the run's worlds."""
        return make_casting(
            task,
            self.opponents,
            self.partners,
            hyperparameters=self.hyperparameters,
        )

    def learners(self, task: Task) -> tuple[Learner, ...]:
        """Return the learners of all members.

        Raises:
          ValueError: if the robots do not fit the mode.
        """
        casting = self.casting(task)
        return tuple(
            learner
            for member in casting.members
            for learner in make_learners(
                self.mode,
                self.layout,
                task.sides,
                seats=casting.learned(member) or None,
                member=member,
            )
        )

    @property
    def folder(self) -> Path:
        """Where the run goes unless told otherwise."""
        words = [self.identity.name, *self._kind, self.mode, f"seed{self.seed}"]
        return Path("runs", "-".join(words))

    @property
    def title(self) -> str:
        """What to call the run."""
        robots = ", ".join(self.identity.robot_names)
        words = [*self._kind, self.mode, f"seed {self.seed}"]
        return f"{self.identity.name} ({robots}), {', '.join(words)}"

    @property
    def _kind(self) -> list[str]:
        """What to call actions, algorithm and others that are not the usual."""
        words = set(self.opponents or self.partners) - {SELF}
        known = [word for word in (LEAGUE, POPULATION) if word in words]
        pairs = (self.identity.action, TaskConfig.action), (self.algorithm, "ppo")
        own = [own for own, usual in pairs if own != usual]
        return own + (known or (["guests"] if words else []))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain lists, dictionaries, numbers and texts."""
        content = asdict(self) | {"layout": self.layout.to_dict()}
        sizes = content["hyperparameters"]["hidden_sizes"]
        content["hyperparameters"]["hidden_sizes"] = list(sizes)
        for name in ("opponents", "partners"):
            content[name] = list(content[name])
        return content

    def how(self) -> dict[str, Any]:
        """Return what it says of training, and not of the environment."""
        world = "identity", "layout"
        return {n: own for n, own in self.to_dict().items() if n not in world}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Settings":
        """Return what `to_dict` was made of."""
        identity = Identity.from_dict(content["identity"])
        hyperparameters = Hyperparameters(**content["hyperparameters"])
        own = {"identity": identity, "hyperparameters": hyperparameters}
        own["layout"] = Layout.from_dict(content["layout"])
        for name in ("opponents", "partners"):
            own[name] = tuple(content.get(name, ()))
        return cls(**{**content, **own})


def settle(
    task: Task,
    started: Settings | None,
    *,
    mode: Mode | None,
    seed: int | None,
    backend: str | None,
    hyperparameters: Hyperparameters | None,
    opponent: Named | None = None,
    partner: Named | None = None,
    start_from: str | Path | None = None,
    algorithm: Algorithm | None = None,
) -> Settings:
    """Return the settings of a run; what is None stays as it was, or is as usual.

    Args:
      task: what to learn.
      started: settings of a run to continue, None for a new one.
      mode: who learns what.
      seed: of the run.
      backend: what collects.
      hyperparameters: how it learns.
      opponent: who plays against what is learned.
      partner: who plays with it.
      start_from: a policy to begin with.
      algorithm: what learns.

    Raises:
      FileNotFoundError: if there is no such policy.
      KeyError: if there is no such policy, seat or algorithm.
      TypeError: if something is of another kind.
      ValueError: if something is unknown or out of range, the robots do not fit the
        mode, or a run cannot go on with other settings; says what differs.
    """
    if hyperparameters is not None:
        kind = "cg.Hyperparameters(...), or left out for the environment's recipe"
        check_kind("hyperparameters", hyperparameters, Hyperparameters, kind)
    if started is not None:
        mode = started.mode if mode is None else mode
        seed = started.seed if seed is None else seed
        algorithm = started.algorithm if algorithm is None else algorithm
        backend = started.backend if backend is None else backend
        hyperparameters = hyperparameters or started.hyperparameters
        opponent = started.opponents if opponent is None else opponent
        partner = started.partners if partner is None else partner
        start_from = (started.start_from or None) if start_from is None else start_from
    layout = World.of(task, strain=True).definition.layout
    opponents, partners = _words("opponent", opponent), _words("partner", partner)
    if len(task.sides) > 1:
        opponents = opponents or (SELF,)
    algorithm = "ppo" if algorithm is None else algorithm
    usual = recipe(task.name, algorithm)
    settings = Settings(
        identity=Identity.of(task),
        mode=_usual_mode(layout, opponents) if mode is None else mode,
        seed=check_run_seed(0 if seed is None else seed),
        backend="skrl" if backend is None else backend,
        layout=layout,
        hyperparameters=hyperparameters or usual,
        opponents=opponents,
        partners=partners,
        start_from=_name(start_from),
        start={} if started is None else started.start,
        algorithm=algorithm,
    )
    if settings.backend not in BACKENDS:
        raise ValueError(unknown("backend", settings.backend, BACKENDS))
    _check_seats(settings, task)
    if started is not None:
        _check_same(settings, started)
    else:
        _check_company(settings)
        if settings.start_from:
            settings = replace(settings, start=_start(first_policy(settings, task)))
    _check_algorithm(algorithm, settings.hyperparameters)
    return settings


def _start(first: NetworkPolicy) -> dict[str, Any]:
    """Return what a run remembers of the policy that it begins with."""
    return {
        "digest": first.digest,
        "environment": first.identity.name,
        "randomization": first.identity.config["randomization"],
        "metadata": first.metadata,
    }


def first_policy(settings: Settings, task: Task) -> NetworkPolicy:
    """Return the policy that a run begins with.

    It may be for another environment, if its networks have the sizes of those that are
    to learn.

    Raises:
      FileNotFoundError: if there is no such file.
      KeyError: if there is no such policy.
      ValueError: if it is not a trained policy, or its networks differ from the run's.
    """
    with closing(VectorEnv(task, 1, num_threads=1, strain=True)) as env:
        policy = read_policy(settings.start_from, env)
    if not isinstance(policy, NetworkPolicy):
        raise ValueError(
            f"start_from must be a trained policy, got {settings.start_from!r}; give"
            " 'baseline', a policy file or the folder of a training run"
        )
    numbers = settings.hyperparameters
    wanted: dict[str, tuple[int, ...]] = {}
    for learner in settings.learners(task):
        for name, (inputs, outputs) in learner.networks(settings.layout).items():
            wanted[name] = inputs, *numbers.hidden_sizes, outputs
    found = {name: each.sizes for name, each in policy.weights.items()}
    differences = [
        f"{name} has layers of {found.get(name, 'nothing')}, not {own}"
        for name, own in wanted.items()
        if found.get(name) != own
    ]
    if policy.activation != numbers.activation:
        differences.append(f"its activation is {policy.activation}")
    if differences:
        raise ValueError(
            f"this run cannot start from {settings.start_from}:"
            f" {'; '.join(differences)}. Choose the mode, hidden_sizes and activation"
            " with which that policy was trained, and spaces of the same sizes"
        )
    return policy


def _name(start_from: str | Path | None) -> str:
    if start_from is None:
        return ""
    check_kind("start_from", start_from, (str, Path), "a policy's name")
    check_name("start_from", str(start_from))
    return str(start_from)


def _words(name: str, given: Any) -> tuple[str, ...]:
    """Return what names opponents or partners as a tuple of words."""
    if given is None:
        return ()
    if isinstance(given, str | Path):
        given = [given]
    a = "a policy's name, several, or one for each of some seats"
    check_kind(name, given, (Sequence, Mapping), a)
    if isinstance(given, Mapping):
        for seat, policy in given.items():
            check_kind(f"each seat of {name}", seat, str, "a string")
            check_kind(f"the {name} {seat}", policy, (str, Path), "a policy's name")
        given = [f"{seat}={policy}" for seat, policy in given.items()]
    for word in given:
        check_kind(f"each {name}", word, (str, Path), "a policy's name")
    words = tuple(str(word) for word in given)
    for word in words:
        check_name(name, word)
        if words.count(word) > 1:
            raise ValueError(f"{name} names {word} twice; name each policy once")
    return words


def _usual_mode(layout: Layout, opponents: Sequence[str]) -> Mode:
    """Return the mode if none is asked for.

    Robots that are alike learn in both seats of the games with guests.
    """
    alike = all(
        len(set(sizes.values())) == 1
        for sizes in (layout.observation_sizes, layout.action_sizes)
    )
    return "shared" if alike and set(opponents) - {SELF} else "collaborative"


def _check_seats(settings: Settings, task: Task) -> None:
    """Raise unless somebody can learn in every seat that shall learn."""
    if settings.algorithm == "sac" and (settings.opponents or settings.partners):
        raise ValueError(
            "sac forgets slowly what former opponents and partners did, and was"
            " not tried with them; choose the algorithm ppo, or a task of one side"
            " without partner"
        )
    settings.learners(task)
    casting = settings.casting(task)
    by_turns = len(task.sides) == 1 and len(casting.learned(casting.members[0])) > 1
    if settings.mode == "centralized" and by_turns:
        raise ValueError(
            "in the mode centralized one network commands all robots, so that there is"
            " no seat for a partner; choose collaborative, independent or shared"
        )
    casting.check(settings.hyperparameters.num_envs)
    read_guests(task, casting, settings.opponents or settings.partners)


def _check_algorithm(algorithm: str, hyperparameters: Hyperparameters) -> None:
    """Raise unless all that is given means something to the algorithm."""
    unknown = [n for n in changed(hyperparameters) if n in foreign(algorithm)]
    if unknown:
        raise ValueError(
            f"{algorithm} knows no {' or '.join(unknown)}; leave out what another"
            " algorithm alone uses"
        )


def _check_company(settings: Settings) -> None:
    """Raise if numbers of a league or of a population are given without one."""
    company = settings.opponents + settings.partners
    given = changed(settings.hyperparameters)
    for option, word in (("opponent", LEAGUE), ("partner", POPULATION)):
        own = [name for name in given if name.startswith(word)]
        if own and word not in company:
            raise ValueError(
                f"{' and '.join(own)} would mean nothing without --{option} {word};"
                " give that too, or leave out these numbers"
            )


def _check_same(settings: Settings, started: Settings) -> None:
    """Raise unless a run that was started otherwise may continue with these."""
    found = settings.identity.differences(started.identity)
    found += settings.layout.differences(started.layout, settings.layout.observation)
    for name in sorted(
        vars(settings).keys() - {"identity", "layout", "hyperparameters", "start"}
    ):
        found += _differing(name, getattr(settings, name), getattr(started, name))
    own, asked = asdict(started.hyperparameters), asdict(settings.hyperparameters)
    for name, value in asked.items():
        is_lower = name == "total_steps" and value < own[name]
        if is_lower or name not in _MAY_CHANGE:
            found += _differing(name, value, own[name])
    if found:
        raise ValueError(
            f"this run cannot continue with other settings: {'; '.join(found)}; leave"
            " out what differs, or start another run with another output"
        )


def _differing(name: str, given: object, kept: object) -> list[str]:
    return [] if given == kept else [f"{name} is {given}, not {kept}"]
