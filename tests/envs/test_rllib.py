"""The RLlib adapter, by RLlib's own check and its own runner, and by what it adds."""

import gymnasium
import numpy as np
import pytest

import collaborative_gym as cg

pytest.importorskip("ray")

import ray
import torch
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.utils.pre_checks.env import (
    check_multiagent_environments,
)
from ray.tune.registry import ENV_CREATOR, _global_registry

from collaborative_gym.envs.pettingzoo import PettingZooEnv
from collaborative_gym.envs.rllib import RLlibEnv, register_envs
from collaborative_gym.envs.rllib_runner import BatchedEnvRunner
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
    assert env.render().shape == (720, 1280, 3)


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
    assert env.render().shape == (720, 1280, 3)
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


@pytest.fixture
def local_ray():
    """Start a Ray of this test's own."""
    ray.init("local", num_cpus=2, include_dashboard=False, logging_level="ERROR")
    yield
    ray.shutdown()


@pytest.fixture
def config(carry_in_rllib):
    """Return settings by which RLlib plays three worlds in a batch."""
    return (
        PPOConfig()
        .environment(carry_in_rllib, env_config={"max_episode_steps": 4})
        .env_runners(
            env_runner_cls=BatchedEnvRunner,
            num_env_runners=0,
            num_envs_per_env_runner=3,
        )
        .multi_agent(policies=set(AGENTS), policy_mapping_fn=lambda agent, *_: agent)
        .training(train_batch_size_per_learner=30, minibatch_size=10, num_epochs=1)
        .evaluation(evaluation_duration=3)
        .debugging(seed=0)
    )


def test_the_batched_runner_tells_what_happened_in_each_world(config):
    runner = BatchedEnvRunner(config=config)
    parts = [runner.sample(num_timesteps=18) for _ in range(2)]
    assert [len(episode) for episode in parts[0]] == [4, 4, 4, 2, 2, 2]
    assert [len(episode) for episode in parts[1]] == [2, 2, 2, 4, 4, 4]
    assert [episode.is_truncated for episode in parts[0]] == [True] * 3 + [False] * 3
    assert [e.id_ for e in parts[0][3:]] == [e.id_ for e in parts[1][:3]]
    for begun, ended in zip(parts[0][3:], parts[1][:3], strict=True):
        begun.concat_episode(ended)
    other = cg.VectorEnv(runner.env.vector_env.task, 3, seed=0)
    seen, _ = other.reset()
    for episodes in (parts[0][:3], parts[0][3:], parts[1][3:]):
        for step in range(4):
            actions = {}
            for agent in AGENTS:
                singles = [episode.agent_episodes[agent] for episode in episodes]
                rows = np.stack([single.get_observations(step) for single in singles])
                np.testing.assert_array_equal(rows, seen[agent])
                actions[agent] = np.stack([each.get_actions(step) for each in singles])
            seen, rewards, _, _, infos = other.step(actions)
            for agent in AGENTS:
                singles = [episode.agent_episodes[agent] for episode in episodes]
                found = [single.get_rewards(step) for single in singles]
                np.testing.assert_array_equal(found, rewards[agent])
        for agent in AGENTS:
            singles = [episode.agent_episodes[agent] for episode in episodes]
            last = np.stack([single.get_observations(-1) for single in singles])
            np.testing.assert_array_equal(last, infos["final_observation"][agent])
    runner.stop()


def test_the_batched_runner_ends_episodes_that_are_over(config):
    runner = BatchedEnvRunner(config=config)
    runner.env.vector_env.task.over = lambda facts: facts.height > -10.0
    for episode in runner.sample(num_episodes=3):
        singles = episode.agent_episodes.values()
        assert [len(each) for each in (episode, *singles)] == [1, 1, 1]
        assert all(each.is_terminated for each in (episode, *singles))
        assert not any(each.is_truncated for each in (episode, *singles))
    assert runner.get_metrics()["num_episodes"].peek() == 3
    runner.stop()


def test_the_batched_runner_asks_the_module_that_plays_an_agent(config):
    # The agents change places in every other world.
    names = iter([*AGENTS, AGENTS[1], AGENTS[0], *AGENTS] * 9)
    order = []
    config.multi_agent(
        policy_mapping_fn=lambda *_: order.append(next(names)) or order[-1]
    )
    runner = BatchedEnvRunner(config=config)
    for episode in runner.sample(num_timesteps=9):
        for agent, single in episode.agent_episodes.items():
            module = runner.module[episode.module_for(agent)]
            told = torch.from_numpy(single.get_observations(slice(0, 3)))
            inputs = module.forward_exploration({"obs": told})["action_dist_inputs"]
            found = single.get_extra_model_outputs("action_dist_inputs")
            np.testing.assert_allclose(found, inputs.detach().numpy(), atol=1e-5)
            chances = module.get_exploration_action_dist_cls().from_logits(inputs)
            logp = chances.logp(torch.from_numpy(single.get_actions()))
            found = single.get_extra_model_outputs("action_logp")
            np.testing.assert_allclose(found, logp.detach().numpy(), atol=1e-4)
    runner.stop()


def test_the_batched_runner_tells_what_it_does_not_know(config):
    own = config.copy().env_runners(env_to_module_connector=lambda *_: MeanStdFilter())
    with pytest.raises(ValueError, match="knows no connectors between worlds"):
        BatchedEnvRunner(config=own)
    with pytest.raises(ValueError, match="never at random"):
        BatchedEnvRunner(config=config).sample(num_timesteps=3, random_actions=True)


def test_rllib_trains_saves_restores_and_evaluates_by_the_batched_runner(
    config, tmp_path, local_ray
):
    algorithm = config.build_algo()
    untrained = algorithm.get_module("robot_1").state_dict()
    untrained = {name: array.clone() for name, array in untrained.items()}
    found = algorithm.train()["env_runners"]
    assert found["num_env_steps_sampled_lifetime"] == 30
    assert found["num_episodes_lifetime"] == 6
    assert found["episode_len_mean"] == 4
    returns = found["agent_episode_returns_mean"]
    assert found["episode_return_mean"] == pytest.approx(sum(returns.values()))
    algorithm.save_to_path(tmp_path)
    trained = algorithm.get_module("robot_1").state_dict()
    assert any((trained[name] != untrained[name]).any() for name in trained)
    algorithm.stop()
    algorithm = Algorithm.from_checkpoint(tmp_path)
    assert isinstance(algorithm.env_runner, BatchedEnvRunner)
    restored = algorithm.get_module("robot_1").state_dict()
    assert all((restored[name] == trained[name]).all() for name in trained)
    assert algorithm.evaluate()["env_runners"]["num_episodes_lifetime"] == 3
    found = algorithm.train()["env_runners"]
    assert found["num_env_steps_sampled_lifetime"] == 60
    algorithm.stop()
