"""Physics steps in which arms crash are taken again as short ones."""

from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.scene.refinement import refinement

MOST_SPEED, MOST_DEPTH, MOST_BEYOND = 4.0, 0.01, 0.02
"""What no action brings about: speed over limit, and m and rad."""


def held_commands(env, steps):
    """Yield full commands at random that are mostly kept: they crash the arms."""
    rng = np.random.default_rng(0)
    spaces = env.single_action_spaces.items()
    signs = {agent: np.ones((env.num_envs, *space.shape)) for agent, space in spaces}
    for _ in range(steps):
        for own in signs.values():
            own *= np.where(rng.random(own.shape) < 0.9, 1.0, -1.0)
        yield signs


def crashed(env_id, worlds=8, steps=60, *, refines=True, watched=False):
    """Play full commands; return the environment and the greatest of each limit."""
    env = cg.make_vec(env_id, worlds, seed=0, strain=True, num_threads=2)
    if not refines:
        env.sim.refinement = None
    most = dict.fromkeys(["speed", "beyond", "refined"], 0.0)

    def look():
        for arm in env.scene.arms.values():
            speed = np.abs(env.sim.qvel[:, arm.dof]) / arm.robot.velocity_limits
            low, high = arm.joint_range
            angle = env.sim.qpos[:, arm.qpos]
            most["speed"] = max(most["speed"], speed.max())
            most["beyond"] = max(most["beyond"], (low - angle).max())
            most["beyond"] = max(most["beyond"], (angle - high).max())
        most["refined"] += sum(len(part.env_ids) for part in env.sim.refined)

    env.watch(look, env.substeps if watched else 1)
    env.reset()
    for actions in held_commands(env, steps):
        *_, infos = env.step(actions)
    strain = infos["metrics"]["strain"]
    most["depth"] = max(strain[name].max() for name in strain if "depth" in name)
    most["told speed"] = strain["speed_over_limit"].max()
    return env, most


@pytest.mark.parametrize(
    ("env_id", "broken"),
    [
        ("PokeTaskSawyers-v0", "depth"),
        ("LiftTaskJacos-v0", "depth"),
        ("BalanceTaskJacoSawyer-v0", "told speed"),
        ("PassTaskSawyers-v0", "depth"),
    ],
)
def test_no_action_brings_an_arm_beyond_its_limits(env_id, broken):
    _, most = crashed(env_id, watched=True)
    assert most["refined"] > 0
    assert max(most["speed"], most["told speed"]) <= MOST_SPEED + 1e-9
    assert most["depth"] < MOST_DEPTH
    assert most["beyond"] < MOST_BEYOND
    _, most = crashed(env_id, refines=False, watched=True)
    assert most["refined"] == 0
    assert most[broken] > {"depth": 0.005, "told speed": MOST_SPEED}[broken]


def test_bits_depend_on_no_other_world_no_watcher_and_no_pause():
    env, most = crashed("PassTaskSawyers-v0", steps=40)
    assert most["refined"] > 5
    watched, _ = crashed("PassTaskSawyers-v0", steps=40, watched=True)
    expected = env.get_state()
    np.testing.assert_array_equal(watched.get_state().physics, expected.physics)
    alone = cg.make_vec("PassTaskSawyers-v0", 1, strain=True, num_threads=1)
    for world in range(0, env.num_envs, 3):
        alone.reset(seed=0, episodes=[world])
        for step, actions in enumerate(held_commands(env, 40)):
            alone.step(
                {agent: own[world : world + 1] for agent, own in actions.items()}
            )
            if step == 20:
                alone.set_state(alone.get_state())
        own = alone.get_state()
        np.testing.assert_array_equal(own.physics[0], expected.physics[world])
        for name, rows in own.progress.items():
            if name.startswith("strain"):
                np.testing.assert_array_equal(rows[0], expected.progress[name][world])


@pytest.mark.parametrize(
    "env_id", ["LiftTaskSawyers-v0", "BalanceTaskSawyers-v0", "PassTaskJacoSawyer-v0"]
)
def test_where_nothing_crashes_no_bit_changes(env_id):
    seen = []
    for refines in (True, False):
        env = cg.make_vec(env_id, 4, seed=0, num_threads=1)
        if not refines:
            env.sim.refinement = None
        env.reset()
        for _ in range(40):
            env.step(env.expert())
        seen.append(env.sim.get_state())
    np.testing.assert_array_equal(*seen)


def test_the_strain_of_short_steps_is_that_of_the_whole_ones():
    told = []
    for refines in (True, False):
        env = cg.make_vec("LiftTaskSawyers-v0", 2, seed=0, strain=True, num_threads=1)
        if refines:
            every = replace(env.sim.refinement, strays=lambda qpos, _: qpos[..., 0] < 9)
            env.sim.refinement = every
        env.reset()
        for _ in range(45):
            *_, infos = env.step(env.expert())
            parts = [part.env_ids.tolist() for part in env.sim.refined]
            assert parts == ([[0, 1]] * 10 if refines else [])
        assert infos["success"].all()
        told.append(infos["metrics"]["strain"])
    for name in ("energy", "internal_force_mean", "clearance"):
        np.testing.assert_allclose(told[0][name], told[1][name], rtol=0.1)


def test_a_protective_stop_slows_one_arm_down_and_keeps_its_path():
    env = cg.make_vec("BalanceTaskJacoSawyer-v0", 2, seed=0, num_threads=1)
    env.reset()
    one, other = env.scene.arms.values()
    start = env.sim.qpos.copy()
    speeds = np.zeros_like(env.sim.qvel)
    speeds[0, one.dof] = (
        np.array(one.robot.velocity_limits) * [6, 1, 1, 1, 1, 1, -5][: one.num_joints]
    )
    speeds[:, other.dof] = 3.8 * np.array(other.robot.velocity_limits)
    after = start.copy()
    after[:, one.qpos] += 0.001 * speeds[:, one.dof]
    qpos, qvel = after.copy(), speeds.copy()
    refinement(env.model, env.scene.arms.values()).stop(start, qpos, qvel)
    np.testing.assert_allclose(qvel[0, one.dof], speeds[0, one.dof] * 3.9 / 6)
    turned = (after - start)[0, one.qpos] * 3.9 / 6
    np.testing.assert_allclose((qpos - start)[0, one.qpos], turned, atol=1e-12)
    np.testing.assert_array_equal(qvel[:, other.dof], speeds[:, other.dof])
    np.testing.assert_array_equal(qpos[1], after[1])
