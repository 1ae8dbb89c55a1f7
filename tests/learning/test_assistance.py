"""What is carried of the weight of loose things while they are hard to lift."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.learning.assistance import Assistance


@pytest.fixture(scope="module")
def env():
    """Return a world whose pot is in the air, after `fallen` has put it there."""
    env = cg.make_vec("Lift", 1, robots=("jaco", "jaco"), num_threads=1)
    yield env
    env.close()


def fallen(env, assistance):
    """Return how far a pot in the air falls in two control steps, in m."""
    env.reset(seed=0)
    env.scene.place(env.sim, [0], name="pot", position=np.array([0.0, 0.0, 2.5]))
    for _ in range(2):
        assistance.lift(env)
        env.step(env.idle())
    return 2.5 - env.facts.pot[0][0, 2]


def test_a_share_of_the_weight_is_carried(env):
    freely = fallen(env, Assistance(0.0))
    assert freely == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.1)
    assert fallen(env, Assistance(0.5)) == pytest.approx(0.5 * freely, rel=0.02)
    assert fallen(env, Assistance(1.0)) == pytest.approx(0.0, abs=1e-4)


def test_what_was_carried_falls_when_the_share_is_gone(env):
    assistance = Assistance(1.0)
    fallen(env, assistance)
    assert env.sim.xfrc_applied.any()
    assistance.share = 0.0
    assistance.lift(env)
    assert not env.sim.xfrc_applied.any()


def test_the_share_falls_to_nothing_where_half_is_completed():
    assistance = Assistance(0.015)
    assistance.adapt([])
    assistance.adapt([{"completion": 0.0}, {"completion": 0.0}, {"completion": 1.0}])
    assert (assistance.share, assistance.demand) == (0.015, 0.0)
    assistance.adapt([{"completion": 0.0}, {"completion": 1.0}])
    assert assistance.share == pytest.approx(0.005)
    assert assistance.demand == pytest.approx(0.02)
    assistance.adapt([{"completion": 1.0}])
    assert assistance.share == 0.0
