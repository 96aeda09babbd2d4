"""The loops of arrival pickers: variance of a filtered signal, ratios and maxima, onsets by AIC.

Every sum runs in the order of time, whatever the blocks, so that parts give exactly what the whole
gives. What a loop keeps of each channel from one sample to the next stands in a record of
:data:`LANES` channels: its fields cannot overlap, which lets the compiler take several channels at
once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from .compiling import compiled, compiled_for, inlined, record
from .frames import FRAMES, add_column, close_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Indices = NDArray[np.intp]

#: Channels of one record. Chosen by judgement: what is kept of eight stays in registers of eight
#: numbers; more channels take another record.
LANES = 8
#: Samples that are filtered together. Chosen by judgement: the nearest cache holds them.
TILE = 64
#: Types of samples that are filtered as they are stored; others are converted first.
STORED = tuple(map(np.dtype, ("i2", "i4", "f4", "f8")))
#: A second-order section: y = b0 x + b1 x' + b2 x'' - a1 y' - a2 y'', of the samples before.
SECTION = record(*((name, "f8") for name in ("b0", "b1", "b2", "a1", "a2")))
#: The filter has that many sections; one with fewer is filled up by sections of b0 = 1.
#: Source: definition; a band-pass of order 2.
SECTIONS = 2
#: What is kept of each channel: what its samples are multiplied by; both sections' memory; the
#: moving average of the square, and what it was at the end of the last complete cell; of the open
#: cell the largest average, the largest absolute value and the sum of squares filtered, and the
#: extremes as recorded. And the samples that are filtered, which become the filtered ones.
CHANNELS = record(
    *((name, "f8", (LANES,)) for name in ("scale", "p1", "p2", "q1", "q2")),
    *((name, "f8", (LANES,)) for name in ("level", "at_cell", "most", "peak")),
    *((name, "f8", (LANES,)) for name in ("power", "high", "low")),
    ("tile", "f8", (TILE, LANES)),
)
#: A filter's memory below this, at the end of a cell, is nothing: it would go on through numbers
#: that are slow to count. Chosen by judgement: far below any sample.
NOTHING = 1e-140


def _cells(kind: np.dtype[Any]) -> Any:
    samples = numba.types.Array(numba.from_dtype(kind), 2, "A", readonly=True, aligned=False)
    sections, channels = (numba.from_dtype(of)[::1] for of in (SECTION, CHANNELS))
    count, rows = numba.i8, numba.f8[:, ::1]
    state = (sections, numba.f8, channels, count, count, FRAMES, count, count)
    return numba.void(samples, *state, rows, rows, numba.f8[:, :, ::1])


def sections_of(sos: Array) -> NDArray[np.void]:
    """Return second-order sections as scipy has them, shape (n, 6), as an array of SECTION."""
    filter_sections = np.zeros(SECTIONS, SECTION)
    filter_sections["b0"] = 1.0
    for name, column in zip(SECTION.names or (), (0, 1, 2, 4, 5), strict=True):
        filter_sections[name][: len(sos)] = sos[:, column]
    return filter_sections


def channels_of(scales: Array, memory: Array) -> NDArray[np.void]:
    """Return what is kept of channels before their first sample.

    Parameters
    ----------
    scales
        Shape (n_channels,).
    memory
        Shape (2 * SECTIONS, n_channels): of the filter.
    """
    count = len(scales)
    records = np.zeros(-(-count // LANES), CHANNELS)
    padded = np.zeros((1 + len(memory), len(records) * LANES))
    padded[0, :count], padded[1:, :count] = scales, memory
    for name, values in zip(("scale", "p1", "p2", "q1", "q2"), padded, strict=True):
        records[name] = values.reshape(-1, LANES)
    records["most"], records["high"], records["low"] = -np.inf, -np.inf, np.inf
    return records


@inlined
def _filter(c: Any, start: int, stop: int, sections: Any, alpha: float) -> None:
    """Scale and filter samples of a tile where they are, and take what cells are made of.

    Each section in the transposed direct form II, as scipy's ``sosfilt``::

        y = b0 x + p1,   p1 = b1 x - a1 y + p2,   p2 = b2 x - a2 y
    """
    one, two, keep = sections[0], sections[1], 1.0 - alpha
    b0, b1, b2, a1, a2 = one.b0, one.b1, one.b2, one.a1, one.a2
    d0, d1, d2, c1, c2 = two.b0, two.b1, two.b2, two.a1, two.a2
    tile = c.tile[start:stop]
    for i in range(len(tile)):
        for j in range(LANES):
            x, p1, p2, q1, q2 = tile[i, j] * c.scale[j], c.p1[j], c.p2[j], c.q1[j], c.q2[j]
            most, peak, high, low = c.most[j], c.peak[j], c.high[j], c.low[j]
            y = b0 * x + p1
            z = d0 * y + q1
            power, size = z * z, abs(z)
            level = alpha * power + keep * c.level[j]
            total = c.power[j] + power
            tile[i, j] = z
            c.p1[j] = b1 * x - a1 * y + p2
            c.p2[j] = b2 * x - a2 * y
            c.q1[j] = d1 * y - c1 * z + q2
            c.q2[j] = d2 * y - c2 * z
            c.level[j], c.power[j] = level, total
            # what is none of the numbers is neither larger nor smaller
            c.most[j] = level if level > most else most
            c.peak[j] = size if size > peak else peak
            c.high[j] = x if x > high else high
            c.low[j] = x if x < low else low


@inlined
def _without_tail(x: float) -> float:
    return 0.0 if abs(x) < NOTHING else x


@inlined
def _close(
    c: Any, first: int, count: int, length: int, levels: Array, index: int, open_frame: Any
) -> None:
    """Add the open cell of channels to their frames, and begin the next."""
    for j in range(count):
        levels[first + j, index], power = c.most[j], c.power[j] / length
        add_column(open_frame[first + j], c.peak[j], power, c.high[j], c.low[j])
    for j in range(LANES):
        c.most[j] = c.high[j] = -np.inf
        c.peak[j] = c.power[j] = 0.0
        c.low[j] = np.inf
        c.p1[j], c.p2[j] = _without_tail(c.p1[j]), _without_tail(c.p2[j])
        c.q1[j], c.q2[j] = _without_tail(c.q1[j]), _without_tail(c.q2[j])
        c.at_cell[j] = c.level[j] = _without_tail(c.level[j])


@compiled_for(_cells)
def variance_cells(
    samples: NDArray[Any],
    sections: NDArray[np.void],
    alpha: float,
    channels: NDArray[np.void],
    filled: int,
    length: int,
    open_frame: NDArray[np.void],
    columns: int,
    frame_length: int,
    rows: Array,
    levels: Array,
    frames: Array,
) -> None:
    """Scale and filter samples, average their square, reduce them to cells, and those to frames.

    Parameters
    ----------
    samples
        Shape (n, n_channels), one of STORED.
    sections
        The filter, as :func:`sections_of` has it.
    alpha
        Of the moving average m = alpha y^2 + (1 - alpha) m.
    channels
        As :func:`channels_of` has them.
    filled, length
        How many samples the open cell has, and a complete one.
    open_frame, columns, frame_length
        As :func:`.frames.frames` takes them; its columns are cells.
    rows
        Shape (n, n_channels): gets the filtered samples.
    levels
        Shape (n_channels, n_cells): gets the largest average of the cells that are completed.
    frames
        Shape (n_channels, n_frames, VALUES): gets the frames that are completed.
    """
    for group in range(len(channels)):
        c, first, in_cell, index = channels[group], group * LANES, filled, 0
        column, frame = columns, 0
        count = min(LANES, samples.shape[1] - first)
        for begin in range(0, len(samples), TILE):
            given = samples[begin : begin + TILE, first:]
            size, start = len(given), 0
            for i in range(size):
                for j in range(LANES):  # a lane without a channel of its own takes the last one's
                    c.tile[i, j] = given[i, min(j, count - 1)]
            while start < size:
                stop = min(size, start + length - in_cell)
                _filter(c, start, stop, sections, alpha)
                in_cell += stop - start
                start = stop
                if in_cell < length:
                    break
                _close(c, first, count, length, levels, index, open_frame)
                in_cell, index, column = 0, index + 1, column + 1
                if column == frame_length:
                    for j in range(first, first + count):
                        close_frame(open_frame[j], frame_length, frames, j, frame)
                    column, frame = 0, frame + 1
            filtered = rows[begin : begin + size, first : first + count]
            if count == LANES:  # a length that is stated is copied at once
                for i in range(size):
                    for j in range(LANES):
                        filtered[i, j] = c.tile[i, j]
            else:
                for i in range(size):
                    for j in range(count):
                        filtered[i, j] = c.tile[i, j]


@compiled("void(f8[:, ::1], f8, f8[::1], f8[:, ::1])")
def variance_levels(rows: Array, alpha: float, before: Array, levels: Array) -> None:
    """Write the moving average of the square, as :func:`variance_cells` averages.

    Parameters
    ----------
    rows
        Shape (n, n_channels): filtered samples.
    alpha, before
        Coefficient, and the average before them, shape (n_channels,).
    levels
        Shape (n, n_channels): gets the averages.
    """
    keep = 1.0 - alpha
    for j in range(rows.shape[1]):
        level = before[j]
        for i in range(len(rows)):
            level = alpha * (rows[i, j] * rows[i, j]) + keep * level
            levels[i, j] = level


@compiled("void(f8[:, ::1], f8[:, ::1], f8[::1], f8, f8[:, ::1])")
def ratio_to_noise(level: Array, noise: Array, trust: Array, silence: float, ratio: Array) -> None:
    """Write the ratio of levels to noise, times the trust in it; nothing where noise is silent.

    Parameters
    ----------
    level, ratio
        Shape (n_channels, n): ``ratio`` gets the ratios.
    noise
        Shape (n_channels, at least n): column by column what levels are divided by.
    trust
        Shape (n,).
    silence
        Noise up to this is silent.
    """
    for r in range(len(level)):
        for i in range(level.shape[1]):
            value = level[r, i] / noise[r, i]
            ratio[r, i] = value * trust[i] if noise[r, i] > silence else 0.0


@inlined
def _is_maximum(line: Array, index: int, reach: int) -> bool:
    value = line[index]
    for i in range(1, reach + 1):  # noqa: SIM110 - compiled as it stands
        if not (line[index - i] < value and line[index + i] <= value):
            return False
    return True


@compiled("i8[:, :](f8[:, ::1], i8, i8, i8, f8, i8)")
def local_maxima(
    line: Array, start: int, stop: int, reach: int, floor: float, back: int
) -> Indices:
    """Return begin of the rise, place and row of maxima, shape (3, m), by place and row.

    Parameters
    ----------
    line
        Shape (rows, n), with ``reach`` columns around each looked at, and ``back`` before.
    start, stop
        Columns looked at.
    reach, floor, back
        As :class:`~.dsp.noise.LocalMaxima` takes them.
    """
    rows, count = len(line), 0
    maxima = np.empty((3, rows * ((stop - start) // (reach + 1) + 1)), np.int64)
    for i in range(start, stop):
        for r in range(rows):
            if line[r, i] > floor and _is_maximum(line[r], i, reach):
                begin = i
                while begin > i - back and line[r, begin - 1] > floor:
                    begin -= 1
                maxima[0, count], maxima[1, count], maxima[2, count] = begin, i, r
                count += 1
    return maxima[:, :count]


#: Samples at both ends of the window where a variance means nothing. Chosen by judgement: of one or
#: two samples a variance is nothing, of three it is a poor one.
EDGE = 3
#: Least variance, so that there is a logarithm; and as a part of the greatest after a sample.
#: Chosen by judgement: the variance of a dead channel; no signal in SI units comes near it.
LEAST, LEAST_PART = 1e-300, 1e-8
#: A weight below exp(-WEIGHTLESS) changes no sum of weights, of which the largest is 1.
#: Source: definition: exp(-60) is below 2^-53, the last bit of a double near 1.
WEIGHTLESS = 60.0


#: A number, as it is stored, is its exponent with its fraction behind it: taken as a whole, it lies
#: below the logarithm to the base 2 by no more than 0.0861. Of the upper half of the bits, this
#: makes a natural logarithm that is too low by at most ROUGHNESS. Source: IEEE 754.
_LOG_UNIT, _LOG_OFFSET = math.log(2) / (1 << 20), 1023 * math.log(2) + 1e-6
ROUGHNESS = 0.0597


@inlined
def _least(room: Array) -> float:
    """Return the least of some numbers, which are written over: half of them, and half of those."""
    n = len(room)
    while n > 1:
        half = (n + 1) // 2
        low, high = room[: n - half], room[half:n]
        for i in range(len(low)):
            one, other = low[i], high[i]
            low[i] = other if other < one else one
        n = half
    return float(room[0])


@compiled("UniTuple(i8, 2)(f8[::1], f8, f8[:, ::1], f8[::1])")
def criterion_of(window: Array, margin: float, room: Array, aic: Array) -> tuple[int, int]:
    """Write AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]) of a window for k = 1 ... n - 1.

    What is more than ``margin`` above the least may be known roughly only: still above it, but too
    low by up to n * ROUGHNESS. Logarithms take most of the time otherwise.

    Parameters
    ----------
    window
        Shape (n,), more than 2 * EDGE + 1.
    room
        Shape (3, at least n): written over.
    aic
        Shape (at least n,): gets AIC(k) at k - 1.

    Returns
    -------
    start, stop
        Outside of ``aic[start:stop]`` it is more than ``margin`` above the least.
    """
    last, first, total, square = len(window) - 1, window[0], 0.0, 0.0
    before, after, spare, aic = room[0, :last], room[1, :last], room[2, :last], aic[:last]
    for i in range(last):
        x = window[i] - first  # an offset would take the digits of the variance
        total += x
        square += x * x
        before[i], after[i] = total, square
    x = window[last] - first
    total += x
    square += x * x
    for i in range(last):
        share, rest = 1.0 / (i + 1.0), 1.0 / (last - i)
        mean, mean_after = before[i] * share, (total - before[i]) * rest
        variance = after[i] * share - mean * mean
        variance_after = (square - after[i]) * rest - mean_after * mean_after
        before[i], after[i] = max(variance, 0.0), max(variance_after, 0.0)
        spare[i] = -after[i]
    least = max(LEAST_PART * -_least(spare), LEAST)
    bits_before, bits_after = before.view(np.int64), after.view(np.int64)
    for i in range(last):
        before[i] += least
        after[i] += least
        rough = (i + 1.0) * (bits_before[i] >> 32) + (last - i) * (bits_after[i] >> 32)
        aic[i] = spare[i] = rough * _LOG_UNIT - (last + 1) * _LOG_OFFSET
    limit = _least(spare[EDGE : last - EDGE]) + (last + 1) * ROUGHNESS + margin
    start, stop = last, 0
    for i in range(last):
        if aic[i] <= limit:
            start, stop = min(start, i), i + 1
            aic[i] = (i + 1.0) * math.log(before[i]) + (last - i) * math.log(after[i])
    return start, stop


@inlined
def _weighted(criterion: Array, start: int, stop: int, scale: float) -> tuple[float, float]:
    """Return mean and deviation of k under the weights exp(-scale AIC(k)) of ``[start, stop)``."""
    least = criterion[start]
    for i in range(start, stop):
        least = min(criterion[i], least)
    mass = moment = 0.0
    for i in range(start, stop):
        distance = (criterion[i] - least) * scale
        weight = math.exp(-distance) if distance < WEIGHTLESS else 0.0
        criterion[i] = weight
        mass += weight
        moment += weight * (i + 1)
    onset, spread = moment / mass, 0.0
    for i in range(start, stop):
        spread += criterion[i] * (i + 1 - onset) ** 2
    return onset, math.sqrt(spread / mass)


@compiled("f8[:, ::1](f8[:, ::1], i8[::1], i8[::1], i8[::1], f8)")
def onsets(
    rows: Array, start: Indices, length: Indices, channel: Indices, correlation: float
) -> Array:
    """Return onset in each window, from its first sample on, and deviation: shape (2, m), samples.

    Parameters
    ----------
    rows
        Shape (n, n_channels): each window holds noise, then signal.
    start, length, channel
        Shape (m,): of each window. Windows that are too short for a variance on both sides (under
        9 samples) give their middle.
    correlation
        Correlation length of the signal [samples].
    """
    most = 0
    for n in length:
        most = max(most, n)
    result, scale = np.empty((2, len(start))), 1.0 / (2.0 * max(correlation, 1.0))
    window, room, criterion = np.empty(most), np.empty((3, most)), np.empty(most)
    for i in range(len(start)):
        n = length[i]
        if n < 2 * EDGE + 3:
            result[0, i], result[1, i] = n / 2, n / math.sqrt(12.0)
            continue
        for k in range(n):
            window[k] = rows[start[i] + k, channel[i]]
        first, end = criterion_of(window[:n], WEIGHTLESS / scale, room, criterion)
        first, end = max(first, EDGE), min(end, n - 1 - EDGE)
        result[0, i], result[1, i] = _weighted(criterion, first, end, scale)
    return result
