"""Rethink Robotics Sawyer with the electric parallel gripper."""

from pathlib import Path

from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.robot import Robot

SAWYER = Robot(
    name="sawyer",
    title="Rethink Robotics Sawyer",
    model_file=Path(__file__).with_name("sawyer.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # "neutral" in sawyer_description/params/named_poses.yaml.
    home=(0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 3.3161),
    # RethinkRobotics/sawyer_robot d1ef3d0, sawyer_base.urdf.xacro.
    velocity_limits=(1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),
    torque_limits=(80.0, 80.0, 40.0, 40.0, 9.0, 9.0, 9.0),
    # Our choice, by measurement (benchmarks/servo.py): damping as great as the joint's
    # inertia allows without chatter at the physics time step. Rotor inertias, too, are
    # our choice: none are published.
    damping=(176.0, 220.0, 78.0, 65.0, 16.0, 18.0, 18.0),
    armature=(0.3, 0.8, 0.2, 0.2, 0.08, 0.1, 0.1),
    payload=4.0,
    reach=1.26,
    stand="pedestal",
    gripper=Gripper(
        joints=("left_finger", "right_finger"),
        # Short of the joint's limit, which costs time to compute when it is touched.
        open_position=0.0203,
        closed_position=0.0,
        open_gap=0.0566,
        closed_gap=0.016,
        force=20.0,
    ),
)
