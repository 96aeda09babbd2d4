"""The loops of :mod:`.strapdown` and :mod:`.error_state`, compiled: segment after segment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from ..heading.rotation_kernels import add_matrix, held, multiply, normalise, of_vector, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


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
    q, turned, halfway = orientation.copy(), np.empty(4), np.empty(3)
    before, now, gained = np.empty(3), np.empty(3), np.zeros(3)
    there, turned_rad, pushed_mps = place.copy(), 0.0, 0.0
    turn(q, force[0] - biases[1], before)
    for i in range(len(interval_s)):
        dt = interval_s[i]
        size = 0.0
        for k in range(3):
            halfway[k] = 0.5 * ((rate[i + 1, k] - biases[0, k]) + (rate[i, k] - biases[0, k])) * dt
            size += halfway[k] * halfway[k]
        turned_rad += math.sqrt(size)
        of_vector(halfway, 1.0, turned)
        multiply(q, turned, q)
        turn(q, force[i + 1] - biases[1], now)
        size = 0.0
        for k in range(3):
            push = 0.5 * (now[k] + before[k]) * dt - (gravity * dt if k == 2 else 0.0)
            gained[k] += push
            there[k] += (velocity[k] + gained[k] - 0.5 * push) * dt
            before[k] = now[k]
            size += push * push
        pushed_mps += math.sqrt(size)
    return q, velocity + gained, there, gained, turned_rad, pushed_mps


@compiled
def transition(first: Array, last: Array, gained: Array, length_s: float, gravity: float) -> Array:
    """Return the transition of a short segment, shape (15, 15), by orientations at its ends."""
    middle, axes, out = 0.5 * (first + last), np.zeros((3, 3)), np.eye(15)
    normalise(middle)
    add_matrix(held(middle), length_s, axes)
    x, y, z = gained[0], gained[1], gained[2] + gravity * length_s
    force = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    for i in range(3):
        out[6 + i, 3 + i] = length_s
        for k in range(3):
            out[i, 9 + k] = -axes[i, k]
            out[3 + i, k] = -force[i, k]
            out[3 + i, 12 + k] = -axes[i, k]
            coupled = 0.0
            for j in range(3):
                coupled += force[i, j] * axes[j, k]
            out[3 + i, 9 + k] = 0.5 * coupled
            out[6 + i, k] = 0.5 * length_s * out[3 + i, k]
            out[6 + i, 12 + k] = 0.5 * length_s * out[3 + i, 12 + k]
            out[6 + i, 9 + k] = length_s / 3.0 * out[3 + i, 9 + k]
    return out
