"""Physics steps that break a grip or need refinement, in many worlds and in one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.sim.cpu import CpuSim

WORLDS, STEPS = 24, 10


def lot(values, salt):
    """Return numbers from 0 to 1 that look drawn, but follow from the last axis."""
    return np.abs(np.sin(1e7 * np.sum(values, axis=-1) + salt)) % 1.0


def current(model):
    """Return which sensor values are current after steps; those of forces are not."""
    is_current = model.sensor_needstage < mujoco.mjtStage.mjSTAGE_ACC.value
    return np.repeat(is_current, model.sensor_dim)


def chances(sim, broken, rough, fast):
    """Let steps of a simulation be wrong with these chances, by their state alone."""
    own, seen = sim.refinement, current(sim.model)
    sim.refinement = replace(
        own,
        strays=lambda qpos, qvel: lot(qpos, 1) < rough / 2,
        too_deep=lambda sensordata: lot(sensordata[..., seen], 2) < rough / 2,
        too_fast=lambda qvel: lot(qvel, 3) < fast,
        stop=lambda start, qpos, qvel: np.multiply(
            qvel, np.where(lot(qvel, 3) < fast, 0.5, 1.0)[:, None], out=qvel
        ),
    )

    def breaks(sensordata, active):
        return active & (lot(sensordata, 4) < broken)[..., None]

    return breaks


@pytest.fixture(scope="module")
def grown():
    """Return an environment in the middle of episodes, and controls to go on with."""
    env = cg.make_vec("LiftTaskSawyers-v0", WORLDS, seed=0, num_threads=2)
    env.reset(stagger=True)
    for _ in range(12):
        env.step(env.expert())
    assert env.sim.eq_active.any()
    controls = env.action_mode.prepare(env.action_mode.commands(env.expert()))
    return env, controls


@pytest.mark.parametrize(
    ("broken", "rough", "fast"),
    [(0.05, 0.0, 0.0), (0.0, 0.1, 0.0), (0.05, 0.1, 0.2), (0.3, 0.6, 0.5)],
)
def test_all_worlds_together_are_as_one_at_a_time(grown, broken, rough, fast):
    env, controls = grown
    start = env.sim.get_state()
    ends, counts = [], [0, 0]
    kept = current(env.model)
    for size in (WORLDS, 1):
        sim = CpuSim(env.model, size, 2, env.sim.refinement)
        breaks, done = chances(sim, broken, rough, fast), []
        for first in range(0, WORLDS, size):
            sim.set_state(start[first : first + size])
            records = {"qvel": np.zeros((size, STEPS, env.model.nv))}
            end = sim.time + STEPS * env.model.opt.timestep
            sim.step(controls[first : first + size], records, breaks)
            # No step is taken twice, and none left out.
            np.testing.assert_allclose(sim.time, end)
            done += [
                np.r_[row, seen.ravel(), now[kept]]
                for row, seen, now in zip(
                    sim.get_state(), records["qvel"], sim.sensordata, strict=True
                )
            ]
            counts[size == 1] += sum(len(part.env_ids) for part in sim.refined)
        ends.append(np.array(done))
    np.testing.assert_array_equal(*ends)
    assert counts[0] == counts[1] and (counts[0] > 0) == (rough > 0)
    moved = CpuSim(env.model, WORLDS, 2)
    moved.set_state(start)
    moved.step(controls)
    assert (moved.get_state() != ends[0][:, : start.shape[1]]).any()


def test_worlds_that_are_not_named_stay(grown):
    env, controls = grown
    sim = CpuSim(env.model, WORLDS, 2, env.sim.refinement)
    breaks = chances(sim, 0.05, 0.1, 0.2)
    sim.set_state(env.sim.get_state())
    sim.step(controls, None, breaks)
    all_moved, other = sim.get_state(), CpuSim(env.model, WORLDS, 2, sim.refinement)
    other.set_state(env.sim.get_state())
    some = np.array([1, 5, 20])
    records = {"qvel": np.full((WORLDS, STEPS, env.model.nv), np.nan)}
    other.step(controls, records, breaks, some)
    expected = env.sim.get_state()
    expected[some] = all_moved[some]
    np.testing.assert_array_equal(other.get_state(), expected)
    written = np.isfinite(records["qvel"]).all(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(written), some)
