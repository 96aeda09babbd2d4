"""Signals on the grid whose filters follow the walker's step time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .even_grid import GRID_HZ, CentredFilter, Kept, gaussian, lowpass
from .rhythm import HOP, PERIODS_S, Rhythm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .rhythm import Scale

#: Step times that have a filter of their own; between them, the filtered signals are mixed.
_NODES_S = np.geomspace(*PERIODS_S, 8)
#: Standard deviations of the band's two Gaussians as parts of the step time: the first takes out
#: the second peak of a step, the second what is slower than a step.
_FINE, _COARSE = 0.16, 0.4
#: Standard deviation of the Gaussian whose average is taken away before the rhythm is told [s].
_TREND_S = 0.4
#: Low-pass in which a rise is timed: corner [Hz] and half length [s].
_TIMED_HZ, _TIMED_S = 3.0, 0.5


class Followed(NamedTuple):
    """Consecutive points whose step time is known, shape (n,) each.

    Attributes
    ----------
    band
        Acceleration upward in the band of the steps [m/s2].
    rise
        Acceleration upward as rises are timed in [m/s2].
    rhythm
        Strength of the rhythm.
    step_s
        Step time [s].
    usual
        Swing that is usual in that rhythm [m/s2].
    """

    band: NDArray[np.float64]
    rise: NDArray[np.float64]
    rhythm: NDArray[np.float64]
    step_s: NDArray[np.float64]
    usual: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Filters:
    band: tuple[CentredFilter, ...]
    rise: CentredFilter
    trend: CentredFilter


def _filters() -> _Filters:
    reach = len(gaussian(_COARSE * _NODES_S[-1])) // 2
    steps = np.arange(-reach, reach + 1) / GRID_HZ
    timed = lowpass(_TIMED_HZ, _TIMED_S, steps)
    return _Filters(
        tuple(
            CentredFilter(_padded(_FINE * t, reach) - _padded(_COARSE * t, reach)) for t in _NODES_S
        ),
        CentredFilter(timed / timed.sum()),
        CentredFilter(-_padded(_TREND_S, len(gaussian(_TREND_S)) // 2, centre=-1.0)),
    )


def _padded(sigma_s: float, reach: int, centre: float = 0.0) -> NDArray[np.float64]:
    """Return a Gaussian of a given half length, ``centre`` added to its middle."""
    kernel = gaussian(sigma_s)
    padded = np.pad(kernel, reach - len(kernel) // 2)
    padded[reach] += centre
    return padded


class StepBand:
    """Follows the rhythm of the acceleration upward, and filters it by the step time.

    Parameters
    ----------
    scales, ahead_s
        Of the :class:`~.rhythm.Rhythm`.
    """

    def __init__(self, scales: Sequence[Scale], ahead_s: float) -> None:
        self._filters = _filters()
        self._rhythm = Rhythm(scales, ahead_s)
        self._bands = Kept(len(_NODES_S) + 1)  # one by node, and the one that rises are timed in
        self._hops = Kept(3)  # strength of the rhythm, step time, swing

    def __call__(self, up: NDArray[np.float64]) -> Followed:
        """Take the acceleration upward, shape (1, n); return the points known by now."""
        filters = self._filters
        self._bands.add(np.concatenate([f(up) for f in (*filters.band, filters.rise)]))
        self._hops.add(self._rhythm(filters.trend(up)))
        return self._until(min(self._bands.end, (self._hops.end - 1) * HOP))

    def finish(self) -> Followed:
        """Return the points up to the end of the signal."""
        filters = self._filters
        self._bands.add(np.concatenate([f.finish() for f in (*filters.band, filters.rise)]))
        self._hops.add(self._rhythm(filters.trend.finish()))
        self._hops.add(self._rhythm.finish())
        return self._until(self._bands.end)

    def _until(self, end: int) -> Followed:
        start = self._bands.first
        end = max(start, end)
        bands = self._bands.between(start, end)
        if start == end:
            nothing = np.empty(0)
            return Followed(nothing, nothing, nothing, nothing, nothing)
        hop = start // HOP
        known = self._hops.between(hop, -(-end // HOP) + 1)
        at = np.arange(start, end) / HOP
        grid = np.arange(hop, hop + known.shape[1])
        rhythm = np.interp(at, grid, known[0])
        step_s = np.interp(at, grid, known[1])
        self._bands.forget_before(end)
        self._hops.forget_before(end // HOP)
        usual = np.interp(at, grid, known[2])
        return Followed(_mixed(bands[:-1], step_s), bands[-1], rhythm, step_s, usual)


def _mixed(bands: NDArray[np.float64], step_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the band of each point's own step time, mixed from those of the nearest nodes."""
    place = np.interp(step_s, _NODES_S, np.arange(len(_NODES_S)))
    below = np.minimum(place.astype(np.intp), len(_NODES_S) - 2)
    part, column = place - below, np.arange(len(step_s))
    return np.asarray(bands[below, column] * (1 - part) + bands[below + 1, column] * part)
