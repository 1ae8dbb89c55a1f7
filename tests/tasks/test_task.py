"""Settings that no world could be made of are refused when they are made."""

from dataclasses import dataclass

import pytest

from collaborative_gym import Randomization, Task, TaskConfig
from collaborative_gym.tasks.registry import make_task, register_task


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_episode_steps": 0}, "max_episode_steps must be at least 1, got 0"),
        ({"max_episode_steps": 1.5}, "got 1.5"),
        ({"max_episode_steps": "long"}, "got 'long'"),
        ({"success_radius": float("nan")}, "success_radius must be finite, got nan"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make_task("Lift", **settings)


@pytest.mark.parametrize("noise", [-0.1, -1, 4])
def test_randomization_out_of_range_is_refused(noise):
    with pytest.raises(ValueError, match=r"joint_noise must be 0 to 3\.14159"):
        Randomization(joint_noise=noise)


def test_the_default_settings_are_in_range():
    assert TaskConfig().max_episode_steps == 200


class Undecorated(TaskConfig):
    """Its field would be the class's, and no setting."""

    tolerance: float = 0.05


class Alone:
    """It lacks the fields that all tasks have."""


@dataclass(frozen=True)
class Untyped(TaskConfig):
    """Its attribute is no field."""

    tolerance = 0.05


@dataclass(frozen=True)
class Quoted(TaskConfig):
    """Its default is of another type than its field."""

    tolerance: float = "0.05"


def test_a_setting_without_a_type_is_refused():
    task = type("Mine", (Task,), {"config_class": Untyped})
    with pytest.raises(
        TypeError, match=r"Untyped\.tolerance is no .* tolerance: float"
    ):
        register_task("Mine", task)


def test_a_default_of_another_type_is_refused():
    with pytest.raises(TypeError, match=r"tolerance must be a number, got '0\.05'"):
        Quoted()


@pytest.mark.parametrize("config_class", [Undecorated, Alone, None])
def test_settings_that_are_no_task_config_are_refused(config_class):
    task = type("Mine", (Task,), {"config_class": config_class})
    with pytest.raises(
        TypeError, match=r"Mine\.config_class must be a dataclass derived"
    ):
        register_task("Mine", task)
