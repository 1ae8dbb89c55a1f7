"""UFACTORY xArm7 with the xArm Gripper."""

from math import pi
from pathlib import Path

from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.robot import Robot

XARM7 = Robot(
    name="xarm7",
    title="UFACTORY xArm7",
    model_file=Path(__file__).with_name("xarm7.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # "home" in google-deepmind/mujoco_menagerie, ufactory_xarm7.
    home=(0.0, -0.247, 0.0, 0.909, 0.0, 1.15644, 0.0),
    # xarm7.urdf of example-robot-data 6.0.0: 180 degrees a second.
    velocity_limits=(pi,) * 7,
    torque_limits=(50.0, 50.0, 30.0, 30.0, 30.0, 20.0, 20.0),
    payload=3.5,
    # To the tcp, as that of Jaco; the data sheet's 0.7 m end before the hand.
    reach=0.9,
    gripper=Gripper(
        joints=("left_finger", "right_finger"),
        # Short of the joint's limit, which costs time to compute when it is touched.
        open_position=0.042,
        closed_position=0.0,
        open_gap=0.084,
        closed_gap=0.0,
        force=30.0,
    ),
)
