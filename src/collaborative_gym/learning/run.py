"""A run under way: learn, validate, show, save."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from collaborative_gym.evaluation import evaluate
from collaborative_gym.learning.backend import Backend, Iteration
from collaborative_gym.learning.casting import LEAGUE, SELF, Casting
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.collector import Job, OwnCollector
from collaborative_gym.learning.config import Resources
from collaborative_gym.learning.folder import BEST, LAST
from collaborative_gym.learning.monitor import Monitor, means_of, summarize
from collaborative_gym.learning.pool import Pool, read_guests
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.sac import SACLearner
from collaborative_gym.learning.seeds import validation_seed
from collaborative_gym.learning.settings import Settings, first_policy
from collaborative_gym.learning.team import Learner
from collaborative_gym.learning.validation import validate
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import POLICY_FILE, player_file
from collaborative_gym.tasks.task import Task

_LEARNERS = {"ppo": PPOLearner, "sac": SACLearner}

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
        `validation/completion`, `validation/performance` and `steps`. Where there are
        several sides, it is the last validation, and they are by side, as
        `validation/side_1/return`.
    """

    folder: Path
    settings: Settings
    steps: int
    seconds: float
    best: Mapping[str, float]

    def policy(self) -> NetworkPolicy:
        """Return the policy with the best validation."""
        return NetworkPolicy.load(self.folder / POLICY_FILE)


class Run:
    """A run, from its start or a checkpoint.

    Args:
      folder: where its files go.
      task: what to learn.
      settings: how.
      resources: what it may use.
      started: from where it goes on, None for the start.

    Raises:
      OSError: if a file cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        task: Task,
        *,
        settings: Settings,
        resources: Resources,
        started: Checkpoint | None,
    ):
        self._folder = folder
        self._task = task
        self._settings = settings
        self._num_threads = resources.num_threads
        self._casting = settings.casting(task)
        self._learners = settings.learners(task)
        self._pool = _make_pool(task, settings, folder, self._casting)
        self._backend = _make_backend(
            task, settings, resources, self._learners, self._casting
        )
        self._best = dict(started.best) if started is not None else {}
        self._before = started.seconds if started is not None else 0.0
        try:
            if started is not None:
                self._backend.load_state_dict(started.backend)
                self._pool.load_state_dict(started.pool)
            elif settings.start_from:
                self._backend.start(first_policy(settings, task))
            rows = started.rows if started is not None else ()
            self._monitor = Monitor(folder, settings.title, rows)
            self._since = time.monotonic()
            self._cores_before = rows[-1].get("core_seconds") if rows else 0.0
            self._cores_since = time.process_time()
            if started is None:
                self._save(LAST)
        except BaseException:
            self._backend.close()
            raise

    def finish(
        self, pressed: Event, *, checkpoint_interval: int, on_row: OnRow | None
    ) -> Result:
        """Train up to the last step, or until Ctrl-C is `pressed`."""
        hyperparameters = self._settings.hyperparameters
        while self._backend.steps < hyperparameters.total_steps:
            before, began = self._backend.steps, time.monotonic()
            iteration = self._backend.advance(self._pool.invitation(self._policy))
            self._check_finite(iteration)
            self._pool.study(iteration, self._backend, self._policy)
            steps = self._backend.steps
            rate = (steps - before) / (time.monotonic() - began)
            is_last = steps >= hyperparameters.total_steps
            is_due = _crosses(before, steps, hyperparameters.validation_interval)
            validation = self._validate() if is_due or is_last else None
            row = summarize(steps, self._seconds, rate, iteration, validation)
            row |= self._core_seconds()
            self._monitor.log(row)
            if validation is not None:
                self._keep_best(row)
                self._pool.publish()
            if _crosses(before, steps, checkpoint_interval) or is_last:
                self._save(LAST)
            if on_row is not None:
                on_row(row, self._best)
            if pressed.is_set():
                self._save(LAST)
                raise KeyboardInterrupt(f"stopped after {steps:,} steps")
        steps, seconds = self._backend.steps, self._seconds
        return Result(self._folder, self._settings, steps, seconds, self._best)

    def close(self) -> None:
        """Close the files and free the worlds."""
        try:
            self._monitor.close()
        finally:
            self._backend.close()

    @property
    def _seconds(self) -> float:
        return self._before + time.monotonic() - self._since

    def _core_seconds(self) -> Mapping[str, float]:
        """Return the CPU time so far, of all threads, unless it is not known.

        Ray's collectors take theirs elsewhere.
        """
        before = self._cores_before
        if before is None or self._settings.backend == "ray":
            return {}
        return {"core_seconds": before + time.process_time() - self._cores_since}

    def _policy(self, member: str) -> NetworkPolicy:
        """Return a member's policy as it is now."""
        settings, content = self._settings, self._settings.to_dict()
        kept = (
            "algorithm",
            "mode",
            "seed",
            "backend",
            "hyperparameters",
            "opponents",
            "partners",
            "start_from",
            "start",
        )
        learners = [each for each in self._learners if each.member == member]
        return NetworkPolicy(
            [part for learner in learners for part in learner.parts],
            self._backend.weights(member),
            activation=settings.hyperparameters.activation,
            identity=settings.identity,
            layout=settings.layout,
            metadata={name: content[name] for name in kept}
            | {"steps": self._backend.steps, "member": member},
        )

    def _validate(self) -> Mapping[str, float]:
        """Return the means of a validation beside those with whom the run learns."""
        episodes = self._settings.hyperparameters.validation_episodes
        given: Any = {
            "episodes": episodes,
            "seed": validation_seed(self._settings.seed),
            "num_threads": self._num_threads,
        }
        members = self._casting.members
        if not self._casting.seats:
            return means_of(evaluate(self._task, self._policy(members[0]), **given))
        policies = {name: self._policy(name) for name in members} | self._pool.policies
        pairings = self._pool.pairings(members[0])
        return validate(self._task, self._casting, policies, pairings, **given)

    def _keep_best(self, row: Mapping[str, float]) -> None:
        # Of opponents one gains what another loses: the latest policies count as best,
        # unless their opponents stay as they are.
        is_latest_best = {SELF, LEAGUE} & set(self._settings.opponents)
        if (
            self._best
            and not is_latest_best
            and self._rank(row) <= self._rank(self._best)
        ):
            return
        self._best = {
            column: value
            for column, value in row.items()
            if column == "steps" or column.startswith("validation/")
        }
        members = self._casting.members
        self._policy(members[0]).save(self._folder / POLICY_FILE)
        if len(members) > 1:
            for name in members:
                self._policy(name).save(self._folder / player_file(name))
        self._save(BEST)

    def _rank(self, row: Mapping[str, float]) -> tuple[float, ...]:
        """Return by what the best validation is chosen.

        Against opponents it is the points, then the return; else the return. Where
        training charges for more than the reward, returns are best before it does:
        there it is completion and performance in percent, and of equals the latest.
        """
        if "validation/points" in row:
            return row["validation/points"], row["validation/return"]
        if not self._settings.hyperparameters.has_prices:
            return (row["validation/return"],)
        shares = row["validation/completion"], row["validation/performance"]
        return *(round(share, 2) for share in shares), row["steps"]

    def _save(self, name: str) -> None:
        Checkpoint(
            self._settings,
            self._backend.state_dict(),
            self._monitor.rows,
            self._best,
            self._seconds,
            self._pool.state_dict(),
        ).save(self._folder / name)

    def _check_finite(self, iteration: Iteration) -> None:
        for learner, update in iteration.updates.items():
            for name, value in update.items():
                if not math.isfinite(value):
                    raise RuntimeError(
                        f"{name} of {learner} is {value} after"
                        f" {self._backend.steps:,} steps; the last good checkpoint is"
                        f" {self._folder / LAST}. A lower learning rate may help"
                    )


