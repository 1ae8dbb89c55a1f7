from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

from collaborative_gym.blocks import Block, Layout
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.collector import Job, Player
from collaborative_gym.learning.config import MODES
from collaborative_gym.learning.display import UPDATE
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners
from collaborative_gym.policies.network import ACTIVATIONS, NetworkPolicy
from collaborative_gym.tasks.identity import Identity

AGENTS = ("robot_1", "robot_2")
SIZES = Layout.of_sizes(dict.fromkeys(AGENTS, 3), dict.fromkeys(AGENTS, 2))
GRIPPING = replace(
    SIZES,
    action={a: {n: Block(n, (1,)) for n in ("moves", "grip")} for a in AGENTS},
)


@pytest.fixture(autouse=True)
def seeded():
    """Let torch draw the same in every test."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield


class Pupil(PPOLearner):
    """A learner that collects for itself."""

    def __init__(self, learner, sizes, numbers):
        super().__init__(learner, sizes, numbers, "cpu")
        job = Job(None, (learner,), sizes, 0, numbers)
        self.player = Player(learner, job, Casting().worlds(learner, numbers.num_envs))
        self.rng = np.random.default_rng(0)
        self.player.start(self.rng)
        self.record = self.player.record

    def act(self, observations, advice=None):
        self.player.load(self.acting())
        return self.player.act(observations, self.rng, advice)

    def update(self, following):
        return self.learn([self.player.finish(following)])


@pytest.fixture
def make(tiny):
    """Return a function that makes the learners of a mode."""

    def make(mode, num_envs=4, sizes=SIZES, **changes):
        numbers = tiny(num_envs=num_envs, **changes)
        return [
            Pupil(learner, sizes, numbers) for learner in make_learners(mode, sizes)
        ]

    return make


def drawn(rng, num_envs):
    """Return observations by agent, far from zero mean and unit deviation."""
    return {a: np.float32(rng.normal(3.0, 2.0, (num_envs, 3))) for a in AGENTS}


def never(num_envs):
    """Return by agent that no world ends."""
    return dict.fromkeys(AGENTS, np.zeros(num_envs, bool))


def practise(learners, updates=2, num_envs=4, rollout_steps=8):
    """Let the learners learn something from noise."""
    rng = np.random.default_rng(0)
    for _ in range(updates):
        for _ in range(rollout_steps):
            observations, following = drawn(rng, num_envs), drawn(rng, num_envs)
            rewards = {agent: np.float32(rng.normal(size=num_envs)) for agent in AGENTS}
            for learner in learners:
                learner.act(observations)
                truncated = dict.fromkeys(AGENTS, rng.random(num_envs) < 0.2)
                learner.record(rewards, following, never(num_envs), truncated)
        for learner in learners:
            learner.update(following)


def means(learners, observations):
    """Return the mean actions of torch's policies by agent."""
    found = {}
    for learner in learners:
        agent = learner._agent
        rows = torch.from_numpy(learner.learner.observations(observations))
        inputs = {"observations": agent._observation_preprocessor(rows)}
        with torch.no_grad():
            rows, _ = learner._policy.compute(inputs)
        found |= learner.learner.actions(rows.numpy(), SIZES)
    return found


def values(learner, observations):
    """Return what the critic expects in each row."""
    agent = learner._agent
    rows = torch.from_numpy(learner.learner.observations(observations))
    inputs = {"observations": agent._observation_preprocessor(rows)}
    with torch.no_grad():
        found, _ = learner._value.act(inputs, role="value")
        return agent._value_preprocessor(found, inverse=True).numpy()[:, 0]


def as_policy(learners, activation):
    """Return what NumPy runs."""
    parts = [part for learner in learners for part in learner.learner.parts]
    weights = {}
    for learner in learners:
        weights |= learner.weights()
    return NetworkPolicy(
        parts,
        weights,
        activation=activation,
        identity=Identity("", "", {}, {}, {}),
        layout=SIZES,
        metadata={},
    )


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("mode", MODES)
def test_numpy_agrees_with_torch_and_rows_with_themselves(make, mode, activation):
    learners = make(mode, activation=activation)
    practise(learners)
    observations = drawn(np.random.default_rng(1), 40)
    policy = as_policy(learners, activation)
    actions = policy(observations)
    for agent, expected in means(learners, observations).items():
        assert np.ptp(expected) > 0.0
        np.testing.assert_allclose(
            actions[agent], np.clip(expected, -1, 1), rtol=0, atol=1e-5
        )
    for i in range(40):
        alone = policy({a: rows[i : i + 1] for a, rows in observations.items()})
        assert all(np.array_equal(alone[a][0], actions[a][i]) for a in AGENTS)


