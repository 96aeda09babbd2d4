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
def criterion_of(window: Array, sums: Array, found: Array, margin: float) -> None:
    """Write AIC(k) for k = 1 ... n-1 of a window of n samples into ``found``.

    ``found`` and the rows of ``sums``, shape (5, at least n / LANES, LANES), are used as lines.
    What is more than ``margin`` above the least, and lies before or after all that is not, is known
    roughly only: still above it, but up to n * ROUGHNESS too low.
    """
    n = len(window)
    total, square = sums[0].reshape(-1), sums[1].reshape(-1)
    first = window[0]
    total[0] = square[0] = 0.0
    for i in range(1, n):
        x = window[i] - first  # an offset would take the digits of the variance
        total[i] = total[i - 1] + x
        square[i] = square[i - 1] + x * x
    rows = (n - 2) // LANES + 1
    most, nothing = every(0.0), every(0.0)
    count, all_total, all_square = every(n * 1.0), every(total[n - 1]), every(square[n - 1])
    for i in range(rows):
        k = row(sums[4], i)
        mean = row(sums[0], i) / k
        put_row(sums[2], i, greater(row(sums[1], i) / k - mean * mean, nothing))
        rest = (all_total - row(sums[0], i)) / (count - k)
        spread = (all_square - row(sums[1], i)) / (count - k) - rest * rest
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


@compiled
def memory_of(n: int) -> Array:
    """Return memory for sums of windows of up to n samples; row 4 holds k = 1, 2, ..."""
    sums = np.ones((5, n // LANES + 1, LANES))
    k = sums[4].reshape(-1)
    for i in range(len(k)):
        k[i] = i + 1.0
    return sums


@compiled
def _weighted(criterion: Array, scale: float) -> tuple[float, float]:
    """Return mean and deviation of k under the weights exp(-scale AIC(k)), k = 1 ... n-1."""
    stop = len(criterion) - EDGE
    least = criterion[EDGE]
    for i in range(EDGE, stop):
        least = criterion[i] if criterion[i] < least else least
    mass = place = 0.0
    first, last = stop, EDGE
    for i in range(EDGE, stop):
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
        criterion_of(window[:n], sums, criterion, WEIGHTLESS / scale)
        result[0, i], result[1, i] = _weighted(criterion.reshape(-1)[: n - 1], scale)
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
def timed_onsets(
    found: Array, ratio: Array, rate_hz: float
) -> tuple[Indices, NDArray[np.int64], NDArray[np.float32]]:
    """Return the sample of each onset, the time past it [ns], and ratio and deviation [s], (m, 2).

    ``found`` is as :func:`mean_onsets` has it.
    """
    m = len(ratio)
    whole, past_ns = np.empty(m, np.intp), np.empty(m, np.int64)
    value = np.empty((m, 2), np.float32)
    for i in range(m):
        whole[i] = np.intp(np.floor(found[0, i]))
        past_ns[i] = np.int64(np.rint((found[0, i] - whole[i]) * NS_PER_S / rate_hz))
        value[i, 0], value[i, 1] = ratio[i], found[1, i] / rate_hz
    return whole, past_ns, value
