"""Starts in which all arms hold one thing, or are where they hold or miss something."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.motion import hold_moved
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Task


def start_holding(
    task: Task[Any, Any],
    sim: Sim,
    env_ids: np.ndarray,
    grasps: Callable[[np.ndarray], Sequence[tuple[Array, Array]]],
    *,
    rng: EpisodeRandom,
    moved: np.ndarray,
    postures: Mapping[str, Array],
) -> np.ndarray:
    """Put all arms of a task where they hold a thing; return how far that is moved.

    Args:
      task: whose arms.
      sim: as in `Task.reset`.
      env_ids: as in `Task.reset`.
      grasps: as in `hold_moved`.
      rng: as in `Task.reset`.
      moved: (worlds, k) how far; halved until all arms reach it.
      postures: by agent, (joints,) in rad, around which the randomization draws joint
        angles; the arms keep to them as far as the grasps allow.
    """
    noise = task.config.randomization.joint_noise
    near = [angles + rng.within(noise, len(angles)) for angles in postures.values()]
    held, moved = hold_moved(task.chains, grasps, moved=moved, near=near)
    for agent, angles in zip(task.agents, held, strict=True):
        task.scene.bend(sim, env_ids, agent=agent, angles=angles)
    return moved
