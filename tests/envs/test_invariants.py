"""The promises of the loop: same bits, isolation, saving, current values."""

import os
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from collaborative_gym.tasks.task import RANDOMIZATIONS
from collaborative_gym.testing import play

CARRY_STEPS = 12


@pytest.fixture(params=["default", "hard"])
def make_env(make_env, request):
    """Return a function that makes worlds, in which much or nothing is disturbed."""
    return partial(make_env, randomization=RANDOMIZATIONS[request.param])


def test_an_episode_has_the_same_bits_in_any_batch(make_env):
    alone = make_env(1)
    alone.reset(seed=3)
    expected = play(alone, 14 * CARRY_STEPS)
    for num_envs in (7, 64):
        env = make_env(num_envs)
        env.reset(seed=3)
        seen = play(env, 14 * CARRY_STEPS // min(num_envs, 14))
        for episode in range(14):
            assert seen[3, episode] == expected[3, episode], (num_envs, episode)


@pytest.mark.parametrize("num_threads", [2, 4])
def test_an_episode_has_the_same_bits_with_any_number_of_threads(make_env, num_threads):
    runs = []
    for threads in (1, num_threads):
        env = make_env(5, num_threads=threads)
        env.reset(seed=1)
        runs.append(play(env, 15))
    assert runs[0] == runs[1]


def test_an_episode_does_not_depend_on_what_was_played_before(make_env):
    fresh, used = make_env(2), make_env(2, seed=9)
    used.reset()
    play(used, 17)
    for env in (fresh, used):
        env.reset(seed=4)
    assert play(fresh, 15) == play(used, 15)


def test_episodes_and_seeds_differ(make_env):
    env = make_env(3)
    first = env.reset(seed=0)[0]["robot_1"]
    second = env.reset(seed=1)[0]["robot_1"]
    assert len(np.unique(np.concatenate([first, second]), axis=0)) == 6


def test_chosen_episodes_are_those_that_a_batch_plays(make_env):
    env = make_env(4)
    expected = env.reset(seed=2)[0]["robot_1"]
    chosen = env.reset(seed=2, episodes=[3, 1, 1, 0])[0]["robot_1"]
    np.testing.assert_array_equal(chosen, expected[[3, 1, 1, 0]])


def test_worlds_that_restart_leave_the_others_alone(make_env):
    env, other = make_env(5), make_env(5)
    env.reset(seed=0)
    other.reset(seed=0)
    late = other.get_state([1, 3])
    late.progress["step"][:] = CARRY_STEPS - 2
    other.set_state(late, [1, 3])
    expected, seen = play(env, 5), play(other, 5)
    assert set(seen) - set(expected) == {(0, 6), (0, 8)}
    for episode in (0, 2, 4):
        assert seen[0, episode] == expected[0, episode]


@pytest.fixture
def elsewhere(monkeypatch, tmp_path):
    """Work in an empty folder, because MuJoCo logs its warnings where it runs."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("qpos", np.nan),
        ("qpos", np.inf),
        ("qvel", np.nan),
        ("qvel", 1e300),
        ("act", np.nan),
    ],
)
def test_a_world_that_diverges_ends_alone(make_env, elsewhere, field, value):
    env, broken = make_env(4), make_env(4)
    for each in (env, broken):
        each.reset(seed=0)
        play(each, 2)
    getattr(broken.sim, field)[2, 0] = value
    expected, seen = play(env, 1), play(broken, 1)
    assert broken.progress["episode"].tolist() == [0, 1, 6, 3]
    for episode in (0, 1, 3):
        assert seen[0, episode] == expected[0, episode]
    expected, seen = play(env, 5), play(broken, 5)
    for episode in (0, 1, 3):
        assert seen[0, episode] == expected[0, episode]


def test_a_world_that_diverges_reports_it_and_goes_on(make_env, elsewhere):
    env = make_env(3, height=-1.0)
    env.reset(seed=0)
    play(env, 4)
    given = env.step({agent: np.zeros((3, 8)) for agent in env.agents})[0]
    last = {agent: array.copy() for agent, array in given.items()}
    for array in given.values():
        array[:] = 0.0
    env.sim.qpos[1] = np.nan
    observations, rewards, terminated, truncated, infos = env.step(
        {agent: np.ones((3, 8)) for agent in env.agents}
    )
    assert infos["diverged"].tolist() == [False, True, False]
    assert infos["success"].tolist() == [True, False, True]
    assert infos["metrics"]["completion"][1] == 0.0
    assert infos["metrics"]["performance"][1] == 0.0
    assert infos["metrics"]["length"][1] == 6
    for agent in env.agents:
        assert truncated[agent].tolist() == [False, True, False]
        assert not terminated[agent].any()
        assert rewards[agent][1] == 0.0
        np.testing.assert_array_equal(
            infos["final_observation"][agent][1], last[agent][1]
        )
        assert np.isfinite(observations[agent]).all()
    fresh = make_env(3, height=-1.0)
    start = fresh.reset(seed=0, episodes=[0, 4, 2])[0]
    np.testing.assert_array_equal(observations["robot_1"][1], start["robot_1"][1])
    after = play(env, CARRY_STEPS)
    assert after[0, 4] == play(fresh, CARRY_STEPS)[0, 4]


def test_a_saved_episode_continues_bit_for_bit(make_env):
    env = make_env(3)
    env.reset(seed=5)
    play(env, 2)  # a push that is remembered comes in step 3
    state = env.get_state()
    expected = play(env, 20)
    env.set_state(state)
    assert play(env, 20) == expected


def test_a_saved_episode_continues_in_another_environment(make_env):
    env, other = make_env(3), make_env(6)
    env.reset(seed=5)
    play(env, 2)  # a push that is remembered comes in step 3
    state = env.get_state([0, 2])
    expected = play(env, 8)
    other.reset(seed=77)
    play(other, 2)
    other.set_state(state, [5, 1])
    assert other.progress["seed"].tolist() == [77, 5, 77, 77, 77, 5]
    seen = play(other, 8)
    for episode in (0, 2):
        assert seen[5, episode] == expected[5, episode]


def test_observations_describe_the_state_after_the_step(make_env):
    env = make_env(2, randomization=RANDOMIZATIONS["paper"])
    env.reset(seed=0)
    play(env, 3)
    observations = env.set_state(env.get_state())
    start = env.observation_blocks["robot_1"]["joints"].size
    for i in range(2):
        data = env.sim.data(i)
        tcp = data.site("robot_1/tcp").xpos
        np.testing.assert_array_equal(
            observations["robot_1"][i, start : start + 3], tcp.astype(np.float32)
        )
        np.testing.assert_array_equal(env.sim.sensordata[i], data.sensordata)


EPISODE = """
import hashlib
import numpy as np
import collaborative_gym as cg

def played():
    env = cg.make_vec("PassTaskJacoSawyer-v0", 2, seed=3, num_threads=1)
    observations, _ = env.reset()
    rng, seen = np.random.default_rng(0), hashlib.sha256()
    for step in range(15):
        actions = env.expert() if step % 2 else {
            agent: rng.uniform(-1, 1, (2, *space.shape))
            for agent, space in env.single_action_spaces.items()
        }
        observations, rewards, *_ = env.step(actions)
        for agent in env.agents:
            seen.update(observations[agent].tobytes() + rewards[agent].tobytes())
    seen.update(env.get_state().physics.tobytes())
    return seen.hexdigest()
"""


def test_an_episode_has_the_same_bits_in_fresh_processes():
    here = {}
    exec(EPISODE, here)
    command = [sys.executable, "-c", EPISODE + "print(played())"]
    told = [
        subprocess.run(
            command,
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for seed in ("1", "2")
    ]
    assert told == [here["played"]()] * 2
