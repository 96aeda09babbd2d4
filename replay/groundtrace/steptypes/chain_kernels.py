"""The loops of :mod:`.chains`, compiled: the strip of a step, and its patterns on both axes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Span = tuple[int, int]


@compiled
def neighbours(row: Array, weights: Array, count: int) -> Array:
    """Return weighted sums of neighbours, the first of each first, shape (count,)."""
    out = np.zeros(count)
    for k in range(len(weights)):
        weight = weights[k]
        for i in range(count):
            out[i] += weight * row[i + k]
    return out


@compiled
def strip(times_s: Array, values: Array, phase_s: Array, weights: Array, smoothed: Array) -> None:
    """Put signals, shape (c, m), at times ``phase_s`` in ``smoothed``, shape (c, n), averaged.

    At the ends fewer neighbours count: nothing beyond the strip is waited for.
    """
    n, half, last = len(phase_s), len(weights) // 2, len(times_s) - 1
    before, past = np.zeros(n, np.int64), np.zeros(n)
    j = 0
    for i in range(n):
        while j < last and times_s[j + 1] <= phase_s[i]:
            j += 1
        before[i], past[i] = j, phase_s[i] - times_s[j]
    # nothing stands beyond the ends, and weighs nothing
    row, ones = np.zeros(n + 2 * half), np.zeros(n + 2 * half)
    ones[half : half + n] = 1.0
    totals = neighbours(ones, weights, n)
    for c in range(len(values)):
        for i in range(n):
            j = before[i]
            now = values[c, j]
            if j < last and past[i] > 0:
                slope = (values[c, j + 1] - values[c, j]) / (times_s[j + 1] - times_s[j])
                now = slope * past[i] + values[c, j]
            row[half + i] = now
        smoothed[c] = neighbours(row, weights, n) / totals


@in_place
def reach(x: Array, span: Span) -> float:
    """Return the range of a signal in ``[first, last]``."""
    low = high = x[span[0]]
    for i in range(span[0], span[1] + 1):
        low, high = min(low, x[i]), max(high, x[i])
    return float(high - low)


@in_place
def lowest(x: Array, first: int, last: int) -> int:
    """Return the place of the minimum in ``[first, last]``."""
    best = first
    for i in range(first, last + 1):
        if x[i] < x[best]:
            best = i
    return best


@in_place
def slopes(x: Array, first: int, peak: int, last: int) -> float:
    """Return the logarithm of the mean slope after a maximum over that before it."""
    rise = (x[peak] - x[first]) / max(peak - first, 1)
    fall = (x[peak] - x[last]) / max(last - peak, 1)
    if not (rise > 0 and fall > 0):
        return 0.0
    return math.log(fall / rise)


@in_place
def highest_top(x: Array, phase: Array, low: float, high: float) -> int:
    """Return the highest local maximum whose phase lies in ``[low, high]``; -1 for none."""
    best = -1
    for i in range(1, len(x) - 1):
        inside = low <= phase[i] <= high
        if inside and x[i] > x[i - 1] and x[i] >= x[i + 1] and (best < 0 or x[i] > x[best]):
            best = i
    return best


@in_place
def windows(x: Array, level: float, top: int) -> tuple[Span, Span, Span]:
    """Return where a signal is above a level: before ``top``, around it, and after.

    Where it stays below, what lies between is given.
    """
    last = len(x) - 1
    first, end = top, top
    if x[top] > level:
        while first > 0 and x[first - 1] > level:
            first -= 1
        while end < last and x[end + 1] > level:
            end += 1
    before, after = (0, first), (end, last)
    i = first - 1
    while i >= 0 and not x[i] > level:
        i -= 1
    if i >= 0:
        begin = i
        while begin > 0 and x[begin - 1] > level:
            begin -= 1
        before = (begin, i)
    i = end + 1
    while i <= last and not x[i] > level:
        i += 1
    if i <= last:
        begin = i
        while i < last and x[i + 1] > level:
            i += 1
        after = (begin, i)
    return before, (first, end), after


@compiled
def frontal(
    values: Array,
    phase: Array,
    contact: int,
    top_span: tuple[float, float],
    near: float,
    about: Span,
    points: int,
    reach_span: Span,
) -> tuple[float, float, float, float]:
    """Return window, lead (NaN without a frontal maximum), density and slopes of a strip.

    Parameters
    ----------
    values, phase
        Shape (3, n), and phase of its points, shape (n,).
    contact
        Place of the contact.
    top_span
        Phases between which the vertical maximum lies.
    near
        How far from that the frontal maximum may lie [steps].
    about, reach_span
        Where the vertical mean and its range are taken, first and last place.
    points
        Per step.
    """
    ahead, up = values[0], values[2]
    top = highest_top(up, phase, top_span[0], top_span[1])
    top = contact if top < 0 else top
    level = up[about[0] : about[1] + 1].mean()
    before, own, after = windows(up, level, top)
    window = (own[1] - own[0]) / points
    peak = highest_top(ahead, phase, phase[top] - near, phase[top] + near)
    if peak < 0:
        return window, math.nan, 0.0, 0.0
    rising, falling = before if peak <= top else own, own if peak <= top else after
    first = lowest(ahead, min(rising[0], peak), min(rising[1], peak))
    last = lowest(ahead, max(falling[0], peak), max(falling[1], peak))
    height = ahead[peak] - 0.5 * (ahead[first] + ahead[last])
    # a triangle of base n and this height has an area of height n / 2
    density = 0.5 * height / max(reach(up, reach_span), 1e-9)
    return window, (top - peak) / points, density, slopes(ahead, first, peak, last)


@compiled
def without_mean(x: Array, half: int) -> Array:
    """Return a signal less its mean over ``half`` points before and after, as far as there are."""
    out = np.empty(len(x))
    for i in range(len(x)):
        first, stop = max(0, i - half), min(len(x), i + half + 1)
        summed = 0.0
        for k in range(first, stop):
            summed += x[k]
        out[i] = x[i] - summed / (stop - first)
    return out


@in_place
def around(x: Array, contact: int, most: float) -> tuple[int, int, int, int]:
    """Return the local minima up to ``most`` nearest to the contact, the first and the last of all.

    The nearest up to the contact, and after it; the ends of the strip where there are none.
    """
    before, after, first, last = 0, len(x) - 1, contact, contact
    for i in range(1, len(x) - 1):
        if x[i] < x[i - 1] and x[i] <= x[i + 1] and x[i] <= most:
            first, last = min(first, i), max(last, i)
            if i <= contact:
                before = i
            elif after == len(x) - 1:
                after = i
    return before, after, first, last


@compiled
def lateral(
    values: Array, contact: int, deep: float, reach_span: Span, stride: int
) -> tuple[float, float, float, float]:
    """Return share, lobe, slopes and where the contact lies of a strip's lateral pattern.

    Parameters
    ----------
    values
        Shape (3, n).
    contact
        Place of the contact.
    deep
        Part of the range in which minima lie.
    reach_span
        Where ranges are taken, first and last place.
    stride
        Points before and after that a mean is taken over.
    """
    ahead, right, up = values
    low, high = right.min(), right.max()
    other = max(reach(ahead, reach_span), 1e-9) * max(reach(up, reach_span), 1e-9)
    share = reach(without_mean(right, stride), reach_span) / other**0.5
    first, last, earliest, latest = around(right, contact, low + deep * (high - low))
    peak = first
    for i in range(first, last + 1):
        if right[i] > right[peak]:
            peak = i
    if first < earliest:
        first = lowest(right, first, peak)
    if last > latest:
        last = lowest(right, peak, last)
    length = max(last - first, 1)
    steep = slopes(right, first, peak, last)
    side = 1.0 if steep > 0 else -1.0
    lobe = abs((peak - first) / length - 0.5)
    return share, lobe, steep, side * (contact - peak) / length
