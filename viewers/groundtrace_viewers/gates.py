"""The evidence of a result: every gate's value against its threshold, without any signal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.explain.comparison import matched
from groundtrace.sinks import Session
from groundtrace_codecs.events import CandidateBlock, TraceBlock
from groundtrace_codecs.signals import NS_PER_S

from .detector import DetectorLog
from .events import log_truth
from .lanes import MARK_NS, Lane, StageLanes, coincident
from .moment import recording_at
from .palette import ACCEPTED, REJECTED, THRESHOLD, SensorColours
from .timeline import Entity, Timeline
from .verdict import COLOURS as VERDICTS
from .views import linked

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import rerun.blueprint as rrb
    from numpy.typing import NDArray

    from groundtrace.explain.evidence import Evidence, StageEvidence
    from groundtrace_codecs.events import GateSpec

APPLICATION = "groundtrace-why"
#: A gate's plot ends at this many thresholds: what decides lies near one.
CEILING = 3.0
#: Candidates beyond lie at this part of its height.
EDGE = 0.96
#: What is shown before and after a moment [s].
AROUND_S = 5.0
PASSED, FIRST, BEHIND = "passed", "fails first here", "fails behind another"
GATE_COLOURS = {PASSED: ACCEPTED, FIRST: THRESHOLD, BEHIND: 0xE8A33AFF}
CURSOR = 0xFFFFFFB0
PAGE = "/page"


@dataclass(frozen=True, slots=True)
class Focus:
    """Times [ns]: the moment a view is about, if any, and what the recording spans."""

    at_ns: int | None
    start_ns: int
    end_ns: int

    @property
    def window_ns(self) -> tuple[int, int]:
        """What is shown when it opens [ns]."""
        if self.at_ns is None:
            return self.start_ns, self.end_ns
        reach = round(AROUND_S * NS_PER_S)
        return self.at_ns - reach, self.at_ns + reach

    @property
    def at_s(self) -> float | None:
        """The moment since the first sample [s]."""
        return None if self.at_ns is None else (self.at_ns - self.start_ns) / NS_PER_S


def verdicts_of(margin: NDArray[np.float32]) -> NDArray[np.str_]:
    """Return what each gate made of each candidate, shape (n, n_gates) as ``margin``.

    ``passed``, ``fails first here`` (all gates before it passed) or ``fails behind another``.
    """
    passed = margin >= 0
    before = np.cumsum(~passed, axis=1) - ~passed
    return np.where(passed, PASSED, np.where(before == 0, FIRST, BEHIND))


def log_gates(timeline: Timeline, part: StageEvidence, focus: Focus) -> None:
    """Log a panel and a lane for each gate of a stage on a topic."""
    verdicts = verdicts_of(part.margin)
    for index, gate in enumerate(part.spec.gates):
        path = f"/gates/{part.spec.stage}/{part.spec.topic.strip('/')}/{index + 1}-{gate.name}"
        top = _panel(timeline, path, part, gate, focus)
        values = _drawn(part.gate_value[:, index].astype(np.float64), top)
        for verdict, colour in GATE_COLOURS.items():
            rows = verdicts[:, index] == verdict
            _points(timeline, f"{path}/{verdict.split()[-1]}", verdict, colour)
            if rows.any():
                times = part.candidates.time_ns[rows]
                timeline.scalars(f"{path}/{verdict.split()[-1]}", times, values[rows][:, None])
        log_moment(timeline, path, focus, top or float(np.nanmax(values, initial=gate.threshold)))
        _gate_lane(timeline, part, index, verdicts[:, index])


def _panel(
    timeline: Timeline, path: str, part: StageEvidence, gate: GateSpec, focus: Focus
) -> float:
    """Declare a gate's panel and draw its threshold; return where the panel ends, 0 if open."""
    import rerun as rr

    top = CEILING * gate.threshold if gate.threshold > 0 else 0.0
    unit = f" {gate.unit.replace('s2', 's²')}" if gate.unit not in ("", "1") else ""
    sign = "≥" if gate.at_least else "≤"
    cut = f", cut at {top:g}" if top else ""
    setting = f"{part.spec.stage}.{gate.parameter}"
    title = f"{part.spec.stage}: {gate.name} {sign} {gate.threshold:g}{unit} ({setting}{cut})"
    timeline.declare(Entity(path, "gate", title, 1, top=top))
    style = rr.SeriesLines(
        names=f"threshold {gate.threshold:g}", colors=np.array([THRESHOLD], np.uint32), widths=1.5
    )
    timeline.static(f"{path}/threshold", style)
    span = (focus.start_ns, focus.end_ns)
    timeline.scalars(f"{path}/threshold", span, np.full((2, 1), gate.threshold))
    return top


def _drawn(values: NDArray[np.float64], top: float) -> NDArray[np.float64]:
    """Bring values into a panel: those beyond its top lie at its edge."""
    limit = EDGE * top if top else np.max(values[np.isfinite(values)], initial=1.0)
    return np.minimum(values, limit)


def _points(timeline: Timeline, path: str, name: str, colour: int) -> None:
    import rerun as rr

    style = rr.SeriesPoints(
        names=name, colors=np.array([colour], np.uint32), markers="circle", marker_sizes=4.0
    )
    timeline.static(path, style)


