"""Sawyer's pedestal: a black column on a four-footed base, its controller behind."""

from collections.abc import Sequence
from itertools import product

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

_BLACK = (0.06, 0.06, 0.065, 1.0)
_GREY = (0.14, 0.14, 0.15, 1.0)
_BASE_X = -0.12  # m; the base reaches back under the cabinet
_BASE_TOP = 0.13  # m above the floor; column and cabinet stand on it
_RADIUS = 0.11  # m, of the column
_CABINET = (0.12, 0.19, 0.27)  # m, half lengths
_CABINET_X = -0.26  # m


def pedestal(height: float, *, rgba: Sequence[float] = _BLACK) -> mujoco.MjSpec:
    """Return a fixed pedestal that carries an arm at a given height.

    The body `pedestal` has its origin on the floor below the arm's mounting plate, z up
    and x forward like the arm's own base; the controller cabinet stands at -x. Shapes
    and sizes are our choice, after the look of Rethink Robotics' pedestal.

    Args:
      height: z of the mounting plate's top face, metres above the floor. Sawyer's own
        pedestal has 0.9149 (the mesh offset in sawyer_description).
      rgba: colour of its column.

    Raises:
      TypeError: if `height` is not a number.
      ValueError: if it is above 100 or below 0.7, as the cabinet would be in the way.
    """
    check_number("height", height, at_least=0.7, at_most=100.0)
    spec, body = begin("pedestal")
    _add_base(body)
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    collar, plate = height - 0.05, height - 0.02
    for radius, bottom, top, colour in (
        (_RADIUS, _BASE_TOP - 0.01, collar, rgba),
        (_RADIUS - 0.01, collar, plate, _GREY),
        (_RADIUS + 0.015, plate, height, _BLACK),
    ):
        fromto = (0.0, 0.0, bottom, 0.0, 0.0, top)
        add_visual(body, cylinder, size=(radius,), rgba=colour, fromto=fromto)
    depth, width, tall = _CABINET
    middle, door = _BASE_TOP + tall, (0.005, width - 0.025, tall - 0.025)
    add_visual(body, box, size=_CABINET, rgba=_BLACK, pos=(_CABINET_X, 0.0, middle))
    place = (_CABINET_X - depth, 0.0, middle)
    add_visual(body, box, size=door, rgba=_GREY, pos=place)
    for x, size, top in (
        (0.0, (_RADIUS, _RADIUS), height),
        (_CABINET_X, (depth, width), _BASE_TOP + 2 * tall),
    ):
        half, pos = (*size, top / 2), (x, 0.0, top / 2)
        body.add_geom(type=box, size=half, pos=pos, group=3, mass=0.0)
    return spec


def _add_base(body: mujoco.MjsBody) -> None:
    shapes = mujoco.mjtGeom
    plate, place = (0.25, 0.2, 0.03), (_BASE_X, 0.0, 0.1)
    add_visual(body, shapes.mjGEOM_BOX, size=plate, rgba=_BLACK, pos=place)
    for x_sign, y_sign in product((-1, 1), (-1, 1)):
        x, y = _BASE_X + 0.34 * x_sign, 0.3 * y_sign
        foot = (_BASE_X + 0.2 * x_sign, 0.15 * y_sign, 0.1, x, y, 0.1)
        capsule, wheel = shapes.mjGEOM_CAPSULE, shapes.mjGEOM_CYLINDER
        add_visual(body, capsule, size=(0.032,), rgba=_BLACK, fromto=foot)
        caster = (x, y - 0.014, 0.04, x, y + 0.014, 0.04)
        add_visual(body, wheel, size=(0.04,), rgba=_GREY, fromto=caster)
