"""Collectors in processes of Ray, on this machine or on many."""

import logging
import os
import socket
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import torch

from collaborative_gym.errors import how_to_install

# Ray reads these as it is imported. Unless clusters are off, as on macOS they are, the
# Ray that it starts listens on all interfaces. Others can be joined all the same.
os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
# Otherwise Ray tells its makers how it is used.
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
from collaborative_gym.learning.collector import (
    ActorState,
    Collected,
    Collector,
    Job,
)
from collaborative_gym.learning.guests import NOBODY, Invitation
from collaborative_gym.plugins import loaded_files

_PATIENCE = 300.0
"""Seconds to wait for any collector if all are lost or starting."""

_PROBE = 5.0
"""Seconds that a machine has to accept a connection."""

_HEALTH = 12.0
"""Seconds that a cluster then has to answer, including the start of the process that
asks."""


class RayCollectors:
    """Collectors that share a run's worlds, each in a process of its own.

    If a collector is lost, alone or with its node, its part of a rollout is lost too.
    It is started anew as soon as there is a CPU for it, and the others go on meanwhile.
    If none is lost, what is collected depends only on the arguments.

    Args:
      job: what to do; of its `num_threads` each collector has as many, 0 for one.
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
            self.count = count or min(num_envs, max(1, _cpus() // threads))
            _check_room(self.count, threads)
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
        """Collect one rollout in every world of the collectors that live.

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
            found = self._ask("collect", given, iteration, assistance, invited)
            if found:
                return [one for each in found.values() for one in each]

    def state_dict(self) -> dict[str, Any]:
        """Return the state of each collector's worlds; lost ones have none."""
        found = {str(index): {} for index in range(self.count)}
        for each in self._ask("state_dict").values():
            found |= each
        return found

    def load_state_dict(self, states: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        own = {i: ({str(i): states[str(i)]},) for i in self._ready}
        self._answers("load_state_dict", own)

    def close(self) -> None:
        """Stop the collectors, and Ray if it was started here."""
        for actor in (
            *self._ready.values(),
            *(actor for _, actor in self._starting.values()),
        ):
            ray.kill(actor)
        self._ready, self._starting = {}, {}
        if self._has_started_ray:
            ray.shutdown()

    def _start(self, index: int) -> None:
        actor = self._process.remote(self._job, index, self.count)
        self._starting[actor.ready.remote()] = index, actor

    def _welcome(self, least: int, seconds: float) -> None:
        """Take in the collectors that have started; wait for so many, and so long."""
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

    def _ask(self, method: str, *given: Any) -> dict[int, Any]:
        return self._answers(method, dict.fromkeys(self._ready, given))

    def _answers(self, method: str, given: Mapping[int, tuple]) -> dict[int, Any]:
        """Return what the method returns, by collector; start lost ones anew.

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
    """A collector in a process of its own, made of a pickled job."""

    def __init__(self, job: bytes, index: int, count: int):
        # A process for each core: more threads would only wait for one another.
        torch.set_num_threads(1)
        super().__init__(cloudpickle.loads(job), index, count)

    def ready(self) -> None:
        """Answer once the worlds are made."""


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
        cause = f"what listens there said nothing that Ray knows in {_HEALTH:.0f} s"
    except subprocess.CalledProcessError as error:
        cause = (error.stderr.strip().splitlines() or ["it is not a healthy Ray"])[-1]
    except (OSError, OverflowError) as error:
        cause = str(error)
    else:
        return
    raise ConnectionError(
        f"no Ray cluster answers at {address} ({cause}); start one there with `ray"
        " start --head`, or leave ray_address out"
    )


def _cpus() -> int:
    return int(ray.cluster_resources().get("CPU", 0))


def _check_room(count: int, threads: int) -> None:
    """Raise ValueError if Ray would wait without end for CPUs."""
    if count * threads > _cpus():
        raise ValueError(
            f"{count} collectors need {count * threads} CPUs, but Ray has {_cpus()};"
            " give fewer num_collectors or num_threads, or join a larger cluster"
        )


def _pickled(job: Job) -> bytes:
    """Return a job for another process, with the users' code that it needs."""
    with _by_value(job):
        return cloudpickle.dumps(job)


@contextmanager
def _by_value(job: Job) -> Iterator[None]:
    """Pickle modules whole that are not installed, since others may not have them."""
    classes = (*type(job.task).__mro__, type(job.task.config))
    used = {each.__module__ for each in classes}
    folders = {str(Path(file).parent) for file in loaded_files()}
    own = [
        module
        for name, module in list(sys.modules.items())
        if (name in used or os.path.dirname(_file(module)) in folders)
        and not _is_installed(module)
    ]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def _is_installed(module: ModuleType) -> bool:
    paths = sysconfig.get_paths()
    installed = tuple(paths[name] for name in ("stdlib", "purelib", "platlib"))
    is_ours = module.__name__.startswith("collaborative_gym.")
    return is_ours or not _file(module) or _file(module).startswith(installed)


def _file(module: ModuleType) -> str:
    return getattr(module, "__file__", None) or ""
