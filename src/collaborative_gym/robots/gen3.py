"""Kinova Gen3 of seven joints with the Robotiq 2F-85 gripper."""

from math import radians
from pathlib import Path

from collaborative_gym.robots.robot import Robot
from collaborative_gym.robots.ur5e import ROBOTIQ_2F85

GEN3 = Robot(
    name="gen3",
    title="Kinova Gen3",
    model_file=Path(__file__).with_name("gen3.xml"),
    joints=tuple(f"joint_{i}" for i in range(1, 8)),
    # The maker's "home": 0, 15, 180, -130, 0, 55 and 90 degrees.
    home=tuple(radians(angle) for angle in (0, 15, 180, -130, 0, 55, 90)),
    # ros2_kortex 0d60040, gen3_macro.xacro: 80 and 70 degrees a second.
    velocity_limits=(1.3963,) * 4 + (1.2218,) * 3,
    torque_limits=(39.0,) * 4 + (9.0,) * 3,
    # Our choice, by measurement (benchmarks/servo.py): with less at the wrist, it gives
    # way by 1 cm a control step when it turns with the rated payload.
    damping=(76.0, 109.0, 63.0, 71.0, 18.0, 18.0, 18.0),
    armature=(0.28,) * 4 + (0.12, 0.12, 0.15),
    payload=4.0,
    # To the tcp, as that of Jaco; the data sheet's 0.902 m end before the hand.
    reach=1.05,
    gripper=ROBOTIQ_2F85,
)
