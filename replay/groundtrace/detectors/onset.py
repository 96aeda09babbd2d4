"""Onsets by the Akaike information criterion (AIC) of variances.

Source: Maeda 1985, AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]). Instead of the minimum alone,
the onset is the mean of k under Akaike weights exp(-(AIC - min) / 2), with the sum divided by the
signal's correlation length, since neighbouring samples are not independent. The spread of the
weights is the uncertainty of the onset.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..compiled import compiled
from ..lanes import LANES, every, greater, put_row, row
from ..logarithms import ROUGHNESS, logarithm, rough_logarithm
from .cell_kernels import times_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Indices = NDArray[np.intp]

#: Samples at both ends of the window where a variance means nothing.
EDGE = 3
#: Least variance, so that there is a logarithm.
LEAST = 1e-300
#: A weight below exp(-WEIGHTLESS) changes no sum of weights, of which the largest is 1.
WEIGHTLESS = 60.0


@compiled
def _cut(line: Array, index: int, value: Any, end: int) -> Any:
    """Return a row of no less than zero, zero from element ``end`` of the line on."""
    put_row(line, index, greater(value, every(0.0)))
    for lane in range(LANES):
        if index * LANES + lane >= end:
            line[index, lane] = 0.0
    return row(line, index)


@compiled
def _rows_near_the_least(line: Array, n: int, margin: float) -> tuple[int, int]:
    """Return which rows, first and after the last, may have an AIC within a margin of the least.

    ``line`` are rough ones of a window of n samples, none of them above the true one.
    """
    first, last = EDGE, n - 2 - EDGE
    least = line[first]
    for i in range(first, last + 1):
        least = line[i] if line[i] < least else least
    limit = least + n * ROUGHNESS + margin
    while line[first] > limit:
        first += 1
    while line[last] > limit:
        last -= 1
    return first // LANES, last // LANES + 1


@compiled
def memory_of(n: int) -> Array:
    """Return memory for sums of windows of up to n samples, shape (7, at least n / LANES, LANES).

    Row 4 holds k = 1, 2, ..., row 5 their inverse, row 6 those of n - k as long as n is the same.
    """
    sums = np.ones((7, n // LANES + 1, LANES))
    k, inverse = sums[4].reshape(-1), sums[5].reshape(-1)
    for i in range(len(k)):
        k[i], inverse[i] = i + 1.0, 1.0 / (i + 1.0)
    return sums


@compiled
def _count_down(sums: Array, n: int) -> None:
    inverse, down = sums[5].reshape(-1), sums[6].reshape(-1)
    if down[0] == inverse[n - 2] and down[n - 2] == 1.0:
        return
    for i in range(len(down)):
        down[i] = inverse[n - 2 - i] if i < n - 1 else 0.0


@compiled
def criterion_of(window: Array, sums: Array, found: Array, margin: float) -> tuple[int, int]:
    """Write AIC(k) for k = 1 ... n-1 of a window of n samples into ``found``.

    ``found`` and the rows of ``sums``, as :func:`memory_of` has them, are used as lines.
    What is more than ``margin`` above the least, and lies before or after all that is not, is known
    roughly only: still above it, but up to n * ROUGHNESS too low.

    Returns
    -------
    Where, on that line, lies what is known, away from the ends of the window: first, after last.
    """
    n = len(window)
    _count_down(sums, n)
    total, square = sums[0].reshape(-1), sums[1].reshape(-1)
    first, all_of_x, all_of_squares = window[0], 0.0, 0.0
    for i in range(n):
        x = window[i] - first  # an offset would take the digits of the variance
        all_of_x += x
        all_of_squares += x * x
        total[i], square[i] = all_of_x, all_of_squares
    rows = (n - 2) // LANES + 1
    most, nothing = every(0.0), every(0.0)
    count, all_total, all_square = every(n * 1.0), every(all_of_x), every(all_of_squares)
    for i in range(rows):
        share, mean = row(sums[5], i), row(sums[0], i) * row(sums[5], i)
        put_row(sums[2], i, greater(row(sums[1], i) * share - mean * mean, nothing))
        share = row(sums[6], i)
        rest = (all_total - row(sums[0], i)) * share
        spread = (all_square - row(sums[1], i)) * share - rest * rest
        spread = greater(spread, nothing) if i + 1 < rows else _cut(sums[3], i, spread, n - 1)
        put_row(sums[3], i, spread)
        most = greater(spread, most)
    put_row(found, 0, most)
    least = every(max(1e-8 * found[0].max(), LEAST))
    for i in range(rows):
        k, before, after = row(sums[4], i), row(sums[2], i) + least, row(sums[3], i) + least
        put_row(sums[2], i, before)
        put_row(sums[3], i, after)
        put_row(found, i, k * rough_logarithm(before) + (count - k) * rough_logarithm(after))
    first_row, end = _rows_near_the_least(found.reshape(-1), n, margin)
    for i in range(first_row, end):
        k, before, after = row(sums[4], i), row(sums[2], i), row(sums[3], i)
        put_row(found, i, k * logarithm(before) + (count - k) * logarithm(after))
    return max(first_row * LANES, EDGE), min(end * LANES, n - 1 - EDGE)


@compiled
def _weighted(criterion: Array, start: int, stop: int, scale: float) -> tuple[float, float]:
    """Return mean and deviation of k under the weights exp(-scale AIC(k)) of some of the line."""
    least = criterion[start]
    for i in range(start, stop):
        least = criterion[i] if criterion[i] < least else least
    mass = place = 0.0
    first, last = stop, start
    for i in range(start, stop):
        distance = (criterion[i] - least) * scale
        criterion[i] = 0.0
        if distance < WEIGHTLESS:
            first, last = min(i, first), i
            criterion[i] = weight = np.exp(-distance)
            mass += weight
            place += weight * (i + 1)
    onset, spread = place / mass, 0.0
    for i in range(first, last + 1):
        spread += criterion[i] * (i + 1 - onset) ** 2
    return onset, np.sqrt(spread / mass)


@compiled
def lane_onsets(
    rows: Array, start: Indices, length: Indices, channel: Indices, correlation: float
) -> Array:
    """Return onset in each window, from its first sample on, and deviation: shape (2, m), samples.

    Parameters
    ----------
    rows
        Shape (n_groups, n, LANES): each window holds noise, then signal.
    start, length, channel
        Shape (m,): of each window. Windows that are too short for a variance on both sides (under
        9 samples) give their middle.
    correlation
        Correlation length of the signal [samples].
    """
    result, scale = np.empty((2, len(start))), 1.0 / (2.0 * max(correlation, 1.0))
    most = 0
    for i in range(len(length)):
        most = max(most, length[i])
    window, sums = np.empty(most), memory_of(most)
    criterion = np.empty(sums[0].shape)
    for i in range(len(start)):
        n, group, lane = length[i], channel[i] // LANES, channel[i] % LANES
        if n < 2 * EDGE + 3:
            result[0, i], result[1, i] = n / 2, n / np.sqrt(12.0)
            continue
        for k in range(n):
            window[k] = rows[group, start[i] + k, lane]
        known, end = criterion_of(window[:n], sums, criterion, WEIGHTLESS / scale)
        result[0, i], result[1, i] = _weighted(criterion.reshape(-1), known, end, scale)
    return result


@compiled
def mean_onsets(
    rows: Array,
    span: tuple[int, int],
    anchor: Indices,
    channel: Indices,
    windows: Indices,
    correlation: float,
) -> Array:
    """Return onset and deviation, the mean over windows around each anchor: shape (2, m), samples.

    Parameters
    ----------
    rows, span
        Shape (n_groups, n, LANES), and which samples of the run they are: first, and after the
        last. A window that reaches over them is shorter, not padded.
    anchor, channel
        Shape (m,): a sample of the run, and its channel.
    windows
        Shape (k, 2): how many samples before and after the anchor.
    correlation
        Correlation length of the signal [samples].
    """
    begin, end = span
    found = np.zeros((2, len(anchor)))
    for before, after in windows:
        start = np.maximum(anchor - before, begin)
        length = np.minimum(anchor + 1 + after, end) - start
        onset, deviation = lane_onsets(rows, start - begin, length, channel, correlation)
        found[0] += start + onset
        found[1] += deviation**2
    found[0] /= len(windows)
    found[1] = np.sqrt(found[1] / len(windows))
    return found


@compiled
def with_onsets(
    held: Any, signal: Any, rises: Any, windows: Indices, correlation: float, clock: Any
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Return candidates and new ones at refined onsets, in the order of (time, channel).

    Parameters
    ----------
    held
        Times, channels and values of candidates in that order, as of
        :class:`~groundtrace.gates.Candidates`: ratio, and deviation of the onset [s].
    signal, windows, correlation
        Rows and span, windows and correlation, as :func:`mean_onsets` takes them.
    rises
        Of the new ones: anchor and channel, as :func:`mean_onsets` takes them, and ratio, (m,).
    clock
        Anchors as :func:`~groundtrace.detectors.cell_kernels.times_of` takes them, and rate [Hz].
    """
    (known_ns, known_channel, known_value), (anchors, rate_hz) = held, clock
    anchor, channel, ratio = rises
    onset, deviation = mean_onsets(signal[0], signal[1], anchor, channel, windows, correlation)
    whole = np.floor(onset).astype(np.intp)
    at_ns = times_of(whole, anchors, NS_PER_S / rate_hz)
    known, count = len(known_ns), len(known_ns) + len(ratio)
    time_ns, own = np.empty(count, np.int64), np.empty(count, np.int32)
    value = np.empty((count, 2), np.float32)
    time_ns[:known], own[:known], value[:known] = known_ns, known_channel, known_value
    for i in range(len(ratio)):
        at_ns[i] += np.int64(np.rint((onset[i] - whole[i]) * NS_PER_S / rate_hz))
        place = known + i
        while place and (time_ns[place - 1], own[place - 1]) > (at_ns[i], channel[i]):
            time_ns[place], own[place] = time_ns[place - 1], own[place - 1]
            value[place] = value[place - 1]
            place -= 1
        time_ns[place], own[place] = at_ns[i], channel[i]
        value[place, 0], value[place, 1] = ratio[i], deviation[i] / rate_hz
    return time_ns, own, value
