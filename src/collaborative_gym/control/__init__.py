"""From actions to servo commands and grips."""

from collaborative_gym.control.controller import Controller

__all__ = ["Controller"]
