"""Power per channel and working cycle, in a band.

Source: the paper, equation (6). Cycles lie on multiples of their length on the recording's clock,
so that those of several recorders begin together, whenever each was switched on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.filters import StreamingFilter, bandpass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Standard deviation of a power over its mean, from the paper's experiments.
RELATIVE_SIGMA = 1 / 3
#: A cycle counts from this part of its samples on, at the ends of a run.
_LEAST_PART = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class CyclePowers:
    """Powers of whole cycles.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: middle of each cycle.
    power
        Shape (n_channels, n): mean squares [unit^2], (6).
    freedom
        Shape (n_channels, n): degrees of freedom of each, 2 B T: the variance of a power P of
        Gaussian noise is 2 P^2 / freedom.
    """

    time_ns: NDArray[np.int64]
    power: Array
    freedom: Array


def degrees_of_freedom(samples: Array) -> Array:
    """Return the effective degrees of freedom of the mean square of each row.

    2 B T with B the bandwidth (int S)^2 / int S^2 of the spectrum S. Of n even lines of noise the
    periodogram has sum I^2 / (sum I)^2 = 2 / (n + 1) in the mean, so that the inverse of what is
    returned has no bias.

    Parameters
    ----------
    samples
        Shape (n_channels, n), n at least 4.

    Returns
    -------
    Shape (n_channels,), at least 1 and at most n; 2 for a single line.
    """
    periodogram = np.abs(np.fft.rfft(samples, axis=1)) ** 2
    total, square = periodogram.sum(axis=1), (periodogram**2).sum(axis=1)
    n = samples.shape[1]
    ratio = np.divide(total**2, square, out=np.full(len(total), float(n)), where=square > 0)
    return np.asarray(np.clip(4 * ratio - 2, 1.0, n))


class CyclePower:
    """Filters samples, and cuts them into cycles.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    channels
        Number of channels.
    cycle_s
        Length of a cycle [s].
    low_hz, high_hz
        Band [Hz]; 0 leaves an edge out, as does an upper one beyond the rate's reach.
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        cycle_s: float = 1.0,
        low_hz: float = 5.0,
        high_hz: float = 40.0,
    ) -> None:
        self.cycle_ns = round(cycle_s * NS_PER_S)
        self._least = max(4, round(_LEAST_PART * cycle_s * rate_hz))
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=4))
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((channels, 0))

    def add(self, times: NDArray[np.int64], x: Array) -> CyclePowers:
        """Take samples, shapes (n,) and (n_channels, n); return the cycles they complete."""
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, self._filter(x)], axis=1)
        return self._cut(open_end=True)

    def finish(self) -> CyclePowers:
        """Return the last cycle, if there is half of it; then start anew."""
        found = self._cut(open_end=False)
        self._filter.zi = None
        self._times, self._samples = self._times[:0], self._samples[:, :0]
        return found

    def _cut(self, open_end: bool) -> CyclePowers:
        number = self._times // self.cycle_ns
        edges = np.flatnonzero(np.diff(number)) + 1
        if not open_end and len(number):
            edges = np.append(edges, len(number))
        starts = np.concatenate([[0], edges[:-1]]).astype(np.intp)
        spans = [(a, b) for a, b in zip(starts, edges, strict=False) if b - a >= self._least]
        middles = np.array([number[a] for a, _ in spans], np.int64) * self.cycle_ns
        rows = [self._samples[:, a:b] for a, b in spans]
        shape = (len(self._samples), len(rows))
        power, freedom = np.empty(shape), np.empty(shape)
        for column, row in enumerate(rows):
            power[:, column] = np.mean(row**2, axis=1)
            freedom[:, column] = degrees_of_freedom(row)
        done = int(edges[-1]) if len(edges) else 0
        self._times, self._samples = self._times[done:], self._samples[:, done:]
        return CyclePowers(middles + self.cycle_ns // 2, power, freedom)
