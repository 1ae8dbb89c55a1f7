"""Nothing is averaged over sides that play against each other."""

import numpy as np
import pytest

from collaborative_gym.learning.team import Sizes, make_learners


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("collaborative", {"side_1": [1.5], "side_2": [5.0]}),
        ("centralized", {"side_1": [1.5], "side_2": [5.0]}),
        ("independent", {"robot_1": [1.0], "robot_2": [2.0], "robot_3": [5.0]}),
        ("shared", {"shared": [1.0, 2.0, 5.0]}),
    ],
)
def test_no_reward_is_averaged_over_opponents(mode, expected):
    rewards = {"robot_1": [1.0], "robot_2": [2.0], "robot_3": [5.0]}
    rewards = {agent: np.float32(reward) for agent, reward in rewards.items()}
    sizes = Sizes(dict.fromkeys(rewards, 3), dict.fromkeys(rewards, 2))
    learners = make_learners(mode, sizes, (("robot_1", "robot_2"), ("robot_3",)))
    found = {each.name: each.rewards(rewards).tolist() for each in learners}
    assert found == expected
    agents = [
        agent for each in learners for part in each.parts for agent in part.agents
    ]
    assert sorted(agents) == sorted(rewards)
