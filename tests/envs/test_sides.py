"""Sides that each have their own goal, and episodes that end before their time."""

import gymnasium
import numpy as np
import pytest

import collaborative_gym as cg

LENGTH = 12


@pytest.fixture
def make(carry):
    """Return a function that makes worlds of the small task with parts replaced."""

    def make(num_envs=2, auto_reset=True, config=None, **parts):
        base = type(carry())
        task = type("Changed", (base,), parts)
        arms = [cg.get_robot("panda")] * 2
        return cg.VectorEnv(
            task(arms, base.config_class(**(config or {}))),
            num_envs,
            num_threads=1,
            auto_reset=auto_reset,
        )

    return make


def high(self, facts):
    return facts.height > 0.6


def lower(self, facts, actions):
    return {
        "robot_1": {"height": -facts.height},
        "robot_2": {"height": facts.height},
    }


DUEL = {
    "reward": lower,
    "sides": (("robot_2",), ("robot_1",)),
    "success": lambda self, facts: (facts.height > 0.6, facts.height < 0.6),
    "performing": lambda self, facts: (facts.height > 0.6, facts.height > -1.0),
}
"""One arm wants the cube high and the other wants it low."""


def test_an_episode_that_is_over_is_terminated(make):
    env, plain = make(over=high), make()
    for each in (env, plain):
        each.reset(seed=0)
    for step in range(LENGTH):  # noqa: B007
        _, _, terminated, truncated, infos = env.step(env.expert())
        metrics = plain.step(plain.expert())[-1]
        for agent in env.agents:
            np.testing.assert_array_equal(terminated[agent], infos["ended"])
            assert not truncated[agent].any()
        if infos["ended"].any():
            break
        np.testing.assert_array_equal(infos["success"], metrics["success"])
    ended = infos["ended"]
    assert 0 < step < LENGTH - 1
    assert infos["success"][ended].all()
    assert (infos["metrics"]["length"][ended] == step + 1).all()
    assert (infos["metrics"]["performance"][ended] == 1.0).all()
    assert (infos["final_observation"]["robot_1"][ended, 16] > 0.6).all()
    assert (env.progress["episode"][ended] >= 2).all()
    assert (env.progress["step"][ended] == 0).all()


def test_time_truncates_and_nothing_terminates_what_diverged(
    make, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings where it runs.
    env = make(2, over=lambda self, facts: facts.height > 10.0)
    env.reset(seed=0)
    for _ in range(LENGTH):
        _, _, terminated, truncated, _ = env.step(env.expert())
    assert truncated["robot_1"].all()
    assert not terminated["robot_1"].any()
    env = make(2, over=lambda self, facts: facts.highest < facts.height - 1.0)
    env.reset(seed=0)
    env.task.over = lambda facts: facts.height > -10.0
    actions = env.expert()
    env.sim.qpos[1, 0] = np.nan
    _, _, terminated, truncated, infos = env.step(actions)
    assert infos["diverged"].tolist() == [False, True]
    assert terminated["robot_2"].tolist() == [True, False]
    assert truncated["robot_2"].tolist() == [False, True]


def test_sides_have_their_own_goal_and_return(make):
    env = make(**DUEL)
    assert env.sides == {"side_1": ("robot_2",), "side_2": ("robot_1",)}
    _, infos = env.reset(seed=0)
    assert infos["success"]["side_2"].all()
    returns = {agent: np.zeros(2) for agent in env.agents}
    seen = []
    for _ in range(LENGTH):
        _, rewards, _, _, infos = env.step(env.expert())
        seen.append(infos["success"])
        for agent in env.agents:
            returns[agent] += rewards[agent]
    metrics = infos["metrics"]
    first = np.argmax([each["side_1"] for each in seen], axis=0)
    assert first.min() > 0
    np.testing.assert_allclose(
        metrics["time_to_success"]["side_1"], (first + 1) * env.control_dt
    )
    assert metrics["time_to_success"]["side_2"].tolist() == [0.1, 0.1]
    assert metrics["performance"]["side_2"].tolist() == [1.0, 1.0]
    for side, (agent,) in env.sides.items():
        np.testing.assert_allclose(metrics["return"][side], returns[agent], rtol=1e-6)
        assert metrics["completion"][side].tolist() == [1.0, 1.0]
        assert metrics["score"][side].tolist() == [1.0, 1.0]


def rising(self, facts):
    return 1 * (facts.height > 0.6), 0.5 * (facts.height > -1.0)


def test_points_are_summed_up_until_the_episode_is_over(make):
    env = make(**DUEL, score=rising, over=high, auto_reset=False)
    _, infos = env.reset(seed=0)
    assert infos["metrics"]["score"]["side_2"].tolist() == [0.0, 0.0]
    env.step(env.expert())
    env.reset(env_ids=[1])  # So that the first world rests while it goes on.
    while not infos["ended"].all():
        *_, infos = env.step(env.expert())
    score = infos["metrics"]["score"]
    assert score["side_1"].tolist() == [1.0, 1.0]
    assert score["side_2"].tolist() == (infos["metrics"]["length"] / 2).tolist()
    assert infos["resting"].tolist() == [True, False]


def test_nobody_wins_an_episode_that_diverged(make, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings where it runs.
    env = make(**DUEL, score=rising)
    env.reset(seed=0)
    *_, infos = env.step(env.expert())
    assert infos["metrics"]["score"]["side_2"].tolist() == [0.5, 0.5]
    actions = env.expert()
    env.sim.qpos[1, 0] = np.nan
    *_, infos = env.step(actions)
    assert infos["metrics"]["score"]["side_2"].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"sides": (("robot_1",),)}, "each of robot_1, robot_2 must be on exactly one"),
        ({"sides": (("robot_1",), ("robot_1", "robot_2"))}, "on exactly one side"),
        ({"sides": (("robot_1", "robot_2"), ())}, "no side empty"),
        ({"sides": None}, "Changed.sides is None; each of"),
        ({"sides": (("robot_1",), ("robot_2",))}, "returns a tuple with an array"),
        ({**DUEL, "performing": lambda *_: (1, 2)}, r"performing\(\) of side_1 is int"),
        ({"score": lambda self, facts: (facts.height,)}, "for tasks of several sides"),
        ({**DUEL, "score": lambda *_: 1}, r"score\(\) is of type int; a task of 2"),
        ({**DUEL, "score": lambda *_: (1, 2)}, r"score\(\) of side_1 has shape \(\)"),
        ({"over": lambda self, facts: facts.height}, r"over\(\) is float64"),
        ({"over": lambda self, facts: facts.height < 9}, "ends an episode at its"),
    ],
)
def test_wrong_sides_and_endings_are_refused(make, parts, message):
    with pytest.raises(ValueError, match=message):
        make(**parts)


def test_one_agent_does_not_command_opponents(carry_id, monkeypatch):
    base = type(cg.make(carry_id).vector_env.task)
    for name, part in DUEL.items():
        monkeypatch.setattr(base, name, part)
    with pytest.raises(ValueError, match="one agent cannot command the 2 sides of Car"):
        gymnasium.make(carry_id)
    with pytest.raises(ValueError, match="one agent cannot command"):
        gymnasium.make_vec(carry_id, num_envs=2)
