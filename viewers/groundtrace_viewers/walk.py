"""What is shown of a walker: the detectors' signals, masses, headings, and the map."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from groundtrace_codecs.events import Disturbance, Heading, TrackPoint

from .azimuths import AzimuthLog
from .details import Details
from .detector import step_like
from .headings import HeadingLog
from .masses import MassLog
from .step_curve import StepCurve
from .street_map import StreetMap
from .walk_map import WalkMap

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import CandidateBlock, Gap, StageSpec
    from groundtrace_codecs.signals import SignalBlock

    from .details import Views
    from .sensor_map import Bounds
    from .timeline import Timeline


class Walk(Details):
    """Logs everything that is particular to walkers.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    tiles
        Whether a street map is asked for.
    """

    def __init__(self, timeline: Timeline, session: Session, *, tiles: bool = False) -> None:
        self._timeline = timeline
        self._session = session
        self._curves: dict[tuple[str, str], StepCurve] = {}
        self._masses: dict[tuple[str, str], MassLog] = {}
        self._last: dict[str, SignalBlock] = {}  # of each topic: a stage is told after its first
        self._headings = HeadingLog(timeline, session.labels)
        self._azimuths = AzimuthLog(timeline)
        walker = session.application == "walker"
        self._map = WalkMap(timeline, session) if walker else None
        self._streets = StreetMap(timeline, session) if walker and tiles else None

    @property
    def bounds(self) -> Bounds | None:
        """What the map must show; None without one."""
        return self._map.bounds if self._map is not None else None

    def stage(self, spec: StageSpec, colour: int) -> None:  # noqa: ARG002
        """Take a stage."""
        session, key = self._session, (spec.stage, spec.topic)
        span_ns = session.shown_ns or (session.start_ns, session.end_ns)
        if step_like(spec) and spec.trace and key not in self._curves:
            curve = StepCurve(self._timeline, session, spec, span_ns)
            if curve.known:
                self._curves[key] = curve
                if spec.topic in self._last:
                    curve.feed(self._last[spec.topic])
        if MassLog.fits(spec) and key not in self._masses:
            self._masses[key] = MassLog(self._timeline, spec, span_ns)

    def draws(self, spec: StageSpec) -> bool:
        """Whether a stage's decision function is drawn at every sample."""
        return (spec.stage, spec.topic) in self._curves

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        self._last[block.topic] = block
        for curve in self._curves.values():
            curve.feed(block)
        if self._map is not None:
            self._map.signal(block)
        if self._streets is not None:
            self._streets.signal(block)

    def gap(self, gap: Gap) -> None:
        """Take a gap."""
        for curve in self._curves.values():
            curve.interrupt(gap)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        key = (block.spec.stage, block.spec.topic)
        if key in self._curves:
            self._curves[key].candidates(block)
        if key in self._masses:
            self._masses[key].candidates(block)
        self._headings.frames(block)
        self._azimuths.candidates(block)

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        if self._map is not None:
            self._map.add(point)
        if self._streets is not None:
            self._streets.track(point)

    def heading(self, heading: Heading) -> None:
        """Take a heading."""
        self._headings.heading(heading)

    def disturbance(self, span: Disturbance) -> None:
        """Take a span in which headings are disturbed."""
        self._headings.disturbance(span)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        for curve in self._curves.values():
            curve.flush()
        self._headings.flush()
        self._azimuths.flush()
        if self._map is not None:
            self._map.flush()

    def close(self) -> None:
        """Log what was held back."""
        for curve in self._curves.values():
            curve.close()
        self._headings.close()
        self._azimuths.flush()
        if self._map is not None:
            self._map.close()
        if self._streets is not None:
            self._streets.close()

    views: ClassVar[Views] = {TrackPoint: track, Heading: heading, Disturbance: disturbance}
