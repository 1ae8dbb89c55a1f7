"""The command that trains."""

import inspect
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from collaborative_gym.cli.terminal import Envs, Folder, Worlds, show
from collaborative_gym.errors import check_count
from collaborative_gym.learning.config import (
    Algorithm,
    Hyperparameters,
    Mode,
    Resources,
    recipe,
)
from collaborative_gym.tasks.task import Task

if TYPE_CHECKING:
    from collaborative_gym.learning.many import Outcome
    from collaborative_gym.learning.settings import Options

_Own = tyro.conf.arg(help_behavior_hint="")
"""An option whose help says by itself what holds if it is not given."""

_MOST_SEEDS = 10_000
"""More runs of one kind than anybody trains."""

_SUBJECTS = {
    "device": "The machine",
    "total_steps": "Length, and sizes of batches",
    "discount": "Learning",
    "replay_size": "SAC alone",
    "initial_std": "Action noise, and grips",
    "assistance": "Assistance, and penalties",
    "imitation": "The expert's advice, and mishaps in training",
    "population": "Populations and leagues",
    "hidden_sizes": "Networks and validations",
}
"""What a hyperparameter and those after it are about."""

_Flat = tyro.conf.arg(name="")


class _NotGiven:
    """Marks the value of an option that the command line does not have."""


def _not_given() -> Hyperparameters:
    """Return the defaults, marked, because asking for a default overrules a recipe."""
    marked = {}
    for option in fields(Hyperparameters):
        kind = type(option.default)
        mark: Any = type(kind.__name__, (_NotGiven, kind), {})
        marked[option.name] = mark(option.default)
    return Hyperparameters(**marked)


