"""Loops over the axes of the body that wears a sensor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Rows of the state: means of force, of rate, and of what turns make of gravity; and weights, the
#: sums of those of the first two means in the first two places.
_FORCE, _RATE, _TURNS, _LEFT = range(4)


@compiled("f8[:, ::1](f8[:, ::1], f8[:, ::1], f8[:, ::1], UniTuple(f8, 3))")
def directions(force: Array, rate: Array, state: Array, keeps: tuple[float, float, float]) -> Array:
    """Return gravity of every sample, shape (3, n); the state, shape (4, 3), goes on in place.

    Parameters
    ----------
    force, rate
        Specific force and angular velocity, shape (3, n); no rows of the latter: there is none.
    keeps
        What a sample keeps of the means of gravity and of the gyroscope's offset, and the time
        constant of gravity [s].
    """
    keep, keep_offset, gravity_s = keeps
    out, turning = np.empty(force.shape), len(rate) > 0
    means, offsets, turns, left = state[_FORCE], state[_RATE], state[_TURNS], state[_LEFT]
    for i in range(force.shape[1]):
        # the weights that an endless past would have had are left out of the sums
        left[0] = keep * left[0] + (1 - keep)
        left[1] = keep_offset * left[1] + (1 - keep_offset)
        for k in range(3):
            means[k] = (1 - keep) * force[k, i] + keep * means[k]
            out[k, i] = means[k] / left[0]
        if not turning:
            continue
        for k in range(3):
            offsets[k] = (1 - keep_offset) * rate[k, i] + keep_offset * offsets[k]
        x = rate[0, i] - offsets[0] / left[1]
        y = rate[1, i] - offsets[1] / left[1]
        z = rate[2, i] - offsets[2] / left[1]
        a, b, c = out[0, i], out[1, i], out[2, i]
        # a fixed direction turns against the body
        turns[0] = (1 - keep) * gravity_s * (b * z - c * y) + keep * turns[0]
        turns[1] = (1 - keep) * gravity_s * (c * x - a * z) + keep * turns[1]
        turns[2] = (1 - keep) * gravity_s * (a * y - b * x) + keep * turns[2]
        for k in range(3):
            out[k, i] += turns[k]
    return out


@compiled("f8[:, ::1](f8[:, ::1], f8[:, ::1], f8[::1], f8)")
def resolved(force: Array, gravity: Array, nominal: Array, steep: float) -> Array:
    """Return accelerations ahead, to the right and up, without gravity, shape (3, n).

    Parameters
    ----------
    force, gravity
        In the sensor's axes, shape (3, n).
    nominal
        The axis that looks ahead, shape (3,); where it is ``steep`` or more upright, by its cosine,
        the one that follows it in x, y, z does.
    """
    out = np.empty(force.shape)
    for i in range(force.shape[1]):
        x, y, z = gravity[0, i], gravity[1, i], gravity[2, i]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 0:
            x, y, z = x / length, y / length, z / length
        a, b, c = nominal[0], nominal[1], nominal[2]
        if abs(a * x + b * y + c * z) > steep:
            a, b, c = c, a, b
        along = a * x + b * y + c * z
        a, b, c = a - along * x, b - along * y, c - along * z
        level = math.sqrt(a * a + b * b + c * c)
        a, b, c = a / level, b / level, c / level
        u, v, w = force[0, i], force[1, i], force[2, i]
        out[0, i] = a * u + b * v + c * w
        out[1, i] = (b * z - c * y) * u + (c * x - a * z) * v + (a * y - b * x) * w
        out[2, i] = x * u + y * v + z * w - length
    return out
