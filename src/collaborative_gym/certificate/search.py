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

_FIRST_STD, _LEAST_STD = 0.7, 0.05
"""Standard deviation of the first candidates, and the least one later."""

_ELITE = 0.1
"""Share of the candidates around which the next ones are drawn."""

_AFTER = 10
"""Control steps of a try after the end of its motion."""


class Motions:
    """Open-loop motions of some agents, while others do as their policies say.

    A motion is a row of the budget's knots, evenly spread over its time, with the
    actions of all these agents side by side. Between two knots actions change evenly;
    after the last one the arms hold still, with the grips that they have then. The
    worlds must not reset themselves.

    Attributes:
      is_grip: (columns,) which of a knot's columns grip.
      shape: knots and columns of a motion.
    """

    def __init__(self, env: VectorEnv, partners: Mapping[str, str], budget: Budget):
        self._env = env
        self._partners = dict(partners)
        self._steps = budget.motion_steps
        sizes = env.world.definition.layout.action_sizes
        self._sizes = {a: n for a, n in sizes.items() if a not in partners}
        grips = [columns_of(env.action_parts[agent], "grip") for agent in self._sizes]
        self.is_grip = np.concatenate(grips)
        self.shape = budget.knots, len(self.is_grip)

    def cast(self, motions: np.ndarray) -> Cast:
        """Return the players of these motions, (tries, knots, columns)."""

        def policy(tries: np.ndarray) -> Policy:
            own, steps = motions[tries], itertools.count()

            def act(observations):
                return self._actions(own, next(steps))

            team = dict.fromkeys(self._sizes, act) | self._partners
            return as_policy(team, self._env)

        return policy

    def _actions(self, motions: np.ndarray, step: int) -> dict[str, np.ndarray]:
        last = self.shape[0] - 1
        at = last * min(step / self._steps, 1.0)
        i = min(int(at), last - 1)
        now = motions[:, i] + (at - i) * (motions[:, i + 1] - motions[:, i])
        if step >= self._steps:
            now = np.where(self.is_grip, now, 0.0)
        return split_columns(now, self._sizes)


def record(env: VectorEnv, seed: int, episodes: int) -> dict[str, np.ndarray]:
    """Return the actions of the first episodes of a seed, as many as there are worlds.

    The expert and the baseline, if one is shipped for this task, play in turn. The
    worlds must not reset themselves.

    Returns:
      (episodes, steps, k) for each agent.
    """
    players = [as_policy("expert", env)]
    if is_shipped("baseline", env.task.name):
        # Of other mounts, or another action mode, it is no policy of this task.
        with suppress(ValueError):
            players.append(as_policy("baseline", env))
    is_first = (np.arange(env.num_envs) % len(players) == 0)[:, None]
    observations, _ = env.reset(seed=seed, episodes=range(env.num_envs))
    steps: list[dict[str, np.ndarray]] = []
    for _ in range(env.task.config.max_episode_steps):
        acted = [player(observations) for player in players]
        actions = {a: np.where(is_first, acted[0][a], acted[-1][a]) for a in env.agents}
        steps.append({agent: rows[:episodes] for agent, rows in actions.items()})
        observations, *_ = env.step(actions)
    return {a: np.stack([step[a] for step in steps], axis=1) for a in env.agents}


def replayed(
    env: VectorEnv, actions: dict[str, np.ndarray], episodes: np.ndarray
) -> Cast:
    """Return players of recorded actions, of `episodes`, (tries,) rows of them."""
    last = next(iter(actions.values())).shape[1] - 1

    def policy(tries: np.ndarray) -> Policy:
        own, steps = episodes[tries], itertools.count()

        def act(observations):
            step = min(next(steps), last)
            return {agent: rows[own, step] for agent, rows in actions.items()}

        return as_policy(act, env)

    return policy


def search(
    env: VectorEnv,
    starts: EnvState,
    groups: np.ndarray,
    *,
    motions: Motions,
    budget: Budget,
    rng: np.random.Generator,
    on_step: Callable[[int], object] | None = None,
) -> tuple[np.ndarray, Results]:
    """Search for a motion that reaches the goal from all starts of a group.

    It uses the cross-entropy method, for each group by itself: candidates are drawn by
    `rng` around the best ones of the round before. A group whose motion reaches the
    goal from each of its starts is done. Groups are (groups, starts of a group) rows of
    `starts`; the worlds and `on_step` are as for `play`.

    Returns:
      The best motion of each group, (groups, knots, columns), and its outcome, where a
      group counts as completed if it was from each of its starts.
    """
    mean = np.zeros((len(groups), *motions.shape))
    mean[..., motions.is_grip] = 1.0
    std, best = np.full_like(mean, _FIRST_STD), mean.copy()
    # The share of starts from which the goal is reached counts before all distances.
    least = np.full(len(groups), np.inf)
    nearest = np.full(len(groups), np.inf)
    steps = budget.motion_steps + _AFTER
    for _ in range(budget.rounds):
        left = np.flatnonzero(least > -1.0)
        if not len(left):
            break
        shape = (len(left), budget.candidates, *motions.shape)
        tried = mean[left, None] + std[left, None] * rng.standard_normal(shape)
        tried[:, 0] = mean[left]
        tried = np.clip(tried, -1.0, 1.0)
        tries = *shape[:2], groups.shape[1]
        which = np.broadcast_to(groups[left, None], tries).ravel()
        flat = np.repeat(tried.reshape(-1, *motions.shape), tries[2], axis=0)
        found = play(
            env, starts, which, motions.cast(flat), steps=steps, on_step=on_step
        )
        completed, near = (each.reshape(tries) for each in found)
        cost = (near - completed).mean(axis=2)
        order = np.argsort(cost, axis=1)[:, : max(2, round(_ELITE * shape[1]))]
        elite = np.take_along_axis(tried, order[..., None, None], axis=1)
        mean[left] = elite.mean(axis=1)
        std[left] = np.maximum(elite.std(axis=1), _LEAST_STD)
        for row, group in enumerate(left):
            first = order[row, 0]
            if cost[row, first] < least[group]:
                least[group], best[group] = cost[row, first], tried[row, first]
                nearest[group] = near[row, first].mean()
    return best, Results(least <= -1.0, nearest)
