import numpy as np

from collaborative_gym import math, motion
from collaborative_gym.sim.cpu import CpuSim


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
