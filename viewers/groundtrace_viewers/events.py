"""Single events on the timeline: picks, steps, gaps and notes as marks, log lines and rows."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import EVENTS

from .lanes import GAPS, LAST, Lane
from .palette import (
    DISTURBED,
    IGNORED,
    IMPACT,
    LOSS,
    SPAN,
    STEP,
    STEP_COLOURS,
    TYPE_COLOURS,
    WALKER_COLOURS,
)
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Gap, Note, Pick, StepEvent
    from groundtrace_codecs.labels import Label

    from .palette import SensorColours
    from .timeline import Timeline

#: Labels without a lane, and those that share one.
ELSEWHERE = frozenset({"waypoint", "heading"})
TOGETHER = {"ignore": "walking", "trailing": "step"}
GAP_COLOURS = {"missing": LOSS, "damage": LOSS, "clock step": IMPACT, "duplicate": SPAN}


def readable(value: float) -> str:
    """Return a number with three digits, without an exponent where it has few more."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


class LogLines:
    """Lines of text at times."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._pending: dict[str, list[tuple[int, str, str]]] = {}

    def add(self, kind: str, time_ns: int, text: str, level: str) -> None:
        """Take a line; ``kind`` names its entity."""
        self._pending.setdefault(kind, []).append((time_ns, text, level))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        for kind, lines in self._pending.items():
            path = f"/log/{kind}"
            self._timeline.declare(Entity(path, "log"))
            times, texts, levels = zip(*lines, strict=True)
            columns = rr.TextLog.columns(text=list(texts), level=list(levels))
            self._timeline.send(path, times, columns)
        self._pending.clear()


class PickLog:
    """Picks: marks on the waveform, rows of a table and log lines."""

    def __init__(self, timeline: Timeline, colours: SensorColours, lines: LogLines) -> None:
        self._timeline = timeline
        self._colours = colours
        self._lines = lines
        self._pending: list[tuple[Pick, float]] = []

    def add(self, pick: Pick, height: float, *, told: bool = True) -> None:
        """Take a pick; its mark lies at ``height`` of the waveform's plot.

        Without being ``told`` it has no line: that of its step would be lost among those of picks.
        """
        self._pending.append((pick, height))
        if not told:
            return
        spread = f" ± {pick.uncertainty_s * 1e3:.2g} ms" if pick.uncertainty_s >= 0 else ""
        where = self._timeline.seconds(pick.time_ns)
        text = f"{where}{spread}  pick {pick.channel}, peak {readable(pick.value)} ({pick.stage})"
        self._lines.add("picks", pick.time_ns, text, "INFO")

    def flush(self) -> None:
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
        import rerun as rr

        self._timeline.declare(Entity("/table/picks", "table", "Picks"))
        columns = rr.AnyValues.columns(
            channel=[p.channel for p in picks],
            stage=[p.stage for p in picks],
            peak=np.array([p.value for p in picks]),
            uncertainty_ms=np.array([p.uncertainty_s for p in picks]) * 1e3,
        )
        self._timeline.send("/table/picks", [p.time_ns for p in picks], columns)


class StepLog:
    """Steps and impacts: marks on the waveform, rows of a table and log lines."""

    def __init__(self, timeline: Timeline, lines: LogLines) -> None:
        self._timeline = timeline
        self._lines = lines
        self._pending: list[tuple[StepEvent, float]] = []

    def add(self, step: StepEvent, height: float) -> None:
        """Take a step; its mark lies at ``height`` of the waveform's plot."""
        self._pending.append((step, height))
        what = " ".join(filter(None, (step.type or step.foot, step.kind)))
        seen = f", {step.channels} channels" if step.channels > 1 else ""
        where = self._timeline.seconds(step.time_ns)
        text = f"{where}  {what}, peak {readable(step.value)}{seen} ({step.stage})"
        self._lines.add("steps", step.time_ns, text, "INFO")

    def flush(self) -> None:
        """Log what is pending."""
        for topic in dict.fromkeys(s.topic for s, _ in self._pending):
            self._marks(topic, [(s, height) for s, height in self._pending if s.topic == topic])
        if self._pending:
            self._rows([s for s, _ in self._pending])
        self._pending = []

    def _marks(self, topic: str, marks: list[tuple[StepEvent, float]]) -> None:
        import rerun as rr

        path = f"/steps/{topic.strip('/')}"
        style = rr.SeriesPoints(markers="up", marker_sizes=7.0, names="step")
        self._timeline.declare(Entity(path, "mark"), style)
        kinds = STEP_COLOURS | TYPE_COLOURS
        shades = [kinds.get(s.type or s.foot or s.kind, STEP) for s, _ in marks]
        columns = [
            *rr.Scalars.columns(scalars=np.array([height for _, height in marks])),
            *rr.SeriesPoints.columns(colors=np.array(shades, np.uint32)),
        ]
        self._timeline.send(path, [s.time_ns for s, _ in marks], columns)

    def _rows(self, steps: list[StepEvent]) -> None:
        import rerun as rr

        self._timeline.declare(Entity("/table/steps", "table", "Steps"))
        columns = rr.AnyValues.columns(
            kind=[s.kind for s in steps],
            foot=[s.foot for s in steps],
            type=[s.type for s in steps],
            stage=[s.stage for s in steps],
            peak=np.array([s.value for s in steps]),
            channels=np.array([s.channels for s in steps]),
        )
        self._timeline.send("/table/steps", [s.time_ns for s in steps], columns)


