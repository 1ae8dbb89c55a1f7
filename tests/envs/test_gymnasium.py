"""The Gymnasium adapters, by Gymnasium's own checks and by what ours add."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordEpisodeStatistics
from gymnasium.wrappers.vector import (
    ClipReward,
    DictInfoToList,
    DtypeObservation,
    NormalizeObservation,
    NormalizeReward,
)
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
    assert info["metrics"]["length"] == 0
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
        assert info["metrics"]["return"] == pytest.approx(total)
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


def test_each_world_may_have_a_seed_of_its_own(env, envs):
    seeds = [7, 3, 5]
    for _ in range(2):  # first, and in the middle of other episodes
        start = envs.reset(seed=seeds)[0]
        single = [env.reset(seed=seed)[0] for seed in seeds]
        np.testing.assert_array_equal(start, single)
        envs.step(envs.action_space.sample())
    mask = np.array([False, True, False])
    masked = envs.reset(seed=[1, 1, 1], options={"reset_mask": mask})[0]
    np.testing.assert_array_equal(masked[1], env.reset(seed=1)[0])
    envs.reset(seed=[None, 4, None])
    assert envs.unwrapped.vector_env.get_state().progress["seed"].tolist() == [7, 4, 5]
    with pytest.raises(ValueError, match="seed has 1 seeds for"):
        envs.reset(seed=[1])
    with pytest.raises(TypeError, match="seed must be an integer, got 'x'"):
        envs.reset(seed=["x", 1, 2])


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
    assert [picture.shape for picture in pictures] == [(720, 1280, 3)] * 2
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


@pytest.fixture
def make_vec(carry_id):
    """Return a function that makes worlds that start anew in a chosen mode."""
    made = []

    def make_vec(mode, num_envs=3):
        kwargs = {"autoreset_mode": mode, "num_threads": 1}
        made.append(gymnasium.make_vec(carry_id, num_envs=num_envs, **kwargs))
        return made[-1]

    yield make_vec
    for envs in made:
        envs.close()


def end_early(envs, worlds):
    """Let the episodes of these worlds end with the next step."""
    batch = envs.unwrapped.vector_env
    state = batch.get_state(worlds)
    state.progress["step"][:] = LENGTH - 1
    batch.set_state(state, worlds)


def test_worlds_reset_in_the_next_step(make_vec, make_env):
    envs, twin = make_vec(AutoresetMode.NEXT_STEP), make_env(3)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.autoreset_mode is AutoresetMode.NEXT_STEP
    envs.reset(seed=0)
    twin.reset(seed=0)
    end_early(envs, [1])
    _, rewards, terminated, truncated, infos = envs.step(np.zeros((3, 16)))
    assert truncated.tolist() == [False, True, False]
    assert infos["metrics"]["length"].tolist() == [1, 1, 1]
    assert infos["_metrics"].all()
    assert "final_obs" not in infos
    observations, rewards, terminated, truncated, infos = envs.step(np.ones((3, 16)))
    assert rewards[1] == 0.0
    assert rewards[0] != 0.0
    assert not (terminated | truncated).any()
    assert infos["metrics"]["length"].tolist() == [2, 0, 2]
    assert infos["metrics"]["episode"].tolist() == [0, 4, 2]
    start = twin.reset(seed=0, episodes=[0, 4, 2])[0]
    joined = np.concatenate(list(start.values()), axis=1)
    np.testing.assert_array_equal(observations[1], joined[1])
    assert not np.array_equal(observations[0], joined[0])
    *_, infos = envs.step(np.zeros((3, 16)))
    assert infos["metrics"]["length"].tolist() == [3, 1, 3]


def test_all_worlds_reset_in_the_next_step(make_vec):
    envs = make_vec("NextStep")
    envs.reset(seed=0)
    for _ in range(LENGTH):
        *_, truncated, _ = envs.step(np.zeros((3, 16)))
    assert truncated.all()
    observations, rewards, _, truncated, infos = envs.step(np.zeros((3, 16)))
    assert observations in envs.observation_space
    assert not truncated.any()
    assert not rewards.any()
    assert infos["metrics"]["episode"].tolist() == [3, 4, 5]


def test_worlds_that_do_not_reset_themselves(make_vec):
    envs = make_vec(AutoresetMode.DISABLED)
    envs.reset(seed=0)
    end_early(envs, [0, 2])
    envs.step(np.zeros((3, 16)))
    with pytest.raises(RuntimeError, match=r"of the worlds \[0, 2\] have ended; call"):
        envs.step(np.zeros((3, 16)))
    mask = np.array([True, False, True])
    observations, infos = envs.reset(options={"reset_mask": mask})
    assert observations in envs.observation_space
    assert infos["_success"].tolist() == mask.tolist()
    *_, infos = envs.step(np.zeros((3, 16)))
    assert infos["metrics"]["length"].tolist() == [1, 2, 1]


def test_there_is_no_such_autoreset_mode(carry_id):
    with pytest.raises(
        KeyError, match=r"no autoreset mode 'never'; autoreset modes: D"
    ):
        gymnasium.make_vec(carry_id, num_envs=2, autoreset_mode="never")


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
@pytest.mark.parametrize(
    "wrapper",
    [
        NormalizeObservation,
        NormalizeReward,
        lambda envs: DtypeObservation(envs, np.float16),
        RecordVectorEpisodeStatistics,
        lambda envs: ClipReward(envs, -1, 1),
        DictInfoToList,
    ],
    ids=["observation", "reward", "dtype", "statistics", "clip", "infos"],
)
def test_wrappers_of_gymnasium(make_vec, mode, wrapper):
    envs = make_vec(mode)
    try:
        wrapped = wrapper(envs)
    except (AssertionError, ValueError):  # Some allow only NEXT_STEP.
        assert mode is not AutoresetMode.NEXT_STEP
        return
    wrapped.reset(seed=0)
    for _ in range(LENGTH):
        observations, rewards, _, truncated, _ = wrapped.step(np.zeros((3, 16)))
    assert truncated.all()
    assert np.isfinite(observations).all()
    assert np.isfinite(rewards).all()
    if mode is not AutoresetMode.DISABLED:
        wrapped.step(np.zeros((3, 16)))


def test_gymnasium_counts_all_episodes_that_start_in_the_next_step(make_vec):
    envs = RecordVectorEpisodeStatistics(make_vec(AutoresetMode.NEXT_STEP))
    envs.reset(seed=0)
    for step in range(2 * (LENGTH + 1)):
        *_, infos = envs.step(np.zeros((3, 16)))
        assert ("episode" in infos) == (step % (LENGTH + 1) == LENGTH - 1)
        if "episode" in infos:
            assert infos["episode"]["l"].tolist() == [LENGTH] * 3
            returns = infos["metrics"]["return"]
            np.testing.assert_allclose(infos["episode"]["r"], returns)
    assert envs.episode_count == 6


def test_gymnasium_turns_a_batch_into_tensors(make_vec):
    torch = pytest.importorskip("torch")
    from gymnasium.wrappers.vector import NumpyToTorch

    envs = NumpyToTorch(make_vec(AutoresetMode.NEXT_STEP))
    envs.reset(seed=0)
    for _ in range(LENGTH):
        observations, rewards, _, truncated, infos = envs.step(torch.zeros(3, 16))
    assert observations.shape == (3, 38)
    assert rewards.dtype == torch.float64
    assert truncated.all()
    assert infos["metrics"]["length"].tolist() == [LENGTH] * 3


def names(value):
    """Return the nested names in an info."""
    if not isinstance(value, dict):
        return None
    return {name: names(part) for name, part in value.items()}


def test_infos_have_the_same_names_at_every_reset_and_step(env, make_vec):
    expected = names(env.reset(seed=0)[1])
    for _ in range(LENGTH):
        assert names(env.step(np.zeros(16))[-1]) == expected
    envs = make_vec(AutoresetMode.NEXT_STEP)
    expected = names(envs.reset(seed=0)[1])
    for _ in range(LENGTH + 2):
        assert names(envs.step(np.zeros((3, 16)))[-1]) == expected


def test_seeds_of_64_bits(env, envs):
    for seed in (2**63, 2**64 - 1):
        env.reset(seed=seed)
        envs.reset(seed=seed)
