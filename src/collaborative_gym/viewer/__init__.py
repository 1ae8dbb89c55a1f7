"""Looking at a policy at work, in a window or in the browser."""

from collaborative_gym.viewer.launch import view

__all__ = ["view"]