@dataclass(frozen=True, kw_only=True)
class Train(Worlds):
    """Train policies by PPO or SAC; stop at any time and continue with --resume.

    The folder of a run holds policy.safetensors, the best policy so far, which
    evaluate, record and view play by the folder's name; progress.csv, curve.png,
    TensorBoard's events, and checkpoints. A run lasts --total-steps. Hyperparameters
    are those of the environment's recipe, or else the defaults that --help-all shows.

    Attributes:
      envs: environment ids, or tasks' names; with --resume that of the run.
      help_all: like --help, then what each hyperparameter does, by subject.
      all: train the baselines of all environments, or of those named, each with
        several seeds, and write their cards; continues the runs that exist already.
      modes: train in each of these; see --mode.
      jobs: how many runs train at a time, each in a process of its own with one physics
        thread (default: one per CPU). Ctrl-C ends all of them, and the same command
        continues them.
      mode: who learns what. collaborative (MAPPO, default): a policy for each robot and
        one critic that sees all observations; independent (IPPO): a policy and a critic
        for each; shared: one policy and critic for robots with equal spaces (default
        for such robots against given policies and in a league); centralized: one policy
        for all robots. For several modes see --modes.
      seed: seed of the run (default: 0); for several seeds see --seeds.
      seeds: seeds of several runs, such as 0 1 2 or 0-9: a run for each seed in each
        environment and mode; with --all for each baseline (default: 0 1 2).
      output: folder of a new run (default: runs/ENV-MODE-seedS, before the mode also
        league, population or guests); the folder of all of several runs (default:
        runs), or of all baselines (default: runs/baselines).
      resume: folder of a run to continue, with the options that it was started with.
      opponent: who plays against the learner, if a task has several sides. The default
        is self, self-play: the latest policies play all sides. If you name policies, as
        in evaluate, each episode draws one of them; side_2=POLICY plays only that side.
        league trains exploiters too, and keeps former versions; policies may follow the
        word.
      partner: who plays with the learner, if a task has one side; by default the latest
        policies (self-play). If you name policies, each episode draws one of them, and
        the learner plays the other robots; robot_2=POLICY plays only that robot. With
        population, several policies for each robot learn, and all pairs of them play.
      start_from: trained policy to begin with, named as in evaluate, instead of random
        networks. It may come from another environment with spaces of the same sizes.
      backend: skrl (default), or ray to collect in several processes or machines.
      algorithm: ppo (default), or sac for tasks of one side and without partners.
      advised: learn with the scripted expert's advice, by hyperparameters that suit it,
        which you can still change; --imitation is their main one.
      checkpoint_interval: environment steps between two checkpoints.
      resources: what the run may use.
      hyperparameters: how it learns.
    """

    envs: Envs = ()
    help_all: tyro.conf.FlagCreatePairsOff[bool] = False
    all: tyro.conf.FlagCreatePairsOff[bool] = False
    mode: Annotated[Mode | None, tyro.conf.arg(metavar="MODE"), _Own] = None
    seed: Annotated[int | None, tyro.conf.arg(metavar="INT"), _Own] = None
    seeds: Annotated[tuple[str, ...], tyro.conf.arg(metavar="INT | A-B ..."), _Own] = ()
    modes: Annotated[tuple[Mode, ...], tyro.conf.arg(metavar="MODE ..."), _Own] = ()
    jobs: Annotated[int | None, tyro.conf.arg(metavar="INT"), _Own] = None
    output: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER"), _Own] = None
    resume: Folder = None
    randomization: Annotated[str | None, tyro.conf.arg(metavar="PRESET"), _Own] = None
    opponent: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WHO ..."), _Own] = ()
    partner: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WHO ..."), _Own] = ()
    start_from: Annotated[str | None, tyro.conf.arg(metavar="POLICY"), _Own] = None
    backend: Annotated[str | None, tyro.conf.arg(metavar="NAME"), _Own] = None
    algorithm: Annotated[Algorithm | None, tyro.conf.arg(metavar="NAME"), _Own] = None
    advised: tyro.conf.FlagCreatePairsOff[bool] = False
    checkpoint_interval: int = 100_000
    resources: Annotated[Resources, _Flat] = field(default_factory=Resources)
    hyperparameters: Annotated[Hyperparameters, _Flat] = field(
        default_factory=_not_given
    )

    def run(self) -> None:
        """Train, showing how it goes."""
        check_count("jobs", self.jobs or 0)
        if self.all:
            self._train_all()
            return
        if len(self.envs) > 1 or self.modes or self.seeds or self.jobs is not None:
            self._train_several()
            return
        from collaborative_gym.learning.train import train

        env, hyperparameters = self._what()
        result = train(
            self._task(env),
            self.mode,
            seed=self.seed,
            output=self.output,
            resume=self.resume,
            hyperparameters=hyperparameters,
            progress=True,
            **self._options(),
        )
        total, update = hyperparameters.total_steps, hyperparameters.steps_per_update
        trained = math.ceil(total / update) * update
        if trained > 1.01 * total:
            show(
                f"trained {trained:,} steps, not {total:,}: an update takes {update:,}"
                " steps, which are --num-envs times --rollout-steps"
            )
        show(f"wrote {result.folder / 'policy.safetensors'}")

    def _what(self) -> tuple[str, Hyperparameters]:
        """Return the environment and how to learn; a run that goes on knows its own."""
        from collaborative_gym.learning.checkpoint import Checkpoint
        from collaborative_gym.learning.folder import LAST

        envs, own = self.envs, None
        if self.resume is not None:
            settings = Checkpoint.load(self.resume / LAST).settings
            envs = envs or (settings.identity.name,)
            own = settings.hyperparameters
        if len(envs) != 1:
            raise ValueError("name environments to train, or pass --all")
        algorithm = self.algorithm or "ppo"
        usual = own or recipe(envs[0], algorithm, advised=self.advised)
        return envs[0], replace(usual, **self._given())

    def _task(self, env: str) -> str | Task:
        """Return what to learn; without options, a run that goes on knows it itself."""
        chosen = self.robots, *self._how
        return env if all(each in (None, ()) for each in chosen) else self.task(env)

    def _given(self) -> dict[str, Any]:
        """Return the hyperparameters that the command line has, by name."""
        from collaborative_gym.learning.settings import check_company

        given = {
            name: value
            for name, value in vars(self.hyperparameters).items()
            if not isinstance(value, _NotGiven)
        }
        if self.resume is None:
            check_company(given, self.opponent, self.partner)
        return given

    def _options(self) -> "Options":
        """Return the options that hold for one run as for several."""
        return {
            "opponent": self.opponent or None,
            "partner": self.partner or None,
            "start_from": self.start_from,
            "backend": self.backend,
            "algorithm": self.algorithm,
            "resources": self.resources,
            "checkpoint_interval": self.checkpoint_interval,
        }

    def _train_several(self) -> None:
        """Train several runs, and name those that failed at the end."""
        for option, other in (("seed", "--seeds"), ("resume", "the same command")):
            if getattr(self, option) is not None:
                raise ValueError(f"--{option} is for one run; give {other} instead")
        if self.mode is not None and self.modes:
            raise ValueError("give --mode or --modes, not both")
        if not self.envs:
            raise ValueError("name environments to train, or pass --all")
        modes = self.modes or ((self.mode,) if self.mode else None)
        outcomes = self._finish(self.envs, modes, (0,), Path("runs"))
        for outcome in outcomes:
            if outcome.result is not None:
                show(f"wrote {outcome.folder}")
        _raise_failures(outcomes)

    def _train_all(self) -> None:
        """Train all baselines, and write their cards."""
        from collaborative_gym import list_envs
        from collaborative_gym.learning.baselines import write_baseline

        own = "mode modes seed resume robots num_robots randomization action"
        for option in (*own.split(), "opponent", "partner", "backend", "algorithm"):
            if getattr(self, option) not in (None, ()):
                raise ValueError(
                    f"{option} does not go with --all: all baselines are trained alike"
                )
        envs, output = self.envs or list_envs(), self.output or Path("runs/baselines")
        outcomes = self._finish(envs, ("collaborative",), (0, 1, 2), output)
        results = [each.result for each in outcomes if each.result is not None]
        for env in envs:
            runs = [each for each in results if each.settings.identity.name == env]
            if runs:
                show(f"wrote {write_baseline(runs, output, self.resources)}")
        _raise_failures(outcomes)

    def _finish(
        self,
        envs: Sequence[str],
        modes: Sequence[Mode] | None,
        seeds: Sequence[int],
        output: Path,
    ) -> "tuple[Outcome, ...]":
        """Train several runs, showing how they go; return what became of each."""
        from collaborative_gym.learning.many import train_all

        return train_all(
            [self._task(env) for env in envs],
            modes,
            seeds=read_seeds(self.seeds) or seeds,
            jobs=self.jobs or 0,
            output=self.output or output,
            changes=self._given(),
            advised=self.advised,
            progress=True,
            **self._options(),
        )


