import numpy as np
import pytest

from collaborative_gym import math, motion
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.timing import CONTROL_DT


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
        change = motion.reach(sim, arm, tcp=pose, goal=(goal, quat), posture=home)
        sim.qpos[:, arm.qpos] += change
        sim.forward()
    found = sim.pose("robot_1/tcp")
    assert math.distance(found[0], goal).max() < 2e-3
    assert math.norm(motion.rotation_error(found[1], quat)).max() < 1e-2


def test_a_hand_stands_off_until_it_is_straight_before_its_goal():
    down = np.array([0.0, 0.0, -1.0])
    offset = np.array([[0.0, 0.0, 0.3], [0.03, 0.0, 0.1], [0.5, 0.0, 0.0]])
    gap = motion.standoff(offset, down, slack=0.01, least=0.005, most=0.12)
    np.testing.assert_allclose(gap, [[0.005], [0.04], [0.12]])


@pytest.mark.parametrize("delay", (0, 1))
def test_steadied_motion_stops_at_its_goal_even_where_it_comes_late(scene, delay):
    sim = CpuSim(scene.compile(), 1, num_threads=1)
    arm = scene.arms["robot_1"]
    coming, misses = [np.zeros((1, arm.num_joints))] * delay, []
    for _ in range(40):
        missing = 1.0 - sim.qpos[:, arm.qpos]
        misses.append(missing.max())
        coming.append(motion.settling(sim, arm, change=missing))
        now = np.clip(coming.pop(0), -arm.stride, arm.stride)
        sim.qpos[:, arm.qpos] += now
        sim.qvel[:, arm.dof] = now / CONTROL_DT
    assert min(misses) > -0.1
    assert np.abs(misses[-5:]).max() < 0.01
