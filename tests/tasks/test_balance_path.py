"""BalancePath: where the target goes, what following is, that it takes both arms."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies import load_policy

IDS = ("BalancePathSawyers-v0", "BalancePathJacoSawyer-v0")
LAP = 120  # control steps


def make(num_envs, env_id=IDS[1], **options):
    env = cg.make_vec(env_id, num_envs, seed=0, num_threads=1, **options)
    env.reset()
    return env


def play(env, *policies, steps=1):
    """Return the facts of each step that a team plays."""
    team = dict(zip(env.agents, policies, strict=True))
    act, seen = load_policy(team, env), []
    for _ in range(steps):
        env.step(act(None))
        seen.append(env.facts)
    return seen


@pytest.fixture(scope="module")
def lap():
    """Return the facts of a lap in which nobody moves."""
    return play(make(16), "idle", "idle", steps=LAP)


def test_the_target_runs_round_a_figure_of_eight_that_rises_and_sinks(lap):
    places = np.array([facts.target for facts in lap])
    half = np.ptp(places, axis=0) / 2
    assert ((half > 0.895 * np.array([0.1, 0.15, 0.15])) & (half < 0.1501)).all()
    middle = places.mean(axis=0)
    assert np.abs(middle - [0.0, 0.0, 1.01]).max() < 0.0501
    assert np.ptp(middle, axis=0).min() > 0.03
    crossings = (np.diff(np.sign(places - middle), axis=0) != 0).sum(axis=0)
    np.testing.assert_allclose(crossings, [[4, 2, 2]] * 16, atol=1)
    # It closes, starts anywhere, and runs either way.
    step = places[1] - places[0]
    np.testing.assert_allclose(places[0] - places[-1], step, atol=0.01)
    assert len(np.unique(np.sign(places[0] - middle), axis=0)) > 3
    turns = np.cross((places - middle)[:-1], np.diff(places, axis=0))[..., 0]
    assert {*np.sign(turns.sum(axis=0))} == {-1.0, 1.0}


def test_its_velocity_and_what_is_coming_are_true(lap):
    for before, facts, after in zip(lap[:20], lap[1:], lap[2:], strict=False):
        speed = (after.target - before.target) / 0.2
        np.testing.assert_allclose(facts.target_velocity, speed, atol=1e-3)
        place, velocity, acceleration = facts.coming
        np.testing.assert_allclose(place, after.target, atol=1e-9)
        np.testing.assert_allclose(velocity, after.target_velocity, atol=1e-9)
        change = (after.coming[1] - facts.target_velocity) / 0.2
        np.testing.assert_allclose(acceleration, change, atol=1e-3)


def test_the_marker_is_where_the_target_is(lap):
    env = make(3)
    for _ in range(3):
        facts = env.facts
        np.testing.assert_allclose(env.sim.mocap_pos[:, 0], facts.target, atol=1e-9)
        play(env, "expert", "expert")
    others = env.sim.mocap_pos[[0, 2]].copy()
    env.reset(env_ids=[1])
    np.testing.assert_array_equal(env.sim.mocap_pos[[0, 2]], others)
    np.testing.assert_allclose(env.sim.mocap_pos[:, 0], env.facts.target, atol=1e-9)


def test_success_is_a_lap_without_a_break():
    still = dict.fromkeys(("path_x", "path_y", "path_z"), 0.0)
    env = make(2, lap=2.0, randomization="paper", **still)
    ball, sim = int(env.model.joint("ball/free").qposadr[0]), env.sim
    idle, followed, met, performing = env.idle(), [], [], []
    for step in range(30):
        sim.qpos[:, ball : ball + 3] = env.facts.coming[0]
        if step == 4:
            sim.qpos[1, ball] += 0.065
        sim.qvel[:] = 0.0
        infos = env.step(idle)[4]
        followed.append(env.facts.followed)
        met.append(infos["success"])
        performing.append(env.task.performing(env.facts))
    np.testing.assert_allclose(followed[-1], [3.0, 2.5], atol=1e-9)
    assert [int(np.argmax(column)) for column in np.transpose(met)] == [19, 24]
    assert np.transpose(performing).tolist() == [
        [True] * 30,
        [s != 4 for s in range(30)],
    ]


def test_a_ball_that_fell_follows_nothing():
    env = make(1)
    ball = int(env.model.joint("ball/free").qposadr[0])
    env.sim.qpos[0, ball : ball + 3] = [0.0, 3.0, 0.04]
    env.step(env.idle())
    assert env.facts.fell.all() and env.facts.followed.tolist() == [0.0]
    heights = [facts.board[0][0, 2] for facts in play(env, *["expert"] * 2, steps=40)]
    assert np.ptp(heights) < 0.15


def test_a_saved_world_goes_on_along_its_path():
    env, other = make(2), make(2)
    play(env, "expert", "expert", steps=25)
    other.set_state(env.get_state())
    one, two = (play(each, "expert", "expert", steps=5) for each in (env, other))
    for name in ("target", "followed", "distance"):
        np.testing.assert_array_equal(getattr(one[-1], name), getattr(two[-1], name))


def test_bad_paths_are_refused():
    with pytest.raises(ValueError, match="lap must be"):
        cg.make("BalancePath", lap=0.0)


@pytest.mark.parametrize("env_id", IDS)
def test_the_expert_follows_and_one_arm_does_not(env_id):
    env = make(4, env_id)
    assert max(facts.followed.max() for facts in play(env, *["expert"] * 2, steps=160))
    assert (env.facts.followed > 12.0).all() and (env.facts.distance < 0.03).all()
    for team in (("expert", "idle"), ("idle", "expert")):
        env.reset(seed=1)
        seen = play(env, *team, steps=160)
        assert max(facts.followed.max() for facts in seen) < 8.0


@pytest.mark.parametrize("env_id", IDS)
def test_the_expert_follows_even_where_its_actions_come_late(env_id):
    env = make(4, env_id, randomization=cg.Randomization(delay=1))
    for _ in range(160):
        env.step(env.expert())
    assert (env.facts.followed > 12.0).all()


def test_arms_hold_the_board_in_postures_from_which_they_move_every_way():
    """An FR3's nearest one is singular; from Jaco's first, a pose is 2.9 s away."""
    env = make(1, cg.task("BalancePath", robots=("fr3", "jaco")))
    env.sim.forward()
    for agent, arm in env.scene.arms.items():
        env.sim.qpos[:, arm.qpos] = env.task.postures[agent]
        env.sim.forward()
        place = env.sim.pose(f"{agent}/tcp")[0]
        jacobian = np.concatenate(env.sim.jacobian(arm.hand, place), axis=1)[0]
        assert np.linalg.svd(jacobian[:, arm.dof])[1].min() > 0.1
