"""Vectors and quaternions against MuJoCo's, and alike on NumPy and torch."""

import mujoco
import numpy as np
import pytest

from collaborative_gym import math

N = 20


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def quats(rng):
    quats = rng.normal(size=(2, N, 4))
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def matrices(quats):
    result = np.zeros((len(quats), 9))
    for row, quat in zip(result, quats, strict=True):
        mujoco.mju_quat2Mat(row, quat)
    return result.reshape(-1, 3, 3)


def test_vectors(rng):
    a, b = rng.normal(size=(2, N, 3))
    np.testing.assert_allclose(math.dot(a, b), (a * b).sum(axis=1))
    np.testing.assert_allclose(math.norm(a), np.linalg.norm(a, axis=1))
    np.testing.assert_allclose(math.distance(a, b), np.linalg.norm(a - b, axis=1))
    np.testing.assert_allclose(math.cross(a, b), np.cross(a, b))


def test_a_row_has_the_same_bits_alone_and_beside_others(rng):
    a = rng.normal(size=(64, 7))
    together = math.norm(a)
    alone = np.concatenate([math.norm(row[None]) for row in a])
    np.testing.assert_array_equal(together, alone)


def test_products_of_quaternions_are_products_of_matrices(quats):
    p, q = quats
    product = matrices(math.multiply(p, q))
    np.testing.assert_allclose(product, matrices(p) @ matrices(q), atol=1e-12)
    identity = math.multiply(q, math.conjugate(q))
    np.testing.assert_allclose(identity, [[1, 0, 0, 0]] * N, atol=1e-12)


def test_rotation_and_axes_are_those_of_the_matrix(quats, rng):
    q, v = quats[0], rng.normal(size=(N, 3))
    turned = (matrices(q) @ v[:, :, None])[:, :, 0]
    np.testing.assert_allclose(math.rotate(q, v), turned, atol=1e-12)
    for i, axis in ((0, math.axis_x), (2, math.axis_z)):
        np.testing.assert_allclose(axis(q), matrices(q)[:, :, i], atol=1e-12)


def test_rotation_vectors_are_mujocos(quats):
    for quat, vector in zip(quats[0], math.rotation_vector(quats[0]), strict=True):
        expected = np.zeros(3)
        mujoco.mju_quat2Vel(expected, quat, 1.0)
        np.testing.assert_allclose(vector, expected, atol=1e-9)
    none = np.array([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(math.rotation_vector(none), np.zeros((2, 3)))


def test_rotation_vectors_and_quaternions_undo_each_other(quats):
    vectors = math.rotation_vector(quats[0])
    again = math.from_rotation_vector(vectors)
    np.testing.assert_allclose(matrices(again), matrices(quats[0]), atol=1e-12)
    tiny = np.array([[0.0, 0.0, 0.0], [1e-12, 0.0, 0.0]])
    expected = [[1.0, 0.0, 0.0, 0.0], [1.0, 5e-13, 0.0, 0.0]]
    np.testing.assert_allclose(math.from_rotation_vector(tiny), expected, atol=1e-20)


def test_roll_and_pitch_by_hand():
    angle = 0.3
    half = np.sin(angle / 2)
    whole = np.cos(angle / 2)
    roll, pitch = math.roll_pitch(
        np.array([[whole, half, 0, 0], [whole, 0, half, 0], [whole, 0, 0, half]])
    )
    np.testing.assert_allclose(roll, [angle, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pitch, [0, angle, 0], atol=1e-12)


def test_yaw_turns_about_z():
    q = math.from_yaw(np.array([0.4]))
    expected = [[np.cos(0.4), np.sin(0.4), 0.0]]
    np.testing.assert_allclose(math.axis_x(q), expected, atol=1e-12)


def test_poses_end_in_x_y_z_w():
    block = math.pose(np.array([[1.0, 2.0, 3.0]]), np.array([[4.0, 5.0, 6.0, 7.0]]))
    assert block.tolist() == [[1, 2, 3, 5, 6, 7, 4]]


def test_torch_agrees(quats, rng):
    torch = pytest.importorskip("torch")
    p, q = quats
    v = rng.normal(size=(N, 3))
    calls = (
        (math.norm, v),
        (math.cross, v, p[:, :3]),
        (math.multiply, p, q),
        (math.rotate, q, v),
        (math.axis_x, q),
        (math.axis_z, q),
        (math.rotation_vector, q),
        (math.from_rotation_vector, v),
        (math.from_yaw, v[:, 0]),
        (math.pose, v, q),
    )
    for function, *arguments in calls:
        tensors = [torch.from_numpy(argument) for argument in arguments]
        result = function(*tensors)
        assert isinstance(result, torch.Tensor)
        np.testing.assert_allclose(result, function(*arguments), atol=1e-12)
    for result, expected in zip(
        math.roll_pitch(torch.from_numpy(q)), math.roll_pitch(q), strict=True
    ):
        np.testing.assert_allclose(result, expected, atol=1e-12)
