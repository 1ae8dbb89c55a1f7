"""The settings of a run, and whether it may continue with others."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypedDict

from collaborative_gym import errors
from collaborative_gym.blocks import Layout
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.envs.world import World
from collaborative_gym.learning.casting import (
    LEAGUE,
    POPULATION,
    SELF,
    Casting,
    make_casting,
)
from collaborative_gym.learning.config import (
    ELEMENT_SIZES,
    Algorithm,
    Hyperparameters,
    Mode,
    Network,
    Resources,
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
from collaborative_gym.tasks.registry import disturbed, resized
from collaborative_gym.tasks.task import Task, TaskConfig

BACKENDS = ("skrl", "ray")

Named = str | Path | Sequence[str | Path] | Mapping[str, str | Path]
"""Names of policies, or of one for each of some seats."""

_MAY_CHANGE = {"total_steps", "validation_interval", "validation_episodes"}
"""Hyperparameters that a run may change when it continues; steps may only grow."""


class Options(TypedDict, total=False):
    """The keywords that `train` and `train_all` share; each may be left out, or None.

    Attributes:
      opponent: who plays against the learner, if there are several sides. "self", or
        None: self-play of the latest policies. Names of policies, as `load_policy`
        knows them: each episode draws one, and the learner plays every side in turn; or
        only the other side, as with `{"side_2": "expert"}`. "league": a league; in a
        sequence, names of policies may follow, against which the league plays, too.
      partner: who plays with the learner, if there is one side. Names of policies: each
        episode draws one, and the learner plays the other robots in turn; or only the
        other robots, as with `{"robot_2": "idle"}`. "population": several policies for
        each robot learn, and all pairs of them play.
      start_from: a trained policy to begin with, as `load_policy` knows it, instead of
        random networks. It may come from another environment with spaces of the same
        sizes. Its noise begins anew with `initial_std`, and only the critics learn
        during the first rollouts.
      backend: "skrl", or "ray" to collect in several processes; None for "skrl".
      algorithm: "ppo" (also by None), or "sac" for one side without partners.
      resources: device and threads of each run.
      checkpoint_interval: environment steps between two checkpoints (100,000).
    """

    opponent: Named | None
    partner: Named | None
    start_from: str | Path | None
    backend: str | None
    algorithm: Algorithm | None
    resources: Resources | None
    checkpoint_interval: int


def take_interval(options: Options) -> int:
    """Take the interval of checkpoints out of options, and return it.

    Raises:
      TypeError: if it is no integer, or there is a keyword that `Options` lacks.
      ValueError: if it is below 1.
    """
    names = Options.__annotations__
    for name in options:
        if name not in names:
            raise errors.UnknownOption(
                f"got an unexpected keyword argument {name!r};"
                f" {errors.unknown('option', name, names)}; hyperparameters, such as"
                " total_steps, come in hyperparameters=cg.Hyperparameters(...)"
            )
    interval = options.pop("checkpoint_interval", 100_000)
    return errors.check_count("checkpoint_interval", interval, at_least=1)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings with which a run was started.

    Attributes:
      identity: of its environment.
      algorithm: "ppo" or "sac".
      mode: which policies and critics learn.
      seed: the run's seed.
      backend: "skrl", or "ray".
      layout: of observations and actions.
      hyperparameters: how it learns.
      opponents: who plays against the learner, as `make_casting` knows them.
      partners: who plays with it.
      start_from: the name of the policy with which it began; empty for random networks.
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
            task, self.opponents, self.partners, hyperparameters=self.hyperparameters
        )

    def learners(self, task: Task) -> tuple[Learner, ...]:
        """Return the learners of all members, in the task or in another team of it.

        Raises:
          ValueError: if the robots do not fit the mode.
        """
        casting, network = self.casting(task), self.hyperparameters.network
        layout = World.of(task, strain=True).definition.layout
        found: list[Learner] = []
        for member in casting.members:
            seats = casting.learned(member) or None
            how = {"seats": seats, "member": member, "network": network}
            found += make_learners(self.mode, layout, task.sides, **how)
        return tuple(found)

    @property
    def folder(self) -> Path:
        """The run's folder unless another one is given."""
        words = [self.identity.name, *self._kind, self.mode, f"seed{self.seed}"]
        return Path("runs", "-".join(words))

    @property
    def title(self) -> str:
        """The heading of the run's pictures."""
        robots = ", ".join(self.identity.robot_names)
        words = [*self._kind, self.mode, f"seed {self.seed}"]
        return f"{self.identity.name} ({robots}), {', '.join(words)}"

    @property
    def _kind(self) -> list[str]:
        """The action mode, grasp, algorithm and company that are not the usual ones."""
        words = set(self.opponents or self.partners) - {SELF}
        known = [word for word in (LEAGUE, POPULATION) if word in words]
        usual = TaskConfig.action, TaskConfig.grasp, "ppo"
        own = self.identity.action, self.identity.grasp, self.algorithm
        own = [a for a, b in zip(own, usual, strict=True) if a != b]
        return own + (known or ["guests"] * bool(words))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain lists, dictionaries, numbers and texts."""
        content = asdict(self) | {"layout": self.layout.to_dict()}
        numbers = content["hyperparameters"]
        for name in ("hidden_sizes", "team_sizes"):
            numbers[name] = list(numbers[name])
        lists = {name: list(content[name]) for name in ("opponents", "partners")}
        return content | lists

    def how(self) -> dict[str, Any]:
        """Return the plain settings of training alone, without the environment."""
        world = "identity", "layout"
        return {n: own for n, own in self.to_dict().items() if n not in world}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Settings":
        """Return the settings that `to_dict` wrote."""
        own = {
            "identity": Identity.from_dict(content["identity"]),
            "hyperparameters": Hyperparameters(**content["hyperparameters"]),
            "layout": Layout.from_dict(content["layout"]),
            "opponents": tuple(content.get("opponents", ())),
            "partners": tuple(content.get("partners", ())),
        }
        return cls(**{**content, **own})


def make_settings(
    task: Task, started: Settings | None = None, **asked: Any
) -> Settings:
    """Return the settings of a run: those asked for, else kept, else the usual ones.

    Args:
      task: what to learn.
      started: settings of a run to continue, None for a new one.
      asked: `mode`, `seed`, `hyperparameters`, `opponent`, `partner`, `start_from`,
        `backend` and `algorithm`, as `train` takes them.

    Raises:
      FileNotFoundError: if there is no such policy.
      KeyError: if there is no such policy, seat or algorithm.
      TypeError: if something is of another kind.
      ValueError: if something is unknown or out of range, the robots do not fit the
        mode, or a run cannot go on with other settings; says what differs.
    """
    asked = _plain({n: value for n, value in asked.items() if value is not None})
    kept = {} if started is None else vars(started)
    asked = {"algorithm": "ppo", "seed": 0, "backend": "skrl"} | kept | asked
    if len(task.sides) > 1:
        asked["opponents"] = asked.get("opponents") or (SELF,)
    layout = World.of(task, strain=True).definition.layout
    usual = recipe(task.name, asked["algorithm"])
    asked["hyperparameters"] = asked.get("hyperparameters", usual)
    if "mode" not in asked:
        asked["mode"] = _usual_mode(
            layout, asked.get("opponents", ()), asked["hyperparameters"].network
        )
    asked["seed"] = check_run_seed(asked["seed"])
    settings = Settings(**asked | {"identity": Identity.of(task), "layout": layout})
    if settings.backend not in BACKENDS:
        raise ValueError(errors.unknown("backend", settings.backend, BACKENDS))
    _check_seats(settings, task)
    numbers = changed(settings.hyperparameters)
    if started is not None:
        _check_same(settings, started)
    else:
        check_company(numbers, settings.opponents, settings.partners)
        if settings.start_from:
            start = _remembered(first_policy(settings, task))
            settings = replace(settings, start=start)
    unused = [name for name in numbers if name in foreign(settings.algorithm)]
    if unused:
        raise ValueError(
            f"{settings.algorithm} knows no {' or '.join(unused)}; leave out"
            " what only another algorithm uses"
        )
    return settings


def _plain(asked: dict[str, Any]) -> dict[str, Any]:
    if "hyperparameters" in asked:
        kind = "cg.Hyperparameters(...), or left out for the environment's recipe"
        given = asked["hyperparameters"]
        errors.check_kind("hyperparameters", given, Hyperparameters, kind)
    for name in ("opponent", "partner"):
        if name in asked:
            asked[f"{name}s"] = _words(name, asked.pop(name))
    if "start_from" in asked:
        errors.check_kind(
            "start_from", asked["start_from"], (str, Path), "a policy's name"
        )
        asked["start_from"] = str(asked["start_from"])
        errors.check_name("start_from", asked["start_from"])
    return asked


def _remembered(first: NetworkPolicy) -> dict[str, Any]:
    return {
        "digest": first.digest,
        "environment": first.identity.name,
        "randomization": first.identity.config["randomization"],
        "metadata": first.metadata,
    }


def first_policy(settings: Settings, task: Task) -> NetworkPolicy:
    """Return the policy that a run begins with.

    It may be for another environment, if its networks have the sizes of those to learn.

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
    found = {name: each.sizes for name, each in policy.weights.items()}
    hidden = (*ELEMENT_SIZES * (numbers.network == "set"), *numbers.hidden_sizes)
    wanted = {
        name: (inputs, *hidden, outputs)
        for learner in settings.learners(task)
        for name, (inputs, outputs) in learner.networks(settings.layout).items()
    }
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
            f" {'; '.join(differences)}. Choose the mode, network, hidden sizes and"
            " activation with which that policy was trained, and spaces of equal sizes"
        )
    return policy


