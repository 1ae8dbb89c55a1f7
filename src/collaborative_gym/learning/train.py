"""The training loop: learn, validate, show, save; stop and go on at any time."""

import json
import math
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

try:
    import skrl  # noqa: F401  # Shows here what is missing.
    import torch
except ImportError as error:
    raise ImportError(
        f"training needs {error.name}, which is not installed;"
        " pip install 'collaborative-gym[train]'"
    ) from error

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_count, unknown
from collaborative_gym.evaluation import Report, evaluate
from collaborative_gym.evaluation.machine import cores
from collaborative_gym.files import write_text
from collaborative_gym.learning.backend import (
    Backend,
    Iteration,
    training_seed,
    validation_seed,
)
from collaborative_gym.learning.checkpoint import BEST, LAST, Checkpoint, Settings
from collaborative_gym.learning.config import Hyperparameters, Mode, Resources, recipe
from collaborative_gym.learning.monitor import Monitor, summarize
from collaborative_gym.learning.skrl_backend import SkrlBackend
from collaborative_gym.learning.team import Learner, Sizes, make_learners
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import POLICY_FILE
from collaborative_gym.rng import check_seed
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Randomization, Task

BACKENDS = ("skrl", "rllib")

_MAY_CHANGE = {"total_steps", "validation_interval", "validation_episodes"}
"""Hyperparameters that a run may go on with another value of; steps only of more."""

OnRow = Callable[[Mapping[str, float], Mapping[str, float]], object]
"""Gets an iteration's row and that of the best validation so far (or nothing)."""


@dataclass(frozen=True)
class Result:
    """A training run that has come to its end.

    Attributes:
      folder: where its files are.
      settings: what it was started with.
      steps: environment steps that it took.
      seconds: time that it took.
      best: means of the best validation: `validation/return`,
        `validation/completion`, `validation/performance` and `steps`.
    """

    folder: Path
    settings: Settings
    steps: int
    seconds: float
    best: Mapping[str, float]

    def policy(self) -> NetworkPolicy:
        """Return the policy with the best validation."""
        return NetworkPolicy.load(self.folder / POLICY_FILE)


def train(
    env: str | Task,
    mode: Mode | None = None,
    seed: int | None = None,
    output: str | Path | None = None,
    resume: str | Path | None = None,
    robots: Sequence[str | Robot] | None = None,
    randomization: str | Randomization | None = None,
    hyperparameters: Hyperparameters | None = None,
    backend: str | None = None,
    resources: Resources | None = None,
    checkpoint_interval: int = 100_000,
    on_row: OnRow | None = None,
) -> Result:
    """Train policies by PPO, and return what came of it.

    The folder of the run holds `policy.safetensors`, the policy with the best
    validation so far, for `load_policy`; `last.pt` and `best.pt`, from which it can go
    on; `config.json`, `progress.csv`, `curve.png` and TensorBoard's events.

    Args:
      env: an environment id, a task's name, or a task.
      mode: who learns what, see `Mode`; None for "collaborative".
      seed: of the run; None for 0.
      output: a new folder; None for one in `runs/` named after environment, mode and
        seed.
      resume: the folder of a run to go on with, in place of `output`. What it was
        started with holds, and need not be given again; `total_steps` may be raised,
        and validations changed.
      robots: other arms than the environment's own, in the order of the agents.
      randomization: how starts are drawn; None for "default".
      hyperparameters: how it learns; None for `recipe(env)`.
      backend: "skrl" or "rllib"; None for "skrl".
      resources: device and threads.
      checkpoint_interval: environment steps between two checkpoints.
      on_row: called after each iteration with its numbers.

    Raises:
      FileExistsError: if there is a run in the folder already.
      FileNotFoundError: if there is nothing to resume.
      ImportError: if the extra `train`, or `rllib`, is not installed.
      KeyboardInterrupt: once the update during which Ctrl-C came is done and saved;
        at once if it comes again.
      KeyError: if a name is unknown.
      OSError: if a file cannot be written, as on a full disk; earlier ones stay.
      RuntimeError: if a loss is not finite; names it and the last good checkpoint.
      TypeError: if a number is of another kind.
      ValueError: if the robots do not fit the mode, or a checkpoint is damaged or of
        another run than the one asked for.
    """
    check_count("checkpoint_interval", checkpoint_interval, at_least=1)
    resources = resources or Resources()
    _check_device(resources.device)
    started = None
    if resume is not None:
        if output is not None:
            raise ValueError("give either output, for a new run, or resume")
        started = Checkpoint.load(Path(resume) / LAST)
        if not isinstance(env, Task):
            robots = robots or started.settings.robots
            own = Randomization(**started.settings.randomization)
            randomization = own if randomization is None else randomization
    task = as_task(env, robots, randomization)
    name = env if isinstance(env, str) else type(task).__name__
    if started is None:
        settings = _settings(name, task, mode, seed, backend, hyperparameters)
        folder = _new_folder(settings, output)
    else:
        given = mode, seed, backend, hyperparameters
        settings = _resumed(started.settings, str(resume), name, task, *given)
        folder = Path(str(resume))
        _clear(folder)
    with _own_generator(settings.seed), _torch_threads(resources.torch_threads):
        run = _Run(folder, task, settings, resources, started)
        try:
            with _ctrl_c() as pressed:
                return run.finish(checkpoint_interval, on_row, pressed)
        finally:
            run.close()


