"""Universal Robots UR5e with the Robotiq 2F-85 gripper."""

from math import pi
from pathlib import Path

from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.robot import Robot

ROBOTIQ_2F85 = Gripper(
    joints=("left_finger", "right_finger"),
    # Short of the joint's limit, which costs time to compute when it is touched.
    open_position=0.0425,
    closed_position=0.0,
    open_gap=0.085,
    closed_gap=0.0,
    # Our choice, of the 20 to 235 N of the data sheet.
    force=125.0,
)

UR5E = Robot(
    name="ur5e",
    title="Universal Robots UR5e",
    model_file=Path(__file__).with_name("ur5e.xml"),
    joints=(
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ),
    # Our choice: the elbow up and the tool down, as in the maker's examples.
    home=(0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0),
    # Universal_Robots_ROS2_Description, config/ur5e/joint_limits.yaml.
    velocity_limits=(pi,) * 6,
    torque_limits=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    payload=5.0,
    # Our choice. The data sheet's 0.85 m end at the wrist, 0.24 m before the tcp; with
    # them robot_2 of Pass would reach robot_1's table. With 0.93 m and more, the pot of
    # Lift would be as far away as one arm can just hold it.
    reach=0.9,
    gripper=ROBOTIQ_2F85,
)
