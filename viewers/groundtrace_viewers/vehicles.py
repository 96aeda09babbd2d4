"""What is shown of vehicles: likelihood, courses, ratios, passes and the way along the road."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from groundtrace_codecs.events import (
    LikelihoodSurface,
    LineCrossing,
    Pass,
    Presence,
    TrackPoint,
)

from .courses import CourseLog
from .details import Details
from .likelihood_map import LikelihoodLog
from .pass_log import PassLog
from .pass_verdicts import log_pass_verdicts, pass_verdicts
from .presence_lane import PresenceLane
from .ratio_curves import RatioCurves
from .recipe import used
from .road_plot import RoadPlot
from .sensor_map import bounds
from .vehicle_truth import log_true_passes, log_true_ways

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.events import CandidateBlock, StageSpec, TraceBlock

    from .details import Views
    from .events import LogLines
    from .lanes import StageLanes
    from .palette import SensorColours
    from .timeline import Timeline

#: What a vehicle is told by: the first opens the viewer, where nothing else does.
TOLD = (Pass, LineCrossing)
#: The parameter by which stages say how power falls with distance.
EXPONENT = "exponent"


class Vehicles(Details):
    """Logs everything that is particular to vehicles.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    colours
        Of the sensors.
    lanes
        Of the stages.
    lines
        Of the log.
    """

    def __init__(
        self,
        timeline: Timeline,
        session: Session,
        colours: SensorColours,
        lanes: StageLanes,
        lines: LogLines,
    ) -> None:
        self._timeline = timeline
        self._session = session
        self._lanes = lanes
        shown = bounds(session)
        self._courses = CourseLog(timeline, shown, lanes)
        self._likelihood = LikelihoodLog(timeline) if shown is not None else None
        self._passes = PassLog(timeline, lines, shown)
        self._road = RoadPlot(timeline, session, colours)
        self._lines = lines
        self._passing = ""
        self._found: list[Pass] = []
        self._heard: dict[tuple[str, str], PresenceLane] = {}
        self._ratios: dict[str, tuple[StageSpec, RatioCurves]] = {}
        if shown is not None:
            log_true_ways(timeline, session.labels)
        log_true_passes(timeline, session.labels)

    @property
    def _span_ns(self) -> tuple[int, int]:
        """What is shown of the recording [ns]."""
        return self._session.shown_ns or (self._session.start_ns, self._session.end_ns)

    def stage(self, spec: StageSpec, colour: int) -> None:  # noqa: ARG002
        """Take a stage."""
        key = (spec.stage, spec.topic)
        if spec.emits == "pass":
            self._passing = spec.stage
        elif spec.emits == "track":
            self._courses.stage(spec)
        elif self.tells(spec) and key not in self._heard:
            self._heard[key] = PresenceLane(spec, self._lanes)
        elif self.draws(spec) and spec.topic not in self._ratios:
            self._begin_ratios(spec)

    def _begin_ratios(self, spec: StageSpec) -> None:
        """Begin the curves of a topic's ratios: stages after the first estimate the same."""
        session = self._session
        curves = RatioCurves(self._timeline, spec, self._span_ns)
        self._ratios[spec.topic] = (spec, curves)
        known = used(session, spec)
        exponent = getattr(known.parameters, EXPONENT, 0.0) if known is not None else 0.0
        if exponent:
            curves.log_truth(session, exponent)

    def draws(self, spec: StageSpec) -> bool:
        """Whether a stage's trace is of ratios, which have plots of their own."""
        return RatioCurves.fits(spec)

    def tells(self, spec: StageSpec) -> bool:
        """Whether a stage hears vehicles: its lane puts the channels together."""
        return spec.emits == "presence" and bool(spec.gates)

    def trace(self, block: TraceBlock) -> None:
        """Take a piece of a trace: ratios are drawn."""
        spec, curves = self._ratios.get(block.spec.topic, (None, None))
        if curves is not None and spec is not None and spec.stage == block.spec.stage:
            curves.trace(block)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        lane = self._heard.get((block.spec.stage, block.spec.topic))
        if lane is not None:
            lane.candidates(block)

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        self._courses.add(point)

    def surface(self, surface: LikelihoodSurface) -> None:
        """Take the likelihood of places in one cycle."""
        if self._likelihood is not None:
            self._likelihood.add(surface)

    def passed(self, one: Pass) -> None:
        """Take a pass of a station."""
        self._found.append(one)
        self._passes.passed(one)
        self._road.add(one)

    def crossed(self, one: LineCrossing) -> None:
        """Take a crossing of a line."""
        self._passes.crossed(one, told=one.stage == self._courses.last)

    def presence(self, span: Presence) -> None:
        """Take a span in which a channel hears a vehicle: its lane has the cycles already."""

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; fill lanes up to a time."""
        for lane in self._heard.values():
            lane.flush(before_ns)
        for _, curves in self._ratios.values():
            curves.flush()
        self._courses.flush()
        self._passes.flush()
        self._road.flush()
        if self._likelihood is not None:
            self._likelihood.flush()

    def close(self) -> None:
        """Log what was held back, and what became of every pass."""
        if self._likelihood is not None:
            self._likelihood.close()
        if self._passing:
            last = [p for p in self._found if p.stage == self._passing]
            found = pass_verdicts(self._session.labels, last, self._span_ns)
            log_pass_verdicts(self._timeline, self._lines, found)
            self._road.missed([one for one in found if one.verdict == "missed"])

    views: ClassVar[Views] = {
        TrackPoint: track,
        LikelihoodSurface: surface,
        Pass: passed,
        LineCrossing: crossed,
        Presence: presence,
    }
