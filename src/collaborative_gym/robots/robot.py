"""A robot arm as a value: its model file, limits, home pose and gripper."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import mujoco

from collaborative_gym.errors import (
    check_kind,
    check_name,
    check_number,
    check_numbers,
)
from collaborative_gym.robots.checks import (
    check_gripper,
    check_values,
    compile_alone,
    overlaps,
)
from collaborative_gym.robots.model_file import load_model
from collaborative_gym.robots.servos import armatures, dampings, torque_limits

_PER_JOINT = (
    "home",
    "velocity_limits",
    "torque_limits",
    "armature",
    "damping",
    "stiffness",
)

_GRIPPER_NUMBERS = (
    "open_position",
    "closed_position",
    "open_gap",
    "closed_gap",
    "force",
)

_STIFFNESS = 8.0
"""Stiffness over damping of the joint servos where none is given, in 1/s."""


@dataclass(frozen=True)
class Gripper:
    """Fingers that move together, each on its own joint; without joints, no fingers.

    Joints that mimic one of these in URDF, or follow it by a joint equality in MJCF,
    move with it.

    Attributes:
      joints: finger joint names in the model file.
      open_position: joint position of an open gripper, in m or rad.
      closed_position: joint position of a closed gripper, in m or rad.
      open_gap: clear width between the fingers when open, in m.
      closed_gap: clear width between the fingers when closed, in m.
      force: limit of one finger's actuator, in N or N m.

    Raises:
      ValueError: if the numbers make no gripper; says which to change.
    """

    joints: tuple[str, ...] = ()
    open_position: float = 0.0
    closed_position: float = 0.0
    open_gap: float = 0.0
    closed_gap: float = 0.0
    force: float = 0.0

    def __post_init__(self) -> None:
        _freeze(self, joints=_names(self.joints))
        for field_name in _GRIPPER_NUMBERS:
            given = getattr(self, field_name)
            _freeze(self, **{field_name: check_number(field_name, given)})
        check_gripper(self)

    def position(self, gap: float) -> float:
        """Return the joint position at which the fingers are `gap` metres apart."""
        gap = check_number("gap", gap)
        if not self.joints:
            return self.open_position
        gap = min(max(gap, self.closed_gap), self.open_gap)
        fraction = (gap - self.closed_gap) / (self.open_gap - self.closed_gap)
        return self.closed_position + fraction * (
            self.open_position - self.closed_position
        )


@dataclass(frozen=True)
class Robot:
    """An arm, ready to be put into any task.

    The model file holds kinematics, joint ranges, inertias and geoms; this value adds
    what a controller must know. The tuples have one entry per arm joint; those that are
    left empty are filled in when the value is made.

    Of the model file, actuators, keyframes, sensors, lights and settings of the physics
    are left out. The arm's links are gravity compensated. Links at most two joints
    apart that touch at home are taken to do so by the look of their shapes, and never
    collide.

    Attributes:
      name: the name under which tasks ask for the arm.
      model_file: MJCF (.xml) or URDF (.urdf) file with the base at the origin, x
        forward and z up.
      joints: arm joint names in the model file, from the base to the tool.
      home: arm joint angles of the maker's ready pose, in rad.
      velocity_limits: greatest joint speeds, in rad/s.
      payload: rated load at the tool, in kg.
      reach: rated reach from the shoulder, in m.
      gripper: its fingers.
      title: maker and model; empty, the name.
      torque_limits: greatest joint torques, in N m; empty, those of the model file
        (`effort` in URDF, `actuatorfrcrange` in MJCF).
      armature: inertias of the rotors as the joints feel them, in kg m2; empty, those
        of the model file, and where that has none, such that the joint needs at least
        20 ms to full speed, and 10 ms for its rotor alone.
      damping: velocity gains of the joint servos, in N m s/rad; empty, half of what
        would chatter, from the joints' inertias at home.
      stiffness: position gains of the joint servos, in N m/rad; empty, 8 times the
        damping.
      stand: what the arm stands on.
      tcp: site, or else body, of the tool centre point, z along the approach direction
        and y along the closing direction of the fingers.

    Raises:
      FileNotFoundError: if the model file or one of its meshes is missing.
      ValueError: if a definition is wrong; says what to change.
    """

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
    _overlaps: tuple[tuple[str, str], ...] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_name("name", self.name)
        check_kind("model_file", self.model_file, (str, Path), "a path")
        check_kind("title", self.title, str, "a string")
        check_kind("gripper", self.gripper, Gripper, "a Gripper")
        check_name("tcp", self.tcp)
        _freeze(
            self,
            model_file=Path(self.model_file).absolute(),
            joints=_names(self.joints),
            title=self.title or self.name,
            _overlaps=(),
        )
        for field_name in _PER_JOINT:
            values = check_numbers(field_name, getattr(self, field_name))
            _freeze(self, **{field_name: values})
        for field_name in ("payload", "reach"):
            value = check_number(field_name, getattr(self, field_name), above=0)
            _freeze(self, **{field_name: value})
        check_values(self)
        spec = self.spec()
        if not self.torque_limits:
            _freeze(self, torque_limits=torque_limits(self, spec))
        model = compile_alone(self, spec)
        _freeze(self, _overlaps=overlaps(self, model))
        if not self.armature:
            _freeze(self, armature=armatures(self, model))
        if not self.damping:
            _freeze(self, damping=dampings(self, model))
        if not self.stiffness:
            _freeze(self, stiffness=tuple(_STIFFNESS * d for d in self.damping))

    @property
    def base_height(self) -> float:
        """Height above the floor at which its stand carries the base, in m."""
        # Those of the thesis; its pedestals are higher than Sawyer's own (0.915 m).
        return {"pedestal": 1.0, "table": 0.65, "none": 0.0}[self.stand]

    def spec(self) -> mujoco.MjSpec:
        """Return the arm's model, fresh for every caller to edit."""
        spec = load_model(self)
        for first, second in self._overlaps:
            spec.add_exclude(bodyname1=first, bodyname2=second)
        return spec


def _freeze(value: Any, **fields: Any) -> None:
    """Set fields of a frozen value that is being made."""
    for name, content in fields.items():
        object.__setattr__(value, name, content)


def _names(given: Sequence[str]) -> tuple[str, ...]:
    check_kind("joints", given, (tuple, list), "a sequence of names")
    for name in given:
        check_name("each of joints", name)
    return tuple(given)
