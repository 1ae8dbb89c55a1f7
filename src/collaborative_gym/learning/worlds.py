"""What both backends do with the worlds that they collect from."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch

from collaborative_gym.envs.vector_env import EnvState, Observations, VectorEnv
from collaborative_gym.evaluation.play import episode_row

_EASE = 0.01
"""How much less is carried after a rollout that went well."""


class Assistance:
    """Carries a share of the weight of what moves freely, the less the better it goes.

    A pot that takes all the strength of two arms is not lifted by chance. What is
    learned on a lighter one carries over as its weight comes back. What a task itself
    pushes by `disturb` is not carried.

    Attributes:
      share: of the weight, from 0 to 1.
    """

    def __init__(self, share: float):
        self.share = share
        self._is_given = share > 0.0

    def carry(self, env: VectorEnv) -> None:
        """Carry the share during the coming control step, in every world."""
        if self._is_given:
            bodies, weights = _loose(env.model)
            env.sim.xfrc_applied[:, bodies, 2] = self.share * weights

    def adapt(self, episodes: Sequence[Mapping[str, Any]]) -> None:
        """Carry less from now on if at least half of these episodes were completed."""
        if episodes and np.mean([row["completion"] for row in episodes]) >= 0.5:
            self.share = max(0.0, self.share - _EASE)


def _loose(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the bodies with a free joint, and their weights in N."""
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    bodies = model.jnt_bodyid[free]
    return bodies, model.body_mass[bodies] * -model.opt.gravity[2]


def full_episodes(infos: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each episode that ended and was not cut by a staggered start."""
    return [
        episode_row(infos, int(i))
        for i in np.flatnonzero(infos["ended"])
        if infos["step"][i] == infos["metrics"]["length"][i]
    ]


def save_worlds(env: VectorEnv) -> dict[str, Any]:
    """Return the state of all worlds as tensors."""
    state = env.get_state()
    return {
        "physics": torch.from_numpy(np.asarray(state.physics)),
        "memory": tensors(state.memory),
        "progress": tensors(state.progress),
    }


def load_worlds(env: VectorEnv, state: Mapping[str, Any]) -> Observations:
    """Go on from what `save_worlds` returned, and return the observations."""
    return env.set_state(
        EnvState(
            state["physics"].numpy(),
            arrays(state["memory"]),
            arrays(state["progress"]),
        )
    )


def tensors(by_name: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Return arrays as tensors on the same memory."""
    return {name: torch.from_numpy(np.asarray(each)) for name, each in by_name.items()}


def arrays(by_name: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """Return tensors as arrays on the same memory."""
    return {name: tensor.numpy() for name, tensor in by_name.items()}
