"""Starts of episodes, drawn for many worlds at a time."""

import numpy as np


def test_the_starts_of_all_worlds_are_drawn_together(carry, monkeypatch):
    task, sizes = carry(), []
    own = type(task).reset

    def reset(self, sim, env_ids, *, rng):
        sizes.append(len(env_ids))
        own(self, sim, env_ids, rng=rng)

    monkeypatch.setattr(type(task), "reset", reset)
    from collaborative_gym.envs.vector_env import VectorEnv

    env = VectorEnv(task, 8, num_threads=1)
    sizes.clear()
    env.reset(stagger=True)
    ends = np.zeros(8, int)
    while ends.min() < 3:
        *_, infos = env.step(env.idle())
        ends += infos["ended"]
    # Those of the reset, and then once for each round of episodes.
    assert sizes[0] == 8 and len(sizes) <= 6 and sum(sizes) <= 8 * 6


def test_a_start_that_fails_is_drawn_again(carry, monkeypatch):
    from collaborative_gym.envs.vector_env import VectorEnv

    task = carry()
    env, plain = VectorEnv(task, 2, num_threads=1), VectorEnv(task, 2, num_threads=1)
    own, kind = type(task).reset, type(task)

    def fails(self, sim, env_ids, *, rng):
        own(self, sim, env_ids, rng=rng)
        raise OSError("no disk")

    monkeypatch.setattr(kind, "reset", fails)
    for _ in range(2):
        try:
            env.reset(seed=3)
        except OSError:
            continue
        raise AssertionError
    monkeypatch.setattr(kind, "reset", own)
    for agent, rows in env.reset(seed=3)[0].items():
        np.testing.assert_array_equal(rows, plain.reset(seed=3)[0][agent])
