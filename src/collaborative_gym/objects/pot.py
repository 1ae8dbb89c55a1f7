"""A cooking pot with two bar handles, and a round one with a handle for each arm."""

import mujoco
import numpy as np

from collaborative_gym.errors import check_count, check_number
from collaborative_gym.objects.visual import add_visual, begin

_SIDE = 0.12  # m, from the original environment
_MOST_BALANCE = 0.059  # m; the contents are at least 2 mm wide
_HANDLE_SIZE = (0.06, 0.01, 0.01)  # m, half lengths, from the original environment
_HANDLE_Z = 0.05  # m above the pot's centre
_GRIP_Y = 0.14  # m from the pot's centre to where a handle is gripped
_HANDLE_SPACING = 0.21  # m along the circle of handles; hands beside one another fit
_GRIP_ROOM = 0.08  # m between wall and grip; with two handles as in the original
_LEAST_CONTENTS = 0.01  # m, least radius of what is in a round pot
_SWING_DAMPING = 0.05  # N m s/rad per kg, our choice; as a drag it is negligible

GRIP_RADIUS = float((_GRIP_Y**2 + _HANDLE_Z**2) ** 0.5)
"""Distance from the pot's centre to a grip site, in m."""

HANDLE_WIDTH = 2 * _HANDLE_SIZE[1]
"""Thickness of a handle, in m."""

_STEEL = (0.72, 0.74, 0.77, 1.0)
_RIM = (0.55, 0.57, 0.60, 1.0)
_LID = (0.80, 0.22, 0.16, 1.0)
_BLACK = (0.10, 0.10, 0.11, 1.0)
_ORANGE = (0.95, 0.50, 0.08, 1.0)


def handle_directions(count: int) -> np.ndarray:
    """Return the directions from a pot's middle to its handles, (count, 3).

    They are evenly around the pot; the first is -y.
    """
    angles = 2.0 * np.pi * np.arange(count) / count - np.pi / 2
    flat = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    return flat.round(12) + 0.0


def bar_directions(count: int) -> np.ndarray:
    """Return directions along the handles' bars, (count, 3), each with x from 0 up."""
    x, y, _ = handle_directions(count).T
    along = np.stack([-y, x, 0.0 * x], axis=1)
    return np.where(along[:, :1] < 0.0, -along, along) + 0.0


def grip_radius(count: int) -> float:
    """Return the distance of so many handles from a pot's axis, in m."""
    return max(_GRIP_Y, _HANDLE_SPACING * count / (2.0 * np.pi))


def handle_places(count: int) -> np.ndarray:
    """Return where handles are gripped, from a pot's middle, (count, 3), in m."""
    return grip_radius(count) * handle_directions(count) + (0.0, 0.0, _HANDLE_Z)


def greatest_balance(count: int) -> float:
    """Return how far from a round pot's axis its centre of mass may lie, in m."""
    return grip_radius(count) - _GRIP_ROOM - _LEAST_CONTENTS


def pot(mass: float, balance: float = 0.0) -> mujoco.MjSpec:
    """Return a pot that is free to move, with a handle at either side along y.

    The body `pot` has its origin in the middle of a cube of 0.12 m. Sites `pot` (the
    middle), `handle_1` (at -y) and `handle_2` (at +y) mark it; each handle site is
    0.14 m from the middle and 0.05 m up, on a bar along x. The cube collides (group 3);
    the round pot that is seen is in group 2. The handles do not collide, because a
    constraint holds what grips them.

    Args:
      mass: in kg.
      balance: y of the centre of mass, in m: the contents may lie to one side.

    Raises:
      TypeError: if one is not a number.
      ValueError: if the mass is out of bounds, or `balance` is outside the pot.
    """
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    check_number("balance", balance, at_least=-_MOST_BALANCE, at_most=_MOST_BALANCE)
    box, half = mujoco.mjtGeom.mjGEOM_BOX, _SIDE / 2
    # The contents are a cube that stops at the nearer wall.
    spec, body = _begin_pot(
        mass,
        (0.0, balance, 0.0),
        shape=box,
        sizes=([half] * 3, [half - abs(balance)] * 3),
    )
    for i, direction in enumerate(handle_directions(2)):
        _add_handle(body, f"handle_{i + 1}", direction, _GRIP_Y)
    _add_vessel(body, half)
    return spec


