"""Vehicles on the timeline: likelihood, courses, ratios, passes and the path along the road."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from groundtrace_codecs.events import (
    CandidateBlock,
    LikelihoodSurface,
    LineCrossing,
    Pass,
    Presence,
    StageSpec,
    TraceBlock,
    TrackPoint,
)
from groundtrace_codecs.signals import NS_PER_S

from .context import View
from .places import ellipses
from .site import SITE, bounds, signs_of
from .timeline import (
    ACCEPTED,
    COURSE_COLOURS,
    ESTIMATOR_COLOURS,
    FAINT,
    MISSED,
    REJECTED,
    REJECTION_COLOURS,
    SCORE,
    TRACE,
    TRUTH,
    TRUTH_LANES,
    WALKER_COLOURS,
    Entity,
    Lane,
    Strips,
    dimmed,
    heat,
    used,
    vehicle_colour,
)
from .wrong_decisions import VERDICT_COLOURS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rerun as rr
    from numpy.typing import ArrayLike, NDArray

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.results import Evidence
    from groundtrace_codecs.events import Event, Label

    from .context import LogLines, ViewContext
    from .timeline import Bounds, SensorColours, StageLanes, Timeline

    Array = NDArray[np.float64]

#: The parameter by which stages say how power falls with distance.
EXPONENT = "exponent"


class VehicleView(View):
    """A view of vehicles alone."""

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether vehicles are replayed."""
        return context.session.application == "vehicle"


TRUE_WAYS = f"{SITE}/true-ways"


