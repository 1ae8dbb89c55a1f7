"""KUKA LBR iiwa 14 R820 with the Robotiq 2F-85 gripper."""

from math import pi, radians
from pathlib import Path

from collaborative_gym.robots.robot import Robot
from collaborative_gym.robots.ur5e import ROBOTIQ_2F85

IIWA14 = Robot(
    name="iiwa14",
    title="KUKA LBR iiwa 14",
    model_file=Path(__file__).with_name("iiwa14.xml"),
    joints=tuple(f"joint{i}" for i in range(1, 8)),
    # Our choice: the elbow up and the tool down, 0.4 m above the base.
    home=(0.0, 0.2, 0.0, -1.6, 0.0, pi - 1.8, 0.0),
    # Data sheet of the LBR iiwa 14 R820, in degrees a second and N m.
    velocity_limits=tuple(radians(v) for v in (85, 85, 100, 75, 130, 135, 135)),
    torque_limits=(320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
    payload=14.0,
    # To the tcp, as that of Jaco. The data sheet's 0.82 m end at the wrist's centre.
    # The elbow turns to 120 degrees, so the wrist comes no nearer to the shoulder than
    # half of them, and places that suit an arm of 0.82 m are too near.
    reach=1.09,
    gripper=ROBOTIQ_2F85,
)
