"""The frames of a detector's trace."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from .compiling import compiled, inlined, record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: What is kept of the frame under way: the largest peak, the sum of powers, the extremes; the last
#: column where it stood still, else none; how many columns stood still at the highest and at the
#: lowest.
FRAME = record(
    *((name, "f8") for name in ("peak", "power", "high", "low", "last")),
    *((name, "i8") for name in ("at_high", "at_low")),
)
#: What a frame tells of each channel: peak, level, swing, columns at an extreme. Source:
#: definition.
VALUES = 4

FRAMES = numba.from_dtype(FRAME)[::1]


def open_frames(channels: int) -> NDArray[np.void]:
    """Return what is kept of frames before their first column."""
    frames_under_way = np.zeros(channels, FRAME)
    frames_under_way["peak"] = frames_under_way["high"] = -np.inf
    frames_under_way["low"], frames_under_way["last"] = np.inf, np.nan
    return frames_under_way


@inlined
def add_column(f: Any, peak: float, power: float, high: float, low: float) -> None:
    """Add a column to a frame."""
    f.peak = peak if peak > f.peak else f.peak
    f.power += power
    if high > f.high:
        f.high, f.at_high = high, 0
    if low < f.low:
        f.low, f.at_low = low, 0
    if high == low == f.last:
        f.at_high += high == f.high
        f.at_low += low == f.low
    f.last = high if high == low else math.nan


@inlined
def close_frame(f: Any, length: int, values: Array, channel: int, index: int) -> None:
    """Write a frame of a channel, and begin the next."""
    values[channel, index, 0], values[channel, index, 1] = f.peak, math.sqrt(f.power / length)
    values[channel, index, 2] = (f.high - f.low) / 2.0
    values[channel, index, 3] = f.at_high if f.high == f.low else f.at_high + f.at_low
    f.peak = f.high = -math.inf
    f.low, f.last = math.inf, math.nan
    f.power, f.at_high, f.at_low = 0.0, 0, 0


@compiled(numba.void(*(4 * [numba.f8[:, ::1]]), FRAMES, numba.i8, numba.i8, numba.f8[:, :, ::1]))
def frames(
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
    peak, power, high, low
        Shape (n_channels, n): columns, as :class:`~.dsp.noise.SignalFrames` takes them.
    open_frame
        As :func:`open_frames` has it.
    filled, length
        How many columns the frame under way has, and a complete one.
    values
        Shape (n_channels, n_frames, VALUES): gets the frames that are completed.
    """
    for c in range(len(peak)):
        f, count, index = open_frame[c], filled, 0
        for i in range(peak.shape[1]):
            add_column(f, peak[c, i], power[c, i], high[c, i], low[c, i])
            count += 1
            if count == length:
                close_frame(f, length, values, c, index)
                count, index = 0, index + 1


@compiled(numba.void(FRAMES, numba.i8, numba.f8[:, :, ::1]))
def close_frames(open_frame: NDArray[np.void], filled: int, values: Array) -> None:
    """Write the frames under way, of so many columns, shape (n_channels, 1, VALUES)."""
    for c in range(len(open_frame)):
        close_frame(open_frame[c], filled, values, c, 0)


@inlined
def _least(past: Array, index: int, value: float, least: float) -> float:
    """Put a value in the place of the oldest; return the least of all, which was ``least``."""
    oldest, past[index] = past[index], value
    if value <= least or oldest > least:
        return min(value, least)
    for x in past:
        value = min(x, value)
    return value


@compiled("void(f8[:, :], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], i8, f8, f4[:, :, ::1])")
def trace_values(
    decision: Array,
    signal: Array,
    past: Array,
    least: Array,
    before: int,
    rate_hz: float,
    values: NDArray[np.float32],
) -> None:
    """Write what the trace tells of frames: the signal against the quietest of the last ones.

    Parameters
    ----------
    decision
        Shape (n_channels, n): the largest decision in each.
    signal
        Shape (n_channels, n, VALUES): as :func:`frames` writes them.
    past, least
        Shapes (2, n_channels, as many as are looked back at) and (2, n_channels): levels and swings
        of the last frames, and the least of them; infinite where there are none or it was dead.
    before
        How many frames came before.
    rate_hz
        Columns per second.
    values
        Shape (n, n_channels, 6): decision, peak, noise, swing, quiet and flat.
    """
    for c in range(len(decision)):
        for i in range(decision.shape[1]):
            index = (before + i) % past.shape[2]
            for k in range(2):  # dead stretches say nothing about the noise
                x = signal[c, i, 1 + k]
                level = x if x > 0.0 else math.inf
                least[k, c] = _least(past[k, c], index, level, least[k, c])
            values[i, c, 0], values[i, c, 1] = decision[c, i], signal[c, i, 0]
            values[i, c, 2] = least[0, c] if least[0, c] < math.inf else 0.0
            values[i, c, 3] = signal[c, i, 2]
            values[i, c, 4] = least[1, c] if least[1, c] < math.inf else 0.0
            values[i, c, 5] = signal[c, i, 3] / rate_hz
