"""A mallet to hit a puck with."""

import mujoco

from collaborative_gym.objects.visual import add_visual, begin

RADIUS = 0.05  # of the disc that hits the puck, in m
HEIGHT = 0.16  # from the disc's lower face to the middle of the hand, in m
GRIP = 0.03  # width of the handle where a hand holds it, in m
_DISC = 0.10  # m, height of the disc
_MASS = 0.15  # kg
_FRICTION = (0.1, 0.005, 0.0001)  # of felt; the greater friction of a pair counts


def mallet(rgba: tuple[float, float, float, float]) -> mujoco.MjSpec:
    """Return a mallet: a disc of 5 cm radius below a handle, without joints.

    The body `mallet` has its origin in the middle of the hand that holds it and z down,
    as a tcp has that points down. The site `mallet` is in its lower face's middle.
    """
    spec, body = begin("mallet")
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(
        name="disc",
        type=cylinder,
        size=(RADIUS, _DISC / 2, 0),
        pos=(0, 0, HEIGHT - _DISC / 2),
        mass=_MASS,
        friction=_FRICTION,
        rgba=rgba,
        group=2,
    )
    size, grey = (GRIP / 2, (HEIGHT - _DISC) / 2), (0.2, 0.2, 0.22, 1.0)
    add_visual(body, cylinder, size=size, rgba=grey, pos=(0, 0, size[1]))
    body.add_site(name="mallet", pos=(0, 0, HEIGHT))
    return spec
