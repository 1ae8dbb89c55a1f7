"""A robot arm as a value: its model file, limits, home pose and gripper."""

from dataclasses import dataclass, replace

import mujoco

from collaborative_gym.errors import naming
from collaborative_gym.robots.checks import check_payload, compile_alone, overlaps
from collaborative_gym.robots.data import RobotData, check_per_joint, freeze
from collaborative_gym.robots.model_file import load_model
from collaborative_gym.robots.servos import gains, torque_limits

_STIFFNESS = 8.0
"""Stiffness over damping of the joint servos where none is given, in 1/s."""

_HOLDING = 8.0
"""Holding force of a gripper where none is given, over the greatest joint torque
divided by the reach: what the strongest joint pulls with at an eighth of the reach.

Our choice: data sheets give what fingers squeeze with (70 N of the Franka Hand), not
what tears a thing out of them, and Lift's pots weigh up to 4.7 payloads an arm. It is
1.6 (Sawyer, Panda) to 2.3 times (Jaco) the greatest force of Lift's experts in any
physics step, by `benchmarks/grips.py`."""


@dataclass(frozen=True)
class Robot(RobotData):
    """An arm, ready to be put into any task.

    The model file holds kinematics, joint ranges, inertias and geoms; this value adds
    what a controller must know. The tuples have one entry per arm joint; those that are
    left empty are filled in when the value is made.

    Keyframes, sensors, lights and physics settings of the model file are ignored, and
    actuators but for their limits. Gravity is compensated for the arm's links. Links at
    most two joints apart, or both of the gripper, that touch at home never collide:
    this counts as a flaw of their shapes.

    Attributes:
      name: the name, one word, under which tasks ask for the arm.
      model_file: MJCF (.xml) or URDF file, base at the origin, x forward and z up.
      joints: arm joint names in the model file, from the base to the tool.
      home: arm joint angles of the maker's ready pose, in rad.
      velocity_limits: greatest joint speeds, in rad/s.
      payload: rated load at the tool, in kg.
      reach: rated reach from the shoulder, in m.
      gripper: its fingers.
      title: maker and model; empty, the name.
      torque_limits: greatest joint torques, in N m; empty, those of the model file
        (`effort` in URDF; `actuatorfrcrange` in MJCF, or else its actuators' limits).
      armature: inertias of the rotors as the joints feel them, in kg m2; empty, those
        of the model file. If the file has none, the joint gets one with which it needs
        at least 20 ms to full speed, and 10 ms for its rotor alone.
      damping: velocity gains of the joint servos, in N m s/rad; empty, half of what
        would chatter, from the joints' inertias at home.
      stiffness: position gains of the servos, in N m/rad; empty, 8 times the damping.
      stand: what the arm stands on.
      tcp: site, or else body, of the tool centre point, z along the approach direction
        and y along the closing direction of the fingers.
      look: another model file of the same arm, with whose shapes it is drawn, such as
        one with the maker's meshes; None for its own. It changes no physics.

    Raises:
      FileNotFoundError: if the model file or one of its meshes is missing.
      ValueError: if a definition is wrong; says what to change.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        spec = self.spec()
        with naming(f"robot {self.name!r}"):
            if not self.torque_limits:
                freeze(self, torque_limits=torque_limits(self, spec))
                check_per_joint(self, "torque_limits")
            pull = _HOLDING * max(self.torque_limits) / self.reach
            if not self.gripper.holding_force:
                freeze(self, gripper=replace(self.gripper, holding_force=pull))
            model = compile_alone(self, spec)
            check_payload(self, pull)
            freeze(self, _overlaps=overlaps(self, model))
        if not (self.armature and self.damping):
            armature, damping = gains(self, model)
            freeze(self, armature=armature, damping=self.damping or damping)
        if not self.stiffness:
            freeze(self, stiffness=tuple(_STIFFNESS * d for d in self.damping))

    def spec(self) -> mujoco.MjSpec:
        """Return the arm's model, fresh for every caller to edit."""
        with naming(f"robot {self.name!r}"):
            spec = load_model(self)
        for first, second in self._overlaps:
            spec.add_exclude(bodyname1=first, bodyname2=second)
        return spec
