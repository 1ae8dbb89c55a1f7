"""Blocks of any shape and type, up to the edge and into a training run."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.blocks import Block, columns_of
from collaborative_gym.policies.network import NetworkPolicy


@pytest.fixture
def seeing(carry):
    """Return the small task with a block for each mate, and a picture."""

    class Seeing(type(carry())):
        def observe(self, facts):
            mates = np.stack([facts.tcp[agent][0] for agent in self.agents], axis=1)
            bright = np.clip(255 * facts.cube[0][:, :2, None], 0, 255)
            picture = np.repeat(bright, 3, axis=2).astype(np.uint8)
            own = {"mates": mates, "picture": picture, "met": facts.cube[0][:, :1] > 0}
            return {
                agent: {"joints": facts.joints[agent], **own} for agent in self.agents
            }

    return lambda **settings: Seeing(
        list(carry().robots.values()), carry(**settings).config
    )


def test_blocks_have_shapes_and_types_and_the_flat_view_has_all_of_them(seeing):
    env = cg.make_vec(seeing(), 3, num_threads=1)
    observations, _ = env.reset(seed=0)
    for _ in range(2):
        observations, *_ = env.step(env.expert())
    for agent in env.agents:
        blocks = env.observation_blocks[agent]
        assert list(blocks.values()) == [
            Block("joints", (7,), unit="rad"),
            Block("mates", (2, 3)),
            Block("picture", (2, 3), "uint8"),
            Block("met", (1,), "bool"),
        ]
        assert env.single_observation_spaces[agent].shape == (20,)
        assert observations[agent].dtype == np.float32
        for name, rows in env.task.observe(env.facts)[agent].items():
            flat = observations[agent][:, columns_of(blocks, name)]
            expected = rows.reshape(3, -1).astype(np.float32)
            np.testing.assert_array_equal(flat, expected)


def test_pettingzoo_sees_the_flat_view(seeing):
    env = cg.make(seeing())
    observations, _ = env.reset(seed=0)
    for agent, observation in observations.items():
        assert env.observation_space(agent).contains(observation)
        assert observation.shape == (20,)


def test_a_policys_file_has_the_blocks_that_it_was_trained_on(seeing, tmp_path):
    pytest.importorskip("torch")
    numbers = cg.Hyperparameters(
        total_steps=16,
        num_envs=4,
        rollout_steps=4,
        hidden_sizes=(8,),
        missed_grips=0.5,
        validation_interval=0,
    )
    task = seeing()
    result = cg.train(task, output=tmp_path / "run", hyperparameters=numbers)
    policy = NetworkPolicy.load(result.folder / "policy.safetensors")
    env = cg.make_vec(task, 1, num_threads=1)
    assert policy.layout == env.world.definition.layout
    policy.check(env)
