import mujoco
import numpy as np
import pytest

from collaborative_gym import math
from collaborative_gym.motion import kinematics
from collaborative_gym.robots import get_robot, list_robots
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.cpu import CpuSim


@pytest.fixture(params=list_robots())
def scene(request):
    scene = Scene()
    robot = get_robot(request.param)
    scene.add_robot("robot_1", robot, Placement((0.3, -0.2, 1.0), 0.7))
    return scene


def tcp_pose(model, arm, angles):
    data = mujoco.MjData(model)
    data.qpos[arm.qpos] = angles
    mujoco.mj_forward(model, data)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, data.site_xmat[arm.tcp])
    return data.site_xpos[arm.tcp].copy(), quat


def test_solve_pose_finds_a_pose_that_the_arm_can_take(scene):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    rng = np.random.default_rng(3)
    for _ in range(5):
        there = np.array(arm.robot.home) + rng.uniform(-0.3, 0.3, 7)
        position, quat = tcp_pose(model, arm, np.clip(there, *arm.joint_range))
        solved = kinematics.solve_pose(model, arm, position, quat, arm.robot.home)
        found = tcp_pose(model, arm, solved)
        assert np.linalg.norm(found[0] - position) < 1e-3
        assert np.linalg.norm(kinematics.rotation_error(found[1], quat)) < 1e-2
        assert np.all(solved >= arm.joint_range[0])
        assert np.all(solved <= arm.joint_range[1])


def test_solve_pose_leaves_the_turn_about_a_direction_free(scene):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    position, _ = tcp_pose(model, arm, arm.robot.home)
    down = np.array([0.0, 0.0, -1.0])
    solved = kinematics.solve_pose(model, arm, position, down, arm.robot.home)
    found = tcp_pose(model, arm, solved)
    assert np.linalg.norm(found[0] - position) < 1e-3
    assert np.dot(math.axis_z(found[1]), down) > np.cos(0.01)


def test_solve_pose_says_why_a_pose_is_out_of_reach(scene):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    with pytest.raises(ValueError, match=f"{arm.robot.name} cannot bring its tcp to"):
        kinematics.solve_pose(model, arm, (5, 0, 1), (0, 0, -1), arm.robot.home, 2)


def test_reach_brings_many_arms_to_their_own_goals(scene):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    sim = CpuSim(model, 4, num_threads=1)
    sim.qpos[:, arm.qpos] = arm.robot.home
    sim.forward()
    position, quat = (array.copy() for array in sim.pose("robot_1/tcp"))
    goal = position + np.array(
        [[0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]]
    )
    for _ in range(30):
        pose = sim.pose("robot_1/tcp")
        home = np.array(arm.robot.home)
        sim.qpos[:, arm.qpos] += kinematics.reach(sim, arm, pose, goal, quat, home)
        sim.forward()
    found = sim.pose("robot_1/tcp")
    assert math.distance(found[0], goal).max() < 2e-3
    assert math.norm(kinematics.rotation_error(found[1], quat)).max() < 1e-2


def test_joint_change_keeps_joints_in_their_room():
    jacobian = np.array([[[1.0, 1.0, 0.5]]])
    room = np.array([[-1.0, -1.0, -1.0]]), np.array([[0.1, 1.0, 1.0]])
    change = kinematics.joint_change(
        jacobian, np.array([[1.0]]), np.zeros((1, 3)), room
    )
    assert change[0, 0] <= 0.1
    # The other joints take over what the first cannot do.
    assert (jacobian @ change[0])[0, 0] == pytest.approx(1.0, abs=0.02)


def test_refine_pose_is_exact_and_stays_near(scene):
    model = scene.compile()
    arm, data = scene.arms["robot_1"], mujoco.MjData(model)
    rng = np.random.default_rng(4)
    home = np.array(arm.robot.home)
    for _ in range(5):
        pose = tcp_pose(model, arm, home + rng.uniform(-0.2, 0.2, 7))
        angle, miss = kinematics.refine_pose(model, data, arm, pose, home)
        found = tcp_pose(model, arm, angle)
        assert miss < 1e-6
        assert np.linalg.norm(found[0] - pose[0]) < 1e-5
        assert np.linalg.norm(kinematics.rotation_error(found[1], pose[1])) < 1e-5
        assert np.abs(angle - home).max() < 0.5
    far = np.array([5.0, 0.0, 1.0]), pose[1]
    angle, miss = kinematics.refine_pose(model, data, arm, far, home)
    assert miss > 1.0
    assert np.all((angle >= arm.joint_range[0]) & (angle <= arm.joint_range[1]))


def test_central_pose_is_nearer_to_the_others_than_home_is(scene):
    model = scene.compile()
    arm, data = scene.arms["robot_1"], mujoco.MjData(model)
    home, limits = np.array(arm.robot.home), np.array(arm.robot.velocity_limits)
    first = tcp_pose(model, arm, home)
    poses = [first] + [(first[0] + [0, 0, dz], first[1]) for dz in (-0.1, 0.1)]
    central = kinematics.central_pose(model, arm, poses)
    found = tcp_pose(model, arm, central)
    assert np.linalg.norm(found[0] - first[0]) < 1e-4
    assert np.linalg.norm(kinematics.rotation_error(found[1], first[1])) < 2e-4

    def slowest(start):
        others = [
            kinematics.refine_pose(model, data, arm, pose, start)[0] for pose in poses
        ]
        return np.max(np.abs(np.array(others) - start) / limits)

    assert slowest(central) <= slowest(home)
    data.qpos[arm.qpos] = central
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_quickest_way_takes_the_shorter_and_leaves_out_what_is_out_of_reach(scene):
    model = scene.compile()
    arm = scene.arms["robot_1"]
    place, quat = tcp_pose(model, arm, arm.robot.home)
    up = np.array([0.0, 0.0, 1.0])
    near, far = place + 0.02 * up, place - 0.15 * up
    beyond = [(place, quat), (np.array([5.0, 0.0, 1.0]), quat)]
    ways = [beyond, [(place, quat), (far, quat)], [(place, quat), (near, quat)]]
    i, angles = kinematics.quickest_way(model, arm, ways, tries=2)
    assert i == 2
    for row, goal in zip(angles, (place, near), strict=True):
        assert np.linalg.norm(tcp_pose(model, arm, row)[0] - goal) < 1e-3
    with pytest.raises(ValueError, match="cannot bring its tcp to"):
        kinematics.quickest_way(model, arm, [beyond], tries=2)
    with pytest.raises(ValueError, match="no way was given"):
        kinematics.quickest_way(model, arm, [])


def test_a_hand_stands_off_until_it_is_straight_before_its_goal():
    down = np.array([0.0, 0.0, -1.0])
    offset = np.array([[0.0, 0.0, 0.3], [0.03, 0.0, 0.1], [0.5, 0.0, 0.0]])
    gap = kinematics.standoff(offset, down, slack=0.01, least=0.005, most=0.12)
    np.testing.assert_allclose(gap, [[0.005], [0.04], [0.12]])
