"""Two sides that play against each other learn, in every mode."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.blocks import Layout
from collaborative_gym.learning.config import MODES
from collaborative_gym.learning.team import make_learners


@pytest.mark.parametrize("mode", MODES)
def test_opponents_learn_by_side(
    train_tiny, tiny, duel, mode, read_progress, monkeypatch
):
    falls, over = [], type(duel).over
    monkeypatch.setattr(
        type(duel), "over", lambda *given: falls.append(over(*given)) or falls[-1]
    )
    result = train_tiny(
        task=duel, mode=mode, hyperparameters=tiny(total_steps=256, rollout_steps=16)
    )
    rows = read_progress(result.folder)
    assert [row["steps"] for row in rows] == [64, 128, 192, 256]
    for row in rows:
        assert not {"return", "completion", "validation/return"} & row.keys()
        assert row["validation/side_1/return"] == -row["validation/side_2/return"] != 0
    ended = [row for row in rows if "side_1/return" in row]
    assert ended and all("side_2/completion" in row for row in ended)
    # Of opponents, the latest are the best.
    assert result.best["steps"] == 256
    assert np.any(np.concatenate(falls))
    report = cg.evaluate(duel, result.policy(), episodes=4, num_threads=1)
    last = report.sides["side_1"].mean_reward.mean
    assert last == -report.sides["side_2"].mean_reward.mean


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
    sizes = Layout.of_sizes(dict.fromkeys(rewards, 3), dict.fromkeys(rewards, 2))
    learners = make_learners(mode, sizes, (("robot_1", "robot_2"), ("robot_3",)))
    found = {each.name: each.rewards(rewards).tolist() for each in learners}
    assert found == expected
    agents = [
        agent for each in learners for part in each.parts for agent in part.agents
    ]
    assert sorted(agents) == sorted(rewards)
