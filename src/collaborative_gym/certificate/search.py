"""Motions that are played blindly, and the search for good ones."""

import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from collaborative_gym.blocks import columns_of, split_columns
from collaborative_gym.certificate.budget import Budget
from collaborative_gym.certificate.tries import Cast, Results, play
from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies import Policy, as_policy
from collaborative_gym.policies.policy import is_shipped

_FIRST_STD, _NEAR_STD, _LEAST_STD = 0.7, 0.3, 0.05
"""Standard deviation of the first candidates, of those near a recorded episode, and the
least one later."""

_ELITE = 0.1  # share of the candidates around which the next ones are drawn

_SCREENED, _GO_ON = 8, 0.15
"""Of more starts than this, each round draws so many for all candidates; only so large
a share of them, the best, is then tried on the others."""

_AFTER = 10  # control steps of a try after the end of its motion

_GAIN, _STALL = 0.01, 6
"""A search has converged if the best motion gains less than this in so many rounds, of
the share of starts that it completes, less its mean distance from the goal."""


class Motions:
    """Open-loop motions of some agents, while others do as their policies say.

    A motion is a row of the budget's knots, evenly spread over its time, with the
    actions of all these agents side by side. Between two knots actions change evenly;
    after the last one the arms hold still, with the grips that they have then. Where
    there are records, a motion is a change of one of them, and takes its time. The
    worlds must not reset themselves.

    Attributes:
      records: (episodes, steps, columns) actions to which the motions' are added.
      is_grip: (columns,) which columns of a knot or a record grip.
      shape: knots and columns of a motion.
      steps: control steps of a motion.
    """

    def __init__(
        self,
        env: VectorEnv,
        partners: Mapping[str, str],
        budget: Budget,
        records: np.ndarray | None = None,
    ):
        self._env = env
        self._partners = dict(partners)
        sizes = env.world.definition.layout.action_sizes
        self._sizes = {a: n for a, n in sizes.items() if a not in partners}
        grips = [columns_of(env.action_parts[agent], "grip") for agent in self._sizes]
        self.is_grip = np.concatenate(grips)
        self.shape = budget.knots, len(self.is_grip)
        self.steps = budget.motion_steps if records is None else records.shape[1]
        none = np.zeros((1, 1, self.shape[1]))
        self.records = none if records is None else records

    def first(self) -> tuple[np.ndarray, float]:
        """Return the first candidates' mean, (knots, columns), and their deviation."""
        is_new = len(self.records[0]) == 1
        mean = np.zeros(self.shape)
        mean[:, self.is_grip] = is_new
        return mean, _FIRST_STD if is_new else _NEAR_STD

    def cast(self, motions: np.ndarray, records: np.ndarray) -> Cast:
        """Return the players of these motions, (tries, knots, columns).

        `records` is the row of each one's record, (tries,).
        """

        def policy(tries: np.ndarray) -> Policy:
            own, begun = motions[tries], self.records[records[tries]]
            steps = itertools.count()

            def act(observations):
                return self._actions(own, begun, next(steps))

            team = dict.fromkeys(self._sizes, act) | self._partners
            return as_policy(team, self._env)

        return policy

    def _actions(
        self, motions: np.ndarray, records: np.ndarray, step: int
    ) -> dict[str, np.ndarray]:
        last = self.shape[0] - 1
        at = last * min(step / self.steps, 1.0)
        i = min(int(at), last - 1)
        now = motions[:, i] + (at - i) * (motions[:, i + 1] - motions[:, i])
        now = now + records[:, min(step, records.shape[1] - 1)]
        if step >= self.steps:
            now = np.where(self.is_grip, now, 0.0)
        return split_columns(np.clip(now, -1.0, 1.0), self._sizes)


def record_actions(env: VectorEnv, seed: int, episodes: int) -> np.ndarray:
    """Return the actions of the first episodes of a seed, as many as there are worlds.

    The expert and the baseline, if one is shipped for this task, play in turn. The
    record ends soon after the last of them has reached the goal, or where all episodes
    have ended. The worlds must not reset themselves.

    Returns:
      (episodes, steps, k), with the actions of all agents side by side.
    """
    players = [as_policy("expert", env)]
    if is_shipped("baseline", env.task.name):
        # Of other mounts, or another action mode, it is no policy of this task.
        with suppress(ValueError):
            players.append(as_policy("baseline", env))
    episodes = min(episodes, env.num_envs)
    is_first = (np.arange(env.num_envs) % len(players) == 0)[:, None]
    observations, _ = env.reset(seed=seed, episodes=range(env.num_envs))
    steps: list[np.ndarray] = []
    met, end = np.zeros(episodes, bool), 0
    for step in range(env.task.config.max_episode_steps):
        acted = [player(observations) for player in players]
        actions = {a: np.where(is_first, acted[0][a], acted[-1][a]) for a in env.agents}
        rows = np.concatenate([actions[agent] for agent in env.agents], axis=1)
        steps.append(rows[:episodes])
        observations, *_, infos = env.step(actions)
        before, met = met, infos["metrics"]["completion"][:episodes] > 0.0
        end = step if (met & ~before).any() else end
        if infos["ended"].all() or (met.all() and step >= end + _AFTER):
            break
    return np.stack(steps, axis=1)[:, : end + _AFTER]


