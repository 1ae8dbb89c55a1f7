"""Many runs, several at a time, each in a process of its own."""

import os
import pickle
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, Queue
from tempfile import TemporaryFile
from threading import Event, Thread
from typing import Any

from collaborative_gym.errors import (
    check_callback,
    check_count,
    check_flag,
    check_kind,
    check_name,
)
from collaborative_gym.evaluation.machine import cores
from collaborative_gym.learning.config import (
    Algorithm,
    Mode,
    Resources,
    recipe,
)
from collaborative_gym.learning.display import ManyDisplay
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.run import Result
from collaborative_gym.learning.settings import Named, settle
from collaborative_gym.learning.stopping import ctrl_c
from collaborative_gym.learning.train import train
from collaborative_gym.plugins import load_modules, loaded_files
from collaborative_gym.rng import check_run_seed
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task

_COMMAND = [
    sys.executable,
    "-c",
    "from collaborative_gym.learning.many import train_one; train_one()",
]
"""What trains one run, as standard input tells it."""

_HEED = 0.2
"""Longest time until Ctrl-C is heeded, in s."""


@dataclass(frozen=True)
class Plan:
    """A run that is to be trained, or to go on.

    Attributes:
      folder: where its files go; its name says what it is.
      total_steps: environment steps of the whole run.
      given: what `train` takes.
    """

    folder: Path
    total_steps: int
    given: Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
      folder: where its files are.
      result: the finished run; None where it failed.
      reason: why it failed; empty where it did not.
    """

    folder: Path
    result: Result | None
    reason: str = ""


OnRow = Callable[[Plan, Mapping[str, float], Mapping[str, float]], object]
"""Gets a run, an iteration's row, and that of the best validation so far."""


def train_all(
    envs: str | Task | Sequence[str | Task],
    modes: Mode | Sequence[Mode] | None = None,
    *,
    seeds: Sequence[int] = (0,),
    jobs: int = 0,
    output: str | Path = "runs",
    changes: Mapping[str, Any] | None = None,
    advised: bool = False,
    opponent: Named | None = None,
    partner: Named | None = None,
    start_from: str | Path | None = None,
    backend: str | None = None,
    algorithm: Algorithm | None = None,
    resources: Resources | None = None,
    checkpoint_interval: int = 100_000,
    on_row: OnRow | None = None,
    progress: bool = False,
) -> tuple[Outcome, ...]:
    """Train every environment in every mode with every seed, several at a time.

    Each run has a folder of its own in `output`, named after environment, mode and
    seed, and a process of its own. A run that fails does not end the others. Ctrl-C
    ends all, each after its current update; the same call then continues those that are
    not finished. Wrong arguments raise before the work.

    Args:
      envs: environment ids, tasks' names, or tasks; tasks of your own come from
        `load_module`.
      modes: who learns what, as in `train`; None for the usual one.
      seeds: of the runs in each mode.
      jobs: processes at a time, 0 for one per CPU. Where there are several, each has
        one physics thread unless `resources` say otherwise.
      output: the folder of all runs.
      changes: hyperparameters to use instead of those of each environment's recipe, by
        name.
      advised: whether they learn with the expert's advice, by recipes of its own.
      opponent: who plays against what is learned.
      partner: who plays with it.
      start_from: a trained policy to begin with.
      backend: what collects.
      algorithm: what learns.
      resources: device and threads of each run.
      checkpoint_interval: environment steps between two checkpoints.
      on_row: called with a plan after each of its iterations, with its numbers.
      progress: whether to show how they go, as the command line does.

    Returns:
      What became of each run, in the order of environments, modes and seeds.

    Raises:
      KeyboardInterrupt: once all runs are saved, after Ctrl-C; at once if it comes
        again, which loses what came after their last checkpoints.
      KeyError: if a name is unknown.
      TypeError: if something is of another kind.
      ValueError: if such runs are not possible; a run that is there already and was
        started with other settings fails when its turn comes.
    """
    check_callback("on_row", on_row)
    check_kind("output", output, (str, Path), "a folder's name")
    check_count("checkpoint_interval", checkpoint_interval, at_least=1)
    advised, progress = check_flag("advised", advised), check_flag("progress", progress)
    plans: dict[Path, Plan] = {}
    for env in _several("environment", envs):
        if not isinstance(env, Task):
            check_name("each environment", env)
        task = as_task(env)
        numbers = recipe(
            task.name, algorithm or "ppo", advised=advised, changes=changes
        )
        for mode in (None,) if modes is None else _several("mode", modes):
            own: dict[str, Any] = {
                "mode": mode,
                "hyperparameters": numbers,
                "opponent": opponent,
                "partner": partner,
                "start_from": start_from,
                "backend": backend,
                "algorithm": algorithm,
            }
            settled = settle(task, None, seed=None, **own)
            for seed in _several("seed", seeds):
                settings = replace(settled, seed=check_run_seed(seed))
                folder = Path(output) / settings.folder.name
                if folder in plans:
                    raise ValueError(f"{folder.name} is asked for twice; ask once")
                given = {"env": task, "seed": settings.seed, **own}
                given["checkpoint_interval"] = checkpoint_interval
                plans[folder] = Plan(folder, numbers.total_steps, given)
    totals = {folder.name: plan.total_steps for folder, plan in plans.items()}
    with ManyDisplay(totals) if progress else nullcontext() as display:

        def show(plan: Plan, row: Mapping[str, float], best: Mapping[str, float]):
            if display is not None:
                display.show(plan.folder.name, row)
            if on_row is not None:
                on_row(plan, row, best)

        return finish(list(plans.values()), jobs, resources, show)


