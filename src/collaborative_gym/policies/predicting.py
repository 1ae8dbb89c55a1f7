"""Models of Stable-Baselines3 as policies. Nothing here imports it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.envs.gymnasium import SingleAgent
from collaborative_gym.envs.vector_env import VectorEnv


def predicting(model: Any, env: VectorEnv) -> Any:
    """Return the deterministic policy of a model that commands all robots.

    Observations go through the model's `VecNormalize`, if it has one, as it is then.

    Args:
      model: of Stable-Baselines3. One that was trained with `VecNormalize` and loaded
        from a file needs it, as in `PPO.load(path, VecNormalize.load(...))`.
      env: what it is to play.

    Raises:
      ValueError: if the model's spaces are not those of all robots side by side.
    """
    agents = SingleAgent(env)
    for name in ("observation_space", "action_space"):
        given, own = getattr(model, name).shape, getattr(agents, name).shape
        if given != own:
            raise ValueError(
                f"the model's {name.replace('_', ' ')} has shape {given}; that of all"
                f" robots of {env.task.name} side by side is {own}"
            )
    normalizer = model.get_vec_normalize_env()

    def act(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        rows = agents.joined(observations)
        if normalizer is not None:
            rows = normalizer.normalize_obs(rows)
        return agents.split(model.predict(rows, deterministic=True)[0])

    return act
