"""Tasks of BenchMARL; `examples/train_benchmarl.py` trains on one."""

import pytest

pytest.importorskip("benchmarl")

from collaborative_gym.adapters.benchmarl import BenchMARLTask
from collaborative_gym.rng import (
    training_seed,
    validation_seed,
)


def test_every_experiment_of_a_task_evaluates_on_episodes_of_its_own():
    task = BenchMARLTask("PokeTaskSawyers-v0", {"max_episode_steps": 3})
    for seed in (0, 1):  # BenchMARL gives one task to all seeds and algorithms
        for draw in (validation_seed, training_seed):
            env = task.get_env_fun(2, True, seed, "cpu")()
            assert task.max_steps(env) == 3
            env.reset()
            assert set(env.vector_env.progress["seed"].tolist()) == {draw(seed)}
            env.close()
