"""Batches of Tianshou, beside its own batch of single environments."""

import gymnasium
import numpy as np
import pytest

import collaborative_gym as cg

pytest.importorskip("tianshou")

from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv

from collaborative_gym.adapters.tianshou import TianshouEnv

POKE = "PokeTaskSawyers-v0"
LENGTH = 3


@pytest.fixture
def make():
    made = []

    def make(num_envs):
        settings = {"max_episode_steps": LENGTH}
        made.append(TianshouEnv(cg.make_vec(POKE, num_envs, num_threads=1, **settings)))
        return made[-1]

    yield make
    for env in made:
        env.close()


def test_it_is_told_of_worlds_as_of_its_own(make):
    worlds = make(1)
    own = DummyVectorEnv([lambda: gymnasium.make(POKE, max_episode_steps=LENGTH)])
    assert worlds.action_space == own.action_space
    np.testing.assert_array_equal(worlds.reset(seed=3)[0], own.reset(seed=3)[0])
    rng = np.random.default_rng(0)
    for step in range(2 * LENGTH + 1):
        actions = rng.uniform(-1, 1, (1, 14)).astype(np.float32)
        found, expected = worlds.step(actions), own.step(actions)
        for mine, theirs in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-6)
        metrics = expected[4][0]["metrics"]
        assert found[4][0]["performance"] == metrics["performance"]
        if found[3][0]:
            assert step % LENGTH == LENGTH - 1
            np.testing.assert_array_equal(worlds.reset([0])[0], own.reset([0])[0])
    own.close()


def test_worlds_that_a_step_does_not_name_stay_as_they_are(make):
    env, twin = make(3), make(3)
    env.seed(5)
    twin.seed(5)
    start = env.reset()[0]
    twin.reset()
    actions = np.stack([space.sample() for space in env.action_space])
    found, *_, infos = env.step(actions[[0, 2]], [0, 2])
    assert [info["env_id"] for info in infos] == [0, 2]
    all_moved = twin.step(actions)[0]
    np.testing.assert_array_equal(found, all_moved[[0, 2]])
    np.testing.assert_array_equal(env.reset([1])[0], start[[1]])
    np.testing.assert_array_equal(env.step(actions[[1]], [1])[0], all_moved[[1]])
    assert env.vector_env.progress["step"].tolist() == [1, 1, 1]


def test_its_collector_counts_episodes_and_keeps_their_last_observations(make):
    env, twin = make(2), make(2).vector_env
    env.seed(0)
    twin.reset(0)
    collector = Collector(_expert(env), env, VectorReplayBuffer(20, 2))
    collector.reset()
    stats = collector.collect(n_episode=3)
    assert stats.lens.tolist() == [LENGTH] * 3
    for _ in range(LENGTH):
        *_, infos = twin.step(twin.expert())
    returns = infos["metrics"]["return"]
    np.testing.assert_allclose(sorted(stats.returns[:2]), sorted(returns), rtol=1e-5)
    ends = collector.buffer[np.flatnonzero(collector.buffer.truncated)]
    final = np.concatenate([*infos["final_observation"].values()], axis=1)
    np.testing.assert_allclose(ends.obs_next[:2], final, rtol=1e-5)


def _expert(env):
    from tianshou.algorithm.algorithm_base import Policy
    from tianshou.data import Batch

    class Expert(Policy):
        def forward(self, batch, state=None, **_):
            actions = np.concatenate([*env.vector_env.expert().values()], axis=1)
            return Batch(act=actions[batch.info.env_id.astype(int)], state=state)

    return Expert(action_space=env.action_space[0])


def test_opponents_are_not_one_agent():
    with pytest.raises(ValueError, match="opponents"):
        TianshouEnv(cg.make_vec("TugSawyers-v0", 1))
