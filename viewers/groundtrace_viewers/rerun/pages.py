"""Timelines about one thing: a comparison, a moment with its gates, the analysis of a room.

A recording about one moment opens there, with the cursor on it. A file cannot hold a cursor (rerun
0.41); that of a running viewer can be set.
"""

from __future__ import annotations

from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.explain.compare import A_RIGHT, B_RIGHT
from groundtrace.explain.reasons import matched, reason_at
from groundtrace.layout.analysis import region_at
from groundtrace.layout.report import (
    NAMES,
    advice_words,
    assumed,
    contribution_words,
    error_words,
    region_words,
    sign_words,
)
from groundtrace.pipeline.engine import ReplaySession
from groundtrace.pipeline.results import atomic_write, step_times, timeline_id
from groundtrace_codecs.events import CandidateBlock, TraceBlock
from groundtrace_codecs.signals import NS_PER_S

from ..errors import ViewerError
from .blueprint import linked
from .decisions import DetectorView, ceiling, decision_gate, log_truth
from .legible import legible, log, send_layout
from .process import connect, data_url, free_port, open_viewer
from .sink import Outlet, RerunSink
from .timeline import (
    ACCEPTED,
    FIX_COLOURS,
    LEFT,
    MARK_NS,
    OUTLINE,
    RIGHT,
    STEP,
    THRESHOLD,
    TIMELINE,
    Entity,
    Lane,
    SensorColours,
    StageLanes,
    Timeline,
    coincident,
    heat,
)
from .wrong_decisions import VERDICT_COLOURS

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    import rerun as rr
    import rerun.blueprint as rrb
    from numpy.typing import NDArray

    from groundtrace.explain.compare import Comparison
    from groundtrace.layout.analysis import Grid, RoomAnalysis
    from groundtrace.pipeline.results import Evidence, StageEvidence
    from groundtrace_codecs.events import Gap, GateSpec, Label

    Array = NDArray[np.float64]

COMPARE_APPLICATION = "groundtrace-compare"
#: What the lane of differences says, and its colours: who is right, or who alone has a step.
DIFFERS = {"A right": LEFT, "B right": RIGHT, "only A": LEFT, "only B": RIGHT}
WORDS = {
    **dict.fromkeys(A_RIGHT, "A right"),
    **dict.fromkeys(B_RIGHT, "B right"),
    "only A": "only A",
    "only B": "only B",
}


def compare_view(
    a: Evidence,
    b: Evidence,
    comparison: Comparison,
    page: str,
    *,
    path: Path | None,
    spawn: bool = False,
) -> None:
    """Show two results of one recording in one layout.

    Parameters
    ----------
    a, b
        What each decided.
    comparison
        Where they differ.
    page
        What there is to say, markdown.
    path
        The ``.rrd`` to write; may be None with ``spawn``.
    spawn
        Open the native viewer, its cursor at the first difference.

    Raises
    ------
    ViewerError
        Where the viewer does not start, or neither it nor a file is asked for.
    """
    focus = Focus(None, a.start_ns, a.end_ns)
    first = next((d.time_s for d in comparison.decisions if d.verdict in WORDS), None)
    opened = recording_at(COMPARE_APPLICATION, a.name, path, spawn=spawn, at_s=first)
    with opened as recording:
        timeline = Timeline(recording, a.start_ns)
        tops = _log_side(timeline, a, "A", focus, comparison.tolerance_s)
        tops |= _log_side(timeline, b, "B", focus, comparison.tolerance_s)
        _log_differences(timeline, comparison, a.start_ns)
        log_truth(timeline, about_steps(a.labels))
        log_page(timeline, page)
        entities = [replace(e, top=tops.get(e.path, e.top)) for e in timeline.entities]
        send_layout(recording, compare_layout(entities, focus))


def _log_side(
    timeline: Timeline, evidence: Evidence, name: str, focus: Focus, tolerance_s: float
) -> dict[str, float]:
    """Log one side; return where the plots of its decision functions end."""
    lanes, colours = StageLanes(timeline), SensorColours(session_of(evidence))
    tops: dict[str, float] = {}
    for part in evidence.stages:
        named = replace(part, spec=replace(part.spec, stage=f"{name}/{part.spec.stage}"))
        tops |= log_detector(timeline, named, evidence.gaps, colours, lanes, focus)
    log_score(timeline, evidence, f"/state/{name}", tolerance_s)
    return tops


