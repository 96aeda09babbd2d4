"""The samples of a foot in segments of equal length, and whether the foot stands still in each.

The statistic is that of :mod:`groundtrace.detectors.zupt`; its window is centred, so the samples
wait for half a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.zupt import RecentPeak, ZeroVelocityStatistic

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..detectors.zupt import ZeroVelocityParameters

    Array = NDArray[np.float64]

#: Length of a segment [s]; at low rates it is one sample.
SEGMENT_S = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Consecutive samples, with the last one before them.

    Attributes
    ----------
    time_ns
        Of its last sample.
    interval_s
        Times between the samples, shape (n,) [s].
    rate, force
        Shape (n + 1, 3) [rad/s], [m/s2].
    field
        Mean magnetic field, shape (3,) [T]; NaN where the stream has none.
    statistic, peak
        Largest of the zero-velocity statistic in it, and in the stride that ends with it.
    length_s
        How long it lasts [s].
    """

    time_ns: int
    interval_s: Array
    rate: Array
    force: Array
    field: Array
    statistic: float
    peak: float
    length_s: float


@dataclass(frozen=True, slots=True, eq=False)
class SegmentRun(Sequence[Segment]):
    """Consecutive segments of equal length in columns.

    Attributes
    ----------
    time_ns, interval_s, field, statistic, peak, length_s
        Of each, shapes (n,), (n, m), (n, 3), (n,), (n,), (n,), as those of a segment.
    rate, force
        Of all samples, shape (n * m + 1, 3) [rad/s], [m/s2]: neighbours share one.
    """

    time_ns: NDArray[np.int64]
    interval_s: Array
    rate: Array
    force: Array
    field: Array
    statistic: Array
    peak: Array
    length_s: Array

    def __len__(self) -> int:
        return len(self.time_ns)

    @overload
    def __getitem__(self, index: int) -> Segment: ...

    @overload
    def __getitem__(self, index: slice) -> list[Segment]: ...

    def __getitem__(self, index: int | slice) -> Segment | list[Segment]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place, samples = range(len(self))[index], self.interval_s.shape[1]
        both = slice(place * samples, (place + 1) * samples + 1)
        return Segment(
            int(self.time_ns[place]),
            self.interval_s[place],
            self.rate[both],
            self.force[both],
            self.field[place],
            float(self.statistic[place]),
            float(self.peak[place]),
            float(self.length_s[place]),
        )


class Segments:
    """Cuts blocks of any length into segments, counted from the run's first sample.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    parameters
        Of the statistic, and the length of a stride.
    """

    def __init__(self, rate_hz: float, parameters: ZeroVelocityParameters) -> None:
        self._peak = RecentPeak(rate_hz, parameters.stride_s)
        self._statistic = ZeroVelocityStatistic(rate_hz, parameters)
        self._length = max(1, round(SEGMENT_S * rate_hz))
        self._late = round(self._statistic.delay_ns * rate_hz / NS_PER_S)
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((0, 9))
        self._values = np.empty((0, 2))
        self._skip = self._late

    def add(self, times: NDArray[np.int64], samples: Array) -> SegmentRun:
        """Take samples, shapes (n,) and (n, 9); return the segments that are complete by now.

        The columns are rate [rad/s], force [m/s2] and field [T], NaN where there is none.
        """
        statistic = self._statistic(samples[:, 3:6].T.copy(), samples[:, :3].T.copy())
        values = np.stack([statistic, self._peak(statistic)], axis=1)
        skipped = min(self._skip, len(values))
        self._skip -= skipped
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, samples])
        self._values = np.concatenate([self._values, values[skipped:]])
        return self._cut(self._length)

    def finish(self) -> list[SegmentRun]:
        """Return what is left; the statistic of the last samples is that of the last window.

        The last segment may be shorter than the others.
        """
        lacking = len(self._times) - len(self._values)
        if not (lacking and len(self._values)):
            return []
        self._values = np.pad(self._values, ((0, lacking), (0, 0)), mode="edge")
        whole = self._cut(self._length)
        left = len(self._times) - 1
        return [whole, self._cut(left)] if left > 0 else [whole]

    def _cut(self, length: int) -> SegmentRun:
        """Return all whole segments; the sample that ends one also begins the next."""
        count = max(0, len(self._values) - 1) // length
        end = count * length
        times, values = self._times[: end + 1], self._values[: end + 1]
        intervals = (np.diff(times) / NS_PER_S).reshape(count, length)
        inner = self._samples[1 : end + 1, 6:].reshape(count, length, 3)
        statistic = values[1:, 0].reshape(count, length).max(axis=1, initial=0.0)
        # each contiguous, as compiled functions take them
        rate, force = (np.ascontiguousarray(self._samples[: end + 1, k : k + 3]) for k in (0, 3))
        self._times, self._samples = self._times[end:], self._samples[end:]
        self._values = self._values[end:]
        return SegmentRun(
            times[length::length],
            intervals,
            rate,
            force,
            inner.mean(axis=1),
            # of both its ends, the first of which is the last of the segment before
            np.maximum(statistic, values[:end:length, 0]),
            np.ascontiguousarray(values[length::length, 1]),
            intervals.sum(axis=1),
        )
