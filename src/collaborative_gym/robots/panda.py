"""Franka Emika Panda with the Franka Hand."""

from math import pi
from pathlib import Path

from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.robot import Robot

PANDA = Robot(
    name="panda",
    title="Franka Emika Panda",
    model_file=Path(__file__).with_name("panda.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # The "ready" pose of libfranka and franka_ros examples.
    home=(0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
    # franka_ros c11f000, franka_description/robots/panda/joint_limits.yaml.
    velocity_limits=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    torque_limits=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    # Our choice, by measurement (benchmarks/servo.py): damping as great as the joint's
    # inertia allows without chatter at the physics time step. Rotor inertias, too, are
    # our choice: none are published.
    damping=(160.0, 150.0, 150.0, 180.0, 18.0, 16.0, 18.0),
    armature=(0.5, 0.4, 0.3, 0.3, 0.1, 0.1, 0.1),
    payload=3.0,
    reach=0.855,
    gripper=Gripper(
        joints=("left_finger", "right_finger"),
        # Short of the joint's limit, which costs time to compute when it is touched.
        open_position=0.0395,
        closed_position=0.0,
        open_gap=0.079,
        closed_gap=0.0,
        force=70.0,
    ),
)
