"""The CPU backend against plain MuJoCo."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from collaborative_gym.errors import SimulationDiverged
from collaborative_gym.quiet import quiet
from collaborative_gym.sim.cpu import CpuSim

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@pytest.fixture
def env(make_env):
    env = make_env(3)
    env.reset(seed=0)
    return env


def controls(env, steps=10):
    low, high = env.model.actuator_ctrlrange.T
    rng = np.random.default_rng(0)
    bounded = np.where(low < high, rng.uniform(size=(3, steps, env.model.nu)), 0.0)
    return low + (high - low) * bounded


def test_a_place_that_is_not_there_is_told(env):
    with pytest.raises(
        KeyError,
        match=r"no pose 'robot_1/tpc'.*'robot_1/tcp'.*; in build\(\), add_pose",
    ):
        env.sim.pose("robot_1/tpc")
    with pytest.raises(KeyError, match="no velocity 'robot_1/tcp'; velocities:"):
        env.sim.velocity("robot_1/tcp")


def test_it_is_in_lockstep_with_mj_step(env):
    commands = controls(env, 30)
    # Give all worlds contacts, grips and a push besides.
    env.sim.eq_active[1] = 1.0
    env.sim.xfrc_applied[2, -1, 2] = 30.0
    worlds = []
    for i, state in enumerate(env.sim.get_state()):
        data = mujoco.MjData(env.model)
        mujoco.mj_setState(env.model, data, state, STATE)
        for command in commands[i]:
            data.ctrl = command
            mujoco.mj_step(env.model, data)
        worlds.append(data)
    env.sim.step(commands)
    for i, data in enumerate(worlds):
        state = np.zeros(mujoco.mj_stateSize(env.model, STATE))
        mujoco.mj_getState(env.model, data, state, STATE)
        np.testing.assert_array_equal(env.sim.get_state()[i], state)


def test_sensors_describe_the_state_after_a_step(env):
    env.sim.step(controls(env))
    for i in range(3):
        data = env.sim.data(i)
        np.testing.assert_array_equal(env.sim.sensordata[i], data.sensordata)
        np.testing.assert_array_equal(
            env.sim.pose("robot_1/tcp")[0][i], data.site("robot_1/tcp").xpos
        )


def test_a_reset_and_a_forward_change_only_their_worlds(env):
    env.sim.step(controls(env))
    before, sensors = env.sim.get_state(), env.sim.sensordata.copy()
    env.sim.reset([1])
    env.sim.forward([1])
    for i in (0, 2):
        np.testing.assert_array_equal(env.sim.get_state()[i], before[i])
        np.testing.assert_array_equal(env.sim.sensordata[i], sensors[i])
    np.testing.assert_array_equal(env.sim.qpos[1], env.model.qpos0)
    assert (env.sim.sensordata[1] != sensors[1]).any()


def test_a_state_is_put_back_with_its_sensors(env):
    state, sensors = env.sim.get_state([0, 2]), env.sim.sensordata.copy()
    env.sim.step(controls(env))
    env.sim.set_state(state, [0, 2])
    np.testing.assert_array_equal(env.sim.get_state([0, 2]), state)
    np.testing.assert_array_equal(env.sim.sensordata[[0, 2]], sensors[[0, 2]])


def test_jacobians_are_mujocos(env):
    arm = env.scene.arms["robot_2"]
    place = env.sim.pose("robot_2/tcp")[0]
    translation, rotation = env.sim.jacobian(arm.hand, place)
    for i in range(3):
        expected = np.zeros((2, 3, env.model.nv))
        mujoco.mj_jacSite(env.model, env.sim.data(i), *expected, arm.tcp)
        np.testing.assert_allclose(translation[i], expected[0], atol=1e-12)
        np.testing.assert_allclose(rotation[i], expected[1], atol=1e-12)


def test_worlds_that_diverge_are_named(env, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    env.sim.qvel[1, 0] = np.nan
    with pytest.raises(SimulationDiverged) as caught:
        env.sim.step(controls(env))
    assert caught.value.env_ids == (1,)
    assert np.isfinite(env.sim.qpos[[0, 2]]).all()


def test_velocities_are_read_by_name():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="top")
    body.add_freejoint()
    body.add_geom(size=[0.1, 0, 0])
    body.add_site(name="top")
    kinds = mujoco.mjtSensor
    for name, kind in (
        ("linear", kinds.mjSENS_FRAMELINVEL),
        ("angular", kinds.mjSENS_FRAMEANGVEL),
    ):
        spec.add_sensor(
            name=f"top.{name}",
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="top",
        )
    sim = CpuSim(spec.compile(), 2, 1)
    sim.qvel[1] = (1, 2, 3, 4, 5, 6)
    sim.forward()
    linear, angular = sim.velocity("top")
    np.testing.assert_allclose(linear, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_allclose(angular, [[0, 0, 0], [4, 5, 6]])


FORK = """
import os, sys
import mujoco
from collaborative_gym.sim.cpu import CpuSim

sim = CpuSim(mujoco.MjSpec().compile(), 4, num_threads=3)
sim.forward()
child = os.fork()
if child == 0:
    sys.exit(0)
assert os.waitpid(child, 0)[1] == 0
sim.forward()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="it cannot fork")
def test_a_forked_process_ends_though_it_has_none_of_the_threads():
    subprocess.run([sys.executable, "-c", FORK], check=True, timeout=60)


def test_worlds_that_diverge_are_quiet_and_other_simulations_are_not(
    env, capfd, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    env.sim.qvel[1] = 1e12
    with pytest.raises(SimulationDiverged):
        env.sim.step(controls(env))
    assert not capfd.readouterr().err
    assert not list(tmp_path.iterdir())
    data = mujoco.MjData(env.model)
    data.qvel[:] = 1e12
    mujoco.mj_step(env.model, data)
    assert "unstable" in capfd.readouterr().err
    assert (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_what_is_quiet_in_two_threads_warns_again_after_both():
    first, second = quiet(), quiet()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert not mujoco.MjLogConfig.get().logto_console
    second.__exit__(None, None, None)
    assert mujoco.MjLogConfig.get().logto_console