def _words(name: str, given: Any) -> tuple[str, ...]:
    if isinstance(given, str | Path):
        given = [given]
    a = "a policy's name, several, or one for each of some seats"
    errors.check_kind(name, given, (Sequence, Mapping), a)
    if isinstance(given, Mapping):
        for seat, policy in given.items():
            errors.check_kind(f"each seat of {name}", seat, str, "a string")
            errors.check_kind(
                f"the {name} {seat}", policy, (str, Path), "a policy's name"
            )
        given = [f"{seat}={policy}" for seat, policy in given.items()]
    words = []
    for word in given:
        errors.check_kind(f"each {name}", word, (str, Path), "a policy's name")
        errors.check_name(name, str(word))
        if str(word) in words:
            raise ValueError(f"{name} names {word} twice; name each policy once")
        words.append(str(word))
    return tuple(words)


def _usual_mode(layout: Layout, opponents: Sequence[str], network: Network) -> Mode:
    """Return the mode if none is asked for.

    Robots that are alike learn in both seats of the games with guests, and one policy
    for teams of any size.
    """
    alike = all(
        len(set(sizes.values())) == 1
        for sizes in (layout.observation_sizes, layout.action_sizes)
    )
    has_reason = network == "set" or set(opponents) - {SELF}
    return "shared" if alike and has_reason else "collaborative"


