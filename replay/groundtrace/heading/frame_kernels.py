"""The loops over the samples of a frame, compiled: those of :mod:`.inertial_frames`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from .rotation_kernels import add_matrix, multiply, of_vector, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled
def turns_of(rate: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Return rotations from the end and from the middle of each sample's interval to the start.

    Shapes (n, 4) each, and the mean matrix of the latter, shape (3, 3); ``rate`` is free of bias,
    shape (n, 3).
    """
    count = len(rate)
    turns, middles, mean = np.empty((count, 4)), np.empty((count, 4)), np.zeros((3, 3))
    back = np.empty(4)
    for i in range(count):
        of_vector(rate[i], step_s, turns[i])
        if i > 0:
            multiply(turns[i - 1], turns[i], turns[i])
        of_vector(rate[i], -0.5 * step_s, back)
        multiply(turns[i], back, middles[i])
        add_matrix(middles[i], 1.0 / count, mean)
    return turns, middles, mean


@compiled
def mean_turned(q: Array, vectors: Array) -> Array:
    """Return the mean of vectors, shape (n, 3), each turned by its quaternion."""
    out, now = np.zeros(3), np.empty(3)
    for i in range(len(q)):
        turn(q[i], vectors[i], now)
        out += now
    return out / len(q)


@compiled
def mean_and_spread(x: Array) -> tuple[Array, float, float]:
    """Return mean, shape (3,), root mean square, and that of the deviation, of vectors (n, 3)."""
    mean, square, apart = np.zeros(3), 0.0, 0.0
    for i in range(len(x)):
        mean += x[i]
    mean /= len(x)
    for i in range(len(x)):
        for k in range(3):
            square += x[i, k] * x[i, k]
            apart += (x[i, k] - mean[k]) * (x[i, k] - mean[k])
    return mean, math.sqrt(square / len(x)), math.sqrt(apart / len(x))


@compiled
def field_of(
    field: Array, rate: Array, middles: Array, delay_s: float
) -> tuple[Array, float, float]:
    """Return the mean field in the axes of the frame's start, and sums that tell its delay."""
    count = len(field)
    still, moved = np.empty((count, 3)), np.empty((count, 3))
    ahead, mean, mean_moved = np.empty(4), np.zeros(3), np.zeros(3)
    for i in range(count):
        of_vector(rate[i], -delay_s, ahead)
        turn(ahead, field[i], still[i])
        (x, y, z), (a, b, c) = rate[i], still[i]
        moved[i, 0], moved[i, 1], moved[i, 2] = y * c - z * b, z * a - x * c, x * b - y * a
        turn(middles[i], still[i], still[i])
        turn(middles[i], moved[i], moved[i])
        mean += still[i]
        mean_moved += moved[i]
    mean /= count
    mean_moved /= count
    across, along = 0.0, 0.0
    for i in range(count):
        for k in range(3):
            off = moved[i, k] - mean_moved[k]
            across += off * (still[i, k] - mean[k])
            along += off * off
    return mean, across, along


@compiled
def headings(start: Array, turns: Array, axis: Array) -> tuple[Array, Array]:
    """Return the orientation after each turn, (n, 4), and the direction of a body axis, (n,)."""
    orientation, heading, pointing = np.empty((len(turns), 4)), np.empty(len(turns)), np.empty(3)
    for i in range(len(turns)):
        multiply(start, turns[i], orientation[i])
        turn(orientation[i], axis, pointing)
        heading[i] = math.atan2(pointing[1], pointing[0])
    return orientation, heading


@compiled
def due_places(
    time_ns: NDArray[np.int64], due_ns: int, every_ns: float, period_ns: float
) -> tuple[NDArray[np.int64], int]:
    """Return the samples at which something is due every so often, and when it is due next.

    ``due_ns`` is when that is first; -1 for the first sample.
    """
    found, count = np.empty(len(time_ns), np.int64), 0
    for i in range(len(time_ns)):
        if due_ns < 0 or time_ns[i] >= due_ns - period_ns / 2:
            found[count] = i
            count += 1
            due_ns = round(max(max(due_ns, 0), time_ns[i] - every_ns / 2) + every_ns)
    return found[:count], due_ns