def _log_differences(timeline: Timeline, comparison: Comparison, start_ns: int) -> None:
    lane = Lane(timeline, "/state/differs", DIFFERS)
    for decision in comparison.decisions:
        if decision.verdict in WORDS:
            lane.add(start_ns + round(decision.time_s * NS_PER_S), WORDS[decision.verdict])
    lane.flush()


def compare_layout(entities: Sequence[Entity], focus: Focus) -> rrb.Blueprint:
    """Return the layout: decision functions of both, and what came of them."""
    import rerun.blueprint as rrb

    plots = [e for e in entities if e.role == "detector"]
    lanes = sum(e.role == "lane" for e in entities)
    states = rrb.StateTimelineView(
        origin="/state", name="A, B, their differences and truth", time_view=focus.axis()
    )
    stack = [*(focus.plot(e) for e in plots), states]
    shares = [2.0] * len(plots) + [1.0 + 0.5 * lanes]
    return arranged(page_view("Comparison"), stack, shares)


@contextmanager
def recording_at(
    application: str, name: str, path: Path | None, *, spawn: bool, at_s: float | None
) -> Iterator[rr.RecordingStream]:
    """Open a recording that goes to a file, to a viewer started for it, or to both.

    Parameters
    ----------
    application
        Application id.
    name
        What it is about; the same name gives the same recording id.
    path
        The ``.rrd`` to write, or None.
    spawn
        Start the native viewer.
    at_s
        Where the started viewer's cursor is put in the end, since the first sample [s].

    Raises
    ------
    ViewerError
        Where neither a path nor a viewer is given, or the viewer does not start.
    """
    import rerun as rr

    if path is None and not spawn:
        raise ViewerError("viewer: expected a file or spawn, found none of them")
    recording = rr.RecordingStream(
        legible(application), recording_id=timeline_id(name), send_properties=False
    )
    port = free_port()
    viewer = open_viewer(["--expect-data-soon"], port) if spawn else None
    shown = [rr.GrpcSink(data_url(port))] if spawn else []
    with nullcontext() if path is None else atomic_write(path) as fresh:
        outlet = Outlet(recording, fresh, *shown, name=path)
        try:
            yield recording
            outlet.finish()
        except BaseException:
            outlet.end()
            if viewer is not None:
                viewer.terminate()
            raise
    if viewer is not None and at_s is not None:
        put_cursor(viewer, port, at_s)


def put_cursor(viewer: subprocess.Popen[bytes], port: int, at_s: float) -> None:
    """Pause a running viewer at a time since the first sample [s]."""
    connect(viewer, port).set_time(TIMELINE, duration=at_s, play_state="paused")


class MomentSink(RerunSink):
    """Shows a replay as :class:`RerunSink` does; a started viewer ends up at a given moment.

    Parameters
    ----------
    path, spawn, web
        As of :class:`RerunSink`.
    at_ns
        The moment [ns].
    """

    def __init__(
        self, path: Path | None = None, *, at_ns: int, spawn: bool = False, web: bool = False
    ) -> None:
        port = free_port()
        super().__init__(path, spawn=spawn, web=web, port=port, full_rate="all")
        self._data_port = port
        self._at_ns = at_ns
        self._start_ns = 0

    def open(self, session: ReplaySession) -> None:
        """Begin a replay."""
        self._start_ns = session.start_ns
        super().open(session)

    @property
    def _opens_ns(self) -> int | None:
        return self._at_ns

    def close(self) -> None:
        """End the replay, and go to the moment."""
        super().close()
        if self._spawn and self.viewer is not None:
            put_cursor(self.viewer, self._data_port, (self._at_ns - self._start_ns) / NS_PER_S)


WHY_APPLICATION = "groundtrace-why"
#: A gate's plot ends at this many thresholds: what decides lies near one.
CEILING = 3.0
#: Candidates beyond lie at this part of its height.
EDGE = 0.9
PASSED, FIRST, BEHIND = "passed", "fails here first", "fails behind another"
GATE_COLOURS = {PASSED: ACCEPTED, FIRST: THRESHOLD, BEHIND: 0xE8A33AFF}
#: Last parts of their paths; what is asked about comes first and so lies below.
ASKED, MARKS = "asked", {PASSED: "passed", FIRST: "first", BEHIND: "behind"}
ASKED_COLOUR = 0xFFFFFFFF


