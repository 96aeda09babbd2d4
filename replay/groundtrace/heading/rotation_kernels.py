"""Quaternions (w, x, y, z) and small systems of equations, compiled: for loops over frames.

The same as :mod:`.rotations`, of one at a time: as plain numbers, or into arrays that are given.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import LANES, every, put_row, row_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Quaternion = tuple[float, float, float, float]
    Vector = tuple[float, float, float]


@in_place
def held(a: Array) -> Quaternion:
    """Return a quaternion out of an array."""
    return a[0], a[1], a[2], a[3]


@in_place
def times(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product a b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@in_place
def of_angles(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    share = 0.5 * (math.sin(half) / half if half > 0.0 else 1.0)
    return math.cos(half), share * x, share * y, share * z


@in_place
def crossed(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@in_place
def rotated(q: Quaternion, v: Vector) -> Vector:
    """Return a vector turned by a quaternion."""
    x, y, z = crossed((q[1], q[2], q[3]), v)
    twice = (2.0 * x, 2.0 * y, 2.0 * z)
    a, b, c = crossed((q[1], q[2], q[3]), twice)
    return v[0] + q[0] * twice[0] + a, v[1] + q[0] * twice[1] + b, v[2] + q[0] * twice[2] + c


@in_place
def put(q: Quaternion, out: Array) -> None:
    """Put a quaternion in an array."""
    out[0], out[1], out[2], out[3] = q


@in_place
def multiply(a: Array, b: Array, out: Array) -> None:
    """Put the product a b in ``out``, which may be either of them."""
    put(times(held(a), held(b)), out)


@in_place
def normalise(q: Array) -> None:
    """Make a quaternion's length 1."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= length


@in_place
def turn_by(error: Array, orientation: Array) -> None:
    """Turn an orientation, shape (4,), by a small rotation in the earth frame, (3,)."""
    put(times(of_angles(error[0], error[1], error[2]), held(orientation)), orientation)
    normalise(orientation)


@in_place
def add_matrix(q: Quaternion, share: float, out: Array) -> None:
    """Add ``share`` times the rotation matrix of a quaternion to ``out``, shape (3, 3)."""
    w, x, y, z = q
    out[0, 0] += share * (w * w + x * x - y * y - z * z)
    out[0, 1] += share * 2.0 * (x * y - w * z)
    out[0, 2] += share * 2.0 * (x * z + w * y)
    out[1, 0] += share * 2.0 * (x * y + w * z)
    out[1, 1] += share * (w * w - x * x + y * y - z * z)
    out[1, 2] += share * 2.0 * (y * z - w * x)
    out[2, 0] += share * 2.0 * (x * z - w * y)
    out[2, 1] += share * 2.0 * (y * z + w * x)
    out[2, 2] += share * (w * w - x * x - y * y + z * z)


@in_place
def identity(out: Array) -> None:
    """Make a matrix, shape (n, n), the identity."""
    out[:] = 0.0
    for i in range(len(out)):
        out[i, i] = 1.0


@in_place
def product(left: Array, right: Array, out: Array) -> None:
    """Put ``left @ right`` in ``out``; zeros of the left matrix are passed over.

    Each row of the right matrix and of ``out`` lies in one piece.
    """
    width = right.shape[1]
    if right.strides[1] != right.itemsize or out.strides[1] != out.itemsize:
        raise ValueError("expected rows that lie in one piece")
    for i in range(left.shape[0]):
        if width < LANES:
            out[i] = 0.0
            for k in range(left.shape[1]):
                if left[i, k] != 0.0:
                    for j in range(width):
                        out[i, j] += left[i, k] * right[k, j]
        for j in range(0, width if width >= LANES else 0, LANES):
            # the last row of lanes ends where the matrix does
            first, total = min(j, width - LANES), every(0.0)
            for k in range(left.shape[1]):
                if left[i, k] != 0.0:
                    total = total + every(left[i, k]) * row_from(right[k], first)
            put_row(out[i, first:], 0, total)


@in_place
def carry(step: Array, covariance: Array, room: Array) -> None:
    """Put ``step @ covariance @ step.T`` in the covariance, shape (n, n).

    Zeros of the step are passed over. ``room``, shape (2, n, n), is written over.
    """
    half, across = room[0], room[1]
    product(step, covariance, half)
    transpose(half, across)
    # the result's transpose, so that neighbours in memory are added
    product(step, across, half)
    transpose(half, covariance)


@in_place
def transpose(matrix: Array, out: Array) -> None:
    """Put the transpose of a matrix, shape (n, m), in ``out``."""
    for i in range(matrix.shape[0]):
        for k in range(matrix.shape[1]):
            out[k, i] = matrix[i, k]


@in_place
def solve(matrix: Array, sides: Array) -> None:
    """Solve ``matrix @ x = sides`` in place, by elimination with the largest pivot.

    Both are overwritten: ``sides``, shape (n, k), by the solution.
    """
    n, width = sides.shape
    for i in range(n):
        best = i
        for r in range(i + 1, n):
            if abs(matrix[r, i]) > abs(matrix[best, i]):
                best = r
        if best != i:
            for j in range(n):
                matrix[i, j], matrix[best, j] = matrix[best, j], matrix[i, j]
            for j in range(width):
                sides[i, j], sides[best, j] = sides[best, j], sides[i, j]
        for r in range(i + 1, n):
            share = matrix[r, i] / matrix[i, i]
            if share != 0.0:
                for j in range(i, n):
                    matrix[r, j] -= share * matrix[i, j]
                for j in range(width):
                    sides[r, j] -= share * sides[i, j]
    for i in range(n - 1, -1, -1):
        for r in range(i + 1, n):
            share = matrix[i, r]
            if share != 0.0:
                for j in range(width):
                    sides[i, j] -= share * sides[r, j]
        pivot = matrix[i, i]
        for j in range(width):
            sides[i, j] /= pivot


@compiled
def joseph(
    covariance: Array, pick: Array, spread: Array, noise: Array, kept: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return gain, shape (n, m), and covariance after a measurement, in Joseph's form.

    Parameters
    ----------
    covariance
        Before, shape (n, n).
    pick
        What the measurement sees of the state, shape (m, n).
    spread, noise
        Covariance of the innovation, and the measurement's part of it, shape (m, m).
    kept
        Shape (n,): rows that keep their estimate.
    """
    n, m = len(covariance), len(pick)
    across, gain, left = np.empty((m, n)), np.empty((n, m)), np.zeros((n, n))
    product(pick, covariance, across)
    solve(spread.copy(), across)
    transpose(across, gain)
    for i in range(n):
        left[i, i] = 1.0
        for k in range(m):
            share = 0.0 if kept[i] else gain[i, k]
            gain[i, k] = share
            for j in range(n):
                left[i, j] -= share * pick[k, j]
    after = covariance.copy()
    carry(left, after, np.empty((2, n, n)))
    for i in range(n):
        for a in range(m):
            for b in range(m):
                share = gain[i, a] * noise[a, b]
                if share != 0.0:
                    for j in range(n):
                        after[i, j] += share * gain[j, b]
    return gain, after
