"""A `VectorEnv` as a batched environment of TorchRL."""

# Not installed everywhere where types are checked; this line must stand alone:
# pyright: reportMissingImports=false

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from collaborative_gym.envs.vector_env import VectorEnv

METRICS = ("completion", "performance")
"""Metrics of the episode so far, for each agent."""


class TorchRLEnv(EnvBase):
    """A `VectorEnv` under TorchRL's contract, all worlds in one batch.

    A tensordict has the batch size (num_envs,). Each group of agents has an entry with
    `observation`, `action` and `reward`, (num_envs, agents, k), and in `info` the
    `completion` and `performance` of the episode so far, (num_envs, agents, 1). `state`
    is the observations of all robots side by side. All episodes of a world end at once,
    so `done`, `terminated` and `truncated` are at the root, (num_envs, 1).

    The worlds start their next episodes by themselves. A step that ends an episode
    still returns its last observation, and the `reset` of these worlds, for which
    TorchRL asks by a mask, returns the first ones of the next.

    Args:
      env: the worlds, from `make_vec`.
      group_map: the agents of each group, by its name; None for each by itself. Those
        of a group must have equal spaces.
      device: where the tensors are; the physics is on the CPU.

    Raises:
      ValueError: if a group's agents have different spaces, or an agent no group.

    Attributes:
      vector_env: the worlds.
      group_map: as given, with lists.
    """

    def __init__(
        self,
        env: VectorEnv,
        group_map: Mapping[str, Sequence[str]] | None = None,
        *,
        device: str | torch.device = "cpu",
    ):
        super().__init__(device=device, batch_size=(env.num_envs,))
        self.vector_env = env
        given = {a: [a] for a in env.agents} if group_map is None else group_map
        self.group_map = {group: list(agents) for group, agents in given.items()}
        _check_groups(env, self.group_map)
        self._sides = {a: side for side, own in env.sides.items() for a in own}
        self._next_seed: int | None = None
        self._observations: dict[str, np.ndarray] = {}
        self._metrics: Mapping[str, Any] = {}
        # Worlds that have begun an episode and have not done a step of it.
        self._is_fresh = np.zeros(env.num_envs, bool)
        self._make_specs()

    def _make_specs(self) -> None:
        env, n = self.vector_env, self.vector_env.num_envs
        observed, acted, rewarded = {}, {}, {}
        for group, agents in self.group_map.items():
            shape = torch.Size((n, len(agents)))
            seen = env.single_observation_spaces[agents[0]].shape
            done = env.single_action_spaces[agents[0]].shape
            info = {name: Unbounded(torch.Size((*shape, 1))) for name in METRICS}
            observed[group] = Composite(
                observation=Unbounded(torch.Size((*shape, *seen))),
                info=Composite(info, shape=shape),
                shape=shape,
            )
            acted[group] = Composite(
                action=Bounded(-1.0, 1.0, torch.Size((*shape, *done))), shape=shape
            )
            reward = Unbounded(torch.Size((*shape, 1)))
            rewarded[group] = Composite(reward=reward, shape=shape)
        sizes = [space.shape[0] for space in env.single_observation_spaces.values()]
        observed["state"] = Unbounded(torch.Size((n, sum(sizes))))
        ends = ("done", "terminated", "truncated")
        flags = {name: Binary(1, torch.Size((n, 1)), dtype=torch.bool) for name in ends}
        self.observation_spec = Composite(observed, shape=(n,)).to(self.device)
        self.action_spec = Composite(acted, shape=(n,)).to(self.device)
        self.reward_spec = Composite(rewarded, shape=(n,)).to(self.device)
        self.done_spec = Composite(flags, shape=(n,)).to(self.device)

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        asked = np.ones(self.vector_env.num_envs, bool)
        if mask is not None:
            asked = mask.reshape(-1).cpu().numpy()
        if not self._observations or (self._next_seed is not None and asked.all()):
            begun = self.vector_env.reset(self._next_seed)
            self._next_seed = None
            self._observations, self._metrics = begun[0], begun[1]["metrics"]
        elif (stale := asked & ~self._is_fresh).any():
            begun = self.vector_env.reset(env_ids=stale)
            self._observations = begun[0]
        self._is_fresh |= asked
        # An episode without a step has no metrics.
        content = self._observed(self._observations, self._by_agent(asked))
        return TensorDict(content, self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions: Any = {
            agent: tensordict[group, "action"][:, i].cpu().numpy()
            for group, agents in self.group_map.items()
            for i, agent in enumerate(agents)
        }
        self._observations, rewards, terminated, truncated, infos = (
            self.vector_env.step(actions)
        )
        self._metrics, self._is_fresh = infos["metrics"], infos["ended"]
        content = self._observed(infos["final_observation"], self._by_agent())
        for group, agents in self.group_map.items():
            content[group]["reward"] = self._stacked(rewards, agents)[..., None]
        first = self.vector_env.agents[0]
        flags = dict(terminated=terminated[first], truncated=truncated[first])
        for name, ends in {**flags, "done": infos["ended"]}.items():
            content[name] = torch.as_tensor(ends, device=self.device)[:, None]
        return TensorDict(content, self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed

    def render(self) -> np.ndarray:
        return self.vector_env.render()

    def close(self, *, raise_if_closed: bool = True) -> None:
        super().close(raise_if_closed=raise_if_closed)
        self.vector_env.close()

    def _observed(
        self, observations: Mapping[str, np.ndarray], metrics: Mapping[str, Any]
    ) -> dict[str, Any]:
        content: dict[str, Any] = {}
        for group, agents in self.group_map.items():
            shape = (self.vector_env.num_envs, len(agents))
            info = {
                name: self._stacked(by_agent, agents)[..., None]
                for name, by_agent in metrics.items()
            }
            seen = self._stacked(observations, agents)
            own = {"observation": seen, "info": TensorDict(info, shape)}
            content[group] = TensorDict(own, shape, device=self.device)
        joined = np.concatenate([*observations.values()], axis=1)
        content["state"] = torch.as_tensor(joined, device=self.device)
        return content

    def _by_agent(self, asked: np.ndarray | None = None) -> dict[str, dict[str, Any]]:
        """Return the metrics by agent, 0 in worlds that begin."""
        metrics = {}
        for name in METRICS:
            values = self._metrics[name]
            metrics[name] = {}
            for agent, side in self._sides.items():
                own = values[side] if isinstance(values, Mapping) else values
                own = own if asked is None else np.where(asked, 0.0, own)
                metrics[name][agent] = own.astype(np.float32)
        return metrics

    def _stacked(self, arrays: Mapping[str, Any], agents: Sequence[str]) -> Any:
        rows = [arrays[agent] for agent in agents]
        return torch.as_tensor(np.stack(rows, axis=1), device=self.device)


def _check_groups(env: VectorEnv, groups: Mapping[str, Sequence[str]]) -> None:
    """Raise unless each agent is in one group, with others of equal spaces."""
    named = [agent for agents in groups.values() for agent in agents]
    if sorted(named) != sorted(env.agents):
        raise ValueError(
            f"group_map names {', '.join(named) or 'nobody'}; each of"
            f" {', '.join(env.agents)} must be in one group"
        )
    for group, agents in groups.items():
        for spaces in (env.single_observation_spaces, env.single_action_spaces):
            if len({spaces[agent].shape for agent in agents}) > 1:
                raise ValueError(
                    f"the agents of the group {group} have different spaces; give each"
                    " a group of its own"
                )
