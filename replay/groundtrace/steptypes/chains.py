"""The patterns of one step: in the frontal chain, in the lateral chain, and what they measure.

Source: EPFL, sections on preprocessing and recognition, figures 2 and 3. On either axis a step is
what lies between two minima. The frontal ones are looked for in windows that the vertical signal
gives, from where it rises through its mean to where it falls through it; the lateral ones lie deep
in a window centred on them. What the document leaves open is ours: thresholds, and that the
lateral window follows the signal instead of having a fixed length, so that cadence does not matter.

All is measured on a strip: the three accelerations around a step on a grid of step times, smoothed
so that slow steps show as many harmonics as fast ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Points of the grid per step time; how far it reaches before and after the contact [steps]. With
#: the two steps that follow it, a step is then known within four.
POINTS, BEFORE, AFTER = 32, 2.5, 1.5625
#: Phase of the points of the grid, in steps about the contact.
PHASE: Array = np.arange(-BEFORE * POINTS, AFTER * POINTS + 1) / POINTS
#: Place of the contact on the grid.
CONTACT = round(BEFORE * POINTS)
#: Standard deviation of the Gaussian that smooths a strip [steps].
_SMOOTH = 0.1
#: The vertical maximum of a step lies in this span of its contact [steps].
_TOP = (-0.35, 0.65)
#: The frontal maximum of a step is looked for this near to its vertical maximum [steps].
_NEAR = 0.5
#: Lateral minima and maxima lie in this part of the range, from its ends.
_DEEP = 0.3
#: Span over which ranges are compared [steps].
_RANGE = 1.5


@dataclass(frozen=True, slots=True)
class Frontal:
    """The frontal pattern of a step.

    Attributes
    ----------
    window
        Length of the vertical signal's stay above its mean [steps].
    lead
        By how much its maximum comes before the vertical one [steps]; NaN where it has none.
    density
        Area of its triangle per length of its base, as a part of the vertical range.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    """

    window: float
    lead: float
    density: float
    slopes: float


@dataclass(frozen=True, slots=True)
class Lateral:
    """The lateral pattern of a step.

    Attributes
    ----------
    share
        Geometric mean of the lateral range over the frontal and over the vertical one.
    lobe
        Distance of its maximum from its middle, as a part of its length.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    inside
        How far on the steep side of the maximum the contact lies, as a part of its length.
    """

    share: float
    lobe: float
    slopes: float
    inside: float


def strip_of(times_s: Array, values: Array, step_s: float) -> Array:
    """Return accelerations on the grid, smoothed, shape (3, n).

    Parameters
    ----------
    times_s
        Of the samples, about the contact [s], shape (m,).
    values
        Accelerations ahead, to the right and up, shape (3, m).
    step_s
        Time of a step [s].
    """
    half = round(3 * _SMOOTH * POINTS)
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / (_SMOOTH * POINTS)) ** 2)
    # the ends have fewer neighbours: nothing beyond the strip is waited for
    count = np.convolve(np.ones(len(PHASE)), weights, "same")
    rows = [np.interp(PHASE * step_s, times_s, row) for row in values]
    return np.stack([np.convolve(row, weights, "same") / count for row in rows])


def maxima(x: Array, low: float, high: float) -> NDArray[np.intp]:
    """Return the places of the local maxima whose phase lies in ``[low, high]``."""
    middle = x[1:-1]
    found = np.flatnonzero((middle > x[:-2]) & (middle >= x[2:])) + 1
    return found[(PHASE[found] >= low) & (PHASE[found] <= high)]


def range_of(x: Array) -> float:
    """Return the range of a strip's row near the contact."""
    near = x[np.abs(PHASE) <= _RANGE]
    return float(np.ptp(near))


