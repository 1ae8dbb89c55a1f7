"""Indices of things in the arrays of a compiled world."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from collaborative_gym.errors import check_number, check_numbers
from collaborative_gym.robots.robot import Robot
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE

_ACTUATOR = mujoco.mjtObj.mjOBJ_ACTUATOR
_TURN = 4 * np.pi  # bound of a yaw; most turns in degrees are beyond it

SHOULDER = np.array([0.0, 0.0, 0.3])
"""Height of an arm's shoulder above its base in m, about right for all arms."""


@dataclass(frozen=True)
class Placement:
    """Where the base of an arm is mounted.

    Attributes:
      position: of the base in the world frame, in m.
      yaw: turn of the base about the vertical, in rad.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0

    def __post_init__(self) -> None:
        position = check_numbers("position", self.position, 3)
        for i, value in enumerate(position):
            check_number(f"position[{i}]", value, at_least=-1000.0, at_most=1000.0)
        object.__setattr__(self, "position", position)
        turn = check_number("yaw in rad", self.yaw, at_least=-_TURN, at_most=_TURN)
        object.__setattr__(self, "yaw", turn)

    @property
    def quat(self) -> list[float]:
        """Its orientation, w x y z."""
        return [float(np.cos(self.yaw / 2)), 0.0, 0.0, float(np.sin(self.yaw / 2))]


@dataclass(frozen=True)
class Arm:
    """Indices of one agent's arm in the arrays of the compiled world."""

    robot: Robot
    qpos: slice  # its joint angles in `qpos`
    dof: slice  # its joint speeds in `qvel`, and its columns in Jacobians
    servos: slice  # what turns its joints, in `ctrl`; empty without drives
    fingers: slice  # its finger actuators in `ctrl`; empty where fingers are fixed
    joint_range: np.ndarray  # lower and upper joint angles, (2, joints), in rad
    stride: np.ndarray  # (joints,) greatest turn in a control step, in rad
    tcp: int  # site id of its tool centre point
    hand: int  # id of the body that carries the tcp
    num_joints: int


@dataclass(frozen=True)
class Grip:
    """A grip that an agent can take: a site held in its hand, as `grasps` describes."""

    agent: str
    site: str  # full name of what can be gripped
    threshold: float  # m between tcp and site, up to which a grip can start
    width: float  # m between the fingers while gripping
    lever: float | None = None  # m, with which pads and cups bear torques; None: theirs

    @property
    def name(self) -> str:
        """The name of the equality constraint in the compiled model."""
        return f"{self.agent} grips {self.site}"

    @property
    def palm(self) -> str:
        """The name of the body and site that bear the hand's grips, and its sensor."""
        # A model file is unlikely to give this name to a body of its own.
        return f"{self.agent}/palm of grips"

    @property
    def held(self) -> str:
        """The name of the palm's site where a grasp remembers what it took."""
        return f"{self.agent}/hold of {self.site}"


def find_arm(model: mujoco.MjModel, agent: str, robot: Robot) -> Arm:
    """Return where the arm of an agent is found.

    Raises:
      ValueError: if its joints are not one after the other in the model.
    """
    joints = [model.joint(f"{agent}/{name}") for name in robot.joints]
    servos, fingers = (
        [mujoco.mj_name2id(model, _ACTUATOR, f"{agent}/{name}") for name in names]
        for names in (robot.joints, robot.gripper.joints)
    )
    tcp = model.site(f"{agent}/{robot.tcp}")
    limits = np.array(robot.velocity_limits)
    return Arm(
        robot=robot,
        qpos=_as_slice([int(joint.qposadr[0]) for joint in joints]),
        dof=_as_slice([int(joint.dofadr[0]) for joint in joints]),
        servos=_as_slice([i for i in servos if i >= 0]),
        fingers=_as_slice([i for i in fingers if i >= 0]),
        joint_range=np.array([joint.range for joint in joints]).T,
        stride=np.minimum(MAX_CHANGE, limits * CONTROL_DT),
        tcp=tcp.id,
        hand=int(tcp.bodyid[0]),
        num_joints=len(joints),
    )


def _as_slice(ids: list[int]) -> slice:
    """Return consecutive ids as a slice, which reads arrays without a copy."""
    if not ids:
        return slice(0, 0)
    if ids != list(range(ids[0], ids[0] + len(ids))):
        raise ValueError(
            f"the arm's joints are not one after the other in its model file: {ids};"
            " list them from the base to the tool"
        )
    return slice(ids[0], ids[0] + len(ids))


def find_free(model: mujoco.MjModel, names: Sequence[str]) -> dict[str, int]:
    """Return where in `qpos` the pose of each object with one free joint begins."""
    found: dict[str, int] = {}
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    for joint in np.flatnonzero(free):
        name = model.body(int(model.jnt_bodyid[joint])).name.split("/")[0]
        if name in names:
            if name in found:
                raise ValueError(
                    f"{name} has more than one free joint; add each of its parts by"
                    " itself"
                )
            found[name] = int(model.jnt_qposadr[joint])
    return found