def finish(
    plans: Sequence[Plan], jobs: int, resources: Resources | None, on_row: OnRow
) -> tuple[Outcome, ...]:
    """Train runs as `train_all` does, and return what became of each, in their order.

    Raises:
      KeyboardInterrupt: as `train_all`.
    """
    check_count("jobs", jobs, at_most=1024)
    resources = resources or Resources()
    check_kind("resources", resources, Resources, "Resources(...)")
    jobs = min(jobs or cores(), len(plans))
    if jobs > 1:
        # Runs side by side keep the cores busy, so more threads would only wait.
        resources = replace(resources, num_threads=resources.num_threads or 1)
    with ctrl_c("the same command continues") as pressed:
        outcomes = _Crew(plans, resources, on_row).work(jobs, pressed)
        if pressed.is_set():
            done = sum(each.result is not None for each in outcomes.values())
            raise KeyboardInterrupt(
                f"stopped with {done} of {len(plans)} runs finished"
            )
    return tuple(outcomes[plan.folder] for plan in plans)


class _Crew:
    """Processes that train runs, one each."""

    def __init__(self, plans: Sequence[Plan], resources: Resources, on_row: OnRow):
        self._waiting = list(plans)
        self._resources = resources
        self._on_row = on_row
        self._inbox: Queue[tuple[Plan, Any]] = Queue()
        self._under_way: dict[Path, subprocess.Popen[bytes]] = {}
        self._outcomes: dict[Path, Outcome] = {}

    def work(self, jobs: int, pressed: Event) -> dict[Path, Outcome]:
        """Return what became of the runs, but not of those that Ctrl-C stopped."""
        try:
            while self._under_way or (self._waiting and not pressed.is_set()):
                while self._waiting and len(self._under_way) < jobs:
                    if pressed.is_set():
                        break
                    self._start(self._waiting.pop(0))
                if pressed.is_set():
                    for process in self._under_way.values():
                        process.stdin.close()  # type: ignore[union-attr]
                with suppress(Empty):
                    self._heed(*self._inbox.get(timeout=_HEED))
        finally:
            for process in self._under_way.values():
                process.kill()
        return self._outcomes

    def _start(self, plan: Plan) -> None:
        """Start a run, out of reach of the terminal's Ctrl-C."""
        is_there = (plan.folder / LAST).exists()
        given = dict(plan.given) | {"resources": self._resources}
        given["resume" if is_there else "output"] = plan.folder
        said = TemporaryFile()  # noqa: SIM115  # The process has it, too.
        process = subprocess.Popen(
            _COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            process_group=0,
        )
        assert process.stdin is not None
        self._under_way[plan.folder] = process
        with suppress(BrokenPipeError):  # It is gone already; `_read` says why.
            # Of a task of the user's own, its file must be loaded before it.
            pickle.dump((loaded_files(), plan.folder), process.stdin)
            pickle.dump(given, process.stdin)
            process.stdin.flush()
        Thread(target=self._read, args=(plan, process, said), daemon=True).start()

    def _read(self, plan: Plan, process: subprocess.Popen[bytes], said: Any) -> None:
        """Hand on what a process sends, and at last its outcome, None if stopped."""
        outcome: Outcome | None = None
        try:
            while True:
                message = pickle.load(process.stdout)  # type: ignore[arg-type]
                if not isinstance(message, tuple):
                    outcome = message
                    break
                self._inbox.put((plan, message))
        except (EOFError, pickle.UnpicklingError):
            said.seek(0)
            last = said.read().decode(errors="replace").strip().splitlines()[-1:]
            words = f"its process ended with status {process.wait()}"
            outcome = Outcome(plan.folder, None, ": ".join([words, *last]))
        process.wait()
        said.close()
        self._inbox.put((plan, outcome))

    def _heed(self, plan: Plan, message: Any) -> None:
        if isinstance(message, tuple):
            self._on_row(plan, *message)
            return
        process = self._under_way.pop(plan.folder)
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]
        if message is not None:
            self._outcomes[plan.folder] = message


def _several(kind: str, given: Any) -> Sequence[Any]:
    """Return what was given as a sequence of at least one."""
    if isinstance(given, str | Task):
        return [given]
    a = f"one {kind} or several"
    check_kind(f"{kind}s", given, Sequence, a)
    if not given:
        raise ValueError(f"give at least one {kind}")
    return given


def train_one() -> None:
    """Train the run that standard input describes, until it is done or input ends."""
    # A parent may have told its children to ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # What prints on standard output must not come between the messages.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    modules, folder = pickle.load(sys.stdin.buffer)

    def send(message: Any) -> None:
        pickle.dump(message, out)
        out.flush()

    def on_row(row: Mapping[str, float], best: Mapping[str, float]) -> None:
        # Input ends when the run is to stop, and also when nobody is there any more.
        with suppress(BrokenPipeError):
            send((dict(row), dict(best)))
        # After its last update a run is finished, so there is nothing to stop.
        total_steps = given["hyperparameters"].total_steps
        if row["steps"] < total_steps and select.select([sys.stdin], [], [], 0.0)[0]:
            signal.raise_signal(signal.SIGINT)

    try:
        load_modules(modules)
        given = pickle.load(sys.stdin.buffer)
        message = Outcome(folder, train(**given, on_row=on_row))
    except KeyboardInterrupt:
        message = None
    except Exception as error:
        message = Outcome(folder, None, str(error) or repr(error))
    with suppress(BrokenPipeError):
        send(message)
