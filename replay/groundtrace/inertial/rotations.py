"""Rotations as unit quaternions (w, x, y, z) that turn body vectors into the earth frame.

The earth frame is x east, y (magnetic) north, z up. A heading is an angle in the horizontal plane,
counter-clockwise from x.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def product(a: Array, b: Array) -> Array:
    """Return quaternion products a b, shape (..., 4)."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


def normalised(q: Array) -> Array:
    """Return quaternions of length 1."""
    return np.asarray(q / np.sqrt(np.einsum("...i,...i", q, q))[..., None])


def rotated(q: Array, vectors: Array) -> Array:
    """Return vectors, shape (..., 3), turned by quaternions, shape (..., 4)."""
    w, u = q[..., :1], q[..., 1:]
    twice = 2 * crossed(u, vectors)
    return np.asarray(vectors + w * twice + crossed(u, twice))


def crossed(a: Array, b: Array) -> Array:
    """Return cross products, shape (..., 3); faster than ``numpy.cross`` on short arrays."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = ay * bz - az * by
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out


def matrix(q: Array) -> Array:
    """Return the rotation matrix of one quaternion, shape (3, 3)."""
    return mean_matrix(q[None, :])


def mean_matrix(q: Array) -> Array:
    """Return the mean of the rotation matrices of quaternions, shape (n, 4) to (3, 3)."""
    (ww, wx, wy, wz), (_, xx, xy, xz), (_, _, yy, yz), (_, _, _, zz) = (q.T @ q / len(q)).tolist()
    return np.array(
        [
            [ww + xx - yy - zz, 2 * (xy - wz), 2 * (xz + wy)],
            [2 * (xy + wz), ww - xx + yy - zz, 2 * (yz - wx)],
            [2 * (xz - wy), 2 * (yz + wx), ww - xx - yy + zz],
        ]
    )


def levelled(force: Array) -> Array:
    """Return the orientation that turns a specific force upward by the shortest way, shape (4,)."""
    up = force / np.linalg.norm(force)
    if up[2] < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + up[2], up[1], -up[0], 0.0])
    return normalised(q)


def headings_of(q: Array, axis: Array) -> Array:
    """Return the direction of a body axis in the horizontal plane [rad], shape (n,)."""
    pointing = rotated(q, np.broadcast_to(axis, (*q.shape[:-1], 3)))
    return np.arctan2(pointing[..., 1], pointing[..., 0])


def wrap_angle(angle_rad: float) -> float:
    """Return an angle within [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