class LossLog:
    """Interruptions: a lane and log lines."""

    def __init__(self, timeline: Timeline, lines: LogLines) -> None:
        self._timeline = timeline
        self._lines = lines
        self._lane = Lane(timeline, GAPS, GAP_COLOURS)

    def add(self, gap: Gap) -> None:
        """Take a gap."""
        self._lane.add(gap.start_ns, gap.reason, gap.end_ns)
        lasting = f"{(gap.end_ns - gap.start_ns) / 1e6:.1f} ms"
        state = "state kept" if gap.bridged else "state reset"
        where = self._timeline.seconds(gap.start_ns)
        text = f"{where}  {gap.reason} {gap.topic}: {gap.lost} lost, {lasting}, {state}"
        self._lines.add("gaps", gap.start_ns, text, "WARN")

    def flush(self, before_ns: int | None = None) -> None:
        """Log the lane up to a time."""
        self._lane.flush(before_ns)


class PlainLog:
    """Kinds of events that have no view of their own: a lane and a line of the log each."""

    def __init__(self, timeline: Timeline, lines: LogLines) -> None:
        self._timeline = timeline
        self._lines = lines
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
            said = f"{self._timeline.seconds(event.time_ns)}  {text}"
            line = f"{said} ({source})" if source else said
            self._lines.add(kind.plural, event.time_ns, line, getattr(event, "level", "INFO"))

    def flush(self, before_ns: int | None = None) -> None:
        """Log the lanes up to a time."""
        for lane in self._lanes.values():
            lane.flush(before_ns)


def log_note(lines: LogLines, note: Note, where: str) -> None:
    """Take a note as a line; ``where`` is its time as text."""
    source = f" ({note.source})" if note.source else ""
    lines.add("notes", note.time_ns, f"{where}  {note.text}{source}", note.level)


def lane_labels(session: Session) -> list[Label]:
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
    known = tuple(labels)
    targets = sorted({x.target for x in known if x.target})
    walkers = dict(zip(targets, cycle(WALKER_COLOURS), strict=False)) if len(targets) > 1 else {}
    caused = any(x.kind in ("step", "impact") for x in known)
    kinds = STEP_COLOURS | TYPE_COLOURS
    lanes: dict[str, Lane] = {}
    for label in known:
        if label.kind in ELSEWHERE or (label.kind == "pick" and caused):
            continue
        name = TOGETHER.get(label.kind, label.kind)
        colours = {name: SPAN, "ignore": IGNORED, "disturbed": DISTURBED} | kinds | walkers
        lane = lanes.setdefault(name, Lane(timeline, f"{root}/{name}", colours))
        shown = label.label if label.label in kinds and label.kind == name else label.kind
        if label.kind in ("step", "impact") and label.target in walkers:
            shown = label.target
        lane.add(label.time_ns, shown, label.end_ns)
        if label.kind == "ignore":
            _resume(lane, label, known)
    for lane in lanes.values():
        lane.flush()


def _resume(lane: Lane, ignored: Label, labels: Iterable[Label]) -> None:
    """Go on with the walk after a part of it that is ignored."""
    if ignored.end_ns is None:
        return
    for label in labels:
        if label.kind == "walking" and label.time_ns <= ignored.end_ns < (label.end_ns or 0):
            lane.add(ignored.end_ns, "walking", label.end_ns)
