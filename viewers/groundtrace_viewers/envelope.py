"""Envelope for the overview: the largest magnitude per bucket, whatever the blocks' bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

    Piece = tuple[NDArray[np.int64], NDArray[np.float64]]


class Envelope:
    """Reduces blocks of a uniform stream to max |x| per bucket.

    Bucket ``k`` of a contiguous run holds samples ``[k * factor, (k + 1) * factor)`` of the run, so
    the result does not depend on how the run was cut into blocks. A bucket lies at the time of its
    first sample.

    Parameters
    ----------
    factor
        Samples per bucket.
    """

    def __init__(self, factor: int) -> None:
        self._factor = factor
        self._anchor_ns: int | None = None
        self._period_ns = 0.0
        self._bucket = 0
        self._peak: NDArray[np.float64] | None = None

    def push(self, block: SignalBlock, values: NDArray[np.float64]) -> Piece:
        """Take a block and return the buckets it completes.

        Parameters
        ----------
        block
            Gives the samples' place in their run.
        values
            Its values, shape (n, n_channels).

        Returns
        -------
        times_ns, peaks
            Shape (m,) and (m, n_channels).
        """
        before = [] if block.anchor_ns == self._anchor_ns else [self.flush()]
        self._anchor_ns, self._period_ns = block.anchor_ns, block.stream.period_ns
        bucket = np.arange(block.first, block.first + len(block)) // self._factor
        starts = np.flatnonzero(np.diff(bucket, prepend=bucket[0] - 1))
        peaks = np.maximum.reduceat(np.abs(values), starts, axis=0)
        index = bucket[starts]
        if self._peak is not None:
            if index[0] == self._bucket:
                peaks[0] = np.maximum(peaks[0], self._peak)
            else:
                before.append(self._emit(np.array([self._bucket]), self._peak[np.newaxis]))
        self._bucket, self._peak = int(index[-1]), peaks[-1]
        parts = [*before, self._emit(index[:-1], peaks[:-1])]
        filled = [p for p in parts if len(p[0])] or parts[-1:]
        return np.concatenate([p[0] for p in filled]), np.concatenate([p[1] for p in filled])

    def flush(self) -> Piece:
        """Return the last, unfinished bucket, if any."""
        if self._peak is None:
            return np.empty(0, np.int64), np.empty((0, 0))
        piece = self._emit(np.array([self._bucket]), self._peak[np.newaxis])
        self._peak = None
        return piece

    def _emit(self, bucket: NDArray[np.int64], peaks: NDArray[np.float64]) -> Piece:
        first = bucket * self._factor * self._period_ns
        return (self._anchor_ns or 0) + np.rint(first).astype(np.int64), peaks
