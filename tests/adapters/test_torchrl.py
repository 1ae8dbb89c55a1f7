"""Batches of TorchRL, by its own check and by what it says where episodes end."""

import numpy as np
import pytest

import collaborative_gym as cg

torch = pytest.importorskip("torch")
pytest.importorskip("torchrl")

from torchrl.envs.utils import check_env_specs  # noqa: E402

from collaborative_gym.adapters.torchrl import TorchRLEnv  # noqa: E402

LENGTH = 3


def make(env_id="BalanceTaskJacoSawyer-v0", num_envs=2, **settings):
    worlds = cg.make_vec(env_id, num_envs, num_threads=1, max_episode_steps=LENGTH)
    return TorchRLEnv(worlds, **settings)


@pytest.mark.parametrize(
    ("env_id", "groups"),
    [
        ("BalanceTaskJacoSawyer-v0", None),
        ("PokeTaskSawyers-v0", {"team": ["robot_1", "robot_2"]}),
        ("TugSawyers-v0", None),
    ],
)
def test_it_passes_torchrls_check(env_id, groups):
    env = make(env_id, group_map=groups)
    check_env_specs(env, seed=0)
    env.close()


def test_a_rollout_has_the_ends_of_episodes_and_the_starts_of_the_next():
    env, twin = make(), make().vector_env
    env.set_seed(5)
    found = env.rollout(2 * LENGTH, break_when_any_done=False)
    observations, _ = twin.reset(5)
    for step in range(2 * LENGTH):
        now, after = found[:, step], found[:, step]["next"]
        for agent in twin.agents:
            seen = now[agent, "observation"][:, 0]
            np.testing.assert_array_equal(seen, observations[agent])
        actions = {a: now[a, "action"][:, 0].numpy() for a in twin.agents}
        observations, rewards, *_, infos = twin.step(actions)
        ended = infos["ended"].tolist()
        assert ended == [step % LENGTH == LENGTH - 1] * 2
        assert after["done"][:, 0].tolist() == ended
        assert after["truncated"][:, 0].tolist() == ended
        assert not after["terminated"].any()
        for agent in twin.agents:
            last = infos["final_observation"][agent]
            np.testing.assert_array_equal(after[agent, "observation"][:, 0], last)
            gained = after[agent, "reward"][:, 0, 0]
            np.testing.assert_array_equal(gained, rewards[agent].astype(np.float32))
            share = after[agent, "info", "performance"][:, 0, 0]
            np.testing.assert_allclose(share, infos["metrics"]["performance"])
    # Worlds that started by themselves are not started again.
    assert env.reset()["state"].equal(torch.as_tensor(_joined(observations)))
    assert env.vector_env.progress["episode"].tolist() == [4, 5]
    env.close()
    twin.close()


def test_a_mask_resets_some_worlds():
    env = make()
    start = env.reset()
    for agent, space in env.vector_env.single_action_spaces.items():
        start[agent, "action"] = torch.zeros(2, 1, *space.shape)
    after = env.step(start)["next"]
    before = after["state"].clone()  # `reset` writes into what it is given.
    after["_reset"] = torch.tensor([[False], [True]])
    begun = env.reset(after)
    assert env.vector_env.progress["step"].tolist() == [1, 0]
    assert begun["state"][0].equal(before[0])
    assert not begun["state"][1].equal(before[1])
    env.close()


def test_a_robot_without_a_group_is_refused():
    with pytest.raises(ValueError, match="group_map names robot_1; each of robot_1,"):
        make(group_map={"team": ["robot_1"]})


def _joined(observations):
    return np.concatenate([*observations.values()], axis=1)
