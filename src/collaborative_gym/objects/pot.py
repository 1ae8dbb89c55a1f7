"""A cooking pot with two bar handles."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

_SIDE = 0.12  # m, from the original environment
_MOST_BALANCE = 0.059  # m; the contents are at least 2 mm wide
_HANDLE_SIZE = (0.06, 0.01, 0.01)  # m, half lengths, from the original environment
_HANDLE_Z = 0.05  # m above the pot's centre
_GRIP_Y = 0.14  # m from the pot's centre to where a handle is gripped

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
    spec, body = begin("pot")
    # Real fingers would not let the pot swing freely on its handles.
    body.add_freejoint().damping = (_SWING_DAMPING * mass, 0.0, 0.0)
    body.add_site(name="pot")
    box, half = mujoco.mjtGeom.mjGEOM_BOX, _SIDE / 2
    # Polished steel slides on wood at 0.2 to 0.6 times its weight.
    body.add_geom(
        name="pot_collision",
        type=box,
        size=[half] * 3,
        mass=0.0,
        friction=(0.4, 0.005, 0.0001),
        priority=1,
        group=3,
    )
    # The contents are a cube that stops at the nearer wall.
    body.add_geom(
        name="contents",
        type=box,
        size=[half - abs(balance)] * 3,
        pos=(0.0, balance, 0.0),
        mass=mass,
        contype=0,
        conaffinity=0,
        group=4,
    )
    for name, side in (("handle_1", -1.0), ("handle_2", 1.0)):
        _add_handle(body, name, side)
    _add_vessel(body)
    return spec


def _add_handle(body: mujoco.MjsBody, name: str, side: float) -> None:
    """Add a bar that two struts carry, and the site where it is gripped."""
    capsule, middle = mujoco.mjtGeom.mjGEOM_CAPSULE, (0.0, side * _GRIP_Y, _HANDLE_Z)
    body.add_site(name=name, pos=middle)
    long, thick = _HANDLE_SIZE[0] - 0.01, 0.013  # seen from a few metres
    ends = (*(-long, *middle[1:]), *(long, *middle[1:]))
    add_visual(body, capsule, size=(thick,), rgba=_ORANGE, fromto=ends)
    for x in (-long, long):
        strut = (x, side * 0.03, _HANDLE_Z - 0.012, x, *middle[1:])
        add_visual(body, capsule, size=(0.009,), rgba=_ORANGE, fromto=strut)


def _add_vessel(body: mujoco.MjsBody) -> None:
    """Add what is seen between the handles: steel wall, rim and a red lid."""
    cylinder, half = mujoco.mjtGeom.mjGEOM_CYLINDER, _SIDE / 2
    ellipsoid, dome = mujoco.mjtGeom.mjGEOM_ELLIPSOID, half - 0.002
    for shape, size, z, rgba in (
        (cylinder, (half, half - 0.003), -0.003, _STEEL),
        (cylinder, (half + 0.004, 0.003), half - 0.006, _RIM),
        (ellipsoid, (dome, dome, 0.018), half - 0.004, _LID),
        (ellipsoid, (0.011, 0.011, 0.009), half + 0.02, _BLACK),
    ):
        add_visual(body, shape, size=size, rgba=rgba, pos=(0.0, 0.0, z))
