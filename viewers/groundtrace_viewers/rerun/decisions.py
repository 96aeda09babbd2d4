"""A detector on the timeline: decision function, threshold, candidates and why they failed.

Results hold frames of 50 ms of the decision function. For its value at every sample the stage runs
once more on the same blocks.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from groundtrace.detectors.trace import FRAME_S
from groundtrace.pipeline.parameters import StageConfig, describe
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import (
    EVENTS,
    CandidateBlock,
    Gap,
    Note,
    Pick,
    StageSpec,
    StepEvent,
    TraceBlock,
    readable,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .context import View, step_like
from .timeline import (
    ACCEPTED,
    CONFLICT,
    CURVE,
    DISAGREEMENT,
    DISTURBED,
    EITHER,
    GAPS,
    IGNORED,
    IMPACT,
    LAST,
    LOSS,
    MARK_NS,
    NO_PEAK,
    PEAK,
    PLACING,
    REFUSED,
    REJECTED,
    REJECTION_COLOURS,
    SPAN,
    STEP,
    STEP_COLOURS,
    THRESHOLD,
    TRUTH,
    TYPE_COLOURS,
    VALLEY,
    WALKER_COLOURS,
    Entity,
    Lane,
    coincident,
    scalar_column,
    used,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.stage import Curve
    from groundtrace_codecs.events import GateSpec, Label

    from .context import ViewContext
    from .samples import Piece
    from .timeline import SensorColours, StageLanes, Timeline

    #: Where marks lie: times [ns], and values.
    Marks = tuple[list[int], list[float]]

#: A ratio's plot ends at this many thresholds: peaks reach thousands, the decision falls near one.
CEILING = 4.0
#: Where on it candidates lie that are higher, as part of its height.
TOP_EDGE = 0.9
#: Rejected candidates this far below the threshold, as part of it, are in the results alone.
FLOOR = 0.5
#: With more channels than this the marks of candidates are smaller.
FEW_CHANNELS = 12
DISAGREE = "disagree"
#: What stages emit whose lanes show it by other marks than those of candidates.
TOLD = frozenset({"heading", "pass", "track"})


def decision_gate(spec: StageSpec) -> GateSpec | None:
    """Return the gate on the decision function: of its name, else the only one of its unit."""
    if not spec.trace:
        return None
    decision = spec.trace[0]
    named = [g for g in spec.gates if g.name == decision.name]
    same_unit = [g for g in spec.gates if g.unit == decision.unit]
    return named[0] if named else same_unit[0] if len(same_unit) == 1 else None


def ceiling(spec: StageSpec) -> float:
    """Return where the decision function's plot ends; 0 lets the data say, as for units."""
    gate = decision_gate(spec)
    if gate is None or spec.trace[0].unit not in ("", "1") or not gate.at_least:
        return 0.0
    return CEILING * max(gate.threshold, 0.0)


def frames_decided(spec: StageSpec) -> bool:
    """Whether every frame of every channel is a candidate: marks would hide the curves."""
    return spec.emits == "presence"


def decision_values(block: CandidateBlock) -> NDArray[np.float32]:
    """Return where candidates lie on the decision function's plot, shape (n,)."""
    names = [q.name for q in block.spec.columns]
    gate = decision_gate(block.spec)
    if block.spec.trace and block.spec.trace[0].name in names:
        return block.value[:, names.index(block.spec.trace[0].name)]
    if gate is not None:
        return block.gate_value[:, block.spec.gates.index(gate)]
    return block.value[:, 0] if names else np.zeros(len(block), np.float32)


def joined(blocks: Sequence[CandidateBlock]) -> CandidateBlock:
    """Return the candidates of several blocks of one stage and topic as one block."""
    names = [f for f in type(blocks[0]).__dataclass_fields__ if f != "spec"]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(b, name) for b in blocks]) for name in names
    }
    return replace(blocks[-1], **columns)


def shown_rows(block: CandidateBlock) -> CandidateBlock:
    """Return the candidates that are shown: those accepted, and those rejected but by far."""
    gate = decision_gate(block.spec)
    if gate is None or not gate.at_least or gate.threshold <= 0.0:
        return block
    rows = block.accepted | ~(decision_values(block) < FLOOR * gate.threshold)
    if rows.all():
        return block
    columns = [f for f in type(block).__dataclass_fields__ if f != "spec"]
    return replace(block, **{name: getattr(block, name)[rows] for name in columns})


class DetectorViews(View):
    """What stages say: the plots of their decision functions, and their lanes."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._detectors: dict[tuple[str, str], DetectorView] = {}

    def stage(self, spec: StageSpec) -> None:
        """Take a stage."""
        self._of(spec)

    def _of(self, spec: StageSpec) -> DetectorView:
        """Return what draws a stage; other views may have taken its plot, or its lane."""
        context, key = self._context, (spec.stage, spec.topic)
        if key not in self._detectors:
            drawn = replace(spec, trace=()) if key in context.drawn else spec
            lanes = None if key in context.drawn_lanes else context.lanes
            self._detectors[key] = DetectorView(
                context.timeline, drawn, context.colours, lanes, context.span_ns
            )
        return self._detectors[key]

    def trace(self, block: TraceBlock) -> None:
        """Take a piece of a decision function."""
        self._of(block.spec).trace(block)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        self._of(block.spec).candidates(block)

    def gap(self, gap: Gap) -> None:
        """Take a gap: curves of its topic end there."""
        for (_, topic), detector in self._detectors.items():
            if topic == gap.topic and not gap.bridged:
                detector.interrupt(gap.start_ns)

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; fill lanes up to a time."""
        for detector in self._detectors.values():
            detector.flush(before_ns)

    kinds: ClassVar = {StageSpec: stage, TraceBlock: trace, CandidateBlock: candidates, Gap: gap}


