"""The proof that a task needs all of its arms: tries to do it while one is still."""

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from collaborative_gym.certificate.budget import Budget
from collaborative_gym.certificate.play import Cast, Outcome, play
from collaborative_gym.certificate.report import Certificate, Trial
from collaborative_gym.certificate.rival import train_rival
from collaborative_gym.certificate.search import Motions, search
from collaborative_gym.certificate.starts import find_starts
from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_callback, check_kind
from collaborative_gym.files import check_writable, write_text
from collaborative_gym.learning.folder import claimed
from collaborative_gym.policies import Policy, as_policy
from collaborative_gym.rng import check_seed, training_seed
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task

FILE = "certificate.json"
"""Name of a certificate in its folder."""

_WORLDS = 256
"""Worlds beside one another; more run hardly faster."""

_TRAINING_STATES = 256
"""States that a training begins its episodes in."""

Row = tuple[str, str, float]
"""A still arm: its agent, its policy, and the fraction at which it froze."""


def certify(
    env: str | Task,
    *,
    budget: Budget | None = None,
    seed: int = 0,
    output: str | Path | None = None,
    num_threads: int = 0,
    on_trial: Callable[[Trial], object] | None = None,
    on_progress: Callable[[float], object] | None = None,
) -> Certificate:
    """Try to do a task while one arm is still, and return how often that worked.

    Each agent in turn is still in several ways: idle; idle with a closed grip, if the
    task has grips; and frozen on the expert's way to the goal, with the grip as it was.
    The other arms then play the task's expert; one motion for all starts, which a
    search finds on other starts; a motion for each start, which a search finds on that
    start; and, in the rows where nobody reached the goal and somebody came nearest, a
    policy that is trained for this. Except for the motions for each start, all play the
    first episodes of the seed, the same as `evaluate` does.

    Args:
      env: an environment id, a task's name, or a task.
      budget: how hard to try; None for `Budget()`, which takes hours.
      seed: of the episodes to judge on.
      output: a folder for `certificate.json`, written after each trial, and for the
        trainings. What it has of the same certificate is not done again. None to keep
        nothing.
      num_threads: physics threads, 0 for one per CPU.
      on_trial: called with each trial that is done.
      on_progress: called with the share that is done, 0 to 1.

    Raises:
      BlockingIOError: if the folder is in use by another process.
      ImportError: if there are trainings to do, and the extra `train` is missing.
      KeyError: if a name is unknown.
      OSError: if a file cannot be written, as on a full disk; what was there stays.
      TypeError: if something is of another kind.
      ValueError: if a number is out of range, the task has one arm or several sides,
        its expert does not reach the goal, or the folder has a damaged certificate or
        one of something else.
    """
    budget = Budget() if budget is None else budget
    check_kind("budget", budget, Budget, "a Budget")
    check_callback("on_trial", on_trial)
    check_callback("on_progress", on_progress)
    task = as_task(env)
    _check(task)
    training_seed(seed := check_seed(seed))
    if budget.ppo_steps and budget.ppo_rows:
        import collaborative_gym.learning.train  # noqa: F401  # Shows what is missing.
    with ExitStack() as stack:
        if output is None:
            folder = Path(stack.enter_context(TemporaryDirectory()))
        else:
            check_kind("output", output, (str, Path), "a folder's name")
            folder = Path(output)
            stack.enter_context(claimed(folder))
        work = _Work(task, budget, seed=seed, folder=folder, num_threads=num_threads)
        stack.enter_context(closing(work))
        return work.finish(on_trial, on_progress)


def _check(task: Task) -> None:
    if len(task.agents) < 2:
        raise ValueError(
            f"{task.name} has one arm, and needs it; certify a task of several"
        )
    if len(task.sides) > 1:
        raise ValueError(
            f"{task.name} has {len(task.sides)} sides; certify a task whose arms share"
            " one goal"
        )


