"""What is measured of each step, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..heading.rotation_kernels import add_matrix, held, rotated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading.rotation_kernels import Vector

    Array = NDArray[np.float64]
    Times = NDArray[np.int64]

_TWO_PI = 2.0 * math.pi


@compiled
def spread_of(x: Array) -> float:
    """Return the largest less the smallest value."""
    return float(x.max() - x.min())


@in_place
def rows_between(time_ns: Times, start_ns: int, stop_ns: int) -> tuple[int, int]:
    """Return first and last place plus one of samples in ``[start_ns, stop_ns)``.

    Where there is none it is those of one sample that is near.
    """
    first = min(int(np.searchsorted(time_ns, start_ns)), len(time_ns) - 1)
    return first, max(int(np.searchsorted(time_ns, stop_ns)), first + 1)


@compiled
def shape(
    time_ns: Times,
    acceleration: Array,
    start_ns: int,
    stop_ns: int,
    margin_ns: int,
    smooth_s: float,
) -> tuple[float, float]:
    """Return swing and rise of a step by its accelerations, shape (n, 3), the last of them upward.

    Averages over ``smooth_s`` reach as far as there are samples, up to ``margin_ns`` before and
    after the step, and count as nothing beyond. Without three samples both are 0.
    """
    begin, end = rows_between(time_ns, start_ns - margin_ns, stop_ns + margin_ns)
    time_ns, acceleration = time_ns[begin:end], acceleration[begin:end]
    n = len(time_ns)
    if n < 3:
        return 0.0, 0.0
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


@in_place
def mean_heading(
    time_ns: Times, orientation: Array, axis: Array, start_ns: int, stop_ns: int
) -> float:
    """Return the mean direction of a body axis in the horizontal plane, turns followed [rad]."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    ahead, total, before, turns = (axis[0], axis[1], axis[2]), 0.0, 0.0, 0.0
    for i in range(begin, end):
        x, y, _ = rotated(held(orientation[i]), ahead)
        angle = math.atan2(y, x)
        if i > begin:
            turns -= _TWO_PI * round((angle - before) / _TWO_PI)
        before = angle
        total += angle + turns
    return total / (end - begin)


@compiled
def mean_up(time_ns: Times, orientation: Array, start_ns: int, stop_ns: int) -> Vector:
    """Return which way up is in the axes of a body, on average."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    mean = np.zeros((3, 3))
    for i in range(begin, end):
        add_matrix(held(orientation[i]), 1.0 / (end - begin), mean)
    return mean[2, 0], mean[2, 1], mean[2, 2]


@in_place
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


@in_place
def resolve(orientation: Array, acceleration: Array, axis: Array, out: Array) -> None:
    """Put accelerations along an axis' heading, to the right of it and up, (n, 3), in (3, n)."""
    ahead = (axis[0], axis[1], axis[2])
    for i in range(len(orientation)):
        x, y, _ = rotated(held(orientation[i]), ahead)
        flat = math.sqrt(x * x + y * y)
        cos, sin = (x / flat, y / flat) if flat > 0 else (1.0, 0.0)
        east, north = acceleration[i, 0], acceleration[i, 1]
        out[0, i], out[1, i] = cos * east + sin * north, sin * east - cos * north
        out[2, i] = acceleration[i, 2]


@compiled
def swing_about(
    time_ns: Times,
    orientation: Array,
    acceleration: Array,
    axis: Array,
    step_ns: int,
    reach_ns: int,
) -> tuple[bool, complex, complex]:
    """Return the swing along an axis' heading and to the right, as :func:`swing`, about a step.

    False first as well where a twentieth of the time within ``reach_ns`` of it has no samples.
    """
    begin, end = rows_between(time_ns, step_ns - reach_ns, step_ns + reach_ns)
    if time_ns[end - 1] - time_ns[begin] < 1.9 * reach_ns:
        return False, 0j, 0j
    values, phase = np.empty((3, end - begin)), np.empty(end - begin)
    resolve(orientation[begin:end], acceleration[begin:end], axis, values)
    for i in range(end - begin):
        phase[i] = (time_ns[begin + i] - step_ns) / reach_ns
    return swing(values, phase)


@in_place
def mean_vector(time_ns: Times, vectors: Array, start_ns: int, stop_ns: int) -> Vector:
    """Return the mean of vectors, shape (n, 3), in a time; NaN where there is none."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    x, y, z, count = 0.0, 0.0, 0.0, float(end - begin)
    for i in range(begin, end):
        x, y, z = x + vectors[i, 0], y + vectors[i, 1], z + vectors[i, 2]
    return x / count, y / count, z / count


@in_place
def mean_near(time_ns: Times, values: Array, middle_ns: int, reach_ns: int) -> float:
    """Return the mean of the values at most ``reach_ns`` from a time; NaN where there is none."""
    total, count = 0.0, 0.0
    for i in range(len(time_ns)):
        if abs(time_ns[i] - middle_ns) <= reach_ns:
            total += values[i]
            count += 1.0
    return total / count
