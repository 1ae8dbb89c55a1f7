"""A `VectorEnv` as a batch of Tianshou; one agent commands all robots."""

# Not installed everywhere where types are checked.
# pyright: reportMissingImports=false

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from tianshou.env import BaseVectorEnv

from collaborative_gym.envs.faces import RENDERING
from collaborative_gym.envs.gymnasium import SingleAgent
from collaborative_gym.envs.vector_env import VectorEnv

Ids = int | Sequence[int] | np.ndarray | None


class TianshouEnv(BaseVectorEnv):
    """A `VectorEnv` under Tianshou's contract, all worlds at once.

    Observations and actions of the robots stand side by side, and the reward is the sum
    of theirs. The infos have `completion` and `performance` of the episode so far. The
    worlds start their next episodes by themselves. A step that ends an episode still
    returns its last observation, and the `reset` of these worlds, for which Tianshou
    asks next, returns the first ones of the next. Worlds that a step does not name stay
    as they are.

    Args:
      env: the worlds, of a task with one side, from `make_vec`.

    Raises:
      ValueError: if the task has several sides.

    Attributes:
      vector_env: the worlds.
    """

    def __init__(self, env: VectorEnv):
        # The base would make a worker for each world.
        self.vector_env, self.env_num = env, env.num_envs
        self.is_async, self.is_closed, self.waiting_id = False, False, []
        self._agents = SingleAgent(env)
        self._next_seed: int | None = None
        # Worlds that have begun an episode and have not done a step of it.
        self._is_fresh = np.zeros(env.num_envs, bool)
        self._observations: dict[str, np.ndarray] = {}

    def reset(
        self, env_id: Ids = None, *, seed: int | None = None, **_: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start an episode in these worlds; return their observations and infos.

        With a seed, here or from `seed` before, all worlds must start.
        """
        rows = np.asarray(self._wrap_id(env_id))
        seed, self._next_seed = self._next_seed if seed is None else seed, None
        if seed is not None or not self._observations:
            self._observations, _ = self.vector_env.reset(seed)
        elif (stale := rows[~self._is_fresh[rows]]).size:
            self._observations, _ = self.vector_env.reset(env_ids=stale)
        self._is_fresh[rows] = True
        infos = np.array([{"env_id": int(row)} for row in rows])
        return self._agents.joined(self._observations)[rows], infos

    def step(self, action: np.ndarray, id: Ids = None) -> tuple[np.ndarray, ...]:
        """Do one control step in these worlds.

        Args:
          action: of all robots, a row for each of these worlds.
          id: the worlds; None for all.

        Returns:
          Observations, rewards, terminated, truncated and infos, a row for each.
        """
        rows, env = np.asarray(self._wrap_id(id)), self.vector_env
        others = np.setdiff1d(np.arange(self.env_num), rows)
        kept = env.get_state(others) if others.size else None
        actions = np.zeros((self.env_num, action.shape[-1]), action.dtype)
        actions[rows] = action
        self._observations, rewards, terminated, truncated, infos = env.step(
            self._agents.split(actions)
        )
        self._is_fresh[rows] = infos["ended"][rows]
        if kept is not None:
            self._observations = env.set_state(kept, others)
        metrics = infos["metrics"]
        told = [
            {"env_id": int(row)}
            | {name: metrics[name][row] for name in ("completion", "performance")}
            for row in rows
        ]
        return (
            self._agents.joined(infos["final_observation"])[rows],
            np.sum([*rewards.values()], axis=0)[rows],
            self._agents.shared(terminated)[rows],
            self._agents.shared(truncated)[rows],
            np.array(told),
        )

    def seed(self, seed: int | Sequence[int] | None = None) -> list[Any]:
        """Let the next `reset` start the episodes 0, 1, 2 ... of a seed."""
        self._next_seed = seed[0] if isinstance(seed, Sequence) else seed
        return [self._next_seed] * self.env_num

    def get_env_attr(self, key: str, id: Ids = None) -> list[Any]:
        """Return what all worlds have in common, once for each."""
        common: Mapping[str, Any] = {
            "observation_space": self._agents.observation_space,
            "action_space": self._agents.action_space,
            "metadata": RENDERING,
        }
        return [common.get(key) for _ in self._wrap_id(id)]

    def set_env_attr(self, key: str, value: Any, id: Ids = None) -> None:
        """Raise: no world of a batch has anything of its own."""
        raise NotImplementedError("no world of a batch has anything of its own")

    def render(self, **_: Any) -> list[np.ndarray]:
        """Return a picture of each world, (480, 640, 3) uint8."""
        return [self.vector_env.render(i) for i in range(self.env_num)]

    def close(self) -> None:
        """Close the worlds."""
        self.vector_env.close()
        self.is_closed = True
