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
from collaborative_gym.certificate.report import TEAM, Certificate, Trial
from collaborative_gym.certificate.rival import train_rival
from collaborative_gym.certificate.search import (
    Motions,
    record_actions,
    search,
    starts_each,
)
from collaborative_gym.certificate.tries import Cast, Results, find_starts, play
from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_callback, check_kind
from collaborative_gym.evaluation.play import OnProgress, parts_of
from collaborative_gym.files import check_writable, write_text
from collaborative_gym.learning.folder import claimed
from collaborative_gym.policies import Policy, as_played, as_policy
from collaborative_gym.rng import check_seed, training_seed
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Randomization, Task

FILE = "certificate.json"
"""Name of a certificate in its folder."""

_WORLDS = 256  # number of worlds; more run hardly faster
_TRAINING_STATES = 256  # number of states in which a training begins its episodes

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
    on_progress: OnProgress = None,
) -> Certificate:
    """Try to do a task while one arm is still, and return how often that worked.

    Each agent in turn is still in several ways: idle; limp, without any torque; if the
    task has grips, idle but gripping what it meets, and absent, so that nothing touches
    it; and frozen on the expert's way to the goal, with the grip as it was. The other
    arms then play the task's expert; one motion for all starts, which a search finds on
    other starts; a motion for each start, which a search finds on that start; and,
    where all of these failed but one came nearest to the goal, a policy that is trained
    beside the still arm. Then all arms play blindly: one motion for all starts, and the
    best of some recorded episodes. Except for the motions for each start, all play the
    first episodes of the seed, the same as `evaluate` does.

    Args:
      env: an environment id, a task's name, or a task.
      budget: the effort; None for `Budget()`, which takes hours.
      seed: seed of the episodes to judge on.
      output: a folder for `certificate.json`, written after each trial, and for the
        trainings. What it has of the same certificate is kept. None to keep nothing.
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
    if len(task.agents) < 2:
        raise ValueError(
            f"{task.name} has one arm, and needs it; certify a task of several"
        )
    if len(task.sides) > 1:
        raise ValueError(
            f"{task.name} has {len(task.sides)} sides; certify a task whose arms share"
            " one goal"
        )
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
        work = Work(task, budget, seed=seed, folder=folder, num_threads=num_threads)
        stack.enter_context(closing(work))
        return work.finish(on_trial, on_progress)


class Work:
    """A certificate in the making; its worlds are freed by `close`.

    The arguments are those of `certify`, checked.
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
        check_writable(folder / FILE)
        self._certificate = _resumed(Certificate(task.name, settings), folder / FILE)
        # Where a thing is fixed in a hand, no arm can be away without it.
        free = ["gripping", "absent"] if task.gripping else []
        ways = [(way, 0.0) for way in ("idle", "limp", *free)]
        ways += [("frozen", fraction) for fraction in budget.fractions]
        self._rows: list[Row] = [(agent, *way) for agent in task.agents for way in ways]
        self._envs: dict[Randomization, VectorEnv] = {}
        self._env = self._worlds_of(TEAM)
        self._on_steps: Callable[[float], object] = lambda steps: None

    def close(self) -> None:
        """Free the worlds."""
        for env in self._envs.values():
            env.close()

    def _worlds_of(self, row: Row) -> VectorEnv:
        """Return the worlds to try a row in; a limp or an absent arm has its own."""
        task, budget = as_played(self._task, _still(row)), self._budget
        tries = budget.candidates * max(budget.training_starts, budget.searched_starts)
        drawn = task.config.randomization
        if drawn not in self._envs:
            self._envs[drawn] = VectorEnv(
                task,
                min(_WORLDS, max(budget.episodes, tries)),
                num_threads=self._num_threads,
                auto_reset=False,
            )
        return self._envs[drawn]

    def finish(
        self, on_trial: Callable[[Trial], object] | None, on_progress: OnProgress
    ) -> Certificate:
        """Do the trials that are left, and return the certificate."""
        players: dict[str, Callable[[Row], Results]] = {
            "expert": lambda row: self._judge_policy(row, "expert"),
            "blind": self._play_blindly,
            "search": self._search_each,
            "replay": self._replay,
            "ppo": self._train,
        }
        costs, team = self._costs(), [TEAM] * bool(self._budget.replays)
        rows = dict.fromkeys(players, self._rows)
        rows |= {"blind": [*self._rows, *team], "replay": team}
        counts = {player: len(own) for player, own in rows.items()}
        counts["ppo"] = min(self._budget.ppo_rows, counts["ppo"])
        sizes = [costs[player] for player in players for _ in range(counts[player])]
        parts = iter(parts_of(on_progress, sizes))
        done = {(trial.row, trial.player) for trial in self._certificate.trials}
        for player, try_out in players.items():
            # A training must know how near the others came.
            for row in self._nearest_rows() if player == "ppo" else rows[player]:
                part = next(parts) or (lambda share: None)
                self._on_steps = _counting(part, costs[player])
                if costs[player] and (row, player) not in done:
                    found = try_out(row)
                    trial = Trial(
                        *row,
                        player,
                        episodes=len(found.completed),
                        completed=int(found.completed.sum()),
                        nearest=round(float(np.median(found.nearest)), 6),
                        converged=found.converged,
                    )
                    trials = *self._certificate.trials, trial
                    self._certificate = replace(self._certificate, trials=trials)
                    write_text(self._folder / FILE, self._certificate.to_json())
                    if on_trial is not None:
                        on_trial(trial)
                part(1.0)
        return self._certificate

    def blind_team(self) -> tuple[Results, Results]:
        """Return the blind team's results, of one motion and of a recorded episode."""
        return self._play_blindly(TEAM), self._replay(TEAM)

    def _costs(self) -> dict[str, int]:
        """Return about how many control steps a trial of each player takes."""
        budget = self._budget
        length = self._task.config.max_episode_steps
        judging = budget.episodes * length
        one = budget.rounds * budget.candidates * budget.motion_steps
        return {
            "expert": judging,
            "blind": judging + round(one * starts_each(budget.training_starts)),
            "search": one * budget.searched_starts,
            "replay": judging + length * budget.replays * (1 + budget.training_starts),
            "ppo": budget.ppo_steps and judging + budget.ppo_steps,
        }

    def _nearest_rows(self) -> list[Row]:
        """Return the rows to train in: the nearest of those least often completed."""
        others = [t for t in self._certificate.trials if t.player != "ppo"]
        found = replace(self._certificate, trials=tuple(others)).rows
        rows = {row: trials for row, trials in found.items() if row != TEAM}

        def rank(row: Row) -> tuple[float, float]:
            trials = rows[row]
            return max(t.completion for t in trials), min(t.nearest for t in trials)

        return sorted(rows, key=rank)[: self._budget.ppo_rows]

    @cached_property
    def _held_out(self) -> dict[float, EnvState]:
        """The states to judge from, by the fraction of the expert's way."""
        return self._find_starts(self._seed, self._budget.episodes)

    @cached_property
    def _training(self) -> dict[float, EnvState]:
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
                    " of its way while the goal is not met; fix the expert, or"
                    " give other fractions"
                )
        return found

    def _judge(self, row: Row, cast: Cast) -> Results:
        starts, env = self._held_out[row[2]], self._worlds_of(row)
        which = np.arange(len(starts.physics))
        return play(env, starts, which, cast, on_step=self._on_steps)

    def _judge_policy(self, row: Row, policy: str | Policy) -> Results:
        team: Any = dict.fromkeys(self._task.agents, policy) | _still(row)
        act = as_policy(team, self._worlds_of(row), any_env=True)
        return self._judge(row, lambda tries: act)

    def _play_blindly(self, row: Row) -> Results:
        starts = self._training[row[2]]
        group = np.arange(min(self._budget.training_starts, len(starts.physics)))
        motions, record = self._motions(row), 0
        if row == TEAM:
            record = self._best_record(motions, starts, group)
        found = self._search(row, motions, starts, group[None], "blind", record)
        judged = self._judge_motion(row, motions, found[0], record)
        return judged._replace(converged=found[1].converged)

    def _search_each(self, row: Row) -> Results:
        starts, motions = self._held_out[row[2]], self._motions(row)
        groups = np.arange(min(self._budget.searched_starts, len(starts.physics)))
        return self._search(row, motions, starts, groups[:, None], "search")[1]

    def _replay(self, row: Row) -> Results:
        motions, starts = self._motions(row), self._training[0.0]
        group = np.arange(min(self._budget.training_starts, len(starts.physics)))
        record = self._best_record(motions, starts, group)
        return self._judge_motion(row, motions, np.zeros((1, *motions.shape)), record)

    def _best_record(
        self, motions: Motions, starts: EnvState, group: np.ndarray
    ) -> int:
        count = len(motions.records)
        episodes = np.repeat(np.arange(count), len(group))
        cast = motions.cast(np.zeros((len(episodes), *motions.shape)), episodes)
        which = np.tile(group, count)
        tried = play(self._env, starts, which, cast, on_step=self._on_steps)
        cost = (tried.nearest - tried.completed).reshape(count, len(group))
        return int(cost.mean(axis=1).argmin())

    def _judge_motion(
        self, row: Row, motions: Motions, motion: np.ndarray, record: int
    ) -> Results:
        count = len(self._held_out[row[2]].physics)
        every = np.repeat(motion, count, axis=0)
        return self._judge(row, motions.cast(every, np.full(count, record)))

    def _motions(self, row: Row) -> Motions:
        records = self._records if row == TEAM else None
        return Motions(self._worlds_of(row), _still(row), self._budget, records)

    @cached_property
    def _records(self) -> np.ndarray:
        """Episodes that the blind team begins with; nothing else is tried on them."""
        return record_actions(
            self._env, training_seed(self._seed), self._budget.replays
        )

    def _search(
        self,
        row: Row,
        motions: Motions,
        starts: EnvState,
        groups: np.ndarray,
        player: str,
        record: int = 0,
    ) -> tuple[np.ndarray, Results]:
        index = len(self._rows) if row == TEAM else self._rows.index(row)
        seeds = [self._seed, index, player == "search"]
        return search(
            self._worlds_of(row),
            starts,
            groups,
            motions=motions,
            budget=self._budget,
            rng=np.random.default_rng(seeds),
            record=record,
            on_step=self._on_steps,
        )

    def _train(self, row: Row) -> Results:
        passive, partner, fraction = row
        policy = train_rival(
            as_played(self._task, _still(row)),
            self._training[fraction],
            (passive, partner),
            budget=self._budget,
            seed=self._seed,
            folder=self._folder / f"ppo-{passive}-{partner}-{fraction:.2f}",
            num_threads=self._num_threads,
            on_step=self._on_steps,
        )
        return self._judge_policy(row, policy)


def _still(row: Row) -> dict[str, str]:
    return {} if row == TEAM else {row[0]: row[1]}


def _counting(part: Callable[[float], object], cost: int) -> Callable[[float], object]:
    """Return a function that adds up steps and reports their share of `cost`."""
    done = 0.0

    def add(steps: float) -> None:
        nonlocal done
        done += steps
        part(min(1.0, done / cost))

    return add


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
    has_trained = any(t.player == "ppo" for t in found.trials)

    def settings(certificate: Certificate) -> dict[str, Any]:
        # Trainings come last; more of them may be added.
        budget = certificate.settings["budget"].items()
        kept = {n: v for n, v in budget if has_trained or not n.startswith("ppo_")}
        return {"seed": certificate.settings["seed"], "budget": kept}

    mine, theirs = settings(blank), settings(found)
    for name in mine:
        if mine[name] != theirs[name]:
            differs.append(f"{name} is {mine[name]}, not {theirs[name]}")
    if differs:
        raise ValueError(
            f"{path} is another certificate: {'; '.join(differs)}; choose another"
            " output, or remove it"
        )
    return replace(blank, trials=found.trials)
