"""Quaternions, rotations and small matrices for compiled functions, each by its equation.

Quaternions are (w, x, y, z) that turn vectors of the body into the earth frame, as in
:mod:`.inertial.rotations`. Here they are tuples, one at a time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .compiling import inlined

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Quaternion = tuple[float, float, float, float]
    Vector = tuple[float, float, float]


@inlined
def quaternion(values: Array) -> Quaternion:
    """Return the first four values of an array."""
    return values[0], values[1], values[2], values[3]


@inlined
def vector(values: Array) -> Vector:
    """Return the first three values of an array."""
    return values[0], values[1], values[2]


@inlined
def quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p q: (pw qw - p . q, pw q + qw p + p x q), with the vector parts p and q."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


@inlined
def rotation_of(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion (cos a/2, sin a/2 u) of a rotation vector a u [rad]."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    share = 0.5 * (math.sin(half) / half if half > 0.0 else 1.0)
    return math.cos(half), share * x, share * y, share * z


@inlined
def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return a vector turned by a quaternion (w, u): v + w t + u x t, where t = 2 u x v."""
    w, a, b, c = q
    x, y, z = v
    i, j, k = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x + w * i + (b * k - c * j), y + w * j + (c * i - a * k), z + w * k + (a * j - b * i)


@inlined
def add_rotation_matrix(q: Quaternion, weight: float, out: Array) -> None:
    """Add ``weight`` times the rotation matrix of a quaternion to ``out``, shape (3, 3)."""
    w, x, y, z = q
    out[0, 0] += weight * (w * w + x * x - y * y - z * z)
    out[0, 1] += weight * 2.0 * (x * y - w * z)
    out[0, 2] += weight * 2.0 * (x * z + w * y)
    out[1, 0] += weight * 2.0 * (x * y + w * z)
    out[1, 1] += weight * (w * w - x * x + y * y - z * z)
    out[1, 2] += weight * 2.0 * (y * z - w * x)
    out[2, 0] += weight * 2.0 * (x * z - w * y)
    out[2, 1] += weight * 2.0 * (y * z + w * x)
    out[2, 2] += weight * (w * w - x * x - y * y + z * z)


@inlined
def put_normalised(q: Quaternion, out: Array) -> None:
    """Put a quaternion at length 1 in an array."""
    w, x, y, z = q
    length = math.sqrt(w * w + x * x + y * y + z * z)
    out[0], out[1], out[2], out[3] = w / length, x / length, y / length, z / length


@inlined
def copy_matrix(values: Array, out: Array) -> None:
    """Put a matrix in another one."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]


@inlined
def product(left: Array, right: Array, out: Array) -> None:
    """Put ``left @ right`` in ``out``; zeros of the left matrix are passed over."""
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            out[i, j] = 0.0
        for k in range(left.shape[1]):
            weight = left[i, k]
            if weight != 0.0:
                for j in range(right.shape[1]):
                    out[i, j] += weight * right[k, j]


@inlined
def propagate_covariance(step: Array, covariance: Array, half: Array, transposed: Array) -> None:
    """Put F P F' in P, shape (n, n), where F is the ``step``; the other two are written over.

    It is F (F P)' for a P that is symmetric, so that neighbours in memory are added.
    """
    product(step, covariance, half)
    for i in range(half.shape[0]):
        for k in range(half.shape[1]):
            transposed[k, i] = half[i, k]
    product(step, transposed, half)
    for i in range(half.shape[0]):
        for k in range(half.shape[1]):
            covariance[k, i] = half[i, k]


@inlined
def kalman_gain(across: Array, spread: Array, gain: Array) -> None:
    """Put S^-1 H P in ``gain``, shape (3, n): the transposed gain of a measurement of three values.

    ``across`` is H P, shape (3, n), and ``spread`` is S = H P H' + R, shape (3, 3), which is taken
    apart into L L' (Cholesky).
    """
    l00 = math.sqrt(spread[0, 0])
    l10, l20 = spread[1, 0] / l00, spread[2, 0] / l00
    l11 = math.sqrt(spread[1, 1] - l10 * l10)
    l21 = (spread[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(spread[2, 2] - l20 * l20 - l21 * l21)
    for i in range(across.shape[1]):
        a = across[0, i] / l00
        b = (across[1, i] - l10 * a) / l11
        c = (across[2, i] - l20 * a - l21 * b) / l22 / l22
        b = (b - l21 * c) / l11
        gain[0, i], gain[1, i], gain[2, i] = (a - l10 * b - l20 * c) / l00, b, c


@inlined
def squared_distance(spread: Array, x: float, y: float, z: float) -> float:
    """Return v' S^-1 v of three values, S of shape (3, 3) taken apart into L L' (Cholesky)."""
    l00 = math.sqrt(spread[0, 0])
    l10, l20 = spread[1, 0] / l00, spread[2, 0] / l00
    l11 = math.sqrt(spread[1, 1] - l10 * l10)
    l21 = (spread[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(spread[2, 2] - l20 * l20 - l21 * l21)
    a = x / l00
    b = (y - l10 * a) / l11
    c = (z - l20 * a - l21 * b) / l22
    return float(a * a + b * b + c * c)


#: Least variance of a part of a state, where the others' are 1: some may be known exactly. Chosen
#: by judgement: far above the rounding of a division, far below any variance.
_KNOWN = 1e-12


@inlined
def rts_gain(
    covariance: Array,
    step: Array,
    predicted: Array,
    sides: Array,
    upper: Array,
    scale: Array,
    gain: Array,
) -> None:
    """Put P F' P_p^-1 in ``gain``, shape (n, n): that of smoothing by the knot after.

    Rows of P_p differ much, so they are scaled to a diagonal of 1, and taken apart into U' U
    (Cholesky).

    Parameters
    ----------
    covariance, step, predicted
        P, the transition F to the knot after, and P_p, predicted there, shape (n, n) each.
    sides, upper, scale
        Shapes (n, n), (n, n) and (n,), written over.
    """
    n = covariance.shape[0]
    product(step, covariance, sides)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(max(predicted[i, i], 1e-30))
    for i in range(n):
        for j in range(n):
            upper[i, j] = predicted[i, j] * scale[i] * scale[j]
            sides[i, j] *= scale[i]
        upper[i, i] += _KNOWN
    for i in range(n):
        for r in range(i):
            weight = upper[r, i]
            for j in range(i, n):
                upper[i, j] -= weight * upper[r, j]
        share = 1.0 / math.sqrt(max(upper[i, i], _KNOWN))
        for j in range(i, n):
            upper[i, j] *= share
    for side in range(2):  # U' y = sides, then U x = y
        for at in range(n):
            i = n - 1 - at if side else at
            for r in range(i + 1 if side else 0, n if side else i):
                weight = upper[i, r] if side else upper[r, i]
                for j in range(n):
                    sides[i, j] -= weight * sides[r, j]
            share = 1.0 / upper[i, i]
            for j in range(n):
                sides[i, j] *= share
    for i in range(n):
        for j in range(n):
            gain[j, i] = sides[i, j] * scale[i]


@inlined
def add_variances(
    covariance: Array, at: int, axes: Array, variances: Sequence[float] | Array
) -> None:
    """Add three variances, along the axes, to the block of a covariance that begins at a row."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                covariance[at + i, at + j] += axes[i, k] * axes[j, k] * variances[k]
