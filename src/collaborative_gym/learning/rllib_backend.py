"""Training on one machine or a Ray cluster, with RLlib."""

# RLlib is optional, and its annotations differ from what its code takes and returns.
# pyright: reportMissingImports=false, reportOptionalMemberAccess=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportReturnType=false
# pyright: reportIndexIssue=false, reportPrivateImportUsage=false

import logging
import os
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import ray
import torch
from ray import cloudpickle
from ray._private import ray_constants
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.core.learner.learner import Learner as RLlibLearner
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.env_runner_group import EnvRunnerGroup
from ray.rllib.policy.policy import PolicySpec
from ray.rllib.policy.sample_batch import MultiAgentBatch, SampleBatch
from ray.rllib.utils.metrics import (
    ENV_RUNNER_RESULTS,
    LEARNER_RESULTS,
    NUM_ENV_STEPS_SAMPLED,
    NUM_ENV_STEPS_SAMPLED_LIFETIME,
)

from collaborative_gym.envs.rllib import RLlibEnv
from collaborative_gym.evaluation.machine import cores
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.backend import Iteration
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.rllib_learner import TeamModule, TeamPPOLearner
from collaborative_gym.learning.rllib_runner import (
    BatchedEnvRunner,
    Job,
    Sample,
    join,
)
from collaborative_gym.learning.team import Learner, Sizes
from collaborative_gym.policies.network import Weights
from collaborative_gym.tasks.task import Task

_PATIENCE = 300.0
"""Seconds to wait for any runner, where all are lost."""

_PROBE = 2.0
"""Seconds that a lost runner has to answer before an update goes on without it."""