def verdicts_of(margin: NDArray[np.float32]) -> NDArray[np.str_]:
    """Return what each gate made of each candidate.

    Parameters
    ----------
    margin
        Shape (n, n_gates), >= 0 passes.

    Returns
    -------
    numpy.ndarray
        Shape (n, n_gates): ``passed``, ``fails here first`` where all gates before it passed, or
        ``fails behind another``.
    """
    failed = ~(margin >= 0)
    before: NDArray[np.intp] = np.cumsum(failed, axis=1) - failed
    return np.where(~failed, PASSED, np.where(before == 0, FIRST, BEHIND))


@dataclass(frozen=True, slots=True)
class Asked:
    """The candidate that the moment is about: its stage, topic, and row."""

    stage: str
    topic: str
    row: int

    def of(self, part: StageEvidence) -> list[int]:
        """Return its row, if it is one of this stage and topic."""
        mine = (self.stage, self.topic) == (part.spec.stage, part.spec.topic)
        return [self.row] if mine else []


def asked(evidence: Evidence, focus: Focus, tolerance_s: float) -> Asked | None:
    """Return the candidate that explains the moment, if there is one."""
    if focus.at_ns is None:
        return None
    reason = reason_at(evidence, focus.at_ns, tolerance_s)
    if reason.candidate_s is None:
        return None
    part = next(p for p in evidence.of(reason.stage) if p.spec.topic == reason.topic)
    candidates = part.candidates
    far = np.abs(candidates.time_ns - evidence.start_ns - round(reason.candidate_s * NS_PER_S))
    other = candidates.channel != part.spec.channels.index(reason.channel)
    return Asked(reason.stage, reason.topic, int(np.lexsort((far, other))[0]))


def log_gates(timeline: Timeline, part: StageEvidence, focus: Focus, about: Asked | None) -> None:
    """Log a panel and a lane for each gate of a stage on a topic."""
    verdicts = verdicts_of(part.margin)
    for index, gate in enumerate(part.spec.gates):
        path = f"/gates/{part.spec.stage}/{part.spec.topic.strip('/')}/{index + 1}-{gate.name}"
        top = gate_top(gate, part.gate_value[:, index], focus.within(part.candidates.time_ns))
        _panel(timeline, path, part.spec.stage, gate, top)
        span = (focus.start_ns, focus.end_ns)
        timeline.level(f"{path}/threshold", span, gate.threshold)
        values = np.minimum(part.gate_value[:, index].astype(np.float64), EDGE * top)
        rows = {mark: verdicts[:, index] == verdict for verdict, mark in MARKS.items()}
        chosen = np.isin(np.arange(len(values)), about.of(part) if about is not None else [])
        for mark, shown in {ASKED: chosen, **rows}.items():
            if shown.any():
                times = part.candidates.time_ns[shown]
                timeline.scalars(f"{path}/{mark}", times, values[shown][:, np.newaxis])
        log_moment(timeline, path, focus, top)
        _lane(timeline, part, index, verdicts[:, index])


def gate_top(gate: GateSpec, values: NDArray[np.float32], shown: NDArray[np.bool_]) -> float:
    """Return where a gate's panel ends: at a few thresholds, or above all that is shown first."""
    if gate.threshold > 0:
        return CEILING * gate.threshold
    finite = values[shown & np.isfinite(values)]
    return float(np.max(finite, initial=0.0)) / EDGE or 1.0


def _panel(timeline: Timeline, path: str, stage: str, gate: GateSpec, top: float) -> None:
    """Announce a gate's panel, and what its curves and points look like."""
    import rerun as rr

    unit = f" {gate.unit.replace('s2', 's²')}" if gate.unit not in ("", "1") else ""
    sign = "≥" if gate.at_least else "≤"
    name = f"{stage}.{gate.parameter}"
    title = f"{stage}: {gate.name} {sign} {gate.threshold:g}{unit} ({name}; cut at {top:.6g})"
    timeline.declare(Entity(path, "gate", title, top=top))
    red = np.array([THRESHOLD], np.uint32)
    line = rr.SeriesLines(names=f"threshold {gate.threshold:g}", colors=red, widths=1.5)
    timeline.static(f"{path}/threshold", line)
    for mark, words, colour, size in (
        (ASKED, "asked about", ASKED_COLOUR, 7.0),
        *((MARKS[v], v, colour, 4.0) for v, colour in GATE_COLOURS.items()),
    ):
        style = rr.SeriesPoints(
            names=words, colors=np.array([colour], np.uint32), markers="circle", marker_sizes=size
        )
        timeline.static(f"{path}/{mark}", style)


