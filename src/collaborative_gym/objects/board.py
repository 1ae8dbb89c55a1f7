"""A board with a handle at each short end."""

import mujoco
import numpy as np

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

WIDTH = 0.8  # m, along x
LENGTH = 1.5  # m, along y
THICKNESS = 0.04  # m
BAR = 0.02  # m, diameter of a handle
HANDLE = 0.79  # m, from the centre to a handle; leaves room for finger tips
HANDLES = ("handle_1", "handle_2")  # sites, at negative and positive y

_HANDLE_LENGTH = 0.16  # m
_SLOPE = np.radians(45)  # of the fingers that hold a handle, downwards
_RGBA = (0.20, 0.42, 0.68, 1.0)
_BAR_RGBA = (0.30, 0.32, 0.34, 1.0)
_CENTRE_RGBA = (0.95, 0.95, 0.95, 1.0)


def board(mass: float = 1.0, marked_radius: float = 0.0) -> mujoco.MjSpec:
    """Return a board without joints, 0.8 x 1.5 x 0.04 m, long side along y.

    The body `board` and its site `board` have their origin in the board's centre, z up.
    The sites `handle_1` (at negative y) and `handle_2` lie in the middle of the handles
    and are oriented as a tcp that holds them: z inwards and 45 degrees down, y across
    the bar and up. Only the plate collides.

    Args:
      mass: in kg, all of it in the plate.
      marked_radius: of a disc painted on the middle of the plate, in m; 0 for none.

    Raises:
      TypeError: if one is not a number.
      ValueError: if one is out of bounds.
    """
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    check_number("marked_radius", marked_radius, at_least=0.0, at_most=10.0)
    spec, body = begin("board")
    body.add_geom(
        name="plate",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(WIDTH / 2, LENGTH / 2, THICKNESS / 2),
        mass=mass,
        rgba=_RGBA,
        group=2,
    )
    body.add_site(name="board")
    for name, side in zip(HANDLES, (-1.0, 1.0), strict=True):
        _add_handle(body, name, side)
    if marked_radius > 0:
        disc, size = mujoco.mjtGeom.mjGEOM_CYLINDER, (marked_radius, 0.0005)
        pos = (0, 0, THICKNESS / 2)
        add_visual(body, disc, size=size, rgba=_CENTRE_RGBA, pos=pos)
    return spec


def _add_handle(body: mujoco.MjsBody, name: str, side: float) -> None:
    """Add a bar along x on two brackets at the end of the plate on that side of y."""
    half = _HANDLE_LENGTH / 2
    y = side * HANDLE
    bars = [(-half, y, 0, half, y, 0)]
    bars += [(x, side * LENGTH / 2, 0, x, y, 0) for x in (-half, half)]
    for bar in bars:
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        add_visual(body, capsule, size=(BAR / 2,), rgba=_BAR_RGBA, fromto=bar)
    inwards = np.array([0.0, -side * np.cos(_SLOPE), -np.sin(_SLOPE)])
    upwards = np.array([0.0, -side * np.sin(_SLOPE), np.cos(_SLOPE)])
    axes = np.stack([np.cross(upwards, inwards), upwards, inwards], axis=1)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    body.add_site(name=name, pos=(0, y, 0), quat=quat)
