"""How far a world is from the goal, as every task tells it."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.tasks.registry import make_task

ONE_SIDED = [name for name in cg.list_envs() if len(make_task(name).sides) == 1]


@pytest.mark.parametrize("env_id", ONE_SIDED)
def test_shortfall_falls_to_zero_where_the_goal_is_met(env_id):
    # An episode of Reach ends with its goal.
    env = cg.VectorEnv(make_task(env_id), 4, seed=5, num_threads=1, auto_reset=False)
    env.reset()
    told = [env.task.shortfall(env.facts)]
    for step in range(env.task.config.max_episode_steps):
        if step >= 40 and not told[-1].all():
            break
        env.step(env.expert())
        told.append(env.task.shortfall(env.facts))
        met = env.task.success(env.facts)
        assert told[-1].shape == (4,)
        assert ((told[-1] == 0.0) == met).all() and (told[-1] >= 0.0).all()
    least = np.min(told, axis=0)
    assert (least < told[0]).all() | (least == 0.0).all() and not least.all()
    assert np.max(told) < 3.0


def test_without_a_word_on_it_shortfall_is_whether_the_goal_is_met(make_env):
    env = make_env(2)
    env.reset()
    for _ in range(11):
        env.step(env.expert())
        met = env.task.success(env.facts)
        assert env.task.shortfall(env.facts).tolist() == (1.0 - met).tolist()
    assert met.any()
