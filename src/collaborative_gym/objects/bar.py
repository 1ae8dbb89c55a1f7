"""A bar with a knob at each end, and the line to which it is pulled."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

LENGTH = 0.4  # from knob to knob, in m
KNOB = 0.04  # diameter of a knob, in m
KNOBS = ("knob_1", "knob_2")  # sites, at negative and positive y

_RADIUS = 0.0125  # m, of the shaft
_ROOM = 0.07  # m, from a knob to the shaft that collides, for finger tips
_RIBBON = 0.02  # m, half of its width
_RGBA = (0.55, 0.40, 0.24, 1.0)
_KNOB_RGBA = (0.30, 0.32, 0.34, 1.0)
_RIBBON_RGBA = (0.85, 0.12, 0.12, 1.0)


def bar(mass: float = 0.5) -> mujoco.MjSpec:
    """Return a bar that moves freely, 0.4 m from knob to knob along y.

    The body `bar` and its site `bar` have their origin in the bar's middle, where it
    has a red ribbon. The sites `knob_1` (at negative y) and `knob_2` lie in the middles
    of the knobs. Only the shaft collides, up to 0.07 m from the knobs.

    Args:
      mass: in kg, all of it in the shaft.

    Raises:
      TypeError: if the mass is not a number.
      ValueError: if it is out of bounds.
    """
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    spec, body = begin("bar")
    body.add_freejoint()
    shaft = LENGTH / 2 - _ROOM
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    ends, size = (0.0, -shaft, 0.0, 0.0, shaft, 0.0), (_RADIUS, 0.0, 0.0)
    own = {"fromto": ends, "mass": mass, "rgba": _RGBA, "group": 2}
    body.add_geom(name="shaft", type=capsule, size=size, **own)
    body.add_site(name="bar")
    end = LENGTH / 2
    ends = (0.0, -end, 0.0, 0.0, end, 0.0)
    add_visual(body, capsule, size=(0.9 * _RADIUS,), rgba=_RGBA, fromto=ends)
    ribbon = (0.0, -_RIBBON, 0.0, 0.0, _RIBBON, 0.0)
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    size = (1.3 * _RADIUS,)
    add_visual(body, cylinder, size=size, rgba=_RIBBON_RGBA, fromto=ribbon)
    for name, y in zip(KNOBS, (-end, end), strict=True):
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        add_visual(body, sphere, size=(KNOB / 2,), rgba=_KNOB_RGBA, pos=(0, y, 0))
        body.add_site(name=name, pos=(0, y, 0))
    return spec


def line(rgba: tuple[float, float, float, float]) -> mujoco.MjSpec:
    """Return a frame to look through, upright across y, that touches nothing.

    Its origin is in its middle. A bar that is pulled over the line passes there.
    """
    spec, body = begin("line")
    box = mujoco.mjtGeom.mjGEOM_BOX
    add_visual(body, box, size=(0.3, 0.001, 0.3), rgba=(*rgba[:3], 0.15))
    for side in (-0.3, 0.3):
        add_visual(body, box, size=(0.006, 0.006, 0.3), rgba=rgba, pos=(side, 0, 0))
        add_visual(body, box, size=(0.3, 0.006, 0.006), rgba=rgba, pos=(0, 0, side))
    return spec
