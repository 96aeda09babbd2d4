"""Signals on one even grid: a low-pass evaluated at its points, and weighted sums of neighbours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .compiling import compiled, inlined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]

#: Phases of the grid against the samples whose weights are kept. Chosen by judgement: usual rates
#: have few against 40 Hz.
_PHASES = 8
#: Sums of every eighth product: they do not wait for each other. Chosen by trial: one vector.
_SUMS = 8
#: Products that are added to each sum before the next one. Chosen by trial: eight gain nothing.
_PRODUCTS = 4


@inlined
def weights_at(
    past: float, reach: int, rate_hz: float, at_s: Array, table: Array, out: Array
) -> None:
    """Write the low-pass's weights of the samples about a point ``past`` one of them, in samples.

    Parameters
    ----------
    past, reach
        How far the point lies after the middle sample, and how many samples count before and after
        that.
    rate_hz
        Sampling rate [Hz].
    at_s, table
        Times and weights between which straight lines are drawn, shape (m,).
    out
        Shape (2 reach + 1,) or more.
    """
    last = len(at_s) - 1
    for k in range(2 * reach + 1):
        away_s = abs((k - reach) - past) / rate_hz
        j = min(int(away_s / at_s[last] * last), last)
        while j > 0 and at_s[j] > away_s:
            j -= 1
        while j < last and at_s[j + 1] <= away_s:
            j += 1
        if j >= last:
            out[k] = table[last]
        else:
            slope = (table[j + 1] - table[j]) / (at_s[j + 1] - at_s[j])
            out[k] = slope * (away_s - at_s[j]) + table[j]


@inlined
def _product_sum(x: Array, at: int, weights: Array, sums: Array) -> float:
    """Return the sum of products of weights and what stands from ``at`` on."""
    sums[:] = 0.0
    for k in range(0, len(weights), _SUMS):
        for i in range(_SUMS):
            sums[i] += weights[k + i] * x[at + k + i]
    s = sums
    return float(((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))


@inlined
def _sum(values: Array, start: int, stop: int) -> float:
    total = 0.0
    for k in range(start, stop):
        total += values[k]
    return total


@compiled(
    "Tuple((f8[:, ::1], f8[:, ::1], i8[::1], f8[::1]))"
    "(f8[:, ::1], i8, i8, i8, f8, f8, i8, f8[::1], f8[::1])"
)
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
    taps, count = 2 * reach + 1, end - start
    low, recorded = np.empty((channels, count)), np.empty((channels, count))
    samples, past = np.empty(count, np.int64), np.empty(count)
    padded = -(-taps // _SUMS) * _SUMS
    phases, weights = np.full(_PHASES, -1.0), np.zeros((_PHASES, padded))
    # nothing stands before the run and after its end
    lines, sums = np.zeros((channels, n + padded + reach + _SUMS)), np.empty(_SUMS)
    for c in range(channels):
        for i in range(n):
            lines[c, reach + i] = values[c, i]
    for m in range(count):
        position = (start + m) * step
        base = math.floor(position + 1e-9)
        past[m] = position - base
        weight, phase = weights[(start + m) % _PHASES], (start + m) % _PHASES
        if phases[phase] != past[m]:
            phases[phase] = past[m]
            weights_at(past[m], reach, rate_hz, at_s, table, weight)
        at = base - first
        total = _sum(weight, max(0, reach - at), min(taps, n + reach - at))
        samples[m] = min(at, n - 1)
        after = min(samples[m] + 1, n - 1)
        for c in range(channels):
            low[c, m] = _product_sum(lines[c], at, weight, sums) / total
            x, y = values[c, samples[m]], values[c, after]
            recorded[c, m] = x * (1 - past[m]) + y * past[m]
    return low, recorded, samples, past


@inlined
def neighbour_sums(x: Array, weights: Array, sums: Array) -> None:
    """Put weighted sums of neighbours in ``sums``, shape (n,): that of i begins with x[i].

    Each is added up from the first neighbour on, whatever the blocks.

    Parameters
    ----------
    x
        Shape (n + len(weights) - 1,) or more.
    weights
        From the first neighbour on.
    """
    taps, n = len(weights), len(sums)
    sums[:] = 0.0
    grouped = taps - taps % _PRODUCTS
    for k in range(0, grouped, _PRODUCTS):
        a, b, c, d = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        part = x[k : k + n + _PRODUCTS - 1]
        for i in range(n):
            sums[i] = sums[i] + a * part[i] + b * part[i + 1] + c * part[i + 2] + d * part[i + 3]
    for k in range(grouped, taps):
        weight, part = weights[k], x[k : k + n]
        for i in range(n):
            sums[i] += weight * part[i]


@compiled("f8[:, ::1](f8[:, ::1], f8[::1])")
def weighted_sums(x: Array, kernel: Array) -> Array:
    """Return sums of neighbours, shape (n_channels, n) to (n_channels, n - len(kernel) + 1).

    The oldest is added first: the same sums whatever the blocks.
    """
    sums, weights = np.empty((len(x), x.shape[1] - len(kernel) + 1)), kernel[::-1].copy()
    for c in range(len(x)):
        neighbour_sums(x[c], weights, sums[c])
    return sums
