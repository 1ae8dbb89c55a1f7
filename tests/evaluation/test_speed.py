import json
import math

import pytest

from collaborative_gym.evaluation.speed import benchmark


@pytest.fixture(scope="module")
def measured():
    # Random actions end an episode of it long before its time is over.
    return benchmark(["TugPandas-v0"], num_envs=4, num_threads=1)


def test_benchmark_measures_every_number(measured):
    (speed,) = measured.environments
    for value in (
        speed.expert.bare,
        speed.random.env,
        speed.single_rate,
        *speed.make_s,
    ):
        assert math.isfinite(value) and value > 0
    assert 0 < speed.expert.ratio < 2 and 0 < speed.random.ratio < 2
    assert 0 < speed.kb_per_env < 1000


def test_benchmark_names_the_machine(measured):
    content = json.loads(measured.to_json())
    assert content["machine"]["cpu"] and content["machine"]["cores"] >= 1
    assert content["num_envs"] == 4 and content["num_threads"] == 1


def test_unknown_environment_shows_before_the_work():
    with pytest.raises(KeyError, match="PokeTaskSawyers-v0"):
        benchmark(["PokeTaskSawyers-v0", "PokeTaskSawyer-v0"])
