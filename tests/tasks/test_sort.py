"""Sort: whose cube is whose, what counts as sorted, and that it takes every arm."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.motion import alone, solve_pose
from collaborative_gym.objects.belt import TOTE, WALL, belt, tote
from collaborative_gym.tasks.experts.sort import HEIGHT, MIDDLE, SIZE
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.sort import LANE, Cube

MIXED = ("sawyer", "jaco", "panda")


@pytest.fixture
def env():
    env = cg.make_vec("SortPandas2-v0", 4, num_threads=1)
    env.reset(seed=0)
    yield env
    env.close()


def play(env, fault=None, agent=None, steps=250):
    """Return the share of sorted cubes, (num_envs,), while the expert plays."""
    env.reset(seed=1)
    gripping = cg.load_policy("gripping", env)
    for _ in range(steps - 1):
        actions = env.expert()
        if fault == "idle":
            actions[agent] = env.idle()[agent]
        elif fault == "gripping":
            actions[agent] = gripping(None)[agent]
        env.step(actions)
    return env.facts.put


@pytest.mark.parametrize(
    ("robots", "grasp"), ((("panda",) * 2, "suction"), (MIXED, "magnet"))
)
def test_expert_sorts_all_and_nobody_fills_the_tote_of_an_arm_that_is_still(
    robots, grasp
):
    env = cg.VectorEnv(make_task("Sort", robots, grasp=grasp), 4, num_threads=1)
    assert play(env).all()
    for i, agent in enumerate(env.agents):
        for fault in ("idle", "gripping"):
            put = play(env, fault, agent)
            needs = np.array([i in each for each in env.task.cubes])
            assert not put[:, needs].any()
            assert put[:, ~needs].all()


def test_each_arm_but_the_first_has_a_cube_that_the_one_before_must_move(env):
    assert env.task.cubes == [Cube(0, -1), Cube(1, -1), Cube(1, 0)]
    y = env.facts.cubes[:, :, 1]
    assert np.abs(y - [-LANE, LANE, -LANE]).max() < 0.03
    # Of the two in a lane either may come first.
    many = cg.make_vec("SortPandas2-v0", 32, num_threads=1)
    many.reset(seed=0)
    x = many.facts.cubes[:, :, 0]
    first = x[:, 0] > x[:, 2]
    assert first.any() and not first.all()
    assert np.abs(x[:, 0] - x[:, 2]).min() > 0.5


@pytest.mark.parametrize("robot", ("panda", "sawyer", "jaco"))
def test_an_arm_does_not_reach_the_lane_at_the_other_side(robot):
    task = make_task("Sort", robot, num_robots=2)
    place, arm = task.placements["robot_1"], task.robots["robot_1"]
    across = np.array([0.0, LANE - place.position[1], HEIGHT - place.position[2]])
    ahead = np.array([across[1], 0.0, across[2] + SIZE / 2])
    for angle in (0.0, 0.6, 1.2):
        approach = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        with pytest.raises(ValueError, match="cannot bring its tcp"):
            solve_pose(*alone(arm), goal=(ahead, approach), start=arm.home)


def test_the_belt_carries_cubes_at_its_speed_whatever_presses_on_it(env):
    before = env.facts.cubes.copy()
    for _ in range(10):
        env.step(env.idle())
    moved = env.facts.cubes - before
    assert moved[:, :, 0] == pytest.approx(0.1, abs=2e-3)
    assert np.abs(moved[:, :, 1:]).max() < 1e-3


def test_only_what_lies_in_the_tote_of_its_colour_is_sorted(env):
    task, sim = env.task, env.sim
    own, other = task.totes["robot_1"], task.totes["robot_2"]
    for floor, at, is_put in (
        (own, (0.0, 0.0, SIZE / 2), True),
        (own, (TOTE - 0.03, 0.0, SIZE / 2), True),
        (own, (TOTE + 0.01, 0.0, SIZE / 2), False),
        (own, (0.0, 0.0, WALL + 0.01), False),
        (other, (0.0, 0.0, SIZE / 2), False),
    ):
        place = floor + np.array(at)
        task.scene.place(sim, slice(None), name="cube_1", position=place)
        sim.forward()
        assert (task.measure(sim).put[:, 0] == is_put).all(), place


def test_what_has_gone_past_its_taker_is_lost(env):
    task, sim = env.task, env.sim
    for (x, y), lost in (
        ((task.seats[0] + 0.31, -LANE), False),
        ((task.seats[0] + 0.33, -LANE), True),
        ((task.seats[0] + 0.33, -0.5 * MIDDLE), False),  # robot_2 can take it
        ((task.seats[1] + 0.33, 0.0), True),
    ):
        place = np.array([x, y, HEIGHT + SIZE / 2 + 1e-3])
        task.scene.place(sim, slice(None), name="cube_3", position=place)
        sim.forward()
        facts = task.measure(sim)
        assert (facts.lost[:, 2] == lost).all(), (x, y)
        assert not facts.to_do["robot_2"][:, 2].any() or not lost


def test_a_cube_dealt_with_never_costs_its_arm(env):
    # Whatever comes next is at most 1 m away, twice; one cube less gains 3.
    env.reset(seed=1)
    before = None
    for _ in range(249):
        _, rewards, *_ = env.step(env.expert())
        left = {a: env.facts.to_do[a].sum(axis=1) for a in env.agents}
        if before:
            for agent in env.agents:
                fewer = left[agent] < before[0][agent]
                gains = rewards[agent] - before[1][agent]
                assert (gains[fewer] > 0.5).all()
        before = left, rewards


def test_all_seats_and_sizes_see_alike():
    ids = "SortPandas2-v0", "SortPandas4-v0"
    envs = [cg.make_vec(each, 1, num_threads=1) for each in ids]
    own = envs[0].observation_blocks["robot_1"]
    assert own["mates"].shape == (7, 6)
    for env in envs:
        assert all(blocks == own for blocks in env.observation_blocks.values())


def test_belts_that_are_too_fast_and_teams_that_are_too_large_are_refused():
    with pytest.raises(ValueError, match=r"belt_speed must be 0\.01 to 0\.2"):
        make_task("Sort", belt_speed=0.5)
    with pytest.raises(ValueError, match="needs 2 to 8 robots, got 9"):
        make_task("Sort", "panda", num_robots=9)
    with pytest.raises(ValueError, match="length must be"):
        belt(0.0, 1.0)


def test_a_tote_is_open_above():
    model = tote((1.0, 0.0, 0.0, 1.0)).compile()
    tops = model.geom_pos[:, 2] + model.geom_size[:, 2]
    assert model.ngeom == 5 and tops.max() == pytest.approx(WALL)
    assert math.norm(model.geom_pos[:, :2]).max() == pytest.approx(TOTE + 0.004)
