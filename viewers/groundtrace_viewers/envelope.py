"""Envelope for the overview: the largest magnitude per bucket, whatever the blocks' bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .signal_curves import entity_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

    from .signal_curves import Curves, CurveStyles, Role
    from .timeline import Timeline

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
        index = np.arange(
            block.first // self._factor, -(-(block.first + len(block)) // self._factor)
        )
        starts = np.maximum(index * self._factor - block.first, 0)
        peaks = np.maximum.reduceat(np.abs(values), starts, axis=0)
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


class EnvelopeLog:
    """Logs the envelope of the curves of a plot.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the curves.
    curves
        The plot.
    styles
        How it is drawn.
    role
        What it is for: ``envelope`` or ``whole``.
    bucket_s
        Length of a bucket [s].
    chunk_s
        Duration of a chunk [s].
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        curves: Curves,
        styles: CurveStyles,
        role: Role,
        bucket_s: float,
        chunk_s: float,
    ) -> None:
        self._timeline = timeline
        self._curves = curves
        self._pending: list[Piece] = []
        self._rows = 0
        self._most = max(1, round(chunk_s / bucket_s))
        self._path = entity_path(role, curves)
        self._envelope = Envelope(max(1, round(stream.rate_hz * bucket_s)))
        timeline.declare(*styles.envelope(curves, role, bucket_s))

    def push(self, block: SignalBlock, values: NDArray[np.float64]) -> None:
        """Take a block and its values, shape (n, n_channels)."""
        columns = self._curves.columns
        own = values if len(columns) == values.shape[1] else values[:, columns]
        self._take(self._envelope.push(block, own))
        if self._rows >= self._most:
            self._log()

    def end(self, end_ns: int) -> None:
        """End the curves at an interruption: the viewer would draw a line across it."""
        self._take(self._envelope.flush())
        self._take((np.array([end_ns]), np.full((1, len(self._curves.columns)), np.nan)))

    def close(self) -> None:
        """Log what is pending and the last bucket."""
        self._take(self._envelope.flush())
        self._log()

    def _take(self, piece: Piece) -> None:
        if len(piece[0]):
            self._pending.append(piece)
            self._rows += len(piece[0])

    def _log(self) -> None:
        if self._pending:
            times = np.concatenate([piece[0] for piece in self._pending])
            peaks = np.concatenate([piece[1] for piece in self._pending])
            self._timeline.scalars(self._path, times, peaks * self._curves.factor)
        self._pending, self._rows = [], 0
