"""Resampling to one even grid, and filters without delay on it, over blocks of any length.

On the grid the same filters apply at any sampling rate: at 400 Hz the grid's low-pass removes what
would alias, at 6 Hz it draws the smooth curve through the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .. import kernels
from .filters import corner

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Points per second of the grid [Hz]. Chosen by judgement: steps have their strength below 6 Hz.
GRID_HZ = 40.0
#: Half length of the low-pass [s]; at least three samples. Chosen by judgement: two periods of 4
#: Hz.
_HALF_S = 0.5
_HALF_SAMPLES = 3.0
#: Points of the tabled half of the low-pass, so fine that straight lines do between them. Chosen by
#: judgement: a period of 20 Hz has 400 of them.
_TABLE = 4096


def gaussian(sigma_s: float, reach: float = 3.0) -> NDArray[np.float64]:
    """Return a Gaussian of unit sum on the grid, cut at ``reach`` standard deviations."""
    half = int(reach * sigma_s * GRID_HZ) + 1
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / (GRID_HZ * sigma_s)) ** 2)
    return np.asarray(weights / weights.sum())


def lowpass(cutoff_hz: float, half_s: float, at_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the impulse response of a Hann-windowed ideal low-pass at times ``at_s``."""
    window = np.where(np.abs(at_s) < half_s, 0.5 + 0.5 * np.cos(np.pi * at_s / half_s), 0.0)
    return np.asarray(2 * cutoff_hz * np.sinc(2 * cutoff_hz * at_s) * window)


@dataclass(frozen=True, slots=True, eq=False)
class GridPart:
    """Consecutive points of the grid.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    values
        Low-passed, shape (n_channels, n).
    recorded
        On the straight line between the samples before and after, shape (n_channels, n).
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    recorded: NDArray[np.float64]


class UniformResampler:
    """Low-passes a uniform signal and evaluates it at the points of the grid.

    Point ``m`` lies ``m / GRID_HZ`` after the run's first sample. Each point is a weighted mean of
    the samples within half a second of it, so that nothing is delayed.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    cutoff_hz
        Corner of the low-pass [Hz]; lowered where the rate does not allow it.
    """

    def __init__(self, rate_hz: float, cutoff_hz: float) -> None:
        self.rate_hz = rate_hz
        half_s = max(_HALF_S, _HALF_SAMPLES / rate_hz)
        self._at_s = np.linspace(0.0, half_s, _TABLE)
        self._weight = lowpass(corner(cutoff_hz, rate_hz), half_s, self._at_s)
        self._reach = int(np.ceil(half_s * rate_hz))
        self._next = 0  # point of the grid
        self._first = 0  # sample of the run that the buffers begin with
        self._times = np.empty(0, np.int64)
        self._values: NDArray[np.float64] = np.empty((0, 0))

    def __call__(self, times: NDArray[np.int64], values: NDArray[np.float64]) -> GridPart:
        """Take samples, (n,) and (n_channels, n); return the points that are complete by now."""
        if not self._values.shape[0]:
            self._values = values[:, :0]
        self._times = np.concatenate([self._times, times])
        self._values = np.concatenate([self._values, values], axis=1)
        return self._until(self._first + len(self._times) - 1 - self._reach - 1)

    def flush(self) -> GridPart:
        """Return the points up to the last sample."""
        return self._until(self._first + len(self._times) - 1)

    def _until(self, sample: int) -> GridPart:
        """Return the next points that lie at or before a sample of the run."""
        start = self._next
        end = max(start, int(np.floor(sample * GRID_HZ / self.rate_hz + 1e-9)) + 1)
        low, recorded, samples, past = kernels.grid.grid_points(
            self._values,
            self._first,
            start,
            end,
            self.rate_hz / GRID_HZ,
            self.rate_hz,
            self._reach,
            self._at_s,
            self._weight,
        )
        past_ns = np.rint(past * (NS_PER_S / self.rate_hz)).astype(np.int64)
        time_ns = self._times[samples] + past_ns
        self._next = end
        dropped = max(0, int(end * self.rate_hz / GRID_HZ) - self._reach - 1 - self._first)
        self._first += dropped
        self._times = self._times[dropped:]
        self._values = np.ascontiguousarray(self._values[:, dropped:])
        return GridPart(time_ns, low, recorded)


class CentredFilter:
    """A symmetric filter on the grid without delay; the signal is held before and after its ends.

    Parameters
    ----------
    kernel
        Odd number of weights.
    """

    def __init__(self, kernel: NDArray[np.float64]) -> None:
        self.kernel = kernel
        self.reach = len(kernel) // 2
        self._skip = self.reach
        self._past: NDArray[np.float64] = np.empty((0, 0))

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take values, shape (n_channels, n); return those that are complete by now."""
        if not x.shape[1]:
            return x
        if not len(self._past):
            self._past = np.repeat(x[:, :1], len(self.kernel) - 1, axis=1)
        joined = np.concatenate([self._past, x], axis=1)
        self._past = joined[:, x.shape[1] :]
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        return kernels.grid.weighted_sums(np.ascontiguousarray(joined[:, skipped:]), self.kernel)

    def flush(self) -> NDArray[np.float64]:
        """Return what the last values lack."""
        if not len(self._past):
            return np.empty((1, 0))
        return self(np.repeat(self._past[:, -1:], self.reach, axis=1))


class ColumnBuffer:
    """Columns that are kept until nobody needs them, by their place in the run.

    Parameters
    ----------
    rows
        Number of rows.
    """

    def __init__(self, rows: int = 1) -> None:
        self.first = 0
        self.values = np.empty((rows, 0))

    @property
    def end(self) -> int:
        """Place just after the last column."""
        return self.first + self.values.shape[1]

    def add(self, values: NDArray[np.float64]) -> None:
        """Take the next columns, shape (rows, n)."""
        self.values = np.concatenate([self.values, values], axis=1)

    def between(self, start: int, end: int) -> NDArray[np.float64]:
        """Return columns ``[start, end)``, fewer where they are not there."""
        return self.values[:, max(start - self.first, 0) : max(end - self.first, 0)]

    def contiguous(self) -> NDArray[np.float64]:
        """Return all columns, as compiled functions take them."""
        return np.ascontiguousarray(self.values)

    def discard_before(self, index: int) -> None:
        """Drop the columns before a place."""
        cut = min(max(index - self.first, 0), self.values.shape[1])
        self.values, self.first = self.values[:, cut:], self.first + cut
