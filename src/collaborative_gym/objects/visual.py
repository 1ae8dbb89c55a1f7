"""Empty models of things, and shapes that are only seen."""

from collections.abc import Sequence

import mujoco
import numpy as np

_CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE

_SEEN = {"contype": 0, "conaffinity": 0, "group": 2, "mass": 0.0}
"""Settings of a geom that is only seen."""

_WIRE = 0.005  # radius of a ring's wire, in m; if it is less, small pictures show dots


def begin(name: str) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """Return a model that has a name, and its body of that name."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    return spec, spec.worldbody.add_body(name=name)


def add_visual(
    body: mujoco.MjsBody,
    shape: mujoco.mjtGeom,
    *,
    size: tuple[float, ...],
    rgba: Sequence[float],
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0),
    fromto: tuple[float, ...] | None = None,
) -> None:
    """Add a massless shape without contact, placed by `pos` or from end to end."""
    geom = body.add_geom(
        type=shape, size=(*size, 0.0, 0.0)[:3], pos=pos, rgba=rgba, **_SEEN
    )
    if fromto is not None:
        geom.fromto = fromto


def add_wire_path(
    body: mujoco.MjsBody, points: np.ndarray, rgba: Sequence[float]
) -> None:
    """Add a closed line through points, (n, 3) in m."""
    for start, end in zip(points, np.roll(points, -1, axis=0), strict=True):
        if np.linalg.norm(end - start) > 1e-6:  # A path may be a point.
            ends = *start, *end
            add_visual(body, _CAPSULE, size=(_WIRE,), rgba=rgba, fromto=ends)


def add_wire_sphere(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, radius: float, rgba: Sequence[float]
) -> None:
    """Add a sphere that hides little: a ring about each axis."""
    mesh = spec.add_mesh(name=f"{body.name} ring", scale=[radius] * 3)
    thick = min(max(_WIRE / radius, 0.025), 0.25)
    mesh.make_supertorus(resolution=40, radius=thick, s=1, t=1)
    half, kind = 0.5**0.5, mujoco.mjtGeom.mjGEOM_MESH
    ring = {"type": kind, "meshname": mesh.name, "rgba": rgba, **_SEEN}
    for turn in ((1.0, 0.0, 0.0, 0.0), (half, half, 0.0, 0.0), (half, 0.0, half, 0.0)):
        body.add_geom(quat=turn, **ring)
