import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies import load_policy


def random_actions(env, steps):
    """Return the random policy's actions by episode and step."""
    policy = load_policy("random", env)
    observations, _ = env.reset(seed=3)
    seen = {}
    for _ in range(steps):
        progress, actions = env.progress, policy(observations)
        for i in range(env.num_envs):
            key = int(progress["episode"][i]), int(progress["step"][i])
            seen[key] = np.concatenate([actions[agent][i] for agent in env.agents])
        observations, *_ = env.step(actions)
    return seen


def test_random_actions_do_not_depend_on_the_number_of_worlds(make_env):
    alone = random_actions(make_env(1), 24)
    beside = random_actions(make_env(2), 12)
    assert set(alone) == set(beside)
    assert all(np.array_equal(alone[key], beside[key]) for key in alone)


def test_random_actions_fill_the_range_and_differ_between_steps(make_env):
    actions = np.stack(list(random_actions(make_env(4), 24).values()))
    assert actions.min() < -0.98 and actions.max() > 0.98
    assert abs(actions.mean()) < 0.05
    assert len(np.unique(actions, axis=0)) == len(actions)


def test_random_actions_differ_between_agents_and_seeds(make_env):
    env = make_env(1)
    policy = load_policy("random", env)
    drawn = []
    for seed in (0, 1):
        observations, _ = env.reset(seed=seed)
        drawn += policy(observations).values()
    assert len(np.unique(np.concatenate(drawn), axis=0)) == 4


def test_expert_is_the_tasks(make_env):
    env = make_env(2)
    observations, _ = env.reset(seed=0)
    actions, expected = load_policy("expert", env)(observations), env.expert()
    assert all(np.array_equal(actions[agent], expected[agent]) for agent in env.agents)


@pytest.mark.parametrize("name", ["expert", "random"])
def test_policies_play_a_pettingzoo_environment(carry_id, name):
    env = cg.make(carry_id)
    policy = load_policy(name, env)
    observations, _ = env.reset(seed=0)
    while env.agents:
        actions = policy(observations)
        assert all(
            env.action_space(agent).shape == action.shape
            for agent, action in actions.items()
        )
        observations, *_ = env.step(actions)


def test_unknown_policy_names_the_nearest(make_env):
    with pytest.raises(KeyError, match=r"expert, random \(did you mean 'expert'"):
        load_policy("exprt", make_env())


def test_a_policy_is_for_an_environment_of_this_package():
    with pytest.raises(TypeError, match=r"a VectorEnv or a PettingZoo .*, got 3"):
        load_policy("expert", 3)
