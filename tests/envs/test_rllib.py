"""The RLlib adapter, by RLlib's own check and its own runner, and by what it adds."""

import gymnasium
import numpy as np
import pytest

import collaborative_gym as cg

pytest.importorskip("ray")

from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.utils.pre_checks.env import (
    check_multiagent_environments,
)
from ray.tune.registry import ENV_CREATOR, _global_registry

from collaborative_gym.envs.pettingzoo import PettingZooEnv
from collaborative_gym.envs.rllib import RLlibEnv, register_envs
from collaborative_gym.tasks import registry

pytestmark = pytest.mark.slow

AGENTS = ["robot_1", "robot_2"]


@pytest.fixture
def env(carry):
    env = RLlibEnv(carry(), "rgb_array", "Carry-v0")
    yield env
    env.close()


@pytest.fixture
def carry_in_rllib(carry_id):
    """Return an id under which RLlib too finds the small task."""
    register_envs()
    yield carry_id
    _global_registry.unregister(ENV_CREATOR, carry_id)


def test_rllib_accepts_it(env):
    check_multiagent_environments(env)
    assert env.possible_agents == AGENTS
    assert env.get_observation_space("robot_1").shape == (19,)
    assert env.get_action_space("robot_2").shape == (8,)


def test_it_plays_what_the_pettingzoo_environment_plays(env, carry):
    other = PettingZooEnv(carry())
    expected, found = other.reset(seed=3)[0], env.reset(seed=3)[0]
    rng = np.random.default_rng(0)
    for step in range(12):
        for agent in AGENTS:
            np.testing.assert_array_equal(found[agent], expected[agent])
        actions = {agent: rng.uniform(-1, 1, 8) for agent in AGENTS}
        expected, rewards, *_ = other.step(actions)
        found, *rest = env.step(actions)
        assert rest[0] == rewards
        assert rest[1] == {"robot_1": False, "robot_2": False, "__all__": False}
        assert rest[2] == dict.fromkeys([*AGENTS, "__all__"], step == 11)
    assert rest[3]["robot_1"]["metrics"]["length"] == 12
    assert env.render().shape == (480, 640, 3)


def test_an_episode_that_is_over_is_terminated_for_all(env):
    env.reset(seed=0)
    env.env.vector_env.task.over = lambda facts: facts.height > -10.0
    *_, terminated, truncated, _ = env.step({a: np.zeros(8) for a in AGENTS})
    assert terminated == dict.fromkeys([*AGENTS, "__all__"], True)
    assert truncated == dict.fromkeys([*AGENTS, "__all__"], False)


def test_every_id_is_registered_with_its_options(carry_in_rllib):
    for env_id in cg.list_envs():
        assert _global_registry.contains(ENV_CREATOR, env_id)
    make = _global_registry.get(ENV_CREATOR, carry_in_rllib)
    options = {"robots": ("panda", "jaco"), "max_episode_steps": 5}
    env = make({**options, "render_mode": "rgb_array"})
    env.reset(seed=0)
    assert env.render().shape == (480, 640, 3)
    task = env.env.vector_env.task
    assert task.robots["robot_2"].name == "jaco"
    assert task.config.max_episode_steps == 5
    assert env.metadata["name"] == carry_in_rllib


def test_another_process_makes_an_id_that_it_does_not_know(carry_in_rllib, monkeypatch):
    make = _global_registry.get(ENV_CREATOR, carry_in_rllib)
    monkeypatch.delitem(registry._ENVS, carry_in_rllib)
    monkeypatch.delitem(gymnasium.registry, carry_in_rllib)
    with pytest.raises(KeyError, match="no environment"):
        cg.make(carry_in_rllib)
    assert make({}).possible_agents == AGENTS


def test_rllibs_own_runner_collects_whole_episodes(carry_in_rllib):
    config = (
        PPOConfig()
        .environment(carry_in_rllib, env_config={"max_episode_steps": 4})
        .env_runners(num_envs_per_env_runner=2)
        .multi_agent(policies=set(AGENTS), policy_mapping_fn=lambda agent, *_: agent)
    )
    runner = MultiAgentEnvRunner(config=config)
    episodes = runner.sample(num_episodes=2)
    assert len(episodes) == 2
    for episode in episodes:
        assert episode.is_truncated
        assert episode.env_steps() == 4
        assert set(episode.agent_ids) == set(AGENTS)
    runner.stop()
