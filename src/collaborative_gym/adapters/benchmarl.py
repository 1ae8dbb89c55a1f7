"""Every environment as a task of BenchMARL."""

# Not installed everywhere where types are checked; this line must stand alone:
# pyright: reportMissingImports=false

from collections.abc import Callable
from typing import Any

import torch
from benchmarl.environments.common import TaskClass
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase

from collaborative_gym.adapters.torchrl import METRICS, TorchRLEnv
from collaborative_gym.envs.make import make_vec
from collaborative_gym.rng import training_seed, validation_seed


class BenchMARLTask(TaskClass):
    """An environment as a task of BenchMARL, in one batch of worlds.

    Each robot is a group by itself; critics see the observations of all. Evaluations
    play other episodes than the training does. BenchMARL's logs have `completion` and
    `performance`, in the mean over the agents.

    Args:
      name: an environment id or a task's name.
      config: arguments for `make_vec`, such as `{"randomization": "paper"}`; BenchMARL
        pickles it with the experiment.
    """

    def __init__(self, name: str, config: dict[str, Any] | None = None):
        super().__init__(name, {} if config is None else config)
        self._is_evaluation = False

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return a function that makes the worlds, to evaluate and to train by turns.

        Every experiment asks for both, in this order and with one seed.
        """
        self._is_evaluation = not self._is_evaluation
        draw = validation_seed if self._is_evaluation else training_seed
        own = draw(0 if seed is None else seed)
        name, config = self.name, {"num_threads": 1, **self.config}
        return lambda: TorchRLEnv(
            make_vec(name, num_envs, seed=own, **config), device=device
        )

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_render(self, env: EnvBase) -> bool:
        return False

    def max_steps(self, env: Any) -> int:
        return env.vector_env.task.config.max_episode_steps

    def group_map(self, env: Any) -> dict[str, list[str]]:
        return env.group_map

    def observation_spec(self, env: Any) -> Composite:
        return self._by_group(env, "observation")

    def info_spec(self, env: Any) -> Composite:
        return self._by_group(env, "info")

    def state_spec(self, env: Any) -> Composite:
        state = env.full_observation_spec_unbatched["state"]
        return Composite(state=state.clone())

    def action_spec(self, env: Any) -> Composite:
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: Any) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "collaborative_gym"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Return completion and performance of the episodes that ended."""
        after: Any = batch["next"]
        ended = after["done"].squeeze(-1)
        if not ended.any():
            return {}
        found: dict[str, list[torch.Tensor]] = {name: [] for name in METRICS}
        for (*_, name), value in after.items(True, True):
            if name in METRICS:
                found[name].append(value[ended].mean())
        return {name: torch.stack(own).mean().item() for name, own in found.items()}

    def _by_group(self, env: Any, name: str) -> Composite:
        spec = env.full_observation_spec_unbatched.clone()
        del spec["state"]
        for group in env.group_map:
            for key in list(spec[group].keys()):
                if key != name:
                    del spec[group, key]
        return spec
