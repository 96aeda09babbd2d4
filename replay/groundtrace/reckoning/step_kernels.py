"""What is measured of each step, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from ..heading.rotation_kernels import add_matrix, held, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_TWO_PI = 2.0 * math.pi


@compiled
def spread_of(x: Array) -> float:
    """Return the largest less the smallest value."""
    return float(x.max() - x.min())


@compiled
def shape(
    time_ns: NDArray[np.int64], acceleration: Array, margin_ns: int, smooth_s: float
) -> tuple[float, float]:
    """Return swing and rise of a step by its accelerations, shape (n, 3), the last of them upward.

    Averages over ``smooth_s`` reach as far as there are samples, and count as nothing beyond.
    """
    n = len(time_ns)
    period_s = (time_ns[n - 1] - time_ns[0]) / 1e9 / (n - 1)
    width = max(1, round(smooth_s / period_s))
    later = (width - 1) // 2
    up, count, all_up = np.empty(n), 0, np.empty(n)
    for i in range(n):
        total = 0.0
        for k in range(max(0, i + later - width + 1), min(n, i + later + 1)):
            total += acceleration[k, 2] * (1 / width)
        all_up[i] = total
        first, last = time_ns[0] + margin_ns, time_ns[n - 1] - margin_ns
        if first <= time_ns[i] <= last:
            up[count] = total
            count += 1
    inside = up[:count] if count >= 3 else all_up
    speed = np.cumsum(inside - inside.mean()) * period_s
    height = np.cumsum(speed - speed.mean()) * period_s
    return spread_of(inside), spread_of(height)


@compiled
def mean_heading(orientation: Array, axis: Array) -> float:
    """Return the mean direction of a body axis in the horizontal plane, turns followed [rad]."""
    pointing, total, before, turns = np.empty(3), 0.0, 0.0, 0.0
    for i in range(len(orientation)):
        turn(orientation[i], axis, pointing)
        angle = math.atan2(pointing[1], pointing[0])
        if i > 0:
            turns -= _TWO_PI * round((angle - before) / _TWO_PI)
        before = angle
        total += angle + turns
    return total / len(orientation)


@compiled
def mean_up(orientation: Array) -> Array:
    """Return which way up is in the axes of a body, on average, shape (3,)."""
    mean, up = np.zeros((3, 3)), np.empty(3)
    for i in range(len(orientation)):
        add_matrix(held(orientation[i]), 1.0 / len(orientation), mean)
    up[:] = mean[2]
    return up


@compiled
def swing(values: Array, phase: Array) -> tuple[bool, complex, complex]:
    """Return the swing of two signals as parts of the third's, shape (3, n), at one per step.

    Over two whole steps, in which what repeats with every second step adds up to nothing; False
    first where the third has none.
    """
    ahead, right, up = 0j, 0j, 0j
    for i in range(len(phase)):
        if -1.0 <= phase[i] < 1.0:
            angle = -_TWO_PI * phase[i]
            wave = complex(math.cos(angle), math.sin(angle))
            ahead += values[0, i] * wave
            right += values[1, i] * wave
            up += values[2, i] * wave
    size = abs(up)
    if not size > 0:
        return False, 0j, 0j
    back = up.conjugate() / size**2
    return True, ahead * back, right * back


@compiled
def resolved(orientation: Array, acceleration: Array, axis: Array) -> Array:
    """Return accelerations along an axis' heading, to the right of it and up, (n, 3) to (3, n)."""
    out, pointing = np.empty((3, len(orientation))), np.empty(3)
    for i in range(len(orientation)):
        turn(orientation[i], axis, pointing)
        angle = math.atan2(pointing[1], pointing[0])
        cos, sin = math.cos(angle), math.sin(angle)
        east, north = acceleration[i, 0], acceleration[i, 1]
        out[0, i], out[1, i] = cos * east + sin * north, sin * east - cos * north
        out[2, i] = acceleration[i, 2]
    return out


@compiled
def mean_vector(vectors: Array) -> tuple[float, float, float]:
    """Return the mean of vectors, shape (n, 3); NaN where there is none."""
    x, y, z, count = 0.0, 0.0, 0.0, float(len(vectors))
    for i in range(len(vectors)):
        x, y, z = x + vectors[i, 0], y + vectors[i, 1], z + vectors[i, 2]
    return x / count, y / count, z / count


@compiled
def mean_near(time_ns: NDArray[np.int64], values: Array, middle_ns: int, reach_ns: int) -> float:
    """Return the mean of the values at most ``reach_ns`` from a time; NaN where there is none."""
    total, count = 0.0, 0.0
    for i in range(len(time_ns)):
        if abs(time_ns[i] - middle_ns) <= reach_ns:
            total += values[i]
            count += 1.0
    return total / count
