"""The common part of other libraries' contracts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, unknown
from collaborative_gym.tasks.task import Task
from collaborative_gym.timing import CONTROL_DT

RENDERING = {"render_modes": ["rgb_array"], "render_fps": round(1 / CONTROL_DT)}
"""Metadata of an environment's pictures."""

STEP_INFO = ("success", "diverged", "reward_terms", "metrics")
"""Keys of the infos of every reset and step."""


def fresh_seed() -> int:
    """Return a seed that nobody chose, so that parallel workers differ."""
    return int(np.random.default_rng().integers(2**31))


class Face:
    """What the contracts have in common: the worlds, their seeds and their pictures."""

    def _face(
        self, task: Task, num_envs: int, render_mode: str | None, **options: Any
    ) -> None:
        """Make the worlds.

        Raises:
          KeyError: for an unknown render mode.
        """
        if render_mode is not None and render_mode not in RENDERING["render_modes"]:
            message = unknown("render mode", render_mode, RENDERING["render_modes"])
            if render_mode == "human":
                message += "; `collaborative-gym view` shows an environment in a window"
            raise UnknownName(message)
        self.render_mode = render_mode
        self.vector_env = VectorEnv(task, num_envs, **options)
        self._has_seed = False

    def _begin(self, seed: int | None, **which: Any) -> tuple[Any, dict[str, Any]]:
        if seed is None and not self._has_seed:
            seed = fresh_seed()
        begun = self.vector_env.reset(seed, **which)
        self._has_seed = True
        return begun

    def _picture(self, world: int = 0) -> np.ndarray:
        if self.render_mode is None:
            raise RuntimeError(
                "this environment draws no pictures; make it with"
                " render_mode='rgb_array'"
            )
        return self.vector_env.render(world)


class OneWorld(Face):
    """What the contracts for one world have in common."""

    def render(self) -> np.ndarray:
        """Return a picture, (720, 1280, 3) uint8.

        Raises:
          RuntimeError: without a render mode, and if no renderer can start.
        """
        return self._picture()

    def close(self) -> None:
        """Free the renderer. No other call is allowed afterwards."""
        self.vector_env.close()


def step_info(infos: Mapping[str, Any]) -> dict[str, Any]:
    """Return those infos that every reset and step has."""
    return {name: infos[name] for name in STEP_INFO}


def first_row(value: Any) -> Any:
    """Return the only row of nested dictionaries of (1,) arrays, None for NaN."""
    if isinstance(value, Mapping):
        return {name: first_row(part) for name, part in value.items()}
    scalar = value.item()
    return None if scalar != scalar else scalar
