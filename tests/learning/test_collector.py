from itertools import pairwise

import numpy as np
import pytest
import torch

from collaborative_gym.envs.world import World
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.collector import Collector, Job
from collaborative_gym.learning.config import FAULTS, MODES
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners

LENGTH, WORLDS, STEPS = 12, 4, 8
NOTHING, ALL = Assistance(0.0), Assistance(0.0)
ALL.demand = 1.0
PENALTIES = (
    "torque_penalty",
    "contact_penalty",
)


@pytest.fixture
def make(carry, tiny):
    """Return a function that makes a collector of the small task, and its learners."""
    sizes = World.of(carry()).definition.layout
    made = []

    def make(mode="collaborative", index=0, count=1, seed=0, **changes):
        numbers = tiny(**changes)
        job = Job(carry(), make_learners(mode, sizes), sizes, seed, numbers, 1)
        made.append(Collector(job, index, count))
        with torch.random.fork_rng():
            torch.manual_seed(0)
            learners = [
                PPOLearner(each, sizes, numbers, "cpu") for each in job.learners
            ]
        return made[-1], learners

    yield make
    for collector in made:
        collector.close()


def acting(learners):
    return {each.learner.name: each.acting() for each in learners}


@pytest.mark.parametrize("mode", MODES)
def test_a_rollout_has_what_was_seen_done_and_seen_last(make, mode):
    collector, learners = make(mode)
    collected = [collector.collect(acting(learners), i, NOTHING)[0] for i in range(3)]
    assert [each.steps for each in collected] == [WORLDS * STEPS] * 3
    for learner in learners:
        found = [each.rollouts[learner.learner.name] for each in collected]
        rows = collector._job.casting.num_rows(learner.learner, WORLDS)
        for rollout in found:
            assert rollout.observations.shape[:2] == (STEPS + 1, rows)
            assert rollout.rewards.shape == rollout.log_prob.shape == (STEPS, rows)
            assert not rollout.terminated.any()
            assert len(rollout.final_observations) == rollout.truncated.sum()
            # The next step begins elsewhere where an episode ended.
            after = rollout.observations[1:][rollout.truncated]
            assert (rollout.final_observations != after).any(axis=1).all()
        for now, following in pairwise(found):
            np.testing.assert_array_equal(
                now.observations[-1], following.observations[0]
            )
        assert sum(each.truncated.sum() for each in found) == 2 * rows


@pytest.mark.parametrize("mode", MODES)
def test_actions_are_as_probable_as_the_learner_finds_them(make, mode):
    collector, learners = make(mode, initial_std=0.3)
    for iteration in range(2):
        collected = collector.collect(acting(learners), iteration, NOTHING)[0]
        for learner in learners:
            rollout = collected.rollouts[learner.learner.name]
            scaler = learner._agent._observation_preprocessor
            rows = torch.from_numpy(rollout.observations[:-1]).flatten(0, 1)
            taken = torch.from_numpy(rollout.actions).flatten(0, 1)
            inputs = {"observations": scaler(rows), "taken_actions": taken}
            with torch.no_grad():
                _, outputs = learner._policy.act(inputs)
            expected = outputs["log_prob"].numpy().ravel()
            np.testing.assert_allclose(rollout.log_prob.ravel(), expected, atol=1e-4)
            learner.learn([rollout])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_the_experts_advice_stands_beside_what_was_done(make, mode, weight):
    collector, learners = make(mode, imitation=weight)
    given, ask = [], collector.env.expert
    collector.env.expert = lambda: given.append(ask()) or given[-1]
    collected = collector.collect(acting(learners), 0, NOTHING)[0]
    assert len(given) == (STEPS if weight else 0)
    for learner in learners:
        rollout = collected.rollouts[learner.learner.name]
        assert rollout.advice.shape[2] == (rollout.actions.shape[2] if weight else 0)
        for advised, actions in zip(rollout.advice, given, strict=False):
            by_agent = learner.learner.actions(advised, collector._job.layout)
            for agent, rows in by_agent.items():
                np.testing.assert_allclose(rows, actions[agent], atol=1e-6)


def test_worlds_end_at_different_times_and_only_full_episodes_count(make):
    collector, learners = make()
    collected = [collector.collect(acting(learners), i, NOTHING)[0] for i in range(3)]
    ends = np.concatenate([each.rollouts["team"].truncated for each in collected])
    assert ends.sum() == 4 * 2
    assert ends.sum(axis=1).max() == 1
    # The first episodes of all worlds but one began before they were watched.
    episodes = [row for each in collected for row in each.episodes]
    assert len(episodes) == 5
    assert {row["length"] for row in episodes} == {LENGTH}


def test_collectors_share_the_worlds_and_play_episodes_of_their_own(make):
    numbers = {"num_envs": 5, "rollout_steps": 2 * LENGTH}
    played = []
    for index, worlds in ((0, 3), (1, 2)):
        collector, learners = make(index=index, count=2, **numbers)
        collected = collector.collect(acting(learners), 0, NOTHING)[0]
        assert collected.steps == worlds * 2 * LENGTH
        again, _ = make(index=index, count=2, **numbers)
        later = again.collect(acting(learners), 1, NOTHING)[0]
        for each in (collected, later):
            played += [row["episode"] for row in each.episodes]
    assert len(set(played)) == len(played) > 0


