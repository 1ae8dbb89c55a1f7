"""A small cube that can be gripped at its centre."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import begin

_RGBA = (0.90, 0.45, 0.13, 1.0)

# A grip holds the cube at a point and leaves its turning free. This damping (N m s/rad
# about the axes, N s/m along them) stops a turn of the small cube within half a second
# and hardly slows its fall.
_DAMPING = 1e-4


def cube(
    size: float = 0.04,
    mass: float = 0.05,
    *,
    rgba: tuple[float, float, float, float] = _RGBA,
) -> mujoco.MjSpec:
    """Return a cube that moves freely.

    The body `cube` and its site `centre` have their origin in the cube's centre. One
    geom is seen and collides.

    Args:
      size: edge length, metres.
      mass: in kg.
      rgba: its colour.

    Raises:
      TypeError: if one is not a number.
      ValueError: if one is out of bounds.
    """
    check_number("size", size, at_least=0.001, at_most=10.0)
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    spec, body = begin("cube")
    body.add_joint(type=mujoco.mjtJoint.mjJNT_FREE, name="free", damping=_DAMPING)
    box, half = mujoco.mjtGeom.mjGEOM_BOX, [size / 2] * 3
    body.add_geom(name="cube", type=box, size=half, rgba=rgba, mass=mass, group=2)
    body.add_site(name="centre")
    return spec
