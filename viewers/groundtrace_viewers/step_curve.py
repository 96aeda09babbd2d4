"""The signal that a step detector decides on, at every sample, with its peaks and valleys."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .curves import Retold
from .detector import decision_gate
from .palette import ACCEPTED, CURVE, REFUSED, THRESHOLD, VALLEY
from .timeline import Entity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.detector import Curve
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import CandidateBlock, Gap, StageSpec
    from groundtrace_codecs.signals import SignalBlock

    from .timeline import Timeline

    #: Where marks lie: times [ns], and values.
    Marks = tuple[list[int], list[float]]

#: Detectors look ahead for less than this; so much of the curve is kept for their candidates.
KEEP_NS = 60 * NS_PER_S
#: A step is timed at most this far from its peak, and a valley lies at most this far from one.
PEAK_NS, VALLEY_NS = NS_PER_S // 4, 6 * NS_PER_S // 5
#: A mark lies on the curve where that comes this close to the value of the candidate.
EXACT = 1e-4


class StepCurve:
    """Logs the curve of one stage on one topic, and its candidates as marks on the curve.

    Steps are timed by what is known of initial contacts, not at their peaks; the marks are at the
    peaks, and at the valleys that the candidates were measured against.

    Parameters
    ----------
    timeline
        Where to.
    session
        Its pipeline says what the stage runs.
    spec
        The stage.
    span_ns
        Over which the threshold is drawn: start and end [ns].
    """

    def __init__(
        self, timeline: Timeline, session: Session, spec: StageSpec, span_ns: tuple[int, int]
    ) -> None:
        self._timeline = timeline
        self._spec = spec
        self._retold = Retold(session, spec)
        self._root = f"/detector/{spec.stage}/{spec.topic.strip('/')}"
        self._times = np.empty(0, np.int64)
        self._values = np.empty(0)
        self._waiting: list[CandidateBlock] = []
        if self.known:
            self._declare(span_ns)

    @property
    def known(self) -> bool:
        """Whether the detector tells its curve."""
        return self._retold.known

    def feed(self, item: SignalBlock | Gap) -> None:
        """Take what the detector is given: a block, or a gap."""
        self._add(self._retold.feed(item))

    def interrupt(self, gap: Gap) -> None:
        """End the curve at a gap that ends the detector's run."""
        self.feed(gap)
        if gap.topic == self._spec.topic and not gap.bridged and len(self._times):
            nothing = np.full((1, 1), np.nan)
            self._timeline.scalars(f"{self._root}/decision", self._times[-1:] + 1, nothing)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        if self.known:
            self._waiting.append(block)

    def flush(self, *, final: bool = False) -> None:
        """Log the candidates that the curve has come past."""
        end_ns = self._times[-1] - VALLEY_NS if len(self._times) else 0
        ready = [b for b in self._waiting if final or b.time_ns[-1] <= end_ns]
        self._waiting = self._waiting[len(ready) :]
        for block in ready:
            self._mark(block)
        if len(self._times):
            kept = self._times > self._times[-1] - KEEP_NS
            self._times, self._values = self._times[kept], self._values[kept]

    def close(self) -> None:
        """Log what was held back."""
        self._add(self._retold.finish())
        self.flush(final=True)

    def _add(self, curve: Curve | None) -> None:
        if curve is None:
            return
        self._timeline.scalars(f"{self._root}/decision", curve.time_ns, curve.value)
        self._times = np.concatenate([self._times, curve.time_ns])
        self._values = np.concatenate([self._values, curve.value[:, 0]])

    def _mark(self, block: CandidateBlock) -> None:
        for verdict, rows in (("accepted", block.accepted), ("rejected", ~block.accepted)):
            peaks: Marks = ([], [])
            valleys: Marks = ([], [])
            for row in np.flatnonzero(rows):
                self._place(block, int(row), peaks, valleys)
            for what, (times, values) in (("peak", peaks), ("valley", valleys)):
                if times:
                    path = f"{self._root}/{verdict}/{what}"
                    self._timeline.scalars(path, times, np.array(values)[:, np.newaxis])

    def _place(self, block: CandidateBlock, row: int, peaks: Marks, valleys: Marks) -> None:
        """Find a candidate's peak on the curve, and the valley before or after it."""
        measured = dict(
            zip((q.name for q in block.spec.columns), block.value[row].tolist(), strict=True)
        )
        time_ns, height = int(block.time_ns[row]), float(block.value[row, 0])
        peak_ns = self._on_curve(time_ns - PEAK_NS, time_ns + PEAK_NS, height) or time_ns
        peaks[0].append(peak_ns)
        peaks[1].append(height)
        if "depth" in measured:
            low = -measured["depth"]
        elif "swing" in measured:
            low = height - measured["swing"]
        else:
            return
        # of the valleys before and after it, the one that was measured is met exactly
        valley_ns = self._on_curve(peak_ns - VALLEY_NS, peak_ns + VALLEY_NS, low)
        if valley_ns is not None:
            valleys[0].append(valley_ns)
            valleys[1].append(low)

    def _on_curve(self, start_ns: int, end_ns: int, value: float) -> int | None:
        """Return when the curve has a value within a span; None where it does not come close."""
        first, last = np.searchsorted(self._times, [start_ns, end_ns + 1])
        if first >= last:
            return None
        off: NDArray[np.float64] = np.abs(self._values[first:last] - value)
        nearest = int(np.argmin(off))
        close = off[nearest] <= EXACT * max(1.0, abs(value))
        return int(self._times[first + nearest]) if close else None

    def _declare(self, span_ns: tuple[int, int]) -> None:
        import rerun as rr

        spec, decision = self._spec, self._spec.trace[0]
        gate = decision_gate(spec)
        gate = gate if gate is not None and gate.name == decision.name else None
        unit = f" [{decision.unit.replace('s2', 's²')}]" if decision.unit not in ("", "1") else ""
        limit = f", threshold {gate.threshold:g} in red" if gate else ""
        title = f"{spec.stage} {spec.topic}: filtered, every sample{unit}; peaks and valleys{limit}"
        lines = rr.SeriesLines(
            names="filtered",
            colors=np.array([CURVE], np.uint32),
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        self._timeline.declare(Entity(f"{self._root}/decision", "detector", title), lines)
        if gate is not None:
            style = rr.SeriesLines(names="threshold", colors=np.array([THRESHOLD], np.uint32))
            self._timeline.static(f"{self._root}/threshold", style)
            level = np.full((2, 1), gate.threshold)
            self._timeline.scalars(f"{self._root}/threshold", span_ns, level)
        self._declare_marks()

    def _declare_marks(self) -> None:
        import rerun as rr

        shapes = rr.components.MarkerShape
        for path, colour, marker, size in (
            ("rejected/valley", REFUSED, shapes.Cross, 2.5),
            ("rejected/peak", REFUSED, shapes.Cross, 4.0),
            ("accepted/valley", VALLEY, shapes.Up, 3.5),
            ("accepted/peak", ACCEPTED, shapes.Down, 5.0),
        ):
            verdict, what = path.split("/")
            style = rr.SeriesPoints(
                names=f"{what}, {verdict}",
                colors=np.array([colour], np.uint32),
                markers=marker,
                marker_sizes=size,
            )
            self._timeline.static(f"{self._root}/{path}", style)
