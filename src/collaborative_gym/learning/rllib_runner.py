"""Collects for RLlib from many worlds in one batch."""

# RLlib is optional, and its annotations differ from what its code takes and returns.
# pyright: reportMissingImports=false, reportOptionalMemberAccess=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportReturnType=false
# pyright: reportIndexIssue=false, reportPrivateImportUsage=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Dict
from ray import cloudpickle
from ray.rllib.core import COMPONENT_RL_MODULE
from ray.rllib.core.columns import Columns
from ray.rllib.env import INPUT_ENV_SINGLE_SPACES, INPUT_ENV_SPACES
from ray.rllib.env.env_runner import EnvRunner

from collaborative_gym.envs.vector_env import Observations, VectorEnv
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.backend import training_seed
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.rllib_learner import ADVANTAGES, RETURNS, TeamModule
from collaborative_gym.learning.team import Learner, Sizes
from collaborative_gym.learning.worlds import (
    arrays,
    full_episodes,
    load_worlds,
    save_worlds,
    tensors,
)

Rows = dict[str, np.ndarray]
"""Columns of a learner's batch, each with a row for every step of each of its rows."""

_BLOCK = 1 << 32
"""Episodes between the first of two runners, or of two starts of one runner."""


@dataclass(frozen=True)
class Job:
    """What all runners of a run do; `env_config` of RLlib holds it under "job".

    Attributes:
      task: what to learn, pickled.
      learners: who learns what.
      sizes: of the agents' spaces.
      seed: of the run.
      hyperparameters: how it learns.
      num_threads: physics threads of a runner, 0 for one per CPU.
    """

    task: bytes
    learners: tuple[Learner, ...]
    sizes: Sizes
    seed: int
    hyperparameters: Hyperparameters
    num_threads: int

    def spaces(self, learner: Learner) -> tuple[Box, Box]:
        """Return the spaces of a learner's rows of observations and actions."""
        size = learner.observation_size(self.sizes)
        observations = Box(-np.inf, np.inf, (size,), np.float32)
        actions = Box(-1.0, 1.0, (learner.action_size(self.sizes),), np.float32)
        return observations, actions


@dataclass(frozen=True)
class Sample:
    """What one runner collected.

    Attributes:
      runner: which one, from 0.
      steps: environment steps, over all its worlds.
      rows: by learner.
      episodes: a row for each episode that ended and was played in full.
    """

    runner: int
    steps: int
    rows: dict[str, Rows]
    episodes: list[dict[str, Any]]