class TeamPPO(PPO):
    """RLlib's PPO with our runners.

    Attributes:
      samples: what the last `train` was made of, by runner.
      rollouts: how many rollouts there were.
      steps: how many environment steps they had, over all worlds.
      assistance: what is carried in the worlds.
    """

    assistance: Assistance
    samples: list[Sample]
    rollouts: int = 0
    steps: int = 0

    def _setup_logdir(self) -> None:
        # Otherwise RLlib makes a folder in the home, and leaves it there empty.
        self._scratch = tempfile.TemporaryDirectory()
        self._logdir = self._scratch.name

    def training_step(self) -> None:
        """Collect a rollout from all runners that live, and learn from it."""
        self.samples = self.collect()
        if not self.samples:
            return
        steps = sum(sample.steps for sample in self.samples)
        batches = {name: SampleBatch(rows) for name, rows in join(self.samples).items()}
        rows = max(len(batch) for batch in batches.values())
        minibatches = max(1, round(rows / self.config.minibatch_size))
        with _seeded(self.config.env_config["job"].seed, self.rollouts):
            for batch in batches.values():
                batch.shuffle()
            results = self.learner_group.update(
                batch=MultiAgentBatch(batches, steps),
                num_epochs=self.config.num_epochs,
                minibatch_size=-(-rows // minibatches),
                shuffle_batch_per_epoch=True,
            )
        self.rollouts += 1
        self.steps += steps
        self.assistance.adapt(
            [row for sample in self.samples for row in sample.episodes]
        )
        self.metrics.aggregate(results, key=LEARNER_RESULTS)
        for name, reduce in (
            (NUM_ENV_STEPS_SAMPLED, "sum"),
            (NUM_ENV_STEPS_SAMPLED_LIFETIME, "lifetime_sum"),
        ):
            self.metrics.log_value((ENV_RUNNER_RESULTS, name), steps, reduce=reduce)

    def restore_env_runners(self, env_runner_group: EnvRunnerGroup) -> list[int]:
        """Bring runners back that were lost; they get their weights when they collect.

        Returns:
          Which ones are back.
        """
        if not env_runner_group.num_remote_env_runners():
            return []
        return env_runner_group.probe_unhealthy_env_runners()

    @property
    def learner(self) -> RLlibLearner:
        """The learner, which is in this process."""
        learners = self.learner_group.foreach_learner(lambda learner: learner)
        return learners.result_or_errors[0].get()

    def on_runners(self, call: Any) -> list[Any]:
        """Return what `call` returns for each runner that lives.

        Raises:
          RuntimeError: if it raises in one of them.
        """
        group = self.env_runner_group
        if not group.num_remote_env_runners():
            return [call(group.local_env_runner)]
        results = group.foreach_env_runner(
            partial(_try, call), local_env_runner=False, timeout_seconds=None
        )
        for result in results:
            if isinstance(result, Exception):
                raise RuntimeError(f"a runner failed: {result!r}") from result
        return results

    def collect(self) -> list[Sample]:
        """Return a rollout of each runner that lives."""
        state = ray.put(self.learner.module.get_state())
        return self.on_runners(partial(_sample, state, self.rollouts, self.assistance))


class RLlibBackend:
    """RLlib's PPO, with worlds in this process or in processes of Ray.

    A runner that is lost takes its part of a rollout with it: updates are made of what
    the others collected, until Ray has started it anew. Where all of them live, what is
    learned depends on the arguments and on torch's generator alone, which the caller
    seeds before, as for skrl.

    The learning rate is adapted after each epoch, the losses and the normalization are
    those of the backend on skrl, but minibatches are drawn otherwise.

    Args:
      task: what to learn.
      learners: who learns what.
      sizes: of the agents' spaces.
      seed: of the run.
      hyperparameters: how it learns.
      device: of torch, for the updates.
      num_threads: physics threads of a runner. 0 is one per CPU where the worlds are in
        this process, and one for each of several runners.
      num_runners: processes that collect, 0 for this one alone.
      ray_address: a running Ray cluster to join; None for one on this machine, which
        listens on loopback only and has no dashboard. If Ray is connected already, it
        is used as it is.

    Raises:
      ValueError: if there are more runners than worlds, or than CPUs in the cluster.
      ConnectionError: if there is no such cluster.
    """

    def __init__(
        self,
        task: Task,
        learners: Sequence[Learner],
        sizes: Sizes,
        seed: int,
        hyperparameters: Hyperparameters,
        device: str = "cpu",
        num_threads: int = 0,
        num_runners: int = 0,
        ray_address: str | None = None,
    ):
        if num_runners > hyperparameters.num_envs:
            raise ValueError(
                f"{num_runners} runners cannot share {hyperparameters.num_envs} worlds;"
                " give more num_envs or fewer num_runners"
            )
        self.steps = 0
        self._learners = tuple(learners)
        threads = num_threads or (1 if num_runners else 0)
        job = Job(
            _pickled(task), tuple(learners), sizes, seed, hyperparameters, threads
        )
        self._has_started_ray = connect(ray_address, num_runners)
        try:
            _check_room(num_runners)
            self._algorithm: TeamPPO = _config(job, num_runners, device).build_algo()
            self._algorithm.assistance = Assistance(hyperparameters.assistance)
        except BaseException:
            self._disconnect()
            raise

    def advance(self) -> Iteration:
        """Collect one rollout in every world, and learn from it.

        Raises:
          RuntimeError: if the task fails in a runner, or no runner has answered for
            five minutes.
        """
        since = time.monotonic()
        while True:
            results = self._algorithm.train()
            samples = self._algorithm.samples
            if samples:
                break
            if time.monotonic() - since > _PATIENCE:
                raise RuntimeError(f"no runner has answered for {_PATIENCE:.0f} s")
            time.sleep(1.0)
        self.steps = self._algorithm.steps
        samples.sort(key=lambda sample: sample.runner)
        return Iteration(
            [row for sample in samples for row in sample.episodes],
            {
                name: {
                    each: float(results[LEARNER_RESULTS][name][each])
                    for each in _NUMBERS
                }
                for name in self._modules()
            },
        )

    def collect(self) -> int:
        """Collect a rollout, learn nothing from it, and return how many steps it had.

        It is how fast the runners are; the worlds go on.
        """
        return sum(sample.steps for sample in self._algorithm.collect())

    def weights(self) -> dict[str, Weights]:
        """Return what the networks have learned so far, by name."""
        found: dict[str, Weights] = {}
        for module in self._modules().values():
            found |= module.weights()
        return found

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on, bit for bit where no runner is lost."""
        worlds = self._algorithm.on_runners(_get_worlds)
        learner = self._algorithm.learner
        return {
            "steps": self.steps,
            "rollouts": self._algorithm.rollouts,
            "assistance": self._algorithm.assistance.share,
            "modules": {
                name: module.state_dict() for name, module in self._modules().items()
            },
            "optimizers": {
                name: learner.get_optimizer(name).state_dict()
                for name in self._modules()
            },
            "worlds": {str(index): state for index, state in worlds if state},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        With another number of runners than it had, the worlds begin new episodes.
        """
        self.steps = self._algorithm.steps = state["steps"]
        self._algorithm.rollouts = state["rollouts"]
        self._algorithm.assistance.share = state["assistance"]
        for name, module in self._modules().items():
            module.load_state_dict(state["modules"][name])
            optimizer = self._algorithm.learner.get_optimizer(name)
            optimizer.load_state_dict(state["optimizers"][name])
        self._algorithm.on_runners(partial(_set_worlds, state["worlds"]))

    def close(self) -> None:
        """Stop the runners, and Ray if it was started here."""
        self._algorithm.stop()
        self._disconnect()

    def _modules(self) -> dict[str, TeamModule]:
        modules = self._algorithm.learner.module
        names = [each.name for each in self._learners]
        return {name: modules[name].unwrapped() for name in names}

    def _disconnect(self) -> None:
        if self._has_started_ray:
            ray.shutdown()


_NUMBERS = (
    "policy_loss",
    "value_loss",
    "entropy_loss",
    "std",
    "kl",
    "learning_rate",
    "weight_norm",
)
"""What an update reports of each learner."""


def _config(job: Job, num_runners: int, device: str) -> PPOConfig:
    numbers = job.hyperparameters
    names = [learner.name for learner in job.learners]
    # RLlib sets the level only after it has said that this is its new API.
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    config = PPOConfig(algo_class=TeamPPO)
    config.environment(RLlibEnv, env_config={"job": job})
    config.framework("torch")
    config.env_runners(
        env_runner_cls=BatchedEnvRunner,
        num_env_runners=num_runners,
        rollout_fragment_length=numbers.rollout_steps,
        merge_env_runner_states=False,
        broadcast_env_runner_states=False,
    )
    gpus = 1 if torch.device(device).type == "cuda" else 0
    config.learners(num_learners=0, num_gpus_per_learner=gpus)
    config.multi_agent(
        # In order, since it is also the order in which weights are drawn.
        policies=dict.fromkeys(names, PolicySpec()),
        policy_mapping_fn=lambda agent, episode: names[0],
    )
    config.rl_module(rl_module_spec=_modules_spec(job))
    config.training(
        learner_class=TeamPPOLearner,
        lr=numbers.learning_rate,
        num_epochs=numbers.epochs,
        minibatch_size=numbers.minibatch_size,
        train_batch_size_per_learner=max(
            numbers.steps_per_update, numbers.minibatch_size
        ),
        grad_clip=numbers.max_grad_norm or None,
        grad_clip_by="global_norm",
        use_kl_loss=False,
    )
    config.fault_tolerance(
        restart_failed_env_runners=True,
        delay_between_env_runner_restarts_s=0.0,
        env_runner_health_probe_timeout_s=_PROBE,
    )
    config.debugging(log_level="ERROR")
    return config


def _modules_spec(job: Job) -> MultiRLModuleSpec:
    numbers = job.hyperparameters
    specs = {}
    for learner in job.learners:
        observations, actions = job.spaces(learner)
        specs[learner.name] = RLModuleSpec(
            module_class=TeamModule,
            observation_space=observations,
            action_space=actions,
            model_config={
                "learner": learner,
                "sizes": job.sizes,
                "hyperparameters": numbers,
            },
        )
    return MultiRLModuleSpec(rl_module_specs=specs)


def connect(address: str | None, num_runners: int) -> bool:
    """Connect to Ray unless it is connected; return whether that was needed."""
    if ray.is_initialized():
        return False
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is not None:
        ray.init(address, **quiet)
        return True
    # Without it Ray tells its makers what it is used for.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # It warns of runners whose configuration might be lost; RLlib keeps it.
    os.environ.setdefault("RAY_BACKEND_LOG_LEVEL", "fatal")
    with on_loopback():
        # "local", because None joins a cluster that happens to run on this machine.
        ray.init(
            "local",
            num_cpus=max(cores(), num_runners + 1),
            include_dashboard=False,
            _node_ip_address="127.0.0.1",
            **quiet,
        )
    return True


def _check_room(num_runners: int) -> None:
    """Raise ValueError where Ray would wait without end for CPUs."""
    cpus = int(ray.cluster_resources().get("CPU", 0))
    if num_runners > cpus:
        raise ValueError(
            f"{num_runners} runners need a CPU each, but Ray has {cpus}; give fewer"
            " num_runners or join a larger cluster"
        )


@contextmanager
def on_loopback() -> Iterator[None]:
    """Let what is started of Ray meanwhile listen on loopback alone.

    `ray.init` replaces a `_node_ip_address` of 127.0.0.1 by an outer one, and then
    listens on all interfaces, unless clusters are off, as on macOS they are.
    """
    allowed = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = allowed


def _pickled(task: Task) -> bytes:
    """Return a task for another process, with its code where that is not installed."""
    classes = (*type(task).__mro__, type(task.config))
    modules = {sys.modules[each.__module__] for each in classes}
    own = [module for module in modules if not _is_installed(module)]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        return cloudpickle.dumps(task)
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def _is_installed(module: ModuleType) -> bool:
    if module.__name__.startswith("collaborative_gym."):
        return True
    file = getattr(module, "__file__", None)
    paths = sysconfig.get_paths()
    installed = tuple(paths[name] for name in ("stdlib", "purelib", "platlib"))
    return file is None or file.startswith(installed)


@contextmanager
def _seeded(*seeds: int) -> Iterator[None]:
    """Seed NumPy's global generator, which RLlib shuffles by, and then restore it."""
    before = np.random.get_state()
    np.random.seed(np.random.SeedSequence(seeds).generate_state(8))
    try:
        yield
    finally:
        np.random.set_state(before)


def _try(call: Any, runner: BatchedEnvRunner) -> Any:
    """Return what `call` returns, or its exception.

    RLlib ends a runner in which anything is raised, and starts it anew without end.
    """
    try:
        return call(runner)
    except Exception as error:
        return error


def _sample(
    state: Any, iteration: int, assistance: Assistance, runner: BatchedEnvRunner
) -> Sample:
    return runner.sample(
        iteration=iteration, weights=ray.get(state), assistance=assistance
    )


def _get_worlds(runner: BatchedEnvRunner) -> tuple[int, dict[str, Any] | None]:
    return runner.index, runner.get_worlds()


def _set_worlds(worlds: dict[str, Any], runner: BatchedEnvRunner) -> None:
    if len(worlds) == runner.num_runners and str(runner.index) in worlds:
        runner.set_worlds(worlds[str(runner.index)])
