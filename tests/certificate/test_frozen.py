"""States on the expert's way."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.certificate.tries import find_starts, play
from collaborative_gym.policies import as_policy


@pytest.fixture
def env(press):
    """Return worlds of the task that needs both."""
    return cg.VectorEnv(press(), 6, num_threads=1, auto_reset=False)


def test_starts_are_before_the_goal_and_continue_the_experts_episodes(env):
    found = find_starts(env, seed=3, count=8, fractions=(0.0, 0.25, 0.75))
    report = cg.evaluate(env.task, "expert", episodes=8, seed=3, num_threads=1)
    times = [round(row["time_to_success"] * 10) for row in report.episodes]
    for fraction, states in found.items():
        assert states.progress["episode"].tolist() == list(range(8))
        expected = [int(fraction * time) for time in times]
        assert states.progress["step"].tolist() == expected
        env.set_state(states.rows(np.arange(6)))
        assert not env.task.success(env.facts).any()
    expert = as_policy("expert", env)
    which = np.arange(8)
    outcome = play(env, found[0.75], which, lambda tries: expert)
    assert outcome.completed.tolist() == [True] * 8
    assert outcome.nearest.tolist() == [0.0] * 8


def test_moments_at_which_the_goal_is_met_are_left_out(press):
    task = press(together=False)
    kept = type(task).success

    class Fickle(type(task)):
        """Met at the start, and then from the sixth step on."""

        success_after = 5

        def success(self, facts):
            return kept(self, facts) | (facts.joints["robot_1"][:, 0] > 0.0)

    env = cg.VectorEnv(
        Fickle(list(task.robots.values()), task.config),
        6,
        num_threads=1,
        auto_reset=False,
    )
    env.reset(seed=0)
    met = env.task.success(env.facts)
    assert 0 < met.sum() < 6
    states = find_starts(env, seed=0, count=6, fractions=(0.25,))[0.25]
    episodes = states.progress["episode"]
    assert not np.isin(episodes, np.flatnonzero(met)).any() and len(episodes) == 6


def test_a_round_in_which_nothing_moves_is_over(press):
    task = press(max_episode_steps=60)
    env = cg.VectorEnv(task, 4, num_threads=1, auto_reset=False)
    starts = find_starts(env, seed=0, count=4, fractions=(0.0,))[0.0]
    lengths = {}
    for policy in ("idle", "random"):
        steps, act = [], as_policy(policy, env)
        play(env, starts, np.arange(4), lambda tries, a=act: a, on_step=steps.append)
        lengths[policy] = len(steps)
    assert 10 < lengths["idle"] < 40 and lengths["random"] == 60
