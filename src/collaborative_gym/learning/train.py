"""The call that trains: a new run, or one that goes on."""

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Unpack

from collaborative_gym import errors

try:
    import skrl  # noqa: F401  # Shows here what is missing.
    import torch
except ImportError as error:
    raise ImportError(
        f"training needs {error.name}, which is not installed;"
        f" {errors.how_to_install('train')}"
    ) from error

from collaborative_gym.evaluation.machine import cores
from collaborative_gym.files import sealed, write_text
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.config import Hyperparameters, Mode, Resources
from collaborative_gym.learning.display import Display
from collaborative_gym.learning.folder import CONFIG, LAST, claimed
from collaborative_gym.learning.run import OnRow, Result, Run
from collaborative_gym.learning.settings import Options, make_settings, take_interval
from collaborative_gym.learning.stopping import ctrl_c
from collaborative_gym.tasks.registry import as_task, make_task
from collaborative_gym.tasks.task import Randomization, Task


def train(
    env: str | Task,
    mode: Mode | None = None,
    *,
    seed: int | None = None,
    output: str | Path | None = None,
    resume: str | Path | None = None,
    hyperparameters: Hyperparameters | None = None,
    on_row: OnRow | None = None,
    progress: bool = False,
    **options: Unpack[Options],
) -> Result:
    """Train policies by PPO or SAC, and return the finished run.

    The folder of the run holds `policy.safetensors`, the policy with the best
    validation so far, for `load_policy`; `last.pt` and `best.pt`, from which it can go
    on; `config.json`, `progress.csv`, `curve.png` and TensorBoard's events.

    Args:
      env: an environment id, a task's name, or a task.
      mode: who learns what, see docs/training.md; None for "collaborative", or for
        "shared" if robots with equal spaces learn against policies or in a league.
      seed: the run's seed; None for 0.
      output: a new folder; None for one in `runs/` by environment, mode and seed.
      resume: the folder of a run to continue, in place of `output`. It keeps the
        settings with which it was started; you need not give them again. You may raise
        `total_steps` and change the validations.
      hyperparameters: how it learns; None for `recipe(env, algorithm)`.
      on_row: called after each iteration with two dictionaries: its line of
        `progress.csv`, and that of the best validation so far.
      progress: whether to show the progress, as the command line does.
      options: partners, start, algorithm and resources, see `Options`.

    Raises:
      BlockingIOError: if a run is under way in the folder.
      FileExistsError: if there is a run in the folder already.
      FileNotFoundError: if there is nothing to resume.
      ImportError: if the extra `train`, or `ray`, is not installed.
      KeyboardInterrupt: once the update during which Ctrl-C came is done and saved;
        at once if it comes again.
      KeyError: if a name is unknown.
      OSError: if a file cannot be written, as on a full disk; earlier ones stay.
      RuntimeError: if a loss is not finite; names it and the last good checkpoint.
      TypeError: if a number is of another kind, or a keyword unknown.
      ValueError: if the robots do not fit the mode, or a checkpoint is damaged or of
        another run or environment than the one asked for; says what differs.
    """
    interval = take_interval(options)
    resources = _checked(options.pop("resources", None))
    errors.check_callback("on_row", on_row)
    progress = errors.check_flag("progress", progress)
    if output is not None and resume is not None:
        raise ValueError("give either output, for a new run, or resume")
    with ExitStack() as stack:
        folder = started = None
        if resume is not None:
            folder = _folder("resume", resume)
            stack.enter_context(claimed(folder, LAST))
            started = Checkpoint.load(folder / LAST)
        task = _task(env, started)
        before = None if started is None else started.settings
        settings = make_settings(
            task,
            before,
            mode=mode,
            seed=seed,
            hyperparameters=hyperparameters,
            **options,
        )
        if settings.backend != "ray" and resources.of_ray:
            raise ValueError(
                f"{' and '.join(resources.of_ray)} would mean nothing without Ray; give"
                " --backend ray too, or leave them out"
            )
        if folder is None:
            folder = _folder("output", settings.folder if output is None else output)
            _begin(folder, stack)
        # Also of a run that goes on, whose total_steps may have grown.
        write_text(folder / CONFIG, sealed(settings.to_dict()))
        stack.enter_context(_torch(settings.seed, resources.torch_threads))
        run = Run(folder, task, settings=settings, resources=resources, started=started)
        pressed = stack.enter_context(ctrl_c(f"continue with --resume {folder}"))
        called = [] if on_row is None else [on_row]
        if progress:
            total = settings.hyperparameters.total_steps
            called.insert(0, stack.enter_context(Display(task.name, total)).show)
        with closing(run):
            return run.finish(pressed, checkpoint_interval=interval, on_rows=called)


def _checked(resources: Resources | None) -> Resources:
    resources = Resources() if resources is None else resources
    errors.check_kind("resources", resources, Resources, "Resources(...)")
    try:
        kind = torch.device(resources.device).type
    except RuntimeError:
        kind = None
    if kind not in ("cpu", "cuda"):
        raise ValueError(f"no device {resources.device!r}; give cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise ValueError("device is cuda, but torch finds no CUDA device here")
    return resources


def _folder(name: str, given: str | Path) -> Path:
    errors.check_kind(name, given, (str, Path), "a folder's name")
    if not str(given) or "\0" in str(given):
        raise ValueError(f"{name} must be a folder's name, got {given!r}")
    return Path(given)


def _task(env: str | Task, started: Checkpoint | None) -> Task:
    """Return what to learn; a run that goes on knows its own arms and starts."""
    if started is None or isinstance(env, Task):
        return as_task(env)
    own = started.settings.identity
    starts = Randomization(**own.config["randomization"])
    return make_task(
        env, own.robot_names, randomization=starts, action=own.action, grasp=own.grasp
    )


def _begin(folder: Path, stack: ExitStack) -> None:
    stack.enter_context(claimed(folder))
    if (folder / LAST).exists():
        raise FileExistsError(
            f"there is a run in {folder} already; continue it (--resume), or choose"
            " another output"
        )


@contextmanager
def _torch(seed: int, threads: int) -> Iterator[None]:
    """Let torch draw from generators of a seed, in so many threads, for a while."""
    before = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        torch.set_num_threads(threads or cores())
        try:
            yield
        finally:
            torch.set_num_threads(before)
