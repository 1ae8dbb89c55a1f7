"""Which shapes collide with which, and how hard."""

from collections.abc import Collection, Iterable
from itertools import product

import mujoco

from collaborative_gym.scene.handles import Grip
from collaborative_gym.timing import SIM_DT

# Collision bits. A pair of geoms collides if a contype bit of one is among the
# conaffinity bits of the other.
_FIXED = 1
_OBJECT = 2
_ROBOT = 4

SOLREF = SIM_DT, 1.0
_SOLIMP = 0.95, 0.99, 0.001, 0.5, 2.0
"""How contacts and stops give way, in MuJoCo's words: they are as stiff as the time
step resolves without a bounce (docs/performance.md has what else was tried)."""

_USUAL = tuple(mujoco.MjSpec().default.geom.solref)

STOP = 0.015
"""How far before the ends of a joint's range its stops are, in rad. A fast joint turns
by 0.03 rad in a physics step before its stop acts."""


def set_collisions(
    spec: mujoco.MjSpec, agents: Collection[str], finger_bodies: Collection[str]
) -> None:
    """Let arms and objects collide with one another and with what is fixed.

    All contacts are alike but those of geoms with a `solref` of their own. Agents are
    the prefixes of the arms' bodies; finger bodies do not collide with objects.
    """
    for geom in spec.geoms:
        if not geom.contype and not geom.conaffinity:
            continue
        if tuple(geom.solref) == _USUAL:
            geom.solref, geom.solimp = SOLREF, _SOLIMP
        if geom.parent.name.split("/")[0] in agents:
            geom.contype, geom.conaffinity = _ROBOT, _FIXED | _ROBOT
            # Fingers close around what they grip; the grip itself is a constraint.
            if geom.parent.name not in finger_bodies:
                geom.conaffinity |= _OBJECT
        elif not has_joints(geom.parent):
            geom.contype, geom.conaffinity = _FIXED, 0
        else:
            geom.contype, geom.conaffinity = _OBJECT, _FIXED | _OBJECT


def exclude_grips(
    spec: mujoco.MjSpec, grips: Iterable[Grip], finger_bodies: Collection[str]
) -> None:
    """Let the fingers of each hand pass through what it can grip, and nothing else."""
    things = {(grip.agent, spec.site(grip.site).parent.name) for grip in grips}
    for finger, (agent, thing) in product(sorted(finger_bodies), sorted(things)):
        if finger.split("/")[0] == agent:
            spec.add_exclude(bodyname1=finger, bodyname2=thing)


def set_stops(joint: mujoco.MjsJoint) -> None:
    """Give an arm's joint stops as stiff as contacts, just before its range's ends."""
    joint.margin = STOP
    joint.solref_limit, joint.solimp_limit = SOLREF, _SOLIMP


def has_joints(body: mujoco.MjsBody) -> bool:
    """Return whether joints let a body move against the world."""
    while body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False
