"""Collectors in processes of Ray, on this machine or on many."""

import logging
import os
import socket
import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import torch

from collaborative_gym.errors import how_to_install

# Ray reads these as it is imported. With clusters, which on macOS are off, the Ray that
# it starts would listen on all interfaces. Others can be joined all the same.
os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
# No statistics for its makers.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

try:
    import ray
    from ray.exceptions import ActorDiedError, RayError, RayTaskError
except ImportError as error:
    raise ImportError(
        f"the backend ray needs {error.name}, which is not installed;"
        f" {how_to_install('ray')}"
    ) from error

from collaborative_gym.evaluation.machine import cores
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.collector import ActorState, Collected, Collector, Job
from collaborative_gym.learning.guests import NOBODY, Invitation
from collaborative_gym.plugins import loaded_files

_PATIENCE = 300.0  # seconds to wait for any collector if all are lost or starting
_PROBE = 5.0  # seconds that a machine has to accept a connection

_HEALTH = 12.0
"""Seconds that a cluster then has to answer; a process must start that asks it."""


class RayCollectors:
    """Collectors that share a run's worlds, each in a process of its own.

    If a collector is lost, alone or with its node, its part of a rollout is lost too.
    It is started anew as soon as there is a CPU for it, and the others go on meanwhile.
    If none is lost, the rollouts depend only on the arguments.

    Args:
      job: what all collectors share; each has `num_threads` threads, or one for 0.
      count: how many collectors, 0 for as many as there are CPUs for.
      address: a running Ray cluster to join, as HOST:PORT; None for one of its own,
        which listens on loopback only and has no dashboard. If Ray is connected
        already, it is used as it is.

    Attributes:
      count: how many there are.

    Raises:
      ConnectionError: if there is no such cluster.
      RuntimeError: if the task cannot be made in a collector.
      ValueError: if there are more collectors than worlds, or than CPUs for them.
    """

    def __init__(self, job: Job, count: int = 0, address: str | None = None):
        num_envs = job.hyperparameters.num_envs
        if count > num_envs:
            raise ValueError(
                f"{count} collectors cannot share {num_envs} worlds; give more num_envs"
                " or fewer num_collectors"
            )
        threads = job.num_threads or 1
        self._ready: dict[int, Any] = {}
        self._starting: dict[Any, tuple[int, Any]] = {}
        self._has_started_ray = connect(address, count * threads)
        try:
            cpus = int(ray.cluster_resources().get("CPU", 0))
            self.count = count or min(num_envs, max(1, cpus // threads))
            if self.count * threads > cpus:  # Ray would wait for them without end.
                raise ValueError(
                    f"{self.count} collectors need {self.count * threads} CPUs, but Ray"
                    f" has {cpus}; give fewer num_collectors or num_threads, or join a"
                    " larger cluster"
                )
            job.casting.check(num_envs // self.count)
            self._job = _pickled(replace(job, num_threads=threads))
            self._process = ray.remote(num_cpus=threads)(_Process)
            for index in range(self.count):
                self._start(index)
            self._welcome(self.count, _PATIENCE)
        except BaseException:
            self.close()
            raise

    def collect(
        self,
        actors: Mapping[str, ActorState],
        iteration: int,
        assistance: Assistance,
        invitation: Invitation = NOBODY,
    ) -> list[Collected]:
        """Return one rollout of every collector that is alive.

        Raises:
          RuntimeError: if the task fails, or no collector answers for five minutes.
        """
        given, invited = ray.put(actors), ray.put(invitation)
        self._welcome(0, 0.0)
        while True:
            if not self._ready:
                self._welcome(1, _PATIENCE)
            if not self._ready:
                raise RuntimeError(f"no collector has answered for {_PATIENCE:.0f} s")
            each = given, iteration, assistance, invited
            found = self._answers("collect", dict.fromkeys(self._ready, each))
            if found:
                return [one for each in found.values() for one in each]

    def state_dict(self) -> dict[str, Any]:
        """Return the state of each collector's worlds, empty for lost ones."""
        found = {str(index): {} for index in range(self.count)}
        answers = self._answers("state_dict", dict.fromkeys(self._ready, ()))
        for each in answers.values():
            found |= each
        return found

    def load_state_dict(self, states: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        own = {i: ({str(i): states[str(i)]},) for i in self._ready}
        self._answers("load_state_dict", own)

    def close(self) -> None:
        """Stop the collectors, and Ray if it was started here."""
        starting = (actor for _, actor in self._starting.values())
        for actor in (*self._ready.values(), *starting):
            ray.kill(actor)
        self._ready, self._starting = {}, {}
        if self._has_started_ray:
            ray.shutdown()

    def _start(self, index: int) -> None:
        actor = self._process.remote(self._job, index, self.count)
        self._starting[actor.ready.remote()] = index, actor

    def _welcome(self, least: int, seconds: float) -> None:
        """Take in started collectors; wait for so many, and at most so many seconds."""
        waiting = list(self._starting)
        if not waiting:
            return
        done, _ = ray.wait(waiting, num_returns=max(1, least), timeout=seconds)
        for reference in done:
            index, actor = self._starting.pop(reference)
            try:
                ray.get(reference)
            except RayError as error:
                if isinstance(error, ActorDiedError) and error.actor_init_failed:
                    raise RuntimeError(f"a collector cannot start: {error}") from error
                self._start(index)
            else:
                self._ready[index] = actor

    def _answers(self, method: str, given: Mapping[int, tuple]) -> dict[int, Any]:
        """Call a method with arguments by collector; start lost collectors anew.

        Raises:
          RuntimeError: if it raises in one of them.
        """
        asked = {
            index: getattr(self._ready[index], method).remote(*each)
            for index, each in given.items()
        }
        found = {}
        for index, reference in asked.items():
            try:
                found[index] = ray.get(reference)
            except RayTaskError as error:
                raise RuntimeError(f"a collector failed: {error.cause!r}") from error
            except RayError:
                ray.kill(self._ready.pop(index))
                self._start(index)
        return found


class _Process(Collector):
    """A collector in a process, made of a pickled job."""

    def __init__(self, job: bytes, index: int, count: int):
        # A process for each core: more threads would only wait for one another.
        torch.set_num_threads(1)
        super().__init__(cloudpickle.loads(job), index, count)

    def ready(self) -> None:
        """Return, once the worlds are made."""


def connect(address: str | None, num_cpus: int) -> bool:
    """Connect to Ray unless it is connected; return whether that was needed.

    Raises:
      ConnectionError: if no cluster answers at the address.
      RuntimeError: if Ray was imported too early to keep it to this machine.
      ValueError: if it is not an address.
    """
    if address is not None:
        _check_answers(address)
    if ray.is_initialized():
        return False
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is not None:
        try:
            ray.init(address, **quiet)
        except (ConnectionError, RuntimeError, RayError) as error:
            # What happened is at its end, after Ray's own traceback.
            cause = str(error.__cause__ or error).strip().splitlines()[-1]
            raise ConnectionError(f"cannot join Ray at {address}: {cause}") from error
        return True
    # "local", because None joins a cluster that happens to run on this machine.
    ray.init(
        "local",
        num_cpus=max(cores(), num_cpus),
        include_dashboard=False,
        _node_ip_address="127.0.0.1",
        **quiet,
    )
    if ray.util.get_node_ip_address() != "127.0.0.1":
        ray.shutdown()
        raise RuntimeError(
            "Ray was imported before collaborative_gym.learning.ray_collectors, and"
            " would listen on all interfaces; import that first, set"
            " RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0, or call ray.init() yourself"
        )
    return True


def _check_answers(address: str) -> None:
    """Raise ConnectionError unless Ray listens there; `ray.init` waits for minutes."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise ValueError(
            f"ray_address must be HOST:PORT, such as 192.0.2.1:6379; got {address!r}"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _PROBE).close()
        # Ray's calls would wait without end for a server that accepts but is not Ray.
        command = [sys.executable, "-m", "ray.scripts.scripts", "health-check"]
        subprocess.run(
            [*command, "--address", address],
            capture_output=True,
            text=True,
            timeout=_HEALTH,
            check=True,
        )
    except subprocess.TimeoutExpired:
        cause = f"the server there gave no answer of Ray in {_HEALTH:.0f} s"
    except subprocess.CalledProcessError as error:
        cause = (error.stderr.strip().splitlines() or ["its Ray is not healthy"])[-1]
    except (OSError, OverflowError) as error:
        cause = str(error)
    else:
        return
    raise ConnectionError(
        f"no Ray cluster answers at {address} ({cause}); start one there with `ray"
        " start --head`, or leave ray_address out"
    )


def _pickled(job: Job) -> bytes:
    """Return a job for another process, with the users' code that it needs."""
    classes = (*type(job.task).__mro__, type(job.task.config))
    used = {each.__module__ for each in classes}
    folders = {str(Path(file).parent) for file in loaded_files()}
    with ExitStack() as stack:
        for name, module in list(sys.modules.items()):
            is_needed = name in used or os.path.dirname(_file(module)) in folders
            if is_needed and not _is_installed(module):
                cloudpickle.register_pickle_by_value(module)
                stack.callback(cloudpickle.unregister_pickle_by_value, module)
        return cloudpickle.dumps(job)


def _is_installed(module: ModuleType) -> bool:
    paths = sysconfig.get_paths()
    installed = tuple(paths[name] for name in ("stdlib", "purelib", "platlib"))
    is_ours = module.__name__.startswith("collaborative_gym.")
    return is_ours or not _file(module) or _file(module).startswith(installed)


def _file(module: ModuleType) -> str:
    return getattr(module, "__file__", None) or ""