class DetectorView:
    """Logs what one stage says about one topic.

    Parameters
    ----------
    timeline
        Where to.
    spec
        What its columns mean.
    colours
        Of the sensors.
    lanes
        Among which its own is; None where another part fills it.
    span_ns
        Over which the threshold is drawn: start and end [ns].
    """

    def __init__(
        self,
        timeline: Timeline,
        spec: StageSpec,
        colours: SensorColours,
        lanes: StageLanes | None,
        span_ns: tuple[int, int],
    ) -> None:
        self._timeline = timeline
        self._spec = spec
        self._path = f"/detector/{spec.stage}/{spec.topic.strip('/')}"
        self._size = 5.0 if len(spec.channels) <= FEW_CHANNELS else 3.0
        self._times: list[NDArray[np.int64]] = []
        self._decision: list[NDArray[np.float32]] = []
        self._candidates: list[CandidateBlock] = []
        self._undecided: list[tuple[int, bool, str]] = []
        shared = lanes is not None and lanes.shared(spec.emits)
        self._because = f"{spec.stage}: " if shared else "rejected: "
        rejections = [f"{self._because}{g.name}" for g in spec.gates]
        shades = (REJECTION_COLOURS[i % len(REJECTION_COLOURS)] for i in range(len(rejections)))
        accepted = STEP_COLOURS if step_like(spec) else {"accepted": ACCEPTED}
        if spec.emits == "disagreement":
            accepted, rejections = {DISAGREE: DISAGREEMENT}, []
        states = {**accepted, **dict(zip(rejections, shades, strict=False))}
        self._lane = lanes.of(spec.stage, spec.topic, states, spec.emits) if lanes else None
        if spec.trace:
            self._declare(colours)
            self._declare_threshold(span_ns)
        if spec.trace and not frames_decided(spec):
            self._declare_candidates()

    def _declare(self, colours: SensorColours) -> None:
        import rerun as rr

        spec, decision, gate = self._spec, self._spec.trace[0], decision_gate(self._spec)
        unit = f" [{decision.unit.replace('s2', 's²')}]" if decision.unit not in ("", "1") else ""
        limit = f", threshold {gate.threshold:g} in red" if gate else ""
        top = ceiling(spec)
        cut = f", cut at {top:g}" if top else ""
        title = f"{spec.stage} {spec.topic}: {decision.name.replace('_', ' ')}{unit}{limit}{cut}"
        lines = rr.SeriesLines(
            names=list(spec.channels),
            colors=np.array([colours.of(c) for c in spec.channels], np.uint32),
            aggregation_policy=rr.components.AggregationPolicy.Max,
            interpolation_mode=rr.components.InterpolationMode.StepAfter
            if frames_decided(spec)
            else None,
        )
        path = f"{self._path}/decision"
        entity = Entity(path, "detector", title, len(spec.channels), top=top)
        self._timeline.declare(entity, lines)

    def _declare_threshold(self, span_ns: tuple[int, int]) -> None:
        import rerun as rr

        gate = decision_gate(self._spec)
        if gate is None:
            return
        path = f"{self._path}/threshold"
        style = rr.SeriesLines(
            names=f"threshold {gate.threshold:g}",
            colors=np.array([THRESHOLD], np.uint32),
            widths=1.5,
            interpolation_mode=rr.components.InterpolationMode.StepAfter,
        )
        self._timeline.static(path, style)
        self._timeline.level(path, span_ns, gate.threshold)

    def _declare_candidates(self) -> None:
        import rerun as rr

        for verdict, colour, marker, size in (
            ("rejected", REJECTED, rr.components.MarkerShape.Cross, 2.5),
            ("accepted", ACCEPTED, rr.components.MarkerShape.Down, self._size),
        ):
            style = rr.SeriesPoints(
                names=verdict,
                colors=np.array([colour], np.uint32),
                markers=marker,
                marker_sizes=size,
            )
            self._timeline.static(f"{self._path}/{verdict}", style)

    def trace(self, block: TraceBlock) -> None:
        """Take a piece of the decision function."""
        if self._spec.trace:
            self._times.append(block.time_ns)
            self._decision.append(block.value[:, :, 0])

    def interrupt(self, time_ns: int) -> None:
        """End the curves at a gap: the viewer would draw a line across it."""
        self._times.append(np.array([time_ns]))
        self._decision.append(np.full((1, len(self._spec.channels)), np.nan, np.float32))

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        self._candidates.append(block)

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; fill the lane up to a time, as channels lag behind each other."""
        if self._times:
            times, values = np.concatenate(self._times), np.concatenate(self._decision)
            self._timeline.scalars(f"{self._path}/decision", times, values)
        if self._candidates:
            self._log_candidates(shown_rows(joined(self._candidates)))
        self._times, self._decision, self._candidates = [], [], []
        if self._lane is not None:
            self._fill_lane(self._lane, before_ns)

    def _log_candidates(self, block: CandidateBlock) -> None:
        if self._spec.trace and not frames_decided(self._spec):
            values = decision_values(block)
            values = np.minimum(values, TOP_EDGE * (ceiling(self._spec) or np.inf))
            for verdict, rows in (("accepted", block.accepted), ("rejected", ~block.accepted)):
                if rows.any():
                    path = f"{self._path}/{verdict}"
                    self._timeline.scalars(path, block.time_ns[rows], values[rows][:, np.newaxis])
        if self._lane is not None:
            first = np.argmax(~(block.margin >= 0), axis=1) if block.margin.shape[1] else []
            gates = [self._spec.gates[i].name for i in first] or ["?"] * len(block)
            candidates = zip(block.time_ns.tolist(), block.accepted.tolist(), gates, strict=True)
            self._undecided += candidates

    def _fill_lane(self, lane: Lane, before_ns: int | None) -> None:
        decided = sorted(self._undecided)
        times = np.array([d[0] for d in decided], np.int64)
        ready = len(decided) if before_ns is None else int(np.searchsorted(times, before_ns))
        accepted = np.array([d[1] for d in decided[:ready]], np.bool_)
        for i in coincident(times[:ready], accepted, MARK_NS):
            state = self._state(bool(accepted[i]), decided[i][2])
            if state:
                lane.add(int(times[i]), state)
        self._undecided = decided[ready:]

    def _state(self, accepted: bool, gate: str) -> str:
        """Return what the lane says of a candidate; nothing of what is shown elsewhere."""
        if self._spec.emits == "disagreement":  # localizers that agree are as they should be
            return DISAGREE if accepted else ""
        if not accepted:
            return f"{self._because}{gate}"
        elsewhere = self._spec.emits in PLACING or self._spec.emits in TOLD
        return "" if elsewhere or step_like(self._spec) else "accepted"


#: How much is drawn around a step [s].
BEFORE_S, AFTER_S = 0.1, 0.1
#: Pickers look so far ahead at most [s].
LOOK_AHEAD_S = 0.05
#: A picker's past is forgotten after so many times its longest time.
RUN_INS = 5.0
#: Parameters of a picker that finds no candidates, and of one whose noise is trusted at once, as it
#: is in a run that began long before.
CURVE_ALONE, TRUSTED = {"floor": np.inf}, {"warm_up_s": 0.0}
#: Steps of the value axis, about a pixel each: samples that change nothing need no row.
LEVELS = 128


class PickerCurves(View):
    """The decision functions of the stages that pick in a room, around steps."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._curves: list[PickerCurve] = []

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether anything is shown at every sample around steps in a room."""
        return context.session.application == "room" and context.plan.mode != "none"

    def stage(self, spec: StageSpec) -> None:
        """Take a stage."""
        context = self._context
        if spec.emits == "pick" and spec.trace:
            self._curves.append(PickerCurve(context, spec))

    def near(self, time_ns: int) -> None:
        """Log the curves around a moment."""
        for curve in self._curves:
            curve.show(time_ns)

    kinds: ClassVar = {StageSpec: stage}


class PickerCurve:
    """Logs the decision function of one picking stage on one topic.

    It costs as much as picking itself, so it is computed around moments alone.

    Parameters
    ----------
    context
        Where to, and the pipeline that says what the stage runs.
    spec
        The stage.
    """

    def __init__(self, context: ViewContext, spec: StageSpec) -> None:
        self._timeline = context.timeline
        self._traces = context.traces
        self._spec = spec
        self._colours = context.colours
        self._path = f"/decision/{spec.stage}/{spec.topic.strip('/')}"
        self._top = ceiling(spec)
        self._retold = RecomputedCurve(context.session, spec)
        self._declared = False

    def show(self, time_ns: int) -> None:
        """Log the curve around a moment."""
        times, values = self._around(time_ns)
        if not len(times):
            return
        if not self._declared:
            self._declare()
            self._declared = True
        times, values = self._drawn(times, values)
        # the viewer would draw a line to the next step
        ended = np.full((1, values.shape[1]), np.nan)
        end_ns = times[-1:] + 1
        self._timeline.scalars(
            self._path, np.concatenate([times, end_ns]), np.concatenate([values, ended])
        )

    def _around(self, time_ns: int) -> Piece:
        """Return the curve about a moment, of a run that begins long enough before it."""
        start_ns, end_ns = time_ns - round(BEFORE_S * NS_PER_S), time_ns + round(AFTER_S * NS_PER_S)
        early_ns = start_ns - round((self._retold.run_in_s + FRAME_S) * NS_PER_S)
        late_ns = end_ns + round(LOOK_AHEAD_S * NS_PER_S)
        run = _last_run(self._traces.blocks(self._spec.topic, early_ns, late_ns), time_ns)
        under_way = bool(run) and run[0].first > 0
        self._retold.restart(CURVE_ALONE | (TRUSTED if under_way else {}))
        pieces = []
        for block in run:
            begin = block.index_of(start_ns)
            self._retold.skip(block.slice(0, begin))
            curve = self._retold.feed(block.slice(begin, len(block)))
            if curve is not None:
                first, last = np.searchsorted(curve.time_ns, [start_ns, end_ns])
                pieces.append((curve.time_ns[first:last], curve.value[first:last]))
        if not pieces:
            return np.empty(0, np.int64), np.empty((0, 0))
        return np.concatenate([p[0] for p in pieces]), np.concatenate([p[1] for p in pieces])

    def _drawn(self, times: NDArray[np.int64], values: NDArray[np.float64]) -> Piece:
        """Return the samples that make the drawn curve: the first and last of equal ones."""
        if not self._top:
            return times, values
        grain = self._top / LEVELS
        level = np.round(np.minimum(values, self._top) / grain)
        changed = (np.diff(level, axis=0) != 0).any(axis=1)
        retained = np.append(changed, True) | np.append(True, changed)
        return times[retained], level[retained] * grain

    def _declare(self) -> None:
        import rerun as rr

        spec, gate = self._spec, decision_gate(self._spec)
        decision = spec.trace[0]
        limit = f", threshold {gate.threshold:g} in red" if gate else ""
        unit = f" [{decision.unit}]" if decision.unit not in ("", "1") else ""
        title = (
            f"{spec.stage} {spec.topic}: {decision.name.replace('_', ' ')}{unit} "
            f"at every sample{limit}"
        )
        lines = rr.SeriesLines(
            names=list(spec.channels),
            colors=np.array([self._colours.of(c) for c in spec.channels], np.uint32),
            aggregation_policy=rr.components.AggregationPolicy.Max,
        )
        channels = len(spec.channels)
        self._timeline.declare(
            Entity(self._path, "decision", title, channels, top=self._top), lines
        )


def _last_run(blocks: Sequence[SignalBlock], time_ns: int) -> list[SignalBlock]:
    """Return the blocks of the run that a moment lies in, from the begin of one of its frames."""
    run: list[SignalBlock] = []
    for block in blocks:
        if run and not block.continues(run[-1]):
            if run[-1].end_ns > time_ns:
                break
            run = []
        run.append(block)
    if not run:
        return []
    # cells are of the samples that they are of in a run from the beginning
    frame = max(1, round(FRAME_S * run[0].stream.rate_hz))
    return [run[0].slice(-run[0].first % frame, len(run[0])), *run[1:]]


class RecomputedCurve:
    """The curve of one stage on one topic.

    Parameters
    ----------
    session
        Its pipeline says what the stage runs.
    spec
        The stage.
    """

    def __init__(self, session: ReplaySession, spec: StageSpec) -> None:
        self._topic = spec.topic
        self._spec = spec
        plugin = used(session, spec)
        self._used = plugin if plugin is not None and hasattr(plugin.kind, "curve") else None
        self.restart({})

    @property
    def has_curve(self) -> bool:
        """Whether there is a curve: the stage is known, and its detector tells one."""
        return self._stage is not None

    @property
    def run_in_s(self) -> float:
        """How long the stage must have run until its past is forgotten [s].

        That is some times the longest time, or the period of the lowest frequency, that it measures
        by.
        """
        if self._used is None:
            return 0.0
        given = self._used.parameters
        infos = (info for info in describe(type(given)) if info.part == "measure")
        quantities = [(info.unit, getattr(given, info.name)) for info in infos]
        times = [value for unit, value in quantities if unit == "s"]
        periods = [1 / value for unit, value in quantities if unit == "Hz" and value > 0]
        return RUN_INS * max([*times, *periods], default=0.0)

    def restart(self, changes: Mapping[str, float]) -> None:
        """Begin the stage anew, with changes to those of its parameters that it has."""
        self._last: Curve | None = None
        self._stage: StageRunner | None = None
        if self._used is not None:
            config = StageConfig(self._spec.plugin, self._spec.stage, self._used.topics)
            given = self._used.parameters
            overrides = {name: value for name, value in changes.items() if hasattr(given, name)}
            self._stage = StageRunner(config, self._used.kind, replace(given, **overrides))

    def skip(self, item: SignalBlock | Gap) -> None:
        """Take what the stage is given, a block or a gap."""
        if self._stage is not None and item.topic == self._topic:
            self._stage.process(item)

    def feed(self, item: SignalBlock | Gap) -> Curve | None:
        """Take what the stage is given, a block or a gap; return the curve completed by it."""
        if self._stage is None or item.topic != self._topic:
            return None
        self._stage.process(item)
        return self._completed(self._stage)

    def flush(self) -> Curve | None:
        """End the recording; return the curve that was held back."""
        if self._stage is None:
            return None
        self._stage.flush()
        return self._completed(self._stage)

    def _completed(self, stage: StageRunner) -> Curve | None:
        """Return what is new: a detector that holds nothing back tells its last piece again."""
        curve = stage.curve(self._topic)
        if curve is None or curve is self._last:
            return None
        self._last = curve
        return curve if len(curve.time_ns) else None


#: Detectors look ahead for less than this; so much of the curve is kept for their candidates.
KEEP_NS = 60 * NS_PER_S
#: A step is timed at most this far from its peak, and a valley lies at most this far from one.
PEAK_NS, VALLEY_NS = NS_PER_S // 4, 6 * NS_PER_S // 5
#: A mark lies on the curve where that comes this close to the value of the candidate.
EXACT = 1e-4


def worn(context: ViewContext) -> bool:
    """Whether a session is of worn sensors, or of no application."""
    return context.session.application not in ("room", "vehicle")


class StepCurves(View):
    """The curves of the stages that find steps by worn sensors."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._curves: dict[tuple[str, str], StepCurve] = {}
        self._last: dict[str, SignalBlock] = {}  # of each topic: a stage is told after its first

    fits = staticmethod(worn)

    def stage(self, spec: StageSpec) -> None:
        """Take a stage: one whose curve is known is drawn here alone."""
        context, key = self._context, (spec.stage, spec.topic)
        if step_like(spec) and spec.trace and key not in self._curves:
            curve = StepCurve(context.timeline, context.session, spec, context.span_ns)
            if curve.has_curve:
                self._curves[key] = curve
                context.drawn.add(key)
                if spec.topic in self._last:
                    curve.feed(self._last[spec.topic])

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        self._last[block.topic] = block
        for curve in self._curves.values():
            curve.feed(block)

    def gap(self, gap: Gap) -> None:
        """Take a gap."""
        for curve in self._curves.values():
            curve.interrupt(gap)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        curve = self._curves.get((block.spec.stage, block.spec.topic))
        if curve is not None:
            curve.candidates(block)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log the candidates that the curves have come past."""
        for curve in self._curves.values():
            curve.flush()

    def close(self) -> None:
        """Log what was held back."""
        for curve in self._curves.values():
            curve.close()

    kinds: ClassVar = {StageSpec: stage, SignalBlock: signal, Gap: gap, CandidateBlock: candidates}


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
        self, timeline: Timeline, session: ReplaySession, spec: StageSpec, span_ns: tuple[int, int]
    ) -> None:
        self._timeline = timeline
        self._spec = spec
        self._retold = RecomputedCurve(session, spec)
        self._root = f"/detector/{spec.stage}/{spec.topic.strip('/')}"
        self._times = np.empty(0, np.int64)
        self._values = np.empty(0)
        self._waiting: list[CandidateBlock] = []
        if self.has_curve:
            self._declare(span_ns)

    @property
    def has_curve(self) -> bool:
        """Whether the detector tells its curve."""
        return self._retold.has_curve

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
        if self.has_curve:
            self._waiting.append(block)

    def flush(self, *, final: bool = False) -> None:
        """Log the candidates that the curve has come past."""
        end_ns = self._times[-1] - VALLEY_NS if len(self._times) else 0
        ready = [b for b in self._waiting if final or b.time_ns[-1] <= end_ns]
        self._waiting = self._waiting[len(ready) :]
        for block in ready:
            self._mark(block)
        if len(self._times):
            recent = self._times > self._times[-1] - KEEP_NS
            self._times, self._values = self._times[recent], self._values[recent]

    def close(self) -> None:
        """Log what was held back."""
        self._add(self._retold.flush())
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
                self._append_marks(block, int(row), peaks, valleys)
            for what, (times, values) in (("peak", peaks), ("valley", valleys)):
                if times:
                    path = f"{self._root}/{verdict}/{what}"
                    self._timeline.scalars(path, times, np.array(values)[:, np.newaxis])

    def _append_marks(self, block: CandidateBlock, row: int, peaks: Marks, valleys: Marks) -> None:
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
        key = "\u25cf accepted green, \u00d7 rejected"
        title = f"{spec.stage} {spec.topic}: filtered{unit}, {key}{limit}"
        lines = rr.SeriesLines(
            names="filtered",
            colors=np.array([CURVE], np.uint32),
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        self._timeline.declare(Entity(f"{self._root}/decision", "detector", title), lines)
        if gate is not None:
            style = rr.SeriesLines(names="threshold", colors=np.array([THRESHOLD], np.uint32))
            self._timeline.static(f"{self._root}/threshold", style)
            self._timeline.level(f"{self._root}/threshold", span_ns, gate.threshold)
        self._declare_marks()

    def _declare_marks(self) -> None:
        import rerun as rr

        shapes = rr.components.MarkerShape
        for path, colour, marker, size in (
            ("rejected/valley", REFUSED, shapes.Cross, 2.5),
            ("rejected/peak", REFUSED, shapes.Cross, 4.0),
            ("accepted/valley", VALLEY, shapes.Up, 3.5),
            ("accepted/peak", ACCEPTED, shapes.Circle, 4.5),
        ):
            verdict, what = path.split("/")
            style = rr.SeriesPoints(
                names=f"{what}, {verdict}",
                colors=np.array([colour], np.uint32),
                markers=marker,
                marker_sizes=size,
            )
            self._timeline.static(f"{self._root}/{path}", style)


#: Labels without a lane, and those that share one.
ELSEWHERE = frozenset({"waypoint", "heading"})
TOGETHER = {"ignore": "walking", "trailing": "step"}
GAP_COLOURS = {"missing": LOSS, "damage": LOSS, "clock step": IMPACT, "duplicate": SPAN}


class PickView(View):
    """Picks of the stage with the last word: marks on the waveform, rows of a table, log lines."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._timeline = context.timeline
        self._colours = context.colours
        self._lines = context.lines
        self._pending: list[tuple[Pick, float]] = []

    def pick(self, pick: Pick) -> None:
        """Take a pick: its line would hide those of steps, where a stage finds steps."""
        context = self._context
        if not context.stages.decides("pick", pick):
            return
        context.opens(pick.time_ns)
        self._pending.append((pick, context.traces.of_pick(pick)))
        if context.stages.last("step") is not None:
            return
        context.answers_ns.append(pick.time_ns)
        if "pick" in context.summed:
            return
        spread = f" ± {pick.uncertainty_s * 1e3:.2g} ms" if pick.uncertainty_s >= 0 else ""
        where = self._timeline.seconds(pick.time_ns)
        text = (
            f"{where}{spread}  pick {pick.channel}, peak {readable(pick.value, 3)} ({pick.stage})"
        )
        self._lines.add("picks", pick.time_ns, text, "INFO")

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        import rerun as rr

        for topic in dict.fromkeys(p.topic for p, _ in self._pending):
            marks = [(p, height) for p, height in self._pending if p.topic == topic]
            path = f"/picks/{topic.strip('/')}"
            style = rr.SeriesPoints(markers="down", marker_sizes=7.0, names="pick")
            self._timeline.declare(Entity(path, "mark"), style)
            colours = np.array([self._colours.of(p.channel) for p, _ in marks], np.uint32)
            columns = [
                *rr.Scalars.columns(scalars=np.array([height for _, height in marks])),
                *rr.SeriesPoints.columns(colors=colours),
            ]
            self._timeline.send(path, [p.time_ns for p, _ in marks], columns)
        if self._pending:
            self._rows([p for p, _ in self._pending])
        self._pending = []

    def _rows(self, picks: list[Pick]) -> None:
        import pyarrow as pa
        import rerun as rr

        self._timeline.declare(Entity("/table/picks", "table", "Picks"))
        columns = rr.AnyValues.columns(
            channel=pa.array([p.channel for p in picks]),
            stage=pa.array([p.stage for p in picks]),
            peak=pa.array([p.value for p in picks]),
            uncertainty_ms=pa.array([p.uncertainty_s * 1e3 for p in picks]),
        )
        self._timeline.send("/table/picks", [p.time_ns for p in picks], columns)

    kinds: ClassVar = {Pick: pick}


