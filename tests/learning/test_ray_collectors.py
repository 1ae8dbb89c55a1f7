"""Collectors in processes of Ray: what they bring, how they resume and survive."""

import os
import signal
import socket
import subprocess
import sys
import time
from copy import deepcopy

import numpy as np
import pytest
import torch

import collaborative_gym as cg

pytest.importorskip("ray")

import psutil
import ray
from ray.cluster_utils import Cluster

from collaborative_gym import plugins
from collaborative_gym.envs.world import World
from collaborative_gym.learning.collector import Job
from collaborative_gym.learning.config import Resources
from collaborative_gym.learning.ray_collectors import (
    RayCollectors,
    _pickled,
    connect,
)
from collaborative_gym.learning.run import Run
from collaborative_gym.learning.settings import make_settings
from collaborative_gym.learning.team import make_learners
from collaborative_gym.tasks import registry
from collaborative_gym.tasks.registry import as_task

TASK = """
from beside import MOST
from collaborative_gym.tasks.poke import Poke
from collaborative_gym.tasks.registry import register_task

class Own(Poke):
    most = MOST

register_task("OwnForRay", Own)
"""


@pytest.fixture(scope="module")
def local_ray():
    """Start Ray as a run does, once for the tests that need nothing of it."""
    connect(None, num_cpus=3)
    yield
    ray.shutdown()


@pytest.fixture
def make_job(carry, tiny):
    """Return a function that makes a job of six worlds of the small task."""

    def make_job(task=None, num_envs=6, seed=0):
        task = task or carry()
        sizes = World.of(task).definition.layout
        numbers = tiny(num_envs=num_envs, rollout_steps=5)
        return Job(task, make_learners("collaborative", sizes), sizes, seed, numbers)

    return make_job


@pytest.fixture
def make(carry, tiny, undrawn, tmp_path):
    """Return a function that makes a run with collectors of Ray, or its own."""
    made = []

    def make(count=2, task=None, address=None):
        task = task or carry()
        settings = make_settings(
            task,
            None,
            mode="collaborative",
            seed=0,
            backend="ray" if count else None,
            hyperparameters=tiny(num_envs=6, rollout_steps=5),
        )
        resources = Resources(num_collectors=count, ray_address=address)
        torch.manual_seed(0)
        folder = tmp_path / f"{len(made)}"
        made.append(Run(folder, task, settings=settings, resources=resources))
        return made[-1]

    with torch.random.fork_rng():
        yield make
    for run in made:
        run.close()  # More than once does no harm.


def advance_until(run, is_enough, most=200):
    """Return the steps of each update, and all episodes, until enough is done."""
    steps, episodes = [], []
    while not is_enough(steps):
        assert len(steps) < most
        before = run.steps
        iteration = run.advance()
        steps.append(run.steps - before)
        episodes += iteration.episodes
        for numbers in iteration.updates.values():
            assert np.isfinite(list(numbers.values())).all()
    return steps, episodes


def collectors_processes():
    """Return the processes of Ray's that collect."""
    found = psutil.Process().children(recursive=True)
    return [each for each in found if "ray::_Process" in " ".join(each.cmdline())]


@pytest.mark.slow
@pytest.mark.usefixtures("local_ray")
def test_a_run_goes_on_bit_for_bit_with_as_many_and_anew_with_others(
    make, tmp_path, same
):
    first = make()
    assert first.advance() and first.steps == 30
    torch.save(first.state_dict(), tmp_path / "state.pt")
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    expected = [first.advance() for _ in range(3)]
    last = deepcopy(first.state_dict())
    first.load_state_dict(state)
    found = [first.advance() for _ in range(3)]
    assert [each.updates for each in found] == [each.updates for each in expected]
    # As text, in which NaN is NaN.
    assert str(found) == str(expected)
    assert same(first.state_dict()["learners"], last["learners"])
    first.close()
    other = make(count=0)
    other.load_state_dict(state)
    assert same(other.state_dict()["learners"], state["learners"])
    other.advance()
    assert other.steps == 60