@dataclass(frozen=True, kw_only=True)
class BriefTrain(Train):
    """The help of `train`: hyperparameters and resources by their names alone."""

    resources: tyro.conf.Suppress[Resources] = field(default_factory=Resources)
    hyperparameters: tyro.conf.Suppress[Hyperparameters] = field(
        default_factory=Hyperparameters
    )

    @classmethod
    def description(cls) -> str:
        """Return the text above the options."""
        text = inspect.cleandoc(Train.__doc__ or "").partition("\n\nAttributes:")[0]
        for what, kind in (("resources", Resources), ("how to learn", Hyperparameters)):
            names = [_option(each.name) for each in fields(kind)]
            text += f"\n\nMore options, {what} (see --help-all): {', '.join(names)}."
        return text


def explain_hyperparameters() -> str:
    """Return the hyperparameters by subject: a sentence about each, and its default."""
    lines: list[str] = []
    for kind in (Resources, Hyperparameters):
        told = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2]
        _, *parts = re.split(r"^  (\w+): ", told, flags=re.MULTILINE)
        about = dict(zip(parts[::2], parts[1::2], strict=True))
        for option in fields(kind):
            if option.name in _SUBJECTS:
                lines += ["", f"{_SUBJECTS[option.name]}:"]
            usual = option.default
            usual = " ".join(map(str, usual)) if isinstance(usual, tuple) else usual
            sentence = re.split(r"\. (?=[A-Z(])", " ".join(about[option.name].split()))
            lines += textwrap.wrap(
                f"{sentence[0].rstrip('.')} ({usual})",
                78,
                initial_indent=f"  {_option(option.name):<24} ",
                subsequent_indent=" " * 27,
            )
    more = "More about each: python -m pydoc collaborative_gym.Hyperparameters"
    return "\n".join([*lines, "", more])


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _raise_failures(outcomes: "Sequence[Outcome]") -> None:
    """Raise an error that names the runs that failed, if any did."""
    failed = [each for each in outcomes if each.result is None]
    if failed:
        listed = "".join(f"\n{each.folder}: {each.reason}" for each in failed)
        raise RuntimeError(f"{len(failed)} of {len(outcomes)} runs failed:{listed}")


def read_seeds(words: Sequence[str]) -> tuple[int, ...]:
    """Return the seeds that words such as "3" and "0-9" name.

    Raises:
      ValueError: if a word is neither a seed nor a range of seeds.
    """
    found: list[int] = []
    for word in words:
        first, dash, last = word.partition("-")
        ends = [first, last if dash else first]
        if not all(end.isdecimal() and end.isascii() and len(end) < 20 for end in ends):
            raise ValueError(
                f"--seeds takes numbers and ranges, such as 0 1 2 or 0-9; got {word!r}"
            )
        low, high = map(int, ends)
        if not low <= high < low + _MOST_SEEDS:
            raise ValueError(
                f"--seeds {word} must go up, by at most {_MOST_SEEDS:,} seeds"
            )
        found += range(low, high + 1)
    return tuple(found)
