"""The common part of other libraries' contracts for one world."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from collaborative_gym.errors import UnknownName, unknown
from collaborative_gym.timing import CONTROL_DT

RENDERING = {"render_modes": ["rgb_array"], "render_fps": round(1 / CONTROL_DT)}
"""Metadata of an environment's pictures."""

STEP_INFO = ("success", "diverged", "reward_terms", "metrics")
"""Keys of the infos of every reset and step."""


def fresh_seed() -> int:
    """Return a seed that nobody chose, so that parallel workers differ."""
    return int(np.random.default_rng().integers(2**31))


def check_render_mode(given: str | None, modes: Sequence[str]) -> None:
    """Raise `KeyError` for an unknown render mode."""
    if given is not None and given not in modes:
        message = unknown("render mode", given, modes)
        if given == "human":
            message += "; `collaborative-gym view` shows an environment in a window"
        raise UnknownName(message)


def check_can_render(render_mode: str | None) -> None:
    """Raise `RuntimeError` for an environment that was made without a render mode."""
    if render_mode is None:
        raise RuntimeError(
            "this environment draws no pictures; make it with render_mode='rgb_array'"
        )


def first_row(value: Any) -> Any:
    """Return the only row of nested dictionaries of (1,) arrays, None for NaN."""
    if isinstance(value, Mapping):
        return {name: first_row(part) for name, part in value.items()}
    scalar = value.item()
    return None if scalar != scalar else scalar
