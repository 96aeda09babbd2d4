"""Rotations that tests make: of rotation vectors, one after the other."""

from __future__ import annotations

import numpy as np

from groundtrace.inertial.rotations import product


def of_vectors(angle: np.ndarray) -> np.ndarray:
    """Return the quaternions of rotation vectors [rad], shape (..., 3) to (..., 4)."""
    half = 0.5 * np.sqrt(np.einsum("...i,...i", angle, angle))
    out = np.empty((*angle.shape[:-1], 4))
    out[..., 0] = np.cos(half)
    # numpy's sinc is sin(pi x) / (pi x), and 1 at 0
    out[..., 1:] = 0.5 * np.sinc(half / np.pi)[..., None] * angle
    return out


def running_products(q: np.ndarray) -> np.ndarray:
    """Return q0, q0 q1, q0 q1 q2, ..., shape (n, 4), in about log2(n) array operations."""
    out, reach = q.copy(), 1
    while reach < len(out):
        out[reach:] = product(out[:-reach], out[reach:])
        reach *= 2
    return out


def skew(v: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product with ``v``, shape (3, 3)."""
    x, y, z = v.tolist()
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], np.float64)