def log_moment(timeline: Timeline, path: str, focus: Focus, top: float) -> None:
    """Draw an upright line at the moment, which a file shows where it cannot hold a cursor."""
    import rerun as rr

    if focus.at_ns is None:
        return
    style = rr.SeriesLines(names="moment", colors=np.array([CURSOR], np.uint32), widths=1.0)
    timeline.static(f"{path}/moment", style)
    times = (focus.at_ns, focus.at_ns + 1)
    timeline.scalars(f"{path}/moment", times, np.array([[0.0], [top]]))


def _gate_lane(
    timeline: Timeline, part: StageEvidence, index: int, verdicts: NDArray[np.str_]
) -> None:
    """Log what a gate made of candidates; of several channels at one moment, one that passed."""
    name = part.spec.gates[index].name
    lane = Lane(timeline, f"/state/{part.spec.stage}/{index + 1}-{name}", GATE_COLOURS)
    times = part.candidates.time_ns
    order = np.argsort(times, kind="stable")
    for row in coincident(times[order], verdicts[order] == PASSED, MARK_NS):
        lane.add(int(times[order][row]), str(verdicts[order][row]))
    lane.flush()


def log_detector(
    timeline: Timeline,
    part: StageEvidence,
    colours: SensorColours,
    lanes: StageLanes,
    focus: Focus,
) -> None:
    """Log the decision function of a stage with its threshold and candidates."""
    spec, found = part.spec, part.candidates
    log = DetectorLog(timeline, spec, colours, lanes, (focus.start_ns, focus.end_ns))
    log.trace(TraceBlock(spec, part.frames.time_ns, part.frames.value))
    verdicts = (part.gate_value, part.margin, part.accepted)
    log.candidates(CandidateBlock(spec, found.time_ns, found.channel, found.value, *verdicts))
    log.flush()


def log_verdicts_of(timeline: Timeline, evidence: Evidence, path: str, tolerance_s: float) -> None:
    """Log a lane of true steps hit and missed, and of false ones; nothing without truth."""
    if not any(label.kind == "step" for label in evidence.labels):
        return
    found = matched(evidence, tolerance_s)
    lane = Lane(timeline, path, VERDICTS)
    for name, times in (
        ("hit", found.truth_ns[found.pairs[:, 0]]),
        ("missed", found.truth_ns[found.missed]),
        ("false", found.found_ns[found.false]),
    ):
        for time_ns in times.tolist():
            lane.add(time_ns, name)
    lane.flush()


def why_view(
    evidence: Evidence,
    page: str,
    *,
    path: Path | None,
    spawn: bool = False,
    at_ns: int | None = None,
    tolerance_s: float = 0.12,
) -> None:
    """Show the evidence of a result, about one moment where one is given.

    Parameters
    ----------
    evidence
        What was decided.
    page
        What there is to say, markdown.
    path
        The ``.rrd`` to write; None with ``spawn`` alone.
    spawn
        Open the native viewer, its cursor at the moment.
    at_ns
        The moment [ns].
    tolerance_s
        Largest distance between a step and its detection [s].
    """
    import rerun as rr

    focus = Focus(at_ns, evidence.start_ns, evidence.end_ns)
    with recording_at(
        APPLICATION, evidence.name, path, spawn=spawn, at_s=focus.at_s
    ) as recording:
        timeline = Timeline(recording, evidence.start_ns)
        lanes, colours = StageLanes(timeline), SensorColours(session_of(evidence))
        for part in evidence.stages:
            log_detector(timeline, part, colours, lanes, focus)
            log_gates(timeline, part, focus)
        log_truth(timeline, evidence.labels)
        log_verdicts_of(timeline, evidence, "/state/score", tolerance_s)
        timeline.static(PAGE, rr.TextDocument(page, media_type="text/markdown"))
        recording.send_blueprint(layout(timeline.entities, focus))


def session_of(evidence: Evidence) -> Session:
    """Return what evidence says about its recording."""
    e = evidence
    return Session(
        e.name, e.config.application, e.start_ns, e.end_ns, (), None, e.labels, e.config.name
    )


def layout(entities: Sequence[Entity], focus: Focus) -> rrb.Blueprint:
    """Return the layout: what there is to say, beside panels that share their span of time."""
    import rerun.blueprint as rrb

    plots = [e for e in entities if e.role in ("detector", "gate")]
    panels = [_plot(e, focus) for e in plots]
    lanes = rrb.StateTimelineView(origin="/state", name="Gates, score, truth", time_view=_axis(focus))
    page = rrb.TextDocumentView(origin=PAGE, name="Why")
    stack = rrb.Vertical(*panels, lanes, row_shares=[1.0] * len(panels) + [2.0])
    return rrb.Blueprint(
        rrb.Horizontal(page, stack, column_shares=[1.0, 2.4]),
        rrb.TimePanel(state="collapsed", timeline="t", play_state="paused", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _plot(entity: Entity, focus: Focus) -> rrb.View:
    import rerun.blueprint as rrb

    origin = entity.path.removesuffix("/decision")
    return rrb.TimeSeriesView(
        origin=origin,
        name=entity.title,
        axis_x=_axis(focus),
        axis_y=rrb.ScalarAxis(range=(0.0, entity.top)) if entity.top else None,
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _axis(focus: Focus) -> rrb.TimeAxis:
    """Return the common axis of time, or the window around the moment.

    A linked axis has no window of its own.
    """
    import rerun.blueprint as rrb

    if focus.at_ns is None:
        return linked()
    first, last = (t - focus.start_ns for t in focus.window_ns)
    edge = rrb.TimeRangeBoundary.absolute
    window = rrb.TimeRange(start=edge(nanos=first), end=edge(nanos=last))
    return rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=window)