class _Run:
    """A run under way."""

    def __init__(
        self,
        folder: Path,
        task: Task,
        settings: Settings,
        resources: Resources,
        started: Checkpoint | None,
    ):
        self._folder = folder
        self._task = task
        self._settings = settings
        self._num_threads = resources.num_threads
        sizes = Sizes(settings.observation_sizes, settings.action_sizes, task.gripping)
        learners = make_learners(settings.mode, sizes)
        self._parts = [part for learner in learners for part in learner.parts]
        self._backend = _make_backend(task, settings, resources, learners, sizes)
        self._best: dict[str, float] = {}
        self._before = 0.0
        try:
            if started is not None:
                self._backend.load_state_dict(started.backend)
                self._best, self._before = dict(started.best), started.seconds
            rows = started.rows if started is not None else ()
            self._monitor = Monitor(folder, settings.title, rows)
            self._since = time.monotonic()
            if started is None:
                self._save(LAST)
        except BaseException:
            self._backend.close()
            raise

    def finish(
        self,
        checkpoint_interval: int,
        on_row: OnRow | None,
        pressed: threading.Event,
    ) -> Result:
        """Train up to the last step, or until Ctrl-C is `pressed`."""
        numbers = self._settings.hyperparameters
        while self._backend.steps < numbers.total_steps:
            before, began = self._backend.steps, time.monotonic()
            iteration = self._backend.advance()
            self._check_finite(iteration)
            steps = self._backend.steps
            rate = (steps - before) / (time.monotonic() - began)
            is_last = steps >= numbers.total_steps
            is_due = _crosses(before, steps, numbers.validation_interval)
            validation = self._validate() if is_due or is_last else None
            row = summarize(steps, self._seconds, rate, iteration, validation)
            self._monitor.log(row)
            if validation is not None:
                self._keep_best(row)
            if _crosses(before, steps, checkpoint_interval) or is_last:
                self._save(LAST)
            if on_row is not None:
                on_row(row, self._best)
            if pressed.is_set():
                self._save(LAST)
                raise KeyboardInterrupt(
                    f"stopped after {steps:,} steps; go on with --resume {self._folder}"
                )
        return Result(
            self._folder,
            self._settings,
            self._backend.steps,
            self._seconds,
            self._best,
        )

    def close(self) -> None:
        """Close the files and free the worlds."""
        try:
            self._monitor.close()
        finally:
            self._backend.close()

    @property
    def _seconds(self) -> float:
        return self._before + time.monotonic() - self._since

    def _policy(self) -> NetworkPolicy:
        settings = self._settings.to_dict()
        activation = self._settings.hyperparameters.activation
        facts = {**settings, "steps": self._backend.steps}
        weights = self._backend.weights()
        return NetworkPolicy(self._parts, weights, activation, facts)

    def _validate(self) -> Report:
        return evaluate(
            self._task,
            self._policy(),
            self._settings.hyperparameters.validation_episodes,
            validation_seed(self._settings.seed),
            num_threads=self._num_threads,
        )

    def _keep_best(self, row: Mapping[str, float]) -> None:
        score = "validation/return"
        if self._best and row[score] <= self._best[score]:
            return
        self._best = {
            column: value
            for column, value in row.items()
            if column == "steps" or column.startswith("validation/")
        }
        self._policy().save(self._folder / POLICY_FILE)
        self._save(BEST)

    def _save(self, name: str) -> None:
        Checkpoint(
            self._settings,
            self._backend.state_dict(),
            self._monitor.rows,
            self._best,
            self._seconds,
        ).save(self._folder / name)

    def _check_finite(self, iteration: Iteration) -> None:
        for learner, numbers in iteration.numbers.items():
            for name, value in numbers.items():
                if not math.isfinite(value):
                    raise RuntimeError(
                        f"{name} of {learner} is {value} after"
                        f" {self._backend.steps:,} steps; the last good checkpoint is"
                        f" {self._folder / LAST}. A lower learning rate may help"
                    )


