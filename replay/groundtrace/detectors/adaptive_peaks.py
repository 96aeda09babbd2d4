"""Step-like peaks of a followed signal, and what is measured of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..later import Later
from .even_grid import GRID_HZ, Kept
from .rhythm import PERIODS_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import peak_kernels
    from .adaptive_band import Followed
else:
    peak_kernels = Later("groundtrace.detectors.peak_kernels")

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


#: Columns of what is measured of a peak: where its step is timed [points of the grid since the
#: start of the run]; the band's value and its rise from the valley before [m/s2]; the same as a
#: part of the swing that is usual in the rhythm around it, 0 without a rhythm; time to the nearest
#: higher value, in step times, at most 1; strength of the rhythm and step time [s] around it.
COLUMNS = ("place", "height", "swing", "share", "dominance", "rhythm", "step_s")


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

    def __call__(self, followed: Followed) -> NDArray[np.float64]:
        """Take points; return the peaks whose surroundings are complete, as :data:`COLUMNS`."""
        self._kept.add(np.stack(followed))
        found = self._until(self._kept.end - _AHEAD)
        self._kept.forget_before(self._next - _BACK)
        return found

    def finish(self) -> NDArray[np.float64]:
        """Return the peaks that waited; a maximum at the very end is not one."""
        return self._until(self._kept.end - 1)

    def _until(self, end: int) -> NDArray[np.float64]:
        if end <= self._next:
            return np.empty((0, len(COLUMNS)))
        span, self._next = (self._next, end), end
        found = peak_kernels.peaks(
            self._kept.contiguous(),
            self._kept.first,
            span,
            self._last,
            self.floor,
            self.rise,
            GRID_HZ,
            round(_RISE_NEAR_S * GRID_HZ),
            (_VALLEY_STEPS, _RISE_STEPS, REACH_STEPS),
        )
        self._last = float(found[-1, 0]) if len(found) else self._last
        return found
