from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

import collaborative_gym as cg
from collaborative_gym.blocks import Layout
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.collector import Job, Player, Rollout
from collaborative_gym.learning.config import MODES, Hyperparameters, recipe
from collaborative_gym.learning.display import UPDATE
from collaborative_gym.learning.folder import BEST, LAST
from collaborative_gym.learning.learner import Policy
from collaborative_gym.learning.networks import Actor
from collaborative_gym.learning.sac import SACLearner
from collaborative_gym.learning.team import make_learners

AGENTS = ("robot_1", "robot_2")
SIZES = Layout.of_sizes(dict.fromkeys(AGENTS, 3), dict.fromkeys(AGENTS, 2))
SMALL = Hyperparameters(
    total_steps=192,
    num_envs=4,
    rollout_steps=8,
    minibatch_size=16,
    replay_size=100,
    warmup=48,
    gradient_steps=3,
    grip_persistence=0.5,
    delayed=0.5,
    torque_penalty=0.1,
    hidden_sizes=(16, 16),
    validation_interval=64,
    validation_episodes=4,
)
"""Six rollouts of 32 rows, the last four with updates and no room for all rows."""


@pytest.fixture(autouse=True)
def seeded():
    """Let torch draw the same in every test."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield


@pytest.fixture
def make():
    """Return a function that makes the learners of a mode."""

    def make(mode, **changes):
        numbers = replace(SMALL, **changes)
        return [
            SACLearner(learner, SIZES, numbers, "cpu")
            for learner in make_learners(mode, SIZES)
        ]

    return make


@pytest.fixture
def train_small(train_tiny):
    """Return a function that trains the small task by SAC."""

    def train_small(*folder, **options):
        options = {"algorithm": "sac", "hyperparameters": SMALL} | options
        return train_tiny(*folder, **options)

    return train_small


def drawn(rng, steps=8, rows=4, observation=6, action=4):
    """Return a rollout of noise, whose worlds end now and then."""
    ends = rng.random((steps, rows))
    truncated = ends < 0.2
    sizes = (steps + 1, rows, observation), (steps, rows, action), (steps, rows)
    observations, actions, rewards = (np.float32(rng.normal(size=s)) for s in sizes)
    finals = np.float32(rng.normal(size=(truncated.sum(), observation)))
    log_prob, terminated = np.zeros_like(rewards), ends > 0.9
    kept = actions, log_prob, rewards, terminated, truncated, finals
    return Rollout(observations, *kept, advice=actions[..., :0])


def test_it_remembers_what_followed_and_not_the_next_episode(make):
    (learner,) = make("centralized")
    rollout = drawn(np.random.default_rng(0))
    assert rollout.truncated.any() and rollout.terminated.any()
    learner.learn([rollout])
    kept = learner.state_dict()["memory"]["rows"]
    following, finals = (
        rollout.observations[1:].copy(),
        iter(rollout.final_observations),
    )
    for t, world in zip(*np.nonzero(rollout.truncated), strict=True):
        following[t, world] = next(finals)
    for name, expected in (
        ("observations", rollout.observations[:-1]),
        ("next_observations", following),
        ("actions", np.clip(rollout.actions, -1.0, 1.0)),
        ("rewards", rollout.rewards[..., None]),
        ("terminated", rollout.terminated[..., None]),
    ):
        found = kept[name].numpy().reshape(expected.shape)
        np.testing.assert_array_equal(found, expected)


def test_it_remembers_the_last_rows_of_any_number(make):
    (learner,) = make("centralized", warmup=100)
    rng, seen = np.random.default_rng(0), []
    for rows in (4, 3, 7, 4):
        rollout = drawn(rng, rows=rows)
        seen += rollout.rewards.flatten().tolist()
        learner.learn([rollout])
    kept = learner.state_dict()["memory"]["rows"]
    assert sorted(kept["rewards"][:, 0].tolist()) == sorted(seen[-100:])
    first = int(np.flatnonzero(kept["rewards"][:, 0] == seen[-1])[0])
    np.testing.assert_array_equal(
        kept["actions"][first], np.clip(rollout.actions[-1, -1], -1.0, 1.0)
    )


def test_nothing_is_learned_before_enough_is_seen(make, same):
    (learner,) = make("centralized", warmup=64)
    rng, first = np.random.default_rng(0), deepcopy(learner.acting()["actor"])
    numbers = learner.learn([drawn(rng)])
    assert same(learner.acting()["actor"], first) and "value_loss" not in numbers
    numbers = learner.learn([drawn(rng)])
    assert not same(learner.acting()["actor"], first)
    assert set(numbers) == set(UPDATE) - {"kl", "entropy_loss"}
    assert np.isfinite(list(numbers.values())).all()


def test_one_stopped_before_its_first_update_goes_on_alike(make, same):
    (whole,), (resumed,) = make("centralized"), make("centralized")
    resumed.load_state_dict(deepcopy(whole.state_dict()))
    for learner in (whole, resumed):
        torch.manual_seed(1)
        rng = np.random.default_rng(0)
        numbers = [learner.learn([drawn(rng)]) for _ in range(4)]
        assert "entropy_weight" in numbers[-1]
    assert same(whole.state_dict(), resumed.state_dict())


def test_critics_learn_alone_and_then_with_the_policy(make, same):
    (learner,) = make("centralized", warmup=0)
    rng, first = np.random.default_rng(0), deepcopy(learner.state_dict())
    learner.learn([drawn(rng)], critic_alone=True)
    state = deepcopy(learner.state_dict())
    assert same(state["policy"], first["policy"])
    assert not same(state["critic_1"], first["critic_1"])
    learner.learn([drawn(rng)])
    assert not same(learner.state_dict()["policy"], first["policy"])


@pytest.mark.parametrize("goal", [0.5, -2.0])
def test_actions_stay_within_bounds_and_can_come_back(goal):
    (learner,) = make_learners("centralized", SIZES)
    policy = Policy(Actor(learner, SIZES, SMALL), SMALL, "cpu", _spaces())
    policy.actor.nets[0][-1].bias.data.fill_(1.5)
    optimizer = torch.optim.Adam(policy.parameters(), 0.05)
    for _ in range(200):
        actions, _ = policy.act({"observations": torch.ones(8, 6)}, role="policy")
        assert actions.abs().max() <= 1.0
        optimizer.zero_grad()
        (actions - goal).square().mean().backward()
        optimizer.step()
    mean = policy.actor(torch.ones(1, 6)).clamp(-1.0, 1.0)
    assert (mean - max(goal, -1.0)).abs().max() < 0.2


def _spaces():
    (learner,) = make_learners("centralized", SIZES)
    return SACLearner(learner, SIZES, SMALL, "cpu")._spaces


@pytest.mark.parametrize("mode", MODES)
def test_it_learns_what_is_rewarded_and_how_much_noise_to_keep(make, mode):
    """Each robot is to do what its observation says: a bandit."""
    numbers = {
        "num_envs": 64,
        "minibatch_size": 64,
        "gradient_steps": 16,
        "replay_size": 4000,
        "learning_rate": 1e-2,
        "discount": 0.5,
        "target_std": 0.1,
        "initial_std": 0.5,
        "initial_grip_std": 0.5,
    }
    learners, rng, earned = make(mode, **numbers), np.random.default_rng(0), []
    job = Job(None, (), SIZES, 0, replace(SMALL, **numbers))
    players = [Player(each.learner, job, _worlds(each)) for each in learners]
    for player in players:
        player.start(rng)
    for _ in range(20):
        for player, learner in zip(players, learners, strict=True):
            player.load(learner.acting())
        for _ in range(4):
            rows = {a: np.float32(rng.normal(3.0, 2.0, (64, 3))) for a in AGENTS}
            actions = {}
            for player in players:
                actions |= player.act(rows, rng)
            rewards = {
                a: -np.square(actions[a] - (rows[a][:, :2] - 3.0) / 6.0).mean(1)
                for a in AGENTS
            }
            earned.append(np.mean(list(rewards.values())))
            over = dict.fromkeys(AGENTS, np.ones(64, bool))
            never = dict.fromkeys(AGENTS, np.zeros(64, bool))
            for player in players:
                player.record(rewards, rows, over, never)
        for player, learner in zip(players, learners, strict=True):
            found = learner.learn([player.finish(rows)])
    assert np.mean(earned[-8:]) > 0.5 * np.mean(earned[:8])
    assert found["std"] < 0.35


def _worlds(learner):
    return Casting().worlds(learner.learner, 64)


@pytest.mark.parametrize("mode", ["centralized", "independent"])
def test_a_resumed_run_equals_the_uninterrupted_one(
    train_small, read_progress, tmp_path, mode, same
):
    whole = train_small(tmp_path / "whole", mode=mode).folder

    def interrupt(row, best):
        if row["steps"] >= 160:
            raise KeyboardInterrupt

    folder = tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        train_small(folder, mode=mode, checkpoint_interval=64, on_row=interrupt)
    assert Checkpoint.load(folder / LAST).backend["steps"] == 128
    torch.rand(3)  # What else draws from the generator must not matter.
    result = train_small(resume=folder, mode=None, algorithm=None, hyperparameters=None)
    assert result.steps == 192 and result.settings.algorithm == "sac"
    name = "policy.safetensors"
    assert (folder / name).read_bytes() == (whole / name).read_bytes()
    for name in (LAST, BEST):
        ends = [Checkpoint.load(each / name).backend for each in (whole, folder)]
        assert same(*ends)
    losses = [
        row.get("robot_1/value_loss", row.get("team/value_loss"))
        for row in read_progress(folder)
    ]
    assert losses[0] is None and losses[-1] > 0.0
    with pytest.raises(ValueError, match="algorithm is ppo, not sac"):
        train_small(resume=folder, algorithm="ppo", hyperparameters=None)


def test_its_policy_plays_and_begins_another_run(train_small, carry, tmp_path):
    first = train_small(tmp_path / "first", mode="centralized")
    policy = first.policy()
    assert policy.metadata["algorithm"] == "sac"
    cg.evaluate(carry(), policy, episodes=2, num_threads=1)
    for algorithm, more in (("sac", {}), ("ppo", {"replay_size": 200_000})):
        numbers = replace(SMALL, total_steps=64, **more)
        if algorithm == "ppo":
            usual = Hyperparameters()
            own = ("warmup", "gradient_steps")
            numbers = replace(numbers, **{n: getattr(usual, n) for n in own})
        result = train_small(
            tmp_path / algorithm,
            mode="centralized",
            algorithm=algorithm,
            hyperparameters=numbers,
            start_from=first.folder,
        )
        assert result.policy().metadata["start"]["digest"] == policy.digest


def test_recipes_leave_out_what_means_nothing_to_it():
    numbers = recipe("PokeTaskSawyers-v0", "sac")
    assert numbers.final_noise == 1.0 and numbers.torque_penalty == 0.1
    assert numbers.num_envs < Hyperparameters().num_envs


def test_runs_are_named_by_their_algorithm(carry, undrawn, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = cg.train(carry(), "independent", algorithm="sac", hyperparameters=SMALL)
    assert result.settings.folder.name == "Carry-sac-independent-seed0"
    assert "sac" in result.settings.title


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"algorithm": "sad"}, KeyError, "no algorithm 'sad'.*sac"),
        ({"algorithm": ["sac"]}, KeyError, "no algorithm"),
        (
            {"hyperparameters": replace(SMALL, clip=0.1, epochs=3)},
            ValueError,
            "sac knows no epochs or clip; leave out",
        ),
        ({"algorithm": "ppo"}, ValueError, "ppo knows no replay_size or warmup or"),
        ({"partner": "idle"}, ValueError, "sac .* choose the algorithm ppo"),
        ({"partner": "population"}, ValueError, "sac .* choose the algorithm ppo"),
        ({"env": "HockeyPandas-v0"}, ValueError, "a task of one side"),
    ],
)
def test_what_makes_no_sense_is_refused(train_small, tmp_path, options, error, message):
    task = options.pop("env", None)
    with pytest.raises(error, match=message):
        train_small(tmp_path / "run", task=task, **options)
    assert not (tmp_path / "run").exists()


def test_a_memory_must_hold_what_is_waited_for():
    with pytest.raises(ValueError, match="warmup 200 is above replay_size 100"):
        Hyperparameters(replay_size=100, warmup=200)
