"""Signals on the grid whose filters follow the walker's step time."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..later import Later
from .even_grid import GRID_HZ, CentredFilter, Kept, gaussian, lowpass
from .rhythm import HOP, PERIODS_S, Rhythm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from . import band_kernels
    from .rhythm import Scale
else:
    band_kernels = Later("groundtrace.detectors.band_kernels")

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


@cache
def _kernels(*, fine: bool) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the weights of each node's band, and last of the signal rises are timed in.

    Without ``fine`` the band has no upper end: a point itself in place of its first Gaussian.

    Shape (nodes + 1, taps), from the oldest neighbour on; and the first and last that counts. Both
    are to read only.
    """
    reach = len(gaussian(_COARSE * _NODES_S[-1])) // 2
    timed = lowpass(_TIMED_HZ, _TIMED_S, np.arange(-reach, reach + 1) / GRID_HZ)
    point = np.zeros(2 * reach + 1)
    point[reach] = 1.0
    tops = [_padded(_FINE * t, reach) if fine else point for t in _NODES_S]
    bands = [top - _padded(_COARSE * t, reach) for top, t in zip(tops, _NODES_S, strict=True)]
    kernels = np.array([*bands, timed / timed.sum()])
    spans = [(k[0], k[-1] + 1) for k in (np.flatnonzero(kernel) for kernel in kernels)]
    return np.ascontiguousarray(kernels[:, ::-1]), np.array(spans, np.int64)


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
    fine
        Whether what is quicker than a step is taken out; False leaves it in.
    """

    def __init__(self, scales: Sequence[Scale], ahead_s: float, *, fine: bool = True) -> None:
        self._kernels, self._spans = _kernels(fine=fine)
        trend = _padded(_TREND_S, len(gaussian(_TREND_S)) // 2, centre=-1.0)
        self._trend = CentredFilter(-trend)
        self._rhythm = Rhythm(scales, ahead_s)
        self._reach = len(self._kernels[0]) // 2
        self._up = Kept()  # held before and after its ends; its places are those of the first tap
        self._hops = Kept(3)  # strength of the rhythm, step time, swing

    def __call__(self, up: NDArray[np.float64]) -> Followed:
        """Take the acceleration upward, shape (1, n); return the points known by now."""
        if up.shape[1] and not self._up.end:
            self._up.add(np.repeat(up[:, :1], self._reach, axis=1))
        self._up.add(up)
        self._hops.add(self._rhythm(self._trend(up)))
        return self._until(min(self._filtered, (self._hops.end - 1) * HOP))

    def finish(self) -> Followed:
        """Return the points up to the end of the signal."""
        self._up.add(np.repeat(self._up.values[:, -1:], self._reach, axis=1))
        self._hops.add(self._rhythm(self._trend.finish()))
        self._hops.add(self._rhythm.finish())
        return self._until(self._filtered)

    @property
    def _filtered(self) -> int:
        """Place after the last point whose neighbours are there."""
        return self._up.end - 2 * self._reach

    def _until(self, end: int) -> Followed:
        start = self._up.first
        end = max(start, end)
        found = np.empty((len(Followed._fields), end - start))
        if end > start:
            hop = start // HOP
            band_kernels.step_bands(
                self._up.between(start, end + 2 * self._reach)[0],
                self._kernels,
                self._spans,
                _NODES_S,
                np.ascontiguousarray(self._hops.between(hop, -(-end // HOP) + 1)),
                start,
                HOP,
                found,
            )
        self._up.forget_before(end)
        self._hops.forget_before(end // HOP)
        return Followed(*found)
