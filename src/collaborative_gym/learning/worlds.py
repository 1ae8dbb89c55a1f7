"""What is kept of the worlds in which a run collects: full episodes, and states."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from collaborative_gym.envs.vector_env import EnvState, Observations, VectorEnv
from collaborative_gym.evaluation.play import episode_row


def full_episodes(infos: dict[str, Any]) -> dict[int, dict[str, Any]]:
    """Return by world a row for each episode that ended, unless its start was cut."""
    return {
        int(i): episode_row(infos, int(i))
        for i in np.flatnonzero(infos["ended"])
        if infos["step"][i] == infos["metrics"]["length"][i]
    }


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
            env.identity,
        )
    )


def tensors(by_name: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    """Return arrays as tensors on the same memory."""
    return {name: torch.from_numpy(np.asarray(each)) for name, each in by_name.items()}


def arrays(by_name: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """Return tensors as arrays on the same memory."""
    return {name: tensor.numpy() for name, tensor in by_name.items()}
