"""A conveyor belt that slides along, and totes beside it."""

import mujoco
import numpy as np

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

_THICKNESS = 0.03  # m
_MASS = 1e5  # kg; what lies on the belt, and hands that press on it, do not slow it
_STRIPE = 0.5  # m between stripes that show how it moves
_RGBA = (0.16, 0.17, 0.18, 1.0)
_STRIPE_RGBA = (0.32, 0.33, 0.35, 1.0)

TOTE = 0.13
"""Half the inner width of a tote, in m."""

WALL = 0.1
"""Height of a tote's rim above its floor, in m."""

_WALL_THICKNESS = 0.008  # m


def belt(length: float, width: float) -> mujoco.MjSpec:
    """Return a belt that slides along x without friction, its origin in the top.

    The body `belt` has the joint `slide`. Once it has a speed, it keeps it.

    Args:
      length: in m, from the origin as far to either side.
      width: in m.

    Raises:
      TypeError: if one is not a number.
      ValueError: if one is out of bounds.
    """
    check_number("length", length, at_least=0.1, at_most=1000.0)
    check_number("width", width, at_least=0.1, at_most=100.0)
    spec, body = begin("belt")
    box, z = mujoco.mjtGeom.mjGEOM_BOX, -_THICKNESS / 2
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    body.add_joint(name="slide", type=slide, axis=(1.0, 0.0, 0.0))
    size = (length / 2, width / 2, _THICKNESS / 2)
    body.add_geom(
        name="belt", type=box, size=size, pos=(0, 0, z), mass=_MASS, rgba=_RGBA, group=2
    )
    for x in np.arange(-length / 2 + _STRIPE / 2, length / 2, _STRIPE):
        half = (0.01, width / 2, 0.0005)
        add_visual(body, box, size=half, pos=(float(x), 0, 0), rgba=_STRIPE_RGBA)
    return spec


def tote(rgba: tuple[float, float, float, float]) -> mujoco.MjSpec:
    """Return an open box that stands still, its origin in the middle of its floor.

    It is `TOTE` wide to either side along x and y, and its rim `WALL` above its floor.

    Args:
      rgba: its colour.
    """
    spec, body = begin("tote")
    box, thick, out = mujoco.mjtGeom.mjGEOM_BOX, _WALL_THICKNESS / 2, TOTE
    walls = [((out, out, thick), (0.0, 0.0, -thick))]
    for sign in (-1.0, 1.0):
        aside, half = sign * (out + thick), out + 2 * thick
        walls += [
            ((thick, half, WALL / 2), (aside, 0.0, WALL / 2)),
            ((half, thick, WALL / 2), (0.0, aside, WALL / 2)),
        ]
    for i, (size, at) in enumerate(walls):
        body.add_geom(name=f"tote_{i}", type=box, size=size, pos=at, rgba=rgba, group=2)
    return spec
