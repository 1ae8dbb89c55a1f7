"""Tug: seats that are alike, who wins and when, lines, forces that arms can bear."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.objects.bar import KNOBS, LENGTH
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.tug import strength

IDS = [f"Tug{arms}-v0" for arms in ("Pandas", "Sawyers", "PandaSawyer")]


def make(num_envs=1, env_id="TugPandas-v0", **options):
    env = cg.VectorEnv(
        make_task(env_id), num_envs, num_threads=1, auto_reset=False, **options
    )
    env.reset(seed=0)
    return env


def play(env, act, steps=200):
    """Play on to the end of all episodes, and return the last infos."""
    for _ in range(steps):
        *_, infos = env.step(act(env))
        if infos["ended"].all():
            break
    return infos


def full_commands(rng):
    def act(env):
        shapes = {a: space.shape for a, space in env.single_action_spaces.items()}
        drawn = {a: rng.uniform(-1, 1, (env.num_envs, *n)) for a, n in shapes.items()}
        return {agent: np.sign(rows) for agent, rows in drawn.items()}

    return act


def turned(env, other):
    """Put what the worlds of `env` are, turned by half a turn, into `other`."""
    half = np.array([0.0, 0.0, 0.0, 1.0])
    place, quat = env.sim.pose("bar")
    place = place * (-1.0, -1.0, 1.0)
    # Its ends change hands, so it is turned about its own middle as well.
    quat = math.multiply(math.multiply(half, quat), half)
    other.scene.place(other.sim, slice(None), name="bar", position=place, quat=quat)
    for one, two in zip(env.agents, env.agents[::-1], strict=True):
        arm, seat = env.scene.arms[one], other.scene.arms[two]
        other.sim.qpos[:, seat.qpos] = env.sim.qpos[:, arm.qpos]
        there, here = (env.model.actuator_actadr[own.servos] for own in (seat, arm))
        other.sim.act[:, there] = env.sim.act[:, here]
    other.sim.forward()


def test_swapped_seats_mirror_the_episode():
    env, other = make(4), make(4)
    turned(env, other)
    one, two = env.step(env.idle()), other.step(other.idle())
    for step in range(25):
        for agent, seat in zip(env.agents, env.agents[::-1], strict=True):
            mine, yours = one[0][agent], two[0][seat]
            np.testing.assert_allclose(mine, yours, atol=1e-4, err_msg=f"{step}")
            np.testing.assert_allclose(one[1][agent], two[1][seat], atol=1e-3)
        mine, yours = env.expert(), other.expert()
        for agent, seat in zip(env.agents, env.agents[::-1], strict=True):
            np.testing.assert_allclose(mine[agent], yours[seat], atol=1e-4)
        one, two = env.step(mine), other.step(yours)
        if one[-1]["ended"].any():
            break
    ended = one[-1]["success"], two[-1]["success"]
    assert ended[0]["side_1"].tolist() == ended[1]["side_2"].tolist()
    assert ended[0]["side_2"].tolist() == ended[1]["side_1"].tolist()


def test_hands_hold_the_knobs_at_the_start():
    env = make(6, "TugPandaSawyer-v0")
    for agent, knob in zip(env.agents, KNOBS, strict=True):
        for i in range(6):
            data = env.sim.data(i)
            gap = data.site(f"{agent}/tcp").xpos - data.site(f"bar/{knob}").xpos
            assert np.abs(gap).max() < 1e-3
    assert np.abs(env.facts.bar - (0.0, 0.0, 1.0)).max() < 0.0501


def test_who_pulls_the_bar_over_the_own_line_wins_and_ends_the_episode():
    env = make(8)
    infos = play(env, lambda env: {**env.idle(), "robot_1": env.expert()["robot_1"]})
    assert infos["success"]["side_1"].all() and not infos["success"]["side_2"].any()
    assert (env.facts.bar[:, 1] < -env.task.lines["robot_1"]).all()
    metrics = infos["metrics"]
    assert metrics["score"]["side_1"].tolist() == [1.0] * 8
    assert metrics["score"]["side_2"].tolist() == [0.0] * 8
    terms = metrics["reward_terms"]
    assert terms["robot_1"]["win"].tolist() == [10.0] * 8
    assert terms["robot_2"]["win"].tolist() == [-10.0] * 8
    # No arm is over the line at one stroke.
    assert metrics["time_to_success"]["side_1"].min() > 0.2
    assert metrics["length"].max() < 200


def test_time_up_is_a_draw():
    env = make(3)
    for _ in range(200):
        *_, terminated, truncated, infos = env.step(env.idle())
    assert truncated["robot_1"].all() and not terminated["robot_1"].any()
    assert not any(score.any() for score in infos["metrics"]["score"].values())


def test_weaker_arms_have_a_handicap():
    envs = make(1, "TugPandas-v0"), make(1, "TugPandaSawyer-v0")
    equal, unequal = (env.task.lines for env in envs)
    assert equal["robot_1"] == equal["robot_2"] == pytest.approx(0.14 * 0.855)
    panda, sawyer = (strength(cg.get_robot(name)) for name in ("panda", "sawyer"))
    assert panda > 1.2 * sawyer
    # For the Sawyer, at positive y.
    assert envs[1].task.help == pytest.approx(2.057 * (panda - sawyer))
    assert envs[0].task.help == 0.0
    ratio = unequal["robot_1"] / unequal["robot_2"]
    assert ratio == pytest.approx(panda / sawyer)
    assert np.mean(list(unequal.values())) == pytest.approx(0.14 * (0.855 + 1.26) / 2)


def test_arms_must_stand_on_their_own_halves():
    spots = (cg.Placement((0, 0.7, 0.7), -1.57), cg.Placement((0, -0.7, 0.7), 1.57))
    with pytest.raises(ValueError, match="robot_1 at negative y and robot_2 at posi"):
        cg.make("TugPandas-v0", placements=spots)


@pytest.mark.parametrize("env_id", IDS[:2])
def test_full_commands_neither_tear_the_bar_nor_break_the_world(env_id):
    env, act = make(6, env_id, strain=True), full_commands(np.random.default_rng(0))
    for _ in range(40):
        *_, infos = env.step(act(env))
        tcps = list(env.facts.tcps.values())
        assert np.abs(math.distance(*tcps) - LENGTH).max() < 0.03
        assert np.abs(sum(tcps) / 2 - env.facts.bar).max() < 0.02
        if infos["ended"].all():
            break
    strain = infos["metrics"]["strain"]
    assert not infos["diverged"].any()
    assert strain["internal_force"].max() < 2000.0
    assert strain["contact_depth_objects"].max() < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS[:2])
def test_seats_are_fair(env_id):
    env = make(300, env_id)
    infos = play(env, lambda env: env.expert())
    won = [won.sum() for won in infos["metrics"]["completion"].values()]
    assert sum(won) > 270
    # Three standard deviations of a fair coin.
    assert abs(won[0] / sum(won) - 0.5) < 0.09
