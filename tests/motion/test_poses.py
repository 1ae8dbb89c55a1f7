from dataclasses import replace

import mujoco
import numpy as np
import pytest

from collaborative_gym import math, motion
from collaborative_gym.motion.solver import Chains


def test_solve_pose_finds_a_pose_that_the_arm_can_take(scene, tcp_pose):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    rng = np.random.default_rng(3)
    for _ in range(5):
        there = np.array(arm.robot.home) + rng.uniform(-0.3, 0.3, arm.num_joints)
        position, quat = tcp_pose(model, arm, np.clip(there, *arm.joint_range))
        solved = motion.solve_pose(
            model, arm, goal=(position, quat), start=arm.robot.home
        )
        found = tcp_pose(model, arm, solved)
        assert np.linalg.norm(found[0] - position) < 1e-3
        assert np.linalg.norm(motion.rotation_error(found[1], quat)) < 1e-2
        assert np.all(solved >= arm.joint_range[0])
        assert np.all(solved <= arm.joint_range[1])


def test_solve_pose_leaves_the_turn_about_a_direction_free(scene, tcp_pose):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    position, _ = tcp_pose(model, arm, arm.robot.home)
    position -= (0.0, 0.0, 0.1)  # a hand that is level at home has room to point down
    down = np.array([0.0, 0.0, -1.0])
    solved = motion.solve_pose(model, arm, goal=(position, down), start=arm.robot.home)
    found = tcp_pose(model, arm, solved)
    assert np.linalg.norm(found[0] - position) < 1e-3
    assert np.dot(math.axis_z(found[1]), down) > np.cos(0.01)


def test_solve_pose_says_why_a_pose_is_out_of_reach(scene, tcp_pose):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    with pytest.raises(ValueError, match=f"{arm.robot.name} cannot bring its tcp to"):
        motion.solve_pose(
            model, arm, goal=((5, 0, 1), (0, 0, -1)), start=arm.robot.home, tries=2
        )


def test_central_pose_is_nearer_to_the_others_than_home_is(scene, tcp_pose):
    model = scene.compile()
    arm, data = scene.arms["robot_1"], mujoco.MjData(model)
    home, limits = np.array(arm.robot.home), np.array(arm.robot.velocity_limits)
    first = tcp_pose(model, arm, home)
    poses = [first] + [(first[0] + [0, 0, dz], first[1]) for dz in (-0.1, 0.1)]
    chains = Chains(model, [arm])
    central = motion.central_pose(model, arm, poses=poses)
    found = tcp_pose(model, arm, central)
    assert np.linalg.norm(found[0] - first[0]) < 1e-4
    assert np.linalg.norm(motion.rotation_error(found[1], first[1])) < 2e-4

    def slowest(start):
        others = [
            motion.hold(chains, [(pose[0][None], pose[1][None])], near=[start[None]])[0]
            for pose in poses
        ]
        return np.max(np.abs(np.array(others) - start) / limits)

    assert slowest(central) <= slowest(home)
    data.qpos[arm.qpos] = central
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_quickest_way_takes_the_shorter_and_leaves_out_what_is_out_of_reach(
    scene, tcp_pose
):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    place, quat = tcp_pose(model, arm, arm.robot.home)
    up = np.array([0.0, 0.0, 1.0])
    near, far = place + 0.02 * up, place - 0.15 * up
    beyond = [(place, quat), (np.array([5.0, 0.0, 1.0]), quat)]
    ways = [beyond, [(place, quat), (far, quat)], [(place, quat), (near, quat)]]
    i, angles = motion.quickest_way(model, arm, ways=ways)
    assert i == 2
    for row, goal in zip(angles, (place, near), strict=True):
        assert np.linalg.norm(tcp_pose(model, arm, row)[0] - goal) < 1e-3
    with pytest.raises(ValueError, match="cannot bring its tcp to"):
        motion.quickest_way(model, arm, ways=[beyond])
    with pytest.raises(ValueError, match="no way was given"):
        motion.quickest_way(model, arm, ways=[])


