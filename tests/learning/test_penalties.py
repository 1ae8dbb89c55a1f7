"""What training charges for beside the task's reward."""

from contextlib import closing

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.config import PENALTIES
from collaborative_gym.learning.penalties import Penalties

FREE = dict.fromkeys(PENALTIES, 0.0)


@pytest.fixture
def env(carry):
    env = VectorEnv(carry(), 3, num_threads=1)
    env.reset()
    yield env
    env.close()


def moving(env, size):
    """Do a few control steps of this size."""
    actions = {
        agent: np.tile([*np.full(space.shape[0] - 1, size), -1.0], (env.num_envs, 1))
        for agent, space in env.single_action_spaces.items()
    }
    for _ in range(3):
        env.step(actions)


def charged(env, numbers, success=None, share=1.0):
    rewards = {agent: np.full(env.num_envs, 2.0) for agent in env.agents}
    return Penalties(env, numbers).charge(rewards, success, share)


def test_torque_costs_its_mean_square_over_the_limits(env, tiny):
    numbers = tiny(**{**FREE, "torque_penalty": 0.7})
    moving(env, 0.3)
    found = charged(env, numbers)
    for agent, arm in env.scene.arms.items():
        for i in range(env.num_envs):
            torque = env.sim.data(i).actuator_force[arm.servos]
            share = torque / np.array(arm.robot.torque_limits)
            assert 1e-4 < np.max(np.abs(share)) < 1.0  # Below it they are the motors'.
            expected = 2.0 - 0.7 * np.mean(share**2)
            assert found[agent][i] == pytest.approx(expected, abs=1e-6)


def test_what_a_servo_asks_for_beyond_its_motor_costs_evenly_more(env, tiny):
    numbers = tiny(**{**FREE, "torque_penalty": 1.0})
    moving(env, 0.0)
    costs = []
    for share in (0.0, 1.0, 2.0, 3.0, 30.0):
        for arm in env.scene.arms.values():
            robot = arm.robot
            ahead = share * np.array(robot.torque_limits) / robot.stiffness
            env.sim.qvel[:, arm.dof] = 0.0
            own = env.model.actuator_actadr[arm.servos]
            env.sim.act[:, own] = env.sim.qpos[:, arm.qpos] + ahead
        costs.append(2.0 - charged(env, numbers)["robot_1"][0])
    assert costs == pytest.approx([0.0, 1.0, 3.0, 5.0, 59.0])


def test_joints_cost_in_the_outer_tenth_of_their_ranges_from_the_beginning(env, tiny):
    arm = env.scene.arms["robot_1"]
    low, high = arm.joint_range
    env.sim.qpos[:, arm.qpos] = (low + high) / 2
    env.sim.qpos[1, arm.qpos.start] = high[0]
    env.sim.qpos[2, arm.qpos.start] = low[0] + 0.025 * (high[0] - low[0])
    found = charged(env, tiny(range_penalty=1.4), share=0.0)["robot_1"]
    assert 2.0 - found == pytest.approx([0.0, 0.2, 0.05])


def test_a_missed_goal_costs_those_who_share_it(env, duel, tiny):
    numbers = tiny(**{**FREE, "miss_penalty": 0.5})
    met = np.array([True, False, False])
    for found in charged(env, numbers, success=met).values():
        assert found.tolist() == [2.0, 1.5, 1.5]
    with closing(VectorEnv(duel, 3, num_threads=1)) as opponents:
        opponents.reset()
        opponents.task.performance_from_start = True
        success = {"side_1": met, "side_2": ~met}
        found = charged(opponents, numbers, success=success)
    assert found["robot_1"].tolist() == [2.0, 1.5, 1.5]
    assert found["robot_2"].tolist() == [1.5, 2.0, 2.0]


def test_a_goal_to_be_kept_for_a_time_is_met_while_it_is_kept(tiny):
    numbers = tiny(**{**FREE, "miss_penalty": 0.5})
    unmet, costs = np.zeros(4, dtype=bool), []
    with closing(cg.make_vec("BalancePathSawyers-v0", 4, num_threads=1)) as env:
        env.reset(seed=0)
        for _ in range(12):
            near = env.facts.distance < env.task.config.success_distance
            found = charged(env, numbers, success=unmet)["robot_2"]
            assert found.tolist() == np.where(near, 2.0, 1.5).tolist()
            costs.extend(found)
            env.step(env.expert())
    assert {1.5, 2.0} == set(costs)


@pytest.fixture
def measured(carry):
    env = VectorEnv(carry(), 4, num_threads=1, strain=True)
    yield env
    env.close()


def test_contacts_cost_by_the_deepest(measured, tiny):
    numbers = tiny(**{**FREE, "contact_penalty": 0.5})
    depths = {"arms": [0.0, 2e-3, 5e-3, 0.05], "objects": [5e-4, 0.0, 7e-3, 0.0]}
    measured.strain.depths = {kind: np.array(each) for kind, each in depths.items()}
    for earned in charged(measured, numbers).values():
        np.testing.assert_allclose(earned, 2.0 - 0.5 * np.array([0.0, 2.0, 6.0, 10.0]))