@pytest.mark.parametrize(
    ("mode", "sees_other", "critic_sees_other"),
    [
        ("collaborative", False, True),
        ("independent", False, False),
        ("shared", False, False),
        ("centralized", True, True),
    ],
)
def test_who_sees_what(make, mode, sees_other, critic_sees_other):
    learners = make(mode)
    practise(learners)
    before = drawn(np.random.default_rng(1), 4)
    after = {**before, "robot_2": before["robot_2"] + 1.0}
    actions = [means(learners, each) for each in (before, after)]
    assert not np.array_equal(actions[0]["robot_2"], actions[1]["robot_2"])
    assert np.array_equal(actions[0]["robot_1"], actions[1]["robot_1"]) != sees_other
    expected = [values(learners[0], each)[:4] for each in (before, after)]
    assert np.array_equal(*expected) != critic_sees_other


def test_a_shared_policy_and_critic_know_which_robot_it_is(make):
    (learner,) = make("shared")
    practise([learner])
    rows = drawn(np.random.default_rng(1), 4)["robot_1"]
    alike = dict.fromkeys(AGENTS, rows)
    actions = means([learner], alike)
    assert not np.allclose(actions["robot_1"], actions["robot_2"])
    first, second = np.split(values(learner, alike), 2)
    assert not np.allclose(first, second)


@pytest.mark.parametrize("mode", ["collaborative", "shared"])
@pytest.mark.parametrize("is_over", [False, True])
def test_the_last_observations_value_counts_where_time_is_up_alone(make, mode, is_over):
    """Compares what the critic is taught with sums by hand."""
    discount, decay, steps, num_envs = 0.9, 0.8, 4, 2
    (learner,) = make(
        mode,
        num_envs,
        discount=discount,
        gae_lambda=decay,
        rollout_steps=steps,
        validation_interval=0,
    )
    rng = np.random.default_rng(0)
    # World 0 ends after the second step; the next observation is of another episode.
    ended = np.zeros((steps, num_envs), bool)
    ended[1, 0] = True
    observations = [drawn(rng, num_envs) for _ in range(steps)]
    final = [*observations[1:], drawn(rng, num_envs)]
    final[1] = {
        agent: np.where(ended[1][:, None], rng.normal(size=(2, 3)), rows).astype("f4")
        for agent, rows in final[1].items()
    }
    rewards = [
        {a: np.float32(rng.normal(size=num_envs)) for a in AGENTS} for _ in range(steps)
    ]
    value = np.array([values(learner, each) for each in observations])
    following = np.array([values(learner, each) for each in final])
    for t in range(steps):
        learner.act(observations[t])
        terminated = dict.fromkeys(AGENTS, ended[t] & is_over)
        # What ends as time is up is over all the same.
        learner.record(
            rewards[t], final[t], terminated, dict.fromkeys(AGENTS, ended[t])
        )
    learner.update(final[-1])
    expected, advantage = np.zeros_like(value), 0.0
    for t in reversed(range(steps)):
        over = np.resize(ended[t], len(value[t]))
        earned = learner.learner.rewards(rewards[t])
        ahead = np.where(over & is_over, 0.0, following[t])
        error = earned + discount * ahead - value[t]
        advantage = error + discount * decay * advantage * ~over
        expected[t] = advantage + value[t]
    taught = learner._agent._value_preprocessor(
        learner._memory.get_tensor_by_name("returns"), inverse=True
    )
    np.testing.assert_allclose(taught.numpy()[:, :, 0], expected, atol=1e-5)


