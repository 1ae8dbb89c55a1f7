"""Many worlds under Gymnasium's contract, in which one agent commands all robots."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from collaborative_gym.envs.faces import RENDERING, Face, step_info
from collaborative_gym.envs.gymnasium import SingleAgent
from collaborative_gym.errors import look_up
from collaborative_gym.math import Array
from collaborative_gym.rng import check_seed
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization


class GymnasiumVectorEnv(Face, gymnasium.vector.VectorEnv):
    """A `VectorEnv` as a Gymnasium vector environment.

    Infos are Gymnasium's: arrays by world, each with a mask under the same name after
    an underscore. They always have `success`, `diverged`, `reward_terms` and `metrics`.
    If a world starts anew in the step that ends its episode, `final_info` has the infos
    of the end and `final_obs` has the last observation; the masks leave this world out
    of the other infos.

    Args:
      env_id: an id from `list_envs` or a task's name from `list_tasks`.
      num_envs: how many worlds.
      num_threads: physics threads, 0 for one per CPU.
      robots: as in `make`.
      render_mode: "rgb_array", or None for no pictures.
      randomization: as in `make`.
      autoreset_mode: when worlds start their next episode: in the step that ends one
        (`AutoresetMode.SAME_STEP`), in the step after it, whose actions do not count
        for them (`NEXT_STEP`, as most wrappers want it), or only by
        `reset(options={"reset_mask": mask})` (`DISABLED`).
      strain: as in `make`.
      **settings: as in `make`.

    Raises:
      KeyError: if there is no such environment, robot, preset, setting or mode.

    Attributes:
      vector_env: the batch, with dictionaries by agent.
      autoreset_mode: as given; TorchRL, which wants `DISABLED`, looks at it.
    """

    closed = True  # until all is made: Gymnasium closes what is thrown away

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        *,
        num_threads: int = 0,
        robots: str | Robot | Sequence[str | Robot] | None = None,
        render_mode: str | None = None,
        randomization: str | Randomization = "default",
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        strain: bool = False,
        **settings: Any,
    ):
        modes, mode = {each.value: each for each in AutoresetMode}, autoreset_mode
        name = mode.value if isinstance(mode, AutoresetMode) else mode
        self.autoreset_mode = look_up("autoreset mode", name, modes)
        self.metadata = {**RENDERING, "autoreset_mode": self.autoreset_mode}
        task = make_task(env_id, robots, randomization=randomization, **settings)
        is_same = self.autoreset_mode is AutoresetMode.SAME_STEP
        how = {"num_threads": num_threads, "auto_reset": is_same, "strain": strain}
        self._face(task, num_envs, render_mode, **how)
        self._agents = SingleAgent(self.vector_env)
        self.num_envs = num_envs
        self.single_observation_space = self._agents.observation_space
        self.single_action_space = self._agents.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)
        self.closed = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every world, or in some.

        Args:
          seed: starts its episodes 0, 1, 2 ...; None starts each world's next
            episode of the present seed, which is drawn afresh if none was ever given.
            Of a list with a seed for each world, each starts episode 0 of its own and
            goes on to the episodes `num_envs`, 2 `num_envs` ...; None is as above.
          options: `reset_mask`, (num_envs,) bool: which worlds start; else all do.

        Returns:
          Observations (num_envs, k) and infos.

        Raises:
          TypeError: if a seed is not an integer.
          ValueError: if one is negative, or a list has not one for each world.
        """
        mask = (options or {}).get("reset_mask")
        if isinstance(seed, list | tuple | np.ndarray):
            observations, infos = self._reset_each(list(seed), mask)
        else:
            whole: Any = seed
            whole = None if whole is None else check_seed(whole)
            super().reset(seed=whole)
            observations, infos = self._begin(whole, env_ids=mask)
        starts = np.ones(self.num_envs, bool) if mask is None else np.asarray(mask)
        self._ended = infos["ended"]
        return self._agents.joined(observations), _masked(step_info(infos), starts)

    def _reset_each(self, seeds: list[Any], mask: Any) -> tuple[Any, dict[str, Any]]:
        """Start an episode of a seed of its own in every world of a mask."""
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"seed has {len(seeds)} seeds for {self.num_envs} worlds; give one for"
                " each, or one for all"
            )
        seeds = [None if each is None else check_seed(each) for each in seeds]
        # Also draws a seed where none was ever given, and checks the mask.
        observations, infos = self._begin(None, env_ids=mask)
        starts = range(self.num_envs) if mask is None else np.flatnonzero(mask)
        for i in starts:
            if seeds[i] is not None:
                observations, infos = self.vector_env.reset(seeds[i], [0], env_ids=[i])
        return observations, infos

    def step(
        self, actions: Array
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Do one control step in every world.

        Args:
          actions: of all robots, (num_envs, k), each component in [-1, 1].

        Returns:
          Observations, rewards, terminated, truncated and infos.

        Raises:
          ValueError: if the actions are not what the space says; no world is changed.
          RuntimeError: before the first `reset`, after `close`, and where an episode
            has ended and its world does not start anew by itself.
        """
        if np.shape(actions) != self.action_space.shape:
            raise ValueError(
                f"the actions have shape {np.shape(actions)}, not"
                f" {self.action_space.shape}: {self._agents.describe_action()}"
            )
        begins = self._ended
        if begins.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                f"the episodes of the worlds {np.flatnonzero(begins).tolist()} have"
                " ended; call reset(options={'reset_mask': mask}) with a mask of them"
            )
        if begins.all():
            observations, infos = self.reset()
            never = np.zeros(self.num_envs, bool)
            return observations, np.zeros(self.num_envs), never, never.copy(), infos
        done = self._agents.split(np.asarray(actions))
        by_agent, rewards, terminated, truncated, infos = self.vector_env.step(done)
        observations = self._agents.joined(by_agent)
        info, ended = step_info(infos), infos["ended"]
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            masked = self._final_infos(infos)
        else:
            if begins.any():
                by_agent, begun = self.vector_env.reset(env_ids=begins)
                started = self._agents.joined(by_agent)
                observations = np.where(begins[:, None], started, observations)
                info = _chosen(begins, step_info(begun), info)
            self._ended = ended & ~begins
            masked = _masked(info, np.ones(self.num_envs, bool))
        earned = np.sum([own.astype(np.float64) for own in rewards.values()], axis=0)
        over, late = map(self._agents.shared, (terminated, truncated))
        return observations, earned, over & ~begins, late & ~begins, masked

    def render(self) -> tuple[np.ndarray, ...]:
        """Return a picture of each world, (720, 1280, 3) uint8.

        Raises:
          RuntimeError: without a render mode, and if no renderer can start.
        """
        return tuple(self._picture(i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Free the renderer; `close` calls this."""
        self.vector_env.close()

    def _final_infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        ended, info = infos["ended"], step_info(infos)
        masked = _masked(info, ~ended)
        if ended.any():
            final = self._agents.joined(infos["final_observation"])
            final_obs = np.full(self.num_envs, None, object)
            for i in np.flatnonzero(ended):
                final_obs[i] = final[i]
            masked["final_obs"], masked["_final_obs"] = final_obs, ended.copy()
            masked["final_info"] = _masked(info, ended)
            masked["_final_info"] = ended.copy()
        return masked


def _chosen(mask: np.ndarray, one: Any, other: Any) -> Any:
    """Return the rows of one of two infos where a mask is set, else the other's."""
    if isinstance(one, Mapping):
        return {name: _chosen(mask, one[name], other[name]) for name in one}
    return np.where(mask, one, other)


def _masked(info: Mapping[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return an info with a mask beside each entry, as Gymnasium's vectors have it."""
    masked = {}
    for name, value in info.items():
        is_group = isinstance(value, Mapping)
        masked[name] = _masked(value, mask) if is_group else value
        masked[f"_{name}"] = mask.copy()
    return masked
