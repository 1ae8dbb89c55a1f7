"""From actions to servo commands and grips."""

from collaborative_gym.control.actions import (
    ActionMode,
    JointChanges,
    Motion,
    check_actions,
)
from collaborative_gym.control.controller import Controller

__all__ = ["ActionMode", "Controller", "JointChanges", "Motion", "check_actions"]
