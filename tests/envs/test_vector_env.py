"""The loop: what it returns, how it counts, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.blocks import POSE, Block

LENGTH = 12


def test_spaces_and_blocks_describe_what_is_returned(make_env):
    env = make_env(3)
    observations, infos = env.reset(seed=0)
    assert env.agents == ("robot_1", "robot_2")
    for agent in env.agents:
        assert env.observation_blocks[agent] == {
            "joints": Block("joints", (7,), unit="rad"),
            "tcp": Block("tcp", (7,), unit=POSE),
            "cube": Block("cube", (3,), unit="m"),
            "distance": Block("distance", (1,)),
            "highest": Block("highest", (1,)),
        }
        assert env.action_parts[agent] == {
            "moves": Block("moves", (7,)),
            "grip": Block("grip", (1,)),
        }
        assert env.single_observation_spaces[agent].shape == (19,)
        assert env.single_action_spaces[agent].shape == (8,)
        assert observations[agent].shape == (3, 19)
        assert observations[agent].dtype == np.float32
        assert env.reward_terms[agent] == ("distance", "height", "effort")
    assert infos["episode"].tolist() == [0, 1, 2]
    assert env.substeps * env.model.opt.timestep == pytest.approx(env.control_dt)


def test_an_ended_episode_reports_its_last_observation_and_metrics(make_env):
    env = make_env(2)
    env.reset(seed=0)
    returns = {agent: np.zeros(2) for agent in env.agents}
    sums = {agent: np.zeros((3, 2)) for agent in env.agents}
    successes = []
    for step in range(LENGTH):
        assert not env.progress["episode"][0]
        observations, rewards, terminated, truncated, infos = env.step(env.expert())
        for agent in env.agents:
            returns[agent] += rewards[agent]
            terms = infos["reward_terms"][agent].values()
            sums[agent] += np.stack(list(terms))
            np.testing.assert_allclose(rewards[agent], sum(terms))
            assert not terminated[agent].any()
            assert (truncated[agent] == (step == LENGTH - 1)).all()
        successes.append(infos["success"])
    metrics = infos["metrics"]
    first = np.argmax(successes, axis=0)
    assert 0 < first.min() < LENGTH - 2
    np.testing.assert_allclose(metrics["return"], sum(returns.values()), rtol=1e-6)
    for agent in env.agents:
        np.testing.assert_allclose(metrics["returns"][agent], returns[agent], rtol=1e-6)
        for total, name in zip(sums[agent], env.reward_terms[agent], strict=True):
            np.testing.assert_allclose(metrics["reward_terms"][agent][name], total)
    assert metrics["completion"].tolist() == [1.0, 1.0]
    assert metrics["length"].tolist() == [LENGTH, LENGTH]
    assert metrics["episode"].tolist() == [0, 1]
    assert metrics["seed"].tolist() == [0, 0]
    np.testing.assert_allclose(metrics["time_to_success"], (first + 1) * 0.1)
    np.testing.assert_allclose(metrics["at_goal"], np.mean(successes, axis=0))
    assert (metrics["at_goal"] < metrics["performance"]).all()
    for i in range(2):
        share = np.mean([success[i] for success in successes[first[i] :]])
        assert metrics["performance"][i] == pytest.approx(share)
    height = infos["final_observation"]["robot_1"][:, 16]
    assert (height > 0.6).all()
    assert (observations["robot_1"][:, 16] < 0.49).all()
    assert infos["episode"].tolist() == [0, 1]
    assert env.progress["episode"].tolist() == [2, 3]


def test_a_failed_episode_has_no_time_to_success(make_env):
    env = make_env(1)
    env.reset(seed=0)
    for _ in range(LENGTH):
        infos = env.step(env.idle())[-1]
    assert infos["metrics"]["completion"][0] == 0.0
    assert infos["metrics"]["performance"][0] == 0.0
    assert np.isnan(infos["metrics"]["time_to_success"][0])


def test_success_counts_only_late_enough(make_env):
    env = make_env(1)
    env.task.success_after = 8
    env.reset(seed=0)
    successes = [env.step(env.expert())[-1]["success"][0] for _ in range(LENGTH)]
    assert successes == [False] * 8 + [True] * 4


def test_success_counts_only_if_it_lasts(carry, monkeypatch):
    task = carry()
    monkeypatch.setattr(type(task), "success_for", 3)
    env = cg.VectorEnv(task, 1, num_threads=1, auto_reset=False)
    _, infos = env.reset(seed=0)
    assert not infos["success"][0]
    successes, met = [], []
    for step in range(LENGTH):
        infos = env.step(env.expert())[-1]
        met.append(bool(task.success(env.facts)[0]))
        successes.append(bool(infos["success"][0]))
        if step == LENGTH - 5:
            state = env.get_state()
    assert any(successes) and met != successes
    assert successes == [
        all(met[max(0, i - 2) : i + 1]) and i > 1 for i in range(LENGTH)
    ]
    # A saved state knows for how long.
    env.set_state(state)
    assert bool(env.step(env.expert())[-1]["success"][0]) == successes[LENGTH - 4]
    env.close()


def test_performance_can_count_from_the_start(make_env):
    env = make_env(1)
    env.task.performance_from_start = True
    env.reset(seed=0)
    successes = []
    for _ in range(LENGTH):
        infos = env.step(env.expert())[-1]
        successes.append(infos["success"][0])
    assert infos["metrics"]["performance"][0] == pytest.approx(np.mean(successes))
    assert 0 < infos["metrics"]["performance"][0] < 1


def test_staggered_worlds_end_at_different_times(make_env):
    env = make_env(6)
    _, infos = env.reset(seed=0, stagger=True)
    assert infos["step"].tolist() == [0, 2, 4, 6, 8, 10]
    ends = []
    for _ in range(LENGTH):
        infos = env.step(env.idle())[-1]
        ends.append(np.flatnonzero(infos["ended"]).tolist())
    assert ends == [[], [5], [], [4], [], [3], [], [2], [], [1], [], [0]]
    assert infos["metrics"]["length"][0] == LENGTH


def test_without_auto_reset_a_world_stays_as_its_episode_left_it(make_env):
    env = make_env(1, auto_reset=False)
    env.reset(seed=0)
    for _ in range(LENGTH):
        observations, _, _, truncated, infos = env.step(env.expert())
    assert truncated["robot_1"].all()
    np.testing.assert_array_equal(
        observations["robot_1"], infos["final_observation"]["robot_1"]
    )
    with pytest.raises(RuntimeError, match=r"ended; call reset\(\)"):
        env.step(env.idle())
    assert env.reset()[1]["episode"].tolist() == [1]
    env.step(env.idle())


def test_an_ended_episode_that_is_put_back_is_still_ended(make_env):
    env, other = make_env(1, auto_reset=False), make_env(1)
    env.reset(seed=0)
    env.step(env.idle())
    under_way = env.get_state()
    for _ in range(LENGTH - 1):
        env.step(env.idle())
    ended = env.get_state()
    for each in (env, other):
        each.set_state(ended)
        with pytest.raises(RuntimeError, match=r"ended; call reset\(\)"):
            each.step(each.idle())
        each.set_state(under_way)
        each.step(each.idle())


def test_returned_arrays_are_the_callers_own(make_env):
    env, other = make_env(2), make_env(2)
    for each in (env, other):
        each.reset(seed=0)
    for _ in range(3):
        observations, rewards, *_, infos = env.step(env.idle())
        other_observations = other.step(env.idle())[0]
        np.testing.assert_array_equal(
            observations["robot_1"], other_observations["robot_1"]
        )
        observations["robot_1"][:] = np.nan
        assert np.isfinite(infos["final_observation"]["robot_1"]).all()
        rewards["robot_1"][:] = np.nan
        infos["step"][:] = 99


def test_one_task_serves_several_environments(carry):
    task = carry()
    small, large = cg.VectorEnv(task, 1), cg.VectorEnv(task, 3)
    small.reset(seed=0)
    large.reset(seed=0)
    one = small.step(small.expert())[0]["robot_1"]
    three = large.step(large.expert())[0]["robot_1"]
    np.testing.assert_array_equal(one[0], three[0])


def test_a_picture_shows_the_scene(make_env):
    env = make_env(2)
    env.reset(seed=0)
    picture = env.render(1, width=64, height=48)
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: {"robot_1": a["robot_1"]}, r"robot_1, robot_2, got keys"),
        (lambda a: {**a, "robot_3": a["robot_1"]}, "robot_3"),
        (
            lambda a: {**a, "robot_2": a["robot_2"][:, :7]},
            r"robot_2.*\(3, 7\).*\(3, 8\)",
        ),
        (lambda a: {**a, "robot_2": a["robot_2"][:1]}, r"robot_2.*\(1, 8\).*\(3, 8\)"),
        (lambda a: a["robot_1"], r"be a dictionary .* got array"),
        (lambda a: with_value(a, np.nan), "robot_2 in world 1 is nan at index 4"),
        (lambda a: with_value(a, -np.inf), "robot_2 in world 1 is -inf at index 4"),
    ],
)
def test_wrong_actions_change_nothing(make_env, change, message, assert_same):
    env = make_env(3)
    env.reset(seed=0)
    env.step(env.idle())
    before = env.get_state()
    with pytest.raises(ValueError, match=message):
        env.step(change(env.idle()))
    assert_same(env.get_state(), before)


def with_value(actions, value):
    actions["robot_2"][1, 4] = value
    return actions


def test_actions_beyond_their_bounds_count_as_the_bound(make_env, assert_same):
    states = []
    for size in (1.0, 5.0):
        env = make_env(1)
        env.reset(seed=0)
        env.step({agent: np.full((1, 8), size) for agent in env.agents})
        states.append(env.get_state())
    assert_same(*states)


@pytest.mark.parametrize("call", ["step", "expert", "get_state", "render"])
def test_calls_out_of_order_say_so(make_env, call):
    env = make_env(1)
    arguments = (env.idle(),) if call == "step" else ()
    with pytest.raises(RuntimeError, match=rf"call reset\(\) before {call}\(\)"):
        getattr(env, call)(*arguments)
    env.close()
    with pytest.raises(RuntimeError, match="closed; make another"):
        getattr(env, call)(*arguments)
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()
    env.close()


@pytest.mark.parametrize(
    ("error", "arguments", "message"),
    [
        (ValueError, {"num_envs": 0}, "num_envs must be at least 1, got 0"),
        (TypeError, {"num_envs": 2.5}, "num_envs must be an integer, got 2.5"),
        (ValueError, {"num_threads": -1}, "num_threads must be at least 0"),
        (ValueError, {"seed": -1}, "seed must be at least 0"),
        (TypeError, {"seed": "1"}, "seed must be an integer, got '1'"),
        (
            ValueError,
            {"max_episode_steps": 0},
            "max_episode_steps must be at least 1",
        ),
    ],
)
def test_wrong_settings_are_refused(make_env, error, arguments, message):
    with pytest.raises(error, match=message):
        make_env(**arguments)


@pytest.mark.parametrize(
    ("error", "arguments", "message"),
    [
        (ValueError, {"seed": -3}, "seed must be at least 0, got -3"),
        (TypeError, {"seed": 1.0}, "seed must be an integer, got 1.0"),
        (TypeError, {"seed": True}, "seed must be an integer, got True"),
        (ValueError, {"episodes": [0, 1]}, "pass seed too"),
        (ValueError, {"seed": 0, "episodes": [0]}, r"has shape \(1,\).* 2 worlds"),
        (ValueError, {"seed": 0, "episodes": [0, -1]}, r"counted 0, 1, 2.*\[0, -1\]"),
    ],
)
def test_a_wrong_reset_changes_nothing(
    make_env, error, arguments, message, assert_same
):
    env = make_env(2)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(error, match=message):
        env.reset(**arguments)
    assert_same(env.get_state(), before)


def test_a_state_that_does_not_fit_changes_nothing(make_env, assert_same):
    env = make_env(3)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(ValueError, match="does not fit"):
        env.set_state(before, [0, 1])
    with pytest.raises(ValueError, match="does not fit"):
        env.set_state(replace(before, memory={}))
    with pytest.raises(ValueError, match="name a world twice"):
        env.set_state(before, [0, 1, 1])
    with pytest.raises(IndexError):
        env.set_state(before, [0, 1, 3])
    assert_same(env.get_state(), before)


def test_some_worlds_cannot_be_restored_before_all_have_started(make_env, assert_same):
    env, fresh = make_env(2), make_env(2)
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match=r"call reset\(\) before set_state\(\)"):
        fresh.set_state(env.get_state([0]), [1])
    fresh.set_state(env.get_state())
    assert_same(fresh.get_state(), env.get_state())


def test_a_picture_of_no_world_or_of_no_size_is_refused(make_env):
    env = make_env(2)
    env.reset()
    with pytest.raises(IndexError, match="no world 2; worlds are 0 to 1"):
        env.render(2)
    with pytest.raises(ValueError, match=r"width must be .*1920, got 5000"):
        env.render(width=5000)
