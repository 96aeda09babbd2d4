"""The loops of the even grid, compiled: its low-pass, centred filters, rhythms and peaks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]

#: Phases of the grid against the samples whose weights are kept.
_PHASES = 8
#: Samples that are filtered together, which stay in the fastest memory.
_TOGETHER = 512


@compiled
def weights_at(past: float, reach: int, rate_hz: float, at_s: Array, table: Array) -> Array:
    """Return the low-pass's weights of the samples about a point ``past`` one of them, in samples.

    Parameters
    ----------
    past, reach
        How far the point lies after the middle sample, and how many samples count before and after
        that.
    rate_hz
        Sampling rate [Hz].
    at_s, table
        Times and weights between which straight lines are drawn, shape (m,).
    """
    out = np.empty(2 * reach + 1)
    last = len(at_s) - 1
    for k in range(2 * reach + 1):
        away_s = abs((k - reach) - past) / rate_hz
        j = int(away_s / at_s[last] * last)
        while j > 0 and at_s[j] > away_s:
            j -= 1
        while j < last and at_s[j + 1] <= away_s:
            j += 1
        if j >= last:
            out[k] = table[last]
        else:
            slope = (table[j + 1] - table[j]) / (at_s[j + 1] - at_s[j])
            out[k] = slope * (away_s - at_s[j]) + table[j]
    return out


@compiled
def grid_points(
    values: Array,
    first: int,
    start: int,
    end: int,
    step: float,
    rate_hz: float,
    reach: int,
    at_s: Array,
    table: Array,
) -> tuple[Array, Array, Places, Array]:
    """Evaluate a low-passed signal at points ``[start, end)`` of the grid.

    Parameters
    ----------
    values
        Shape (n_channels, n), of the samples from ``first`` on.
    step
        Samples from point to point.
    rate_hz, reach, at_s, table
        As those of :func:`weights_at`.

    Returns
    -------
    Low-passed and straight between samples, shape (n_channels, m) each; the sample before each
    point, counted from ``first``, and how far after it the point lies [samples], shape (m,).
    """
    channels, n = values.shape
    low, recorded = np.empty((channels, end - start)), np.empty((channels, end - start))
    own, past = np.empty(end - start, np.int64), np.empty(end - start)
    known, kept = np.full(_PHASES, -1.0), np.empty((_PHASES, 2 * reach + 1))
    for m in range(start, end):
        place, to = m * step, m - start
        base = math.floor(place + 1e-9)
        past[to] = place - base
        phase = m % _PHASES
        if known[phase] != past[to]:
            known[phase] = past[to]
            kept[phase] = weights_at(past[to], reach, rate_hz, at_s, table)
        weight, at = kept[phase], base - first
        begin, stop = max(0, reach - at), min(2 * reach + 1, n + reach - at)
        total = 0.0
        for k in range(begin, stop):
            total += weight[k]
        own[to] = min(at, n - 1)
        after = min(own[to] + 1, n - 1)
        for c in range(channels):
            summed = 0.0
            for k in range(begin, stop):
                summed += weight[k] * values[c, at - reach + k]
            low[c, to] = summed / total
            x, y = values[c, own[to]], values[c, after]
            recorded[c, to] = x * (1 - past[to]) + y * past[to]
    return low, recorded, own, past


@compiled
def weighted_sums(x: Array, kernel: Array) -> Array:
    """Return sums of neighbours, shape (n_channels, n) to (n_channels, n - len(kernel) + 1).

    The oldest is added first: the same sums whatever the blocks.
    """
    channels, taps = len(x), len(kernel)
    count = x.shape[1] - taps + 1
    out = np.zeros((channels, count))
    for c in range(channels):
        for at in range(0, count, _TOGETHER):
            end = min(at + _TOGETHER, count)
            for k in range(taps):
                weight = kernel[taps - 1 - k]
                if weight != 0.0:
                    for i in range(at, end):
                        out[c, i] += weight * x[c, i + k]
    return out
