"""The evidence of a result on the timeline, as far as it is shown in every view of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.explain.counted import matched
from groundtrace.explain.evidence import step_times
from groundtrace.sinks import Session
from groundtrace_codecs.events import CandidateBlock, TraceBlock
from groundtrace_codecs.signals import NS_PER_S

from .detector import DetectorLog, ceiling, decision_gate
from .lanes import Lane
from .palette import STEP
from .timeline import TIMELINE
from .verdict import COLOURS
from .views import linked

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import rerun.blueprint as rrb
    from numpy.typing import NDArray

    from groundtrace.explain import Evidence, StageEvidence
    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.labels import Label

    from .lanes import StageLanes
    from .palette import SensorColours
    from .timeline import Entity, Timeline

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


def session_of(evidence: Evidence) -> Session:
    """Return what evidence says of its recording."""
    e, config = evidence, evidence.config
    return Session(
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
    spec, found = part.spec, part.candidates
    log = DetectorLog(timeline, spec, colours, lanes, (focus.start_ns, focus.end_ns))
    log.trace(TraceBlock(spec, part.frames.time_ns, part.frames.value))
    for gap in gaps:
        if gap.topic == spec.topic and not gap.bridged:
            log.interrupt(gap.start_ns)
    verdicts = (part.gate_value, part.margin, part.accepted)
    log.candidates(CandidateBlock(spec, found.time_ns, found.channel, found.value, *verdicts))
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
    lane = Lane(timeline, path, {**COLOURS, "step": STEP})
    if not any(label.kind == "step" for label in evidence.labels):
        for time_ns in step_times(evidence).tolist():
            lane.add(time_ns, "step")
        lane.flush()
        return
    found = matched(evidence, tolerance_s)
    for state, times in (
        ("hit", found.truth_ns[found.pairs[:, 0]]),
        ("missed", found.truth_ns[found.missed]),
        ("false", found.found_ns[found.false]),
    ):
        for time_ns in times.tolist():
            lane.add(time_ns, state)
    lane.flush()
