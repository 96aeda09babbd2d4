"""The loops of :mod:`.rhythm`, compiled: window after window, hop after hop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import LANES
from .band_kernels import between
from .grid_kernels import TOGETHER, sums_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@in_place
def autocorrelation(x: Array, n: int, lags: int, energy: Array, sums: Array) -> None:
    """Put the correlations of a window with itself shifted by 0 to ``lags`` in ``sums``.

    Each is divided by the energies of the two parts that overlap, so that a perfect rhythm gives 1
    at all multiples of its period.

    Parameters
    ----------
    x, n
        The window in its first n places; 0 in as many behind them as there are sums.
    energy
        Shape (n + 1,), written over.
    sums
        Shape (m,), m a multiple of TOGETHER and more than ``lags``.
    """
    rows = sums.reshape(-1, LANES)
    energy[0] = 0.0
    for i in range(n):
        energy[i + 1] = energy[i] + x[i] * x[i]
    for g in range(len(sums) // TOGETHER):
        sums_together(x, g * TOGETHER, x, (0, max(n - g * TOGETHER, 0)), rows, 4 * g)
    for lag in range(lags + 1):
        sums[lag] /= math.sqrt(energy[n - lag] * (energy[n] - energy[lag]) + 1e-9)


@in_place
def median_size(window: Array, x: Array) -> float:
    """Return the median of absolute values, by parting them about one again and again (Hoare).

    They are moved about in ``x``, shape (n,) or more.
    """
    n = len(window)
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


@in_place
def clip_window(window: Array, limit: float, x: Array) -> None:
    """Put a window, shape (n,), with its amplitudes clipped, less its mean, in ``x``."""
    total = 0.0
    for i in range(len(window)):
        x[i] = min(max(window[i], -limit), limit)
        total += x[i]
    for i in range(len(window)):
        x[i] -= total / len(window)


@in_place
def best_period(
    correlation: Array, repeats: int, shortest: int, longest: int, comb: Array
) -> tuple[int, float]:
    """Return the period that stands out, in points, and its strength; 0 and -1 for none.

    ``comb``, shape (longest - shortest + 1,), is written over.
    """
    for i in range(longest - shortest + 1):
        comb[i] = 0.0
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
    out, lags = np.empty((3, count)), repeats * longest
    sums = np.empty(-(-(lags + 1) // TOGETHER) * TOGETHER)
    x, energy = np.zeros(length + len(sums)), np.empty(length + 1)
    comb = np.empty(max(longest - shortest + 1, 1))
    for w in range(count):
        window = signal[w * hop : w * hop + length]
        out[0, w], out[1, w], out[2, w] = -1.0, 0.0, median_size(window, x)
        if longest < shortest + 2:
            continue
        clip_window(window, clip * out[2, w], x)
        autocorrelation(x, length, lags, energy, sums)
        period, strength = best_period(sums, repeats, shortest, longest, comb)
        if not period:
            continue
        steps = 1
        if period >= 3 * fastest and between(sums, period / 3) > part * strength:
            steps = 3
        elif period >= 2 * fastest and between(sums, period / 2) > -part * strength:
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
