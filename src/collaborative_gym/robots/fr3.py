"""Franka Research 3 with the Franka Hand."""

from math import pi
from pathlib import Path

from collaborative_gym.robots.panda import PANDA
from collaborative_gym.robots.robot import Robot

FR3 = Robot(
    name="fr3",
    title="Franka Research 3",
    model_file=Path(__file__).with_name("fr3.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # The "ready" pose of libfranka and franka_ros examples.
    home=(0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
    # frankaemika/franka_description 1ddff9b, robots/fr3/joint_limits.yaml.
    velocity_limits=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    torque_limits=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # The maker's, in RobotLocomotion/drake, manipulation/models/franka_description.
    armature=(0.606, 0.606, 0.462, 0.462, 0.206, 0.206, 0.206),
    payload=3.0,
    reach=0.855,
    gripper=PANDA.gripper,
)