@pytest.mark.slow
@pytest.mark.usefixtures("local_ray")
def test_a_killed_collector_is_replaced_and_an_error_of_the_task_raised_here(
    make, carry, tmp_path
):
    task, broken = carry(), tmp_path / "broken"
    task.disturb = lambda sim, step: 1 / (not broken.exists())
    run = make(task=task)
    _, before = advance_until(run, lambda steps: len(steps) == 4)
    os.kill(collectors_processes()[0].pid, signal.SIGKILL)
    steps, after = advance_until(
        run, lambda steps: 15 in steps and steps[-3:] == [30, 30, 30]
    )
    assert set(steps) <= {15, 30}
    played = [row["episode"] for row in before + after]
    assert len(set(played)) == len(played)
    listening = [
        connection.laddr
        for process in (psutil.Process(), *psutil.Process().children(recursive=True))
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    addresses = {address.ip for address in listening}
    assert addresses and addresses <= {"127.0.0.1", "::1", "::ffff:127.0.0.1"}
    assert 8265 not in {address.port for address in listening}  # The dashboard's.
    broken.touch()
    with pytest.raises(RuntimeError, match="a collector failed: ZeroDivisionError"):
        run.advance()


@pytest.mark.slow
@pytest.mark.usefixtures("local_ray")
def test_there_is_a_world_and_a_cpu_for_each_collector(make_job):
    with pytest.raises(ValueError, match="7 collectors cannot share 6 worlds"):
        RayCollectors(make_job(), 7)
    with pytest.raises(ValueError, match="5 collectors need 5 CPUs, but Ray has 3"):
        RayCollectors(make_job(), 5)


def test_an_address_that_does_not_answer_is_told_soon(make_job):
    since = time.monotonic()
    with pytest.raises(
        ConnectionError, match=r"no Ray cluster answers at 127\.0\.0\.1:1 "
    ):
        RayCollectors(make_job(), 2, "127.0.0.1:1")
    for address in ("here", "127.0.0.1:", "127.0.0.1:x"):
        with pytest.raises(ValueError, match="ray_address must be HOST:PORT"):
            RayCollectors(make_job(), 2, address)
    assert time.monotonic() - since < 20


@pytest.mark.slow
def test_who_listens_but_is_no_ray_is_told_soon(make_job):
    since = time.monotonic()
    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        pytest.raises(ConnectionError, match="gave no answer of Ray in 12 s"),
    ):
        RayCollectors(make_job(), 2, f"127.0.0.1:{silent.getsockname()[1]}")
    assert time.monotonic() - since < 60  # Alone it is 12 s.


def test_a_users_task_travels_with_the_modules_beside_it(
    make_job, tmp_path, monkeypatch
):
    # Else processes that later tests start would look for files that are gone.
    monkeypatch.setattr(plugins, "_loaded", {})
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "beside.py").write_text("MOST = 7\n")
    (tmp_path / "own_for_ray.py").write_text(TASK)
    module = cg.load_module(str(tmp_path / "own_for_ray.py"))
    poke = as_task("PokeTaskSawyers-v0")
    task = module.Own(tuple(poke.robots.values()), poke.config)
    (tmp_path / "job").write_bytes(_pickled(make_job(task)))
    for source in tmp_path.glob("*.py"):
        source.unlink()
    code = (
        "import cloudpickle, sys;"
        "job = cloudpickle.load(open(sys.argv[1], 'rb'));"
        "print(type(job.task).__name__, job.task.most)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "job")]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["Own", "7"]


@pytest.fixture
def two_nodes(local_ray):
    """Return a cluster of two nodes with one processor each, instead of this Ray's."""
    ray.shutdown()
    node = {"num_cpus": 1, "node_ip_address": "127.0.0.1"}
    cluster = Cluster(
        initialize_head=True, head_node_args={**node, "include_dashboard": False}
    )
    cluster.add_node(**node)
    yield cluster
    ray.shutdown()
    cluster.shutdown()
    connect(None, num_cpus=3)


@pytest.mark.slow
def test_a_run_outlives_a_node_of_its_cluster(make, two_nodes):
    run = make(count=2, address=two_nodes.address)
    advance_until(run, lambda steps: len(steps) == 2)
    (other,) = two_nodes.worker_nodes
    two_nodes.remove_node(other, allow_graceful=False)
    steps, _ = advance_until(run, lambda steps: len(steps) == 3)
    assert steps[-1] == 15
    two_nodes.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    advance_until(run, lambda steps: steps[-2:] == [30, 30], most=10_000)
    run.close()


@pytest.mark.slow
@pytest.mark.usefixtures("local_ray")
def test_guests_sit_in_collectors_elsewhere(train_tiny, duel, tiny):
    numbers = tiny(num_envs=14, league_least_steps=20, league_most_steps=60)
    options = {"task": duel, "opponent": ["league", "idle"], "backend": "ray"}
    options |= {"hyperparameters": numbers}
    result = train_tiny(**options, resources=Resources(num_collectors=2))
    assert (result.folder / "players" / "main-1.safetensors").exists()
    with pytest.raises(ValueError, match="4 worlds are too few for 7 teams"):
        train_tiny(
            **options,
            resources=Resources(num_collectors=3),
            output=result.folder.parent / "few",
        )
