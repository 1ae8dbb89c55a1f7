"""SuperSuit's vector environments over ours for PettingZoo; no adapter is needed."""

import numpy as np
import pytest

import collaborative_gym as cg

supersuit = pytest.importorskip("supersuit")

LENGTH = 3


@pytest.mark.parametrize("env_id", ["PokeTaskSawyers-v0", "PassTaskJacoSawyer-v0"])
def test_its_rows_are_robots_in_several_environments(env_id):
    settings = {"max_episode_steps": LENGTH}
    single = cg.make(env_id, **settings)
    sizes = [single.action_space(agent).shape[0] for agent in single.possible_agents]
    padded = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(single))
    rows = supersuit.pettingzoo_env_to_vec_env_v1(padded)
    envs = supersuit.concat_vec_envs_v1(rows, 2)
    twins = [cg.make(env_id, **settings) for _ in range(2)]
    found = envs.reset(seed=3)[0]
    expected = [twin.reset(seed=3 + i)[0] for i, twin in enumerate(twins)]
    rng = np.random.default_rng(0)
    for step in range(LENGTH + 1):
        assert_rows(found, expected)
        actions = rng.uniform(-1, 1, (4, max(sizes))).astype(np.float32)
        found, rewards, terminated, truncated, infos = envs.step(actions)
        given = iter(actions)
        for i, twin in enumerate(twins):
            own = {a: next(given)[:k] for a, k in zip(twin.agents, sizes, strict=True)}
            expected[i], earned, *_ = twin.step(own)
            np.testing.assert_allclose(
                rewards[2 * i : 2 * i + 2], [*earned.values()], rtol=1e-6
            )
        assert not terminated.any()
        assert truncated.tolist() == [step == LENGTH - 1] * 4
        if truncated.all():
            assert_rows([info["terminal_observation"] for info in infos], expected)
            expected = [twin.reset()[0] for twin in twins]
    for env in (envs, single, *twins):
        env.close()


def assert_rows(rows, expected):
    """Compare padded rows with what the robots of several environments observe."""
    singles = [seen for observations in expected for seen in observations.values()]
    for row, single in zip(rows, singles, strict=True):
        np.testing.assert_array_equal(row[: single.size], single)
        assert not row[single.size :].any()