def _make_pool(task: Task, settings: Settings, folder: Path, casting: Casting) -> Pool:
    guests = read_guests(task, casting, settings.opponents or settings.partners)
    if LEAGUE not in settings.opponents:
        return Pool(casting, guests)
    # Imports SciPy and Matplotlib, which take time; only a league needs them.
    from collaborative_gym.learning.league import League

    return League(
        casting,
        guests,
        hyperparameters=settings.hyperparameters,
        folder=folder,
        title=settings.title,
        seed=settings.seed,
    )


def _make_backend(
    task: Task,
    settings: Settings,
    resources: Resources,
    learners: Sequence[Learner],
    casting: Casting,
) -> Backend:
    hyperparameters = settings.hyperparameters
    learns = _LEARNERS[settings.algorithm]
    layout = settings.layout
    job = Job(
        task,
        tuple(learners),
        layout,
        settings.seed,
        hyperparameters,
        resources.num_threads,
        casting,
    )
    if settings.backend == "ray":
        from collaborative_gym.learning.ray_collectors import RayCollectors

        address = resources.ray_address
        collectors = RayCollectors(job, resources.num_collectors, address)
    elif resources.num_collectors or resources.ray_address:
        raise ValueError("num_collectors and ray_address go with the backend ray")
    else:
        collectors = OwnCollector(job)
    return Backend(
        [
            learns(each, layout, hyperparameters, resources.device, casting)
            for each in learners
        ],
        collectors,
        hyperparameters,
    )


def _crosses(before: int, after: int, interval: int) -> bool:
    """Return whether a multiple of the interval lies between; 0 for no interval."""
    return bool(interval) and before // interval < after // interval