def log_true_ways(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log the way of each vehicle while it is on it, and where it is; of several with its name."""
    ways = true_ways(labels)
    for number, (name, way) in enumerate(ways.items()):
        path = f"{TRUE_WAYS}/{number}"
        line = Strips(timeline, f"{path}/way", 5.0)
        line.add(int(way.times_ns[0]), [way.places], [TRUTH & 0xFFFFFF80], [-0.8])
        line.clear(int(way.times_ns[-1]))
        line.flush()
        log_moving(timeline, f"{path}/place", way, TRUTH, 5.0, name if len(ways) > 1 else "")


def log_true_passes(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log a lane for each direction: vehicles from their first station to their last."""
    lanes: dict[str, Lane] = {}
    colours = cycle(WALKER_COLOURS)
    for name, those in vehicles(labels).items():
        passes = [x for x in those if x.kind == "pass"]
        direction = passes[0].label or "passes"
        speeds = [x.value for x in passes if x.value is not None]
        state = f"{name} {np.mean(speeds):.1f} m/s" if speeds else name
        lane = lanes.setdefault(direction, Lane(timeline, f"{TRUTH_LANES}/{direction}", {}))
        lane.allow({state: next(colours)})
        lane.add(passes[0].time_ns, state, passes[-1].time_ns)
    for lane in lanes.values():
        lane.flush()


COURSES = f"{SITE}/courses"
KEY = f"{COURSES}/key"
#: A course stays so long after its last place [ns].
COURSE_HOLD_NS = 5 * NS_PER_S
#: Length of a dash as a part of the map's width; width of lines [screen points].
DASH, BROAD, THIN = 0.012, 1.6, 1.0
#: How far down the margin the key stands.
MARGIN = 0.55


class CourseView(VehicleView):
    """Logs tracks of vehicles, which are told when a vehicle has gone, at the times they are of.

    Courses of a stage that follow one another use two entities in turn: one may still be seen
    when the next begins. Lanes show speeds.
    """

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline
        self._shown = bounds(context.session)
        self._lanes = context.lanes
        if self._shown is not None:
            log_true_ways(context.timeline, context.session.labels)
        self._specs: dict[str, StageSpec] = {}
        self._pending: dict[tuple[str, int], list[TrackPoint]] = {}
        self._strips: dict[tuple[str, int, str], Strips] = {}

    def stage(self, spec: StageSpec) -> None:
        """Take a stage; those that tell courses are named in the key."""
        if spec.emits != "track":
            return
        self._specs.setdefault(spec.stage, spec)
        if self._shown is not None:
            self._name(self._shown)

    def colour(self, stage: str) -> int:
        """Return the colour of a stage: the last one has the first."""
        index = list(reversed(self._specs)).index(stage)
        return COURSE_COLOURS[index % len(COURSE_COLOURS)]

    def _name(self, shown: Bounds) -> None:
        """Name the stages in the key."""
        import rerun as rr

        key = rr.Points2D(
            shown.key(len(self._specs), -MARGIN),
            labels=list(self._specs),
            show_labels=True,
            colors=np.array([self.colour(s) for s in self._specs], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(KEY, key)

    def track(self, point: TrackPoint) -> None:
        """Take a place; those of a track come together, in the order of time."""
        if point.stage in self._specs:
            self._pending.setdefault((point.stage, point.track), []).append(point)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        for (stage, track), points in self._pending.items():
            self._span(stage, track, points)
            if len(points) > 1 and self._shown is not None:
                self._log(stage, track, points, self._shown)
        self._pending = {}
        for strips in self._strips.values():
            strips.flush()

    def _span(self, stage: str, track: int, points: list[TrackPoint]) -> None:
        """Put a track into its stage's lane, with its mean speed."""
        spec = self._specs[stage]
        speed = float(np.mean([np.hypot(p.vx_mps, p.vy_mps) for p in points]))
        state = f"V{track} {speed:.1f} m/s"
        lane = self._lanes.of(stage, spec.topic, {state: vehicle_colour(track)}, spec.emits)
        lane.add(points[0].time_ns, state, points[-1].time_ns)

    def _log(self, stage: str, track: int, points: list[TrackPoint], shown: Bounds) -> None:
        times = np.array([p.time_ns for p in points], np.int64)
        way = Way(times, np.array([(p.x_m, p.y_m) for p in points]))
        best, colour, turn = stage == next(reversed(self._specs)), self.colour(stage), track % 2
        line = dashes(way.places, DASH * (shown.x[1] - shown.x[0]))
        radii = [-(BROAD if best else THIN)] * len(line)
        drawn = self._of(stage, turn, "course")
        drawn.add(points[0].time_ns, line, [colour] * len(line), radii)
        drawn.clear(points[-1].time_ns + COURSE_HOLD_NS)
        path = f"{COURSES}/{stage}/{turn}/place"
        log_moving(self._timeline, path, way, colour, 6.0 if best else 3.0)
        if best:
            self._log_ellipses(stage, turn, way, points)

    def _log_ellipses(self, stage: str, turn: int, way: Way, points: list[TrackPoint]) -> None:
        drawn = self._of(stage, turn, "ellipse")
        spreads = way.between(np.array([p.covariance for p in points]))
        lines = ellipses(way.between(way.places), spreads)
        for time_ns, line in zip(way.steps_ns().tolist(), lines, strict=True):
            drawn.add(time_ns, [line], [self.colour(stage)], [-1.0])
        drawn.clear(int(way.times_ns[-1]) + 1)

    def _of(self, stage: str, turn: int, what: str) -> Strips:
        key = (stage, turn, what)
        if key not in self._strips:
            path = f"{COURSES}/{stage}/{turn}/{what}"
            self._strips[key] = Strips(self._timeline, path, 10.0)
        return self._strips[key]

    kinds: ClassVar = {StageSpec: stage, TrackPoint: track}


CROSSINGS = f"{SITE}/crossings"
PASSES, CROSSED = "/table/passes", "/table/crossings"
#: A lane for each direction of the vehicles that passed.
LANES = "/state/5-passes"
#: Where at the map's side what a crossing says stands: parts of the map's width from the edge, and
#: above its line, where sensors have their names below.
LABEL, LABEL_ABOVE = 0.07, 0.06


def pass_text(one: Pass) -> str:
    """Return what there is to say of a pass at a station."""
    if not one.vehicle:
        return f"a vehicle at {one.station} alone"
    return f"V{one.vehicle} {one.direction} {speed_text(one)} at {one.station}"


def crossing_text(one: LineCrossing) -> str:
    """Return what there is to say of a crossing."""
    position = f"({one.x_m:.1f}, {one.y_m:.1f}) ± {one.along_sigma_m:.1f} m"
    return f"V{one.track} {speed_text(one)} crosses {one.line} at {position}"


def speed_text(one: Pass | LineCrossing) -> str:
    """Return a speed with its standard deviation; nothing where it is unknown."""
    if not math.isfinite(one.speed_mps):
        return "of unknown speed"
    return f"{one.speed_mps:.1f} ± {one.speed_sigma_mps:.1f} m/s"


class PassView(VehicleView):
    """Logs passes and crossings, which are told when a vehicle has gone."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._timeline = context.timeline
        self._lines = context.lines
        self._shown = bounds(context.session)
        self._road = RoadPlot(context.timeline, context.session, context.colours)
        self._all_passes: list[Pass] = []
        self._passes: list[Pass] = []
        self._crossings: list[LineCrossing] = []
        self._lanes: dict[str, Lane] = {}
        log_true_passes(context.timeline, context.session.labels)

    def passed(self, one: Pass) -> None:
        """Take a pass; those of a vehicle come together."""
        self._context.opens(one.time_ns)
        self._all_passes.append(one)
        self._road.add(one)
        self._passes.append(one)
        level = "INFO" if one.vehicle else "WARN"
        self._lines.add("passes", one.time_ns, f"{self._when(one)}  {pass_text(one)}", level)

    def crossed(self, one: LineCrossing) -> None:
        """Take a crossing: a row; of the last stage a line of the log and a mark on the map."""
        self._context.opens(one.time_ns)
        self._crossings.append(one)
        last = self._context.stages.last("track")
        reported = last is not None and last.stage == one.stage
        if reported:
            line = f"{self._when(one)}  {crossing_text(one)}"
            self._lines.add("crossings", one.time_ns, line, "INFO")
        if reported and self._shown is not None:
            self._mark(one, self._shown)

    def _when(self, one: Pass | LineCrossing) -> str:
        return f"{self._timeline.seconds(one.time_ns)} ± {one.sigma_s:.2g} s"

    def _mark(self, one: LineCrossing, shown: Bounds) -> None:
        """Log a mark where a line was crossed, and at the map's side time and speed."""
        import rerun as rr

        path = f"{CROSSINGS}/{one.line}"
        when = f"{(one.time_ns - self._timeline.start_ns) / NS_PER_S:.2f} s"
        width = shown.x[1] - shown.x[0]
        side = (shown.x[1] - LABEL * width, one.y_m + LABEL_ABOVE * width)
        columns = rr.Points2D.columns(
            positions=[(one.x_m, one.y_m), side],
            labels=["", f"{one.line}: {when}, {one.speed_mps:.1f} m/s"],
            colors=np.array([COURSE_COLOURS[0]] * 2, np.uint32),
            radii=[-4.0, -0.1],
        )
        entity = Entity(path, "map", visible_s=10.0)
        self._timeline.declare(entity, rr.Points2D.from_fields(show_labels=True))
        self._timeline.send(path, [one.time_ns], columns.partition([2]))

    def close(self) -> None:
        """Log what became of every pass, where a stage finds passes."""
        last = self._context.stages.last("pass")
        if last is not None:
            passes = [p for p in self._all_passes if p.stage == last.stage]
            span_ns = self._context.span_ns
            verdicts = pass_verdicts(self._context.session.labels, passes, span_ns)
            log_pass_verdicts(self._timeline, self._lines, verdicts)
            self._road.missed([one for one in verdicts if one.verdict == "missed"])

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        self._road.flush()
        if self._passes:
            self._rows()
            for number in dict.fromkeys(p.vehicle for p in self._passes if p.vehicle):
                self._span([p for p in self._passes if p.vehicle == number])
        if self._crossings:
            self._crossing_rows()
        self._passes, self._crossings = [], []
        for lane in self._lanes.values():
            lane.flush()

    def _span(self, passes: list[Pass]) -> None:
        """Put a vehicle into the lane of its direction, from its first station to its last."""
        first, direction = passes[0], passes[0].direction
        lane = self._lanes.setdefault(direction, Lane(self._timeline, f"{LANES}/{direction}", {}))
        state = f"V{first.vehicle} {first.speed_mps:.1f} m/s"
        lane.allow({state: vehicle_colour(first.vehicle)})
        times = [p.time_ns for p in passes]
        lane.add(min(times), state, max(times))

    def _rows(self) -> None:
        import rerun as rr

        passes = self._passes
        self._timeline.declare(Entity(PASSES, "table", "Passes"))
        columns = rr.AnyValues.columns(
            vehicle=np.array([p.vehicle for p in passes]),
            direction=[p.direction for p in passes],
            speed_mps=np.array([p.speed_mps for p in passes]),
            speed_sigma_mps=np.array([p.speed_sigma_mps for p in passes]),
            station=[p.station for p in passes],
            time_sigma_s=np.array([p.sigma_s for p in passes]),
            half_width_s=np.array([p.half_width_s for p in passes]),
            over_noise_db=np.array([p.value for p in passes]),
        )
        self._timeline.send(PASSES, [p.time_ns for p in passes], columns)

    def _crossing_rows(self) -> None:
        import rerun as rr

        crossings = self._crossings
        self._timeline.declare(Entity(CROSSED, "table", "Crossings"))
        columns = rr.AnyValues.columns(
            stage=[c.stage for c in crossings],
            track=np.array([c.track for c in crossings]),
            line=[c.line for c in crossings],
            x_m=np.array([c.x_m for c in crossings]),
            y_m=np.array([c.y_m for c in crossings]),
            along_sigma_m=np.array([c.along_sigma_m for c in crossings]),
            time_sigma_s=np.array([c.sigma_s for c in crossings]),
            speed_mps=np.array([c.speed_mps for c in crossings]),
            speed_sigma_mps=np.array([c.speed_sigma_mps for c in crossings]),
            heading_deg=np.degrees([c.heading_rad for c in crossings]),
        )
        self._timeline.send(CROSSED, [c.time_ns for c in crossings], columns)

    kinds: ClassVar = {Pass: passed, LineCrossing: crossed}


@dataclass(frozen=True, slots=True, order=True)
class PassVerdict:
    """What became of a pass.

    Attributes
    ----------
    time_ns
        Of the true pass that was hit or missed, of the found one that is false.
    verdict
        ``hit``, ``missed`` or ``false``.
    station, text
        Where, and what there is to say of it.
    """

    time_ns: int
    verdict: str
    station: str
    text: str


def pass_verdicts(
    labels: Sequence[Label], passes: Sequence[Pass], span_ns: tuple[int, int]
) -> list[PassVerdict]:
    """Return what became of every true pass, and which found ones answer none, as scored.

    Parameters
    ----------
    labels
        Truth.
    passes
        Of one stage.
    span_ns
        First and last sample that was replayed [ns].
    """
    from groundtrace.evaluation.positions import ignored
    from groundtrace.evaluation.vehicles import match_passes

    first, last = span_ns
    in_span = [x for x in labels if x.kind == "pass" and first <= x.time_ns <= last]
    excluded = ignored(labels, np.array([x.time_ns for x in in_span], np.int64))
    truth = sorted(x for x, no in zip(in_span, excluded, strict=True) if not no)
    away = ignored(labels, np.array([p.time_ns for p in passes], np.int64))
    detected = [p for p, no in zip(passes, away, strict=True) if not no]
    if not truth:
        return []
    pairs = match_passes(truth, detected)
    hit, matched = [x for x, _ in pairs], [p for _, p in pairs]
    true = [(x, "hit" if x in hit else "missed") for x in truth]
    return sorted(
        [
            *(PassVerdict(x.time_ns, what, x.channel, _true_pass_text(x)) for x, what in true),
            *(PassVerdict(p.time_ns, "false", p.station, pass_text(p)) for p in detected
              if p not in matched),
        ]
    )  # fmt: skip


def wrong_passes(evidence: Evidence, events: Sequence[Event]) -> tuple[str, list[PassVerdict]]:
    """Return the last stage that finds passes, and the passes that are missed or false by it."""
    stages = [part.spec.stage for part in evidence.stages if part.spec.emits == "pass"]
    if not stages:
        return "", []
    passes = [e for e in events if isinstance(e, Pass) and e.stage == stages[-1]]
    verdicts = pass_verdicts(evidence.labels, passes, (evidence.start_ns, evidence.end_ns))
    return stages[-1], [one for one in verdicts if one.verdict != "hit"]


def _true_pass_text(label: Label) -> str:
    """Return what the truth says of a pass."""
    speed = f"{label.value:.1f} m/s" if label.value is not None else ""
    return " ".join(filter(None, (label.target, label.label, speed, "at", label.channel)))


def log_pass_verdicts(timeline: Timeline, lines: LogLines, verdicts: Sequence[PassVerdict]) -> None:
    """Log the lane of the score, and a line for every pass that was missed or is false."""
    lane = Lane(timeline, SCORE, VERDICT_COLOURS)
    for one in verdicts:
        lane.add(one.time_ns, one.verdict)
        if one.verdict != "hit":
            text = f"{timeline.seconds(one.time_ns)}  {one.verdict} pass: {one.text}"
            lines.add("score", one.time_ns, text, "ERROR" if one.verdict == "missed" else "WARN")
    lane.flush()


HEARD = "vehicle"
#: Cycles as long as this, where there is but one [ns].
CYCLE_NS = 500_000_000
#: No span: its start and end [ns] and its state.
NONE = (0, 0, "")


class PresenceLanes(VehicleView):
    """The lanes of the stages that hear vehicles."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._stages: dict[tuple[str, str], PresenceLane] = {}

    def stage(self, spec: StageSpec) -> None:
        """Take a stage: the lane of one that hears vehicles puts its channels together."""
        key = (spec.stage, spec.topic)
        if spec.emits == "presence" and spec.gates and key not in self._stages:
            self._stages[key] = PresenceLane(spec, self._context.lanes)
            self._context.drawn_lanes.add(key)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        lane = self._stages.get((block.spec.stage, block.spec.topic))
        if lane is not None:
            lane.candidates(block)

    def presence(self, span: Presence) -> None:
        """Take a span in which a channel hears a vehicle: its lane has the cycles already."""

    def flush(self, before_ns: int | None = None) -> None:
        """Fill the lanes up to a time."""
        for lane in self._stages.values():
            lane.flush(before_ns)

    kinds: ClassVar = {StageSpec: stage, CandidateBlock: candidates, Presence: presence}


class PresenceLane:
    """Puts the channels together: any that hears a vehicle, else the loudest above the threshold.

    Parameters
    ----------
    spec
        The stage that hears vehicles; its first gate is on power.
    lanes
        Among which its own is.
    """

    def __init__(self, spec: StageSpec, lanes: StageLanes) -> None:
        names = [f"no: {gate.name.replace('_', ' ')}" for gate in spec.gates]
        self._names = names
        shades = (REJECTION_COLOURS[i % len(REJECTION_COLOURS)] for i in range(len(names)))
        colours = {HEARD: ACCEPTED, **dict(zip(names, shades, strict=True))}
        self._lane: Lane = lanes.of(spec.stage, spec.topic, colours, spec.emits)
        self._cycles: dict[int, tuple[float, str]] = {}
        self._cycle_ns = 0
        self._open = NONE

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided cycles of channels."""
        rows = zip(block.time_ns.tolist(), block.margin, block.accepted.tolist(), strict=True)
        for time_ns, margin, accepted in rows:
            if accepted:
                self._cycles[time_ns] = (np.inf, HEARD)
                continue
            loudness, _ = self._cycles.get(time_ns, (0.0, ""))
            failed = int(np.argmax(~(margin >= 0)))
            if failed and margin[0] >= loudness:
                self._cycles[time_ns] = (float(margin[0]), self._names[failed])
        times = np.unique(block.time_ns)
        if len(times) > 1:
            apart_ns = int(np.diff(times).min())
            self._cycle_ns = min(self._cycle_ns or apart_ns, apart_ns)

    def flush(self, before_ns: int | None = None) -> None:
        """Fill the lane up to a time; all channels have told what was before."""
        length_ns = self._cycle_ns or CYCLE_NS
        ready = sorted(t for t in self._cycles if before_ns is None or t < before_ns)
        for time_ns in ready:
            _, cycle_state = self._cycles.pop(time_ns)
            start_ns, end_ns, state = self._open
            first_ns = time_ns - length_ns // 2
            if cycle_state != state or first_ns > end_ns:
                self._end()
                start_ns = first_ns
            self._open = start_ns, first_ns + length_ns, cycle_state
        if before_ns is None or self._open[1] < before_ns - length_ns:
            self._end()

    def _end(self) -> None:
        """Put the span that is open into the lane."""
        start_ns, end_ns, state = self._open
        if state:
            self._lane.add(start_ns, state, end_ns)
        self._open = NONE


RATIOS = "/ratios"
SIGMA = " sigma"
#: Decibels of a natural logarithm of powers.
DB = 10 / np.log(10)
#: Estimators of a cycle stand beside each other, this far apart [ns].
APART_NS = 60_000_000
#: A vehicle is no nearer to a sensor than this [m], as in the computations.
NEAREST_M = 0.5


class RatioViews(VehicleView):
    """The ratios of each topic: stages after its first estimate the same."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._topics: dict[str, tuple[StageSpec, RatioCurves]] = {}

    def stage(self, spec: StageSpec) -> None:
        """Take a stage: a trace of ratios has plots of its own."""
        if not RatioCurves.fits(spec):
            return
        context = self._context
        context.drawn.add((spec.stage, spec.topic))
        if spec.topic in self._topics:
            return
        curves = RatioCurves(context.timeline, spec, context.span_ns)
        self._topics[spec.topic] = (spec, curves)
        plugin = used(context.session, spec)
        exponent = getattr(plugin.parameters, EXPONENT, 0.0) if plugin is not None else 0.0
        if exponent:
            curves.log_truth(context.session, exponent)

    def trace(self, block: TraceBlock) -> None:
        """Take a piece of a trace: ratios are drawn."""
        spec, curves = self._topics.get(block.spec.topic, (None, None))
        if curves is not None and spec is not None and spec.stage == block.spec.stage:
            curves.trace(block)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        for _, curves in self._topics.values():
            curves.flush()

    kinds: ClassVar = {StageSpec: stage, TraceBlock: trace}


class RatioCurves:
    """Logs the ratios of one topic's pairs: a plot each, with a colour for every estimator.

    Parameters
    ----------
    timeline
        Where to.
    spec
        A stage whose trace holds ln theta by estimators, and its deviations.
    span_ns
        What is shown of the recording: start and end [ns].
    """

    def __init__(self, timeline: Timeline, spec: StageSpec, span_ns: tuple[int, int]) -> None:
        self._span_ns = span_ns
        self._timeline = timeline
        self._spec = spec
        names = [quantity.name for quantity in spec.trace]
        self._columns = {
            name: (i, names.index(name + SIGMA))
            for i, name in enumerate(names)
            if name + SIGMA in names
        }
        self._pending: list[TraceBlock] = []
        for pair in spec.channels:
            self._begin(pair)

    @staticmethod
    def fits(spec: StageSpec) -> bool:
        """Whether the trace of a stage holds estimates and their deviations, of pairs."""
        names = {quantity.name for quantity in spec.trace}
        paired = all("/" in channel for channel in spec.channels)
        return paired and any(name + SIGMA in names for name in names)

    def _path(self, pair: str) -> str:
        return f"{RATIOS}/{self._spec.topic.strip('/')}/{pair.replace('/', '-')}"

    def _begin(self, pair: str) -> None:
        import rerun as rr

        of = pair.replace("/", " / ")
        legend = ", ".join(
            f"{a} {b}" for a, b in zip(self._columns, ESTIMATOR_COLOURS, strict=False)
        )
        first = pair == self._spec.channels[0]
        title = f"θ {of} [dB] ± σ: {legend}" if first else f"θ {of}"
        self._timeline.declare(Entity(self._path(pair), "ratio", title, len(self._columns)))
        # a plot of the whole recording, though cycles are where there are vehicles
        zero_line = rr.SeriesLines(names="alike", colors=np.array([FAINT], np.uint32), widths=1.0)
        self._timeline.static(f"{self._path(pair)}/alike", zero_line)
        self._timeline.level(f"{self._path(pair)}/alike", self._span_ns, 0.0)
        for name, colour in zip(self._columns, ESTIMATOR_COLOURS.values(), strict=False):
            shade = np.array([colour], np.uint32)
            points = rr.SeriesPoints(
                names=name, colors=shade, markers=rr.components.MarkerShape.Circle, marker_sizes=2.5
            )
            bars = rr.SeriesLines(
                names=f"{name} ± σ",
                colors=shade,
                widths=1.0,
                aggregation_policy=rr.components.AggregationPolicy.MinMax,
            )
            self._timeline.static(f"{self._path(pair)}/{name}/value", points)
            self._timeline.static(f"{self._path(pair)}/{name}/sigma", bars)

    def trace(self, block: TraceBlock) -> None:
        """Take the estimates of cycles."""
        self._pending.append(block)

    def flush(self) -> None:
        """Log what is pending."""
        if not self._pending:
            return
        ratios_db = DB * np.concatenate([b.value for b in self._pending]).astype(np.float64)
        time_ns = np.concatenate([b.time_ns for b in self._pending])
        self._pending = []
        middle = (len(self._columns) - 1) / 2
        for index, (name, (theta, sigma)) in enumerate(self._columns.items()):
            times = time_ns + round((index - middle) * APART_NS)
            for row, pair in enumerate(self._spec.channels):
                path = f"{self._path(pair)}/{name}"
                self._log(path, times, ratios_db[:, row, theta], ratios_db[:, row, sigma])

    def _log(self, path: str, times: NDArray[np.int64], value: Array, sigma: Array) -> None:
        """Log estimates as points, and their deviations as upright bars."""
        self._timeline.scalars(f"{path}/value", times, value[:, np.newaxis])
        ends = np.stack([value - sigma, value + sigma, np.full(len(value), np.nan)], axis=1)
        bar_ns = (times[:, np.newaxis] + np.arange(3)).ravel()
        self._timeline.scalars(f"{path}/sigma", bar_ns, ends.reshape(-1, 1))

    def log_truth(self, session: ReplaySession, exponent: float) -> None:
        """Log what true distances make of the ratios by the law, of each vehicle."""
        site = session.geometry
        places = {s.channel: (s.x, s.y) for s in site.sensors} if site is not None else {}
        for name, way in true_ways(session.labels).items():
            times, route = way.steps_ns(), way.between(way.places)
            for pair in self._spec.channels:
                ends = [places[channel] for channel in pair.split("/", 1) if channel in places]
                if len(ends) < 2:
                    continue
                r, r0 = (np.maximum(np.hypot(*(route - end).T), NEAREST_M) for end in ends)
                self._log_true(f"{self._path(pair)}/truth/{name}", times, r / r0, exponent)

    def _log_true(self, path: str, times: NDArray[np.int64], ratio: Array, exponent: float) -> None:
        import rerun as rr

        style = rr.SeriesLines(names="truth", colors=np.array([TRUTH], np.uint32), widths=1.0)
        self._timeline.static(path, style)
        self._timeline.scalars(path, times, 10 * exponent * np.log10(ratio)[:, np.newaxis])


LIKELIHOOD = f"{SITE}/likelihood"
#: What is less likely than the likeliest by more than this, in log-likelihood, is clear: a place
#: there is ten thousand times less likely. The rest has so many levels.
DEPTH, SHOWN_LEVELS = 9.0, 24
#: Opacity of the likeliest.
OPACITY = 0.8
#: An image goes out after this, unless another comes before [ns].
LIKELIHOOD_HOLD_NS = 2 * NS_PER_S


class LikelihoodView(VehicleView):
    """Logs the images of all stages that locate by likelihood, where there is a map."""

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline
        self._mapped = bounds(context.session) is not None
        self._pending: dict[str, list[LikelihoodSurface]] = {}
        self._begun: set[str] = set()
        self._last_ns: dict[str, int] = {}

    def surface(self, surface: LikelihoodSurface) -> None:
        """Take the surface of a cycle; those of a stage have one lattice."""
        if not self._mapped:
            return
        if surface.stage not in self._begun:
            self._begun.add(surface.stage)
            self._begin(surface)
        self._pending.setdefault(surface.stage, []).append(surface)

    def _begin(self, surface: LikelihoodSurface) -> None:
        import rerun as rr

        path = f"{LIKELIHOOD}/{surface.stage}"
        half = surface.step_m / 2  # nodes are the middles of pixels
        transform = rr.Transform3D(
            translation=(surface.x_m - half, surface.y_m - half, 0.0), scale=surface.step_m
        )
        order = rr.SegmentationImage.from_fields(draw_order=-30.0)
        self._timeline.declare(Entity(path, "map"), transform, _shades(), order)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        import rerun as rr

        for stage, surfaces in self._pending.items():
            path = f"{LIKELIHOOD}/{stage}"
            self._go_out(path, stage, [s.time_ns for s in surfaces])
            columns = rr.SegmentationImage.columns(
                buffer=[_image(s) for s in surfaces],
                format=[_format(s) for s in surfaces],
                opacity=np.ones(len(surfaces), np.float32),
            )
            self._timeline.send(path, [s.time_ns for s in surfaces], columns)
        self._pending = {}

    def close(self) -> None:
        """Log what is pending, and that the last images go out."""
        self.flush()
        for stage, last_ns in self._last_ns.items():
            self._clear(f"{LIKELIHOOD}/{stage}", [last_ns + LIKELIHOOD_HOLD_NS])

    def _go_out(self, path: str, stage: str, times_ns: list[int]) -> None:
        """Log that images go out that no other follows in time."""
        before = [self._last_ns.get(stage, times_ns[0]), *times_ns]
        late = np.flatnonzero(np.diff(before) > LIKELIHOOD_HOLD_NS)
        if len(late):
            self._clear(path, [before[i] + LIKELIHOOD_HOLD_NS for i in late])
        self._last_ns[stage] = times_ns[-1]

    def _clear(self, path: str, times_ns: list[int]) -> None:
        import rerun as rr

        clear = rr.SegmentationImage.columns(opacity=np.zeros(len(times_ns), np.float32))
        self._timeline.send(path, times_ns, clear)

    kinds: ClassVar = {LikelihoodSurface: surface}


def _shades() -> rr.AnnotationContext:
    """Return the colours of the levels, clear below and nearly opaque above."""
    import rerun as rr

    level = np.arange(SHOWN_LEVELS) / (SHOWN_LEVELS - 1)
    alpha = np.rint(0xFF * OPACITY * np.minimum(1.6 * level, 1.0)).astype(np.uint32)
    colours = (heat(level) & np.uint32(0xFFFFFF00)) | alpha
    return rr.AnnotationContext(
        [rr.AnnotationInfo(id=i, color=int(colour)) for i, colour in enumerate(colours)]
    )


def _image(surface: LikelihoodSurface) -> bytes:
    """Return the shown level of every node, a byte each."""
    below = surface.highest - surface.values()
    shown = (SHOWN_LEVELS - 1) * np.clip(1.0 - below / DEPTH, 0.0, 1.0)
    return np.rint(shown).astype(np.uint8).tobytes()


def _format(surface: LikelihoodSurface) -> rr.components.ImageFormat:
    import rerun as rr

    return rr.components.ImageFormat(
        width=surface.columns, height=surface.rows, channel_datatype=rr.ChannelDatatype.U8
    )


ROAD = "/road"
#: Beyond the first and last station the plot shows this part of the way between them, and this
#: much at least [m].
BEYOND, LEAST_M = 0.3, 10.0
#: Vehicles use so many curves in turn: two that are there at once never share one.
CURVES = 4
#: Brightness of the lines of stations.
STATION = 0.45


class RoadPlot:
    """Logs the plot; without two stations at places there is none.

    Parameters
    ----------
    timeline
        Where to.
    session
        Gives stations, road and truth.
    colours
        Of the sensors.
    """

    def __init__(self, timeline: Timeline, session: ReplaySession, colours: SensorColours) -> None:
        self._timeline = timeline
        self._session = session
        self._passes: list[Pass] = []
        self._begun = False
        geometry = session.geometry
        self._site = geometry.stations() if geometry is not None else None
        self._along: dict[str, float] = {}
        if self._site is not None and self._site.names:
            along, _ = self._site.along_road()
            self._along = dict(zip(self._site.names, along.tolist(), strict=True))
        signs = signs_of(geometry, colours) if geometry is not None else []
        self._shades = {sign.name: sign.colour for sign in signs}

    def add(self, one: Pass) -> None:
        """Take a pass; those of a vehicle come together."""
        if len(set(self._along.values())) > 1 and one.station in self._along:
            self._passes.append(one)

    def flush(self) -> None:
        """Log what is pending."""
        if self._passes and not self._begun:
            self._begin()
        for number in dict.fromkeys(p.vehicle for p in self._passes if p.vehicle):
            self._vehicle([p for p in self._passes if p.vehicle == number])
        for station in dict.fromkeys(p.station for p in self._passes):
            self._marks(station, [p for p in self._passes if p.station == station])
        self._passes = []

    @property
    def _reach_m(self) -> tuple[float, float]:
        """What the plot shows of the way along the road [m]."""
        low, high = min(self._along.values()), max(self._along.values())
        beyond = max(BEYOND * (high - low), LEAST_M)
        return low - beyond, high + beyond

    def _begin(self) -> None:
        """Log what does not come with passes: the stations, and the truth."""
        self._begun = True
        session, (low, high) = self._session, self._reach_m
        title = "Way along the road [m]: passes at stations, vehicles, missed red; truth violet"
        entity = Entity(ROAD, "road", title, bottom=low, top=high)
        self._timeline.declare(entity)
        span_ns = session.shown_ns or (session.start_ns, session.end_ns)
        for name, along in self._along.items():
            colour = dimmed(self._shades.get(name, TRACE), STATION)
            self._curve(f"stations/{name}", span_ns, (along, along), name, colour, 1.0)
        for number, name in enumerate(vehicles(session.labels)):
            self._true(number, name)

    def _true(self, number: int, name: str) -> None:
        """Log where a vehicle truly was along the road, or when at the stations without a road."""
        if self._site is None:
            return
        way = true_ways(self._session.labels).get(name)
        if len(self._site.road) > 1 and way is not None:
            times = way.times_ns
            along, _ = replace(self._site, places=way.places).along_road()
        else:
            passes = vehicles(self._session.labels)[name]
            timed_positions = [
                (x.time_ns, self._along[x.channel]) for x in passes if x.channel in self._along
            ]
            times = np.array([t for t, _ in timed_positions], np.int64)
            along = np.array([a for _, a in timed_positions])
        low, high = self._reach_m
        near = (along > low) & (along < high)
        if near.sum() > 1:
            path = f"truth/{number % CURVES}"
            self._curve(path, times[near], along[near], "truth", TRUTH, 1.0)

    def _vehicle(self, passes: list[Pass]) -> None:
        """Log the line that a vehicle's passes make, over the whole plot."""
        passes = sorted(passes, key=lambda p: p.time_ns)
        since = np.array([p.time_ns - passes[0].time_ns for p in passes]) / NS_PER_S
        along = np.array([self._along[p.station] for p in passes])
        one = passes[0]
        speed = one.speed_mps if one.direction == "forward" else -one.speed_mps
        if not np.isfinite(speed) or speed == 0.0:
            return
        start = float(np.mean(along - speed * since))
        ends = sorted((edge - start) / speed for edge in self._reach_m)
        times = [one.time_ns + round(t * NS_PER_S) for t in ends]
        path = f"vehicles/{one.vehicle % CURVES}"
        line = [start + speed * t for t in ends]
        self._curve(path, times, line, "vehicle", vehicle_colour(one.vehicle), 1.8)

    def _marks(self, station: str, passes: list[Pass]) -> None:
        """Log a station's passes: in its colour, or grey where no vehicle has them."""
        import rerun as rr

        whose = [p for p in passes if p.vehicle], rr.components.MarkerShape.Circle
        alone = [p for p in passes if not p.vehicle], rr.components.MarkerShape.Cross
        for kind, (those, marker) in (("whose", whose), ("alone", alone)):
            if those:
                colour = self._shades.get(station, TRACE) if kind == "whose" else REJECTED
                path = f"{ROAD}/passes/{station}/{kind}"
                style = rr.SeriesPoints(
                    names=station,
                    colors=np.array([colour], np.uint32),
                    markers=marker,
                    marker_sizes=5.0,
                )
                self._timeline.static(path, style)
                along = np.full((len(those), 1), self._along[station])
                self._timeline.scalars(path, [p.time_ns for p in those], along)

    def missed(self, verdicts: Sequence[PassVerdict]) -> None:
        """Take the true passes that were missed."""
        import rerun as rr

        located = [one for one in verdicts if one.station in self._along]
        if not located or len(set(self._along.values())) < 2:
            return
        if not self._begun:
            self._begin()
        style = rr.SeriesPoints(
            names="missed",
            colors=np.array([MISSED], np.uint32),
            markers=rr.components.MarkerShape.Cross,
            marker_sizes=6.0,
        )
        self._timeline.static(f"{ROAD}/missed", style)
        along = np.array([[self._along[one.station]] for one in located])
        self._timeline.scalars(f"{ROAD}/missed", [one.time_ns for one in located], along)

    def _curve(
        self,
        name: str,
        times: ArrayLike,
        values: ArrayLike,
        title: str,
        colour: int,
        width: float,
    ) -> None:
        """Log a line that ends: the viewer would draw it on to the next."""
        import rerun as rr

        path = f"{ROAD}/{name}"
        style = rr.SeriesLines(names=title, colors=np.array([colour], np.uint32), widths=width)
        self._timeline.static(path, style)
        ends = np.append(np.asarray(times, np.int64), np.asarray(times, np.int64)[-1] + 1)
        along = np.append(np.asarray(values, np.float64), np.nan)
        self._timeline.scalars(path, ends, along[:, np.newaxis])


#: Labels that say where a vehicle is.
PLACED = ("waypoint", "pass")


def vehicles(labels: Sequence[Label]) -> dict[str, list[Label]]:
    """Return what is known of each vehicle that passes, in the order of time."""
    names = dict.fromkeys(x.target for x in sorted(labels) if x.kind == "pass")
    return {
        name: sorted(x for x in labels if x.target == name and x.kind in PLACED) for name in names
    }


def true_ways(labels: Sequence[Label]) -> dict[str, Way]:
    """Return the way of each vehicle that is known at two moments or more."""
    ways = {}
    for name, those in vehicles(labels).items():
        placed = [x for x in those if x.x_m is not None and x.y_m is not None]
        times, rows = np.unique([x.time_ns for x in placed], return_index=True)
        if len(times) > 1:
            places = np.array([(placed[i].x_m, placed[i].y_m) for i in rows], np.float64)
            ways[name] = Way(times.astype(np.int64), places)
    return ways


#: Between two places of a vehicle that is shown to move [ns].
MOVE_NS = NS_PER_S // 10
#: Most dashes of a course.
MOST_DASHES = 300


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Where a vehicle is when.

    Attributes
    ----------
    times_ns
        Shape (n,), increasing.
    places
        Shape (n, 2) [m].
    """

    times_ns: NDArray[np.int64]
    places: Array

    def steps_ns(self) -> NDArray[np.int64]:
        """Return moments from the first to the last, a tenth of a second apart."""
        return np.append(np.arange(self.times_ns[0], self.times_ns[-1], MOVE_NS), self.times_ns[-1])

    def between(self, values: Array) -> Array:
        """Return values of its times, shape (n, k), at :meth:`steps_ns`."""
        since, at = self.times_ns - self.times_ns[0], self.steps_ns() - self.times_ns[0]
        return np.column_stack([np.interp(at, since, column) for column in values.T])


def dashes(line: Array, length_m: float) -> list[NDArray[np.float32]]:
    """Cut a line of shape (n, 2) into dashes, each of shape (2, 2), with gaps as long [m]."""
    reached = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    length_m = max(length_m, float(reached[-1]) / (2 * MOST_DASHES))
    starts = np.arange(0.0, float(reached[-1]), 2 * length_m)
    ends = np.minimum(starts + length_m, reached[-1])
    endpoints = [
        np.column_stack([np.interp(at, reached, column) for column in line.T])
        for at in (starts, ends)
    ]
    return list(np.stack(endpoints, axis=1).astype(np.float32))


def log_moving(
    timeline: Timeline, path: str, way: Way, colour: int, radius: float, name: str = ""
) -> None:
    """Log a point that moves along a way, and is gone at its end."""
    import rerun as rr

    times = way.steps_ns()
    rows = len(times)
    columns = rr.Points2D.columns(
        positions=way.between(way.places).astype(np.float32),
        colors=np.full(rows, colour, np.uint32),
        radii=np.full(rows, -radius),
        labels=[name] * rows if name else None,
    )
    timeline.declare(Entity(path, "map"))
    timeline.send(path, times, columns)
    none = rr.Points2D.columns(positions=np.zeros((1, 2))).partition([0])
    timeline.send(path, [int(times[-1]) + 1], none)