def _lane(timeline: Timeline, part: StageEvidence, index: int, verdicts: NDArray[np.str_]) -> None:
    """Log what a gate made of candidates; of several at one moment, of one that passed."""
    name = part.spec.gates[index].name
    lane = Lane(timeline, f"/state/{part.spec.stage}/{index + 1}-{name}", GATE_COLOURS)
    order = np.argsort(part.candidates.time_ns, kind="stable")
    times, verdicts = part.candidates.time_ns[order], verdicts[order]
    for row in coincident(times, verdicts == PASSED, MARK_NS):
        lane.add(int(times[row]), str(verdicts[row]))
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
    """Show the evidence of a result, around one moment where one is given.

    Parameters
    ----------
    evidence
        What was decided.
    page
        What there is to say, markdown.
    path
        The ``.rrd`` to write; may be None with ``spawn``.
    spawn
        Open the native viewer, its cursor at the moment.
    at_ns
        The moment [ns].
    tolerance_s
        Largest distance between a step and its detection [s].

    Raises
    ------
    ViewerError
        Where the viewer does not start, or neither it nor a file is asked for.
    """
    focus = Focus(at_ns, evidence.start_ns, evidence.end_ns)
    about = asked(evidence, focus, tolerance_s)
    opened = recording_at(WHY_APPLICATION, evidence.name, path, spawn=spawn, at_s=focus.at_s)
    with opened as recording:
        timeline = Timeline(recording, evidence.start_ns)
        lanes, colours = StageLanes(timeline), SensorColours(session_of(evidence))
        tops: dict[str, float] = {}
        for part in evidence.stages:
            tops |= log_detector(timeline, part, evidence.gaps, colours, lanes, focus)
            log_gates(timeline, part, focus, about)
        log_truth(timeline, about_steps(evidence.labels))
        log_score(timeline, evidence, "/state/score", tolerance_s)
        log_page(timeline, page)
        entities = [replace(e, top=tops.get(e.path, e.top)) for e in timeline.entities]
        send_layout(recording, why_layout(entities, focus))


def why_layout(entities: Sequence[Entity], focus: Focus) -> rrb.Blueprint:
    """Return the layout: what there is to say, beside panels over one span of time."""
    import rerun.blueprint as rrb

    plots = [e for e in entities if e.role in ("detector", "gate")]
    lanes = sum(e.role == "lane" for e in entities)
    stack = [
        *(focus.plot(e) for e in plots),
        rrb.StateTimelineView(
            origin="/state", name="Gates, score and truth", time_view=focus.axis()
        ),
    ]
    shares = [1.5 if e.role == "detector" else 1.0 for e in plots] + [1.0 + 0.36 * lanes]
    return arranged(page_view("Why"), stack, shares)


#: What is shown before and after a moment [s].
AROUND_S = 4.0
MOMENT_COLOUR = 0xFFFFFFC0
PAGE = "/page"
#: Space above the highest value of a plot, as part of it.
HEADROOM = 0.15