class StepView(View):
    """Steps and impacts: lanes; of the stage with the last word marks, rows and lines."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._timeline = context.timeline
        self._lines = context.lines
        self._pending: list[StepEvent] = []

    def step(self, step: StepEvent) -> None:
        """Take a step."""
        context = self._context
        lane = context.lanes.of(step.stage, step.topic)
        lane.add(step.time_ns, step.type or step.foot or step.kind)
        if not context.stages.decides("step", step):
            return
        context.opens(step.time_ns)
        context.answers_ns.append(step.time_ns)
        self._pending.append(step)
        what = " ".join(filter(None, (step.type or step.foot, step.kind)))
        seen = f"{step.channels} channels" if step.channels > 1 else ""
        where = self._timeline.seconds(step.time_ns)
        text = ", ".join(filter(None, (f"{where}  {what}", step.value_text, seen)))
        text += f" ({step.stage})"
        self._lines.add("steps", step.time_ns, text, "INFO")

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        for topic in dict.fromkeys(s.topic for s in self._pending):
            self._marks(topic, [s for s in self._pending if s.topic == topic])
        if self._pending:
            self._rows(self._pending)
        self._pending = []

    def _marks(self, topic: str, steps: list[StepEvent]) -> None:
        """Log a step as an upright over the curves: at no height, since none was measured."""
        import rerun as rr

        extent, kinds = self._context.traces.extent, STEP_COLOURS | TYPE_COLOURS
        ends = {s.time_ns: limits for s in steps if (limits := extent(topic, s.time_ns))}
        marked = [s for s in steps if s.time_ns in ends]
        if not marked:
            return
        path = f"/steps/{topic.strip('/')}"
        every = rr.components.AggregationPolicy.Off  # else an upright may lose its end
        style = rr.SeriesLines(names="step", widths=1.0, aggregation_policy=every)
        self._timeline.declare(Entity(path, "mark"), style)
        shades = [kinds.get(s.type or s.foot or s.kind, STEP) for s in marked]
        heights = np.array([(*ends[s.time_ns], np.nan) for s in marked])
        columns = [
            scalar_column(heights.reshape(-1, 1)),
            *rr.SeriesLines.columns(colors=np.repeat(np.array(shades, np.uint32), 3)),
        ]
        times = np.repeat([s.time_ns for s in marked], 3) + np.tile([0, 0, 1], len(marked))
        self._timeline.send(path, times, columns)

    def _rows(self, steps: list[StepEvent]) -> None:
        import pyarrow as pa
        import rerun as rr

        self._timeline.declare(Entity("/table/steps", "table", "Steps"))
        columns = rr.AnyValues.columns(
            kind=pa.array([s.kind for s in steps]),
            foot=pa.array([s.foot for s in steps]),
            type=pa.array([s.type for s in steps]),
            stage=pa.array([s.stage for s in steps]),
            peak=pa.array([s.value for s in steps]),
            channels=pa.array([s.channels for s in steps]),
        )
        self._timeline.send("/table/steps", [s.time_ns for s in steps], columns)

    kinds: ClassVar = {StepEvent: step}


#: Filled gaps of so long are one line of the log [ns]. Chosen by judgement: a line for each lost
#: packet, or a second of each topic, buries the steps.
GAPS_NS = 10 * NS_PER_S


class LossView(View):
    """Interruptions: a lane and log lines, one for all gaps of ten seconds that were filled."""

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline
        self._lines = context.lines
        self._lane = Lane(context.timeline, GAPS, GAP_COLOURS)
        self._filled: dict[str, list[Gap]] = {}

    def gap(self, gap: Gap) -> None:
        """Take a gap."""
        self._lane.add(gap.start_ns, gap.reason, gap.end_ns)
        if not gap.filled:
            self._say([gap])
            return
        filled = self._filled.setdefault(gap.topic, [])
        if filled and gap.start_ns >= filled[0].start_ns + GAPS_NS:
            self._say(filled)
            filled.clear()
        filled.append(gap)

    def _say(self, gaps: Sequence[Gap]) -> None:
        first, lost = gaps[0], sum(gap.lost for gap in gaps)
        lasting_s = (gaps[-1].end_ns - first.start_ns) / NS_PER_S
        lasting = f"{lasting_s:.1f} s" if lasting_s >= 1 else f"{1e3 * lasting_s:.1f} ms"
        state = f"{'filled, ' if first.filled else ''}state {'kept' if first.bridged else 'reset'}"
        many = f" in {len(gaps)} gaps within" if len(gaps) > 1 else ","
        where = self._timeline.seconds(first.start_ns)
        text = f"{where}  {first.reason} {first.topic}: {lost} lost{many} {lasting}, {state}"
        self._lines.add("gaps", first.start_ns, text, "INFO" if first.filled else "WARN")

    def flush(self, before_ns: int | None = None) -> None:
        """Log the lane and the lines up to a time."""
        self._lane.flush(before_ns)
        for filled in self._filled.values():
            if filled and (before_ns is None or filled[0].start_ns + GAPS_NS < before_ns):
                self._say(filled)
                filled.clear()

    kinds: ClassVar = {Gap: gap}


class PlainView(View):
    """Kinds of events that have no view of their own: a lane and a line of the log each."""

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline
        self._lines = context.lines
        self._lanes: dict[str, Lane] = {}

    def add(self, event: Any) -> None:
        """Take an event."""
        kind = EVENTS[type(event)]
        if kind.plural not in self._lanes:
            path = f"/state/{LAST}-{kind.plural}"
            self._lanes[kind.plural] = Lane(self._timeline, path, {kind.name: SPAN})
        self._lanes[kind.plural].add(event.time_ns, kind.name, getattr(event, "end_ns", None))
        if text := kind.text(event):
            source = getattr(event, "stage", "")
            timed_text = f"{self._timeline.seconds(event.time_ns)}  {text}"
            line = f"{timed_text} ({source})" if source else timed_text
            self._lines.add(kind.plural, event.time_ns, line, getattr(event, "level", "INFO"))

    def flush(self, before_ns: int | None = None) -> None:
        """Log the lanes up to a time."""
        for lane in self._lanes.values():
            lane.flush(before_ns)


class NoteView(View):
    """Notes: lines of the log."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context

    def note(self, note: Note) -> None:
        """Take a note."""
        source = f" ({note.source})" if note.source else ""
        text = f"{self._context.timeline.seconds(note.time_ns)}  {note.text}{source}"
        self._context.lines.add("notes", note.time_ns, text, note.level)

    kinds: ClassVar = {Note: note}


