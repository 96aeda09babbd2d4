"""Annotations on the timeline: a lane and lines to jump to, in a replay or added to an open one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import SPAN_KINDS

from .context import LogLines
from .timeline import (
    ANNOTATION_COLOURS,
    MARK_NS,
    STEP_COLOURS,
    TYPE_COLOURS,
    Entity,
    Mark,
    Timeline,
    stream_of,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Label

#: Between the lanes of truth and score.
LANE = "/state/2-annotations"
LOG = "annotations"
_LEVELS = {"missed": "ERROR", "false": "WARN"}


def log_annotations(
    timeline: Timeline,
    lines: LogLines,
    annotations: Collection[Annotation],
    drawn: Collection[Annotation] = (),
    changed_ns: Collection[int] = (),
) -> None:
    """Log the lane, and a line for each annotation.

    Parameters
    ----------
    timeline, lines
        Where to.
    annotations
        All that hold now.
    drawn
        What was logged before: nothing logged can be taken back, so what holds no more is painted
        over on the lane, and a line says that it was withdrawn.
    changed_ns
        When the lane changed in any layer before [ns]: what was painted over once stays so, unless
        it is painted again.
    """
    changes = states(annotations)
    changes += _painted_over(changes, {t for t, _ in states(drawn)} | set(changed_ns))
    _log_lane(timeline, annotations, changes)
    previous = {a.id: a.label for a in drawn}
    for a in annotations:
        if previous.pop(a.id, None) != a.label:
            level = _LEVELS.get(a.label.kind, "INFO")
            lines.add(LOG, a.label.time_ns, line(timeline, a.label), level)
    for label in previous.values():
        text = f"{line(timeline, label)}  withdrawn"
        lines.add(LOG, label.time_ns, text, "DEBUG")


def layer_rrd(
    name: str,
    application: str,
    start_ns: int,
    annotations: Collection[Annotation],
    drawn: Collection[Annotation] = (),
    changed_ns: Collection[int] = (),
) -> bytes:
    """Return annotations as a file of the viewer that joins an open replay.

    Parameters
    ----------
    name, application
        File name of the recording, and its kind as the pipeline has it: as the replay was made.
    start_ns
        First sample of the recording [ns].
    annotations, drawn, changed_ns
        As :func:`log_annotations`.
    """
    import rerun as rr

    recording = stream_of(name, application)
    binary = rr.binary_stream(recording)
    timeline = Timeline(recording, start_ns)
    lines = LogLines(timeline)
    log_annotations(timeline, lines, annotations, drawn, changed_ns)
    lines.flush()
    return binary.read() or b""


def states(annotations: Iterable[Annotation]) -> list[tuple[int, str]]:
    """Return from when on the lane is in which state, by time; no state is empty.

    Of several at once the latest shows: a step marked within a span, then the span again.
    """
    marks = sorted(_mark(a.label) for a in annotations)
    changes: list[tuple[int, str]] = []
    active: list[Mark] = []
    waiting = iter([*marks, None])
    following = next(waiting)
    for time_ns in sorted({t for m in marks for t in (m.start_ns, m.end_ns)}):
        while following is not None and following.start_ns <= time_ns:
            active.append(following)
            following = next(waiting)
        active = [m for m in active if m.end_ns > time_ns]
        changes.append((time_ns, active[-1].state if active else ""))
    return changes


def state(label: Label) -> str:
    """Return what the lane says of an annotation: its kind, foot, or a span's own word."""
    if label.kind == "span":
        return label.label or "span"
    if label.kind == "step" and label.label in STEP_COLOURS | TYPE_COLOURS:
        return label.label
    return label.kind


def line(timeline: Timeline, label: Label) -> str:
    """Return an annotation as a line of text."""
    until = "" if label.end_ns is None else f" to {timeline.seconds(label.end_ns)}"
    words = " ".join(filter(None, (label.kind, label.label, label.channel)))
    note = f": {' '.join(label.note.split())}" if label.note else ""
    return f"{timeline.seconds(label.time_ns)}{until}  {words}{note} ({label.author})"


def _mark(label: Label) -> Mark:
    end_ns = label.end_ns if label.kind in SPAN_KINDS else None
    return Mark(label.time_ns, end_ns or label.time_ns + MARK_NS, state(label))


def _painted_over(
    changes: list[tuple[int, str]], before_ns: Iterable[int]
) -> list[tuple[int, str]]:
    """Return the states that hold now at times where only the lane before had a change."""
    times = np.array([t for t, _ in changes], np.int64)
    current_ns = {t for t, _ in changes}
    over = []
    for time_ns in sorted(before_ns):
        if time_ns not in current_ns:
            at = int(np.searchsorted(times, time_ns)) - 1
            over.append((time_ns, changes[at][1] if at >= 0 else ""))
    return over


def _log_lane(
    timeline: Timeline, annotations: Iterable[Annotation], changes: list[tuple[int, str]]
) -> None:
    import rerun as rr

    if not changes:
        return
    label_colours = {state(a.label): ANNOTATION_COLOURS["span"] for a in annotations}
    colours = label_colours | STEP_COLOURS | TYPE_COLOURS | ANNOTATION_COLOURS
    style = rr.StateConfiguration(
        values=list(colours), colors=np.array(list(colours.values()), np.uint32)
    )
    timeline.declare(Entity(LANE, "lane"), style)
    times, names = zip(*sorted(changes), strict=True)
    timeline.send(LANE, times, rr.StateChange.columns(state=list(names)))
