"""Kinova Jaco of the second generation with seven joints and three fingers."""

from pathlib import Path

from collaborative_gym.robots.data import Gripper
from collaborative_gym.robots.robot import Robot

JACO = Robot(
    name="jaco",
    title="Kinova Jaco (j2s7s300)",
    model_file=Path(__file__).with_name("jaco.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # "Home" in kinova-ros 924781d, j2s7s300.srdf.
    home=(4.71, 2.84, 0.0, 0.75, 4.62, 4.48, 4.88),
    # kinova-ros 924781d, j2s7s300.xacro: 36 and 48 degrees a second.
    velocity_limits=(0.62831853,) * 4 + (0.83775804,) * 3,
    # Peak torques of the actuators KA-75+ and KA-58.
    torque_limits=(30.5,) * 4 + (6.8,) * 3,
    # Our choice, by measurement (benchmarks/servo.py): damping as great as the joint's
    # inertia allows without chatter at the physics time step. Rotor inertias, too, are
    # our choice: none are published.
    damping=(96.0,) * 4 + (16.0,) * 3,
    armature=(0.8,) * 4 + (0.15,) * 3,
    payload=2.4,
    reach=0.985,
    gripper=Gripper(
        joints=("finger1", "finger2", "finger3"),
        open_position=0.2,
        closed_position=1.2,
        open_gap=0.112,
        closed_gap=0.014,
        force=2.0,
    ),
)
