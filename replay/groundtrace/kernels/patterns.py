"""Where signals of one step are highest, lowest or above a level: scans of some hundred points."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .compiling import compiled, inlined

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled("i8(f8[::1], f8[::1], f8, f8)")
def highest_top(x: Array, phase: Array, low: float, high: float) -> int:
    """Return the highest local maximum whose phase lies in ``[low, high]``; -1 for none."""
    best = -1
    for i in range(1, len(x) - 1):
        top = x[i - 1] < x[i] and x[i] >= x[i + 1] and low <= phase[i] <= high
        if top and (best < 0 or x[i] > x[best]):
            best = i
    return best


@inlined
def _stay(x: Array, level: float, start: int, step: int) -> int:
    """Return the last place, from one on in one direction, up to which x stays above a level."""
    i = start
    while 0 <= i + step < len(x) and x[i + step] > level:
        i += step
    return i


@compiled("UniTuple(i8, 6)(f8[::1], f8, i8)")
def stays_about(x: Array, level: float, top: int) -> tuple[int, int, int, int, int, int]:
    """Return first and last place of a signal's stays above a level: before, around and after.

    Where it is not above it at ``top``, that place alone is around it; where there is none before
    or after, what lies between is.
    """
    first = last = top
    if x[top] > level:
        first, last = _stay(x, level, top, -1), _stay(x, level, top, 1)
    begin, end = 0, first
    for i in range(first - 1, -1, -1):
        if x[i] > level:
            begin, end = _stay(x, level, i, -1), i
            break
    begin_after, end_after = last, len(x) - 1
    for i in range(last + 1, len(x)):
        if x[i] > level:
            begin_after, end_after = i, _stay(x, level, i, 1)
            break
    return begin, end, first, last, begin_after, end_after


@compiled("UniTuple(i8, 4)(f8[::1], i8, f8, f8)")
def minima_about(x: Array, contact: int, most: float, equal: float) -> tuple[int, int, int, int]:
    """Return the local minima up to ``most`` nearest to the contact, and the first and last of all.

    The nearest up to the contact, and after it; the ends where there are none. A flat bottom, of
    values that differ by ``equal`` at most, is at its first place.
    """
    before, after, first, last = 0, len(x) - 1, contact, contact
    for i in range(1, len(x) - 1):
        if x[i] < x[i - 1] - equal and x[i] <= x[i + 1] + equal and x[i] <= most:
            if i > contact and last == contact:
                after = i
            first, last = min(first, i), max(last, i)
            before = i if i <= contact else before
    return before, after, first, last


@compiled("i8(f8[::1], i8, i8, f8)")
def lowest(x: Array, first: int, last: int, equal: float) -> int:
    """Return the first place in ``[first, last]`` within ``equal`` of the minimum."""
    least = x[first]
    for i in range(first, last + 1):
        if math.isnan(x[i]):
            return first
        least = min(x[i], least)
    for i in range(first, last + 1):
        if x[i] <= least + equal:
            return i
    return first


@compiled("f8(f8[::1], i8, i8)")
def extent(x: Array, first: int, last: int) -> float:
    """Return the range of a signal in ``[first, last]``; none where one of its numbers is none."""
    low = high = x[first]
    for i in range(first, last + 1):
        if math.isnan(x[i]):
            return math.nan
        low, high = min(x[i], low), max(x[i], high)
    return float(high - low)
