"""The loops of :mod:`.adaptive_peaks`, compiled: peak after peak."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@in_place
def vertex(before: float, middle: float, after: float) -> float:
    """Return where the parabola through three values has its vertex, from the middle one."""
    return 0.5 * (before - after) / (before - 2.0 * middle + after)


@in_place
def risen(signal: Array, here: int, near: int, back: int, part: float) -> float:
    """Return where a signal reaches a part of its rise to the peak within ``near`` of a place."""
    top = max(0, here - near)
    for i in range(top, min(here + near + 1, len(signal))):
        if signal[i] > signal[top]:
            top = i
    low = max(0, top - back)
    for i in range(low, top + 1):
        if signal[i] < signal[low]:
            low = i
    level = signal[low] + part * (signal[top] - signal[low])
    if not level > signal[low]:
        return float(top)
    before = low
    for i in range(low, top):
        if signal[i] <= level:
            before = i
    if signal[before + 1] <= signal[before]:
        return float(top)
    return float(before + (level - signal[before]) / (signal[before + 1] - signal[before]))


@in_place
def higher(band: Array, here: int, reach: int) -> int:
    """Return how many points away the nearest higher value is; 0 where none is within ``reach``."""
    for away in range(1, reach + 1):
        before, after = here - away, here + away
        earlier = before >= 0 and band[before] >= band[here]
        if earlier or (after < len(band) and band[after] > band[here]):
            return away
    return 0


@compiled
def peaks(
    points: Array,
    first: int,
    span: tuple[int, int],
    last: float,
    floor: float,
    rise: float,
    grid_hz: float,
    near: int,
    reaches: tuple[float, float, float],
) -> Array:
    """Measure the local maxima of the band at places ``[start, end)``.

    Parameters
    ----------
    points
        Band, rise, rhythm, step time and usual swing of the points from ``first`` on, shape (5, n).
    last
        Place of the peak before.
    floor, rise
        Lowest peak, and part of the rise at which a step is timed; 0 times it at the peak.
    near
        How far from the peak of the band a rise ends at most [points].
    reaches
        How far valleys, the beginning of a rise and higher peaks are looked for [step times].

    Returns
    -------
    Place, height, swing, share, dominance, rhythm and step time, shape (n_peaks, 7).
    """
    band, timed, rhythm, step_s, usual = points
    found = np.empty((span[1] - span[0], 7))
    count = 0
    for at in range(span[0], span[1]):
        i = at - first
        if not (band[i] > band[i - 1] and band[i] >= band[i + 1] and band[i] > floor):
            continue
        step, low = step_s[i], band[i]
        for k in range(max(0, i - int(reaches[0] * step * grid_hz)), i):
            low = min(low, band[k])
        if rise == 0.0:
            offset = vertex(band[i - 1], band[i], band[i + 1])
        else:
            offset = risen(timed, i, near, round(reaches[1] * step * grid_hz), rise) - i
        last = max(last, at + offset)
        swing = band[i] - low
        row = found[count]
        row[0], row[1], row[2] = last, band[i], swing
        row[3] = swing / usual[i] if usual[i] > 0 else 0.0
        away = higher(band, i, int(reaches[2] * step * grid_hz))
        row[4] = min(reaches[2], away / grid_hz / step) if away else reaches[2]
        row[5], row[6] = rhythm[i], step
        count += 1
    return found[:count].copy()
