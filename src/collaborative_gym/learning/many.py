"""Many runs, several at a time, each in a process of its own."""

import os
import pickle
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, Queue
from tempfile import TemporaryFile
from threading import Event, Lock
from typing import Any, Unpack

from collaborative_gym.errors import (
    check_callback,
    check_count,
    check_flag,
    check_kind,
    check_name,
)
from collaborative_gym.evaluation.machine import cores
from collaborative_gym.learning.config import Mode, Resources, recipe
from collaborative_gym.learning.display import ManyDisplay
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.settings import Options, make_settings, take_interval
from collaborative_gym.learning.stopping import ctrl_c
from collaborative_gym.learning.train import Result, train
from collaborative_gym.plugins import load_modules, loaded_files
from collaborative_gym.rng import check_run_seed
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task

_COMMAND = [
    sys.executable,
    "-c",
    "from collaborative_gym.learning.many import train_one; train_one()",
]
"""Trains the run that its standard input describes."""

_HEED = 0.2  # longest time until Ctrl-C is heeded, in s


@dataclass(frozen=True)
class Plan:
    """A run that is to be trained, or to go on.

    Attributes:
      folder: where its files go; its name says what it is.
      total_steps: environment steps of the whole run.
      given: the arguments of `train`.
    """

    folder: Path
    total_steps: int
    given: Mapping[str, Any]


@dataclass(frozen=True)
class Outcome:
    """The end of a run: its result, or why it failed.

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
    on_row: OnRow | None = None,
    progress: bool = False,
    **options: Unpack[Options],
) -> tuple[Outcome, ...]:
    """Train every environment in every mode with every seed, several at a time.

    Each run has a folder of its own in `output`, named after environment, mode and
    seed, and a process of its own. A run that fails does not end the others. Ctrl-C
    ends all, each after its current update; the same call then continues those that are
    not finished. Wrong arguments raise before the work.

    Args:
      envs: environment ids, tasks' names, or tasks (your own after `load_module`).
      modes: who learns what, as in `train`; None for the usual one.
      seeds: of the runs in each mode.
      jobs: processes at a time, 0 for one per CPU. Where there are several, each has
        one physics thread unless `resources` say otherwise.
      output: the folder of all runs.
      changes: hyperparameters to use instead of each environment's recipe's, by name.
      advised: whether they learn with the expert's advice, by recipes of its own.
      on_row: called with a plan after each of its iterations, with its numbers.
      progress: whether to show the progress, as the command line does.
      options: partners, start, algorithm and resources, see `Options`.

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
    every = {"checkpoint_interval": take_interval(options)}
    check_callback("on_row", on_row)
    check_kind("output", output, (str, Path), "a folder's name")
    resources = options.pop("resources", None)
    advised, progress = check_flag("advised", advised), check_flag("progress", progress)
    algorithm = options.get("algorithm") or "ppo"
    plans: dict[Path, Plan] = {}
    for env in _several("environment", envs):
        if not isinstance(env, Task):
            check_name("each environment", env)
        task = as_task(env)
        numbers = recipe(task.name, algorithm, advised=advised, changes=changes)
        for mode in (None,) if modes is None else _several("mode", modes):
            own = {"mode": mode, "hyperparameters": numbers, **options}
            common = make_settings(task, **own)
            for seed in _several("seed", seeds):
                settings = replace(common, seed=check_run_seed(seed))
                folder = Path(output) / settings.folder.name
                if folder in plans:
                    raise ValueError(f"{folder.name} is asked for twice; ask once")
                given = {"env": task, "seed": settings.seed, **own} | every
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
        found = _Crew(resources, pressed).work(plans, jobs, on_row)
        outcomes = tuple(each for each in found if each is not None)
        if pressed.is_set():
            done = sum(each.result is not None for each in outcomes)
            raise KeyboardInterrupt(
                f"stopped with {done} of {len(plans)} runs finished"
            )
    return outcomes


class _Crew:
    """Processes that train runs, one each, until Ctrl-C is `pressed`."""

    def __init__(self, resources: Resources, pressed: Event):
        self._resources, self._pressed = resources, pressed
        self._rows: Queue[tuple[Plan, Any] | None] = Queue()
        self._under_way: list[subprocess.Popen[bytes]] = []
        self._lock = Lock()

    def work(
        self, plans: Sequence[Plan], jobs: int, on_row: OnRow
    ) -> list[Outcome | None]:
        """Return the outcomes of runs, None for those that Ctrl-C stopped."""
        with ThreadPoolExecutor(jobs) as threads:
            runs = [threads.submit(self._train, plan) for plan in plans]
            for run in runs:
                run.add_done_callback(lambda _: self._rows.put(None))
            try:
                while not (all(run.done() for run in runs) and self._rows.empty()):
                    with suppress(Empty):
                        if row := self._rows.get(timeout=_HEED):
                            on_row(row[0], *row[1])
                    if self._pressed.is_set():
                        with self._lock, suppress(BrokenPipeError):
                            for process in self._under_way:
                                process.stdin.close()  # type: ignore[union-attr]
            except BaseException:
                with self._lock:
                    self._pressed.set()  # So that no thread begins another run.
                    for process in self._under_way:
                        process.kill()
                raise
        return [run.result() for run in runs]

    def _train(self, plan: Plan) -> Outcome | None:
        is_there = (plan.folder / LAST).exists()
        given = dict(plan.given) | {"resources": self._resources}
        given["resume" if is_there else "output"] = plan.folder
        pipe = subprocess.PIPE
        with ExitStack() as stack:
            said = stack.enter_context(TemporaryFile())
            with self._lock:
                if self._pressed.is_set():
                    return None
                process = subprocess.Popen(
                    _COMMAND, stdin=pipe, stdout=pipe, stderr=said, process_group=0
                )
                # It may be gone already; its last words say why.
                stack.enter_context(suppress(BrokenPipeError))
                stack.enter_context(process)
                self._under_way.append(process)
                assert process.stdin is not None and process.stdout is not None
                with suppress(BrokenPipeError):
                    # Of a task of the user's own, its file must be loaded before it.
                    pickle.dump((loaded_files(), plan.folder), process.stdin)
                    pickle.dump(given, process.stdin)
                    process.stdin.flush()
            try:
                while isinstance(message := pickle.load(process.stdout), tuple):
                    self._rows.put((plan, message))
                return message
            except (EOFError, pickle.UnpicklingError):
                said.seek(0)
                last = said.read().decode(errors="replace").strip().splitlines()[-1:]
                words = f"its process ended with status {process.wait()}"
                return Outcome(plan.folder, None, ": ".join([words, *last]))


def _several(kind: str, given: Any) -> Sequence[Any]:
    if isinstance(given, str | Task):
        return [given]
    a = f"one {kind} or several"
    check_kind(f"{kind}s", given, Sequence, a)
    if not given:
        raise ValueError(f"give at least one {kind}")
    return given


def train_one() -> None:
    """Train the run that standard input describes, until it is done or input ends."""
    # A parent may have made its children ignore it.
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