def lane_labels(session: ReplaySession) -> list[Label]:
    """Return the labels that have lanes: of a room with steps not the walk as a whole.

    It would say nothing more, unless parts of it are ignored. Passes of vehicles have lanes by
    direction.
    """
    kinds = {label.kind for label in session.labels}
    needless = session.application == "room" and "step" in kinds and "ignore" not in kinds
    hidden = {"walking"} if needless else set()
    hidden |= {"pass"} if session.application == "vehicle" else set()
    return [x for x in session.labels if x.kind not in hidden]


def log_truth(timeline: Timeline, labels: Iterable[Label], root: str = "/state/truth") -> None:
    """Log a lane for every kind of label, below ``root``.

    Places alone are on the map, headings have a plot, and arrivals follow from the step or impact
    they belong to. Of several targets the lane says which.
    """
    truth = tuple(labels)
    targets = sorted({x.target for x in truth if x.target})
    walkers = dict(zip(targets, cycle(WALKER_COLOURS), strict=False)) if len(targets) > 1 else {}
    caused = any(x.kind in ("step", "impact") for x in truth)
    kinds = STEP_COLOURS | TYPE_COLOURS
    lanes: dict[str, Lane] = {}
    for label in truth:
        if label.kind in ELSEWHERE or (label.kind == "pick" and caused):
            continue
        name = TOGETHER.get(label.kind, label.kind)
        colours = {name: SPAN, "ignore": IGNORED, "disturbed": DISTURBED} | kinds | walkers
        colours |= {"step": TRUTH}  # green would say that it was found
        lane = lanes.setdefault(name, Lane(timeline, f"{root}/{name}", colours))
        shown = label.label if label.label in kinds and label.kind == name else label.kind
        if label.kind in ("step", "impact") and label.target in walkers:
            shown = label.target
        lane.add(label.time_ns, shown, label.end_ns)
        if label.kind == "ignore":
            _resume(lane, label, truth)
    for lane in lanes.values():
        lane.flush()


