"""The last samples of a run, in lanes, and the times of its samples."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np

from ..lanes import LANES, zero_rows
from .cell_kernels import times_of
from .open_cell_kernels import load

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock


class SampleClock:
    """Times of a run's samples by their index from its first block on.

    The anchor of the times may move from block to block: the source follows small steps of a clock.

    Attributes
    ----------
    table
        Anchors, as :func:`~groundtrace.detectors.cell_kernels.times_of` takes them.
    """

    def __init__(self) -> None:
        self._count = 0
        self._period_ns = 0.0
        self._starts = [0]  # index from which an anchor holds
        self._anchors = [(0, 0)]  # time of the anchor, and which index before ours it counts from
        self.table = np.zeros((1, 3), np.int64)  # both, for compiled functions

    def add(self, block: SignalBlock) -> None:
        """Count in a block of the run."""
        anchor = (block.anchor_ns, block.first - self._count)
        self._period_ns = block.stream.period_ns
        if not self._count or self._anchors[-1] != anchor:
            kept = len(self._anchors) if self._count else 0
            self._starts[kept:], self._anchors[kept:] = [self._count], [anchor]
            self._tabulate()
        self._count += len(block)

    def at(self, index: NDArray[np.intp]) -> NDArray[np.int64]:
        """Return the times of samples [ns], shape (n,), as their blocks have them."""
        return times_of(np.asarray(index, np.intp), self.table, self._period_ns)

    def time_of(self, index: int) -> int:
        """Return the time of one sample [ns]."""
        anchor = self._anchors[max(0, bisect_right(self._starts, index) - 1)]
        return anchor[0] + round((index + anchor[1]) * self._period_ns)

    def forget_before(self, index: int) -> None:
        """Forget anchors of samples before one."""
        while len(self._starts) > 1 and self._starts[1] <= index:
            del self._starts[0], self._anchors[0]
            self._tabulate()

    def _tabulate(self) -> None:
        rows = [(start, *anchor) for start, anchor in zip(self._starts, self._anchors, strict=True)]
        self.table = np.array(rows, np.int64)


class LaneHistory:
    """The last samples of a few signals, by their index in the run; the memory is used again.

    Parameters
    ----------
    signals
        How many signals each channel has.
    channels
        Number of channels.

    Attributes
    ----------
    first, end
        Index of the first sample kept, and just after the last.
    """

    def __init__(self, signals: int, channels: int) -> None:
        self.first = 0
        self.end = 0
        self._begin = 0  # row of the first sample kept
        groups = -(-channels // LANES)
        self._rows = zero_rows(signals, groups, 0)

    def extend(self, samples: int) -> None:
        """Make room for some more samples; they are written by :meth:`recent`."""
        kept = self.end - self.first
        if self._begin + kept + samples > self._rows.shape[2]:
            signals, groups, room, _ = self._rows.shape
            # little more than a block stays near in the caches, and yet what is kept moves seldom;
            # with a row to spare no view of several groups is contiguous: one type to compile for
            wanted = max(room, 4 * kept + samples + 1)
            rows = self._rows if wanted == room else zero_rows(signals, groups, wanted)
            rows[:, :, :kept] = self._rows[:, :, self._begin : self._begin + kept]
            self._rows, self._begin = rows, 0
        self.end += samples

    def append(self, *signals: NDArray[np.float64]) -> None:
        """Take samples of every signal, each (n_channels, n)."""
        n = signals[0].shape[1]
        self.extend(n)
        for index, signal in enumerate(signals):
            for group, rows in enumerate(self.recent(n, index)):
                load(np.ascontiguousarray(signal), group * LANES, 0, rows)

    def recent(self, samples: int, signal: int = 0) -> NDArray[np.float64]:
        """Return the last samples of a signal, shape (n_groups, n, LANES): a view."""
        stop = self._begin + self.end - self.first
        return self._rows[signal, :, stop - samples : stop]

    def rows(self, signal: int = 0) -> NDArray[np.float64]:
        """Return what is kept of a signal, shape (n_groups, n, LANES): a view."""
        return self._rows[signal, :, self._begin : self._begin + self.end - self.first]

    def between(self, start: int, stop: int, signal: int = 0) -> NDArray[np.float64]:
        """Return samples ``[start, stop)`` of a signal, shape (n_groups, n, LANES): a view.

        What was dropped is there until more samples come.
        """
        begin = self._begin + start - self.first
        return self._rows[signal, :, begin : begin + stop - start]

    def drop_before(self, index: int) -> None:
        """Drop the samples before one; they are there until more samples come."""
        cut = max(0, index - self.first)
        self.first += cut
        self._begin += cut
