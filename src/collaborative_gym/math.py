"""Vector and quaternion maths over arrays with any leading axes.

Written in the Python array API, so that NumPy and torch run the same code. Sums over
the last axis are spelt out column by column: a library's reduction may group terms
differently for one row than for many, and the same world must give the same bits in a
batch of any size. Quaternions are w x y z and of unit length.
"""

from typing import Any

import array_api_compat
import numpy as np

Array = np.ndarray
"""An array of the backend. Type checkers see NumPy's; others have the same names."""


def array_namespace(*arrays: Array) -> Any:
    """Return the array API's functions for these arrays; NumPy has them itself."""
    if isinstance(arrays[0], np.ndarray):
        return np
    return array_api_compat.array_namespace(*arrays)


def dot(a: Array, b: Array) -> Array:
    """Return the inner product over the last axis."""
    product = a * b
    columns = (product[..., i] for i in range(1, product.shape[-1]))
    return sum(columns, product[..., 0])


def norm(a: Array) -> Array:
    """Return the Euclidean length over the last axis."""
    square = a * a
    return sum((square[..., i] for i in range(1, a.shape[-1])), square[..., 0]) ** 0.5


def distance(a: Array, b: Array) -> Array:
    """Return the Euclidean distance over the last axis."""
    return norm(a - b)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of 3-vectors."""
    xp = array_namespace(a, b)
    a, b = xp.concat([a, a], axis=-1), xp.concat([b, b], axis=-1)
    return a[..., 1:4] * b[..., 2:5] - a[..., 2:5] * b[..., 1:4]


def conjugate(q: Array) -> Array:
    """Return the inverse of a unit quaternion."""
    xp = array_namespace(q)
    return xp.concat([q[..., :1], -q[..., 1:]], axis=-1)


def multiply(p: Array, q: Array) -> Array:
    """Return the quaternion of the rotation q followed by p."""
    xp = array_namespace(p, q)
    w = p[..., :1] * q[..., :1] - dot(p[..., 1:], q[..., 1:])[..., None]
    v = (
        p[..., :1] * q[..., 1:]
        + q[..., :1] * p[..., 1:]
        + cross(p[..., 1:], q[..., 1:])
    )
    return xp.concat([w, v], axis=-1)


def rotate(q: Array, v: Array) -> Array:
    """Return the vector v turned by q."""
    twice = 2.0 * cross(q[..., 1:], v)
    return v + q[..., :1] * twice + cross(q[..., 1:], twice)


def axis_x(q: Array) -> Array:
    """Return the first column of the rotation matrix of q."""
    xp = array_namespace(q)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    columns = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    return xp.stack(columns, axis=-1)


def axis_z(q: Array) -> Array:
    """Return the third column of the rotation matrix of q."""
    xp = array_namespace(q)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    columns = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    return xp.stack(columns, axis=-1)


def roll_pitch(q: Array) -> tuple[Array, Array]:
    """Return the fixed-axis roll and pitch angles of q, in radians."""
    xp = array_namespace(q)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    roll = xp.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = xp.asin(xp.minimum(xp.maximum(2 * (w * y - z * x), -1.0), 1.0))
    return roll, pitch


def rotation_vector(q: Array) -> Array:
    """Return the axis times the angle of q, the shorter way round, in radians."""
    xp = array_namespace(q)
    q = xp.where(q[..., :1] < 0, -q, q)
    sine = norm(q[..., 1:])
    angle = 2.0 * xp.atan2(sine, q[..., 0])
    small = sine < 1e-9
    scale = xp.where(small, 2.0, angle / xp.where(small, 1.0, sine))
    return q[..., 1:] * scale[..., None]


def from_rotation_vector(vector: Array) -> Array:
    """Return the quaternion of a rotation given as its axis times its angle."""
    xp = array_namespace(vector)
    angle = norm(vector)
    # For a vanishing angle, sin(angle / 2) / angle is 1 / 2.
    small = angle < 1e-9
    scale = xp.where(small, 0.5, xp.sin(angle / 2) / xp.where(small, 1.0, angle))
    scaled = scale[..., None] * vector
    return xp.concat([xp.cos(angle / 2)[..., None], scaled], axis=-1)


def from_yaw(yaw: Array) -> Array:
    """Return the quaternion of a turn by yaw radians about z."""
    xp = array_namespace(yaw)
    zero = xp.zeros_like(yaw)
    return xp.stack([xp.cos(yaw / 2), zero, zero, xp.sin(yaw / 2)], axis=-1)


def pose(pos: Array, quat: Array) -> Array:
    """Return the observation block of a pose: position, then quaternion x y z w.

    That is the order of the thesis's observation tables.
    """
    xp = array_namespace(pos, quat)
    return xp.concat([pos, quat[..., 1:], quat[..., :1]], axis=-1)
