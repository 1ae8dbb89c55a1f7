"""From actions to controls and grips: the action modes."""

from collaborative_gym.control.impedance import Impedance, ImpedanceStiffness
from collaborative_gym.control.joints import JointChanges
from collaborative_gym.control.modes import (
    ActionMode,
    Command,
    Commands,
    Motion,
    get_mode,
    list_modes,
    register_mode,
)
from collaborative_gym.control.tcp import TcpChanges, TcpPositionChanges
from collaborative_gym.control.torques import Torques

__all__ = [
    "ActionMode",
    "Command",
    "Commands",
    "Impedance",
    "ImpedanceStiffness",
    "JointChanges",
    "Motion",
    "TcpChanges",
    "TcpPositionChanges",
    "Torques",
    "get_mode",
    "list_modes",
    "register_mode",
]
