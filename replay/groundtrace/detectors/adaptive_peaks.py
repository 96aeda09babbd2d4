"""Step-like peaks of a followed signal, and what is measured of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .even_grid import GRID_HZ, Kept
from .rhythm import PERIODS_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from .adaptive_band import Followed

#: A valley belongs to the peak that follows it within this many step times.
_VALLEY_STEPS = 1.2
#: How far a higher peak is looked for, in step times.
REACH_STEPS = 1.0
#: Longest look ahead, a reach at the longest step time [points of the grid].
_AHEAD = round(REACH_STEPS * PERIODS_S[1] * GRID_HZ)
#: Longest look back [points of the grid].
_BACK = round(_VALLEY_STEPS * PERIODS_S[1] * GRID_HZ) + 1
#: A rise is looked for this long before and after the peak of the band [s], its valley within
#: this part of a step.
_RISE_NEAR_S, _RISE_STEPS = 0.1, 0.6


class Peak(NamedTuple):
    """One local maximum of the band.

    Attributes
    ----------
    place
        Where its step is timed [points of the grid since the start of the run].
    height
        The band's value [m/s2].
    swing
        Rise from the valley before [m/s2].
    share
        The same as a part of the swing that is usual in the rhythm around it; 0 without a rhythm.
    dominance
        Time to the nearest higher value, in step times; at most 1.
    rhythm
        Strength of the rhythm around it.
    step_s
        Step time around it [s].
    """

    place: float
    height: float
    swing: float
    share: float
    dominance: float
    rhythm: float
    step_s: float


class Peaks:
    """Finds the local maxima of the band of a :class:`~.adaptive_band.StepBand`.

    Parameters
    ----------
    floor
        Lowest peak [m/s2].
    rise
        Part of the rise from valley to peak at which a step is timed; 0 times it at the peak.
    """

    def __init__(self, floor: float, rise: float) -> None:
        self.floor = floor
        self.rise = rise
        self._kept = Kept(5)
        self._next = 1  # a maximum has a neighbour on either side
        self._last = 0.0  # place of the peak before

    def __call__(self, followed: Followed) -> list[Peak]:
        """Take points; return the peaks whose surroundings are complete."""
        self._kept.add(np.stack(followed))
        found = list(self._until(self._kept.end - _AHEAD))
        self._kept.forget_before(self._next - _BACK)
        return found

    def finish(self) -> list[Peak]:
        """Return the peaks that waited; a maximum at the very end is not one."""
        return list(self._until(self._kept.end - 1))

    def _until(self, end: int) -> Iterator[Peak]:
        if end <= self._next:
            return
        band = self._kept.between(self._next - 1, end + 1)[0]
        higher = (band[1:-1] > band[:-2]) & (band[1:-1] >= band[2:]) & (band[1:-1] > self.floor)
        for index in np.flatnonzero(higher).tolist():
            yield self._measured(self._next + index)
        self._next = end

    def _measured(self, at: int) -> Peak:
        here = at - self._kept.first
        band, rise, rhythm, step, usual = self._kept.values
        step_s = float(step[here])
        back = int(_VALLEY_STEPS * step_s * GRID_HZ)
        swing = float(band[here] - band[max(0, here - back) : here + 1].min())
        offset = (
            _vertex(band[here - 1 : here + 2])
            if not self.rise
            else (self._risen(rise, here, step_s) - here)
        )
        self._last = max(self._last, at + offset)
        return Peak(
            self._last,
            float(band[here]),
            swing,
            swing / float(usual[here]) if usual[here] > 0 else 0.0,
            _dominance(band, here, step_s),
            float(rhythm[here]),
            step_s,
        )

    def _risen(self, signal: NDArray[np.float64], here: int, step_s: float) -> float:
        """Return where the signal reaches the given part of its rise to the peak at ``here``."""
        near = round(_RISE_NEAR_S * GRID_HZ)
        start = max(0, here - near)
        top = start + int(np.argmax(signal[start : here + near + 1]))
        start = max(0, top - round(_RISE_STEPS * step_s * GRID_HZ))
        low = start + int(np.argmin(signal[start : top + 1]))
        level = signal[low] + self.rise * (signal[top] - signal[low])
        if not level > signal[low]:
            return float(top)
        before = low + int(np.flatnonzero(signal[low:top] <= level)[-1])
        if signal[before + 1] <= signal[before]:
            return float(top)
        return before + float((level - signal[before]) / (signal[before + 1] - signal[before]))


def _vertex(three: NDArray[np.float64]) -> float:
    """Return where the parabola through three values has its vertex, from the middle one."""
    before, middle, after = map(float, three)
    return 0.5 * (before - after) / (before - 2 * middle + after)


def _dominance(band: NDArray[np.float64], here: int, step_s: float) -> float:
    reach = int(REACH_STEPS * step_s * GRID_HZ)
    start = max(0, here - reach)
    before = np.flatnonzero(band[start:here] >= band[here])
    after = np.flatnonzero(band[here + 1 : here + reach + 1] > band[here])
    apart = [float(REACH_STEPS)]
    if len(before):
        apart.append((here - start - int(before[-1])) / GRID_HZ / step_s)
    if len(after):
        apart.append((int(after[0]) + 1) / GRID_HZ / step_s)
    return min(apart)
