"""Checks of a caller's arguments, before any world is changed."""

from typing import Any

import numpy as np

from collaborative_gym.errors import shown
from collaborative_gym.sim.sim import EnvIds

_LAST_EPISODE = 2**62
"""Beyond any that will be played, and far enough from where integers end."""


def check_env_ids(env_ids: EnvIds, num_envs: int) -> np.ndarray:
    """Return the worlds that a caller names, as integers in the caller's order.

    Raises:
      TypeError: if they are neither integers nor a mask.
      IndexError: if there is no such world, or the mask has another length.
      ValueError: if one is named twice.
    """
    if env_ids is None:
        return np.arange(num_envs)
    ids = _array("env_ids", env_ids)
    if ids.shape == (0,):
        return np.zeros(0, np.int64)
    if ids.ndim != 1 or ids.dtype.kind not in "biu":
        raise TypeError(
            "env_ids must be a list of worlds or a mask with a bool for each, got"
            f" {shown(env_ids)}"
        )
    if ids.dtype.kind == "b":
        if len(ids) != num_envs:
            raise IndexError(
                f"env_ids is a mask of {len(ids)} worlds, but there are {num_envs}"
            )
        return np.flatnonzero(ids)
    if (ids < 0).any() or (ids >= num_envs).any():
        raise IndexError(
            f"env_ids are {shown(ids.tolist())}; worlds are 0 to {num_envs - 1}"
        )
    if len(np.unique(ids)) < len(ids):
        raise ValueError(f"env_ids {shown(ids.tolist())} name a world twice")
    return ids.astype(np.int64)


def check_episodes(episodes: Any, count: int) -> np.ndarray:
    """Return the episode index of each of that many worlds.

    Raises:
      ValueError: if there are fewer or more, or one is not an index.
    """
    first = _array("episodes", episodes)
    if first.shape != (count,):
        raise ValueError(
            f"episodes has shape {first.shape}; give one index for each of the"
            f" {count} worlds"
        )
    if first.dtype.kind not in "iu" or ((first < 0) | (first > _LAST_EPISODE)).any():
        raise ValueError(
            f"episodes are counted 0, 1, 2 ... up to 2**62; got {shown(first.tolist())}"
        )
    return first.astype(np.int64)


def _array(what: str, given: Any) -> np.ndarray:
    try:
        return np.asarray(given)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{what} cannot be read as numbers: {error}") from None
