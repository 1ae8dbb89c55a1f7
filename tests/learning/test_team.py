from dataclasses import replace

import numpy as np
import pytest

from collaborative_gym.blocks import Layout
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.config import MODES
from collaborative_gym.learning.team import make_learners

SIZES = Layout.of_sizes({"robot_1": 3, "robot_2": 2}, {"robot_1": 2, "robot_2": 1})
EQUAL = Layout.of_sizes({"robot_1": 2, "robot_2": 2}, {"robot_1": 1, "robot_2": 1})


def numbered(sizes, num_envs=2):
    """Return an array by agent whose numbers tell world, agent and column."""
    return {
        agent: np.float32(
            [[100 * i + 10 * j + k for k in range(size)] for i in range(num_envs)]
        )
        for j, (agent, size) in enumerate(sizes.items())
    }


def test_who_learns_what():
    found = {}
    for mode in MODES:
        learners = make_learners(mode, EQUAL)
        found[mode] = [
            (learner.agents, [part.weights for part in learner.parts])
            for learner in learners
        ]
    both = ("robot_1", "robot_2")
    assert found == {
        "collaborative": [(both, ["robot_1", "robot_2"])],
        "independent": [(("robot_1",), ["robot_1"]), (("robot_2",), ["robot_2"])],
        "shared": [(both, ["shared", "shared"])],
        "centralized": [(both, ["team"])],
    }


@pytest.mark.parametrize(
    ("mode", "networks"),
    [
        ("collaborative", {"robot_1": (3, 2), "robot_2": (2, 1)}),
        ("centralized", {"team": (5, 3)}),
    ],
)
def test_a_teams_rows_have_all_agents_and_their_mean_reward(mode, networks):
    (learner,) = make_learners(mode, SIZES)
    assert learner.networks(SIZES) == networks
    assert Casting().num_rows(learner, 2) == 2
    rows = learner.observations(numbered(SIZES.observation_sizes))
    assert rows.tolist() == [[0, 1, 2, 10, 11], [100, 101, 102, 110, 111]]
    rewards = {"robot_1": np.float32([1, 2]), "robot_2": np.float32([3, 6])}
    assert learner.rewards(rewards).tolist() == [2, 4]
    actions = learner.actions(np.float32([[1, 2, 3], [4, 5, 6]]), SIZES)
    assert {agent: block.tolist() for agent, block in actions.items()} == {
        "robot_1": [[1, 2], [4, 5]],
        "robot_2": [[3], [6]],
    }


def test_independent_agents_have_their_own_rows_and_rewards():
    first, second = make_learners("independent", SIZES)
    assert first.networks(SIZES) == {"robot_1": (3, 2)}
    rewards = {"robot_1": np.float32([1, 2]), "robot_2": np.float32([3, 6])}
    assert second.rewards(rewards).tolist() == [3, 6]
    rows = second.observations(numbered(SIZES.observation_sizes))
    assert rows.tolist() == [[10, 11], [110, 111]]


def test_shared_rows_tell_which_robot_and_stand_below_one_another():
    (learner,) = make_learners("shared", EQUAL)
    assert learner.networks(EQUAL) == {"shared": (4, 1)}
    assert Casting().num_rows(learner, 2) == 4
    rows = learner.observations(numbered(EQUAL.observation_sizes))
    assert rows.tolist() == [
        [0, 1, 1, 0],
        [100, 101, 1, 0],
        [10, 11, 0, 1],
        [110, 111, 0, 1],
    ]
    rewards = {"robot_1": np.float32([1, 2]), "robot_2": np.float32([3, 6])}
    assert learner.rewards(rewards).tolist() == [1, 2, 3, 6]
    actions = learner.actions(np.float32([[1], [2], [3], [4]]), EQUAL)
    assert actions["robot_1"].tolist() == [[1], [2]]
    assert actions["robot_2"].tolist() == [[3], [4]]


def test_a_shared_policy_needs_equal_spaces():
    listed = "observations are 3 for robot_1, 2 for robot_2; choose another mode"
    with pytest.raises(ValueError, match=listed):
        make_learners("shared", SIZES)
    sizes = replace(EQUAL, action=SIZES.action)
    with pytest.raises(ValueError, match="actions are 2 for robot_1, 1 for robot_2"):
        make_learners("shared", sizes)


def test_an_unknown_mode_names_those_there_are():
    with pytest.raises(ValueError, match=r"did you mean 'shared'.*: centralized, "):
        make_learners("share", SIZES)