def test_a_collector_goes_on_where_its_state_was_taken(make, same):
    first, learners = make("shared")
    assert first.state_dict() == {"0": {}}
    first.collect(acting(learners), 0, NOTHING)
    state = first.state_dict()
    expected = first.collect(acting(learners), 1, NOTHING)[0]
    second, _ = make("shared")
    second.load_state_dict(state)
    found = second.collect(acting(learners), 1, NOTHING)[0]
    assert same(vars(found.rollouts["shared"]), vars(expected.rollouts["shared"]))
    other, _ = make("shared", seed=1)
    other.load_state_dict(state)
    drawn = other.collect(acting(learners), 1, NOTHING)[0].rollouts["shared"]
    assert not same(drawn.actions, found.rollouts["shared"].actions)


def test_what_rollouts_say_is_learned_beside_one_another(make):
    """Two halves of the worlds teach what all of them together do, but for rounding."""
    collector, (learner,) = make(epochs=1, minibatch_size=4 * 32)
    rollout = collector.collect(acting([learner]), 0, NOTHING)[0].rollouts["team"]
    _, (other,) = make(epochs=1, minibatch_size=4 * 32)
    late = np.nonzero(rollout.truncated)[1]
    halves = [
        type(rollout)(
            **{name: each[:, rows] for name, each in vars(rollout).items()}
            | {"final_observations": rollout.final_observations[np.isin(late, rows)]}
        )
        for rows in ([0, 2], [1, 3])
    ]
    numbers, others = learner.learn([rollout]), other.learn(halves)
    for name, value in numbers.items():
        assert others[name] == pytest.approx(value, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("delayed", [0.0, 0.5, 1.0])
def test_some_worlds_do_each_action_a_step_late(make, delayed, monkeypatch):
    numbers = dict.fromkeys((*PENALTIES, *FAULTS), 0.0) | {"delayed": delayed}
    collector, learners = make(rollout_steps=2 * LENGTH, **numbers)
    done = []
    step = collector.env.step
    monkeypatch.setattr(collector.env, "step", lambda a: done.append(a) or step(a))
    rollout = collector.collect(acting(learners), 0, ALL)[0].rollouts["team"]
    done = np.stack([np.concatenate(list(each.values()), axis=1) for each in done])
    chosen = np.clip(rollout.actions, -1.0, 1.0)
    late = round(delayed * WORLDS)
    np.testing.assert_array_equal(done[:, late:], chosen[:, late:])
    idle = np.concatenate([each[0] for each in collector.env.idle().values()])
    for world in range(late):
        ended = rollout.truncated[:, world]
        assert ended.any()
        for i in range(1, 2 * LENGTH):
            before = idle if ended[i - 1] else chosen[i - 1, world]
            np.testing.assert_array_equal(done[i, world], before)
        np.testing.assert_array_equal(done[0, world], idle)


def test_penalties_are_in_what_is_learned_but_in_no_episode(make):
    found = []
    for weight in (0.0, 5.0):
        penalties = dict.fromkeys(PENALTIES, weight)
        collector, learners = make(rollout_steps=2 * LENGTH, **penalties)
        found.append(collector.collect(acting(learners), 0, ALL)[0])
    free, charged = found
    cost = free.rollouts["team"].rewards - charged.rollouts["team"].rewards
    assert (cost >= 0.0).all() and (cost > 0.0).mean() > 0.8
    earned = [[row["return"] for row in each.episodes] for each in found]
    assert earned[0] == earned[1] != []


@pytest.mark.parametrize("lost", [0.0, 0.2])
@pytest.mark.parametrize("missed", [0.0, 0.6])
def test_grips_are_lost_and_missed_now_and_then(make, monkeypatch, lost, missed):
    faults = {"lost_grips": lost, "missed_grips": missed}
    numbers = dict.fromkeys(FAULTS, 0.0) | faults
    collector, learners = make(rollout_steps=400, **numbers)
    env, done, held = collector.env, [], []
    step = env.step

    def watched(actions):
        held.append(np.stack([env.scene.holds(env.sim, a) for a in env.agents], axis=1))
        done.append(actions)
        return step(actions)

    monkeypatch.setattr(env, "step", watched)
    chosen = collector.collect(acting(learners), 0, ALL)[0].rollouts["team"].actions
    asked = np.stack([np.concatenate(list(each.values()), axis=1) for each in done])
    fails = asked != np.clip(chosen, -1.0, 1.0)
    grips = learners[0].learner.is_grip(World.of(env.task).definition.layout)
    assert not fails[:, :, ~grips].any() and (asked[fails] == -1.0).all()
    fails, held = fails[:, :, grips], np.stack(held)
    for of_these, share in ((held, lost), (~held, missed)):
        assert of_these.sum() > 100
        assert fails[of_these].mean() == pytest.approx(share, abs=0.5 * share)


def test_crashes_are_refined_where_somebody_asks_for_it(make):
    assert make()[0].env.sim.refinement is None
    assert make(refined=1)[0].env.sim.refinement is not None
