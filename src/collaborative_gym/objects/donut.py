"""A square ring, the "donut"."""

import mujoco

from collaborative_gym.objects.visual import begin

OUTER = 0.24  # outer side of the ring, in m
BAR = 0.04  # width of the ring's bars, in m
HOLE = OUTER - 2 * BAR  # side of the square hole, in m
THICKNESS = 0.02  # thickness of the ring along its normal, in m
_MASS = 0.1  # kg
_RGBA = (0.10, 0.32, 0.75, 1.0)


def donut() -> mujoco.MjSpec:
    """Return a square ring of four bars, 0.1 kg, with a hole that lets things through.

    The origin lies at the centre of the hole, x and y run along the bars, z along the
    normal. The ring has one body and, at the origin, one site, both named `donut`, and
    no joint. What is seen is what collides.
    """
    spec, body = begin("donut")
    body.add_site(name="donut")
    middle = (OUTER - BAR) / 2
    long, short, half = OUTER / 2, HOLE / 2, THICKNESS / 2
    bars = {
        "left": ((-middle, 0, 0), (BAR / 2, long, half)),
        "right": ((middle, 0, 0), (BAR / 2, long, half)),
        "rear": ((0, -middle, 0), (short, BAR / 2, half)),
        "front": ((0, middle, 0), (short, BAR / 2, half)),
    }
    box, area = mujoco.mjtGeom.mjGEOM_BOX, OUTER**2 - HOLE**2
    for name, (at, size) in bars.items():
        mass = _MASS * 4 * size[0] * size[1] / area
        body.add_geom(
            name=name, type=box, pos=at, size=size, mass=mass, rgba=_RGBA, group=2
        )
    return spec
