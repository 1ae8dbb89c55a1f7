"""skrl's own trainer and learner on a batch of worlds."""

import numpy as np
import pytest
import torch
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.multi_agents.torch.mappo import MAPPO, MAPPO_CFG
from skrl.trainers.torch import SequentialTrainer
from skrl.trainers.torch.sequential import SequentialTrainerCfg

import collaborative_gym as cg
import collaborative_gym.adapters.skrl as adapter

BALANCE = "BalanceTaskJacoSawyer-v0"
LENGTH = 4


@pytest.fixture
def env():
    worlds = cg.make_vec(BALANCE, 3, num_threads=1, max_episode_steps=LENGTH)
    env = adapter.SkrlEnv(worlds)
    yield env
    env.close()


class Actor(GaussianMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.layer = torch.nn.Linear(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        return self.layer(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.layer = torch.nn.Linear(self.num_states, 1)

    def compute(self, inputs, role):
        return self.layer(inputs["states"]), {}


def test_it_passes_on_what_the_worlds_say(env):
    twin = cg.make_vec(BALANCE, 3, num_threads=1, max_episode_steps=LENGTH)
    expected, _ = twin.reset()
    observations, _ = env.reset()
    rng = np.random.default_rng(0)
    for step in range(LENGTH + 1):
        for agent in twin.agents:
            np.testing.assert_array_equal(observations[agent], expected[agent])
            joined = np.concatenate([*expected.values()], axis=1)
            np.testing.assert_array_equal(env.state()[agent], joined)
        actions = {
            agent: rng.uniform(-1, 1, (3, *space.shape)).astype(np.float32)
            for agent, space in twin.single_action_spaces.items()
        }
        observations, rewards, terminated, truncated, infos = env.step(
            {agent: torch.as_tensor(given) for agent, given in actions.items()}
        )
        expected, gained, *_, told = twin.step(actions)
        if step == LENGTH - 1:
            value = told["metrics"]["performance"].mean()
            assert infos["episode"]["performance"].item() == pytest.approx(value)
        else:
            assert infos["episode"] == {}
        for agent in twin.agents:
            np.testing.assert_array_equal(rewards[agent][:, 0], gained[agent])
            assert not terminated[agent].any()
            assert truncated[agent].tolist() == [[step == LENGTH - 1]] * 3
    twin.close()


def test_skrls_trainer_and_learner_run_on_it(env, tmp_path):
    models, memories = {}, {}
    for agent in env.possible_agents:
        spaces = {
            "observation_space": env.observation_space(agent),
            "state_space": env.state_space(agent),
            "action_space": env.action_space(agent),
            "device": env.device,
        }
        models[agent] = {"policy": Actor(**spaces), "value": Critic(**spaces)}
        memories[agent] = RandomMemory(memory_size=8, num_envs=env.num_envs)
    before = models["robot_1"]["policy"].layer.weight.detach().clone()
    # skrl divides what its functions are told by agent, but not nothing.
    nothing = {agent: {} for agent in env.possible_agents}
    cfg = MAPPO_CFG(
        rollouts=8,
        learning_epochs=1,
        mini_batches=1,
        learning_rate_scheduler_kwargs={**nothing},
        observation_preprocessor_kwargs={**nothing},
        state_preprocessor_kwargs={**nothing},
        value_preprocessor_kwargs={**nothing},
    )
    cfg.experiment.write_interval = cfg.experiment.checkpoint_interval = 0
    cfg.experiment.directory = str(tmp_path)
    learner = MAPPO(
        possible_agents=env.possible_agents,
        models=models,
        memories=memories,
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        device=env.device,
        cfg=cfg,
    )
    options = SequentialTrainerCfg(
        timesteps=8,
        headless=True,
        disable_progressbar=True,
        close_environment_at_exit=False,
    )
    SequentialTrainer(env=env, agents=learner, cfg=options).train()
    after = models["robot_1"]["policy"].layer.weight.detach()
    assert torch.isfinite(after).all()
    assert not torch.equal(before, after)