def _resume(lane: Lane, ignored: Label, labels: Iterable[Label]) -> None:
    """Go on with the walk after a part of it that is ignored."""
    if ignored.end_ns is None:
        return
    for label in labels:
        if label.kind == "walking" and label.time_ns <= ignored.end_ns < (label.end_ns or 0):
            lane.add(ignored.end_ns, "walking", label.end_ns)


#: A plot's source, and the columns of its masses: on peak, no peak, either; combined also K.
PLOTS = (
    (
        "accelerometer",
        ("accelerometer_peak", "accelerometer_nonpeak", "accelerometer_peak_ignorance"),
    ),
    ("gyroscope", ("gyroscope_peak", "gyroscope_nonpeak", "gyroscope_peak_ignorance")),
    ("combined", ("peak_mass", "nonpeak_mass", "peak_ignorance", "peak_conflict")),
)
NAMES = ("pic", "nonpic", "Θ", "K")
MASS_COLOURS = (PEAK, NO_PEAK, EITHER, CONFLICT)


class MassViews(View):
    """The masses of the stages that measure some, on worn sensors."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._stages: dict[tuple[str, str], MassView] = {}

    fits = staticmethod(worn)

    def stage(self, spec: StageSpec) -> None:
        """Take a stage."""
        key = (spec.stage, spec.topic)
        if MassView.fits(spec) and key not in self._stages:
            self._stages[key] = MassView(self._context.timeline, spec, self._context.span_ns)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates."""
        view = self._stages.get((block.spec.stage, block.spec.topic))
        if view is not None:
            view.candidates(block)

    kinds: ClassVar = {StageSpec: stage, CandidateBlock: candidates}


