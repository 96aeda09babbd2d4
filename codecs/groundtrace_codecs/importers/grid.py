"""Sample times: is there a uniform grid behind them, and which contiguous runs it has."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..mcap.set_backs import set_backs
from ..signals import NS_PER_S, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

#: A grid holds where no sample lies further from it than this part of a period ...
_JITTER = 0.01
#: ... or than this part of the step the times were rounded to (a bit over one half).
_ROUNDING = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """When the samples of one stream were taken.

    Attributes
    ----------
    rate_hz
        Of the grid; of an irregular stream the inverse of the median interval.
    anchor_ns
        Time of the first sample [ns].
    index
        Shape (n,), int64: place of each sample on the grid; None where there is no grid.
    times_ns
        Shape (n,), int64: the samples' own times; None where the grid holds.
    set_back
        Where the clock was set back: the first sample after it, and the sum of it and all before
        [ns], which the samples from there on are earlier than their place on the grid says.
    """

    rate_hz: float
    anchor_ns: int
    index: NDArray[np.int64] | None
    times_ns: NDArray[np.int64] | None
    set_back: tuple[tuple[int, int], ...] = ()

    def shifted(self, by_ns: int) -> Timing:
        """Return the same timing ``by_ns`` later."""
        times = None if self.times_ns is None else self.times_ns + by_ns
        return replace(self, anchor_ns=self.anchor_ns + by_ns, times_ns=times)

    def sample_times(self) -> NDArray[np.int64]:
        """Return the time of every sample [ns], shape (n,)."""
        if self.index is None:
            assert self.times_ns is not None
            return self.times_ns
        period_ns = NS_PER_S / self.rate_hz
        times: NDArray[np.int64] = np.rint(self.index * period_ns).astype(np.int64)
        return times + self.anchor_ns - earlier_by(self.set_back, len(times))

    def runs(self) -> list[slice]:
        """Return the contiguous runs: cut at gaps and where time does not go on."""
        if self.index is not None:
            holes = np.flatnonzero(np.diff(self.index) != 1) + 1
            breaks = np.union1d(holes, [at for at, _ in self.set_back]).astype(np.int64)
        else:
            breaks = np.flatnonzero(np.diff(self.sample_times()) < 0) + 1
        edges = [0, *breaks.tolist(), len(self.sample_times())]
        return [slice(a, b) for a, b in pairwise(edges)]

    def blocks(self, stream: Stream, samples: NDArray[Any]) -> Iterator[SignalBlock]:
        """Yield each contiguous run of ``samples``, shape (n, n_channels), as a block."""
        for run in self.runs():
            first = run.start if self.index is None else int(self.index[run.start])
            times = None if self.times_ns is None else self.times_ns[run]
            back_ns = 0 if times is not None else sum_before(self.set_back, run.start)
            yield SignalBlock(stream, self.anchor_ns - back_ns, first, samples[run], times)


def earlier_by(set_back: Sequence[tuple[int, int]], count: int) -> NDArray[np.int64]:
    """Return by how much a clock is set back at each of so many samples [ns], shape (count,)."""
    earlier_ns = np.zeros(count, np.int64)
    for at, sum_ns in set_back:
        earlier_ns[at:] = sum_ns
    return earlier_ns


def set_back_lines(set_back: Sequence[tuple[int, int]]) -> list[str]:
    """Return what a person should know of each step of a clock."""
    before_ns = [0, *(sum_ns for _, sum_ns in set_back)]
    return [
        f"the clock was set back by {(sum_ns - before) / NS_PER_S:.3f} s at sample {at + 1}: what "
        f"follows is a segment of its own, and its times come twice"
        for (at, sum_ns), before in zip(set_back, before_ns, strict=False)
    ]


def sum_before(set_back: Sequence[tuple[int, int]], at: int) -> int:
    """Return by how much a clock is set back at a sample [ns]."""
    return max((sum_ns for first, sum_ns in set_back if first <= at), default=0)


def uniform(count: int, rate_hz: float, start_ns: int = 0) -> Timing:
    """Return the timing of ``count`` samples without a break."""
    return Timing(rate_hz, start_ns, np.arange(count, dtype=np.int64), None)


def even(times_ns: NDArray[np.int64]) -> Timing:
    """Return a timing with the samples evenly between the first and the last time."""
    rate_hz = (len(times_ns) - 1) * NS_PER_S / float(times_ns[-1] - times_ns[0])
    return uniform(len(times_ns), rate_hz, int(times_ns[0]))


def fit(times_ns: NDArray[np.int64]) -> Timing:
    """Return the timing behind ``times_ns``: a grid where one holds, else the times themselves.

    A grid holds where every time lies on it within 1 % of a period, or within half of the step
    the times were rounded to. Missing samples leave holes in the grid. Where a clock was set back,
    the grid goes on as if it had not been.

    Parameters
    ----------
    times_ns
        Shape (n,), n >= 2, at least two of them different.
    """
    if back := tuple(set_backs(times_ns)):
        on = fit(times_ns + earlier_by(back, len(times_ns)))
        return replace(on, times_ns=None if on.times_ns is None else times_ns, set_back=back)
    steps = np.diff(times_ns)
    median = float(np.median(steps[steps > 0]))
    places = np.concatenate(([0.0], np.cumsum(np.rint(steps / median))))
    relative = (times_ns - times_ns[0]).astype(np.float64)
    tolerance = max(_JITTER * median, min(_ROUNDING * float(np.gcd.reduce(steps)), 0.25 * median))
    for period, offset in _periods(relative, places, median):
        index = np.rint((relative - offset) / period)
        if index.min() < 0 or np.abs(relative - offset - index * period).max() > tolerance:
            continue
        first = int(index[0])
        anchor_ns = int(times_ns[0]) + round(offset)
        index = index.astype(np.int64) - first
        return Timing(NS_PER_S / period, anchor_ns, index, None)
    return Timing(NS_PER_S / median, int(times_ns[0]), None, times_ns)


def _periods(
    relative: NDArray[np.float64], places: NDArray[np.float64], median: float
) -> Iterator[tuple[float, float]]:
    """Yield (period, offset) [ns] to try: a whole rate, a whole period, the best line."""
    rate = round(NS_PER_S / median)
    if rate:
        yield NS_PER_S / rate, 0.0
    yield median, 0.0
    spread = places - places.mean()
    if spread.any():
        slope = float(spread @ relative / (spread @ spread))
        if slope > 0:
            yield slope, float(relative.mean() - slope * places.mean())
