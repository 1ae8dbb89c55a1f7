"""The RLlib backend: what it learns, how it resumes, and what it survives."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg

pytest.importorskip("ray")

import psutil
import ray
import torch
from ray._private import ray_constants
from ray.cluster_utils import Cluster

from collaborative_gym.learning.config import MODES, Hyperparameters
from collaborative_gym.learning.rllib_backend import (
    RLlibBackend,
    connect,
)
from collaborative_gym.learning.rllib_learner import Normalization
from collaborative_gym.learning.rllib_runner import estimate_advantages
from collaborative_gym.learning.team import Sizes, make_learners
from collaborative_gym.policies.network import NetworkPolicy

pytestmark = pytest.mark.slow

SMALL = Hyperparameters(
    num_envs=6, rollout_steps=5, minibatch_size=16, epochs=2, hidden_sizes=(16, 16)
)
LENGTH = 12


@pytest.fixture(scope="module")
def local_ray():
    """Start Ray as a backend does, once for the tests that need nothing of it."""
    connect(None, num_runners=2)
    yield
    ray.shutdown()


@pytest.fixture
def backends(carry):
    """Return a function that makes a backend for the small task."""
    made = []

    def make(mode="collaborative", numbers=SMALL, task=None, seed=0, **options):
        task = task or carry(max_episode_steps=LENGTH)
        env = cg.VectorEnv(task, 1)
        sizes = Sizes(
            *(
                {agent: space.shape[0] for agent, space in spaces.items()}
                for spaces in (env.single_observation_spaces, env.single_action_spaces)
            ),
            task.gripping,
        )
        torch.manual_seed(seed)
        learners = make_learners(mode, sizes)
        backend = RLlibBackend(task, learners, sizes, seed, numbers, **options)
        made.append(backend)
        backend.sizes = sizes
        backend.parts = [part for learner in learners for part in learner.parts]
        return backend

    yield make
    for backend in made:
        backend.close()  # More than once does no harm.


def arrays(backend):
    """Return all that the policy has learned."""
    weights = backend.weights().values()
    return [
        array
        for each in weights
        for array in (each.mean, each.std, *(a for pair in each.layers for a in pair))
    ]


def kill_runner(backend, which=1):
    pids = backend._algorithm.on_runners(lambda runner: (runner.index, os.getpid()))
    os.kill(dict(pids)[which], signal.SIGKILL)


def advance_until(backend, is_enough, most=60):
    """Return the steps of each update, and all episodes, until enough is done."""
    steps, episodes = [], []
    while not is_enough(steps):
        assert len(steps) < most
        before = backend.steps
        iteration = backend.advance()
        steps.append(backend.steps - before)
        episodes += iteration.episodes
        for numbers in iteration.numbers.values():
            assert np.isfinite(list(numbers.values())).all()
    return steps, episodes


def test_advantages_count_on_beyond_an_end_by_time_but_not_into_the_next_episode():
    rewards = np.array([[1.0], [2.0], [3.0]])
    values = np.array([[10.0], [20.0], [30.0]])
    # After the second step an episode ends, whose last observation is worth 7.
    next_values = np.array([[20.0], [7.0], [40.0]])
    ended = np.array([[False], [True], [False]])
    found = estimate_advantages(rewards, values, next_values, ended, 0.5, 0.8)
    last = 3.0 + 0.5 * 40.0 - 30.0
    second = 2.0 + 0.5 * 7.0 - 20.0
    first = 1.0 + 0.5 * 20.0 - 10.0 + 0.5 * 0.8 * second
    np.testing.assert_allclose(found[:, 0], [first, second, last])


def test_normalization_has_the_moments_of_all_it_saw():
    rows = torch.from_numpy(np.random.default_rng(0).normal(3.0, 2.0, (5000, 2)))
    normalization = Normalization(2)
    for part in rows.split(1000):
        normalization.watch(part)
    torch.testing.assert_close(normalization.mean, rows.mean(0), rtol=1e-3, atol=0)
    torch.testing.assert_close(normalization.std, rows.std(0), rtol=1e-3, atol=0)
    shown = rows[:3].float()
    torch.testing.assert_close(normalization.restore(normalization(shown)), shown)


@pytest.mark.usefixtures("local_ray")
@pytest.mark.parametrize("mode", MODES)
def test_every_mode_learns_and_exports_what_it_learned(backends, mode):
    backend = backends(mode)
    before = arrays(backend)
    steps, episodes = advance_until(backend, lambda steps: len(steps) == 5)
    assert steps == [30] * 5
    assert all(
        not np.array_equal(*pair) for pair in zip(before, arrays(backend), strict=True)
    )
    assert episodes
    for row in episodes:
        assert row["length"] == LENGTH
        assert row["return"] == pytest.approx(
            row["robot_1/return"] + row["robot_2/return"]
        )
    facts = {"action_sizes": backend.sizes.action}
    policy = NetworkPolicy(backend.parts, backend.weights(), "relu", facts)
    rng = np.random.default_rng(0)
    observations = {
        agent: rng.normal(size=(20, size)).astype(np.float32)
        for agent, size in backend.sizes.observation.items()
    }
    for learner in backend._algorithm.config.env_config["job"].learners:
        module = backend._modules()[learner.name]
        rows = torch.from_numpy(learner.observations(observations))
        found = module.forward_inference({"obs": rows})["action_dist_inputs"]
        mean = found.chunk(2, dim=1)[0].clamp(-1, 1).numpy()
        expected = learner.actions(mean, backend.sizes)
        for agent in learner.agents:
            np.testing.assert_allclose(
                policy(observations)[agent], expected[agent], atol=1e-5
            )


@pytest.mark.usefixtures("local_ray")
def test_in_mode_collaborative_a_robot_acts_on_its_own_observation(backends):
    module = backends()._modules()["team"]
    rows = torch.zeros(1, 38)
    changed = rows.clone()
    changed[0, 19:] = 1.0
    first, second = (
        module.forward_inference({"obs": each})["action_dist_inputs"]
        for each in (rows, changed)
    )
    assert torch.equal(first[:, :8], second[:, :8])
    assert not torch.equal(first[:, 8:16], second[:, 8:16])
    values = [module.compute_values({"obs": each}) for each in (rows, changed)]
    assert not torch.equal(*values)


@pytest.mark.usefixtures("local_ray")
@pytest.mark.parametrize("num_runners", [0, 2])
def test_a_resumed_run_goes_on_bit_for_bit(backends, tmp_path, num_runners):
    first = backends(num_runners=num_runners)
    first.advance()
    torch.save(first.state_dict(), tmp_path / "state.pt")
    expected = [first.advance() for _ in range(3)]
    first.close()
    second = backends(num_runners=num_runners)
    second.advance()
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    second.load_state_dict(state)
    assert second.steps == 30
    found = [second.advance() for _ in range(3)]
    assert [each.numbers for each in found] == [each.numbers for each in expected]
    # As text, in which NaN is NaN.
    assert str(found) == str(expected)
    for one, other in zip(arrays(first), arrays(second), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("local_ray")
def test_a_run_may_resume_with_other_runners(backends):
    first = backends(num_runners=2)
    first.advance()
    second = backends(num_runners=1)
    second.load_state_dict(first.state_dict())
    for one, other in zip(arrays(first), arrays(second), strict=True):
        np.testing.assert_array_equal(one, other)
    second.advance()
    assert second.steps == 60


@pytest.mark.usefixtures("local_ray")
def test_the_grips_noise_is_its_own_and_lasts(backends):
    numbers = replace(
        SMALL,
        grip_persistence=0.9,
        initial_std=0.1,
        initial_grip_std=0.8,
        num_envs=200,
    )
    backend = backends(numbers=numbers)
    (sample,) = backend._algorithm.collect()
    rows = sample.rows["team"]["actions"].reshape(5, 200, 16)
    # At first all means are near zero.
    std = np.full(16, 0.1)
    std[[7, 15]] = 0.8
    np.testing.assert_allclose(rows.std((0, 1)), std, rtol=0.15)
    for column in range(16):
        found = np.corrcoef(rows[:-1, :, column].ravel(), rows[1:, :, column].ravel())
        lasts = 0.9 if column in (7, 15) else 0.0
        assert found[0, 1] == pytest.approx(lasts, abs=0.1)


@pytest.mark.usefixtures("local_ray")
def test_a_loss_that_is_not_finite_is_told(backends):
    backend = backends()
    with torch.no_grad():
        backend._modules()["team"].critic[0].weight.fill_(torch.nan)
    assert np.isnan(backend.advance().numbers["team"]["value_loss"])


@pytest.mark.usefixtures("local_ray")
def test_it_learns(backends, carry):
    numbers = Hyperparameters(
        num_envs=64, rollout_steps=12, minibatch_size=256, hidden_sizes=(32,)
    )
    backend = backends(task=carry(max_episode_steps=LENGTH), numbers=numbers)
    returns = [
        np.mean([row["return"] for row in backend.advance().episodes] or [np.nan])
        for _ in range(30)
    ]
    assert np.nanmean(returns[-5:]) > np.nanmean(returns[:5]) + 0.5


@pytest.mark.usefixtures("local_ray")
def test_a_killed_runner_is_replaced(backends):
    backend = backends(num_runners=2)
    _, before = advance_until(backend, lambda steps: len(steps) == 4)
    kill_runner(backend)
    steps, after = advance_until(
        backend, lambda steps: 15 in steps and steps[-3:] == [30, 30, 30]
    )
    assert set(steps) <= {15, 30}
    assert backend.steps == 120 + sum(steps)
    played = [row["episode"] for row in before + after]
    assert len(set(played)) == len(played)
    for array in arrays(backend):
        assert np.isfinite(array).all()


@pytest.mark.usefixtures("local_ray")
def test_an_error_of_the_task_is_raised_here(backends):
    def measure(sim):
        raise ZeroDivisionError("for a test")

    backend = backends(num_runners=2)
    backend.advance()
    backend._algorithm.on_runners(
        lambda runner: setattr(runner.env.task, "measure", measure)
    )
    with pytest.raises(RuntimeError, match="a runner failed: ZeroDivisionError"):
        backend.advance()


@pytest.mark.usefixtures("local_ray")
def test_there_is_a_world_and_a_cpu_for_each_runner(backends):
    with pytest.raises(ValueError, match="7 runners cannot share 6 worlds"):
        backends(num_runners=7)
    with pytest.raises(ValueError, match="5 runners need a CPU each, but Ray has 3"):
        backends(num_runners=5)


@pytest.fixture
def two_nodes(local_ray, monkeypatch):
    """Return a cluster of two nodes with one processor each, instead of this Ray's."""
    ray.shutdown()
    monkeypatch.setattr(ray_constants, "ENABLE_RAY_CLUSTER", False)
    node = {"num_cpus": 1, "node_ip_address": "127.0.0.1"}
    cluster = Cluster(
        initialize_head=True, head_node_args={**node, "include_dashboard": False}
    )
    cluster.add_node(**node)
    yield cluster
    ray.shutdown()
    cluster.shutdown()
    connect(None, num_runners=2)


def test_a_run_outlives_a_node_of_its_cluster(backends, two_nodes):
    backend = backends(num_runners=2, ray_address=two_nodes.address)
    advance_until(backend, lambda steps: len(steps) == 2)
    (other,) = two_nodes.worker_nodes
    two_nodes.remove_node(other, allow_graceful=False)
    steps, _ = advance_until(backend, lambda steps: len(steps) == 3)
    assert steps[-1] == 15
    two_nodes.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    steps, _ = advance_until(backend, lambda steps: steps[-2:] == [30, 30])
    backend.close()


@pytest.mark.usefixtures("local_ray")
def test_ray_listens_on_loopback_alone(backends):
    backend = backends(num_runners=2)
    backend.advance()
    here = psutil.Process()
    listening = [
        connection.laddr
        for process in (here, *here.children(recursive=True))
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    addresses = {address.ip for address in listening}
    assert addresses and addresses <= {"127.0.0.1", "::1", "::ffff:127.0.0.1"}
    assert 8265 not in {address.port for address in listening}  # The dashboard's.
