"""The tests of a frame's field, and what is learned where they pass, compiled.

The same as :class:`.compass.Compass`, which goes by objects.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from .attitude_kernels import EARTH, IRON, SIZE, update

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TESLA = 1e-6
_TWO_PI = 2.0 * math.pi


@compiled
def wrapped(angle: float) -> float:
    """Return an angle within [-pi, pi)."""
    return (angle + math.pi) % _TWO_PI - math.pi


@compiled
def turn_about_vertical(before: Array, after: Array) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    w = after[0] * before[0] + after[1] * before[1] + after[2] * before[2] + after[3] * before[3]
    z = -after[0] * before[3] - after[1] * before[2] + after[2] * before[1] + after[3] * before[0]
    return wrapped(2.0 * math.atan2(z, w))


@compiled
def keep(values: Array, counts: NDArray[np.int64], row: int, value: float) -> None:
    """Add a value to those of a row, and drop the oldest where there are too many."""
    count, most = counts[row, 0], counts[row, 1]
    if count == most:
        values[row, : most - 1] = values[row, 1:most].copy()
        count -= 1
    values[row, count] = value
    counts[row, 0] = count + 1


@compiled
def deviation(values: Array) -> float:
    """Return the standard deviation of a few values."""
    mean = values.sum() / len(values)
    square = 0.0
    for value in values:
        square += (value - mean) * (value - mean)
    return math.sqrt(square / len(values))


@compiled
def tests(
    state: Array,
    seen: Array,
    sigma: float,
    recent: Array,
    counts: NDArray[np.int64],
    length_s: float,
    out: Array,
) -> None:
    """Put what the tests look at in ``out``, shape (8,); ``seen`` is the field, earth frame."""
    flat = math.hypot(seen[0], seen[1])
    norm = math.sqrt(seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2])
    north, up = state[EARTH], state[EARTH + 1]
    turned = math.atan2(seen[0], seen[1])
    left = math.copysign(max(abs(turned) - sigma, 0.0), turned)
    x, y, z = flat * math.sin(left), flat * math.cos(left) - north, seen[2] - up
    keep(recent, counts, 0, norm)
    keep(recent, counts, 1, turned)
    count = counts[1, 0]
    changed = math.degrees(wrapped(recent[1, count - 1] - recent[1, 0]))
    out[0] = math.sqrt(x * x + y * y + z * z) / TESLA
    out[1] = abs(norm - math.hypot(north, up)) / TESLA
    out[2] = deviation(recent[0, : counts[0, 0]]) / TESLA
    out[3] = abs(flat - north) / TESLA
    out[4] = abs(math.degrees(left))
    out[5] = abs(changed) / (count * length_s)
    out[6] = abs(math.degrees(math.atan2(-seen[2], flat) - math.atan2(-up, north)))
    out[7] = 0.0


@compiled
def passes(values: Array, limits: Array) -> bool:
    """Return whether all tests pass, their values as they are stored."""
    passed = 0
    for k in range(len(limits)):
        if limits[k] - np.float64(np.float32(values[k])) >= 0.0:
            passed += 1
    return passed == len(limits)


@compiled
def correct_field(
    state: Array, covariance: Array, turned: Array, field: Array, variance: float
) -> None:
    """Turn towards north by a field in the earth frame; ``turned`` is the mean turn there."""
    seen, pick, kept = field.copy(), np.zeros((3, SIZE)), np.zeros(SIZE, np.bool_)
    kept[0] = kept[1] = kept[3] = kept[4] = kept[5] = True  # a field must not change the tilt
    for i in range(3):
        for k in range(3):
            seen[i] -= turned[i, k] * state[IRON + k]
            pick[i, 9 + k] = -turned[i, k]
    x, y, z = seen
    pick[0, 1], pick[0, 2], pick[1, 0] = z, -y, -z
    pick[1, 2], pick[2, 0], pick[2, 1] = x, y, -x
    pick[1, 12] = pick[2, 13] = -1.0
    innovation = np.array([-x, state[EARTH] - y, state[EARTH + 1] - z])
    update(state, covariance, pick, innovation, variance, kept)
