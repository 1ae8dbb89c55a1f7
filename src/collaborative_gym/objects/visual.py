"""Shapes that are there to be seen."""

import mujoco


def add_visual(
    body: mujoco.MjsBody,
    shape: mujoco.mjtGeom,
    *,
    size: tuple[float, ...],
    rgba: tuple[float, float, float, float],
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0),
    fromto: tuple[float, ...] | None = None,
) -> None:
    """Add a massless shape without contact, placed by `pos` or from end to end."""
    geom = body.add_geom(
        type=shape,
        size=(*size, 0.0, 0.0)[:3],
        pos=pos,
        rgba=rgba,
        contype=0,
        conaffinity=0,
        group=2,
        mass=0.0,
    )
    if fromto is not None:
        geom.fromto = fromto
