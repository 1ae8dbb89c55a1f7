"""A runner for RLlib that steps its worlds in one batch.

RLlib's own steps worlds one by one and writes episodes step by step. This one asks each
module once a step, and cuts a whole fragment into episodes at its end.
"""

# RLlib's annotations differ from what its code takes and returns.
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import time
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import torch
import tree
from gymnasium.spaces import Dict
from ray.rllib.core.columns import Columns
from ray.rllib.env.env_context import EnvContext
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.env.multi_agent_episode import MultiAgentEpisode
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.env.utils.infinite_lookback_buffer import (
    InfiniteLookbackBuffer as Buffer,
)
from ray.rllib.env.vector.vector_multi_agent_env import VectorMultiAgentEnv
from ray.rllib.utils import metrics as names
from ray.tune.registry import ENV_CREATOR, _global_registry

from collaborative_gym.envs.faces import fresh_seed
from collaborative_gym.envs.rllib import RLlibEnv
from collaborative_gym.envs.vector_env import Observations, VectorEnv

Columned = dict[str, dict[str, np.ndarray]]
"""What RLlib's columns hold, by agent, with a row for each world."""

_OUTPUTS = Columns.ACTION_DIST_INPUTS, Columns.ACTION_LOGP


class _Worlds(VectorMultiAgentEnv):
    """A `VectorEnv` with its spaces where RLlib looks for them."""

    def __init__(self, vector_env: VectorEnv):
        self.vector_env = vector_env
        self.num_envs = vector_env.num_envs
        self.observation_space = Dict(vector_env.single_observation_spaces)
        self.action_space = Dict(vector_env.single_action_spaces)
        self.single_observation_space = self.observation_space
        self.single_action_space = self.action_space

    def close_extras(self, **_: Any) -> None:
        self.vector_env.close()


class _Part(NamedTuple):
    """An episode's part in a fragment: some steps of a world."""

    episode: MultiAgentEpisode
    world: int
    steps: slice