@pytest.mark.parametrize("mode", MODES)
def test_it_learns_what_is_rewarded(make, mode):
    """Each robot is to do what its observation says: a bandit."""
    size = {"num_envs": 64, "minibatch_size": 128, "epochs": 4, "rollout_steps": 4}
    learners = make(mode, learning_rate=3e-3, **size)
    rng, earned = np.random.default_rng(0), []
    for _ in range(40):
        for _ in range(size["rollout_steps"]):
            observations = drawn(rng, 64)
            actions = {}
            for learner in learners:
                actions |= learner.act(observations)
            rewards = {
                agent: -np.square(actions[agent] - (rows[:, :2] - 3.0) / 4.0).mean(1)
                for agent, rows in observations.items()
            }
            earned.append(np.mean(list(rewards.values())))
            for learner in learners:
                over = dict.fromkeys(AGENTS, np.ones(64, bool))
                learner.record(rewards, drawn(rng, 64), never(64), over)
        for learner in learners:
            learner.update(observations)
    assert np.mean(earned[-8:]) > 0.5 * np.mean(earned[:8])


@pytest.mark.parametrize("price", [0.0, 3.0])
def test_actions_that_gain_nothing_shrink_if_they_cost_something(make, price):
    learning = {"learning_rate": 3e-3, "target_kl": 0.0, "entropy": 0.0}
    (learner,) = make("collaborative", num_envs=64, action_penalty=price, **learning)
    actor, rng = learner._policy.actor, np.random.default_rng(0)
    for net in actor.nets:
        net[-1].bias.data.fill_(1.0)
    for _ in range(20):
        observations = drawn(rng, 64)
        learner.act(observations)
        noise = dict.fromkeys(AGENTS, np.float32(rng.normal(size=64)))
        learner.record(noise, observations, never(64), never(64))
        learner.update(observations)
    with torch.no_grad():
        means = actor(torch.zeros(1, 6))[0]
    assert (means[~actor.is_grip].abs() < 0.5).all() == (price > 0.0)
    assert (means[actor.is_grip] > 0.5).all()


@pytest.mark.parametrize(
    ("mode", "weight"), [(MODES[0], 0.0), *((mode, 30.0) for mode in MODES)]
)
def test_the_experts_advice_is_learned_as_far_as_it_counts(make, mode, weight):
    learning = {"learning_rate": 3e-3, "target_kl": 0.0, "imitation": weight}
    learners, rng = make(mode, num_envs=64, **learning), np.random.default_rng(0)
    for _ in range(30):
        observations = drawn(rng, 64)
        advice = {
            agent: np.where(rows[:, :1] > 3.0, [[0.5, -0.3]], [[-0.5, 0.3]])
            for agent, rows in observations.items()
        }
        # Where there is none, nothing is learned from it.
        given = {agent: np.array(rows) for agent, rows in advice.items()}
        for rows in given.values():
            rows[::2] = np.nan
        noise = {agent: np.float32(rng.normal(size=64)) for agent in AGENTS}
        for learner in learners:
            learner.act(observations, given)
            learner.record(noise, observations, never(64), never(64))
            learner.update(observations)
    found = means(learners, observations)
    missed = [np.square(found[agent] - advice[agent]).mean() for agent in AGENTS]
    assert (np.sqrt(missed) < 0.25).all() == (weight > 0.0)


@pytest.mark.parametrize("entropy", [0.0, 0.01])
def test_an_update_tells_its_losses_and_rates(make, entropy):
    learning = {"learning_rate": 1e-3, "target_kl": 0.0, "entropy": entropy}
    learning["action_penalty"] = 0.0
    (learner,) = make("collaborative", initial_std=0.5, **learning)
    observations = drawn(np.random.default_rng(2), 4)
    rewards = dict.fromkeys(AGENTS, np.ones(4, np.float32))
    for _ in range(8):
        learner.act(observations)
        learner.record(rewards, observations, never(4), never(4))
    numbers = learner.update(observations)
    assert (numbers["entropy_loss"] == 0.0) == (entropy == 0.0)
    assert set(numbers) == set(UPDATE) - {"entropy_weight"}
    assert numbers["learning_rate"] == 1e-3
    assert numbers["std"] == pytest.approx(0.5, rel=0.1)
    assert numbers["kl"] > 0.0


@pytest.mark.parametrize(("target", "rises"), [(1e-9, False), (10.0, True)])
def test_the_learning_rate_keeps_the_policy_near_its_target(make, target, rises):
    limits = {"min_learning_rate": 5e-4, "max_learning_rate": 2e-3}
    (learner,) = make("collaborative", learning_rate=1e-3, target_kl=target, **limits)
    practise([learner], updates=3)
    assert learner._agent.optimizer.param_groups[0]["lr"] == (2e-3 if rises else 5e-4)


