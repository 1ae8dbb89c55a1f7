"""The Gymnasium adapters, by Gymnasium's own checks and by what ours add."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordEpisodeStatistics
from gymnasium.wrappers.vector import (
    RecordEpisodeStatistics as RecordVectorEpisodeStatistics,
)

import collaborative_gym as cg

LENGTH = 12

# Gymnasium advises against observation spaces without bounds; ours have none.
pytestmark = pytest.mark.filterwarnings("ignore:.*Box observation space")


@pytest.fixture
def env(carry_id):
    env = gymnasium.make(carry_id, render_mode="rgb_array")
    yield env
    env.close()


@pytest.fixture
def envs(carry_id):
    envs = gymnasium.make_vec(carry_id, num_envs=3, num_threads=1)
    yield envs
    envs.close()


def expert_action(env):
    return np.concatenate(list(env.unwrapped.vector_env.expert().values()), axis=1)


@pytest.mark.filterwarnings("error")
@pytest.mark.filterwarnings("ignore:.*Box observation space")
def test_gymnasium_checks(env):
    check_env(env.unwrapped)


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
def test_gymnasium_checks_with_its_wrappers(env):
    check_env(env, skip_render_check=True)


def test_one_agent_commands_all_robots(env, make_env):
    batch = make_env(2)
    expected = batch.reset(seed=3)[0]
    observation, info = env.reset(seed=3)
    assert info == {}
    assert env.observation_space.shape == (38,)
    assert env.action_space.shape == (16,)
    joined = np.concatenate([expected[agent][0] for agent in batch.agents])
    np.testing.assert_array_equal(observation, joined)
    action = np.linspace(-1, 1, 16)
    observation, reward, terminated, truncated, info = env.step(action)
    expected, rewards, *_, infos = batch.step(
        {"robot_1": np.tile(action[:8], (2, 1)), "robot_2": np.tile(action[8:], (2, 1))}
    )
    joined = np.concatenate([expected[agent][0] for agent in batch.agents])
    np.testing.assert_array_equal(observation, joined)
    assert reward == pytest.approx(rewards["robot_1"][0] + rewards["robot_2"][0])
    assert (terminated, truncated) == (False, False)
    assert info["success"] is False
    assert info["diverged"] is False
    for agent, terms in info["reward_terms"].items():
        for name, term in terms.items():
            assert term == infos["reward_terms"][agent][name][0]


def test_an_episode_ends_truncated_with_its_metrics(carry_id):
    env = RecordEpisodeStatistics(gymnasium.make(carry_id))
    env.reset(seed=0)
    truncated, total = False, 0.0
    while not truncated:
        observation, reward, terminated, truncated, info = env.step(
            expert_action(env)[0]
        )
        total += reward
        assert not terminated
        assert ("metrics" in info) == truncated
    assert observation[16] > 0.7
    assert info["metrics"]["return"] == pytest.approx(total)
    assert info["metrics"]["length"] == info["episode"]["l"] == LENGTH
    assert info["episode"]["r"] == pytest.approx(total)
    with pytest.raises(RuntimeError, match="ended"):
        env.step(np.zeros(16))
    env.reset()
    assert env.unwrapped.vector_env.progress["episode"][0] == 1


def test_worlds_reset_in_the_same_step(envs, make_env):
    twin = make_env(3, auto_reset=False)
    twin.reset(seed=0)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.num_envs == 3
    assert envs.single_observation_space.shape == (38,)
    assert envs.observation_space.shape == (3, 38)
    assert envs.single_action_space.shape == (16,)
    assert envs.action_space.shape == (3, 16)
    observations, infos = envs.reset(seed=0)
    assert observations in envs.observation_space
    for step in range(LENGTH):
        assert "final_obs" not in infos
        last = twin.step(twin.expert())[0]
        observations, rewards, terminated, truncated, infos = envs.step(
            expert_action(envs)
        )
        assert rewards.shape == (3,)
        assert not terminated.any()
        assert (truncated == (step == LENGTH - 1)).all()
        assert (infos["_success"] == ~truncated).all()
    assert infos["_final_obs"].all()
    assert infos["_final_info"].all()
    joined = np.concatenate([last[agent] for agent in twin.agents], axis=1)
    np.testing.assert_array_equal(np.stack(infos["final_obs"]), joined)
    assert (observations[:, 16] < 0.49).all()
    metrics = infos["final_info"]["metrics"]
    assert metrics["completion"].tolist() == [1.0, 1.0, 1.0]
    assert infos["final_info"]["_success"].all()


def test_only_ended_worlds_have_final_observations(envs):
    envs.reset(seed=0)
    loop = envs.unwrapped.vector_env
    state = loop.get_state([1])
    state.progress["step"][:] = LENGTH - 1
    loop.set_state(state, [1])
    *_, truncated, infos = envs.step(np.zeros((3, 16)))
    assert truncated.tolist() == [False, True, False]
    assert [row is None for row in infos["final_obs"]] == [True, False, True]
    assert infos["_final_info"].tolist() == truncated.tolist()
    assert infos["_success"].tolist() == (~truncated).tolist()


def test_gymnasium_counts_the_same_episodes(envs):
    envs = RecordVectorEpisodeStatistics(envs)
    envs.reset(seed=0)
    for _ in range(LENGTH):
        infos = envs.step(expert_action(envs))[-1]
    np.testing.assert_allclose(
        infos["episode"]["r"], infos["final_info"]["metrics"]["return"]
    )


def test_a_batch_plays_the_episodes_of_its_seed(carry_id, env, envs):
    start = envs.reset(seed=6)[0]
    single = [env.reset(seed=6)[0], env.reset()[0], env.reset()[0]]
    np.testing.assert_array_equal(start, single)


def test_without_a_seed_environments_differ(carry_id):
    starts = [gymnasium.make(carry_id).reset()[0] for _ in range(2)]
    assert (starts[0] != starts[1]).any()


def test_options_reach_the_task(carry_id):
    env = gymnasium.make(
        carry_id, robots=("panda", "jaco"), randomization="paper", height=0.55
    )
    task = env.unwrapped.vector_env.task
    assert task.robots["robot_2"].name == "jaco"
    assert task.config.height == 0.55
    assert task.config.randomization.joint_noise == 0.0
    envs = gymnasium.make_vec(carry_id, num_envs=2, max_episode_steps=5)
    assert envs.unwrapped.vector_env.task.config.max_episode_steps == 5


def test_wrong_actions_change_nothing(env, envs):
    env.reset(seed=0)
    envs.reset(seed=0)
    before = envs.unwrapped.vector_env.get_state().physics
    with pytest.raises(ValueError, match=r"\(15,\), not \(16,\): 8 of robot_1, 8 of"):
        env.unwrapped.step(np.zeros(15))
    with pytest.raises(ValueError, match=r"\(3, 15\), not \(3, 16\): 8 of robot_1"):
        envs.step(np.zeros((3, 15)))
    actions = np.zeros((3, 16))
    actions[2, 9] = np.inf
    with pytest.raises(ValueError, match="robot_2 in world 2 is inf at index 1"):
        envs.step(actions)
    np.testing.assert_array_equal(envs.unwrapped.vector_env.get_state().physics, before)


def test_pictures_of_a_batch(carry_id):
    envs = gymnasium.make_vec(carry_id, num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    pictures = envs.render()
    assert [picture.shape for picture in pictures] == [(480, 640, 3)] * 2
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.step(np.zeros((2, 16)))


def test_pictures_need_a_render_mode(carry_id):
    with pytest.raises(
        KeyError, match="no render mode 'ansi'; render modes: rgb_array"
    ):
        cg.make(carry_id, render_mode="ansi")
    envs = gymnasium.make_vec(carry_id, num_envs=2)
    envs.reset()
    with pytest.raises(RuntimeError, match="make it with render_mode='rgb_array'"):
        envs.render()
