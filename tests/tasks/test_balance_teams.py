"""Balance and BalancePath with three arms and more, on a round board."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.objects.board import board, is_off, within
from collaborative_gym.tasks.registry import make_task

MIXED = ("jaco", "panda", "sawyer", "jaco", "panda")


def play(env, idle=None, steps=200):
    """Return the longest time that the ball follows while the expert plays."""
    env.reset(seed=1)
    longest = np.zeros(env.num_envs)
    for _ in range(steps):
        actions = env.expert()
        if idle:
            actions[idle] = env.idle()[idle]
        env.step(actions)
        longest = np.maximum(longest, env.facts.followed)
    return longest


@pytest.mark.parametrize("robots", (("panda",) * 3, MIXED))
def test_expert_follows_with_all_arms_and_of_three_not_with_one_that_idles(robots):
    env = cg.VectorEnv(make_task("BalancePath", robots), 4, num_threads=1)
    assert (play(env) > 12.0).all()
    # In larger teams the others can be strong enough to move one that holds still.
    for agent in env.agents if len(robots) == 3 else ():
        assert play(env, idle=agent).max() < 8.0


def test_the_middle_of_a_round_board_is_kept_too():
    env = cg.VectorEnv(make_task("Balance", ("panda",) * 4), 4, num_threads=1)
    env.reset(seed=0)
    for _ in range(60):
        metrics = env.step(env.expert())[4]["metrics"]
    assert metrics["completion"].all()


def test_all_arms_start_with_their_handle_in_the_hand():
    env = cg.VectorEnv(make_task("BalancePathMixed3-v0"), 6, num_threads=1)
    env.reset(seed=0)
    place, quat = env.facts.board
    for agent in env.agents:
        handle = env.task.grasp(agent, place, quat)[0]
        assert math.distance(env.sim.pose(f"{agent}/tcp")[0], handle).max() < 1e-3


def test_all_seats_and_sizes_see_alike():
    ids = "BalancePathPandas3-v0", "BalancePathPandas6-v0", "BalancePathPandas4-v0"
    tasks = [make_task(each, randomization="paper") for each in ids]
    pair = {"randomization": "paper", "egocentric": True}
    tasks += [make_task("BalancePath", "panda", num_robots=2, **pair)]
    envs = [cg.VectorEnv(task, 1, num_threads=1) for task in tasks]
    own = envs[0].observation_blocks["robot_1"]
    assert own["mates"].shape == (7, 4)
    for env in envs:
        assert all(blocks == own for blocks in env.observation_blocks.values())
        observations, _ = env.reset(seed=0)
        # All else of a nominal start depends on the seat: the board alone is even.
        boards = [env.task.observe(env.facts)[a]["board"] for a in env.agents]
        assert np.ptp(boards, axis=0).max() < 2e-3
        assert {rows.shape for rows in observations.values()} == {(1, 57)}


def test_mates_and_target_are_seen_from_the_own_base():
    env = cg.VectorEnv(make_task("BalancePathPandas3-v0"), 3, num_threads=1)
    env.reset(seed=0)
    task, (place, quat) = env.task, env.facts.board
    mount = task.placements["robot_2"]
    turn = math.from_yaw(np.array(-mount.yaw))
    seen = task.observe(env.facts)["robot_2"]
    handles = {a: task.grasp(a, place, quat)[0] for a in env.agents}
    for row, mate in enumerate(("robot_3", "robot_1")):
        apart = math.rotate(turn, handles[mate] - handles["robot_2"])
        assert seen["mates"][:, row, 0] == pytest.approx(1.0)
        assert seen["mates"][:, row, 1:] == pytest.approx(apart)
    assert (seen["mates"][:, 2:] == 0.0).all()
    target = math.rotate(turn, env.facts.target - np.array(mount.position))
    assert seen["target"] == pytest.approx(target)


def test_a_ball_is_off_beyond_the_edge_of_its_board():
    on = np.array([[0.3, 0.5, 0.05], [0.59, 0.0, 0.05], [0.0, 0.74, 0.05]])
    assert is_off(on, 2).tolist() == [False, True, False]
    assert is_off(on, 3).tolist() == [False, False, True]
    assert is_off(on - [0.0, 0.0, 0.04], 3).all()
    assert np.hypot(*within(3)) == pytest.approx(0.6)


def test_round_board_has_its_handles_evenly_around():
    model = board(2.0, count=5).compile()
    assert model.body("board").mass[0] == pytest.approx(2.0)
    sites = np.array([model.site(f"handle_{i + 1}").pos for i in range(5)])
    assert math.norm(sites) == pytest.approx(0.64)
    assert sites[0] == pytest.approx([0.0, -0.64, 0.0])
    steps = np.diff(np.unwrap(np.arctan2(sites[:, 1], sites[:, 0])))
    assert steps == pytest.approx(2 * np.pi / 5)
    with pytest.raises(ValueError, match="count must be"):
        board(count=1)


def test_other_settings_and_teams_are_refused():
    with pytest.raises(ValueError, match="needs 2 to 8 robots, got 9"):
        make_task("Balance", "panda", num_robots=9)
    with pytest.raises(TypeError, match="egocentric must be"):
        make_task("Balance", egocentric="yes")