class BatchedEnvRunner(EnvRunner):
    """RLlib's runner of one `VectorEnv`, whose worlds are stepped together.

    With n runners each has about an n-th of the worlds. A runner keeps nothing that
    cannot be lost: weights come with each call, and one that was started anew begins
    episodes that nobody has played.

    Args:
      config: of the algorithm, with a `Job` in `env_config`.
      **kwargs: as RLlib gives them.
    """

    def __init__(self, *, config, **kwargs: Any):
        super().__init__(config=config, **kwargs)
        self._job: Job = self.config.env_config["job"]
        runners = self.config.num_env_runners
        self.index = max(self.worker_index or 0, 1) - 1
        self.num_runners = max(runners, 1)
        self._observations: Observations | None = None
        self._noise: dict[str, np.ndarray] = {}
        if self.worker_index:
            # A process for each core: more threads would only wait for one another.
            torch.set_num_threads(1)
        self.make_module()
        if self.worker_index or not runners:
            self.make_env()

    def make_env(self) -> None:
        """Make this runner's worlds."""
        job = self._job
        share = len(range(self.index, job.hyperparameters.num_envs, self.num_runners))
        seed = training_seed(job.seed)
        self.env = VectorEnv(
            cloudpickle.loads(job.task), share, seed=seed, num_threads=job.num_threads
        )
        self._observations = None

    def make_module(self) -> None:
        """Make the networks; their weights come with `sample`."""
        spec = self.config.get_multi_rl_module_spec(spaces=self.get_spaces())
        self.module = spec.build()

    def get_spaces(self) -> dict[str, tuple[Any, Any]]:
        """Return observation and action spaces by module, and those of the worlds."""
        job = self._job
        single = _spaces(job.sizes.observation, np.inf), _spaces(job.sizes.action, 1.0)
        return {
            INPUT_ENV_SPACES: single,
            INPUT_ENV_SINGLE_SPACES: single,
            **{learner.name: job.spaces(learner) for learner in job.learners},
        }

    def sample(
        self,
        *,
        iteration: int,
        weights: Mapping[str, Any],
        assistance: Assistance,
        **kwargs: Any,
    ) -> Sample:
        """Collect one rollout in each of this runner's worlds.

        What comes of it depends on the worlds and the arguments, and on no generator's
        state.

        Args:
          iteration: how many rollouts the run has had.
          weights: state of each module, by learner.
          assistance: what is carried meanwhile.
          **kwargs: not used.
        """
        self.module.set_state(weights)
        job = self._job
        rng = np.random.default_rng([job.seed, iteration, self.index])
        observations = self._observations or self._start(iteration, rng)
        rollouts = [
            _Rollout(
                learner,
                job,
                self.module[learner.name].unwrapped(),
                self._noise[learner.name],
            )
            for learner in job.learners
        ]
        episodes: list[dict[str, Any]] = []
        for _ in range(job.hyperparameters.rollout_steps):
            actions: dict[str, np.ndarray] = {}
            for rollout in rollouts:
                actions |= rollout.act(observations, rng)
            assistance.carry(self.env)
            observations, rewards, _, _, infos = self.env.step(actions)
            for rollout in rollouts:
                rollout.record(rewards, infos)
            episodes += full_episodes(infos)
        self._observations = observations
        done = job.hyperparameters.rollout_steps * self.env.num_envs
        rows = {each.learner.name: each.finish(observations) for each in rollouts}
        return Sample(self.index, done, rows, episodes)

    def get_worlds(self) -> dict[str, Any] | None:
        """Return the state of the worlds as tensors, None before the first rollout."""
        if self._observations is None:
            return None
        return {**save_worlds(self.env), "noise": tensors(self._noise)}

    def set_worlds(self, state: Mapping[str, Any]) -> None:
        """Go on from what `get_worlds` returned."""
        noise = arrays(state["noise"])
        self._noise = {name: each.copy() for name, each in noise.items()}
        self._observations = load_worlds(self.env, state)

    def get_state(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Return the weights, for RLlib."""
        return {COMPONENT_RL_MODULE: self.module.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Set the weights, for RLlib."""
        if COMPONENT_RL_MODULE in state:
            self.module.set_state(state[COMPONENT_RL_MODULE])

    def get_metrics(self) -> Any:
        """Return RLlib's measurements; what matters here is in the samples."""
        return self.metrics.reduce()

    def assert_healthy(self) -> None:
        """Raise AssertionError unless there are networks."""
        assert self.module is not None

    def stop(self) -> None:
        """Free the worlds."""
        if self.env is not None:
            self.env.close()

    def _start(self, iteration: int, rng: np.random.Generator) -> Observations:
        """Start episodes that no runner has played, at any time before."""
        self._noise = {
            learner.name: rng.standard_normal(
                (
                    learner.num_rows(self.env.num_envs),
                    learner.action_size(self._job.sizes),
                ),
                np.float32,
            )
            for learner in self._job.learners
        }
        first = (iteration * self.num_runners + self.index) * _BLOCK
        observations, _ = self.env.reset(
            seed=training_seed(self._job.seed),
            episodes=range(first, first + self.env.num_envs),
            stagger=True,
        )
        return observations


class _Rollout:
    """What a learner's rows saw, did and earned, step by step.

    Args:
      learner: whose.
      job: what is done.
      module: the learner's networks.
      noise: that of the last actions, (rows, actions); goes on in place.
    """

    def __init__(
        self, learner: Learner, job: Job, module: TeamModule, noise: np.ndarray
    ):
        self.learner = learner
        self._job = job
        self._module = module
        self._noise = noise
        self._distribution = module.get_exploration_action_dist_cls()
        self._columns: dict[str, list[np.ndarray]] = {
            name: [] for name in (Columns.OBS, Columns.ACTIONS, Columns.ACTION_LOGP)
        }
        self._values: list[np.ndarray] = []
        self._rewards: list[np.ndarray] = []
        self._ended: list[np.ndarray] = []
        self._final_values: list[np.ndarray] = []

    def act(
        self, observations: Observations, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        """Return sampled actions by agent."""
        rows = self.learner.observations(observations)
        batch = {Columns.OBS: torch.from_numpy(rows)}
        found = self._module.forward_exploration(batch)
        mean, log_std = found[Columns.ACTION_DIST_INPUTS].chunk(2, dim=1)
        is_grip = self.learner.is_grip(self._job.sizes)
        persistence = self._job.hyperparameters.persistence(is_grip).astype(np.float32)
        self._noise *= persistence
        fresh = rng.standard_normal(self._noise.shape, np.float32)
        self._noise += np.sqrt(1.0 - persistence**2) * fresh
        actions = mean + log_std.exp() * torch.from_numpy(self._noise)
        with torch.no_grad():
            values = self._module.compute_values(batch, found[Columns.EMBEDDINGS])
            distribution = self._distribution.from_logits(
                found[Columns.ACTION_DIST_INPUTS]
            )
            log_probability = distribution.logp(actions)
        self._columns[Columns.OBS].append(rows)
        self._columns[Columns.ACTIONS].append(actions.numpy())
        self._columns[Columns.ACTION_LOGP].append(log_probability.numpy())
        self._values.append(values.numpy())
        return self.learner.actions(actions.numpy(), self._job.sizes)

    def record(self, rewards: Mapping[str, Any], infos: Mapping[str, Any]) -> None:
        """Keep what came of the last actions.

        Episodes end only because time is up, so that their last value counts on.
        """
        ended = self.learner.per_row(infos["ended"])
        final_values = np.zeros(len(ended), np.float32)
        if ended.any():
            rows = self.learner.observations(infos["final_observation"])
            final_values[ended] = self._value(rows[ended])
        self._rewards.append(self.learner.rewards(rewards).astype(np.float32))
        self._ended.append(ended)
        self._final_values.append(final_values)

    def finish(self, observations: Observations) -> Rows:
        """Return all columns, with advantages and returns."""
        last = self._value(self.learner.observations(observations))
        following = np.stack([*self._values[1:], last])
        ended, values = np.stack(self._ended), np.stack(self._values)
        advantages = estimate_advantages(
            np.stack(self._rewards),
            values,
            np.where(ended, np.stack(self._final_values), following),
            ended,
            self._job.hyperparameters.discount,
            self._job.hyperparameters.gae_lambda,
        )
        rows = {name: np.concatenate(each) for name, each in self._columns.items()}
        rows[ADVANTAGES] = advantages.reshape(-1)
        rows[RETURNS] = (advantages + values).reshape(-1)
        return rows

    def _value(self, rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            batch = {Columns.OBS: torch.from_numpy(rows)}
            return self._module.compute_values(batch).numpy()


def estimate_advantages(
    rewards: np.ndarray,
    values: np.ndarray,
    next_values: np.ndarray,
    ended: np.ndarray,
    discount: float,
    gae_lambda: float,
) -> np.ndarray:
    """Return generalized advantage estimates, (steps, rows) as all that they come of.

    Args:
      rewards: of each step.
      values: of the observations before it.
      next_values: of those after it, which in an episode's last step are its own.
      ended: whether it was an episode's last.
      discount: what a reward is worth one step earlier.
      gae_lambda: trace decay.
    """
    advantages = np.zeros_like(rewards)
    trace = np.zeros_like(rewards[0])
    for step in reversed(range(len(rewards))):
        surprise = rewards[step] + discount * next_values[step] - values[step]
        trace = surprise + discount * gae_lambda * np.where(ended[step], 0.0, trace)
        advantages[step] = trace
    return advantages


def join(samples: Sequence[Sample]) -> dict[str, Rows]:
    """Return the rows of all samples by learner, in the order of the runners."""
    ordered = sorted(samples, key=lambda sample: sample.runner)
    return {
        name: {
            column: np.concatenate([sample.rows[name][column] for sample in ordered])
            for column in rows
        }
        for name, rows in ordered[0].rows.items()
    }


def _spaces(sizes: Mapping[str, int], bound: float) -> Dict:
    return Dict({a: Box(-bound, bound, (n,), np.float32) for a, n in sizes.items()})
