"""Which numbers of an arm's model are finite, and which a machine can have."""

import mujoco
import numpy as np

from collaborative_gym.robots.data import RobotData

_OWNERS = {
    "body": "body",
    "jnt": "joint",
    "dof": "joint",
    "qpos": "joint",
    "qpos0": "joint",
    "geom": "geom",
    "site": "site",
    "mesh": "mesh",
    "eq": "equality",
    "tendon": "tendon",
    "wrap": "tendon",
}
"""What has a number, by the first part of MuJoCo's name of it. What only pictures use,
such as materials, may hold anything."""

_NOT_GIVEN = "aabb", "invweight0", "length0", "M0", "rbound", "subtreemass", "user"
"""Ends of names of what MuJoCo works out of the others, or does not use."""

_SOFTNESS = (-1e4, 1e3, "")
"""A `solref` below minus 1 over the square of the physics time step is unstable."""

_PLACES: dict[str, tuple[float, float, str]] = dict.fromkeys(
    ("body_pos", "body_ipos", "jnt_pos", "geom_pos", "site_pos"), (-10.0, 10.0, " m")
)
"""Bounds of positions, in the frame of what carries a thing."""

_BOUNDS = {
    "body_mass": (0.0, 1e4, " kg"),
    "body_inertia": (0.0, 1e4, " kg m2, with lengths in m"),
    "body_gravcomp": (0.0, 1.0, ""),
    "jnt_stiffness": (0.0, 1e6, " N m/rad or N/m"),
    "jnt_stiffnesspoly": (0.0, 1e6, ""),
    "jnt_margin": (0.0, 10.0, ""),
    "jnt_solref": _SOFTNESS,
    "qpos_spring": (-30.0, 30.0, " rad or m"),
    "dof_armature": (0.0, 1e3, " kg m2 or kg"),
    "dof_damping": (0.0, 1e5, " N m s/rad or N s/m"),
    "dof_dampingpoly": (0.0, 1e5, ""),
    "dof_frictionloss": (0.0, 1e4, " N m or N"),
    "dof_solref": _SOFTNESS,
    "geom_friction": (0.0, 100.0, ""),
    "geom_margin": (0.0, 1.0, " m"),
    "geom_gap": (0.0, 1.0, " m"),
    "geom_solref": _SOFTNESS,
    "geom_adhesion": (0.0, 1e5, ""),
    "geom_surfacevel": (-1e3, 1e3, ""),
    "eq_data": (-1e4, 1e4, ""),
    "eq_solref": _SOFTNESS,
    "tendon_armature": (0.0, 1e3, " kg"),
    "tendon_damping": (0.0, 1e5, " N s/m"),
    "tendon_frictionloss": (0.0, 1e4, " N"),
    "tendon_stiffness": (0.0, 1e6, " N/m"),
    "tendon_solref_lim": _SOFTNESS,
    "tendon_solref_fri": _SOFTNESS,
}
"""Least and greatest values, and their unit. Our choice: a hundred times what the
heaviest industrial arms have, or where worlds diverge at the physics time step."""


def check_numbers(robot: RobotData, model: mujoco.MjModel) -> None:
    """Raise ValueError if physics cannot use a number of a model, or no arm has it."""
    for name in dir(model):
        if name.partition("_")[0] in _OWNERS and not name.endswith(_NOT_GIVEN):
            values = getattr(model, name)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f":
                _refuse(robot, model, name, ~np.isfinite(values), "finite")
    _check(robot, model, _BOUNDS)


def check_places(robot: RobotData, model: mujoco.MjModel) -> None:
    """Raise ValueError if a part is farther from its parent than in any real arm."""
    _check(robot, model, _PLACES)


def _check(
    robot: RobotData, model: mujoco.MjModel, bounds: dict[str, tuple[float, float, str]]
) -> None:
    for name, (low, high, unit) in bounds.items():
        values = getattr(model, name)
        allowed = f"{low:g} to {high:g}{unit}"
        _refuse(robot, model, name, (values < low) | (values > high), allowed)


def _refuse(
    robot: RobotData, model: mujoco.MjModel, name: str, is_wrong: np.ndarray, must: str
) -> None:
    if not is_wrong.any():
        return
    index = tuple(int(i) for i in np.argwhere(is_wrong)[0])
    prefix, _, number = name.partition("_")
    owner = _OWNERS[prefix]
    whose = f"{owner} {_owner(model, prefix, index[0])!r}"
    raise ValueError(
        f"in its model file {robot.model_file.name}, {number or 'qpos'} of {whose} must"
        f" be {must}, got {getattr(model, name)[index]:g}"
    )


def _owner(model: mujoco.MjModel, prefix: str, index: int) -> str:
    """Return the name, or else the index, of what has a row of an array."""
    if prefix == "dof":
        index = int(model.dof_jntid[index])
    elif prefix.startswith("qpos"):
        index = int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
    elif prefix in ("mesh", "wrap"):
        return str(index)
    return getattr(model, _OWNERS[prefix])(index).name or str(index)
