"""A detector on the timeline: decision function, threshold, candidates and why they failed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .lanes import MARK_NS, PLACING, coincident
from .palette import (
    ACCEPTED,
    DISAGREEMENT,
    REJECTED,
    REJECTION_COLOURS,
    STEP_COLOURS,
    THRESHOLD,
)
from .timeline import Entity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, GateSpec, StageSpec, TraceBlock

    from .lanes import Lane, StageLanes
    from .palette import SensorColours
    from .timeline import Timeline

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
    alike = [g for g in spec.gates if g.unit == decision.unit]
    return named[0] if named else alike[0] if len(alike) == 1 else None


def ceiling(spec: StageSpec) -> float:
    """Return where the decision function's plot ends; 0 lets the data say, as for units."""
    gate = decision_gate(spec)
    if gate is None or spec.trace[0].unit not in ("", "1") or not gate.at_least:
        return 0.0
    return CEILING * max(gate.threshold, 0.0)


def step_like(spec: StageSpec) -> bool:
    """Whether accepted candidates become steps, which have marks of their own on the lane."""
    return spec.emits in ("step", "impact")


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


class DetectorLog:
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
        self._timeline.scalars(path, span_ns, np.full((2, 1), gate.threshold))

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
        block = shown_rows(block)
        if self._spec.trace and not frames_decided(self._spec):
            self._candidates.append(block)
        first = np.argmax(~(block.margin >= 0), axis=1) if block.margin.shape[1] else []
        gates = [self._spec.gates[i].name for i in first] or ["?"] * len(block)
        if self._lane is not None:
            rows = zip(block.time_ns.tolist(), block.accepted.tolist(), gates, strict=True)
            self._undecided += rows

    def flush(self, before_ns: int | None = None) -> None:
        """Log what is pending; fill the lane up to a time, as channels lag behind each other."""
        if self._times:
            times, values = np.concatenate(self._times), np.concatenate(self._decision)
            self._timeline.scalars(f"{self._path}/decision", times, values)
        if self._candidates:
            times = np.concatenate([b.time_ns for b in self._candidates])
            values = np.concatenate([decision_values(b) for b in self._candidates])
            values = np.minimum(values, TOP_EDGE * (ceiling(self._spec) or np.inf))
            accepted = np.concatenate([b.accepted for b in self._candidates])
            for verdict, rows in (("accepted", accepted), ("rejected", ~accepted)):
                if rows.any():
                    path = f"{self._path}/{verdict}"
                    self._timeline.scalars(path, times[rows], values[rows][:, np.newaxis])
        self._times, self._decision, self._candidates = [], [], []
        if self._lane is not None:
            self._fill_lane(self._lane, before_ns)

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
