"""Starts of episodes, drawn for many worlds at a time, and checked."""

from itertools import product

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.envs.starts import deepest
from collaborative_gym.rng import EpisodeRandom

FOLDED = [0.0, -1.7, 0.0, -1.5, 0.0, 0.1, 0.0]
"""Joint angles at which a Panda's hand is in its own forearm."""


@pytest.fixture
def starting(carry):
    """Return a function that makes the small task with another end of `reset`."""

    def make(ending):
        task = carry()

        class Starting(type(task)):
            def reset(self, sim, env_ids, *, rng):
                super().reset(sim, env_ids, rng=rng)
                ending(self, sim, env_ids, rng)

        return Starting(tuple(task.robots.values()), task.config)

    return make


def put_cube(task, sim, env_ids, heights):
    place = np.zeros((len(env_ids), 3))
    place[:, 2] = heights
    task.scene.place(sim, env_ids, name="cube", position=place)


def test_a_start_in_which_something_is_inside_something_else_is_drawn_again(starting):
    drawn = []

    def ending(task, sim, env_ids, rng):
        height = rng.uniform(0.0, 0.5)
        drawn.append((list(env_ids), height))
        put_cube(task, sim, env_ids, height)

    env = cg.VectorEnv(starting(ending), 32, num_threads=1)
    drawn.clear()
    observations, _ = env.reset(seed=0)
    # The cube's half is 0.03 m high.
    (_, first), (again, _), *_ = drawn
    assert 0 < len(again) < 8 and again == list(np.flatnonzero(first < 0.029))
    height = env.sim.qpos[:, -5]
    np.testing.assert_array_equal(height[first >= 0.029], first[first >= 0.029])
    assert (height >= 0.029).all() and max(deepest(env.sim, i)[0] for i in again) < 1e-3
    # It is drawn by its own generator: the same alone as among others.
    alone = cg.VectorEnv(env.task, 1, num_threads=1)
    for episode in again[:2]:
        own, _ = alone.reset(seed=0, episodes=[episode])
        assert alone.sim.qpos[0, -5] == height[episode]
        for agent in env.agents:
            np.testing.assert_array_equal(own[agent][0], observations[agent][episode])


def test_what_is_less_than_a_millimetre_deep_may_be(starting):
    def ending(task, sim, env_ids, rng):
        put_cube(task, sim, env_ids, 0.0292)

    env = cg.VectorEnv(starting(ending), 1)
    env.reset(seed=0)
    assert deepest(env.sim, 0)[0] == pytest.approx(8e-4)


def test_a_task_without_a_sound_start_is_refused_by_name(starting):
    def in_the_floor(task, sim, env_ids, rng):
        put_cube(task, sim, env_ids, 0.0)

    def in_itself(task, sim, env_ids, rng):
        task.scene.bend(sim, env_ids, agent="robot_2", angles=FOLDED)

    def in_another(task, sim, env_ids, rng):
        for agent in task.agents:
            angles = [0.0, 1.2, 0.0, -0.6, 0.0, 1.8, 0.0]
            task.scene.bend(sim, env_ids, agent=agent, angles=angles)

    for ending, one, other in (
        (in_the_floor, "world", "cube/cube"),
        (in_itself, "robot_2/", "robot_2/"),
        (in_another, "robot_1/", "robot_2/"),
    ):
        told = rf"Starting: {one}.* and {other}.* are \d+\.\d mm deep in one another at"
        with pytest.raises(ValueError, match=told):
            cg.VectorEnv(starting(ending), 1)


@pytest.mark.slow
@pytest.mark.parametrize("task", cg.list_tasks())
def test_the_first_draw_of_every_team_is_sound_within_usual_bounds(task, monkeypatch):
    def rows(self, which):
        raise AssertionError(f"{len(which)} starts are drawn again")

    monkeypatch.setattr(EpisodeRandom, "rows", rows)
    count = cg.task(task).robot_counts[0]
    for team in product(("panda", "sawyer", "jaco"), repeat=count):
        usual = cg.task(task, team, randomization=cg.Randomization())
        env = cg.VectorEnv(usual, 128, num_threads=1)
        env.reset(seed=0)


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
