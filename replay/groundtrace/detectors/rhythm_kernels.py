"""The loops of :mod:`.rhythm`, compiled: window after window, hop after hop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from ..lanes import LANES
from .grid_kernels import TOGETHER, sums_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled
def autocorrelation(x: Array, lags: int) -> Array:
    """Return the correlations of a window, shape (n,), with itself shifted by 0 to ``lags``.

    Each is divided by the energies of the two parts that overlap, so that a perfect rhythm gives 1
    at all multiples of its period. Shape (lags + 1,).
    """
    n, groups = len(x), -(-(lags + 1) // TOGETHER)
    line, energy = np.zeros(n + groups * TOGETHER), np.zeros(n + 1)
    line[:n] = x
    sums = np.empty(groups * TOGETHER)
    rows = sums.reshape(-1, LANES)
    for i in range(n):
        energy[i + 1] = energy[i] + x[i] * x[i]
    for g in range(groups):
        sums_together(line, g * TOGETHER, x, (0, max(n - g * TOGETHER, 0)), rows, 4 * g)
    out = sums[: lags + 1]
    for lag in range(lags + 1):
        out[lag] /= math.sqrt(energy[n - lag] * (energy[n] - energy[lag]) + 1e-9)
    return out


@compiled
def median_size(window: Array) -> float:
    """Return the median of absolute values, by parting them about one again and again (Hoare)."""
    n = len(window)
    x = np.empty(n)
    for i in range(n):
        x[i] = abs(window[i])
    low, high, middle = 0, n - 1, n // 2
    while low < high:
        pivot, i, j = x[(low + high) // 2], low, high
        while i <= j:
            while x[i] < pivot:
                i += 1
            while x[j] > pivot:
                j -= 1
            if i <= j:
                x[i], x[j] = x[j], x[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if n % 2:
        return float(x[middle])
    below = x[0]
    for k in range(1, middle):
        below = max(below, x[k])
    return float(0.5 * (below + x[middle]))


@compiled
def clipped(window: Array, limit: float) -> Array:
    """Return a window, shape (n,), with its amplitudes clipped, less its mean."""
    x, total = np.empty(len(window)), 0.0
    for i in range(len(window)):
        x[i] = min(max(window[i], -limit), limit)
        total += x[i]
    for i in range(len(window)):
        x[i] -= total / len(window)
    return x


@compiled
def between(values: Array, place: float) -> float:
    """Return the value at a place, on the straight line between its neighbours."""
    low, high = values[int(place)], values[int(place) + 1]
    return float((high - low) * (place - int(place)) + low)


@compiled
def best_period(correlation: Array, repeats: int, shortest: int, longest: int) -> tuple[int, float]:
    """Return the period that stands out, in points, and its strength; 0 and -1 for none."""
    comb = np.zeros(longest - shortest + 1)
    for i in range(len(comb)):
        for k in range(1, repeats + 1):
            comb[i] += correlation[k * (shortest + i)]
        comb[i] /= repeats
    best, strength = 0, -np.inf
    for i in range(1, len(comb) - 1):
        if comb[i] > comb[i - 1] and comb[i] >= comb[i + 1] and comb[i] > strength:
            best, strength = shortest + i, comb[i]
    return best, strength if best else -1.0


@compiled
def rhythms(
    signal: Array,
    hop: int,
    length: int,
    repeats: int,
    periods: tuple[int, int],
    fastest: float,
    clip: float,
    part: float,
) -> Array:
    """Return strength, step time in points and median amplitude of windows, shape (3, n).

    Parameters
    ----------
    signal
        Shape (m,): windows of ``length`` points begin at every ``hop``-th.
    repeats
        How many periods on the signal must repeat itself.
    periods
        Shortest and longest that are tried [points].
    fastest
        Shortest step time [points].
    clip
        Amplitudes are clipped at this multiple of their median.
    part
        What parts of a period must correlate by, as a part of what it does itself.
    """
    count = (len(signal) - length) // hop + 1
    shortest, longest = periods
    out = np.empty((3, count))
    for w in range(count):
        window = signal[w * hop : w * hop + length]
        out[0, w], out[1, w], out[2, w] = -1.0, 0.0, median_size(window)
        if longest < shortest + 2:
            continue
        x = clipped(window, clip * out[2, w])
        correlation = autocorrelation(x, repeats * longest)
        period, strength = best_period(correlation, repeats, shortest, longest)
        if not period:
            continue
        steps = 1
        if period >= 3 * fastest and between(correlation, period / 3) > part * strength:
            steps = 3
        elif period >= 2 * fastest and between(correlation, period / 2) > -part * strength:
            steps = 2
        out[0, w], out[1, w] = strength, period / steps
    return out


@compiled
def strongest(found: Array, first: int, hops: tuple[int, int], ahead: int, width: int) -> Array:
    """Return the best window of each hop ``[start, end)``, shape (3, n); -inf where there is none.

    Parameters
    ----------
    found
        Of the windows from ``first`` on, the strength first, shape (3, m).
    ahead, width
        How far ahead of a hop a window may reach, and how long it is [hops].
    """
    start, end = hops
    out = np.full((3, end - start), -np.inf)
    for hop in range(start, end):
        last = min(hop, max(0, hop + ahead - width), first + found.shape[1] - 1)
        for w in range(max(min(hop - 1 - width, last) - first, 0), last - first + 1):
            if found[0, w] > out[0, hop - start]:
                out[:, hop - start] = found[:, w]
    return out
