"""Universal Robots UR10e with the Robotiq 2F-85 gripper."""

from math import radians
from pathlib import Path

from collaborative_gym.robots.robot import Robot
from collaborative_gym.robots.ur5e import ROBOTIQ_2F85, UR5E

UR10E = Robot(
    name="ur10e",
    title="Universal Robots UR10e",
    model_file=Path(__file__).with_name("ur10e.xml"),
    joints=UR5E.joints,
    home=UR5E.home,
    # Universal_Robots_ROS2_Description, config/ur10e/joint_limits.yaml.
    velocity_limits=tuple(map(radians, (120, 120, 180, 180, 180, 180))),
    torque_limits=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
    payload=12.5,
    # To the tcp, as that of Jaco; the data sheet's 1.3 m end at the wrist.
    reach=1.5,
    gripper=ROBOTIQ_2F85,
)
