"""One world as an RLlib multi-agent environment.

The import of this module registers every environment with RLlib under its id, so your
script can say `PPOConfig().environment("LiftTaskSawyers-v0")`. `env_config` may have
`robots`, `randomization` and fields of the task's config, which go to `make_task`, and
the `render_mode` of the environment.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

from ray.rllib.env.multi_agent_env import MultiAgentEnv
from ray.tune.registry import register_env as register_with_ray

from collaborative_gym.envs.pettingzoo import ByAgent, PettingZooEnv
from collaborative_gym.math import Array
from collaborative_gym.tasks import registry
from collaborative_gym.tasks.task import Task


class RLlibEnv(MultiAgentEnv):
    """A `PettingZooEnv` under RLlib's contract.

    All agents act in every step, and all their episodes end in the same one: truncated
    as time is up, terminated where the task says that it is over. Arguments, attributes
    and all that it returns are those of `PettingZooEnv`, but for `__all__`.

    Attributes:
      env: the environment below.
    """

    def __init__(self, task: Task, render_mode: str | None = None, name: str = ""):
        self.env = PettingZooEnv(task, render_mode, name=name)
        self.metadata = self.env.metadata
        self.render_mode = render_mode
        self.possible_agents = list(self.env.possible_agents)
        # RLlib asks for them before the first reset too.
        self.agents = list(self.env.possible_agents)
        self.observation_spaces = {**self.env.observation_spaces}
        self.action_spaces = {**self.env.action_spaces}
        super().__init__()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, ByAgent]:
        """Start an episode; see `PettingZooEnv.reset`."""
        return self.env.reset(seed, options)

    def step(
        self, action_dict: Mapping[str, Array]
    ) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        """Do one control step; see `PettingZooEnv.step`.

        Args:
          action_dict: by agent, (k,); what is beyond [-1, 1] counts as a bound.

        Returns:
          Observations, rewards, terminated, truncated and infos by agent; terminated
          and truncated also of "__all__".
        """
        observations, rewards, terminated, truncated, infos = self.env.step(action_dict)
        terminated["__all__"] = all(terminated.values())
        truncated["__all__"] = all(truncated.values())
        return observations, rewards, terminated, truncated, infos

    def render(self) -> Any:
        """Return a picture, (720, 1280, 3) uint8; see `PettingZooEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Free the renderer. No other call is allowed afterwards."""
        self.env.close()


def register_envs() -> None:
    """Register all present environments with RLlib under their ids.

    Call it again after registering environments of your own.
    """
    for env_id in registry.list_envs():
        register_with_ray(env_id, partial(_make, registry.get_env(env_id)))


def _make(spec: registry.EnvSpec, settings: Mapping[str, Any]) -> RLlibEnv:
    # Another process of Ray does not know what was registered in this one.
    if spec.env_id not in registry.list_envs():
        registry.register_env(spec)
    options = {**settings}
    render_mode = options.pop("render_mode", None)
    task = registry.make_task(spec.env_id, **options)
    return RLlibEnv(task, render_mode, spec.env_id)


register_envs()
