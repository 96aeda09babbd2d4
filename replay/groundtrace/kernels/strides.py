"""What a worn sensor feels of one step: swing and rise, the walking axis, and where it looks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from numba import float64, int64, void
from numba.types import Array as ArrayType
from numba.types import UniTuple

from .algebra import quaternion, rotate, vector
from .compiling import compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .algebra import Array

_TIMES = ArrayType(int64, 1, "C", readonly=True)
_GIVEN, _ROWS = (ArrayType(float64, n, "C", readonly=True) for n in (1, 2))
#: A full turn [rad]. Source: SI.
_TWO_PI = 2.0 * math.pi


@compiled(UniTuple(float64, 3)(_TIMES, _ROWS, int64, float64, int64, float64[:, ::1]))
def shape(
    time_ns: NDArray[np.int64],
    acceleration: Array,
    margin_ns: int,
    smooth_s: float,
    ns_per_s: int,
    room: Array,
) -> tuple[float, float, float]:
    """Return swing [m/s2], rise [m] and peak-end time [s] of a step by its accelerations.

    The last column is upward. The peak-end time is that from the highest to the lowest after it.

    Averages over ``smooth_s`` count as nothing beyond the samples, three at least, shape (n,) and
    (n, 3), which begin and end ``margin_ns`` before and after the step. The room, shape (2, n), is
    written over.
    """
    n, up, smooth, count = len(time_ns), room[0], room[1], 0
    period_s = (time_ns[n - 1] - time_ns[0]) / ns_per_s / (n - 1)
    width = max(1, round(smooth_s / period_s))
    later, total = (width - 1) // 2, 0.0
    for i in range(n):
        smooth[i] = 0.0
        for k in range(max(0, i + later - width + 1), min(n, i + later + 1)):
            smooth[i] += acceleration[k, 2] * (1.0 / width)
        if time_ns[0] + margin_ns <= time_ns[i] <= time_ns[n - 1] - margin_ns:
            up[count] = smooth[i]
            count += 1
    inside = up[:count] if count >= 3 else smooth
    low, high = inside[0], inside[0]
    top = bottom = 0
    for i in range(len(inside)):
        low, total = min(low, inside[i]), total + inside[i]
        if inside[i] > high:
            high, top, bottom = inside[i], i, i
        elif inside[i] < inside[bottom]:
            bottom = i
    for _ in range(2):  # what it gains about its mean: the speed, then the height
        mean, gained, total = total / len(inside), 0.0, 0.0
        for i in range(len(inside)):
            gained += inside[i] - mean
            inside[i] = gained * period_s
            total += inside[i]
    least, most = inside[0], inside[0]
    for x in inside:
        least, most = min(least, x), max(most, x)
    return high - low, most - least, (bottom - top) * period_s


@compiled(float64(_ROWS, _GIVEN))
def mean_heading(orientation: Array, axis: Array) -> float:
    """Return the mean direction of a body axis in the horizontal plane, turns followed [rad]."""
    total, before, turns = 0.0, 0.0, 0.0
    for i in range(len(orientation)):
        x, y, _ = rotate(quaternion(orientation[i]), vector(axis))
        angle = math.atan2(y, x)
        if i > 0:
            turns -= _TWO_PI * round((angle - before) / _TWO_PI)
        before = angle
        total += angle + turns
    return total / len(orientation)


@compiled(void(_ROWS, _ROWS, _GIVEN, float64[:, ::1]))
def resolve(orientation: Array, acceleration: Array, axis: Array, out: Array) -> None:
    """Put accelerations along an axis' heading, to the right of it and up, (n, 3), in (3, n)."""
    for i in range(len(orientation)):
        x, y, _ = rotate(quaternion(orientation[i]), vector(axis))
        flat = math.hypot(x, y)
        cos, sin = (x / flat, y / flat) if flat != 0.0 else (0.0, 0.0)
        east, north = acceleration[i, 0], acceleration[i, 1]
        out[0, i], out[1, i] = cos * east + sin * north, sin * east - cos * north
        out[2, i] = acceleration[i, 2]


@compiled(void(_ROWS, _GIVEN, float64[:, ::1]))
def swing(values: Array, phase: Array, out: Array) -> None:
    """Put the parts of three signals, (3, n), at a frequency of one per step in ``out``, (3, 2).

    They are sums of each times exp(-2 pi i phase), real and imaginary, over two whole steps, in
    which what repeats with every second step adds up to nothing.
    """
    out[:] = 0.0
    for i in range(len(phase)):
        if -1.0 <= phase[i] < 1.0:
            cos, sin = math.cos(_TWO_PI * phase[i]), -math.sin(_TWO_PI * phase[i])
            for k in range(3):
                out[k, 0] += values[k, i] * cos
                out[k, 1] += values[k, i] * sin
