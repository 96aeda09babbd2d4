"""Onsets by the Akaike information criterion (AIC) of variances.

Source: Maeda 1985, AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]). Instead of the minimum alone,
the onset is the mean of k under Akaike weights exp(-(AIC - min) / 2), with the sum divided by the
signal's correlation length, since neighbouring samples are not independent. The spread of the
weights is the uncertainty of the onset.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled
from ..lanes import LANES, every, greater, logarithm, put_row, row

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
def criterion_of(window: Array, sums: Array, found: Array) -> None:
    """Write AIC(k) for k = 1 ... n-1 of a window of n samples into ``found``.

    ``found`` and the rows of ``sums``, shape (5, at least n / LANES, LANES), are used as lines.
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
        k = row(sums[4], i)
        before, after = logarithm(row(sums[2], i) + least), logarithm(row(sums[3], i) + least)
        put_row(found, i, k * before + (count - k) * after)


@compiled
def memory_of(n: int) -> Array:
    """Return memory for sums of windows of up to n samples; row 4 holds k = 1, 2, ..."""
    sums = np.ones((5, n // LANES + 1, LANES))
    k = sums[4].reshape(-1)
    for i in range(len(k)):
        k[i] = i + 1.0
    return sums


@compiled
def _weighted(criterion: Array, correlation: float) -> tuple[float, float]:
    """Return mean and standard deviation of k under the weights of AIC(k), k = 1 ... n-1."""
    last = len(criterion) - EDGE
    scale = 1.0 / (2.0 * max(correlation, 1.0))
    least = criterion[EDGE]
    for i in range(EDGE, last):
        least = criterion[i] if criterion[i] < least else least
    mass = place = 0.0
    for i in range(EDGE, last):
        distance = (criterion[i] - least) * scale
        weight = np.exp(-distance) if distance < WEIGHTLESS else 0.0
        criterion[i] = weight
        mass += weight
        place += weight * (i + 1)
    onset, spread = place / mass, 0.0
    for i in range(EDGE, last):
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
    result = np.empty((2, len(start)))
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
        criterion_of(window[:n], sums, criterion)
        result[0, i], result[1, i] = _weighted(criterion.reshape(-1)[: n - 1], correlation)
    return result
