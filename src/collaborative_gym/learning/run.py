"""A run under way: learn, validate, show, save."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import torch

from collaborative_gym.envs.world import World
from collaborative_gym.evaluation import evaluate
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.casting import LEAGUE, SELF
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.collector import Collected, Collector, Collectors, Job
from collaborative_gym.learning.config import PENALTIES, Resources
from collaborative_gym.learning.folder import BEST, LAST
from collaborative_gym.learning.learner import SkrlLearner
from collaborative_gym.learning.monitor import Monitor, means_of, summarize
from collaborative_gym.learning.pool import Iteration, Pool, read_guests
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.sac import SACLearner
from collaborative_gym.learning.settings import Settings, first_policy
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import POLICY_FILE, player_file
from collaborative_gym.rng import validation_seed
from collaborative_gym.tasks.registry import disturbed, resized
from collaborative_gym.tasks.task import Task

_LEARNERS = {"ppo": PPOLearner, "sac": SACLearner}

_CRITIC_ALONE = 10
"""Rollouts in which only the critics learn if the run begins with a policy, which the
estimates of a new critic would make forget all it knows."""

OnRow = Callable[[Mapping[str, float], Mapping[str, float]], object]
"""Gets an iteration's row and that of the best validation so far (or nothing)."""


@dataclass(frozen=True)
class Result:
    """A finished training run.

    Attributes:
      folder: where its files are.
      settings: with which it was started.
      steps: environment steps that it took.
      seconds: time that it took.
      best: means of the best validation: `validation/return`, `validation/completion`,
        `validation/performance` and `steps`. With opponents `self` or `league` it is
        the last validation. Several sides have their own, as
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
    """A run, from its start or a checkpoint: collectors, and learners in this process.

    It draws from torch's own generators, which the caller seeds.

    Args:
      folder: where its files go.
      task: what to learn.
      settings: how.
      resources: device, threads and collectors.
      started: from where it goes on, None for the start.

    Attributes:
      steps: environment steps done so far, over all worlds.

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
        started: Checkpoint | None = None,
    ):
        self._folder, self._task, self._settings = folder, task, settings
        self._hyperparameters = settings.hyperparameters
        self._num_threads = resources.num_threads
        self._casting = settings.casting(task)
        self._pool = self._make_pool()
        self._assistance = Assistance(settings.hyperparameters.assistance)
        self.steps = self._iteration = 0
        self._has_policy, self._quietness = bool(settings.start_from), 0.0
        self._best: dict[str, float] = dict(started.best) if started else {}
        self._before = started.seconds if started else 0.0
        self._collectors = _make_collectors(task, settings, resources)
        try:
            learns = _LEARNERS[settings.algorithm]
            how = settings.hyperparameters, resources.device, self._casting
            self._learners: dict[str, SkrlLearner] = {
                each.name: learns(each, settings.layout, *how)
                for each in settings.learners(task)
            }
            if started is None and settings.start_from:
                policy = first_policy(settings, task)
                for learner in self._learners.values():
                    learner.start(policy)
            self._first = {
                name: deepcopy(each.state_dict())
                for name, each in self._learners.items()
                if each.learner.member
            }
            if started is not None:
                self.load_state_dict(started.backend)
                self._pool.load_state_dict(started.pool)
            rows = started.rows if started else ()
            self._monitor = Monitor(folder, settings.title, rows)
            self._since = time.monotonic()
            self._cores_before = rows[-1].get("core_seconds") if rows else 0.0
            self._cores_since = time.process_time()
            if started is None:
                self._save(LAST)
        except BaseException:
            self._collectors.close()
            raise

    def finish(
        self, pressed: Event, *, checkpoint_interval: int, on_rows: Sequence[OnRow]
    ) -> Result:
        """Train up to the last step, or until Ctrl-C is `pressed`."""
        numbers = self._hyperparameters
        while self.steps < numbers.total_steps:
            before, began = self.steps, time.monotonic()
            iteration = self.advance()
            steps = self.steps
            rate = (steps - before) / (time.monotonic() - began)
            is_last = steps >= numbers.total_steps
            is_due = _crosses(before, steps, numbers.validation_interval)
            validation = self._validate() if is_due or is_last else None
            row = summarize(steps, self._seconds, rate, iteration, validation)
            row |= self._core_seconds()
            self._monitor.log(row)
            if validation is not None:
                self._keep_best(row)
                self._pool.publish()
            if _crosses(before, steps, checkpoint_interval) or is_last:
                self._save(LAST)
            for on_row in on_rows:
                on_row(row, self._best)
            if pressed.is_set():
                self._save(LAST)
                none = " before the first validation, so there is no policy yet"
                why = f"stopped after {steps:,} steps{none * (not self._best)}"
                raise KeyboardInterrupt(why)
        seconds = self._seconds
        return Result(self._folder, self._settings, self.steps, seconds, self._best)

    def collect(self) -> list[Collected]:
        """Return one rollout of every collector that is alive; the worlds go on.

        Raises:
          RuntimeError: if the task fails in a collector elsewhere, or none answers.
        """
        actors = {name: each.acting() for name, each in self._learners.items()}
        invitation = self._pool.invitation(self.policy)
        return self._collectors.collect(
            actors, self._iteration, self._assistance, invitation
        )

    def advance(self) -> Iteration:
        """Collect one rollout in every world, and learn from it.

        Raises:
          RuntimeError: as `collect` does, or if a loss is not finite.
        """
        collected = self.collect()
        episodes = [row for each in collected for row in each.episodes]
        self._assistance.adapt(episodes)
        critic_alone = self._has_policy and self._iteration < _CRITIC_ALONE
        updates = {
            name: learner.learn(
                [each.rollouts[name] for each in collected], critic_alone=critic_alone
            )
            for name, learner in self._learners.items()
        }
        self._iteration += 1
        self.steps += sum(each.steps for each in collected)
        self._shrink_noise()
        seated = [names for each in collected for names in each.seated]
        iteration = Iteration(episodes, updates, seated)
        for learner, update in updates.items():
            for name, value in update.items():
                if not math.isfinite(value):
                    raise RuntimeError(
                        f"{name} of {learner} is {value} after {self.steps:,} steps;"
                        f" the last good checkpoint is {self._folder / LAST}. A lower"
                        " learning rate may help"
                    )
        for member, like in self._pool.study(iteration, self.steps, self.policy):
            self.restart(member, like)
        return iteration

    def policy(self, member: str) -> NetworkPolicy:
        """Return a member's policy as it is now."""
        settings, own = self._settings, self._of(member)
        return NetworkPolicy(
            [part for each in own for part in each.learner.parts],
            {name: net for each in own for name, net in each.weights().items()},
            activation=self._hyperparameters.activation,
            identity=settings.identity,
            layout=settings.layout,
            metadata=settings.how() | {"steps": self.steps, "member": member},
        )

    def restart(self, member: str, like: str | None) -> None:
        """Replace a member's networks by another's, for None by its own first ones."""
        if like is None:
            states = [self._first[each.learner.name] for each in self._of(member)]
        else:
            states = [each.state_dict() for each in self._of(like)]
        for learner, state in zip(self._of(member), states, strict=True):
            learner.load_state_dict(deepcopy(state))

    def close(self) -> None:
        """Close the files and free the worlds. No other call is allowed afterwards."""
        try:
            self._monitor.close()
        finally:
            self._collectors.close()

    def _make_pool(self) -> Pool:
        settings, casting = self._settings, self._casting
        words = settings.opponents or settings.partners
        guests = read_guests(self._task, casting, words)
        if LEAGUE not in settings.opponents:
            return Pool(casting, guests)
        # Imports SciPy and Matplotlib, which take time; only a league needs them.
        from collaborative_gym.learning.league import League

        return League(
            casting,
            guests,
            hyperparameters=settings.hyperparameters,
            folder=self._folder,
            title=settings.title,
            seed=settings.seed,
        )

    def _shrink_noise(self) -> None:
        """Let the noise shrink as far as it should have by now, and never grow."""
        numbers = self._hyperparameters
        due = self._assistance.demand
        if numbers.quiet_share:
            left = (numbers.total_steps - self.steps) / numbers.total_steps
            due = 1.0 - min(max(left / numbers.quiet_share, 0.0), 1.0)
        # A run that was made longer may have shrunk it further than is due.
        further = max(due - self._quietness, 0.0)
        self._quietness = max(due, self._quietness)
        for learner in self._learners.values():
            learner.scale_noise(numbers.final_noise**further)

    def _of(self, member: str) -> list[SkrlLearner]:
        learners = self._learners.values()
        return [each for each in learners if each.learner.member == member]

    def state_dict(self) -> dict[str, Any]:
        """Return all of learners and worlds that is needed to go on.

        It is nested tensors, numbers and texts. On CPUs a run goes on from it bit for
        bit, unless a collector was lost.
        """
        cuda = torch.cuda.is_initialized()
        return {
            "steps": self.steps,
            "iteration": self._iteration,
            "assistance": self._assistance.state_dict(),
            "has_policy": self._has_policy,
            "quietness": self._quietness,
            "learners": {n: each.state_dict() for n, each in self._learners.items()},
            "first": self._first,
            "generator": torch.get_rng_state(),
            "cuda_generators": torch.cuda.get_rng_state_all() if cuda else [],
            "worlds": self._collectors.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        With another number of collectors than it had, the worlds begin new episodes.
        """
        worlds, self._first = state["worlds"], state["first"]
        if len(worlds) == self._collectors.count:
            self._collectors.load_state_dict(worlds)
        self.steps, self._iteration = state["steps"], state["iteration"]
        self._assistance.load_state_dict(state["assistance"])
        self._has_policy, self._quietness = state["has_policy"], state["quietness"]
        for name, learner in self._learners.items():
            learner.load_state_dict(state["learners"][name])
            if self._has_policy:
                learner.hold_statistics()
        torch.set_rng_state(state["generator"])
        if torch.cuda.is_initialized() and state["cuda_generators"]:
            torch.cuda.set_rng_state_all(state["cuda_generators"])

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

    def _validate(self) -> Mapping[str, float]:
        given: Any = {
            "episodes": self._hyperparameters.validation_episodes,
            "seed": validation_seed(self._settings.seed),
            "num_threads": self._num_threads,
        }
        if not self._casting.seats:
            policy = self.policy(self._casting.members[0])
            return means_of(evaluate(self._task, policy, **given))
        return self._pool.validate(self._task, self.policy, **given)

    def _keep_best(self, row: Mapping[str, float]) -> None:
        # Of opponents one gains what another loses: the latest policies count as best,
        # unless their opponents stay as they are.
        is_latest_best = {SELF, LEAGUE} & set(self._settings.opponents)
        is_known = self._best and not is_latest_best
        if is_known and self._rank(row) <= self._rank(self._best):
            return
        self._best = {
            column: value
            for column, value in row.items()
            if column == "steps" or column.startswith("validation/")
        }
        members = self._casting.members
        self.policy(members[0]).save(self._folder / POLICY_FILE)
        if len(members) > 1:
            for name in members:
                self.policy(name).save(self._folder / player_file(name))
        self._save(BEST)

    def _rank(self, row: Mapping[str, float]) -> tuple[float, ...]:
        """Return the numbers whose greatest is the best validation.

        Against opponents these are the points, then the return; else the return. Where
        training charges for more than the reward, returns are best before it does:
        there it is completion and performance in percent, and of equals the latest.
        """
        if "validation/points" in row:
            return row["validation/points"], row["validation/return"]
        if not any(getattr(self._hyperparameters, name) for name in PENALTIES):
            return (row["validation/return"],)
        shares = row["validation/completion"], row["validation/performance"]
        return *(round(share, 2) for share in shares), row["steps"]

    def _save(self, name: str) -> None:
        state, pool = self.state_dict(), self._pool.state_dict()
        so_far = self._monitor.rows, self._best, self._seconds, pool
        Checkpoint(self._settings, state, *so_far).save(self._folder / name)


def _make_collectors(task: Task, settings: Settings, resources: Resources) -> Any:
    if settings.hyperparameters.mishaps:
        task = disturbed(task, lost=settings.hyperparameters.mishaps)
    teams = task, *(resized(task, n) for n in settings.hyperparameters.team_sizes)
    how = settings.seed, settings.hyperparameters, resources.num_threads

    def job(team: Task) -> Job:
        layout = World.of(team, strain=True).definition.layout
        return Job(team, settings.learners(team), layout, *how, settings.casting(team))

    first, *others = map(job, teams)
    if settings.backend != "ray":
        return Collectors([first, *others]) if others else Collector(first)
    from collaborative_gym.learning.ray_collectors import RayCollectors

    return RayCollectors(first, resources.num_collectors, resources.ray_address)


def _crosses(before: int, after: int, interval: int) -> bool:
    """Return whether a multiple of the interval lies between; 0 for no interval."""
    return bool(interval) and before // interval < after // interval