class BatchedEnvRunner(MultiAgentEnvRunner):
    """RLlib's multi-agent runner on one `VectorEnv`.

    Give it as `env_runner_cls`, with the id of an environment of this package. Metrics,
    checkpoints and evaluation are those of RLlib's runner. Of the callbacks of
    episodes, it calls only `on_episode_end`. A runner in a process of its own uses as
    many physics threads as Ray gives it CPUs; the local runner uses all CPUs.

    Args:
      config: of the algorithm.
      **kwargs: as RLlib gives them.

    Raises:
      TypeError: if the environment is not one of this package.
      ValueError: with connectors between worlds and modules, or modules with memory.
    """

    env: _Worlds | None

    def __init__(self, config: Any, **kwargs: Any):
        super().__init__(config=config, **kwargs)
        self._observations: Observations = {}
        self._chunks: list[MultiAgentEpisode] = []
        self._rows: dict[str, list[tuple[str, np.ndarray]]] = {}
        own = config._env_to_module_connector, config._module_to_env_connector
        if any(own) or any(module.is_stateful() for module in self.module.values()):
            raise ValueError(
                "BatchedEnvRunner knows no connectors between worlds and modules, and"
                " no modules with memory; leave env_runner_cls out to use RLlib's own"
            )

    def make_env(self) -> None:
        """Make this runner's worlds, of the task of the environment's id."""
        if self.env is not None:
            self.env.close()
        index = self.worker_index or 0
        context = EnvContext(
            self.config.env_config, index, num_workers=self.num_workers
        )
        single = _global_registry.get(ENV_CREATOR, self.config.env)(context)
        if not isinstance(single, RLlibEnv):
            raise TypeError(
                f"BatchedEnvRunner plays ids of cg.list_envs(), not {self.config.env!r}"
            )
        self.num_envs = self.config.num_envs_per_env_runner
        seed = fresh_seed() if self._seed is None else self._seed
        threads = max(1, int(self.config.num_cpus_per_env_runner)) if index else 0
        task = single.env.vector_env.task
        worlds = VectorEnv(task, self.num_envs, seed=seed, num_threads=threads)
        self.env = _Worlds(worlds)
        single.close()
        self._needs_initial_reset = True

    def sample(self, **options: Any) -> list[MultiAgentEpisode]:
        """Play, as RLlib's runner does; see there for the options."""
        # Threads of Torch cost more than they bring to so few rows.
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return super().sample(**options)
        finally:
            torch.set_num_threads(threads)

    def _sample(
        self,
        *,
        num_timesteps: int | None = None,
        num_episodes: int | None = None,
        explore: bool,
        random_actions: bool = False,
        force_reset: bool = False,
    ) -> list[MultiAgentEpisode]:
        if random_actions:
            raise ValueError("BatchedEnvRunner acts by the modules, never at random")
        if force_reset or num_episodes is not None or self._needs_initial_reset:
            self._observations, _ = self.env.vector_env.reset()
            self._ongoing_episodes_for_metrics.clear()
            self._chunks = [self._new_chunk() for _ in range(self.num_envs)]
            self._map()
        self._needs_initial_reset = num_episodes is not None
        since = time.perf_counter()
        steps, done, going_on = self._play(num_timesteps, num_episodes, explore)
        # If episodes are asked for, only those that came to their end count.
        parts = done if num_timesteps is None else done + going_on
        self._fill(parts, steps, since)
        for part in done:
            by_world = {part.world: part.episode}
            self._make_on_episode_callback("on_episode_end", part.world, by_world)
            self._done_episodes_for_metrics.append(part.episode)
        for part in parts[len(done) :]:
            self._ongoing_episodes_for_metrics[part.episode.id_].append(part.episode)
            self._chunks[part.world] = self._new_chunk(part.episode)
        episodes = [part.episode for part in parts]
        self._count(episodes, len(done))
        return episodes

    def _play(
        self, num_timesteps: int | None, num_episodes: int | None, explore: bool
    ) -> tuple[list[Columned], list[_Part], list[_Part]]:
        by_agent = self.config.count_steps_by == "agent_steps"
        size = self.num_envs * (len(self._observations) if by_agent else 1)
        steps: list[Columned] = []
        done: list[_Part] = []
        starts, now = [0] * self.num_envs, 0
        wanted = num_episodes if num_timesteps is None else num_timesteps
        while (len(done) if num_timesteps is None else now * size) < (wanted or 0):
            columns, ended = self._step(explore)
            steps.append(columns)
            now = len(steps)
            for world in ended:
                played = slice(starts[world], now)
                done.append(_Part(self._chunks[world], world, played))
                starts[world], self._chunks[world] = now, self._new_chunk()
            if ended:
                self._map()
        going_on = [
            _Part(self._chunks[world], world, slice(start, now))
            for world, start in enumerate(starts)
            if start < now
        ]
        return steps, done, going_on

    def _new_chunk(self, before: MultiAgentEpisode | None = None) -> MultiAgentEpisode:
        """Return an empty part of an episode, of a new one or of that before it."""
        mapping = self.config.policy_mapping_fn
        if before is None:
            return MultiAgentEpisode(agent_to_module_mapping_fn=mapping)
        return MultiAgentEpisode(
            before.id_,
            env_t_started=before.env_t,
            agent_t_started=dict.fromkeys(before.agent_ids, before.env_t),
            agent_module_ids=before._agent_to_module_mapping,
            agent_to_module_mapping_fn=mapping,
        )

    def _map(self) -> None:
        self._rows = {}
        for agent in self._observations:
            modules = np.array([chunk.module_for(agent) for chunk in self._chunks])
            for module in np.unique(modules):
                rows = np.flatnonzero(modules == module)
                self._rows.setdefault(str(module), []).append((agent, rows))

    def _step(self, explore: bool) -> tuple[Columned, list[int]]:
        columns = self._act(explore)
        env = self.env.vector_env
        actions = {agent: found[Columns.ACTIONS] for agent, found in columns.items()}
        self._observations, rewards, terminated, truncated, infos = env.step(actions)
        for agent, found in columns.items():
            found[Columns.REWARDS] = rewards[agent]
            found[Columns.TERMINATEDS] = terminated[agent]
            found[Columns.TRUNCATEDS] = truncated[agent]
            found[Columns.NEXT_OBS] = infos["final_observation"][agent]
        return columns, np.flatnonzero(infos["ended"]).tolist()

    def _act(self, explore: bool) -> Columned:
        columns: Columned = {a: {Columns.OBS: o} for a, o in self._observations.items()}
        for name, rows in self._rows.items():
            module = self.module[name]
            seen = np.concatenate([self._observations[a][w] for a, w in rows])
            batch = {Columns.OBS: torch.from_numpy(seen).to(self._device)}
            with torch.no_grad():
                if explore:
                    inputs = module.forward_exploration(batch)
                    kind = module.get_exploration_action_dist_cls()
                else:
                    inputs = module.forward_inference(batch)
                    kind = module.get_inference_action_dist_cls()
                inputs = inputs[Columns.ACTION_DIST_INPUTS]
                chances = kind.from_logits(inputs)
                drawn = chances if explore else chances.to_deterministic()
                found = (actions := drawn.sample()), inputs, chances.logp(actions)
            cuts = np.cumsum([len(worlds) for _, worlds in rows])[:-1]
            for column, whole in zip((Columns.ACTIONS, *_OUTPUTS), found, strict=True):
                parts = np.split(whole.cpu().numpy(), cuts)
                for (agent, worlds), part in zip(rows, parts, strict=True):
                    shape = self.num_envs, *part.shape[1:]
                    own = columns[agent].setdefault(column, np.empty(shape, part.dtype))
                    own[worlds] = part
        return columns

    def _fill(self, parts: list[_Part], steps: list[Columned], since: float) -> None:
        whole = tree.map_structure(lambda *rows: np.stack(rows, axis=1), *steps)
        for part in parts:
            episode, world, played = part.episode, part.world, part.steps
            begin, end = episode.env_t, episode.env_t + played.stop - played.start
            for agent, columns in whole.items():
                rows = {name: array[world][played] for name, array in columns.items()}
                episode.agent_episodes[agent] = single = _single(episode, agent, rows)
                episode.env_t_to_agent_t[agent] = Buffer([*range(begin, end + 1)])
                # All agents' episodes end in the same step, and in the same way.
                episode.is_terminated = single.is_terminated
                episode.is_truncated = single.is_truncated
            episode.env_t = end
            episode._start_time, episode._last_step_time = since, time.perf_counter()

    def _count(self, episodes: list[MultiAgentEpisode], num_ended: int) -> None:
        counts = Counter[tuple[str, ...]]({(names.NUM_EPISODES,): num_ended})
        for episode in episodes:
            counts[(names.NUM_ENV_STEPS_SAMPLED,)] += len(episode)
            for agent, single in episode.agent_episodes.items():
                counts[names.NUM_AGENT_STEPS_SAMPLED, agent] += len(single)
                counts[names.NUM_MODULE_STEPS_SAMPLED, single.module_id] += len(single)
        log = self.metrics.log_value
        for (name, *of), count in counts.items():
            log((name, *of), count, reduce="sum")
            key, timed = (f"{name}_lifetime", *of), name == names.NUM_ENV_STEPS_SAMPLED
            log(key, count, reduce="lifetime_sum", with_throughput=timed)


def _single(
    episode: MultiAgentEpisode, agent: str, rows: dict[str, np.ndarray]
) -> SingleAgentEpisode:
    last = rows[Columns.NEXT_OBS][-1:]
    return SingleAgentEpisode(
        f"{episode.id_}_{agent}",
        agent_id=agent,
        module_id=episode.module_for(agent),
        multi_agent_episode_id=episode.id_,
        observations=Buffer(np.concatenate([rows[Columns.OBS], last])),
        actions=Buffer(rows[Columns.ACTIONS]),
        rewards=Buffer(rows[Columns.REWARDS]),
        extra_model_outputs={name: Buffer(rows[name]) for name in _OUTPUTS},
        terminated=bool(rows[Columns.TERMINATEDS][-1]),
        truncated=bool(rows[Columns.TRUNCATEDS][-1]),
        t_started=episode.env_t_started,
        len_lookback_buffer=0,
    )
