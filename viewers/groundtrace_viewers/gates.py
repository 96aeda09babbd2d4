"""Gates on the timeline: every value against its threshold, without any signal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.explain import reason_at
from groundtrace_codecs.signals import NS_PER_S

from .events import log_truth
from .evidence import (
    Focus,
    about_steps,
    arranged,
    log_detector,
    log_moment,
    log_page,
    log_score,
    page_view,
    session_of,
)
from .lanes import MARK_NS, Lane, StageLanes, coincident
from .moment import recording_at
from .palette import ACCEPTED, THRESHOLD, SensorColours
from .timeline import Entity, Timeline

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import rerun.blueprint as rrb
    from numpy.typing import NDArray

    from groundtrace.explain import Evidence, StageEvidence
    from groundtrace_codecs.events import GateSpec

APPLICATION = "groundtrace-why"
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
    found = part.candidates
    far = np.abs(found.time_ns - evidence.start_ns - round(reason.candidate_s * NS_PER_S))
    other = found.channel != part.spec.channels.index(reason.channel)
    return Asked(reason.stage, reason.topic, int(np.lexsort((far, other))[0]))


def log_gates(timeline: Timeline, part: StageEvidence, focus: Focus, about: Asked | None) -> None:
    """Log a panel and a lane for each gate of a stage on a topic."""
    verdicts = verdicts_of(part.margin)
    for index, gate in enumerate(part.spec.gates):
        path = f"/gates/{part.spec.stage}/{part.spec.topic.strip('/')}/{index + 1}-{gate.name}"
        top = gate_top(gate, part.gate_value[:, index], focus.within(part.candidates.time_ns))
        _panel(timeline, path, part.spec.stage, gate, top)
        span = (focus.start_ns, focus.end_ns)
        timeline.scalars(f"{path}/threshold", span, np.full((2, 1), gate.threshold))
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
    opened = recording_at(APPLICATION, evidence.name, path, spawn=spawn, at_s=focus.at_s)
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
        recording.send_blueprint(layout(entities, focus))


def layout(entities: Sequence[Entity], focus: Focus) -> rrb.Blueprint:
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