def starts_each(count: int) -> float:
    """Return on how many of so many starts a candidate is tried, in the mean."""
    return min(count, _SCREENED) + _GO_ON * max(0, count - _SCREENED)


def search(
    env: VectorEnv,
    starts: EnvState,
    groups: np.ndarray,
    *,
    motions: Motions,
    budget: Budget,
    rng: np.random.Generator,
    record: int = 0,
    on_step: Callable[[int], object] | None = None,
) -> tuple[np.ndarray, Results]:
    """Search for a motion that reaches the goal from all starts of a group.

    It uses the cross-entropy method, for each group by itself: candidates are drawn by
    `rng` around the best ones of the round before. A group whose motion reaches the
    goal from each of its starts is done, and so is one that has converged. Groups are
    (groups, starts of a group) rows of `starts`; `record` is the row of `motions`'
    records that all begin with; the worlds and `on_step` are as for `play`.

    Returns:
      The best motion of each group, (groups, knots, columns), and its outcome, where a
      group counts as completed if it was from each of its starts.
    """

    def played(starting: np.ndarray, tried: np.ndarray) -> np.ndarray:
        """Return sums over starts of costs and distances, (2, groups, candidates)."""
        tries = *tried.shape[:2], starting.shape[1]
        which = np.broadcast_to(starting[:, None], tries).ravel()
        flat = np.repeat(tried.reshape(-1, *motions.shape), tries[2], axis=0)
        cast = motions.cast(flat, np.full(len(flat), record))
        found = play(
            env, starts, which, cast, steps=motions.steps + _AFTER, on_step=on_step
        )
        completed, near = found.completed.reshape(tries), found.nearest.reshape(tries)
        return np.stack([near - completed, near]).sum(axis=3)

    first, deviation = motions.first()
    mean = np.tile(first, (len(groups), 1, 1))
    std, best = np.full_like(mean, deviation), mean.copy()
    # The share of starts from which the goal is reached counts before all distances.
    least = np.full((budget.rounds + 1, len(groups)), np.inf)
    nearest = np.full(len(groups), np.inf)
    left = np.arange(len(groups))
    for number in range(1, budget.rounds + 1):
        shape = (len(left), budget.candidates, *motions.shape)
        tried = mean[left, None] + std[left, None] * rng.standard_normal(shape)
        tried[:, 0] = mean[left]
        tried = np.clip(tried, -1.0, 1.0)
        tried, cost, near = _race(tried, groups[left], played, rng)
        elite = tried[:, : max(2, round(_ELITE * shape[1]))]
        mean[left] = elite.mean(axis=1)
        std[left] = np.maximum(elite.std(axis=1), _LEAST_STD)
        least[number] = least[number - 1]
        for row, group in enumerate(left):
            if cost[row, 0] < least[number, group]:
                least[number, group] = cost[row, 0]
                best[group], nearest[group] = tried[row, 0], near[row, 0]
        before = least[max(0, number - _STALL), left]
        now = least[number, left]
        left = left[(now > -1.0) & (before - now > _GAIN)]
        if not len(left):
            break
    return best, Results(least[number] <= -1.0, nearest, not len(left))


def _race(
    tried: np.ndarray,
    groups: np.ndarray,
    played: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return candidates, the best of each group first, with costs and distances.

    Both are means over a group's starts. Those that are not tried on all are left out.
    """
    count = groups.shape[1]
    if count > _SCREENED:
        groups = groups[:, rng.permutation(count)]
    tried, sums = _ranked(tried, played(groups[:, :_SCREENED], tried))
    if count > _SCREENED:
        most = max(2, round(_GO_ON * tried.shape[1]))
        tried, sums = tried[:, :most], sums[..., :most]
        sums = sums + played(groups[:, _SCREENED:], tried)
        tried, sums = _ranked(tried, sums)
    return tried, *(sums / count)


def _ranked(tried: np.ndarray, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return candidates and their sums in the order of these costs."""
    order = np.argsort(sums[0], axis=1)
    ranked = np.take_along_axis(tried, order[..., None, None], axis=1)
    return ranked, np.take_along_axis(sums, order[None], axis=2)
