"""The arms, by name."""

from collaborative_gym.errors import check_kind, look_up_registered
from collaborative_gym.plugins import note_registration
from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.fr3 import FR3
from collaborative_gym.robots.gen3 import GEN3
from collaborative_gym.robots.iiwa14 import IIWA14
from collaborative_gym.robots.jaco import JACO
from collaborative_gym.robots.panda import PANDA
from collaborative_gym.robots.robot import Robot
from collaborative_gym.robots.sawyer import SAWYER
from collaborative_gym.robots.ur5e import UR5E
from collaborative_gym.robots.ur10e import UR10E
from collaborative_gym.robots.xarm7 import XARM7

__all__ = [
    "FR3",
    "GEN3",
    "IIWA14",
    "JACO",
    "PANDA",
    "SAWYER",
    "UR5E",
    "UR10E",
    "XARM7",
    "Gripper",
    "Robot",
    "get_robot",
    "list_robots",
    "register_robot",
]

_ARMS = SAWYER, PANDA, JACO, UR5E, UR10E, XARM7, GEN3, FR3, IIWA14
_ROBOTS = {robot.name: robot for robot in _ARMS}


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
