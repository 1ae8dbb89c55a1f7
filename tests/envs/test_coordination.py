"""What the metrics keep of how arms work together."""

from typing import ClassVar

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math


@pytest.fixture
def measured(carry):
    """Return worlds of the small task, whose metrics keep how high the cube is."""

    class Measured(type(carry())):
        coordination: ClassVar = {"height": "mean", "highest": "greatest"}

    base = carry()
    task = Measured(tuple(base.robots.values()), base.config)
    with_rest = cg.VectorEnv(task, 3, num_threads=1, auto_reset=False)
    yield with_rest
    with_rest.close()


def test_metrics_keep_means_and_greatest_until_the_goal_is_reached(measured):
    env, heights, kept = measured, [], {}
    assert (env.reset(seed=0)[1]["metrics"]["coordination"]["height"] == 0.0).all()
    first = np.full(3, -1)
    for i in range(env.task.config.max_episode_steps):
        infos = env.step(env.expert())[-1]
        heights.append(env.facts.height.copy())
        first = np.where((first < 0) & infos["success"], i, first)
        kept = infos["metrics"]["coordination"]
    assert (first >= 0).any() and (first < len(heights) - 1).all()
    for world, end in enumerate(first):
        own = np.array(heights)[: end + 1 if end >= 0 else None, world]
        assert kept["height"][world] == pytest.approx(own.mean(), rel=1e-12)
        assert kept["highest"][world] == own.max()


def test_a_resting_world_keeps_its_coordination_and_a_new_episode_has_none(measured):
    env = measured
    env.reset(seed=0)
    for _ in range(env.task.config.max_episode_steps):
        infos = env.step(env.expert())[-1]
    before = infos["metrics"]["coordination"]["height"]
    env.reset(env_ids=[1])
    after = env.step(env.idle())[-1]["metrics"]["coordination"]["height"]
    assert (after[[0, 2]] == before[[0, 2]]).all()
    assert after[1] == env.facts.height[1]


def test_what_cannot_be_kept_is_refused(carry, monkeypatch):
    task = carry()
    for facts, message in (
        ({"hight": "mean"}, r"Carry.coordination: no fact 'hight'.*did you mean"),
        ({"tcp": "mean"}, r"coordination: tcp has shape .*; it needs one number"),
    ):
        monkeypatch.setattr(type(task), "coordination", facts)
        with pytest.raises(ValueError, match=message):
            cg.VectorEnv(task, 1)
    task = cg.task("TugPandas-v0")
    monkeypatch.setattr(type(task), "coordination", {"bar": "mean"})
    with pytest.raises(ValueError, match="coordination is for tasks of one side"):
        cg.VectorEnv(task, 1)


@pytest.mark.parametrize("robots", [("panda", "panda"), ("panda", "sawyer", "jaco")])
def test_an_arm_waits_if_it_holds_nothing_and_no_joint_moves(robots):
    env = cg.make_vec("Lift", 4, robots=robots, num_threads=1)
    env.reset(seed=0)
    arms, sim = env.scene.arms, env.sim
    sim.qvel[:] = 0.0
    one, other = arms["robot_1"], arms["robot_2"]
    sim.qvel[1, one.dof.stop - 1] = -0.021 * one.robot.velocity_limits[-1]
    sim.qvel[2, one.dof.start] = 0.019 * one.robot.velocity_limits[0]
    sim.qvel[3, one.dof.start] = 0.021 * one.robot.velocity_limits[0]
    bond = env.model.equality(env.scene.grips[1].name).id
    sim.eq_active[3, bond] = 1
    assert env.scene.grips[1].agent == "robot_2" and other.dof != one.dof
    count = len(robots)
    idle = env.task.measure(sim).idle
    assert idle.tolist() == pytest.approx(np.array([0, 1, 0, 2]) / -count + 1.0)


def test_the_pots_handles_are_as_far_apart_in_height_as_it_is_tilted():
    env = cg.make_vec("LiftTaskSawyers-v0", 2, num_threads=1)
    env.reset(seed=0)
    tilt = 0.1
    quats = [[1.0, 0.0, 0.0, 0.0], [np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]]
    where = {"position": np.array([0.0, 0.0, 1.0]), "quat": np.array(quats)}
    env.scene.place(env.sim, np.arange(2), name="pot", **where)
    env.sim.forward()
    facts = env.task.measure(env.sim)
    apart = np.ptp(env.task.handles[:, 1]) * np.sin(tilt)
    assert facts.handle_spread == pytest.approx([0.0, apart], abs=1e-6)
    assert facts.stage.tolist() == [0.0, 0.0]
    grip = env.model.equality(env.scene.grips[0].name).id
    env.sim.eq_active[1, grip] = 1
    assert env.task.measure(env.sim).stage.tolist() == [0.0, 0.5]
    heights = [place[:, 2] for place, _ in facts.handles.values()]
    assert facts.handle_spread[1] == abs(heights[0] - heights[1])[1]
    # All distances are found at once.
    far = math.distance(facts.pot[0], facts.target)
    assert (facts.to_target == far).all()


@pytest.mark.parametrize(
    ("name", "full"), [("PassTaskSawyers-v0", "stage"), ("ReachPandas2-v0", "stage")]
)
def test_an_expert_that_succeeds_has_come_through_all_stages(name, full):
    report = cg.evaluate(name, "expert", episodes=2, num_threads=1)
    assert report.completion.mean == 1.0
    unit, found = report.coordination[full]
    assert unit == "" and found.mean == 1.0
    assert all(0.0 < row["idle"] < 1.0 for row in report.episodes)
    assert "| stage | 100 % | 100 % | 100 % |" in report.to_markdown()
    assert report.summary()["coordination"][full][1]["mean"] == 1.0
