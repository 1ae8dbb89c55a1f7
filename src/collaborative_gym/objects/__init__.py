"""The objects in the worlds: functions that each return the model of one."""

from typing import Any

from collaborative_gym.errors import unknown
from collaborative_gym.objects.ball import ball
from collaborative_gym.objects.bar import bar
from collaborative_gym.objects.board import board
from collaborative_gym.objects.cube import cube
from collaborative_gym.objects.donut import donut
from collaborative_gym.objects.mallet import mallet
from collaborative_gym.objects.pedestal import pedestal
from collaborative_gym.objects.pot import pot, ring_pot
from collaborative_gym.objects.puck import puck
from collaborative_gym.objects.rink import rink
from collaborative_gym.objects.stick import stick
from collaborative_gym.objects.table import round_table, table

__all__ = [
    "ball",
    "bar",
    "board",
    "cube",
    "donut",
    "mallet",
    "pedestal",
    "pot",
    "puck",
    "ring_pot",
    "rink",
    "round_table",
    "stick",
    "table",
]


def __getattr__(name: str) -> Any:
    raise AttributeError(unknown("object", name, __all__))
