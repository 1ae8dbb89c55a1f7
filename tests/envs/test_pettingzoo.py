"""The PettingZoo adapter, by PettingZoo's own tests and by what ours adds."""

from types import SimpleNamespace

import numpy as np
import pytest
from pettingzoo import ParallelEnv
from pettingzoo.test import (
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
)
from pettingzoo.utils.conversions import parallel_to_aec

import collaborative_gym as cg
from collaborative_gym.envs.pettingzoo import PettingZooEnv

LENGTH = 12


@pytest.fixture
def env(carry):
    env = PettingZooEnv(carry(), "rgb_array", name="Carry-v0")
    yield env
    env.close()


def idle(env):
    return {agent: np.zeros(8) for agent in env.possible_agents}


def test_pettingzoo_parallel_api(env):
    parallel_api_test(env, num_cycles=30)


def test_pettingzoo_seeds(carry):
    parallel_seed_test(lambda: PettingZooEnv(carry()), num_cycles=30)


def test_pettingzoo_max_cycles(carry):
    def make(max_cycles):
        return PettingZooEnv(carry(max_episode_steps=max_cycles))

    max_cycles_test(
        SimpleNamespace(
            parallel_env=make, env=lambda max_cycles: parallel_to_aec(make(max_cycles))
        )
    )


def test_pettingzoo_rendering(carry):
    def make(render_mode):
        # PettingZoo begins with a mode "human" that it then never draws in.
        mode = None if render_mode == "human" else render_mode
        return parallel_to_aec(PettingZooEnv(carry(), mode))

    render_test(make)


def test_an_environment_says_what_it_is(env):
    assert isinstance(env, ParallelEnv)
    assert str(env) == env.metadata["name"] == "Carry-v0"
    assert env.metadata["render_modes"] == ["rgb_array"]
    assert env.metadata["render_fps"] == 10
    assert env.metadata["is_parallelizable"]
    assert env.possible_agents == ["robot_1", "robot_2"]
    assert env.observation_space("robot_1").shape == (19,)
    assert env.action_space("robot_2").shape == (8,)
    assert env.state_space.shape == (38,)


def test_it_plays_the_same_episode_as_a_batch(env, make_env):
    batch = make_env(3)
    expected = batch.reset(seed=4)[0]
    observations, infos = env.reset(seed=4)
    assert infos["robot_1"]["metrics"]["length"] == 0
    for _ in range(3):
        for agent in env.agents:
            assert observations[agent].dtype == np.float32
            np.testing.assert_array_equal(observations[agent], expected[agent][0])
        state = np.concatenate([expected[agent][0] for agent in env.agents])
        np.testing.assert_array_equal(env.state(), state)
        expected = batch.step({agent: np.zeros((3, 8)) for agent in env.agents})[0]
        observations = env.step(idle(env))[0]


def test_an_episode_ends_with_its_own_last_observation_and_metrics(env):
    env.reset(seed=0)
    total = dict.fromkeys(env.agents, 0.0)
    for step in range(LENGTH):
        assert env.agents == ["robot_1", "robot_2"]
        batch = env.vector_env.expert()
        actions = {agent: rows[0] for agent, rows in batch.items()}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        assert terminated == {"robot_1": False, "robot_2": False}
        for agent, reward in rewards.items():
            assert type(reward) is float
            total[agent] += reward
            info = infos[agent]
            assert sum(info["reward_terms"].values()) == pytest.approx(reward)
            assert info["success"] is (observations[agent][16] > 0.6).item()
            assert info["diverged"] is False
            assert info["metrics"]["length"] == step + 1
            assert truncated[agent] is (step == LENGTH - 1)
    assert env.agents == []
    assert observations["robot_1"][16] > 0.7
    metrics = infos["robot_2"]["metrics"]
    assert metrics["returns"] == pytest.approx(total)
    assert metrics["length"] == LENGTH
    assert metrics["completion"] == 1.0
    with pytest.raises(RuntimeError, match=r"ended; call reset\(\)"):
        env.step(actions)
    env.reset()
    assert env.agents == ["robot_1", "robot_2"]
    assert env.vector_env.progress["episode"][0] == 1


def test_a_failure_has_no_time_to_success(env):
    env.reset(seed=0)
    while env.agents:
        infos = env.step(idle(env))[-1]
    assert infos["robot_1"]["metrics"]["time_to_success"] is None


