"""Signals on the timeline: envelopes for the overview, and samples at full rate where asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .envelope import EnvelopeLog
from .full_rate import FULL_RATE_HZ, enveloped
from .signal_curves import CurveStyles, curves_of, entity_path, has_norm

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

    from .full_rate import Plan
    from .palette import SensorColours
    from .signal_curves import Curves, Role
    from .timeline import Timeline

#: Envelopes: the finest, and for a recording that is longer than the viewer shows at first those of
#: what it shows, and of all of it.
ENVELOPE_HZ, OVERVIEW_HZ, WHOLE_HZ = 100.0, 20.0, 2.0
IN_VIEW_NS = 60 * NS_PER_S
#: A chunk of a fast stream lasts this long: about 2 MB, which the viewer reads best.
CHUNK_S = 1.0
SLOW_CHUNK_S = 10.0
#: Periods without samples that end a curve of a stream whose samples come at their own times.
IRREGULAR_PERIODS = 20.0


class SignalLog:
    """Logs the blocks of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        What the blocks hold.
    colours
        Of the sensors.
    plan
        What is shown at full rate.
    chunk_s
        Duration of a chunk [s]; None chooses by the rate.
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        colours: SensorColours,
        plan: Plan,
        chunk_s: float | None = None,
    ) -> None:
        fast = stream.rate_hz > FULL_RATE_HZ
        seconds = chunk_s or (CHUNK_S if fast else SLOW_CHUNK_S)
        self._timeline = timeline
        self._stream = stream
        self._plan = plan
        self._rows = max(1, round(seconds * stream.rate_hz))
        self._curves = curves_of(stream)
        self._styles = CurveStyles(stream, colours)
        self._levels = [
            EnvelopeLog(
                timeline, stream, curves, self._styles, role, 1.0 / rate_hz, chunk_s or SLOW_CHUNK_S
            )
            for curves in self._curves
            if enveloped(stream, curves.quantity)
            for role, rate_hz in envelopes_of(plan)
        ]
        self._times: list[NDArray[np.int64]] = []
        self._values: list[NDArray[np.float64]] = []
        self._pending = 0
        self._end_ns: int | None = None
        self._patience_ns = stream.period_ns * (IRREGULAR_PERIODS if stream.irregular else 1.0)
        for curves in self._curves:
            if plan.whole or not enveloped(stream, curves.quantity):
                self._declare(curves)

    def _declare(self, curves: Curves) -> None:
        around = f" around {self._plan.subject}" if self._plan.close_ups else ""
        where = around if enveloped(self._stream, curves.quantity) else ""
        self._timeline.declare(*self._styles.samples(curves, where))
        if has_norm(curves):
            self._timeline.declare(*self._styles.norm(curves))

    def write(self, block: SignalBlock) -> None:
        """Take a block."""
        start = 0
        while start < len(block):
            stop = min(len(block), start + self._rows - self._pending)
            self._take(block.slice(start, stop))
            start = stop

    def close_up(self, pieces: Iterable[tuple[NDArray[np.int64], NDArray[np.float64]]]) -> None:
        """Log samples that were asked for later: times [ns], and values, shape (n, n_channels)."""
        known = list(pieces)
        if not known:
            return
        times = np.concatenate([piece[0] for piece in known])
        values = np.concatenate([piece[1] for piece in known])
        if not len(times):
            return
        # the viewer would draw a line to the next
        times = np.append(times, times[-1] + 1)
        values = np.vstack([values, np.full((1, values.shape[1]), np.nan)])
        for curves in self._curves:
            if enveloped(self._stream, curves.quantity):
                self._declare(curves)
                self._log(curves, times, values)

    def _take(self, block: SignalBlock) -> None:
        values = block.values
        if self._end_ns is not None and block.start_ns - self._end_ns > self._patience_ns:
            self._break(self._end_ns)
        self._end_ns = block.end_ns
        self._times.append(block.sample_times())
        self._values.append(values)
        self._pending += len(block)
        for level in self._levels:
            level.push(block, values)
        if self._pending >= self._rows:
            self.flush()

    def _break(self, end_ns: int) -> None:
        """End the curves at an interruption: the viewer would draw a line across it."""
        self._times.append(np.array([end_ns]))
        self._values.append(np.full((1, len(self._stream.channels)), np.nan))
        self._pending += 1
        for level in self._levels:
            level.end(end_ns)

    def flush(self) -> None:
        """Log what is pending, of fast curves what lies in the span that is shown."""
        if not self._pending:
            return
        times, values = np.concatenate(self._times), np.concatenate(self._values)
        self._times, self._values, self._pending = [], [], 0
        first, last = np.searchsorted(times, self._plan.span_ns)
        for curves in self._curves:
            if not enveloped(self._stream, curves.quantity):
                self._log(curves, times, values)
            elif first < last:
                self._declare(curves)
                self._log(curves, times[first:last], values[first:last])

    def _log(self, curves: Curves, times: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        shown = values[:, curves.columns] * curves.factor
        self._timeline.scalars(entity_path("signal", curves), times, shown)
        if has_norm(curves):
            norm = np.linalg.norm(shown, axis=1, keepdims=True)
            self._timeline.scalars(entity_path("norm", curves), times, norm)

    def close(self) -> None:
        """Log what is pending and the envelopes' last buckets."""
        self.flush()
        for level in self._levels:
            level.close()


def envelopes_of(plan: Plan) -> list[tuple[Role, float]]:
    """Return the envelopes that fast signals have: role, and buckets a second."""
    long = plan.duration_ns > IN_VIEW_NS
    finest: list[tuple[Role, float]] = [("envelope", ENVELOPE_HZ)]
    return [("overview", OVERVIEW_HZ), *finest, ("whole", WHOLE_HZ)] if long else finest
