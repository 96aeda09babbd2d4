"""The moments of a result that a page jumps to: events, and wrong decisions with their causes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundtrace.evaluation.matching import match_steps
from groundtrace.explain.reasons import StepReasons
from groundtrace.explain.redecide import OfflineDecider
from groundtrace.explain.remedies import RemedySearch
from groundtrace.explain.thresholds import ThresholdCurve, threshold_curves
from groundtrace.explain.unfiltered import with_recording
from groundtrace.explain.why import narrowest, remedy_of
from groundtrace.explain.why_picks import pick_account
from groundtrace.pipeline.results import evidence_of
from groundtrace_codecs.events import (
    EVENTS,
    Disagreement,
    Disturbance,
    Fix,
    Gap,
    LineCrossing,
    Note,
    Pass,
    Pick,
    StageSpec,
    StepEvent,
    readable,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .timeline import TIMELINE
from .vehicles import crossing_text, pass_text, wrong_passes
from .wrong_decisions import (
    TOLERANCE_S,
    doublings,
    gates_at,
    let_pass,
    results_of,
    value_text,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from groundtrace.evaluation.matching import StepMatch
    from groundtrace.explain.reasons import GateReading
    from groundtrace.explain.remedies import Remedy
    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.results import Evidence, Results
    from groundtrace_codecs.events import Event, Label
    from groundtrace_codecs.signals import Stream

#: Length of a frame where no detector has any [s].
NO_FRAME_S = 0.01
#: Kinds of events that a page steps through, and shows before all others.
STEPPED = frozenset({"step", "impact", "pass", "crossing"})
#: Levels of notes that a page shows.
LOUD = frozenset({"WARN", "ERROR"})
#: So long a page waits for causes and remedies before it opens [s]. Chosen by judgement: those of
#: some hundred wrong steps take less, and thousands come while the first is looked at.
OPENING_S = 0.5
#: What is said of a wrong step until then.
PENDING = "its cause is being looked for"


@dataclass(frozen=True, slots=True)
class PageMoment:
    """A moment of a page's list.

    Attributes
    ----------
    t_s
        Since the recording's first sample [s].
    kind
        Of an event ``step``, ``impact``, ``pick``, ``fix``, ``pass``, ``crossing``, ``gap``,
        ``disturbance``, ``disagreement`` or ``note``; of a wrong decision ``missed``, ``false``,
        ``late`` or ``early``.
    stage
        Which stage it comes from; empty where none.
    text
        For people: what it is, or why it went wrong.
    """

    t_s: float
    kind: str
    stage: str
    text: str


@dataclass(frozen=True, slots=True)
class WrongMoment(PageMoment):
    """A wrong decision.

    Attributes
    ----------
    remedy, effect
        Of a wrong step: the smallest change that mends it, as ``--set`` takes it, and what it does
        to the recording; empty where there is none.
    gates
        What the gates said of its candidate.
    """

    remedy: str = ""
    effect: str = ""
    gates: tuple[PageGate, ...] = ()


@dataclass(frozen=True, slots=True)
class PageGate:
    """A gate of a wrong decision.

    Attributes
    ----------
    name, value, threshold, unit
        As they are written.
    sign
        How the value compares with the threshold.
    doublings
        How far it is from it, in doublings.
    passed
        Whether it let the candidate pass.
    """

    name: str
    value: str
    sign: str
    threshold: str
    unit: str
    doublings: float
    passed: bool


@dataclass(frozen=True, slots=True)
class PageMoments:
    """All that a page needs to know of a replay beside the viewer's file.

    Attributes
    ----------
    recording, sha256
        File name of the recording, and of its bytes; empty where unknown.
    start_ns
        Its first sample [ns], as digits: a page's numbers hold 53 bits.
    duration_s
        From its first to its last sample [s].
    timeline
        Name of the viewer's timeline.
    sample_s, sample_of
        Sample period of its fastest stream [s] and that stream's topic; None and empty where no
        stream is known.
    frame_s, frame_of
        Length of a detector's frame [s] and which stage has it; 10 ms and empty where none has.
    channels
        Names of the channels that can be picked.
    steps
        Name of the stage whose steps are reported; empty where none has.
    truth
        True where there is truth to tell wrong decisions by.
    events, misses
        In the order of time.
    opens_s
        Where a page, or a notebook, opens [s], see :func:`opening_s`.
    live
        True while the replay is running: there will be more.
    pending
        So many wrong decisions are told without cause and remedy by now.
    curves
        What other thresholds would make of the steps.
    pipeline
        The pipeline that was replayed, TOML.
    """

    recording: str
    sha256: str
    start_ns: str
    duration_s: float
    timeline: str
    sample_s: float | None
    sample_of: str
    frame_s: float
    frame_of: str
    channels: tuple[str, ...]
    steps: str
    truth: bool
    events: tuple[PageMoment, ...]
    misses: tuple[WrongMoment, ...]
    opens_s: float = 0.0
    live: bool = False
    pending: int = 0
    curves: tuple[ThresholdCurve, ...] = ()
    pipeline: str = ""

    def json(self) -> bytes:
        """Return it as one JSON document."""
        return msgspec.json.encode(self)


def moments_of_results(
    results: Results,
    streams: Sequence[Stream] = (),
    labels: tuple[Label, ...] | None = None,
    recording: Path | None = None,
    within_s: float = math.inf,
) -> PageMoments:
    """Return the moments of a result.

    Parameters
    ----------
    results
        As :func:`groundtrace.pipeline.results.read_results` gives them.
    streams
        Of the recording, for the sample period; the results do not know them.
    labels
        Truth instead of the results' own.
    recording
        Where the recording is, to tell whether a filter took a step out; None where it is not
        at hand.
    within_s
        After so long wrong steps are told without cause and remedy [s]; they are ``pending``.
    """
    evidence = evidence_of(results, labels)
    if recording is not None:
        evidence = with_recording(evidence, results.provenance.sha256, (recording,))
    steps = _last_stage(evidence)
    fastest = max(streams, key=lambda stream: stream.rate_hz, default=None)
    frame_of, frame_s = _frames(evidence)
    moments = (_event(event, steps, evidence.start_ns) for event in results.events)
    misses = (
        *_wrong_steps(evidence, results.events, steps, within_s),
        *_wrong_picks(evidence),
        *_wrong_passes(evidence, results.events),
    )
    listed = sorted((m for m in moments if m is not None), key=_order)
    wrong = sorted(misses, key=_order)
    return PageMoments(
        results.provenance.recording,
        results.provenance.sha256,
        str(evidence.start_ns),
        (evidence.end_ns - evidence.start_ns) / NS_PER_S,
        TIMELINE,
        None if fastest is None else 1 / fastest.rate_hz,
        "" if fastest is None else fastest.topic,
        frame_s,
        frame_of,
        _channels(evidence, streams),
        steps,
        any(label.kind in ("step", "pick", "pass") for label in evidence.labels),
        tuple(listed),
        tuple(wrong),
        opens_s=opening_s(listed, wrong),
        pending=sum(miss.text == PENDING for miss in misses),
        curves=threshold_curves(evidence, TOLERANCE_S) if misses else (),
        pipeline=results.provenance.pipeline,
    )


def opening_s(events: Sequence[PageMoment], misses: Sequence[PageMoment]) -> float:
    """Return where to look first: at what went wrong first, else what a page steps through [s].

    Parameters
    ----------
    events, misses
        In the order of time.

    Returns
    -------
    The time of the first wrong decision; without one of the first event of :data:`STEPPED`, without
    that of the first event, and 0 without any.
    """
    stepped = [event for event in events if event.kind in STEPPED]
    first = next(iter((*misses, *stepped, *events)), None)
    return 0.0 if first is None else first.t_s


def moments_of_session(
    session: ReplaySession,
    events: Sequence[Event],
    at_ns: int | None = None,
    within_s: float = math.inf,
) -> PageMoments:
    """Return the moments of a replay that has ended, of the events it gave.

    Parameters
    ----------
    session, events
        Of the replay.
    at_ns
        Where the page opens [ns]; None stands for where the moments say, see :func:`opening_s`.
    within_s
        As of :func:`moments_of_results`.
    """
    results = results_of(session, events)
    moments = moments_of_results(results, session.streams, within_s=within_s)
    return (
        moments
        if at_ns is None
        else replace(moments, opens_s=(at_ns - session.start_ns) / NS_PER_S)
    )


#: So many of the last events a page lists while a replay is running. Chosen by judgement: minutes.
LAST_EVENTS = 500


class LiveMoments:
    """The moments of a replay that is running: the last events, and no judgement of them yet.

    Parameters
    ----------
    session
        Of the replay.
    """

    def __init__(self, session: ReplaySession) -> None:
        self._begun = moments_of_session(replace(session, labels=()), ())
        self._events: deque[PageMoment] = deque(maxlen=LAST_EVENTS)
        self._steps = ""
        self._start_ns, self._end_ns = session.start_ns, session.end_ns

    def add(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        if isinstance(item, SignalBlock):
            self._end_ns = max(self._end_ns, item.last_ns)
            return
        if isinstance(item, StageSpec) and item.emits == "step":
            self._steps = item.stage
        moment = _event(item, self._steps, self._start_ns)
        if moment is not None:
            self._events.append(moment)

    def so_far(self) -> PageMoments:
        """Return what there is by now."""
        return replace(
            self._begun,
            duration_s=(self._end_ns - self._start_ns) / NS_PER_S,
            steps=self._steps,
            events=tuple(sorted(self._events, key=_order)),
            live=True,
        )


def _order(moment: PageMoment) -> tuple[float, str, str]:
    return moment.t_s, moment.kind, moment.text


def _last_stage(evidence: Evidence) -> str:
    """Return the stage whose steps are reported."""
    names = [part.spec.stage for part in evidence.stages if part.spec.emits == "step"]
    return names[-1] if names else ""


def _frames(evidence: Evidence) -> tuple[str, float]:
    """Return the last stage that has frames, and how long they are [s]."""
    for part in reversed(evidence.stages):
        if len(part.frames.time_ns) > 1:
            length_ns = float(np.median(np.diff(part.frames.time_ns)))
            if length_ns > 0:
                return part.spec.stage, length_ns / NS_PER_S
    return "", NO_FRAME_S


def _channels(evidence: Evidence, streams: Sequence[Stream]) -> tuple[str, ...]:
    """Return the channels of the streams, or where none is known of the stages that pick."""
    named = [channel.name for stream in streams for channel in stream.channels]
    picking = [part.spec for part in evidence.stages if part.spec.emits == "pick"]
    return tuple(dict.fromkeys(named or [name for spec in picking for name in spec.channels]))


#: What a page says of the events that it lists, and who says it; steps have words of their own.
LISTED: Mapping[type[Any], Callable[[Any], tuple[str, str]]] = {
    Pick: lambda pick: (pick.stage, pick.channel),
    Fix: lambda fix: (fix.stage, f"({fix.x_m:.2f}, {fix.y_m:.2f}) m"),
    Pass: lambda one: (one.stage, pass_text(one)),
    LineCrossing: lambda one: (one.stage, crossing_text(one)),
    Gap: lambda gap: ("", f"{gap.topic} {gap.reason}, {gap.lost} lost".strip()),
    Disturbance: lambda span: (span.stage, "disturbed field"),
    Disagreement: lambda one: (one.stage, f"{one.distance_m:.2f} m: {one.methods}"),
    Note: lambda note: (note.source, note.text),
}


def _event(event: Event, steps: str, start_ns: int) -> PageMoment | None:
    """Return an event as a moment; None of one that a page does not list."""
    if isinstance(event, StepEvent):
        if event.stage != steps and event.kind == "step":
            return None
        return _moment(event.time_ns, start_ns, event.kind, event.stage, _step_text(event))
    text_of = LISTED.get(type(event))
    quiet = isinstance(event, Note) and event.level not in LOUD
    if text_of is None or quiet or (isinstance(event, Gap) and event.filled):
        return None
    listed: Any = event
    return _moment(listed.time_ns, start_ns, EVENTS[type(event)].name, *text_of(event))


def _step_text(step: StepEvent) -> str:
    """Return what is known of a step: its foot and type, how high it rose, who saw it."""
    seen = f"{step.channels} channels" if step.channels > 1 else ""
    return ", ".join(filter(None, (step.foot, step.type, step.value_text, seen)))


def _moment(time_ns: int, start_ns: int, kind: str, stage: str, text: str) -> PageMoment:
    return PageMoment((time_ns - start_ns) / NS_PER_S, kind, stage, text)


def _wrong(time_ns: int, start_ns: int, kind: str, stage: str, text: str) -> WrongMoment:
    return WrongMoment((time_ns - start_ns) / NS_PER_S, kind, stage, text)


def _wrong_steps(
    evidence: Evidence, events: Sequence[Event], steps: str, within_s: float
) -> list[WrongMoment]:
    """Return missed and false steps, each with the first thing that made it so, and its remedy.

    After so many seconds the rest are told without: :data:`PENDING` stands for why.
    """
    if not steps or not any(label.kind == "step" for label in evidence.labels):
        return []
    began_s = monotonic()
    times = [e.time_ns for e in events if isinstance(e, StepEvent) and e.stage == steps]
    found_ns, start_ns = np.array(times, np.int64), evidence.start_ns
    matching = match_steps(evidence.labels, found_ns, start_ns, evidence.end_ns, TOLERANCE_S)
    explained = _StepMoments(evidence, matching, steps)
    every = [
        *((time_ns, "missed") for time_ns in matching.truth_ns[matching.missed].tolist()),
        *((time_ns, "false") for time_ns in matching.found_ns[matching.false].tolist()),
    ]
    return [
        explained.moment(time_ns, kind)
        if monotonic() - began_s < within_s
        else _wrong(time_ns, start_ns, kind, "", PENDING)
        for time_ns, kind in sorted(every)
    ]


class _StepMoments:
    """Explains wrong steps one by one."""

    def __init__(self, evidence: Evidence, matching: StepMatch, steps: str) -> None:
        self._evidence, self._steps = evidence, steps
        self._reasons = StepReasons(evidence, TOLERANCE_S, matching)
        self._healer = RemedySearch(OfflineDecider(evidence), TOLERANCE_S)

    def moment(self, time_ns: int, kind: str) -> WrongMoment:
        """Return why a step is missed or false, and what mends it."""
        evidence, reasons = self._evidence, self._reasons
        pair = reasons.wrong_time(time_ns)
        remedy = remedy_of(self._healer, reasons, time_ns, false=kind == "false")
        if kind == "missed":
            reason = reasons.at(time_ns)
            pair_text = "" if pair is None else f" (the step found at {pair.found_s:.3f} s)"
            text = f"{reason.cause}: {reason.text}{pair_text}"
            moment = _wrong(time_ns, evidence.start_ns, kind, reason.stage, text)
            return _mended(moment, remedy, reason.readings)
        answers = "" if pair is None else f"{pair.text}; "
        text = answers + let_pass(narrowest(evidence, time_ns))
        moment = _wrong(time_ns, evidence.start_ns, kind, self._steps, text)
        return _mended(moment, remedy, gates_at(evidence, time_ns))


def _mended(
    moment: WrongMoment, remedy: Remedy | None, gates: Sequence[GateReading]
) -> WrongMoment:
    """Return a wrong decision with what mends it and what its gates said."""
    shown = tuple(
        PageGate(
            gate.gate,
            value_text(gate),
            "\u2265" if gate.value >= gate.threshold else "<",
            readable(gate.threshold),
            "" if gate.unit == "1" else gate.unit,
            doublings(gate.value, gate.threshold, passed=gate.passed),
            gate.passed,
        )
        for gate in gates
    )
    if remedy is None:
        return replace(moment, gates=shown)
    settings, effect = " --set ".join(remedy.settings), remedy.effect
    return replace(moment, remedy=settings, effect=effect, gates=shown)


def _wrong_picks(evidence: Evidence) -> list[WrongMoment]:
    """Return late, early, missed and false picks where true arrivals are known."""
    picking = any(part.spec.emits == "pick" for part in evidence.stages)
    if not picking or not any(label.kind == "pick" for label in evidence.labels):
        return []
    account = pick_account(evidence)
    return [
        WrongMoment(bad.time_s, bad.state, account.stage, f"{bad.channel}: {bad.reason.text}")
        for bad in account.bad
    ]


def _wrong_passes(evidence: Evidence, events: Sequence[Event]) -> list[WrongMoment]:
    """Return missed and false passes of the last stage that finds passes."""
    stage, wrong = wrong_passes(evidence, events)
    start_ns = evidence.start_ns
    return [_wrong(one.time_ns, start_ns, one.verdict, stage, one.text) for one in wrong]