def test_hold_puts_all_tcps_at_poses_and_stays_near(pair, tcp_pose):
    model, rng = pair.compile(), np.random.default_rng(4)
    arms = list(pair.arms.values())
    near, goals = [], []
    for arm in arms:
        home = np.array(arm.robot.home)
        noise = rng.uniform(-0.2, 0.2, (6, arm.num_joints))
        poses = [tcp_pose(model, arm, home + row) for row in noise]
        goals.append(tuple(np.array(part) for part in zip(*poses, strict=True)))
        near.append(np.tile(home, (6, 1)))
    # One arm cannot do its part in one of the worlds.
    goals[1][0][3] = (5.0, 0.0, 1.0)
    angles, reached = motion.hold(Chains(model, arms), goals, near=near)
    assert reached.tolist() == [True, True, True, False, True, True]
    for arm, found, (position, quat), start in zip(
        arms, angles, goals, near, strict=True
    ):
        assert found.shape == start.shape
        assert np.all((found >= arm.joint_range[0]) & (found <= arm.joint_range[1]))
        for i in np.flatnonzero(reached):
            there = tcp_pose(model, arm, found[i])
            assert np.linalg.norm(there[0] - position[i]) < 1e-5
            assert np.linalg.norm(motion.rotation_error(there[1], quat[i])) < 1e-5
            assert np.abs(found[i] - start[i]).max() < 0.5


def test_a_world_is_held_the_same_to_the_bit_alone_and_among_others(pair, tcp_pose):
    model, rng = pair.compile(), np.random.default_rng(5)
    arms = list(pair.arms.values())
    homes = [np.array(arm.robot.home) for arm in arms]
    near = [h + rng.uniform(-0.1, 0.1, (9, len(h))) for h in homes]
    goals = []
    for arm, home in zip(arms, homes, strict=True):
        position, quat = tcp_pose(model, arm, home)
        moved = position + rng.uniform(-0.05, 0.05, (9, 3))
        goals.append((moved, np.tile(quat, (9, 1))))
    chains = Chains(model, arms)
    together, _ = motion.hold(chains, goals, near=near)
    for i in range(9):
        rows = slice(i, i + 1)
        own = [(position[rows], quat[rows]) for position, quat in goals]
        alone, _ = motion.hold(chains, own, near=[angles[rows] for angles in near])
        for angles, found in zip(together, alone, strict=True):
            np.testing.assert_array_equal(angles[rows], found)


def test_patience_spares_steps_where_the_range_ends_and_changes_nothing_else(
    pair, tcp_pose, monkeypatch
):
    model, arms = pair.compile(), list(pair.arms.values())
    rng, near, goals = np.random.default_rng(6), [], []
    for arm in arms:
        home = np.array(arm.robot.home)
        poses = [tcp_pose(model, arm, home + 0.2 * rng.uniform(-1, 1, len(home)))] * 4
        goals.append(tuple(np.array(part) for part in zip(*poses, strict=True)))
        near.append(np.tile(home, (4, 1)))
    goals[1][0][3] = (5.0, 0.0, 1.0)
    chains, rows = Chains(model, arms), []
    of = chains.of

    def counted(arm):
        postures = of(arm)

        def at(angles, which):
            rows.append(len(which))
            return postures.at(angles, which)

        return replace(postures, at=at)

    monkeypatch.setattr(chains, "of", counted)
    found = [motion.hold(chains, goals, near=near, patience=p) for p in (None, 4)]
    (usual, reached), (spared, same) = found
    assert reached.tolist() == same.tolist() == [True, True, True, False]
    for one, other in zip(usual, spared, strict=True):
        np.testing.assert_array_equal(one[:3], other[:3])
    assert rows.index(1) < 21 < len(rows) < 21 + 15


@pytest.mark.parametrize("scene", ["sawyer"], indirect=True)
def test_solve_pose_tries_other_starts_when_the_first_fails(scene, tcp_pose):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    goal = tcp_pose(model, arm, arm.robot.home)
    far = np.array(arm.robot.home) + 2.0 * np.array([1, -1, 1, -1, 1, -1, 1])
    with pytest.raises(ValueError, match=r"allowed\); postures far from where"):
        motion.solve_pose(model, arm, goal=goal, start=far, tries=1)
    solved = motion.solve_pose(model, arm, goal=goal, start=far)
    assert np.linalg.norm(tcp_pose(model, arm, solved)[0] - goal[0]) < 1e-3
