"""A ball that rolls."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import begin

RADIUS = 0.04  # m


def ball(mass: float = 0.02) -> mujoco.MjSpec:
    """Return a ball of 4 cm radius that moves freely and rolls.

    The body `ball` and its site `ball` have their origin in the ball's centre. Its
    friction takes precedence over that of what it rolls on: sliding 1.0, rolling
    0.003 m, so on a slope of less than 0.003 / 0.04 it stays where it is.

    Args:
      mass: in kg.

    Raises:
      TypeError: if the mass is not a number.
      ValueError: if it is out of bounds.
    """
    check_number("mass", mass, at_least=1e-6, at_most=1e4)
    spec, body = begin("ball")
    spec.add_texture(
        name="patches",
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.93, 0.45, 0.12],
        rgb2=[0.98, 0.92, 0.84],
        width=64,
        height=64,
    )
    patches = spec.add_material(name="patches")
    patches.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "patches"
    body.add_freejoint(name="free")
    body.add_geom(
        name="ball",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(RADIUS, 0, 0),
        mass=mass,
        material="patches",
        condim=6,
        friction=(1.0, 0.003, 0.003),
        priority=1,
        group=2,
    )
    body.add_site(name="ball")
    return spec
