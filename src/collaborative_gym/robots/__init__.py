"""The arms, by name."""

from collaborative_gym.errors import check_kind, look_up_registered
from collaborative_gym.plugins import note_registration
from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.jaco import JACO
from collaborative_gym.robots.panda import PANDA
from collaborative_gym.robots.robot import Robot
from collaborative_gym.robots.sawyer import SAWYER

__all__ = [
    "JACO",
    "PANDA",
    "SAWYER",
    "Gripper",
    "Robot",
    "get_robot",
    "list_robots",
    "register_robot",
]

_ROBOTS = {robot.name: robot for robot in (SAWYER, PANDA, JACO)}


def register_robot(robot: Robot) -> None:
    """Let tasks and the command line ask for an arm by its name.

    Raises:
      ValueError: if the name is taken.
    """
    check_kind("robot", robot, Robot, "a Robot")
    if robot.name in _ROBOTS:
        raise ValueError(
            f"robot {robot.name!r} is registered already; give yours another name"
        )
    _ROBOTS[robot.name] = robot
    note_registration()


def list_robots() -> tuple[str, ...]:
    """Return the names of the arms: the package's, and those registered since."""
    return tuple(_ROBOTS)


def get_robot(robot: "str | Robot") -> Robot:
    """Return the arm of that name; a `Robot` is returned as it is.

    Raises:
      KeyError: if no arm has the name.
    """
    if isinstance(robot, Robot):
        return robot
    return look_up_registered("robot", robot, _ROBOTS)