class MassView:
    """Logs the masses of one stage's candidates.

    Parameters
    ----------
    timeline
        Where to.
    spec
        The stage; its columns are masses.
    span_ns
        Of the recording: the plots begin and end with it [ns].
    """

    def __init__(self, timeline: Timeline, spec: StageSpec, span_ns: tuple[int, int]) -> None:
        self._timeline = timeline
        self._root = f"/masses/{spec.stage}/{spec.topic.strip('/')}"
        names = [q.name for q in spec.columns]
        self._columns = {
            source: [names.index(column) for column in columns] for source, columns in PLOTS
        }
        for source, columns in PLOTS:
            self._declare(source, len(columns))
            nothing = np.full(len(columns), np.nan)
            timeline.level(f"{self._root}/{source}/lines", span_ns, nothing)

    @staticmethod
    def fits(spec: StageSpec) -> bool:
        """Whether a stage measures masses."""
        names = {q.name for q in spec.columns}
        return all(names.issuperset(columns) for _, columns in PLOTS)

    def candidates(self, block: CandidateBlock) -> None:
        """Log the masses of decided candidates."""
        if not len(block):
            return
        for source, columns in self._columns.items():
            values = block.value[:, columns]
            for kind in ("lines", "points"):
                self._timeline.scalars(f"{self._root}/{source}/{kind}", block.time_ns, values)

    def _declare(self, source: str, count: int) -> None:
        import rerun as rr

        conflict = ", their conflict K yellow" if source == "combined" else ""
        title = f"Masses, {source}: pic green, nonpic red, Θ grey{conflict}"
        colours = np.array(MASS_COLOURS[:count], np.uint32)
        points = rr.SeriesPoints(
            names=NAMES[:count],
            colors=colours,
            markers=["circle"] * count,
            marker_sizes=[3.0] * count,
        )
        # the lines only lead the eye from candidate to candidate
        faint = (colours & np.uint32(0xFFFFFF00)) | np.uint32(0x50)
        lines = rr.SeriesLines(
            names=[" "] * count,
            colors=faint,
            widths=[1.0] * count,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        path = f"{self._root}/{source}"
        self._timeline.declare(Entity(path, "masses", title, count, top=1.0))
        self._timeline.static(f"{path}/lines", lines)
        self._timeline.static(f"{path}/points", points)