def test_without_a_seed_environments_differ_and_go_on(carry):
    starts = []
    for _ in range(2):
        env = PettingZooEnv(carry())
        starts += [env.reset()[0]["robot_1"] for _ in range(2)]
    assert len(np.unique(starts, axis=0)) == 4


def test_the_last_picture_is_of_the_ended_episode(env):
    env.reset(seed=0)
    first = env.render()
    while env.agents:
        batch = env.vector_env.expert()
        env.step({agent: rows[0] for agent, rows in batch.items()})
    assert first.shape == (720, 1280, 3)
    assert np.abs(env.render().astype(float) - first).mean() > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda a: {**a, "robot_2": np.zeros(7)},
            r"robot_2 has shape \(7,\), not \(8,\)",
        ),
        (lambda a: {"robot_1": a["robot_1"]}, r"robot_2, got keys \['robot_1'\]"),
        (lambda a: {}, r"got keys \[\]"),
        (lambda a: np.zeros(16), "must be a dictionary"),
        (lambda a: {**a, "robot_1": np.full(8, np.nan)}, "robot_1 in world 0 is nan"),
    ],
)
def test_wrong_actions_change_nothing(env, change, message):
    env.reset(seed=0)
    before = env.vector_env.get_state().physics
    with pytest.raises(ValueError, match=message):
        env.step(change(idle(env)))
    np.testing.assert_array_equal(env.vector_env.get_state().physics, before)


def test_calls_out_of_order_say_so(env):
    for call in (lambda: env.step(idle(env)), env.render, env.state):
        with pytest.raises(RuntimeError, match=r"call reset\(\) before"):
            call()
    env.reset()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(idle(env))
    env.close()


def test_pictures_need_a_render_mode(carry):
    with pytest.raises(
        KeyError,
        match=r"no render mode 'human'; .* rgb_array; `collaborative-gym view`",
    ):
        PettingZooEnv(carry(), "human")
    env = PettingZooEnv(carry())
    env.reset()
    with pytest.raises(RuntimeError, match="make it with render_mode='rgb_array'"):
        env.render()


def test_make_finds_an_environment_by_id_or_task(carry_id):
    assert str(cg.make(carry_id)) == carry_id
    env = cg.make("Carry", robots=("panda", "jaco"), max_episode_steps=3)
    assert env.vector_env.task.robots["robot_2"].name == "jaco"
    assert env.vector_env.task.config.max_episode_steps == 3
    assert env.vector_env.task.config.randomization == cg.Randomization()


def shape(value):
    """Return the nested names in an info."""
    if not isinstance(value, dict):
        return None
    return {name: shape(part) for name, part in value.items()}


def test_infos_have_the_same_names_at_every_reset_and_step(env):
    infos = env.reset(seed=0)[1]
    expected = shape(infos)
    assert set(expected["robot_1"]) == {
        "success",
        "diverged",
        "reward_terms",
        "metrics",
    }
    while env.agents:
        assert shape(env.step(idle(env))[-1]) == expected
    assert shape(env.reset()[1]) == expected


def test_agents_of_several_sides_are_told_of_their_own(carry, monkeypatch):
    task = carry()
    parts = {
        "sides": (("robot_1",), ("robot_2",)),
        "success": lambda self, facts: (facts.height > 0.6, facts.height < 0.6),
        "performing": lambda self, facts: (facts.height > 0.6, facts.height < 0.6),
        "reward": lambda self, facts, actions: {
            "robot_1": {"height": facts.height},
            "robot_2": {"height": -facts.height},
        },
        "over": lambda self, facts: facts.height > 0.6,
    }
    for name, part in parts.items():
        monkeypatch.setattr(type(task), name, part)
    env = PettingZooEnv(task)
    infos = env.reset(seed=0)[1]
    assert [infos[agent]["success"] for agent in env.agents] == [False, True]
    terminated = {}
    while env.agents:
        batch = env.vector_env.expert()
        actions = {agent: rows[0] for agent, rows in batch.items()}
        _, _, terminated, truncated, infos = env.step(actions)
    assert terminated == {"robot_1": True, "robot_2": True}
    assert truncated == {"robot_1": False, "robot_2": False}
    one, two = (infos[agent]["metrics"] for agent in ("robot_1", "robot_2"))
    assert one["return"] == one["returns"]["robot_1"] == -two["return"]
    assert one["time_to_success"] > two["time_to_success"] == 0.1
    parallel_api_test(PettingZooEnv(task), num_cycles=30)
