"""Batches of Stable-Baselines3, and its models as policies."""

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import collaborative_gym as cg
import collaborative_gym.adapters.sb3 as adapter

POKE = "PokeTaskSawyers-v0"
LENGTH = 5


@pytest.fixture
def envs():
    worlds = cg.make_vec(POKE, 3, num_threads=1, max_episode_steps=LENGTH)
    envs = adapter.SB3VecEnv(worlds)
    yield envs
    envs.close()


def model_of(envs):
    return PPO("MlpPolicy", envs, n_steps=8, batch_size=24, n_epochs=1, device="cpu")


def test_it_is_told_of_worlds_as_of_its_own():
    settings = {"max_episode_steps": LENGTH}
    worlds = adapter.SB3VecEnv(cg.make_vec(POKE, 1, num_threads=1, **settings))
    own = make_vec_env(POKE, n_envs=1, env_kwargs=settings)
    for envs in (worlds, own):
        envs.seed(3)
    np.testing.assert_array_equal(worlds.reset(), own.reset())
    rng = np.random.default_rng(0)
    for step in range(12):
        actions = rng.uniform(-1, 1, (1, 14)).astype(np.float32)
        found, expected = worlds.step(actions), own.step(actions)
        for mine, theirs in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-6)
        (info,), (other,) = found[3], expected[3]
        is_last = step % LENGTH == LENGTH - 1
        assert found[2].tolist() == [is_last]
        assert info.get("TimeLimit.truncated", False) == is_last
        assert other["TimeLimit.truncated"] == is_last
        assert ("terminal_observation" in info) == is_last
        if is_last:
            np.testing.assert_array_equal(
                info["terminal_observation"], other["terminal_observation"]
            )
    worlds.close()
    own.close()


def test_an_episode_that_is_over_is_no_time_limit(short):
    worlds = adapter.SB3VecEnv(cg.VectorEnv(short, 2, num_threads=1))
    expert = cg.load_policy("expert", worlds)
    observations, ends = worlds.reset(), np.zeros(2, bool)
    while not ends.any():
        observations, _, ends, infos = worlds.step(expert(observations))
    last = infos[int(np.argmax(ends))]
    assert not last["TimeLimit.truncated"]
    assert last["is_success"]


def test_a_model_that_learned_with_normalized_observations_is_evaluated(envs):
    normalized = VecNormalize(VecMonitor(envs))
    model = model_of(normalized).learn(24)
    normalized.training = False
    report = cg.evaluate(POKE, model, episodes=2, num_threads=1)

    def by_hand(observations):
        rows = np.concatenate([*observations.values()], axis=1)
        actions, _ = model.predict(normalized.normalize_obs(rows), deterministic=True)
        return {"robot_1": actions[:, :7], "robot_2": actions[:, 7:]}

    expected = cg.evaluate(POKE, by_hand, episodes=2, num_threads=1)
    assert report.to_csv() == expected.to_csv()  # equal also where a value is NaN
    assert report.settings["policy"] == "PPO"


def test_a_model_commands_one_robot_beside_another_policy(envs):
    model = model_of(envs)
    worlds = envs.vector_env
    observations, _ = worlds.reset(0)
    mixed = cg.load_policy({"robot_1": model, "robot_2": "idle"}, worlds)(observations)
    alone = cg.load_policy(model, worlds)(observations)
    np.testing.assert_array_equal(mixed["robot_1"], alone["robot_1"])
    np.testing.assert_array_equal(mixed["robot_2"], worlds.idle()["robot_2"])


def test_a_model_of_another_environment_is_refused(envs):
    with pytest.raises(ValueError, match=r"shape \(42,\); that of all robots of Lift"):
        cg.evaluate("LiftTaskSawyers-v0", model_of(envs), episodes=1)


def test_opponents_are_not_one_agent():
    with pytest.raises(ValueError, match="opponents"):
        adapter.SB3VecEnv(cg.make_vec("TugSawyers-v0", 1))


def test_policies_play_it(envs):
    envs.seed(0)
    observations = envs.reset()
    expert = cg.load_policy("expert", envs)
    np.testing.assert_array_equal(
        expert(observations),
        np.concatenate([*envs.vector_env.expert().values()], axis=1),
    )


def test_it_draws_all_worlds(envs):
    envs.reset()
    assert len(envs.get_images()) == 3
    assert envs.render().shape == (1440, 2560, 3)
