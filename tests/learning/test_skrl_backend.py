from itertools import pairwise

import numpy as np
import pytest

from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.skrl_backend import SkrlBackend
from collaborative_gym.learning.team import Sizes, make_learners

LENGTH = 12


@pytest.fixture
def make_backend(carry, tiny, make_env):
    """Return a function that makes a backend on the small task."""
    env = make_env()
    sizes = Sizes(
        *(
            {agent: space.shape[0] for agent, space in spaces.items()}
            for spaces in (env.single_observation_spaces, env.single_action_spaces)
        )
    )
    made = []

    def make(mode="collaborative", **changes):
        learners = make_learners(mode, sizes)
        made.append(SkrlBackend(carry(), learners, sizes, 0, tiny(**changes), "cpu", 1))
        return made[-1]

    yield make
    for backend in made:
        backend.close()


@pytest.fixture
def recorded(monkeypatch):
    """Return a list that gets what is observed, earned and recorded in each step."""
    steps, act, record = [], PPOLearner.act, PPOLearner.record

    def acting(self, observations):
        steps.append({"before": observations})
        return act(self, observations)

    def recording(self, rewards, final_observations, terminated, truncated):
        ended = terminated["robot_1"] | truncated["robot_1"]
        steps[-1] |= {"after": final_observations, "ended": ended}
        record(self, rewards, final_observations, terminated, truncated)

    monkeypatch.setattr(PPOLearner, "act", acting)
    monkeypatch.setattr(PPOLearner, "record", recording)
    return steps


def test_an_end_is_recorded_with_what_was_seen_last(make_backend, recorded):
    backend = make_backend()
    for _ in range(3):
        backend.advance()
    for now, following in pairwise(recorded):
        for agent, rows in now["after"].items():
            is_same = (rows == following["before"][agent]).all(axis=1)
            assert np.array_equal(is_same, ~now["ended"])


def test_worlds_end_at_different_times_and_only_full_episodes_count(
    make_backend, recorded
):
    backend = make_backend()
    episodes = []
    for _ in range(3):
        episodes += backend.advance().episodes
    assert backend.steps == 3 * 8 * 4
    ends = np.array([step["ended"] for step in recorded])
    assert ends.sum() == 4 * 2
    assert ends.sum(axis=1).max() == 1
    # The first episodes of all worlds but one began before they were watched.
    assert len(episodes) == 5
    assert {row["length"] for row in episodes} == {LENGTH}
