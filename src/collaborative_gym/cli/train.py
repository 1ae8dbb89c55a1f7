"""The command that trains."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from collaborative_gym.cli.terminal import Envs, Flag, Folder, Worlds, option, show
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

_MOST_SEEDS = 10_000  # more runs of one kind than anybody trains

_Flat = tyro.conf.arg(name="")


class _NotGiven:
    """Marks the value of an option that the command line does not have."""


def _not_given() -> Hyperparameters:
    """Return the defaults, marked, because asking for a default overrules a recipe."""
    marked = {}
    for each in fields(Hyperparameters):
        kind = type(each.default)
        mark: Any = type(kind.__name__, (_NotGiven, kind), {})
        marked[each.name] = mark(each.default)
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
      help_all: like --help, but with all hyperparameters.
      all: train the baselines of all environments, or of those named, and write their
        cards; continues the runs that exist already.
      modes: train in each of these; see --mode.
      jobs: how many runs train at a time, each in a process of its own (default: one
        per CPU). The same command continues what Ctrl-C has ended.
      mode: which policies and critics learn. collaborative (MAPPO, default): a policy
        for each robot and one critic; independent (IPPO): a policy and a critic for
        each; shared: one policy for robots with equal spaces (default for such robots
        against given policies and in a league); centralized: one policy for all robots.
      seed: seed of the run (default: 0); for several seeds see --seeds.
      seeds: seeds of several runs, such as 0 1 2 or 0-9: a run for each seed in each
        environment and mode; with --all for each baseline (default: 0 1 2).
      output: folder of a new run (default: runs/ENV-MODE-seedS; league, population or
        guests stands before MODE). For several runs, the folder that holds them
        (default: runs; with --all, runs/baselines).
      resume: folder of a run to continue, with the options that it was started with.
      opponent: who plays against the learner, if a task has several sides: by default
        self, the latest policies; policies, of which each episode draws one;
        side_2=POLICY, which plays only that side; or league; see docs/leagues.md.
      partner: who plays with the learner, if a task has one side: by default the latest
        policies; policies, of which each episode draws one; robot_2=POLICY, which plays
        only that robot; or population; see docs/strangers.md.
      start_from: trained policy to begin with, named as in evaluate, instead of random
        networks. It may come from another environment with spaces of the same sizes.
      backend: skrl (default), or ray to collect in several processes or machines.
      algorithm: ppo (default), or sac for tasks of one side and without partners.
      advised: learn with the scripted expert's advice, with hyperparameters for it,
        which your options replace; the main one is --imitation.
      checkpoint_interval: environment steps between two checkpoints.
      hyperparameters: how it learns.
      resources: what the run may use.
    """

    envs: Envs = ()
    help_all: Flag = False
    all: Flag = False
    mode: Annotated[Mode | None, option("MODE")] = None
    seed: Annotated[int | None, option("INT")] = None
    seeds: Annotated[tuple[str, ...], option("INT | A-B ...")] = ()
    modes: Annotated[tuple[Mode, ...], option("MODE ...")] = ()
    jobs: Annotated[int | None, option("INT")] = None
    output: Annotated[Path | None, option("FOLDER")] = None
    resume: Folder = None
    randomization: Annotated[str | None, option("PRESET")] = None
    opponent: Annotated[tuple[str, ...], option("WHO ...")] = ()
    partner: Annotated[tuple[str, ...], option("WHO ...")] = ()
    start_from: Annotated[str | None, option("POLICY")] = None
    backend: Annotated[str | None, option("NAME")] = None
    algorithm: Annotated[Algorithm | None, option("NAME")] = None
    advised: Flag = False
    checkpoint_interval: int = 100_000
    hyperparameters: Annotated[Hyperparameters, _Flat] = field(
        default_factory=_not_given
    )
    resources: Annotated[Resources, _Flat] = field(default_factory=Resources)

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

        env, hyperparameters, done = self._what()
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
        if done >= total:
            show("the run was complete; to go on, give more --total-steps")
        elif trained > 1.01 * total:
            show(
                f"trained {trained:,} steps, not {total:,}: an update takes {update:,}"
                " steps, which are --num-envs times --rollout-steps"
            )
        show(f"wrote {result.folder / 'policy.safetensors'}")

    def _what(self) -> tuple[str, Hyperparameters, float]:
        """Return the environment, how to learn, and the steps that a run has done."""
        from collaborative_gym.learning.checkpoint import Checkpoint
        from collaborative_gym.learning.folder import LAST

        envs, own, done = self.envs, None, 0.0
        if self.resume is not None:
            run = Checkpoint.load(self.resume / LAST)
            settings, done = run.settings, run.backend["steps"]
            envs = envs or (settings.identity.name,)
            own = settings.hyperparameters
        if len(envs) != 1:
            raise ValueError("name environments to train, or pass --all")
        algorithm = self.algorithm or "ppo"
        usual = own or recipe(envs[0], algorithm, advised=self.advised)
        return envs[0], replace(usual, **self._given()), done

    def _task(self, env: str) -> str | Task:
        chosen = self.robots, *self._how
        return env if all(each in (None, ()) for each in chosen) else self.task(env)

    def _given(self) -> dict[str, Any]:
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
        for name, other in (("seed", "--seeds"), ("resume", "the same command")):
            if getattr(self, name) is not None:
                raise ValueError(f"--{name} is for one run; give {other} instead")
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
        from collaborative_gym import list_envs
        from collaborative_gym.learning.baselines import write_baseline

        own = "mode modes seed resume robots num_robots randomization action"
        for name in (*own.split(), "opponent", "partner", "backend", "algorithm"):
            if getattr(self, name) not in (None, ()):
                raise ValueError(
                    f"{name} does not go with --all: all baselines are trained alike"
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


def _raise_failures(outcomes: "Sequence[Outcome]") -> None:
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
