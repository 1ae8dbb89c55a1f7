"""A user's data of an arm and its gripper, before the model file is read."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from collaborative_gym import errors

_STANDS = ("pedestal", "table", "none")  # what an arm can stand on
_FASTEST = 30.0  # rad/s; joint speeds above this, five turns a second, are degrees
_WIDEST = 1.0  # gaps of a gripper above this, in m, are millimetres
_PER_JOINT = {
    "home": (-np.inf, np.inf, ""),
    "velocity_limits": (1e-9, _FASTEST, " rad/s"),
    "torque_limits": (1e-9, 1e5, " N m"),
    "armature": (0.0, 1e3, " kg m2"),
    "damping": (1e-9, 1e5, " N m s/rad"),
    "stiffness": (1e-9, 1e6, " N m/rad"),
}
"""Least and greatest values of a joint, and their unit. Those that no law of physics
gives are our choice: a hundred times what the heaviest industrial arms have."""

SLACK = 1e-6  # rad or m by which a home and fingers may be beyond their range
GRAVITY = 9.81
"""m/s2, MuJoCo's default."""


@dataclass(frozen=True)
class Gripper:
    """Fingers that move together, each on its own joint; without joints, no fingers.

    Joints that mimic one of these in URDF, or by an equality in MJCF, move with it.

    Attributes:
      joints: finger joint names in the model file. One whose range has the other sign
        is turned around, so that all have the same position.
      open_position: joint position of an open gripper, in m or rad.
      closed_position: joint position of a closed gripper, in m or rad.
      open_gap: clear width between the fingers when open, in m.
      closed_gap: clear width between the fingers when closed, in m.
      force: limit of one finger's actuator, in N or N m.
      holding_force: pull at which a grip tears, in N; 0 for the pull of the arm's
        strongest joint at an eighth of the reach.

    Raises:
      ValueError: if no gripper can have these numbers; says which to change.
    """

    joints: tuple[str, ...] = ()
    open_position: float = 0.0
    closed_position: float = 0.0
    open_gap: float = 0.0
    closed_gap: float = 0.0
    force: float = 0.0
    holding_force: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, joints=_names(self.joints))
        for each in fields(self)[1:]:
            given = getattr(self, each.name)
            value = errors.check_number(each.name, given, at_least=-1e6, at_most=1e6)
            freeze(self, **{each.name: value})
        _check_gripper(self)

    @property
    def pad_force(self) -> float:
        """The force of each finger on an object, in N; 0 without fingers.

        Where fingers turn, it follows from what their turn takes off the gap.
        """
        if not self.joints:
            return 0.0
        travel = abs(self.open_position - self.closed_position)
        return 2.0 * self.force * travel / (self.open_gap - self.closed_gap)

    def position(self, gap: float) -> float:
        """Return the joint position at which the fingers are `gap` metres apart."""
        gap = errors.check_number("gap", gap)
        if not self.joints:
            return self.open_position
        gap = min(max(gap, self.closed_gap), self.open_gap)
        fraction = (gap - self.closed_gap) / (self.open_gap - self.closed_gap)
        travel = self.open_position - self.closed_position
        return self.closed_position + fraction * travel


@dataclass(frozen=True)
class RobotData:
    """The fields of a `Robot`, which says what they are; blanks are not filled."""

    name: str
    model_file: Path
    joints: tuple[str, ...]
    home: tuple[float, ...]
    velocity_limits: tuple[float, ...]
    payload: float
    reach: float
    gripper: Gripper = field(default_factory=Gripper)
    title: str = ""
    torque_limits: tuple[float, ...] = ()
    armature: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    stiffness: tuple[float, ...] = ()
    stand: Literal["pedestal", "table", "none"] = "table"
    tcp: str = "tcp"
    look: Path | None = None
    _overlaps: tuple[tuple[str, str], ...] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        errors.check_word("name", self.name)
        errors.check_kind("model_file", self.model_file, (str, Path), "a path")
        errors.check_kind("title", self.title, str, "a string")
        errors.check_kind("gripper", self.gripper, Gripper, "a Gripper")
        errors.check_name("tcp", self.tcp)
        if self.look is not None:
            errors.check_kind("look", self.look, (str, Path), "a path")
            freeze(self, look=Path(self.look).absolute())
        freeze(
            self,
            model_file=Path(self.model_file).absolute(),
            joints=_names(self.joints),
            title=self.title or self.name,
            _overlaps=(),
        )
        who = f"robot {self.name!r}: "
        for name in _PER_JOINT:
            values = errors.check_numbers(who + name, getattr(self, name))
            freeze(self, **{name: values})
        for name in ("payload", "reach"):
            value = errors.check_number(
                who + name, getattr(self, name), above=0, at_most=1e4
            )
            freeze(self, **{name: value})
        _check_values(self)

    @property
    def base_height(self) -> float:
        """Height above the floor at which its stand carries the base, in m."""
        # Those of the thesis; its pedestals are higher than Sawyer's own (0.915 m).
        return {"pedestal": 1.0, "table": 0.65, "none": 0.0}[self.stand]


