"""From actions to controls and grips: the action modes."""

from collaborative_gym.control.joints import JointChanges
from collaborative_gym.control.modes import (
    ActionMode,
    Command,
    Motion,
    get_mode,
    list_modes,
    register_mode,
)
from collaborative_gym.control.tcp import TcpChanges, TcpPositionChanges

__all__ = [
    "ActionMode",
    "Command",
    "JointChanges",
    "Motion",
    "TcpChanges",
    "TcpPositionChanges",
    "get_mode",
    "list_modes",
    "register_mode",
]
