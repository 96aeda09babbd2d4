"""The loops of the even grid, compiled: its low-pass and centred filters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import LANES, every, put_row, row_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]

#: Phases of the grid against the samples whose weights are kept.
_PHASES = 8
#: Sums that are made together, in registers.
TOGETHER = 4 * LANES


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


@in_place
def summed(values: Array, start: int, stop: int) -> float:
    """Return the sum of values ``[start, stop)``, the first two added first."""
    total = 0.0
    for k in range(start, stop):
        total += values[k]
    return total


@in_place
def product_sum(x: Array, at: int, weights: Array, rows: int, sums: Array) -> float:
    """Return the sum of products of weights and what stands from ``at`` on, a few rows of each.

    Each lane is summed by itself, into ``sums``, shape (1, LANES).
    """
    total = every(0.0)
    for k in range(0, rows * LANES, LANES):
        total = total + row_from(weights, k) * row_from(x, at + k)
    put_row(sums, 0, total)
    s = sums[0]
    return float(((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))


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
    rows = (2 * reach + LANES) // LANES
    known, kept, totals = (
        np.full(_PHASES, -1.0),
        np.zeros((_PHASES, rows * LANES)),
        np.zeros(_PHASES),
    )
    # nothing stands before the run and after its end
    lines, sums = np.zeros((channels, n + (rows + 1) * LANES + reach)), np.empty((1, LANES))
    for c in range(channels):
        lines[c, reach : reach + n] = values[c]
    for m in range(start, end):
        place, to = m * step, m - start
        base = math.floor(place + 1e-9)
        past[to] = place - base
        phase = m % _PHASES
        if known[phase] != past[to]:
            known[phase] = past[to]
            kept[phase, : 2 * reach + 1] = weights_at(past[to], reach, rate_hz, at_s, table)
            totals[phase] = summed(kept[phase], 0, 2 * reach + 1)
        weight, at, total = kept[phase], base - first, totals[phase]
        if at < reach or at >= n - reach:
            total = summed(weight, max(0, reach - at), min(2 * reach + 1, n + reach - at))
        own[to] = min(at, n - 1)
        after = min(own[to] + 1, n - 1)
        for c in range(channels):
            low[c, to] = product_sum(lines[c], at, weight, rows, sums) / total
            x, y = values[c, own[to]], values[c, after]
            recorded[c, to] = x * (1 - past[to]) + y * past[to]
    return low, recorded, own, past


@in_place
def sums_together(
    x: Array, at: int, weights: Array, span: tuple[int, int], out: Array, to: int
) -> None:
    """Put weighted sums of neighbours, of :data:`TOGETHER` points from ``at`` on, in four rows.

    Parameters
    ----------
    x
        Shape (n,), to at least TOGETHER behind the last neighbour.
    weights, span
        Weights from the oldest neighbour on, and those that count.
    out, to
        Rows of LANES, and the first of the four.
    """
    one, two, three, four = every(0.0), every(0.0), every(0.0), every(0.0)
    for k in range(span[0], span[1]):
        weight = every(weights[k])
        one = one + weight * row_from(x, at + k)
        two = two + weight * row_from(x, at + k + LANES)
        three = three + weight * row_from(x, at + k + 2 * LANES)
        four = four + weight * row_from(x, at + k + 3 * LANES)
    put_row(out, to, one)
    put_row(out, to + 1, two)
    put_row(out, to + 2, three)
    put_row(out, to + 3, four)


@compiled
def weighted_sums(x: Array, kernel: Array) -> Array:
    """Return sums of neighbours, shape (n_channels, n) to (n_channels, n - len(kernel) + 1).

    The oldest is added first: the same sums whatever the blocks.
    """
    channels, taps = len(x), len(kernel)
    count = x.shape[1] - taps + 1
    groups = -(-count // TOGETHER)
    out, line = np.empty((channels, groups * TOGETHER)), np.zeros(groups * TOGETHER + taps)
    weights = kernel[::-1].copy()
    for c in range(channels):
        line[: x.shape[1]] = x[c]
        rows = out[c].reshape(-1, LANES)
        for g in range(groups):
            sums_together(line, g * TOGETHER, weights, (0, taps), rows, 4 * g)
    return out[:, :count]
