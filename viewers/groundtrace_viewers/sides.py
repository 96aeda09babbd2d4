"""Two results side by side on the timeline: what each decided, and by which functions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from groundtrace.explain.comparison import A_RIGHT, B_RIGHT
from groundtrace_codecs.signals import NS_PER_S

from .events import log_truth
from .evidence import (
    Focus,
    about_steps,
    arranged,
    log_detector,
    log_page,
    log_score,
    page_view,
    session_of,
)
from .lanes import Lane, StageLanes
from .moment import recording_at
from .palette import LEFT, RIGHT, SensorColours
from .timeline import Entity, Timeline

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import rerun.blueprint as rrb

    from groundtrace.explain import Evidence
    from groundtrace.explain.comparison import Comparison

APPLICATION = "groundtrace-compare"
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
    found: Comparison,
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
    found
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
    first = next((d.time_s for d in found.decisions if d.verdict in WORDS), None)
    opened = recording_at(APPLICATION, a.name, path, spawn=spawn, at_s=first)
    with opened as recording:
        timeline = Timeline(recording, a.start_ns)
        tops = _log_side(timeline, a, "A", focus, found.tolerance_s)
        tops |= _log_side(timeline, b, "B", focus, found.tolerance_s)
        _log_differences(timeline, found, a.start_ns)
        log_truth(timeline, about_steps(a.labels))
        log_page(timeline, page)
        entities = [replace(e, top=tops.get(e.path, e.top)) for e in timeline.entities]
        recording.send_blueprint(layout(entities, focus))


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


def _log_differences(timeline: Timeline, found: Comparison, start_ns: int) -> None:
    lane = Lane(timeline, "/state/differs", DIFFERS)
    for decision in found.decisions:
        if decision.verdict in WORDS:
            lane.add(start_ns + round(decision.time_s * NS_PER_S), WORDS[decision.verdict])
    lane.flush()


def layout(entities: Sequence[Entity], focus: Focus) -> rrb.Blueprint:
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