def frontal(strip: Array, swing: NDArray[np.complex128] | None) -> Frontal:
    """Measure the frontal pattern of a strip.

    Parameters
    ----------
    strip
        Shape (3, n).
    swing
        Of the step (:func:`groundtrace.heading.walking_axis.step_swing`); its phase is the lead of
        a step without a frontal maximum of its own.
    """
    ahead, _, up = strip
    tops = maxima(up, *_TOP)
    top = int(tops[np.argmax(up[tops])]) if len(tops) else CONTACT
    before, own, after = _windows(up - up[np.abs(PHASE) <= 1.0].mean(), top)
    found = maxima(ahead, PHASE[top] - _NEAR, PHASE[top] + _NEAR)
    window = (own[1] - own[0]) / POINTS
    if not len(found):
        angle = 0.0 if swing is None else float(np.angle(swing[0]))
        return Frontal(window, angle / (2 * np.pi), 0.0, 0.0)
    peak = int(found[np.argmax(ahead[found])])
    first = _lowest(ahead, *(before if peak <= top else own), limit=peak)
    last = _lowest(ahead, *(own if peak <= top else after), limit=-peak)
    height = ahead[peak] - 0.5 * (ahead[first] + ahead[last])
    # a triangle of base n and this height has an area of height n / 2
    density = 0.5 * float(height) / max(range_of(up), 1e-9)
    return Frontal(window, (top - peak) / POINTS, density, _slopes(ahead, first, peak, last))


def lateral(strip: Array) -> Lateral:
    """Measure the lateral pattern of a strip."""
    ahead, right, up = strip
    low, size = float(right.min()), float(np.ptp(right))
    other = max(range_of(ahead), 1e-9) * max(range_of(up), 1e-9)
    share = range_of(right - _stride_mean(right)) / other**0.5
    deep = maxima(-right, -BEFORE, AFTER)
    deep = deep[right[deep] <= low + _DEEP * size]
    first, last = _around(deep)
    peak = first + int(np.argmax(right[first : last + 1]))
    if first < deep.min(initial=CONTACT):
        first = _lowest(right, first, peak)
    if last > deep.max(initial=CONTACT):
        last = _lowest(right, peak, last)
    length = max(last - first, 1)
    slopes = _slopes(right, first, peak, last)
    side = 1.0 if slopes > 0 else -1.0
    lobe = abs((peak - first) / length - 0.5)
    return Lateral(share, lobe, slopes, side * (CONTACT - peak) / length)


def _stride_mean(x: Array) -> Array:
    """Return the mean over two steps: what a turn adds to the lateral acceleration."""
    box = np.ones(2 * POINTS + 1)
    return np.asarray(np.convolve(x, box, "same") / np.convolve(np.ones(len(x)), box, "same"))


def _around(places: NDArray[np.intp]) -> tuple[int, int]:
    """Return the last place up to the contact and the first after it; the strip's ends if none."""
    before, after = places[places <= CONTACT], places[places > CONTACT]
    first = int(before[-1]) if len(before) else 0
    return first, int(after[0]) if len(after) else len(PHASE) - 1


def _lowest(x: Array, first: int, last: int, limit: int | None = None) -> int:
    """Return the place of the minimum in ``[first, last]``.

    Only up to ``limit`` where it is positive, from ``-limit`` on where it is negative.
    """
    if limit is not None and limit < 0:
        first, last = max(first, -limit), max(last, -limit)
    elif limit is not None:
        first, last = min(first, limit), min(last, limit)
    return first + int(np.argmin(x[first : last + 1]))


def _windows(x: Array, top: int) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """Return where a signal is above 0: around ``top``, and the times before and after that.

    Where it stays below, what lies between is given.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], x > 0, [0]]).astype(np.int8)))
    spans = [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
    own = next((s for s in spans if s[0] <= top <= s[1]), (top, top))
    before = [s for s in spans if s[1] < own[0]]
    after = [s for s in spans if s[0] > own[1]]
    end = len(x) - 1
    return (before[-1] if before else (0, own[0])), own, (after[0] if after else (own[1], end))


def _slopes(x: Array, first: int, peak: int, last: int) -> float:
    """Return the logarithm of the mean slope after a maximum over that before it."""
    rise = float(x[peak] - x[first]) / max(peak - first, 1)
    fall = float(x[peak] - x[last]) / max(last - peak, 1)
    if not (rise > 0 and fall > 0):
        return 0.0
    return float(np.log(fall / rise))
