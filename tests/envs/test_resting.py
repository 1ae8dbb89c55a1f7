"""Worlds that rest after their episode, and resets of some worlds only."""

import numpy as np
import pytest

from collaborative_gym.testing import play

LENGTH = 12


def late(env, worlds, left=1):
    """Put these worlds that many steps before their episode's end."""
    state = env.get_state(worlds)
    state.progress["step"][:] = LENGTH - left
    env.set_state(state, worlds)


def test_an_ended_world_rests_while_the_others_go_on(make_env, assert_same):
    env, plain = make_env(4, auto_reset=False), make_env(4)
    for each in (env, plain):
        each.reset(seed=0)
        each.step(each.expert())
    late(env, [1, 2])
    observations, _, _, truncated, infos = env.step(env.expert())
    plain.step(plain.expert())
    assert infos["ended"].tolist() == [False, True, True, False]
    assert not infos["resting"].any()
    assert truncated["robot_1"].tolist() == infos["ended"].tolist()
    before = env.get_state([1, 2])
    for _ in range(3):
        expected = plain.step(plain.expert())
        again, rewards, _, truncated, later = env.step(env.expert())
        assert later["ended"].tolist() == later["resting"].tolist()
        assert later["resting"].tolist() == [False, True, True, False]
        assert truncated["robot_2"].tolist() == later["resting"].tolist()
        for agent in env.agents:
            assert not rewards[agent][[1, 2]].any()
            np.testing.assert_array_equal(
                again[agent][[1, 2]], observations[agent][[1, 2]]
            )
            np.testing.assert_array_equal(
                again[agent][[0, 3]], expected[0][agent][[0, 3]]
            )
            np.testing.assert_array_equal(
                rewards[agent][[0, 3]], expected[1][agent][[0, 3]]
            )
        for name in ("length", "return", "completion", "performance"):
            np.testing.assert_array_equal(
                later["metrics"][name][[1, 2]], infos["metrics"][name][[1, 2]]
            )
    assert_same(env.get_state([1, 2]), before)
    late(env, [0, 3])
    env.step(env.idle())
    with pytest.raises(RuntimeError, match=r"ended; call reset\(\) before step\(\)"):
        env.step(env.idle())


def test_some_worlds_start_again_and_the_others_go_on_unchanged(make_env, assert_same):
    env, other = make_env(5), make_env(5)
    for each in (env, other):
        each.reset(seed=0)
        play(each, 3)
    kept = other.get_state([0, 2, 4])
    observations, infos = other.reset(env_ids=[3, 1])
    assert_same(other.get_state([0, 2, 4]), kept)
    assert infos["episode"].tolist() == [0, 6, 2, 8, 4]
    assert observations["robot_1"].shape == (5, 19)
    fresh = make_env(9)
    start = fresh.reset(seed=0)[0]
    np.testing.assert_array_equal(
        observations["robot_1"][[1, 3]], start["robot_1"][[6, 8]]
    )
    expected, seen = play(env, 3), play(other, 3)
    for episode in (0, 2, 4):
        assert seen[0, episode] == expected[0, episode]
    observations, infos = other.reset(5, [7, 2], env_ids=[4, 0])
    assert infos["episode"].tolist() == [2, 6, 2, 8, 7]
    assert other.progress["seed"].tolist() == [5, 0, 0, 0, 5]
    start = make_env(8).reset(seed=5)[0]
    np.testing.assert_array_equal(
        observations["robot_2"][[0, 4]], start["robot_2"][[2, 7]]
    )


def test_a_mask_names_worlds_too(make_env):
    env = make_env(3)
    env.reset(seed=0)
    before = env.progress["episode"].tolist()
    env.reset(env_ids=np.array([False, True, False]))
    assert env.progress["episode"].tolist() == [before[0], before[1] + 3, before[2]]
    env.reset(env_ids=[])
    assert env.progress["episode"].tolist() == [before[0], before[1] + 3, before[2]]


def test_a_world_that_rests_starts_again_when_it_is_reset(make_env):
    env = make_env(2, auto_reset=False)
    env.reset(seed=0)
    late(env, [1])
    env.step(env.idle())
    _, infos = env.reset(env_ids=[1])
    assert not infos["ended"].any()
    *_, infos = env.step(env.idle())
    assert infos["step"].tolist() == [2, 1]


def test_a_diverged_world_rests_wherever_its_state_is_put(
    make_env, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings where it runs.
    env, other = make_env(2, auto_reset=False), make_env(2, auto_reset=False)
    for each in (env, other):
        each.reset(seed=0)
    env.sim.qpos[0, 0] = np.nan
    *_, infos = env.step(env.idle())
    assert infos["diverged"].tolist() == [True, False]
    env.set_state(env.get_state([1]), [1])
    other.set_state(env.get_state([0]), [1])
    for each, rests in ((env, [True, False]), (other, [False, True])):
        *_, infos = each.step(each.idle())
        assert infos["resting"].tolist() == rests
        assert infos["diverged"].tolist() == rests


@pytest.mark.parametrize(
    ("error", "env_ids", "message"),
    [
        (IndexError, [0, 3], r"env_ids are \[0, 3\]; worlds are 0 to 2"),
        (IndexError, [-1], r"worlds are 0 to 2"),
        (IndexError, [True, False], "a mask of 2 worlds, but there are 3"),
        (ValueError, [1, 1], r"env_ids \[1, 1\] name a world twice"),
        (ValueError, [[1], [1, 2]], "env_ids cannot be read as numbers"),
        (TypeError, [0.0, 1.0], "must be a list of worlds or a mask"),
        (TypeError, 1, "must be a list of worlds or a mask"),
        (TypeError, "12", "must be a list of worlds or a mask"),
        (TypeError, [[0, 1]], "must be a list of worlds or a mask"),
        (TypeError, slice(0, 2), "must be a list of worlds or a mask"),
    ],
)
def test_worlds_that_there_are_not_change_nothing(
    make_env, error, env_ids, message, assert_same
):
    env = make_env(3)
    env.reset(seed=0)
    before = env.get_state()
    for call in (
        lambda: env.reset(env_ids=env_ids),
        lambda: env.get_state(env_ids),
        lambda: env.set_state(before, env_ids),
    ):
        with pytest.raises(error, match=message):
            call()
    assert_same(env.get_state(), before)


def test_some_worlds_cannot_start_before_all_have(make_env):
    with pytest.raises(RuntimeError, match=r"call reset\(\) of all worlds before"):
        make_env(2).reset(env_ids=[0])
