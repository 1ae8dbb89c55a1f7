"""A four-legged table and a round one."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin

_TOP_THICKNESS = 0.03  # m, our choice
_LEG_RADIUS = 0.025  # m, our choice
_LEG_INSET = 0.05  # m from the edge of the top to a leg's axis, our choice
_TOP_RGBA = (0.78, 0.74, 0.68, 1.0)
_LEG_RGBA = (0.52, 0.55, 0.57, 1.0)


def table(
    length: float = 0.6, width: float = 1.2, *, height: float = 0.64
) -> mujoco.MjSpec:
    """Return a table with a rectangular top on four round legs.

    The origin lies on the floor under the centre of the top; x runs along the
    length, y along the width, z up. The table has one body, `table`, without
    joints. Its top collides as the geom `table_top_collision` (group 3), and so do
    the legs that are seen (group 2).

    Args:
      length: extent of the top along x, metres.
      width: extent of the top along y, metres.
      height: z of the top's upper face, metres above the floor.

    Raises:
      TypeError: if one is not a number.
      ValueError: if the top is too small or low for the legs, or longer than 100 m.
    """
    for name, given in (("length", length), ("width", width), ("height", height)):
        check_number(name, given, at_most=100.0)
    shortest_side = 2 * (_LEG_INSET + _LEG_RADIUS)
    if min(length, width) < shortest_side or height <= _TOP_THICKNESS:
        raise ValueError(
            f"table of {length} x {width} x {height} m; length and width must be at "
            f"least {shortest_side} m and height more than {_TOP_THICKNESS} m"
        )
    spec, body = begin("table")
    box, size = mujoco.mjtGeom.mjGEOM_BOX, (length / 2, width / 2, _TOP_THICKNESS / 2)
    pos = (0, 0, height - _TOP_THICKNESS / 2)
    body.add_geom(name="table_top_collision", type=box, size=size, pos=pos, group=3)
    add_visual(body, box, size=size, pos=pos, rgba=_TOP_RGBA)
    middle, capsule = (height - _TOP_THICKNESS) / 2, mujoco.mjtGeom.mjGEOM_CAPSULE
    size, seen = (_LEG_RADIUS, middle - _LEG_RADIUS, 0), {"rgba": _LEG_RGBA, "group": 2}
    for x in (_LEG_INSET - length / 2, length / 2 - _LEG_INSET):
        for y in (_LEG_INSET - width / 2, width / 2 - _LEG_INSET):
            body.add_geom(type=capsule, size=size, pos=(x, y, middle), **seen)
    return spec


def round_table(radius: float, *, height: float = 0.64) -> mujoco.MjSpec:
    """Return a table with a round top on one column, its origin as that of `table`.

    Args:
      radius: of the top, metres.
      height: z of the top's upper face, metres above the floor.

    Raises:
      TypeError: if one is not a number.
      ValueError: if the top is too small or too low for the column.
    """
    thick, column = _TOP_THICKNESS, 2 * _LEG_RADIUS
    check_number("radius", radius, at_least=column, at_most=100.0)
    check_number("height", height, at_least=2 * thick, at_most=100.0)
    spec, body = begin("table")
    for name, size, z, rgba in (
        ("top", (radius, thick / 2), height - thick / 2, _TOP_RGBA),
        ("column", (column, height / 2 - thick / 2), (height - thick) / 2, _LEG_RGBA),
        ("foot", (radius, thick / 2), thick / 2, _LEG_RGBA),
    ):
        kind, pos = mujoco.mjtGeom.mjGEOM_CYLINDER, (0, 0, z)
        collision = f"table_{name}_collision"
        body.add_geom(name=collision, type=kind, size=(*size, 0), pos=pos, group=3)
        add_visual(body, kind, size=size, pos=pos, rgba=rgba)
    return spec