def _check_seats(settings: Settings, task: Task) -> None:
    """Raise unless somebody can learn in every seat that shall learn."""
    if settings.algorithm == "sac" and (settings.opponents or settings.partners):
        raise ValueError(
            "sac forgets slowly what former opponents and partners did, and was"
            " not tried with them; choose the algorithm ppo, or a task of one side"
            " without partner"
        )
    if settings.algorithm == "sac" and settings.hyperparameters.network == "set":
        raise ValueError(
            "sac has no critics of sets; choose the algorithm ppo, or network=flat"
        )
    if settings.hyperparameters.mishaps:
        disturbed(task, lost=1.0)  # Refused by tasks without mishaps.
    settings.learners(task)
    if settings.hyperparameters.team_sizes:
        _check_teams(settings, task)
    casting = settings.casting(task)
    by_turns = len(task.sides) == 1 and len(casting.learned(casting.members[0])) > 1
    if settings.mode == "centralized" and by_turns:
        raise ValueError(
            "in the mode centralized one network commands all robots, so that there is"
            " no seat for a partner; choose collaborative, independent or shared"
        )
    casting.check(settings.hyperparameters.num_envs)
    read_guests(task, casting, settings.opponents or settings.partners)


def _check_teams(settings: Settings, task: Task) -> None:
    """Raise unless one policy can learn in teams of several sizes at once."""
    numbers = settings.hyperparameters
    others = settings.opponents or settings.partners or settings.backend == "ray"
    if settings.mode != "shared" or numbers.network != "set" or others:
        raise ValueError(
            "team_sizes are for one policy of any team: give --network set and the mode"
            " shared, and neither partners, opponents nor Ray"
        )
    for count in numbers.team_sizes:
        resized(task, count)


def check_company(
    numbers: Iterable[str], opponents: Sequence[str], partners: Sequence[str]
) -> None:
    """Raise if numbers of a league or of a population are given without one."""
    pairs = ("opponent", LEAGUE, opponents), ("partner", POPULATION, partners)
    for option, word, given in pairs:
        own = [name for name in numbers if name.startswith(word)]
        if own and word not in given:
            raise ValueError(
                f"{' and '.join(own)} would mean nothing without --{option} {word};"
                " give that too, or leave out these numbers"
            )


def _check_same(settings: Settings, started: Settings) -> None:
    found = settings.identity.differences(started.identity)
    if not found:  # Another task has other blocks.
        own = settings.layout
        found = own.differences(started.layout, own.observation)
    apart = {"identity", "layout", "hyperparameters", "start"}
    pairs = [
        (name, getattr(settings, name), getattr(started, name))
        for name in sorted(vars(settings).keys() - apart)
    ]
    own = vars(started.hyperparameters)
    for name, value in vars(settings.hyperparameters).items():
        is_lower = name == "total_steps" and value < own[name]
        if is_lower or name not in _MAY_CHANGE:
            pairs.append((name, value, own[name]))
    found += [f"{n} is {a}, not {b}" for n, a, b in pairs if a != b]
    if found:
        raise ValueError(
            f"this run cannot continue with other settings: {'; '.join(found)}; leave"
            " out what differs (total_steps may be raised), or give another output"
        )
