"""The loops over the samples of a frame, compiled: those of :mod:`.inertial_frames`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from .rotation_kernels import add_matrix, crossed, held, of_angles, put, rotated, times

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rotation_kernels import Quaternion

    Array = NDArray[np.float64]


#: Places in what is told of a frame: the matrix of its mean turn, mean force and field in the axes
#: of its start, mean rate in moving ones; root mean square rate, and how far rate and force are off
#: their means; the sums that tell the field's delay.
MEAN_TURN, FORCE, FIELD, RATE, SPEED, RATE_SPREAD, FORCE_SPREAD, ACROSS, ALONG, FRAME = (
    0, 9, 12, 15, 18, 19, 20, 21, 22, 23,
)  # fmt: skip


@in_place
def spread(x: Array) -> float:
    """Return the root mean square deviation of vectors, shape (n, 3), from their mean."""
    apart = 0.0
    for k in range(3):
        mean = 0.0
        for i in range(len(x)):
            mean += x[i, k]
        mean /= len(x)
        for i in range(len(x)):
            apart += (x[i, k] - mean) * (x[i, k] - mean)
    return math.sqrt(apart / len(x))


@in_place
def turn_through(
    rate: Array, force: Array, bias: Array, step_s: float, turns: Array, out: Array
) -> None:
    """Follow the turn of a frame; put means over it in ``out``. As :func:`sum_up` has it."""
    count, square, end = len(rate), 0.0, (1.0, 0.0, 0.0, 0.0)
    out[:FRAME] = 0.0
    mean = out[MEAN_TURN:FORCE].reshape(3, 3)
    for i in range(count):
        x, y, z = rate[i, 0] - bias[0], rate[i, 1] - bias[1], rate[i, 2] - bias[2]
        square += x * x + y * y + z * z
        half = of_angles(0.5 * step_s * x, 0.5 * step_s * y, 0.5 * step_s * z)
        middle = times(end, half)
        end = times(middle, half)
        put(end, turns[i, 0])
        put(middle, turns[i, 1])
        add_matrix(middle, 1.0 / count, mean)
        pushed = rotated(middle, (force[i, 0], force[i, 1], force[i, 2]))
        for k in range(3):
            out[FORCE + k] += pushed[k] / count
            out[RATE + k] += rate[i, k] / count
    out[SPEED] = math.sqrt(square / count)


@in_place
def field_of(
    field: Array, rate: Array, bias: Array, turns: Array, delay_s: float, room: Array, out: Array
) -> None:
    """Put the mean field in the axes of the frame's start, and sums that tell its delay, in one.

    ``room``, shape (n + 1, 6), is written over.
    """
    count = len(field)
    mean = room[count]
    mean[:] = 0.0
    for i in range(count):
        w = (rate[i, 0] - bias[0], rate[i, 1] - bias[1], rate[i, 2] - bias[2])
        ahead = of_angles(-delay_s * w[0], -delay_s * w[1], -delay_s * w[2])
        still = rotated(ahead, (field[i, 0], field[i, 1], field[i, 2]))
        middle = held(turns[i, 1])
        room[i, 0], room[i, 1], room[i, 2] = rotated(middle, still)
        room[i, 3], room[i, 4], room[i, 5] = rotated(middle, crossed(w, still))
        for k in range(6):
            mean[k] += room[i, k]
    across, along = 0.0, 0.0
    for i in range(count):
        for k in range(3):
            off = room[i, 3 + k] - mean[3 + k] / count
            across += off * (room[i, k] - mean[k] / count)
            along += off * off
    for k in range(3):
        out[FIELD + k] = mean[k] / count
    out[ACROSS], out[ALONG] = across, along


@in_place
def sum_up(
    rate: Array,
    force: Array,
    field: Array,
    bias: Array,
    delay_s: float,
    step_s: float,
    turns: Array,
    room: Array,
    out: Array,
) -> None:
    """Put what a frame says in ``out``, shape (FRAME,), in the places above.

    Parameters
    ----------
    rate, force, field
        Of its samples, shape (n, 3) each.
    bias, delay_s
        Of the gyroscope [rad/s]; how much later than it the magnetometer answers [s].
    step_s
        Time between samples [s].
    turns
        Takes the rotations from the end and from the middle of each sample's interval to the
        frame's start, shape (n, 2, 4).
    room
        Shape (n + 1, 6), written over.
    """
    turn_through(rate, force, bias, step_s, turns, out)
    out[RATE_SPREAD], out[FORCE_SPREAD] = spread(rate), spread(force)
    field_of(field, rate, bias, turns, delay_s, room, out)


@in_place
def headings_into(
    start: Quaternion, turns: Array, axis: Array, orientation: Array, heading: Array
) -> None:
    """Put the orientation after each sample, and the direction of a body axis, in the last two.

    ``turns`` are as those of :func:`sum_up`.
    """
    ahead = (axis[0], axis[1], axis[2])
    for i in range(len(turns)):
        now = times(start, held(turns[i, 0]))
        put(now, orientation[i])
        x, y, _ = rotated(now, ahead)
        heading[i] = math.atan2(y, x)


@compiled
def headings(start: Array, turns: Array, axis: Array) -> tuple[Array, Array]:
    """Return the orientation after each turn, (n, 4), and the direction of a body axis, (n,)."""
    orientation, heading = np.empty((len(turns), 4)), np.empty(len(turns))
    headings_into(held(start), turns.reshape(-1, 1, 4), axis, orientation, heading)
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
