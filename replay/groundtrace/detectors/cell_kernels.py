"""The loops of cells, compiled: maxima of noise, ratios to it, local maxima, frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Noise up to this is none: a filter's memory of what was before the silence.
SILENCE = 1e-140
#: What an open frame holds of each channel: decision, peak, power, highest and lowest sample; how
#: often the signal stood still at the highest and the lowest; the column before, NaN if it moved.
FRAME = 8


@compiled
def window_maxima(line: Array, width: int) -> Array:
    """Return the maximum of every ``width`` neighbours of shape (rows, n): (rows, n - width + 1).

    Source: van Herk 1992, Gil and Werman 1993: maxima from the left and from the right over parts
    of ``width``, of which any window meets two.
    """
    rows, n = line.shape
    found = np.empty((rows, n - width + 1))
    right = np.empty(n)
    for row in range(rows):
        x = line[row]
        for i in range(n - 1, -1, -1):
            ends = i == n - 1 or (i + 1) % width == 0
            right[i] = x[i] if ends or x[i] > right[i + 1] else right[i + 1]
        left = x[0]
        for i in range(n):
            left = x[i] if i % width == 0 or x[i] > left else left
            first = i - width + 1
            if first >= 0:
                found[row, first] = left if left > right[first] else right[first]
    return found


@compiled
def ratio_to_noise(level: Array, noise: Array, known: int, warm_up: float) -> Array:
    """Return levels, shape (rows, n), over the noise of the same places, as far as it is trusted.

    ``known`` is for how many cells the noise of the first place was there; 0 or less: not at all.
    """
    rows, n = level.shape
    ratio = np.zeros((rows, n))
    for i in range(n):
        seen = max(known + i, 0.0)
        trust = seen / (seen + warm_up)
        for row in range(rows):
            # over digital silence nothing has a ratio: a sensor coming alive is not an arrival
            if seen > 0.0 and noise[row, i] > SILENCE:
                ratio[row, i] = level[row, i] / noise[row, i] * trust
    return ratio


@compiled
def _is_maximum(x: Array, place: int, reach: int) -> bool:
    value = x[place]
    for i in range(1, reach + 1):  # noqa: SIM110 - compiled as it stands
        if x[place - i] >= value or x[place + i] > value:
            return False
    return True


@compiled
def local_maxima(
    line: Array, start: int, stop: int, reach: int, floor: float, back: int
) -> tuple[NDArray[np.intp], Array]:
    """Find the columns in ``[start, stop)`` that are the largest within reach, first of equals.

    Parameters
    ----------
    line
        Shape (rows, n), with at least ``reach`` columns around each looked at, and ``back`` before.
    start, stop
        Columns looked at.
    reach, floor, back
        As :class:`~groundtrace.detectors.cells.LocalMaxima` takes them.

    Returns
    -------
    Begin of the rise, maximum and row, shape (m, 3), by column and row; values, shape (m,).
    """
    rows = len(line)
    most = rows * ((stop - start) // (reach + 1) + 1)
    place, value = np.empty((most, 3), np.intp), np.empty(most)
    count = 0
    for i in range(start, stop):
        for row in range(rows):
            if line[row, i] > floor and _is_maximum(line[row], i, reach):
                begin = i
                while begin > i - back and line[row, begin - 1] > floor:
                    begin -= 1
                place[count, 0], place[count, 1], place[count, 2] = begin, i, row
                value[count] = line[row, i]
                count += 1
    return place[:count], value[:count]


@compiled
def open_frame(state: Array) -> None:
    """Begin a frame: shape (rows, FRAME)."""
    for row in range(len(state)):
        state[row, 0] = state[row, 1] = state[row, 3] = -np.inf
        state[row, 2] = state[row, 5] = state[row, 6] = 0.0
        state[row, 4] = np.inf
        state[row, 7] = np.nan


@compiled
def _extend_frame(s: Array, decision: float, peak: float, power: float, x: Any) -> None:
    """Take a column into the frame of one channel; ``x`` is the highest and lowest sample."""
    high, low = x
    s[0] = decision if decision > s[0] else s[0]
    s[1] = peak if peak > s[1] else s[1]
    s[2] += power
    if high > s[3]:
        s[3], s[5] = high, 0.0
    if low < s[4]:
        s[4], s[6] = low, 0.0
    still = high == low
    if still and s[7] == high:  # as in the column before
        s[5] += 1.0 if high == s[3] else 0.0
        s[6] += 1.0 if low == s[4] else 0.0
    s[7] = high if still else np.nan


@compiled
def close_frame(s: Array, columns: int, found: Array) -> None:
    """Write decision, peak, effective value, swing and columns stood still of one channel."""
    found[0], found[1] = s[0], s[1]
    found[2] = np.sqrt(s[2] / columns)
    found[3] = (s[3] - s[4]) / 2.0
    found[4] = s[5] if s[3] == s[4] else s[5] + s[6]


@compiled
def fold_frames(
    decision: Array,
    peak: Array,
    power: Array,
    high: Array,
    low: Array,
    state: Array,
    filled: int,
    length: int,
) -> Array:
    """Take columns, each shape (rows, n), into frames of ``length`` columns.

    Returns
    -------
    What :func:`close_frame` writes of the frames that are complete, shape (frames, rows, 5).
    """
    rows, n = decision.shape
    found = np.empty(((filled + n) // length, rows, 5))
    for row in range(rows):
        own, columns, index = state[row], filled, 0
        for i in range(n):
            extremes = (high[row, i], low[row, i])
            _extend_frame(own, decision[row, i], peak[row, i], power[row, i], extremes)
            columns += 1
            if columns == length:
                close_frame(own, length, found[index, row])
                open_frame(state[row : row + 1])
                columns = 0
                index += 1
    return found
