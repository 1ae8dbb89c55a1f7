import json
import math

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.evaluation import speed
from collaborative_gym.evaluation.speed import benchmark


@pytest.fixture(scope="module")
def measured():
    # Random actions end an episode of it long before its time is over.
    return benchmark(["TugPandas-v0"], num_envs=4, num_threads=1)


def test_benchmark_measures_every_number(measured):
    (own,) = measured.environments
    for value in (own.expert.bare, own.random.env, own.single_rate, *own.make_s):
        assert math.isfinite(value) and value > 0
    assert 0 < own.expert.ratio < 2 and 0 < own.random.ratio < 2
    assert 0 < own.kb_per_env < 1000


def test_benchmark_names_the_machine(measured):
    content = json.loads(measured.to_json())
    assert content["machine"]["cpu"] and content["machine"]["cores"] >= 1
    assert content["num_envs"] == 4 and content["num_threads"] == 1


def test_unknown_environment_shows_before_the_work():
    with pytest.raises(KeyError, match="PokeTaskSawyers-v0"):
        benchmark(["PokeTaskSawyers-v0", "PokeTaskSawyer-v0"])


def test_bare_physics_is_that_of_the_environment():
    env = cg.make_vec("AssemblePandas3-v0", 2, num_threads=1)
    env.reset(seed=0)
    for _ in range(45):  # Hands hold the parts then, each where it took its own.
        env.step(env.expert())
    actions = env.expert()
    commands = env.action_mode.commands(env.action_mode.check(actions))
    before = env.sim.get_state()
    controls = env.action_mode.prepare(commands)
    assert env.sim.eq_active.any()
    state = env.sim.get_state()
    speed._roll(env, state, controls, clock=lambda: 0.0)
    alone = env.sim.qpos.copy()
    env.sim.set_state(before)
    env.step(actions)
    assert np.array_equal(alone, env.sim.qpos)
