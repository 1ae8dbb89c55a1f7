"""Robots and objects put together into one compiled world."""

from collaborative_gym.scene.collisions import STOP
from collaborative_gym.scene.handles import SHOULDER, Arm, Grip, Placement
from collaborative_gym.scene.refinement import refinement
from collaborative_gym.scene.scene import Scene

__all__ = ["SHOULDER", "STOP", "Arm", "Grip", "Placement", "Scene", "refinement"]
