"""Where a page's camera may stand."""

from collections.abc import Mapping

import mujoco
import numpy as np

from collaborative_gym.pictures.rendering import CAMERA, overview

_FROM: Mapping[str, tuple[float, float, float]] = {
    "front": (1.0, 0.0, 0.4),
    "back": (-1.0, 0.0, 0.4),
    "left": (0.0, -1.0, 0.4),
    "right": (0.0, 1.0, 0.4),
    # Not quite upright, where it would have no upper side.
    "above": (0.01, 0.0, 1.0),
}
"""From where a camera looks at the middle of the arms."""

_MARGIN = 0.4
"""How much there is to see around the middles of an arm's parts, in m."""

HANDS = "hands"
"""The view that shows the hands alone."""


def views(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the views of a world, the task's own cameras first."""
    own = [model.camera(i).name for i in range(model.ncam)]
    return tuple(dict.fromkeys([CAMERA, *filter(None, own), HANDS, *_FROM]))


def stand(
    view: str,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    arms: np.ndarray,
    hands: np.ndarray,
    aspect: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a camera stands so that the arms are in view, and what it looks at.

    Args:
      view: one of `views`.
      model: the world.
      data: its state, whose camera is current.
      arms: places that the picture is to show, (places, 3) in m.
      hands: likewise where it shows the hands alone.
      aspect: width of the picture over its height.

    Returns:
      Two places, (3,) in m.
    """
    shown = hands if view == HANDS else arms
    if view == CAMERA:
        eye, target = overview(model, data)
    elif view in (HANDS, *_FROM):
        target = (shown.min(axis=0) + shown.max(axis=0)) / 2
        own, looked_at = overview(model, data)
        eye = target + np.array(_FROM.get(view, own - looked_at))
    else:
        own = data.camera(view)
        return own.xpos, own.xpos - own.xmat.reshape(3, 3)[:, 2]
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    away = shown - target
    slope = np.tan(np.radians(model.camera(CAMERA).fovy[0]) / 2)
    wide = (np.abs(away @ right) + _MARGIN) / (slope * aspect)
    high = (np.abs(away @ np.cross(back, right)) + _MARGIN) / slope
    needed = float(np.max(away @ back + np.maximum(wide, high)))
    nearest = np.linalg.norm(eye - target) if view == CAMERA else 0.0
    return target + max(needed, nearest) * back, target