def compile_error(robot: RobotData, error: ValueError) -> Exception:
    """Return the error that says why MuJoCo cannot compile an arm's model."""
    file, told = robot.model_file.name, errors.told_by_mujoco(error)
    kind = FileNotFoundError if "opening file" in told else ValueError
    return kind(f"MuJoCo cannot compile {file}: {told}")


def _check_gripper(gripper: Gripper) -> None:
    """Raise ValueError if no gripper can have these numbers."""
    if gripper.holding_force < 0:
        raise ValueError(
            f"a gripper's holding_force must be at least 0, got {gripper.holding_force}"
        )
    if not gripper.joints:
        return
    positions = gripper.open_position, gripper.closed_position
    gaps = gripper.open_gap, gripper.closed_gap
    if positions[0] == positions[1]:
        raise ValueError(
            "a gripper's open_position must differ from its closed_position, got"
            f" {positions[0]} for both"
        )
    if not 0 <= gaps[1] < gaps[0]:
        raise ValueError(
            "a gripper's closed_gap must be at least 0 and below its open_gap, got"
            f" {gaps[1]} and {gaps[0]}"
        )
    if gaps[0] > _WIDEST:
        raise ValueError(
            f"a gripper's open_gap must be at most {_WIDEST:g} m, got {gaps[0]:g};"
            " give m, not mm"
        )
    if gripper.force <= 0:
        raise ValueError(f"a gripper's force must be above 0, got {gripper.force}")


def _check_values(robot: RobotData) -> None:
    """Raise ValueError if a value cannot be right whatever the model file holds."""
    who, count = f"robot {robot.name!r}", len(robot.joints)
    with errors.naming(who):
        if robot.stand not in _STANDS:
            raise ValueError(errors.unknown("stand", robot.stand, _STANDS))
        if not count or len(set(robot.joints)) < count:
            raise ValueError(f"joints must name each joint once, got {robot.joints}")
    optional = ("torque_limits", "armature", "damping", "stiffness")
    for name in ("home", "velocity_limits", *optional):
        values = getattr(robot, name)
        if name in optional and not values:
            continue
        if len(values) != count:
            raise ValueError(
                f"{who} has {count} joints but {len(values)} values in {name}; give one"
                " per joint"
            )
        with errors.naming(who):
            check_per_joint(robot, name)


def check_per_joint(robot: RobotData, name: str) -> None:
    """Raise ValueError if a joint cannot have its value in this field."""
    low, high, unit = _PER_JOINT[name]
    hint = "; give rad/s, not degrees" if name == "velocity_limits" else ""
    for joint, value in zip(robot.joints, getattr(robot, name), strict=True):
        if not low <= value <= high:
            raise ValueError(
                f"{name} of joint {joint!r} must be {low:g} to {high:g}{unit}, got"
                f" {value:g}{hint}"
            )


def freeze(value: Any, **contents: Any) -> None:
    """Set fields of a frozen value that is being made."""
    for name, content in contents.items():
        object.__setattr__(value, name, content)


def _names(given: Sequence[str]) -> tuple[str, ...]:
    errors.check_kind("joints", given, (tuple, list), "a sequence of names")
    for name in given:
        errors.check_name("each of joints", name)
    return tuple(given)
