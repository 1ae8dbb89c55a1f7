import mujoco
import numpy as np
import pytest

from collaborative_gym.viewer.spring import Spring


@pytest.fixture
def env(make_env):
    env = make_env()
    env.reset()
    return env


@pytest.fixture
def forces(env):
    """Return the live force and torque on the cube."""
    return env.sim.xfrc_applied[0, env.model.body("cube/cube").id]


@pytest.fixture
def pull(env):
    """Return a pull at the cube's centre, to a place 0.2 m above."""
    perturb = mujoco.MjvPerturb()
    perturb.select = env.model.body("cube/cube").id
    perturb.active = mujoco.mjtPertBit.mjPERT_TRANSLATE.value
    perturb.refselpos = env.facts.cube[0][0] + [0.0, 0.0, 0.2]
    return perturb


def test_it_pulls_towards_the_place(env, forces, pull):
    Spring(env).pull(pull)
    stiffness = env.model.vis.map.stiffness * pull.localmass
    np.testing.assert_allclose(forces[:3], [0, 0, 0.2 * stiffness], atol=1e-6)
    np.testing.assert_allclose(forces[3:], 0.0, atol=1e-9)
    assert pull.localmass == pytest.approx(1.0, rel=1e-3)  # The cube's.


def test_pulled_aside_of_its_middle_a_body_turns(env, forces, pull):
    pull.localpos = [0.03, 0.0, 0.0]
    Spring(env).pull(pull)
    assert forces[4] < -0.1


def test_the_mass_is_found_once_and_kept(env, forces, pull):
    spring = Spring(env)
    pull.localmass = 2.5
    spring.pull(pull)
    assert pull.localmass == 2.5
    np.testing.assert_allclose(forces[2], 0.2 * 2.5 * env.model.vis.map.stiffness)


def test_it_adds_to_what_acts_and_leaves_that_when_let_go(env, forces, pull):
    spring, before = Spring(env), np.array([0.1, -7.3, 1 / 3, 0.0, 0.2, 0.0])
    forces[:] = before
    spring.pull(pull)
    assert forces[2] > before[2] + 1.0
    np.testing.assert_array_equal(forces[:2], before[:2])
    spring.pull(pull)
    spring.pull(None)
    np.testing.assert_array_equal(forces, before)


def test_what_the_task_writes_meanwhile_is_kept(env, forces, pull):
    spring = Spring(env)
    pull.refselpos += [0.1, 0.0, 0.0]
    for _ in range(3):
        spring.pull(pull)
        forces[2] = 5.0  # And this alone, as a push from above.
        spring.pull(pull)
    spring.pull(None)
    np.testing.assert_array_equal(forces, [0, 0, 5.0, 0, 0, 0])


def test_after_a_reset_nothing_is_put_back(env, forces, pull):
    spring = Spring(env)
    forces[:] = 5.0
    spring.pull(pull)
    env.reset()
    spring.forget()
    spring.pull(None)
    np.testing.assert_array_equal(forces, 0.0)


@pytest.mark.parametrize(("field", "value"), [("active", 0), ("select", 0)])
def test_nobody_is_pulled_without_a_grip_or_a_body(env, pull, field, value):
    setattr(pull, field, value)
    Spring(env).pull(pull)
    assert not env.sim.xfrc_applied.any()
