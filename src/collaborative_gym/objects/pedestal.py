"""Sawyer's pedestal: a black column on a four-footed base, its controller behind."""

import itertools

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual

_BLACK = (0.06, 0.06, 0.065, 1.0)
_GREY = (0.14, 0.14, 0.15, 1.0)

_BASE_CENTRE_X = -0.12  # metres; the base reaches back under the cabinet
_BASE_TOP = 0.13  # metres above the floor; column and cabinet stand on it
_COLUMN_RADIUS = 0.11  # metres
_CABINET_SIZE = (0.12, 0.19, 0.27)  # half lengths, metres
_CABINET_X = -0.26  # metres


def pedestal(height: float) -> mujoco.MjSpec:
    """Return a fixed pedestal that carries an arm at a given height.

    The body `pedestal` has its origin on the floor below the arm's mounting plate, z up
    and x forward like the arm's own base; the controller cabinet stands at -x. Shapes
    and sizes are our choice, after the look of Rethink Robotics' pedestal.

    Args:
      height: z of the mounting plate's top face, metres above the floor. Sawyer's own
        pedestal has 0.9149 (the mesh offset in sawyer_description).

    Raises:
      TypeError: if `height` is not a number.
      ValueError: if it is below 0.7, where the cabinet would stand in the arm's way, or
        above 100.
    """
    check_number("height", height, at_least=0.7, at_most=100.0)

    spec = mujoco.MjSpec()
    spec.modelname = "pedestal"
    body = spec.worldbody.add_body(name="pedestal")
    _add_base(body)
    _add_column(body, height)
    _add_cabinet(body)
    return spec


def _add_base(body: mujoco.MjsBody) -> None:
    """Add the base plate and its four splayed feet, each on a caster."""
    hub = (_BASE_CENTRE_X, 0.0, 0.1)
    add_visual(
        body, mujoco.mjtGeom.mjGEOM_BOX, size=(0.25, 0.2, 0.03), rgba=_BLACK, pos=hub
    )
    for x_sign, y_sign in itertools.product((-1, 1), (-1, 1)):
        x, y = _BASE_CENTRE_X + 0.34 * x_sign, 0.3 * y_sign
        shoulder = (_BASE_CENTRE_X + 0.2 * x_sign, 0.15 * y_sign, 0.1)
        add_visual(
            body,
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(0.032,),
            rgba=_BLACK,
            fromto=(*shoulder, x, y, 0.1),
        )
        add_visual(
            body,
            mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=(0.04,),
            fromto=(x, y - 0.014, 0.04, x, y + 0.014, 0.04),
            rgba=_GREY,
        )


def _add_column(body: mujoco.MjsBody, height: float) -> None:
    """Add the column and the mounting plate on top of it."""
    collar, plate = height - 0.05, height - 0.02
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    for radius, bottom, top, rgba in (
        (_COLUMN_RADIUS, _BASE_TOP - 0.01, collar, _BLACK),
        (_COLUMN_RADIUS - 0.01, collar, plate, _GREY),
        (_COLUMN_RADIUS + 0.015, plate, height, _BLACK),
    ):
        fromto = (0.0, 0.0, bottom, 0.0, 0.0, top)
        add_visual(body, cylinder, size=(radius,), rgba=rgba, fromto=fromto)
    body.add_geom(
        name="pedestal_column_collision",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(_COLUMN_RADIUS, _COLUMN_RADIUS, height / 2),
        pos=(0.0, 0.0, height / 2),
        group=3,
        mass=0.0,
    )


def _add_cabinet(body: mujoco.MjsBody) -> None:
    """Add the controller cabinet, with its door on the back."""
    depth, width, tall = _CABINET_SIZE
    middle = _BASE_TOP + tall
    box = mujoco.mjtGeom.mjGEOM_BOX
    add_visual(
        body, box, size=_CABINET_SIZE, rgba=_BLACK, pos=(_CABINET_X, 0.0, middle)
    )
    add_visual(
        body,
        box,
        size=(0.005, width - 0.025, tall - 0.025),
        pos=(_CABINET_X - depth, 0.0, middle),
        rgba=_GREY,
    )
    top = _BASE_TOP + 2 * tall
    body.add_geom(
        name="pedestal_cabinet_collision",
        type=box,
        size=(depth, width, top / 2),
        pos=(_CABINET_X, 0.0, top / 2),
        group=3,
        mass=0.0,
    )