def _check_device(device: str) -> None:
    try:
        kind = torch.device(device).type
    except RuntimeError:
        kind = None
    if kind not in ("cpu", "cuda"):
        raise ValueError(f"no device {device!r}; give cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise ValueError("device is cuda, but torch finds no CUDA device here")


def _settings(
    name: str,
    task: Task,
    mode: Mode | None,
    seed: int | None,
    backend: str | None,
    hyperparameters: Hyperparameters | None,
) -> Settings:
    """Return the settings of a new run."""
    backend = backend or "skrl"
    if backend not in BACKENDS:
        raise ValueError(unknown("backend", backend, BACKENDS))
    sizes = _sizes(task)
    settings = Settings(
        environment=name,
        robots=tuple(robot.name for robot in task.robots.values()),
        randomization=asdict(task.config.randomization),
        mode=mode or "collaborative",
        seed=check_seed(0 if seed is None else seed),
        backend=backend,
        observation_sizes=sizes.observation,
        action_sizes=sizes.action,
        hyperparameters=hyperparameters or recipe(name),
    )
    training_seed(settings.seed)
    make_learners(settings.mode, sizes)
    return settings


def _sizes(task: Task) -> Sizes:
    env = VectorEnv(task, 1, num_threads=1)
    observation, action = (
        {agent: space.shape[0] for agent, space in spaces.items()}
        for spaces in (env.single_observation_spaces, env.single_action_spaces)
    )
    env.close()
    return Sizes(observation, action, task.gripping)


def _resumed(
    own: Settings,
    folder: str,
    name: str,
    task: Task,
    mode: Mode | None,
    seed: int | None,
    backend: str | None,
    hyperparameters: Hyperparameters | None,
) -> Settings:
    """Return the settings of a run that goes on, after comparing what was asked for."""
    asked = asdict(hyperparameters or own.hyperparameters)
    numbers = asdict(own.hyperparameters)
    given = {
        "environment": name,
        "robots": tuple(robot.name for robot in task.robots.values()),
        "randomization": asdict(task.config.randomization),
        "mode": mode or own.mode,
        "seed": own.seed if seed is None else seed,
        "backend": backend or own.backend,
    }
    kept = {field: getattr(own, field) for field in given}
    for option, value in asked.items():
        is_lower = option == "total_steps" and value < numbers[option]
        if is_lower or option not in _MAY_CHANGE:
            given[option], kept[option] = value, numbers[option]
    for option, value in given.items():
        if value != kept[option]:
            raise ValueError(
                f"the run in {folder} has {option} {kept[option]}, not {value}; leave"
                " it out to go on with that run, or start another"
            )
    sizes = _sizes(task)
    if (sizes.observation, sizes.action) != (own.observation_sizes, own.action_sizes):
        raise ValueError(
            f"the run in {folder} is of another version of {name}: its spaces have"
            " other sizes; start another run"
        )
    return replace(own, hyperparameters=hyperparameters or own.hyperparameters)


def _new_folder(settings: Settings, output: str | Path | None) -> Path:
    """Make the folder of a new run, with what it was started with."""
    name = f"{settings.environment}-{settings.mode}-seed{settings.seed}"
    folder = Path("runs") / name if output is None else Path(output)
    if (folder / LAST).exists():
        raise FileExistsError(
            f"there is a run in {folder} already; go on with it (--resume), or choose"
            " another output"
        )
    write_text(folder / "config.json", json.dumps(settings.to_dict(), indent=2) + "\n")
    return folder


def _clear(folder: Path) -> None:
    """Remove what a run that was killed had half written."""
    for partial in folder.glob(".*.partial"):
        shutil.rmtree(partial, ignore_errors=True)


def _make_backend(
    task: Task,
    settings: Settings,
    resources: Resources,
    learners: Sequence[Learner],
    sizes: Sizes,
) -> Backend:
    given = (
        task,
        learners,
        sizes,
        settings.seed,
        settings.hyperparameters,
        resources.device,
        resources.num_threads,
    )
    if settings.backend == "rllib":
        from collaborative_gym.learning.rllib_backend import RLlibBackend

        return RLlibBackend(*given, resources.num_runners, resources.ray_address)
    return SkrlBackend(*given)


def _crosses(before: int, after: int, interval: int) -> bool:
    """Return whether a multiple of the interval lies between; 0 for no interval."""
    return bool(interval) and before // interval < after // interval


@contextmanager
def _own_generator(seed: int) -> Iterator[None]:
    """Let torch draw from generators of this seed, and the caller's go on after."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


@contextmanager
def _ctrl_c() -> Iterator[threading.Event]:
    """Yield what Ctrl-C sets while the context lasts; a second one interrupts."""
    pressed = threading.Event()

    def press(*_: object) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    # Only the main thread may set what a signal does, and one that is ignored, as in
    # the background, or heeded by the caller stays so.
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield pressed
        return
    signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count or cores())
    try:
        yield
    finally:
        torch.set_num_threads(before)
