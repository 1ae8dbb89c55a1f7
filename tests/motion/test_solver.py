import numpy as np
import pytest

from collaborative_gym import motion
from collaborative_gym.motion.kinematics import Kinematics
from collaborative_gym.motion.solver import Chains, simulated
from collaborative_gym.sim.cpu import CpuSim


def test_joint_change_keeps_joints_in_their_room():
    jacobian = np.array([[[1.0, 1.0, 0.5]]])
    room = np.array([[-1.0, -1.0, -1.0]]), np.array([[0.1, 1.0, 1.0]])
    change = motion.joint_change(
        jacobian, np.array([[1.0]]), nullspace=np.zeros((1, 3)), room=room
    )
    assert change[0, 0] <= 0.1
    # The other joints take over what the first cannot do.
    assert (jacobian @ change[0])[0, 0] == pytest.approx(1.0, abs=0.02)


def test_all_arms_at_once_agree_with_the_simulation(pair):
    """One of them has a joint less, and both have bases that are turned."""
    model, rng = pair.compile(), np.random.default_rng(1)
    arms, yaws = list(pair.arms.values()), (0.0, 2.0)
    angles = np.zeros((7, 2, 8))
    for i, arm in enumerate(arms):
        drawn = rng.uniform(*arm.joint_range, (8, arm.num_joints))
        angles[: arm.num_joints, i] = drawn.T
    kinematics = Kinematics(model, arms, yaws, np)
    (place, rotation), jacobian = kinematics(angles)
    for i, (arm, yaw) in enumerate(zip(arms, yaws, strict=True)):
        own, placement = (
            angles[: arm.num_joints, i].T,
            pair.placements[f"robot_{i + 1}"],
        )
        sim = simulated(CpuSim(model, 8, num_threads=1), arm).at(own, np.arange(8))
        c, s = np.cos(yaw), np.sin(yaw)
        back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        moved = (sim[0] - placement.position) @ back.T
        offset = place[:, i].T - moved
        np.testing.assert_allclose(offset, np.tile(offset[0], (8, 1)), atol=1e-12)
        np.testing.assert_allclose(
            rotation[:, :, i].transpose(2, 0, 1), back @ sim[1], atol=1e-12
        )
        halves = np.split(sim[2], 2, axis=1)
        expected = np.concatenate([back @ half for half in halves], axis=1)
        found = jacobian[:, : arm.num_joints, i].transpose(2, 0, 1)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert kinematics.moves[:, :, 0].T.tolist() == [[1.0] * 7, [1.0] * 6 + [0.0]]


def test_chains_agree_with_the_simulation(pair):
    model, rng = pair.compile(), np.random.default_rng(1)
    arms = list(pair.arms.values())
    rows = np.arange(8)
    for i, arm in enumerate(arms):
        angles = np.zeros((8, 7))
        angles[:, : arm.num_joints] = rng.uniform(*arm.joint_range, (8, arm.num_joints))
        own = angles[:, : arm.num_joints]
        chain = Chains(model, arms).of(np.full(8, i)).at(angles, rows)
        sim = simulated(CpuSim(model, 8, num_threads=1), arm).at(own, rows)
        for found, expected in zip(chain[:2], sim[:2], strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)
        jacobian = chain[2][:, :, : arm.num_joints]
        np.testing.assert_allclose(jacobian, sim[2], atol=1e-12)
        assert not chain[2][:, :, arm.num_joints :].any()
