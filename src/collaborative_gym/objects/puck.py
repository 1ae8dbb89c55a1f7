"""A puck that glides over the rink on a cushion of air."""

import mujoco

from collaborative_gym.errors import check_number
from collaborative_gym.objects.visual import add_visual, begin
from collaborative_gym.timing import SIM_DT

RADIUS = 0.05  # m
_MASS = 0.1  # kg
_MIDDLE = 0.052  # m above the ice
_DRAG = 0.015  # N s/m: it loses half of its speed in 4.6 s
_WILD_DRAG = 0.004  # N s3/m3
_STIFFNESS = 100.0  # 1/s2; at rest a puck comes out of what it is in, slowly
_RGBA = (0.95, 0.35, 0.10, 1.0)


def puck(restitution: float = 0.8) -> mujoco.MjSpec:
    """Return a puck of 5 cm radius that moves in its plane, without friction.

    The body `puck` and its site `puck` have their origin on the ice. Two joints, `x`
    and `y`, let it go anywhere in the plane; it cannot tip, and a turn would change
    nothing. What collides is a sphere of its radius, for which MuJoCo knows exactly how
    far it is in a box or a cylinder; the disc that is seen is its middle.

    Its contacts take precedence over those of what it touches. They turn the puck round
    within one physics step, to `restitution` times its speed. A contact that acts like
    a spring would take several steps. A fast puck would then be deep in the wall, and
    its speed afterwards would depend on chance. The integrator must take contacts as
    they are before a step (not `discrete`).

    Args:
      restitution: speed after a bounce over the speed before it.

    Raises:
      TypeError: if `restitution` is not a number.
      ValueError: if it is not within 0 and 1.
    """
    check_number("restitution", restitution, at_least=0.0, at_most=1.0)
    spec, body = begin("puck")
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        kind = mujoco.mjtJoint.mjJNT_SLIDE
        body.add_joint(name=name, type=kind, axis=axis, damping=[_DRAG, 0, _WILD_DRAG])
    body.add_geom(
        name="puck",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(RADIUS, 0, 0),
        pos=(0, 0, _MIDDLE),
        mass=_MASS,
        condim=1,
        priority=1,
        solref=(-_STIFFNESS, -(1.0 + restitution) / SIM_DT),
        solimp=(0.9999, 0.9999, 0.001, 0.5, 2.0),
        group=3,
    )
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    add_visual(body, cylinder, size=(RADIUS, 0.02), rgba=_RGBA, pos=(0, 0, 0.025))
    body.add_site(name="puck")
    return spec