def ring_pot(
    count: int, mass: float, *, balance: tuple[float, float] = (0.0, 0.0)
) -> mujoco.MjSpec:
    """Return a round pot that is free to move, with handles evenly around it.

    The body `pot` has its origin in the middle of a cylinder 0.12 m high. Sites `pot`
    (the middle) and `handle_1` (at -y) and so on, counterclockwise, mark it; they lie
    at `handle_places`, with the pot's axes. All else is as in `pot`.

    Args:
      count: number of handles.
      mass: in kg.
      balance: x and y of the centre of mass, in m.

    Raises:
      TypeError: if one is not a number.
      ValueError: if one is out of bounds, or `balance` is outside the pot.
    """
    check_count("count", count, 2, 100)
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    most, radius = greatest_balance(count), grip_radius(count)
    aside = check_number("the length of balance", float(np.hypot(*balance)))
    check_number("the length of balance", aside, at_least=0.0, at_most=most + 1e-9)
    wall, half = radius - _GRIP_ROOM, _SIDE / 2
    sizes = [wall, half, 0.0], [wall - aside, half, 0.0]
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec, body = _begin_pot(mass, (*balance, 0.0), shape=cylinder, sizes=sizes)
    for i, direction in enumerate(handle_directions(count)):
        _add_handle(body, f"handle_{i + 1}", direction, radius)
    _add_vessel(body, wall)
    return spec


def _begin_pot(
    mass: float,
    centre: tuple[float, float, float],
    *,
    shape: mujoco.mjtGeom,
    sizes: tuple[list[float], list[float]],
) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    spec, body = begin("pot")
    # Real fingers would not let the pot swing freely on its handles.
    body.add_freejoint().damping = (_SWING_DAMPING * mass, 0.0, 0.0)
    body.add_site(name="pot")
    # Polished steel slides on wood at 0.2 to 0.6 times its weight.
    steel = {"friction": (0.4, 0.005, 0.0001), "priority": 1, "mass": 0.0, "group": 3}
    body.add_geom(name="pot_collision", type=shape, size=sizes[0], **steel)
    inside = {"contype": 0, "conaffinity": 0, "pos": centre, "mass": mass, "group": 4}
    body.add_geom(name="contents", type=shape, size=sizes[1], **inside)
    return spec, body


def _add_handle(
    body: mujoco.MjsBody, name: str, direction: np.ndarray, radius: float
) -> None:
    capsule, up = mujoco.mjtGeom.mjGEOM_CAPSULE, np.array([0.0, 0.0, 1.0])
    middle = radius * direction + _HANDLE_Z * up
    body.add_site(name=name, pos=middle)
    long, thick = _HANDLE_SIZE[0] - 0.01, 0.013  # seen from a few metres
    along, inside = np.cross(up, direction), (radius - _GRIP_Y + 0.03) * direction
    ends = [middle - long * along, middle + long * along]
    add_visual(body, capsule, size=(thick,), rgba=_ORANGE, fromto=(*ends[0], *ends[1]))
    for end in ends:
        foot = end - middle + inside + (_HANDLE_Z - 0.012) * up
        add_visual(body, capsule, size=(0.009,), rgba=_ORANGE, fromto=(*foot, *end))


def _add_vessel(body: mujoco.MjsBody, wall: float) -> None:
    cylinder, half = mujoco.mjtGeom.mjGEOM_CYLINDER, _SIDE / 2
    ellipsoid, dome = mujoco.mjtGeom.mjGEOM_ELLIPSOID, wall - 0.002
    for shape, size, z, rgba in (
        (cylinder, (wall, half - 0.003), -0.003, _STEEL),
        (cylinder, (wall + 0.004, 0.003), half - 0.006, _RIM),
        (ellipsoid, (dome, dome, 0.018), half - 0.004, _LID),
        (ellipsoid, (0.011, 0.011, 0.009), half + 0.02, _BLACK),
    ):
        add_visual(body, shape, size=size, rgba=rgba, pos=(0.0, 0.0, z))
