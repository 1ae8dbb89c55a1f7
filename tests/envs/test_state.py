"""Saved states: which are refused, and environments that are copied."""

import copy
import pickle
from dataclasses import replace

import cloudpickle
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.envs.gymnasium import GymnasiumEnv
from collaborative_gym.envs.gymnasium_vector import GymnasiumVectorEnv
from collaborative_gym.tasks.registry import make_task

LENGTH = 12


def with_progress(state, name, value):
    rows = state.progress[name].copy()
    rows[1] = value
    return replace(state, progress={**state.progress, name: rows})


def with_physics(state, value):
    rows = state.physics.copy()
    rows[1, 3] = value
    return replace(state, physics=rows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: with_physics(s, np.nan), "physics 'rows' is not finite"),
        (lambda s: with_physics(s, np.inf), "physics 'rows' is not finite"),
        (lambda s: replace(s, physics=s.physics.astype(complex)), "of type complex128"),
        (lambda s: replace(s, physics=s.physics[:, :-1]), "does not fit"),
        (lambda s: with_progress(s, "step", -1), r"'step' is \[2, -1\]"),
        (lambda s: with_progress(s, "step", LENGTH + 1), "no episode of 12 steps"),
        (lambda s: with_progress(s, "length", 3), "'length' is"),
        (lambda s: with_progress(s, "episode", -5), "'episode' is"),
        (lambda s: with_progress(s, "seed", -5), "'seed' is"),
        (lambda s: with_progress(s, "side_1: first_success", 3), "first_success' is"),
        (lambda s: with_progress(s, "side_1: performing_steps", -1), "performing_s"),
        (lambda s: with_progress(s, "robot_1: height", np.nan), "is not finite"),
        (
            lambda s: {"physics": s.physics},
            r"must come from get_state\(\), got <class .dict.>",
        ),
    ],
)
def test_a_state_that_no_world_can_be_in_changes_nothing(
    make_env, change, message, assert_same
):
    env = make_env(2)
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.idle())
    before = env.get_state()
    with pytest.raises((ValueError, TypeError), match=message):
        env.set_state(change(env.get_state()))
    assert_same(env.get_state(), before)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"height": 0.7}, "another environment: height is 0.6, not 0.7"),
        ({"robots": ("panda", "sawyer")}, "robot_2 is panda, not sawyer"),
    ],
)
def test_a_state_of_another_environment_is_refused(
    make_env, settings, message, assert_same
):
    env, other = make_env(2), make_env(2, **settings)
    for each in (env, other):
        each.reset(seed=0)
    before = other.get_state()
    with pytest.raises(ValueError, match=message):
        other.set_state(env.get_state())
    assert_same(other.get_state(), before)


def test_a_state_of_another_environment_is_taken_on_purpose(make_env, assert_same):
    env, other = make_env(2), make_env(2, height=0.7)
    for each, seed in ((env, 0), (other, 1)):
        each.reset(seed=seed)
    env.step(env.idle())
    other.set_state(env.get_state(), from_another=True)
    assert_same(other.get_state(), env.get_state())


def test_a_state_of_another_version_is_refused(make_env):
    env = make_env(1)
    env.reset(seed=0)
    state = env.get_state()
    versions = {**state.identity.versions, "mujoco": "3.9"}
    old = replace(state, identity=replace(state.identity, versions=versions))
    with pytest.raises(ValueError, match=r"version of mujoco is 3\.9, not .*from_ano"):
        env.set_state(old)


def again_by_pickle(env):
    return pickle.loads(pickle.dumps(env))


def again_by_cloudpickle(env):
    return cloudpickle.loads(cloudpickle.dumps(env))


@pytest.fixture(params=[copy.deepcopy, again_by_pickle, again_by_cloudpickle])
def again(request):
    """Return a way to make an environment anew."""
    return request.param


def test_a_copied_environment_goes_on_with_the_same_bits(again, assert_same):
    task = make_task("PokeTaskSawyers-v0", max_episode_steps=20)
    env = cg.VectorEnv(task, 3, seed=7, num_threads=1, auto_reset=False)
    fresh = again(env)
    np.testing.assert_array_equal(
        fresh.reset()[0]["robot_1"], env.reset()[0]["robot_1"]
    )
    for _ in range(4):
        env.step(env.expert())
    other = again(env)
    for _ in range(5):
        seen, expected = other.step(other.expert()), env.step(env.expert())
        for agent in env.agents:
            np.testing.assert_array_equal(seen[0][agent], expected[0][agent])
            np.testing.assert_array_equal(seen[1][agent], expected[1][agent])
    assert_same(other.get_state(), env.get_state())
    assert other.task.config == env.task.config
    other.close()
    env.step(env.expert())


def test_a_copied_pettingzoo_environment_goes_on(again):
    env = cg.make("PokeTaskSawyers-v0", max_episode_steps=5)
    env.reset(seed=3)
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    env.step(actions)
    other = again(env)
    assert str(other) == "PokeTaskSawyers-v0"
    while env.agents:
        seen, expected = other.step(actions), env.step(actions)
        assert seen[1:] == expected[1:]
        for agent, observation in expected[0].items():
            np.testing.assert_array_equal(seen[0][agent], observation)
    assert other.agents == []
    np.testing.assert_array_equal(other.state(), env.state())


def test_copied_gymnasium_environments_go_on(again):
    env = GymnasiumEnv("PokeTaskSawyers-v0", max_episode_steps=5)
    env.reset(seed=3)
    other, action = again(env), env.action_space.sample()
    np.testing.assert_array_equal(other.step(action)[0], env.step(action)[0])
    envs = GymnasiumVectorEnv("PokeTaskSawyers-v0", 2, num_threads=1)
    envs.reset(seed=3)
    others, actions = again(envs), envs.action_space.sample()
    np.testing.assert_array_equal(others.step(actions)[0], envs.step(actions)[0])
    others.close()
    envs.close()
