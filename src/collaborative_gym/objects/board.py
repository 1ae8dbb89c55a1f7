"""A board with a handle at each short end, and a round one with more."""

import mujoco
import numpy as np

from collaborative_gym.errors import check_count, check_number
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.objects.pot import handle_directions
from collaborative_gym.objects.visual import add_visual, begin

THICKNESS = 0.04  # m
BAR = 0.02  # m, diameter of a handle

_WIDTH = 0.8  # m, along x
_LENGTH = 1.5  # m, along y
_RADIUS = 0.6  # m, of a round board
_ROOM = 0.04  # m between the edge and a handle; leaves room for finger tips
_HANDLE_LENGTH = 0.16  # m
_SLOPE = np.radians(45)  # of the fingers that hold a handle, downwards
_RGBA = (0.20, 0.42, 0.68, 1.0)
_BAR_RGBA = (0.30, 0.32, 0.34, 1.0)
_CENTRE_RGBA = (0.95, 0.95, 0.95, 1.0)


def handle_radius(count: int) -> float:
    """Return the distance of so many handles from a board's centre, in m."""
    return (_LENGTH / 2 if count == 2 else _RADIUS) + _ROOM


def within(count: int) -> np.ndarray:
    """Return half the sides along x and y of a rectangle on the plate, (2,), in m.

    It is the whole plate with two handles, the largest square on it with more.
    """
    if count == 2:
        return np.array([_WIDTH / 2, _LENGTH / 2])
    return np.full(2, _RADIUS * 0.5**0.5)


def is_off(offset: Array, count: int) -> Array:
    """Return which places are beyond the plate's edge, or below its top.

    Args:
      offset: (num_envs, 3) from the board's centre, in its frame, in m.
      count: number of handles.
    """
    xp = array_namespace(offset)
    x, y, below = offset[:, 0], offset[:, 1], offset[:, 2] < THICKNESS / 2
    if count == 2:
        return (xp.abs(x) > _WIDTH / 2) | (xp.abs(y) > _LENGTH / 2) | below
    return (x**2 + y**2 > _RADIUS**2) | below


def board(
    mass: float = 1.0, marked_radius: float = 0.0, *, count: int = 2
) -> mujoco.MjSpec:
    """Return a board without joints, 0.04 m thick, with handles around it.

    With two handles it is 0.8 x 1.5 m, the long side along y; with more it is round,
    1.2 m wide. The body `board` and its site `board` have their origin in the board's
    centre, z up. The sites `handle_1` (at negative y) and so on, counterclockwise, lie
    in the middle of the handles and are oriented as a tcp that holds them: z inwards
    and 45 degrees down, y across the bar and up. Only the plate collides.

    Args:
      mass: in kg, all of it in the plate.
      marked_radius: of a disc painted on the middle of the plate, in m; 0 for none.
      count: number of handles.

    Raises:
      TypeError: if one is not a number.
      ValueError: if one is out of bounds.
    """
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    check_number("marked_radius", marked_radius, at_least=0.0, at_most=10.0)
    check_count("count", count, 2, 100)
    spec, body = begin("board")
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    shape, size = cylinder, (_RADIUS, THICKNESS / 2, 0.0)
    if count == 2:
        shape, size = box, (_WIDTH / 2, _LENGTH / 2, THICKNESS / 2)
    body.add_geom(name="plate", type=shape, size=size, mass=mass, rgba=_RGBA, group=2)
    body.add_site(name="board")
    for i, direction in enumerate(handle_directions(count)):
        _add_handle(body, f"handle_{i + 1}", direction, handle_radius(count))
    if marked_radius > 0:
        size, pos = (marked_radius, 0.0005), (0, 0, THICKNESS / 2)
        add_visual(body, cylinder, size=size, rgba=_CENTRE_RGBA, pos=pos)
    return spec


def _add_handle(
    body: mujoco.MjsBody, name: str, outwards: np.ndarray, radius: float
) -> None:
    up = np.array([0.0, 0.0, 1.0])
    along = _HANDLE_LENGTH / 2 * np.cross(outwards, up)
    middle, edge = radius * outwards, (radius - _ROOM) * outwards
    ends = [middle - along, middle + along]
    bars = [ends, *([edge + end - middle, end] for end in ends)]
    for start, end in bars:
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        fromto = (*start, *end)
        add_visual(body, capsule, size=(BAR / 2,), rgba=_BAR_RGBA, fromto=fromto)
    inwards = -np.cos(_SLOPE) * outwards - np.sin(_SLOPE) * up + 0.0
    upwards = -np.sin(_SLOPE) * outwards + np.cos(_SLOPE) * up + 0.0
    axes = np.stack([np.cross(upwards, inwards), upwards, inwards], axis=1)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    body.add_site(name=name, pos=middle, quat=quat)
