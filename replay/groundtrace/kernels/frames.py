"""The frames of a detector's trace, and running maxima."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from .compiling import compiled, inlined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: What is kept of the frame under way: the largest decision and peak, the sum of powers, the
#: extremes; the last column where it stood still, else none; how many columns stood still at the
#: highest and at the lowest.
FRAME = np.dtype(
    [
        *((name, "f8") for name in ("decision", "peak", "power", "high", "low", "last")),
        *((name, "i8") for name in ("at_high", "at_low")),
    ]
)
#: What a frame tells of each channel: decision, peak, level, swing, columns at an extreme. Source:
#: definition.
VALUES = 5

_FRAMES = numba.void(
    *(5 * [numba.f8[:, ::1]]), numba.from_dtype(FRAME)[::1], numba.i8, numba.i8, numba.f8[:, :, ::1]
)


def open_frames(channels: int) -> NDArray[np.void]:
    """Return what is kept of frames before their first column."""
    found = np.zeros(channels, FRAME)
    found["decision"] = found["peak"] = found["high"] = -np.inf
    found["low"], found["last"] = np.inf, np.nan
    return found


@inlined
def _extend(
    f: Any,
    decision: Array,
    peak: Array,
    power: Array,
    high: Array,
    low: Array,
    row: int,
    start: int,
    stop: int,
) -> None:
    """Add the columns ``[start, stop)`` of a channel to its frame."""
    most, largest, total, last = f.decision, f.peak, f.power, f.last
    highest, lowest = f.high, f.low
    for i in range(start, stop):
        most = decision[row, i] if decision[row, i] > most else most
        largest = peak[row, i] if peak[row, i] > largest else largest
        total += power[row, i]
        above, below = high[row, i], low[row, i]
        if above > highest:
            highest, f.at_high = above, 0
        if below < lowest:
            lowest, f.at_low = below, 0
        if above == below == last:
            f.at_high += above == highest
            f.at_low += below == lowest
        last = above if above == below else math.nan
    f.decision, f.peak, f.power, f.last = most, largest, total, last
    f.high, f.low = highest, lowest


@inlined
def _close(f: Any, length: int, values: Array) -> None:
    """Write a frame, and begin the next."""
    values[0], values[1], values[2] = f.decision, f.peak, math.sqrt(f.power / length)
    values[3] = (f.high - f.low) / 2.0
    values[4] = f.at_high if f.high == f.low else f.at_high + f.at_low
    f.decision = f.peak = f.high = -math.inf
    f.low, f.last = math.inf, math.nan
    f.power, f.at_high, f.at_low = 0.0, 0, 0


@compiled(_FRAMES)
def frames(
    decision: Array,
    peak: Array,
    power: Array,
    high: Array,
    low: Array,
    open_frame: NDArray[np.void],
    filled: int,
    length: int,
    values: Array,
) -> None:
    """Reduce columns to frames.

    Parameters
    ----------
    decision, peak, power, high, low
        Shape (n_channels, n): columns, as :class:`~.detectors.trace.FrameTrace` takes them.
    open_frame
        As :func:`open_frames` has it.
    filled, length
        How many columns the frame under way has, and a complete one.
    values
        Shape (n_channels, n_frames, VALUES): gets the frames that are completed.
    """
    for row in range(len(decision)):
        f, own, start, index = open_frame[row], filled, 0, 0
        while True:
            stop = min(decision.shape[1], start + length - own)
            _extend(f, decision, peak, power, high, low, row, start, stop)
            own += stop - start
            start = stop
            if own < length:
                break
            _close(f, length, values[row, index])
            own, index = 0, index + 1


@inlined
def _larger(one: Array, other: Array, found: Array) -> None:
    for i in range(len(found)):
        first, second = one[i], other[i]
        found[i] = first if first >= second or first != first else second


@compiled("f8[:, ::1](f8[:, ::1], i8)")
def window_maxima(line: Array, width: int) -> Array:
    """Return the maximum of every window of a line, shape (rows, n) to (rows, n - width + 1).

    The maximum of twice as many neighbours is that of two maxima, again and again; what overlaps
    counts twice without harm. A window with a number that is none has none.
    """
    rows, n = line.shape
    found = np.empty((rows, n - width + 1))
    room, more = np.empty(n), np.empty(n)
    for r in range(rows):
        some, reach = line[r], 1
        while 2 * reach < width:
            _larger(some, some[reach:], more[: n - 2 * reach + 1])
            some, room, more = more, more, room
            reach *= 2
        _larger(some, some[width - reach :], found[r])
    return found
