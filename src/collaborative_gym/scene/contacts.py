"""Pairs that can touch, and sensors of the depth and force of their contacts."""

from collections.abc import Collection
from itertools import combinations, product

import mujoco
import numpy as np

from collaborative_gym.scene.collisions import has_joints

DEPTHS = "arms", "objects", "furniture"
"""Kinds of contacts: of two arms; of a loose thing with an arm, with what is fixed or
with another loose thing; of an arm with what is fixed."""

KINDS = *DEPTHS, "own"
"""All kinds of contacts; the last is of links of one arm that are no neighbours."""

Place = tuple[mujoco.mjtObj, str]
"""A body, or a tree of bodies, as contact sensors name them."""

_TREE, _BODY = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_BODY
DEEPEST = 1 << mujoco.mjtConDataField.mjCONDATA_DIST.value, 1, 1
_FORCE = 1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value
_NET, EACH = (_FORCE, 3, 1), (_FORCE, 0, 8)
"""What a contact sensor measures, and how it sums up many contacts: the distance of the
deepest (`mindist`), the force of all (`netforce`), or the force of each of eight, of
which the first component is along the contact's normal."""


def contact_pairs(
    spec: mujoco.MjSpec, agents: Collection[str]
) -> dict[str, list[tuple[Place, Place]]]:
    """Return the pairs of bodies that can touch, by kind. Each gets a name."""
    arms, loose, fixed = [], [], []
    for i, body in enumerate(spec.bodies):
        body.name = body.name or f"body {i}"
        if body.name.split("/")[0] in agents:
            if body.parent == spec.worldbody:
                arms.append((_TREE, body.name))
        elif not has_joints(body):
            if any(geom.contype for geom in body.geoms):
                fixed.append((_BODY, body.name))
        elif not has_joints(body.parent):
            loose.append((_TREE, body.name))
    return {
        "arms": list(combinations(arms, 2)),
        "objects": [*product(loose, arms + fixed), *combinations(loose, 2)],
        "furniture": list(product(arms, fixed)),
        "own": [(arm, arm) for arm in arms],
    }


def add_depth_sensors(spec: mujoco.MjSpec, agents: Collection[str]) -> None:
    """Let `depth_sensors` read how deep contacts are."""
    for kind, pairs in contact_pairs(spec, agents).items():
        for i, pair in enumerate(pairs):
            add_contact_sensor(spec, f"{kind} deep {i}", *pair, fields=DEEPEST)


def add_contact_sensor(
    spec: mujoco.MjSpec,
    name: str,
    one: Place,
    other: Place = (mujoco.mjtObj.mjOBJ_UNKNOWN, ""),
    *,
    fields: tuple[int, int, int] = _NET,
) -> None:
    """Add a sensor of a place's contacts with another, or with all: their net force."""
    spec.add_sensor(
        name=name,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=one[0],
        objname=one[1],
        reftype=other[0],
        refname=other[1],
        intprm=fields,
    )


def depth_sensors(
    model: mujoco.MjModel, kinds: Collection[str] = DEPTHS
) -> dict[str, np.ndarray]:
    """Return the ids of the sensors of minus the depth of contacts, by kind."""
    names = np.array([model.sensor(i).name for i in range(model.nsensor)], str)
    return {k: np.flatnonzero(np.char.startswith(names, f"{k} deep")) for k in kinds}
