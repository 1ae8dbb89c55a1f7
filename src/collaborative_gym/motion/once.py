"""Searches of a posture that are done once in a process for the same arm and world."""

import pickle
from collections.abc import Callable
from copy import deepcopy
from functools import wraps
from hashlib import blake2b
from typing import Any, Concatenate, ParamSpec, TypeVar

import mujoco

from collaborative_gym.scene import Arm

_KEPT = 256  # results of each search
_SHAPES = "body_", "jnt_", "qpos0", "geom_", "mesh_", "hfield_", "exclude_", "pair_"
"""Beginnings of the names of MuJoCo's fields that say how bodies move and touch."""

Options = ParamSpec("Options")
Found = TypeVar("Found")
Search = Callable[Concatenate[mujoco.MjModel, Arm, Options], Found]


def found_once(search: Search[Options, Found]) -> Search[Options, Found]:
    """Return a search that remembers what it found.

    The same arm among the same bodies and shapes has the same postures, whatever drives
    and sensors the worlds have. A search that fails is done again.
    """
    kept: dict[bytes, Found] = {}

    @wraps(search)
    def find(
        model: mujoco.MjModel, arm: Arm, *args: Options.args, **options: Options.kwargs
    ) -> Found:
        key = _digest(model, arm, (args, options))
        if key not in kept:
            if len(kept) == _KEPT:
                del kept[next(iter(kept))]
            kept[key] = search(model, arm, *args, **options)
        return deepcopy(kept[key])

    return find


def _digest(model: mujoco.MjModel, arm: Arm, options: Any) -> bytes:
    tcp = model.site_bodyid[arm.tcp], model.site_pos[arm.tcp], model.site_quat[arm.tcp]
    own = arm.robot, arm.qpos, arm.dof, arm.joint_range, arm.stride, arm.hand
    flags = model.opt.disableflags, model.opt.enableflags
    shapes = [getattr(model, name) for name in dir(model) if name.startswith(_SHAPES)]
    return blake2b(pickle.dumps((tcp, own, flags, options, shapes))).digest()
