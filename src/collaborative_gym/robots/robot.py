"""A robot arm as a value: its model file, limits, home pose and gripper."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco

from collaborative_gym.errors import unknown


@dataclass(frozen=True)
class Gripper:
    """Fingers that move together, each on its own joint.

    Attributes:
      joints: finger joint names in the model file.
      open_position: joint position of an open gripper, in m or rad.
      closed_position: joint position of a closed gripper, in m or rad.
      open_gap: clear width between the fingers when open, in m.
      closed_gap: clear width between the fingers when closed, in m.
      force: limit of one finger's actuator, in N or N m.
    """

    joints: tuple[str, ...]
    open_position: float
    closed_position: float
    open_gap: float
    closed_gap: float
    force: float

    def position(self, gap: float) -> float:
        """Return the joint position at which the fingers are `gap` metres apart."""
        gap = min(max(gap, self.closed_gap), self.open_gap)
        fraction = (gap - self.closed_gap) / (self.open_gap - self.closed_gap)
        return self.closed_position + fraction * (
            self.open_position - self.closed_position
        )


@dataclass(frozen=True)
class Robot:
    """A commercial arm, ready to be put into any task.

    The model file holds kinematics, joint ranges, inertias and geoms; this value adds
    what a controller must know. The tuples have one entry per arm joint.

    Attributes:
      name: the name under which tasks ask for the arm.
      title: maker and model.
      model_file: MJCF or URDF file with the base at the origin, x forward and z up.
      joints: arm joint names in the model file, from the base to the tool.
      home: arm joint angles of the maker's ready pose, in rad.
      velocity_limits: greatest joint speeds, in rad/s.
      torque_limits: greatest joint torques, in N m.
      stiffness: position gains of the joint servos, in N m/rad.
      damping: velocity gains of the joint servos, in N m s/rad.
      armature: inertias of the rotors as the joints feel them, in kg m2.
      payload: rated load at the tool, in kg.
      reach: rated reach from the shoulder, in m.
      stand: what the arm stands on.
      gripper: its fingers.
      tcp: site of the tool centre point, z along the approach direction and y along
        the closing direction of the fingers.
    """

    name: str
    title: str
    model_file: Path
    joints: tuple[str, ...]
    home: tuple[float, ...]
    velocity_limits: tuple[float, ...]
    torque_limits: tuple[float, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    armature: tuple[float, ...]
    payload: float
    reach: float
    stand: Literal["pedestal", "table", "none"]
    gripper: Gripper
    tcp: str = "tcp"

    def __post_init__(self) -> None:
        for field in (
            "home",
            "velocity_limits",
            "torque_limits",
            "stiffness",
            "damping",
            "armature",
        ):
            count = len(getattr(self, field))
            if count != len(self.joints):
                raise ValueError(
                    f"robot {self.name!r} has {len(self.joints)} joints but {count}"
                    f" values in {field}; give one per joint"
                )

    @property
    def base_height(self) -> float:
        """Height above the floor at which its stand carries the base, in m."""
        # Those of the thesis; its pedestals are higher than Sawyer's own (0.915 m).
        return {"pedestal": 1.0, "table": 0.65, "none": 0.0}[self.stand]

    def spec(self) -> mujoco.MjSpec:
        """Return the arm's model, fresh for every caller to edit.

        Raises:
          ValueError: if the model file lacks a joint or the tcp's site.
        """
        spec = mujoco.MjSpec.from_file(str(self.model_file))
        for kind, wanted, elements in (
            ("joint", (*self.joints, *self.gripper.joints), spec.joints),
            ("site", (self.tcp,), spec.sites),
        ):
            names = [element.name for element in elements]
            for name in wanted:
                if name not in names:
                    raise ValueError(
                        f"robot {self.name!r}: its model file {self.model_file.name}"
                        f" has {unknown(kind, name, names)}"
                    )
        return spec