@dataclass(frozen=True, slots=True)
class Focus:
    """The moment [ns] that a view is about, or None, and the span of the recording [ns]."""

    at_ns: int | None
    start_ns: int
    end_ns: int

    @property
    def window_ns(self) -> tuple[int, int]:
        """What is shown at first [ns]."""
        if self.at_ns is None:
            return self.start_ns, self.end_ns
        reach = round(AROUND_S * NS_PER_S)
        return max(self.at_ns - reach, self.start_ns), min(self.at_ns + reach, self.end_ns)

    @property
    def at_s(self) -> float | None:
        """The moment, since the first sample [s]."""
        return None if self.at_ns is None else (self.at_ns - self.start_ns) / NS_PER_S

    def within(self, time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which times are shown at first."""
        first, last = self.window_ns
        return (time_ns >= first) & (time_ns <= last)

    def axis(self) -> rrb.TimeAxis:
        """Return the common axis of time, or around a moment one that begins with its window.

        A linked axis cannot have a window of its own.
        """
        import rerun.blueprint as rrb

        if self.at_ns is None:
            return linked()
        edge = rrb.TimeRangeBoundary.absolute
        first, last = (edge(nanos=t - self.start_ns) for t in self.window_ns)
        window = rrb.TimeRange(start=first, end=last)
        return rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=window)

    def plot(self, entity: Entity) -> rrb.View:
        """Return a plot of an entity and what belongs to it, from 0 to its top if it has one."""
        import rerun.blueprint as rrb

        return rrb.TimeSeriesView(
            origin=entity.path.removesuffix("/decision"),
            name=entity.title,
            axis_x=self.axis(),
            axis_y=rrb.ScalarAxis(range=(0.0, entity.top)) if entity.top else None,
            plot_legend=rrb.PlotLegend(visible=False),
        )


def page_view(name: str) -> rrb.View:
    """Return the page of what there is to say."""
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=PAGE, name=name)


def arranged(page: rrb.View, stack: Sequence[rrb.View], shares: Sequence[float]) -> rrb.Blueprint:
    """Return a layout: a page beside a stack of views with their shares of the height."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(page, rrb.Vertical(*stack, row_shares=shares), column_shares=[1.0, 2.4]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def session_of(evidence: Evidence) -> ReplaySession:
    """Return what evidence says of its recording."""
    e, config = evidence, evidence.config
    return ReplaySession(
        e.name, config.application, e.start_ns, e.end_ns, (), None, e.labels, config.name
    )


def about_steps(labels: Iterable[Label]) -> tuple[Label, ...]:
    """Return the labels that say when there were steps, and when that is known."""
    return tuple(x for x in labels if x.kind in ("step", "walking", "ignore"))


def log_page(timeline: Timeline, text: str) -> None:
    """Log what there is to say, markdown."""
    import rerun as rr

    timeline.static(PAGE, rr.TextDocument(text, media_type="text/markdown"))


def log_moment(timeline: Timeline, path: str, focus: Focus, top: float) -> None:
    """Draw an upright line at the moment: a file cannot hold a cursor."""
    import rerun as rr

    if focus.at_ns is None:
        return
    style = rr.SeriesLines(
        names="moment",
        colors=np.array([MOMENT_COLOUR], np.uint32),
        widths=1.0,
        aggregation_policy=rr.components.AggregationPolicy.MinMax,
    )
    timeline.static(f"{path}/moment", style)
    times = (focus.at_ns, focus.at_ns + 1)
    timeline.scalars(f"{path}/moment", times, np.array([[0.0], [top]]))


def log_detector(
    timeline: Timeline,
    part: StageEvidence,
    gaps: Iterable[Gap],
    colours: SensorColours,
    lanes: StageLanes,
    focus: Focus,
) -> dict[str, float]:
    """Log the decision function of a stage, its threshold and its candidates.

    Returns
    -------
    dict
        Path of the decision function to where its plot ends; empty where there is none.
    """
    spec, candidates = part.spec, part.candidates
    log = DetectorView(timeline, spec, colours, lanes, (focus.start_ns, focus.end_ns))
    log.trace(TraceBlock(spec, part.frames.time_ns, part.frames.value))
    for gap in gaps:
        if gap.topic == spec.topic and not gap.bridged:
            log.interrupt(gap.start_ns)
    verdicts = (part.gate_value, part.margin, part.accepted)
    log.candidates(
        CandidateBlock(spec, candidates.time_ns, candidates.channel, candidates.value, *verdicts)
    )
    log.flush()
    if not spec.trace:
        return {}
    top = decision_top(part, focus)
    origin = f"/detector/{spec.stage}/{spec.topic.strip('/')}"
    log_moment(timeline, origin, focus, top)
    return {f"{origin}/decision": top}


def decision_top(part: StageEvidence, focus: Focus) -> float:
    """Return where the plot of a decision function ends: above all that is shown at first."""
    top, gate = ceiling(part.spec), decision_gate(part.spec)
    if top:
        return top
    shown = part.frames.value[focus.within(part.frames.time_ns), :, 0]
    highest = max(float(np.nanmax(shown, initial=0.0)), gate.threshold if gate else 0.0)
    return (1.0 + HEADROOM) * highest or 1.0


def log_score(timeline: Timeline, evidence: Evidence, path: str, tolerance_s: float) -> None:
    """Log a lane of true steps hit and missed, and of false ones; without truth, of all steps."""
    lane = Lane(timeline, path, {**VERDICT_COLOURS, "step": STEP})
    if not any(label.kind == "step" for label in evidence.labels):
        for time_ns in step_times(evidence).tolist():
            lane.add(time_ns, "step")
        lane.flush()
        return
    match = matched(evidence, tolerance_s)
    for state, times in (
        ("hit", match.truth_ns[match.pairs[:, 0]]),
        ("missed", match.truth_ns[match.missed]),
        ("false", match.found_ns[match.false]),
    ):
        for time_ns in times.tolist():
            lane.add(time_ns, state)
    lane.flush()


ROOM_APPLICATION = "groundtrace-room-analysis"
#: Pixels along the longer side of a map, so that a lattice keeps its cells' borders.
PIXELS = 420
#: Around the room, as part of its longer side; more on the right, where the scale of colours is.
PAD, SCALE_PAD, SCALE_PART, SCALE_WIDTH = 0.14, 0.26, (0.07, 0.11), 12
SENSOR, MOST_RADIUS, LEAST_RADIUS = 0xFFFFFFFF, 16.0, 4.0
ADDED, MOVED = FIX_COLOURS[1], FIX_COLOURS[0]
REGION_BORDER = 0xFFFFFF60
#: Least end of the scale of confusion.
LEAST_SCALE = 0.1

READING = """
## How to read it

* Each map is the room from above, in metres; the bar at its right says what its colours mean. \
Error maps share one scale, so that localizers compare. Hover over a map for places.
* **Error maps**: root mean square distance between a step at that place and where the localizer \
puts it, over random errors of the arrivals. Red ring: the worst place.
* **Wrong signs**: how many signs of time differences are measured wrong on average, where the \
arrivals of each sensor err on their own.
* **Regions**: places with the same order of arrivals. Brighter: more of the steps inside are \
taken to be in a region beyond its neighbours. A ring marks a region that is ambiguous: tiny, \
like one far away but for two signs, or mostly confused.
* **Sensors**: a disc's size is by how much the mean error rises without that sensor. Turquoise: \
the best place tried for one more; peach: the best for the sensor that counts least, moved along \
the line.
* The velocity of the hyperbolic fit is calibrated in the same room without errors, and no arrival \
is late or missing: recordings will be worse. The power law is fitted by least squares.
"""


def room_view(analysis: RoomAnalysis, *, path: Path | None, spawn: bool = False) -> None:
    """Show an analysis.

    Parameters
    ----------
    analysis
        The analysis.
    path
        The ``.rrd`` to write; may be None with ``spawn``.
    spawn
        Open the native viewer.

    Raises
    ------
    ViewerError
        Where the viewer does not start, or neither it nor a file is asked for.
    """
    import rerun as rr

    with recording_at(
        ROOM_APPLICATION, analysis.layout.name, path, spawn=spawn, at_s=None
    ) as recording:
        top = max(float(errors.rmse_m.max()) for errors in analysis.errors)
        views = []
        for errors in analysis.errors:
            board = _Board(recording, f"/{errors.method}", analysis)
            board.image(analysis.grid, errors.rmse_m, top, "m")
            board.room()
            board.ring(np.array([analysis.worst(errors)]))
            views.append(board.view(error_words(analysis, errors).partition(";")[0]))
        views += [
            _signs(recording, analysis),
            _regions(recording, analysis),
            _sensors(recording, analysis),
        ]
        # the viewer wants a timeline even where nothing depends on time
        page = rr.TextDocument.columns(text=[room_page(analysis)], media_type=["text/markdown"])
        Timeline(recording, 0).send(PAGE, [0], page)
        send_layout(recording, _layout(views))


def room_page(analysis: RoomAnalysis) -> str:
    """Return the page about an analysis, markdown."""
    lines = [f"# {analysis.layout.name}", "", assumed(analysis.layout), ""]
    lines += [f"* {error_words(analysis, errors)}" for errors in analysis.errors]
    lines += [f"* {sign_words(analysis)}", f"* {region_words(analysis)}"]
    lines += [f"* {contribution_words(analysis)}"]
    lines += [f"* **{advice_words(analysis, advice)}**" for advice in analysis.advice]
    lines += [f"* remark: {remark}" for remark in analysis.remarks]
    if analysis.contributions:
        lines += ["", "Mean error without each sensor, rise [m]:", ""]
        lines += [f"| sensor | {' | '.join(NAMES.values())} |", "|---" * (len(NAMES) + 1) + "|"]
        lines += [
            f"| {name} | {' | '.join(f'{rise:+.3f}' for rise in without.values())} |"
            for name, without in zip(analysis.layout.sensors, analysis.contributions, strict=True)
        ]
    return "\n".join(lines) + "\n" + READING


class _Board:
    """One map: everything hangs below an entity that turns y upwards."""

    def __init__(self, recording: rr.RecordingStream, origin: str, analysis: RoomAnalysis) -> None:
        import rerun as rr

        self._recording, self._origin, self._analysis = recording, origin, analysis
        corners = np.vstack([analysis.layout.outline, analysis.layout.positions])
        self._low, self._high = corners.min(axis=0), corners.max(axis=0)
        self._extent = float((self._high - self._low).max())
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        self.log("", upwards)

    def log(self, part: str, *archetypes: rr.AsComponents) -> None:
        """Log something of the map, which no time changes."""
        log(self._recording, f"{self._origin}/room{part}", *archetypes, static=True)

    def image(self, grid: Grid, values: Array, top: float, unit: str) -> None:
        """Draw values of a lattice's nodes, from 0 to ``top``, with the scale of colours."""
        cells = grid.image(values)
        factor = max(1, round(PIXELS / max(cells.shape)))
        self._picture(
            "/map", _coloured(np.kron(cells, np.ones((factor, factor))), top), grid.bounds
        )
        low, high = self._low, self._high
        left, right = high[0] + self._extent * np.array(SCALE_PART)
        ramp = np.tile(np.linspace(0.0, top, 128)[:, None], (1, SCALE_WIDTH))
        self._picture("/scale", _coloured(ramp, top), ((left, low[1]), (right, high[1])))
        marks = np.linspace(0.0, 1.0, 3)
        texts = [f"{top * part:.2g} {unit}".strip() for part in marks]
        places = np.stack([np.full(3, right), low[1] + marks * (high[1] - low[1])], axis=1)
        self.points("/marks", places, SENSOR, 0.5, texts)

    def _picture(
        self, part: str, pixels: NDArray[np.uint8], bounds: tuple[tuple[float, float], ...]
    ) -> None:
        """Put an image, first row at the bottom, between two corners [m]."""
        import rerun as rr

        (left, bottom), (right, upper) = bounds
        wide, high = (right - left) / pixels.shape[1], (upper - bottom) / pixels.shape[0]
        transform = rr.Transform3D(
            translation=[left, bottom, 0.0], mat3x3=[[wide, 0, 0], [0, high, 0], [0, 0, 1]]
        )
        self.log(part, transform, rr.Image(pixels, draw_order=-10.0))

    def room(self, *, sensors: bool = True) -> None:
        """Draw walls and sensors."""
        import rerun as rr

        corners = self._analysis.layout.outline
        ring = np.vstack([corners, corners[:1]])
        self.log(
            "/outline", rr.LineStrips2D([ring], colors=np.array([OUTLINE], np.uint32), radii=-1.2)
        )
        if sensors:
            self.points("/sensors", self._analysis.layout.positions, SENSOR, LEAST_RADIUS)

    def points(
        self,
        part: str,
        places: Array,
        colour: int,
        radii: float | Array,
        labels: list[str] | None = None,
    ) -> None:
        """Draw points of radii in screen points."""
        import rerun as rr

        colours = np.full(len(places), colour, np.uint32)
        shown = rr.Points2D(
            places, colors=colours, radii=-np.asarray(radii), labels=labels, show_labels=True
        )
        self.log(part, shown)

    def lines(self, part: str, strips: list[Array], colour: int, width: float) -> None:
        """Draw lines of a width in screen points."""
        import rerun as rr

        colours = np.full(len(strips), colour, np.uint32)
        self.log(part, rr.LineStrips2D(strips, colors=colours, radii=-width / 2))

    def ring(self, places: Array, radius: float = 0.028) -> None:
        """Draw rings around places."""
        turn = np.linspace(0, 2 * np.pi, 33)
        circle = radius * self._extent * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        self.lines("/rings", [position + circle for position in places], THRESHOLD, 3.0)

    def view(self, title: str) -> rrb.View:
        """Return the view of the map."""
        import rerun.blueprint as rrb

        pad = PAD * self._extent
        right = self._high[0] + SCALE_PAD * self._extent
        bounds = rrb.VisualBounds2D(
            x_range=(self._low[0] - pad, right),
            y_range=(-self._high[1] - pad, -self._low[1] + pad),
        )
        return rrb.Spatial2DView(origin=self._origin, name=title, visual_bounds=bounds)


def _coloured(values: NDArray[np.floating], top: float) -> NDArray[np.uint8]:
    """Return pixels of values from 0 to ``top``, shape (..., 4); clear where there is none."""
    packed = heat(np.nan_to_num(values) / (top or 1.0)).astype(">u4")
    pixels = np.ascontiguousarray(packed).view(np.uint8).reshape(*values.shape, 4).copy()
    pixels[np.isnan(values)] = 0
    return pixels


def _signs(recording: rr.RecordingStream, analysis: RoomAnalysis) -> rrb.View:
    board, mean = _Board(recording, "/signs", analysis), analysis.signs.physical
    board.image(analysis.sign_grid, mean, float(mean.max()), "")
    board.room()
    board.ring(analysis.sign_grid.nodes[[mean.argmax()]])
    return board.view(sign_words(analysis).partition(", where")[0])


def _regions(recording: rr.RecordingStream, analysis: RoomAnalysis) -> rrb.View:
    """Draw regions in the colour of their confusion, their borders, and rings where ambiguous."""
    board, a, raster = _Board(recording, "/regions", analysis), analysis.ambiguity, analysis.raster
    home = region_at(a.regions, raster.nodes)
    tried = np.nan_to_num(a.confusion)
    board.image(raster, tried[home], max(LEAST_SCALE, float(tried.max())), "")
    board.lines("/borders", raster.borders(home), REGION_BORDER, 1.0)
    board.room()
    marked = a.tiny | a.doubled | a.confused
    if marked.any():
        board.ring(a.sources[marked], 0.012)
    return board.view(region_words(analysis))


def _sensors(recording: rr.RecordingStream, analysis: RoomAnalysis) -> rrb.View:
    """Draw each sensor as large as its contribution, and what would be better."""
    board, layout = _Board(recording, "/sensors", analysis), analysis.layout
    board.room(sensors=False)
    localizer = analysis.settings.localizer
    rises = np.array([without[localizer] for without in analysis.contributions])
    size = np.zeros(len(layout.sensors))
    labels = list(layout.sensors)
    if len(rises):
        size = np.maximum(rises, 0.0) / max(rises.max(), 1e-9)
        labels = [f"{name} {rise:+.2f} m" for name, rise in zip(labels, rises, strict=True)]
    radii = LEAST_RADIUS + (MOST_RADIUS - LEAST_RADIUS) * np.sqrt(size)
    board.points("/sensors", layout.positions, SENSOR, radii, labels)
    for advice in analysis.advice:
        position = np.array(advice.position)
        added = advice.moved is None
        # the line of a sensor that is moved says as much as a name
        colour, name = (ADDED, ["one more"]) if added else (MOVED, None)
        board.points(f"/{'added' if added else 'moved'}", position[None], colour, 9.0, name)
        if advice.moved is not None:
            board.lines("/move", [np.array([layout.positions[advice.moved], position])], MOVED, 2.0)
    return board.view(contribution_words(analysis))


def _layout(views: list[rrb.View]) -> rrb.Blueprint:
    """Return the layout: three error maps over signs, regions and sensors, and the page."""
    import rerun.blueprint as rrb

    rows = [rrb.Horizontal(*views[:3]), rrb.Horizontal(*views[3:])]
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*rows), page_view("What is shown"), column_shares=[3.0, 1.0]),
        rrb.TimePanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
