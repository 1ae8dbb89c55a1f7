"""A stick."""

import mujoco

from collaborative_gym.objects.visual import begin

LENGTH = 0.2  # length of the stick, in m
SIDE = 0.02  # m, of its square section
_MASS = 0.1  # kg
_RGBA = (0.93, 0.62, 0.12, 1.0)


def stick() -> mujoco.MjSpec:
    """Return a stick of 0.02 x 0.02 x 0.2 m and 0.1 kg.

    The origin lies at its middle, z runs along it. The stick has one body and, at the
    origin, one site, both named `stick`, and no joint. What is seen is what collides.
    """
    spec, body = begin("stick")
    body.add_site(name="stick")
    box, size = mujoco.mjtGeom.mjGEOM_BOX, (SIDE / 2, SIDE / 2, LENGTH / 2)
    body.add_geom(name="stick", type=box, size=size, mass=_MASS, rgba=_RGBA, group=2)
    return spec
