"""An air hockey table."""

from collections.abc import Sequence

import mujoco

from collaborative_gym.objects.visual import add_visual, begin

HALF_LENGTH = 0.55  # from the middle to the cushion behind a goal's line, in m
HEIGHT = 0.6  # of the ice above the floor, in m
MOUNT = 0.2  # of the blocks on which arms stand, above the ice, in m
_RAIL = 0.09  # m, height of the cushions above the ice
_SLOT = 0.055  # m, height of a goal
_POCKET = 0.2  # m, depth of a goal
_END = 0.35  # m, of the deck behind a goal's line
_BLOCK = 0.1  # m, half the width of what an arm stands on
_THICK = 0.15  # m, of cushions: a fast puck is in them before it turns round
_FRICTION = (0.1, 0.005, 0.0001)
_ICE = (0.93, 0.95, 0.98, 1.0)
_DECK = (0.16, 0.27, 0.42, 1.0)
_LINE = (0.75, 0.15, 0.15, 1.0)
_GOALS = {-1.0: (0.85, 0.12, 0.1, 1.0), 1.0: (0.1, 0.25, 0.9, 1.0)}  # by x
_DARK = (0.12, 0.12, 0.13, 1.0)


_Three = tuple[float, float, float]
_BOX = mujoco.mjtGeom.mjGEOM_BOX


def rink(
    half_width: float, half_goal: float, *, mounts: Sequence[tuple[float, float]] = ()
) -> mujoco.MjSpec:
    """Return a table with a sunken field of ice, 1.1 m long, and a goal at both ends.

    The origin is on the ice in the middle; x runs from goal to goal. The body `rink`
    has the ice, the cushions and the pockets behind the goals, in which a puck stays;
    the body `lintels` has the bars above the goals, which keep mallets out of them and
    under which pucks pass (exclude their contacts).

    Args:
      half_width: of the field, in m.
      half_goal: half of a goal's width, in m.
      mounts: x and y of the blocks on which arms stand, in m.
    """
    spec, body = begin("rink")
    lintels = spec.worldbody.add_body(name="lintels")
    long, wide, half = HALF_LENGTH + _END, half_width + _THICK, _RAIL / 2
    _box(body, (0, 0, -0.03), (long, wide, 0.03), rgba=_ICE)
    for side in (-1.0, 1.0):
        place = (0, side * (half_width + _THICK / 2), half)
        _box(body, place, (long, _THICK / 2, half))
        x, beside = side * (HALF_LENGTH + _END / 2), (half_width - half_goal) / 2
        for across in (-1.0, 1.0):
            place = (x, across * (half_goal + beside), half)
            _box(body, place, (_END / 2, beside, half))
        # What comes in stays in: stiff, and damped without a bounce.
        deep = (_END - _POCKET) / 2
        place = (side * (HALF_LENGTH + _POCKET) + side * deep, 0, half)
        _box(body, place, (deep, half_goal, half), rgba=_DARK, priority=2, condim=1)
        bar = (_RAIL - _SLOT) / 2
        place = (side * (HALF_LENGTH + _POCKET / 2), 0, _RAIL - bar)
        _box(lintels, place, (_POCKET / 2, half_goal, bar), rgba=_GOALS[side])
        size, place = (0.05, 0.8 * wide, HEIGHT / 2 - 0.03), (0.8 * side * long, 0)
        add_visual(body, _BOX, size=size, pos=(*place, -HEIGHT / 2 - 0.03), rgba=_DARK)
    for place in mounts:
        tall = (MOUNT - _RAIL) / 2
        size, pos = (_BLOCK, _BLOCK, tall), (*place, _RAIL + tall)
        add_visual(body, _BOX, size=size, pos=pos, rgba=_DARK)
    _paint(body, half_width, half_goal)
    return spec


def _box(
    body: mujoco.MjsBody, place: _Three, size: _Three, *, rgba=_DECK, **contacts: int
) -> None:
    shape = {"type": _BOX, "pos": place, "size": size, "rgba": rgba, "group": 2}
    body.add_geom(**shape, friction=_FRICTION, **contacts)


def _paint(body: mujoco.MjsBody, half_width: float, half_goal: float) -> None:
    thin = 0.0005
    add_visual(body, _BOX, size=(0.006, half_width, thin), pos=(0, 0, 0), rgba=_LINE)
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    add_visual(body, cylinder, size=(0.012, 2 * thin), rgba=_LINE)
    for side in (-1.0, 1.0):
        size, place = (0.015, half_goal, thin), (side * (HALF_LENGTH - 0.015), 0, 0)
        add_visual(body, _BOX, size=size, pos=place, rgba=_GOALS[side])
