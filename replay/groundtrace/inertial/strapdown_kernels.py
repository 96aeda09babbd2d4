"""The loops of :mod:`.strapdown` and :mod:`.error_state`, compiled: segment after segment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from ..heading.rotation_kernels import (
    add_matrix,
    held,
    normalise,
    of_angles,
    put,
    rotated,
    times,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading.rotation_kernels import Vector

    Array = NDArray[np.float64]


@compiled
def felt(sample: Array, bias: Array) -> Vector:
    """Return a sample less its bias, shape (3,) each."""
    return sample[0] - bias[0], sample[1] - bias[1], sample[2] - bias[2]


@compiled
def integrate(
    orientation: Array,
    velocity: Array,
    place: Array,
    biases: Array,
    interval_s: Array,
    rate: Array,
    force: Array,
    gravity: float,
) -> tuple[Array, Array, Array, Array, float, float]:
    """Go over a segment, rates and forces taken as straight between samples.

    Parameters
    ----------
    orientation, velocity, place
        At its start, shapes (4,), (3,), (3,).
    biases
        Of gyroscope and accelerometer, shape (2, 3).
    interval_s, rate, force
        Shapes (n,), (n + 1, 3), (n + 1, 3).
    gravity
        Its acceleration [m/s2].

    Returns
    -------
    Orientation, velocity, place at its end, what was gained of velocity, and how far it turned and
    was pushed.
    """
    q = held(orientation)
    turned_rad, pushed_mps = 0.0, 0.0
    speed, there, gained = velocity.copy(), place.copy(), np.zeros(3)
    before = rotated(q, felt(force[0], biases[1]))
    for i in range(len(interval_s)):
        dt = interval_s[i]
        last, rates = felt(rate[i], biases[0]), felt(rate[i + 1], biases[0])
        x, y, z = (
            0.5 * (rates[0] + last[0]) * dt,
            0.5 * (rates[1] + last[1]) * dt,
            0.5 * (rates[2] + last[2]) * dt,
        )
        turned_rad += math.sqrt(x * x + y * y + z * z)
        q = times(q, of_angles(x, y, z))
        now = rotated(q, felt(force[i + 1], biases[1]))
        size = 0.0
        for k in range(3):
            push = 0.5 * (now[k] + before[k]) * dt - (gravity * dt if k == 2 else 0.0)
            gained[k] += push
            there[k] += (velocity[k] + gained[k] - 0.5 * push) * dt
            size += push * push
        before = now
        pushed_mps += math.sqrt(size)
    end = np.empty(4)
    put(q, end)
    for k in range(3):
        speed[k] += gained[k]
    return end, speed, there, gained, turned_rad, pushed_mps


@compiled
def transition(first: Array, last: Array, gained: Array, length_s: float, gravity: float) -> Array:
    """Return the transition of a short segment, shape (15, 15), by orientations at its ends."""
    middle, axes, out = 0.5 * (first + last), np.zeros((3, 3)), np.eye(15)
    normalise(middle)
    add_matrix(held(middle), length_s, axes)
    x, y, z = gained[0], gained[1], gained[2] + gravity * length_s
    force = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    for i in range(3):
        out[6 + i, 3 + i] = length_s
        for k in range(3):
            out[i, 9 + k] = -axes[i, k]
            out[3 + i, k] = -force[i][k]
            out[3 + i, 12 + k] = -axes[i, k]
            coupled = 0.0
            for j in range(3):
                coupled += force[i][j] * axes[j, k]
            out[3 + i, 9 + k] = 0.5 * coupled
            out[6 + i, k] = 0.5 * length_s * out[3 + i, k]
            out[6 + i, 12 + k] = 0.5 * length_s * out[3 + i, 12 + k]
            out[6 + i, 9 + k] = length_s / 3.0 * out[3 + i, 9 + k]
    return out
