"""The loops of frames, compiled: what a channel reached in each, and the quietest before it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled
from .cell_kernels import window_maxima

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: What an open frame holds of each channel: decision, peak, power, highest and lowest sample; how
#: often the signal stood still at the highest and the lowest; the column before, NaN if it moved.
FRAME = 8


@compiled
def open_frame(state: Array) -> None:
    """Begin a frame: shape (rows, FRAME)."""
    for row in range(len(state)):
        state[row, 0] = state[row, 1] = state[row, 3] = -np.inf
        state[row, 2] = state[row, 5] = state[row, 6] = 0.0
        state[row, 4] = np.inf
        state[row, 7] = np.nan


@compiled
def _extended(frame: Any, decision: float, peak: float, power: float, x: Any) -> Any:
    """Return a frame of one channel with a column more; ``x`` is its highest and lowest sample."""
    reached, top, total, highest, lowest, at_highest, at_lowest, before = frame
    high, low = x
    if high > highest:
        highest, at_highest = high, 0.0
    if low < lowest:
        lowest, at_lowest = low, 0.0
    still = high == low
    if still and before == high:  # as in the column before
        at_highest += 1.0 if high == highest else 0.0
        at_lowest += 1.0 if low == lowest else 0.0
    before = high if still else np.nan
    reached = decision if decision > reached else reached
    top = peak if peak > top else top
    return reached, top, total + power, highest, lowest, at_highest, at_lowest, before


@compiled
def _held(s: Array) -> Any:
    return s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]


@compiled
def _keep(frame: Any, state: Array) -> None:
    for k in range(FRAME):
        state[k] = frame[k]


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
        own, columns, index = _held(state[row]), filled, 0
        for i in range(n):
            extremes = (high[row, i], low[row, i])
            own = _extended(own, decision[row, i], peak[row, i], power[row, i], extremes)
            columns += 1
            if columns == length:
                _keep(own, state[row])
                close_frame(state[row], length, found[index, row])
                open_frame(state[row : row + 1])
                own = _held(state[row])
                columns = 0
                index += 1
        _keep(own, state[row])
    return found


@compiled
def frame_values(folded: Array, past: Array, rate_hz: float) -> tuple[NDArray[np.float32], Array]:
    """Return frames with the quietest of the last ones beside each.

    Parameters
    ----------
    folded
        Shape (frames, rows, 5), as :func:`fold_frames` has them.
    past
        Shape (2 * rows, n): effective value and swing of frames before, as negative numbers; a dead
        stretch, which says nothing about the noise, has -inf.
    rate_hz
        Columns per second [Hz].

    Returns
    -------
    The quantities of :func:`~groundtrace.detectors.frames.trace_of`, (frames, rows, 6); next past.
    """
    count, rows, _ = folded.shape
    level = np.full((2 * rows, count), -np.inf)
    for i in range(count):
        for row in range(rows):
            for k in range(2):
                if folded[i, row, 2 + k] > 0.0:
                    level[k * rows + row, i] = -folded[i, row, 2 + k]
    most, past = window_maxima(past, level)
    value = np.empty((count, rows, 6), np.float32)
    for i in range(count):
        for row in range(rows):
            noise, quiet = most[row, i], most[rows + row, i]
            value[i, row, 0], value[i, row, 1] = folded[i, row, 0], folded[i, row, 1]
            value[i, row, 2] = -noise if noise > -np.inf else 0.0
            value[i, row, 3] = folded[i, row, 3]
            value[i, row, 4] = -quiet if quiet > -np.inf else 0.0
            value[i, row, 5] = folded[i, row, 4] / rate_hz
    return value, past
