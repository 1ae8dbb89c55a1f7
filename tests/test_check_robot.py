"""An arm that is played says what will not work, where and why."""

import runpy
from dataclasses import replace
from pathlib import Path

import pytest

from collaborative_gym import robots
from collaborative_gym.testing import check_robot
from collaborative_gym.trying import _hindrances

EXAMPLE = Path(__file__).parents[1] / "examples" / "own_arm.py"


@pytest.fixture
def own(monkeypatch):
    monkeypatch.setattr(robots, "_ROBOTS", dict(robots._ROBOTS))
    return runpy.run_path(str(EXAMPLE))["OWN"]


@pytest.fixture
def faults():
    """Return a function that checks an arm and returns the lines of what is wrong."""

    def faults(robot, *tasks):
        with pytest.raises(AssertionError) as caught:
            check_robot(robot, tasks, episodes=4)
        first, *listed = str(caught.value).splitlines()
        assert first == "own does not do every task:"
        return [line.removeprefix("- ") for line in listed]

    return faults


def test_a_sound_arm_has_no_faults(own):
    assert check_robot(own, ("Poke", "Tug", "Sort"), episodes=4) is None
    with pytest.raises(KeyError, match="did you mean 'panda'"):
        check_robot("pand")
    with pytest.raises(KeyError, match="did you mean 'Poke'"):
        check_robot(own, ("Poek",))


def test_a_task_that_an_arm_is_too_short_for_is_named(own, faults):
    (told,) = faults(own, "Hockey")
    assert told.startswith("Hockey cannot be made: own cannot bring its tcp to ")


@pytest.mark.parametrize("task", ["Pass", "Sort"])
def test_a_tool_centre_inside_the_hand_is_named(own, faults, tmp_path, task):
    file, text = tmp_path / "arm.xml", own.model_file.read_text()
    file.write_text(text.replace('"tcp" pos="0 0 0.115"', '"tcp" pos="0 0 0.03"'))
    told, why = faults(replace(own, model_file=file), task)
    start = f"{task}: the expert completes 0 of 4 episodes; in most of the failures"
    assert told.startswith(start)
    assert "touches" in told
    assert why.startswith("its tcp is 30 mm inside its hand, which may")


def test_a_home_that_looks_away_or_up_is_named(own, faults):
    blank = {"armature": (), "damping": (), "stiffness": ()}
    away = replace(own, home=(3.0, -0.3, 1.9, 0.0, -1.57, 0.0), **blank)
    told, why = faults(away, "Poke")
    assert "cannot bring its tcp to" in told and "choose a home" in told
    assert why == "at home its hand is 0.36 m behind its base"
    up = replace(own, home=(0.0, -0.1, 1.87, -3.34, -1.57, 0.0), **blank)
    assert faults(up, "Hockey")[1:] == [
        "at home its hand points up",
        "at home joint_4 is 0.06 rad from the end of its range",
    ]


def test_joints_at_their_ends_are_named(own, faults, tmp_path):
    """The elbow of this arm does not bend as far as the usual way of the cube needs."""
    file, text = tmp_path / "arm.xml", own.model_file.read_text()
    file.write_text(text.replace('range="-2.7 2.7"', 'range="-1.95 1.95"'))
    told = faults(replace(own, model_file=file), "Pass")
    assert "robot_1's joint_3 is at the end of its range" in told[0]


def test_a_singular_posture_is_named(make_env):
    env = make_env(robots=("sawyer", "panda"))
    env.reset(seed=0)
    told = "robot_1 is in a singular posture, as an outstretched arm is"
    assert told not in _hindrances(env, 0)
    env.sim.qpos[:, env.scene.arms["robot_1"].qpos] = 0.0
    assert told in _hindrances(env, 0)
