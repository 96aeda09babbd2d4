"""The tests of a frame's field, and the correction by it, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import in_place
from .attitude_kernels import ACROSS, EARTH, IRON, SEES, SIZE, update

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rotation_kernels import Quaternion, Vector

    Array = NDArray[np.float64]

TESLA = 1e-6
#: A field must not change the tilt; and the earth's field only where it is surely that.
TILT = np.isin(np.arange(SIZE), [0, 1, 3, 4, 5])
TILT_AND_EARTH = np.isin(np.arange(SIZE), [0, 1, 3, 4, 5, 12, 13])
_TWO_PI = 2.0 * math.pi


@in_place
def wrapped(angle: float) -> float:
    """Return an angle within [-pi, pi)."""
    return (angle + math.pi) % _TWO_PI - math.pi


@in_place
def turn_about_vertical(before: Quaternion, after: Quaternion) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    w = after[0] * before[0] + after[1] * before[1] + after[2] * before[2] + after[3] * before[3]
    z = -after[0] * before[3] - after[1] * before[2] + after[2] * before[1] + after[3] * before[0]
    return wrapped(2.0 * math.atan2(z, w))


@in_place
def keep(values: Array, counts: NDArray[np.int64], row: int, value: float) -> None:
    """Add a value to those of a row, and drop the oldest where there are too many."""
    count, most = counts[row, 0], counts[row, 1]
    if count == most:
        for k in range(1, most):
            values[row, k - 1] = values[row, k]
        count -= 1
    values[row, count] = value
    counts[row, 0] = count + 1


@in_place
def total(values: Array, count: int, column: int) -> float:
    """Return the sum of the first few values of a column."""
    summed = 0.0
    for i in range(count):
        summed += values[i, column]
    return summed


@in_place
def deviation(values: Array, count: int, column: int) -> float:
    """Return the standard deviation of the first few values of a column."""
    mean, square = total(values, count, column) / count, 0.0
    for i in range(count):
        square += (values[i, column] - mean) * (values[i, column] - mean)
    return math.sqrt(square / count)


@in_place
def tests(
    earth: Array,
    seen: Vector,
    sigma: float,
    recent: Array,
    counts: NDArray[np.int64],
    length_s: float,
    out: Array,
) -> None:
    """Put what the tests but the last look at in ``out``; ``seen`` is the field, earth frame.

    ``earth`` is the earth's field, north and up, ``sigma`` how far the azimuth may be off.
    Norms and azimuths of the last frames are ``recent``, shape (2, m), and how many there are and
    may be ``counts``, shape (2, 2).
    """
    flat = math.hypot(seen[0], seen[1])
    norm = math.sqrt(seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2])
    north, up = earth[0], earth[1]
    turned = math.atan2(seen[0], seen[1])
    left = math.copysign(max(abs(turned) - sigma, 0.0), turned)
    x, y, z = flat * math.sin(left), flat * math.cos(left) - north, seen[2] - up
    keep(recent, counts, 0, norm)
    keep(recent, counts, 1, turned)
    count = counts[1, 0]
    changed = math.degrees(wrapped(recent[1, count - 1] - recent[1, 0]))
    out[0] = math.sqrt(x * x + y * y + z * z) / TESLA
    out[1] = abs(norm - math.hypot(north, up)) / TESLA
    out[2] = deviation(recent.T, counts[0, 0], 0) / TESLA
    out[3] = abs(flat - north) / TESLA
    out[4] = abs(math.degrees(left))
    out[5] = abs(changed) / (count * length_s)
    out[6] = abs(math.degrees(math.atan2(-seen[2], flat) - math.atan2(-up, north)))


@in_place
def passes(values: Array, limits: Array) -> bool:
    """Return whether all tests pass, their values as they are stored."""
    passed = 0
    for k in range(len(limits)):
        if limits[k] - np.float64(np.float32(values[k])) >= 0.0:
            passed += 1
    return passed == len(limits)


@in_place
def without(iron: Vector, turned: Array, field: Vector) -> Vector:
    """Return a field in the earth frame without that of iron on the sensor, shape (3,).

    ``turned``, shape (3, 3), is what the frame's mean turn makes of it there.
    """
    x, y, z = iron
    return (
        field[0] - (turned[0, 0] * x + turned[0, 1] * y + turned[0, 2] * z),
        field[1] - (turned[1, 0] * x + turned[1, 1] * y + turned[1, 2] * z),
        field[2] - (turned[2, 0] * x + turned[2, 1] * y + turned[2, 2] * z),
    )


@in_place
def seen_by_field(turned: Array, seen: Vector, pick: Array) -> None:
    """Put what a field in the earth frame, the sensor's iron taken out, sees of the errors in one.

    That is ``pick``, shape (3, SIZE); ``turned`` is as that of :func:`without`.
    """
    pick[:] = 0.0
    for i in range(3):
        for k in range(3):
            pick[i, 9 + k] = -turned[i, k]
    x, y, z = seen
    pick[0, 1], pick[0, 2], pick[1, 0] = z, -y, -z
    pick[1, 2], pick[2, 0], pick[2, 1] = x, y, -x
    pick[1, 12] = pick[2, 13] = -1.0


@in_place
def correct_field(
    state: Array,
    covariance: Array,
    turned: Array,
    field: Vector,
    variance: float,
    earth: bool,
    room: Array,
) -> None:
    """Turn towards north by a field, earth frame; ``earth``: it may correct the earth's as well.

    ``turned`` is as that of :func:`without`.
    """
    x, y, z = without((state[IRON], state[IRON + 1], state[IRON + 2]), turned, field)
    innovation = (-x, state[EARTH] - y, state[EARTH + 1] - z)
    pick = room[SEES:ACROSS]
    seen_by_field(turned, (x, y, z), pick)
    update(state, covariance, pick, innovation, variance, TILT if earth else TILT_AND_EARTH, room)
