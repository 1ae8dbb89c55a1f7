"""How actions divide, what is idle, and how motions become actions."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.blocks import columns_of
from collaborative_gym.control import (
    JointChanges,
    Motion,
)
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE


@pytest.fixture
def env(make_env):
    env = make_env(2)
    env.reset(seed=0)
    return env


def motions(env, *changes, **options):
    """Return motions of all joints alike, by so much of what a step allows."""
    return {
        agent: Motion(np.tile(share * arm.stride, (2, 1)), **options)
        for share, (agent, arm) in zip(changes, env.scene.arms.items(), strict=True)
    }


def test_actions_are_changes_of_joint_angles_and_a_grip(env):
    robot, mode = cg.get_robot("panda"), env.action_mode
    most = np.minimum(MAX_CHANGE, np.array(robot.velocity_limits) * CONTROL_DT)
    asked = Motion(np.array([0.5 * most, -most]), grips=np.array([True, False]))
    action = mode.encode(dict.fromkeys(env.agents, asked))["robot_1"]
    np.testing.assert_allclose(action, [[0.5] * 7 + [1.0], [-1.0] * 8])
    assert JointChanges(env.scene, env.sim, gripping=False).size("robot_1") == 7


@pytest.mark.parametrize("gripping", [True, False])
def test_an_action_divides_into_moves_and_a_grip(env, gripping):
    action = np.array([[0.1, 0.2, 0.0], [0.3, 0.4, 0.5]])
    mode = JointChanges(env.scene, env.sim, gripping)
    moves, grips = mode.split(action)
    assert moves.tolist() == action[:, : 2 if gripping else 3].tolist()
    assert grips.tolist() == [False, gripping]
    parts = mode.parts("robot_1")
    assert (columns_of(parts, "moves").sum() == 7 and "grip" in parts) or not gripping
    assert columns_of(parts, "grip").tolist() == [False] * 7 + [True] * gripping


def test_idle_robots_hold_still_and_grip_nothing(env):
    for agent, action in env.idle().items():
        moves, grips = env.action_mode.split(action)
        assert action.shape == (2, *env.single_action_spaces[agent].shape)
        assert not moves.any()
        assert not grips.any()
    closed = env.idle(grips={"robot_1": np.array([True, False]), "robot_2": True})
    assert closed["robot_1"][:, -1].tolist() == [1.0, -1.0]
    assert closed["robot_2"][:, -1].tolist() == [1.0, 1.0]
    assert not closed["robot_1"][:, :-1].any()
    alone = env.idle(grips={"robot_2": True})
    assert (alone["robot_1"][:, -1] == -1.0).all() and (
        alone["robot_2"][:, -1] == 1.0
    ).all()
    still = JointChanges(env.scene, env.sim, gripping=False).idle(3)["robot_1"]
    assert still.tolist() == np.zeros((3, 7)).tolist()


def test_a_motion_that_is_too_fast_keeps_its_direction(env):
    change = np.zeros((2, 7))
    change[0, :2], change[1, :2] = (0.5, 0.25), (0.1, 0.2)
    both = {agent: Motion(change) for agent in env.agents}
    action = env.action_mode.encode(both)["robot_1"]
    limits = env.scene.arms["robot_1"].stride[:2]
    share = change[:, :2] / limits
    np.testing.assert_allclose(action[0, :2], share[0] / share[0].max())
    np.testing.assert_allclose(action[1, :2], share[1])
    assert action[:, 2:].tolist() == [[0, 0, 0, 0, 0, -1]] * 2


def test_arms_in_step_go_at_the_pace_of_the_slowest(env):
    encode = env.action_mode.encode
    grips = np.array([True, False])
    alone = encode(motions(env, 4.0, 1.0, grips=grips))
    np.testing.assert_allclose(alone["robot_2"][:, :7], 1.0)
    assert alone["robot_2"][:, 7].tolist() == [1.0, -1.0]
    together = encode(motions(env, 4.0, 1.0, in_step=True))
    np.testing.assert_allclose(together["robot_1"][:, :7], 1.0)
    np.testing.assert_allclose(together["robot_2"][:, :7], 0.25)


@pytest.mark.parametrize(
    ("motions", "message"),
    [
        (np.zeros((2, 8)), "motion of robot_1 is of type ndarray; return a Motion"),
        ({"robot_1": np.zeros((2, 8))}, "motion of robot_1 is of type ndarray"),
        (
            {"robot_1": Motion(np.zeros((2, 7)))},
            "motion of robot_2 is missing",
        ),
        ({"robot_1": Motion(np.zeros((2, 8)))}, r"\(2, 8\), not \(2, 7\)"),
    ],
)
def test_an_expert_that_returns_no_motions_is_told(env, monkeypatch, motions, message):
    monkeypatch.setattr(env.task, "expert", lambda sim, facts: motions)
    with pytest.raises(ValueError, match=rf"Carry.expert\(\): .*{message}"):
        env.expert()
