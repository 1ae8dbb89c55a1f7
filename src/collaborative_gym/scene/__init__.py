"""Robots and objects put together into one compiled world."""

from collaborative_gym.scene.handles import SHOULDER, Arm, Grip, Placement
from collaborative_gym.scene.scene import Scene

__all__ = ["SHOULDER", "Arm", "Grip", "Placement", "Scene"]