class _Work:
    """A certificate that is being made.

    Args:
      task: what to do.
      budget: how hard to try.
      seed: of the episodes to judge on.
      folder: of its files.
      num_threads: physics threads, 0 for one per CPU.
    """

    def __init__(
        self, task: Task, budget: Budget, *, seed: int, folder: Path, num_threads: int
    ):
        self._task, self._budget, self._seed = task, budget, seed
        self._folder, self._num_threads = folder, num_threads
        settings = {
            "identity": Identity.of(task).to_dict(),
            "budget": asdict(budget) | {"fractions": list(budget.fractions)},
            "seed": seed,
        }
        blank = Certificate(task.name, settings)
        check_writable(folder / FILE)
        self._certificate = _resumed(blank, folder / FILE)
        tries = budget.candidates * max(budget.training_starts, budget.searched_starts)
        self._env = VectorEnv(
            task,
            min(_WORLDS, max(budget.episodes, tries)),
            num_threads=num_threads,
            auto_reset=False,
        )
        # Control steps, about: of all trials, of those done, and of the present one.
        self._total, self._done, self._cost, self._steps = 1.0, 0.0, 0.0, 0.0
        self._on_progress: Callable[[float], object] | None = None

    def close(self) -> None:
        """Free the worlds."""
        self._env.close()

    def finish(
        self,
        on_trial: Callable[[Trial], object] | None,
        on_progress: Callable[[float], object] | None,
    ) -> Certificate:
        """Do the trials that are left, and return the certificate."""
        self._on_progress = on_progress
        players = {
            "expert": lambda row: self._judge_policy(row, "expert"),
            "blind": self._play_blindly,
            "search": self._search_each,
            "ppo": self._train,
        }
        costs = self._costs()
        rows = self._rows()
        counts = {player: len(rows) for player in players}
        counts["ppo"] = min(self._budget.ppo_rows, len(rows))
        self._total = sum(costs[player] * counts[player] for player in players)
        for player, try_out in players.items():
            # A training must know how near the others came.
            for row in self._nearest_rows() if player == "ppo" else rows:
                self._cost, self._steps = costs[player], 0.0
                if costs[player] and not self._has(row, player):
                    self._keep(row, player, try_out(row), on_trial)
                self._done += costs[player]
                self._cost = 0.0
                self._advance(0.0)
        return self._certificate

    def _costs(self) -> dict[str, float]:
        """Return about how many control steps a trial of each player takes."""
        budget = self._budget
        judging = budget.episodes * self._task.config.max_episode_steps
        one = budget.rounds * budget.candidates * budget.motion_steps
        return {
            "expert": judging,
            "blind": judging + one * budget.training_starts,
            "search": one * budget.searched_starts,
            "ppo": budget.ppo_steps and judging + budget.ppo_steps,
        }

    def _rows(self) -> list[Row]:
        """Return the still arms, for each agent the same."""
        ways = [("idle", 0.0)]
        if self._task.gripping:
            ways.append(("gripping", 0.0))
        ways += [("frozen", fraction) for fraction in self._budget.fractions]
        return [(agent, *way) for agent in self._task.agents for way in ways]

    def _nearest_rows(self) -> list[Row]:
        """Return the rows to train in: the nearest of those least often completed."""
        rows = replace(
            self._certificate,
            trials=tuple(t for t in self._certificate.trials if t.player != "ppo"),
        ).rows

        def rank(row: Row) -> tuple[float, float]:
            trials = rows[row]
            most = max(trial.completion for trial in trials)
            return most, min(trial.nearest for trial in trials)

        return sorted(rows, key=rank)[: self._budget.ppo_rows]

    def _has(self, row: Row, player: str) -> bool:
        return any((t.row, t.player) == (row, player) for t in self._certificate.trials)

    def _keep(
        self,
        row: Row,
        player: str,
        outcome: Outcome,
        on_trial: Callable[[Trial], object] | None,
    ) -> None:
        """Write what came of a trial, so that it need not be done again."""
        trial = Trial(
            *row,
            player,
            episodes=len(outcome.completed),
            completed=int(outcome.completed.sum()),
            nearest=round(float(np.median(outcome.nearest)), 6),
        )
        trials = *self._certificate.trials, trial
        self._certificate = replace(self._certificate, trials=trials)
        write_text(self._folder / FILE, self._certificate.to_json())
        if on_trial is not None:
            on_trial(trial)

    def _advance(self, steps: float) -> None:
        self._steps += steps
        done = self._done + min(self._steps, self._cost)
        if self._on_progress is not None:
            self._on_progress(min(1.0, done / self._total))

    def _partners(self, row: Row) -> dict[str, str]:
        passive, partner, _ = row
        return {passive: partner}

    @cached_property
    def _held_out(self) -> dict[float, EnvState]:
        """The states to judge from, by the fraction of the expert's way."""
        return self._find_starts(self._seed, self._budget.episodes)

    @cached_property
    def _training(self) -> dict[float, EnvState]:
        """The states to search and to train from."""
        count = self._budget.training_starts
        if self._budget.ppo_steps:
            count = max(count, _TRAINING_STATES)
        return self._find_starts(training_seed(self._seed), count)

    def _find_starts(self, seed: int, count: int) -> dict[float, EnvState]:
        fractions = (0.0, *self._budget.fractions)
        found = find_starts(self._env, seed, count, fractions)
        for fraction, states in found.items():
            if not len(states.physics):
                raise ValueError(
                    f"{self._task.name}: in no episode is its expert at {fraction:.0%}"
                    " of its way while the goal is not met; mend the expert, or"
                    " give other fractions"
                )
        return found

    def _judge(self, row: Row, cast: Cast) -> Outcome:
        starts = self._held_out[row[2]]
        which = np.arange(len(starts.physics))
        return play(self._env, starts, which, cast, on_step=self._advance)

    def _judge_policy(self, row: Row, policy: str | Policy) -> Outcome:
        team: Any = dict.fromkeys(self._task.agents, policy) | self._partners(row)
        act = as_policy(team, self._env, any_env=True)
        return self._judge(row, lambda tries: act)

    def _play_blindly(self, row: Row) -> Outcome:
        starts = self._training[row[2]]
        group = np.arange(min(self._budget.training_starts, len(starts.physics)))
        best, _ = self._search(row, starts, group[None], "blind")
        motions = Motions(self._env, self._partners(row), self._budget)
        every = np.repeat(best, len(self._held_out[row[2]].physics), axis=0)
        return self._judge(row, motions.cast(every))

    def _search_each(self, row: Row) -> Outcome:
        starts = self._held_out[row[2]]
        groups = np.arange(min(self._budget.searched_starts, len(starts.physics)))
        return self._search(row, starts, groups[:, None], "search")[1]

    def _search(
        self, row: Row, starts: EnvState, groups: np.ndarray, player: str
    ) -> tuple[np.ndarray, Outcome]:
        number = self._rows().index(row)
        return search(
            self._env,
            starts,
            groups,
            motions=Motions(self._env, self._partners(row), self._budget),
            budget=self._budget,
            rng=np.random.default_rng([self._seed, number, player == "search"]),
            on_step=self._advance,
        )

    def _train(self, row: Row) -> Outcome:
        passive, partner, fraction = row
        policy = train_rival(
            self._task,
            self._training[fraction],
            (passive, partner),
            budget=self._budget,
            seed=self._seed,
            folder=self._folder / f"ppo-{passive}-{partner}-{fraction:.2f}",
            num_threads=self._num_threads,
            on_step=self._advance,
        )
        return self._judge_policy(row, policy)


def _resumed(blank: Certificate, path: Path) -> Certificate:
    """Return the certificate of a file, to go on with, or a blank one.

    Raises:
      ValueError: if it is damaged, or of something else; says what differs.
    """
    if not path.exists():
        return blank
    found = Certificate.load(path)
    own, other = (Identity.from_dict(c.settings["identity"]) for c in (blank, found))
    differs = own.differences(other)
    for name in ("seed", "budget"):
        mine, theirs = blank.settings[name], found.settings[name]
        if name == "budget" and not any(t.player == "ppo" for t in found.trials):
            # Trainings come last; more of them may be added.
            mine, theirs = (
                {key: n for key, n in each.items() if not key.startswith("ppo_")}
                for each in (mine, theirs)
            )
        if mine != theirs:
            differs.append(f"{name} is {mine}, not {theirs}")
    if differs:
        raise ValueError(
            f"{path} is another certificate: {'; '.join(differs)}; choose another"
            " output, or remove it"
        )
    return replace(blank, trials=found.trials)