@pytest.mark.parametrize("is_gripping", [False, True])
def test_the_grips_noise_lasts_and_no_other(make, is_gripping):
    std = {"initial_std": 0.3, "initial_grip_std": 0.5, "grip_persistence": 0.8}
    gripping = GRIPPING if is_gripping else SIZES
    (learner,) = make("collaborative", 2000, sizes=gripping, **std)
    observations = drawn(np.random.default_rng(0), 2000)
    expected = means([learner], observations)["robot_1"]
    noise = np.array(
        [learner.act(observations)["robot_1"] - expected for _ in range(3)]
    )
    for column, lasts in ((0, 0.0), (-1, 0.8 if is_gripping else 0.0)):
        found = noise[:, :, column]
        size = 0.5 if lasts else 0.3
        assert found.std(axis=1) == pytest.approx(size, rel=0.08)
        correlation = np.corrcoef(found)
        assert correlation[0, 1] == pytest.approx(lasts, abs=0.08)
        assert correlation[0, 2] == pytest.approx(lasts**2, abs=0.08)


@pytest.mark.parametrize("mode", MODES)
def test_a_grips_mean_has_a_limit_and_the_same_sign_without_torch(make, mode):
    learners = make(mode, 400, sizes=GRIPPING, grip_limit=0.5, initial_grip_std=0.3)
    for learner in learners:
        with torch.no_grad():
            for net in learner._policy.actor.nets:
                net[-1].weight *= 1000.0
    observations = drawn(np.random.default_rng(0), 400)
    found = means(learners, observations)
    actions = as_policy(learners, "relu")(observations)
    taken = [learner.act(observations) for learner in learners]
    taken = {agent: rows for by_agent in taken for agent, rows in by_agent.items()}
    for agent in AGENTS:
        arm, grip = found[agent].T
        assert np.abs(arm).max() > 1.0
        assert 0.49 < np.abs(grip).max() <= 0.5
        np.testing.assert_array_equal(np.sign(actions[agent][:, -1]), np.sign(grip))
        sure = np.abs(grip) > 0.49
        assert sure.sum() > 100
        against = np.sign(taken[agent][sure, -1]) != np.sign(grip[sure])
        assert 0.01 < against.mean() < 0.1


@pytest.mark.parametrize(("loss", "gradient"), [(1.0, 4.0), (-1.0, 0.0)])
def test_a_grip_at_its_limit_can_still_learn_to_let_go(make, loss, gradient):
    (learner,) = make("shared", sizes=GRIPPING, grip_limit=0.5)
    actor = learner._policy.actor
    with torch.no_grad():
        actor.nets[0][-1].bias[-1] = 20.0
    grips = actor(torch.zeros(4, 5))[:, -1]
    assert grips.tolist() == [0.5] * 4
    (loss * grips).sum().backward()
    assert float(actor.nets[0][-1].bias.grad[-1]) == gradient


@pytest.mark.parametrize("mode", MODES)
def test_a_learner_goes_on_where_its_state_was_taken(make, same, mode):
    learners, others = make(mode), make(mode)
    practise(learners)
    for learner, other in zip(learners, others, strict=True):
        other.load_state_dict(deepcopy(learner.state_dict()))
        for each in (learner, other):  # A collector's noise is its own affair.
            each.rng = np.random.default_rng(1)
            each.player.start(each.rng)
    generator = torch.get_rng_state()
    practise(learners, updates=1)
    torch.set_rng_state(generator)
    practise(others, updates=1)
    for learner, other in zip(learners, others, strict=True):
        assert same(learner.state_dict(), other.state_dict())


def test_statistics_tell_of_the_last_half(make):
    (learner,) = make("collaborative")
    scaler = learner._modules["observation_preprocessor"]
    count, columns = 8_000, learner.learner.observation_size(SIZES)
    for i in range(200):
        scaler(torch.full((count, columns), float(i)), train=True)
    assert float(scaler.current_count) == pytest.approx(100 * count, rel=0.01)
    assert 120.0 < float(scaler.running_mean[0]) < 180.0
