"""Steps and passes against the truth: what was decided at the cursor, why, and what mends it.

Nothing of it is known before the last detection, so that all of it is logged at the end. Where
nothing is wrong there is a lane alone.
"""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np

from groundtrace.evaluation.matching import answers_text, found_text, match_steps, timing_pairs
from groundtrace.pipeline.results import Provenance, Results, evidence_of, replayed_labels
from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    StageSpec,
    StepEvent,
    TraceBlock,
    readable,
    unit_after,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .context import View
from .samples import FULL_RATE_HZ
from .site import SITE
from .timeline import ACCEPTED, FALSE, MISSED, NORM, OUTLINE, SCORE, Entity, Lane, strips_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace.explain.reasons import GateReading
    from groundtrace.explain.remedies import Remedy
    from groundtrace.explain.why import FalseDetection, Missed, StepExplanation
    from groundtrace.explain.why_vehicles import VehicleReason
    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.results import Evidence, StageEvidence
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry

    from .context import LogLines, ViewContext
    from .timeline import Timeline

#: Largest distance between a step and its detection, as the score has it.
TOLERANCE_S = 0.12
TOLERANCE_NS = round(TOLERANCE_S * NS_PER_S)
VERDICT_COLOURS = {"hit": ACCEPTED, "missed": MISSED, "false": FALSE}


class Verdict(NamedTuple):
    """What became of a step: when it was [ns], and in a word; of a wrong time, what it is.

    ``text`` is ``found 126 ms late, tolerance 120 ms`` of a missed step that has a false one near
    it, and ``answers step 12, 126 ms late`` of that one; else empty. ``found_ns`` is when a step
    that is right was found [ns].
    """

    time_ns: int
    verdict: str
    text: str = ""
    found_ns: int | None = None


def verdicts(
    session: ReplaySession, steps_ns: Sequence[int], replayed_ns: tuple[int, int]
) -> list[Verdict]:
    """Return what became of every true step, and which detections answer none.

    Parameters
    ----------
    session
        Its labels are the truth.
    steps_ns
        Detected steps [ns], any order.
    replayed_ns
        First and last sample that was replayed [ns]: what lies outside was never looked at.

    Returns
    -------
    list
        ``hit``, ``missed`` (at times of true steps) or ``false`` (of detections), in the spans
        that the score looks at.
    """
    first, last = replayed_ns
    labels = [x for x in session.labels if x.kind != "step" or first <= x.time_ns <= last]
    detected = np.array(steps_ns, np.int64)
    match = match_steps(labels, detected, session.start_ns, session.end_ns, TOLERANCE_S)
    pairs = timing_pairs(match)
    texts = {p.truth_ns: found_text(p, TOLERANCE_S) for p in pairs}
    texts |= {p.found_ns: answers_text(p, TOLERANCE_S) for p in pairs}
    right = [
        Verdict(int(match.truth_ns[t]), "hit", "", int(match.found_ns[d])) for t, d in match.pairs
    ]
    wrong = [
        Verdict(int(t), verdict, texts.get(int(t), ""))
        for verdict, times in (
            ("missed", match.truth_ns[match.missed]),
            ("false", match.found_ns[match.false]),
        )
        for t in times
    ]
    return sorted([*right, *wrong], key=lambda one: (one.time_ns, one.verdict))


class WrongSteps(View):
    """What became of every true step; where one is wrong, the decision at the cursor."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._events: list[Event] = []
        self._steps_ns: list[int] = []
        self._acceleration_ranges: dict[str, tuple[float, float]] = {}

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether there is truth to tell by."""
        return any(label.kind == "step" for label in context.session.labels)

    def event(self, event: Event) -> None:
        """Keep what decisions are explained by."""
        self._events.append(event)

    def signal(self, block: SignalBlock) -> None:
        """Remember how far the acceleration of a worn sensor goes, for the bands over it."""
        columns = block.stream.columns_of({"acceleration"})
        if columns and block.stream.rate_hz <= FULL_RATE_HZ:
            specific_force = block.values[:, columns]
            low, high = self._acceleration_ranges.get(block.topic, (0.0, 0.0))
            norm = float(np.linalg.norm(specific_force, axis=1).max())
            self._acceleration_ranges[block.topic] = (
                min(low, float(specific_force.min())),
                max(high, norm),
            )

    def step(self, step: StepEvent) -> None:
        """Take a step."""
        self._events.append(step)
        if self._context.stages.decides("step", step):
            self._steps_ns.append(step.time_ns)

    def close(self) -> None:
        """Log what became of every true step, where a stage finds steps."""
        context = self._context
        if context.stages.last("step") is None or context.replayed_ns is None:
            return
        outcomes = verdicts(context.session, self._steps_ns, context.replayed_ns)
        _log_lane(context.timeline, outcomes)
        wrong = [one for one in outcomes if one.verdict != "hit"]
        if not wrong:
            return
        context.opens_ns = wrong[0].time_ns + TOLERANCE_NS
        if not context.session.pipeline:  # nobody says by what it was decided
            _log_lines(context.timeline, context.lines, wrong)
            return
        evidence = evidence_of(results_of(context.session, self._events))
        decisions = _decisions(evidence, outcomes)
        DecisionCard(context.timeline, decisions).log(context.span_ns[0])
        _log_lines(context.timeline, context.lines, wrong, decisions)
        GatesPlot(context.timeline, evidence, context.span_ns).log(wrong)
        self._log_bands(evidence, wrong)
        if context.session.geometry is not None:
            true = {
                label.time_ns: (label.x_m, label.y_m)
                for label in context.session.labels
                if label.kind == "step" and label.x_m is not None and label.y_m is not None
            }
            SensorVerdicts(context.timeline, context.session.geometry, true).log(decisions)

    def _log_bands(self, evidence: Evidence, wrong: Sequence[Verdict]) -> None:
        """Log wrong steps as bands over what worn sensors felt, and over what was decided on."""
        timeline = self._context.timeline
        for topic, (low, high) in self._acceleration_ranges.items():
            for verdict in _log_bands(timeline, ("", topic), wrong, (low, high)):
                timeline.declare(Entity(f"/{verdict}{topic}", "mark"))
        for part in _deciding(evidence):
            heights = part.candidates.value[:, :1]
            if part.spec.topic in self._acceleration_ranges and part.spec.trace and heights.size:
                high = float(np.nanmax(np.abs(heights)))
                root = f"/detector/{part.spec.stage}{part.spec.topic}"
                _log_bands(timeline, (root, ""), wrong, (-high, high))

    kinds: ClassVar[Mapping[type[Any], Callable[[Any, Any], None]]] = {
        StageSpec: event,
        CandidateBlock: event,
        TraceBlock: event,
        Gap: event,
        StepEvent: step,
        SignalBlock: signal,
    }


class WrongPasses(View):
    """The decision at the cursor where a vehicle's pass is missed or false."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._events: list[Event] = []

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether there is truth to tell by, and a pipeline that may have found passes."""
        has_truth = any(label.kind == "pass" for label in context.session.labels)
        return has_truth and bool(context.session.pipeline)

    def event(self, event: Event) -> None:
        """Keep what decisions are explained by."""
        self._events.append(event)

    def close(self) -> None:
        """Log all of them, where a stage finds passes."""
        context = self._context
        results = results_of(context.session, self._events)
        has_truth = any(label.kind == "pass" for label in results.labels)
        if context.stages.last("pass") is None or not has_truth:
            return
        from groundtrace.explain.why_vehicles import vehicle_account

        evidence = evidence_of(results)
        decisions = [_pass(evidence, reason) for reason in vehicle_account(evidence).reasons]
        if decisions:
            DecisionCard(context.timeline, decisions).log(context.span_ns[0])
            context.opens_ns = decisions[0].time_ns

    kinds: ClassVar[Mapping[type[Any], Callable[[Any, Any], None]]] = {
        StageSpec: event,
        CandidateBlock: event,
        TraceBlock: event,
        Gap: event,
    }


def _pass(evidence: Evidence, one: VehicleReason) -> Decision:
    time_ns = _nanoseconds(evidence, one.time_s)
    who = " of ".join(filter(None, ("pass", one.target)))
    title = f"{one.state.capitalize()}: {who} at {one.station}, {_seconds(evidence, time_ns)}"
    remedy = f"--set {one.change}" if one.change else "no change of one gate mends it"
    return Decision(time_ns, one.state, title, one.text, remedy)


def results_of(session: ReplaySession, events: Sequence[Event]) -> Results:
    """Return what a replay that has ended decided, as a file of its results has it.

    Parameters
    ----------
    session, events
        Of the replay.
    """
    origin = Provenance(session.name, "", session.start_ns, session.end_ns, session.pipeline)
    labels = replayed_labels(session.labels, *(session.shown_ns or (None, None)))
    return Results(session.name, origin, labels, session.geometry, tuple(events))


def _log_lane(timeline: Timeline, outcomes: Sequence[Verdict]) -> None:
    lane = Lane(timeline, SCORE, VERDICT_COLOURS)
    for one in outcomes:
        lane.add(one.time_ns, one.verdict)
    lane.flush()


def _log_lines(
    timeline: Timeline,
    lines: LogLines,
    wrong: Sequence[Verdict],
    decisions: Sequence[Decision] = (),
) -> None:
    """Log a line for every step that was missed or is false."""
    counts = Counter(one.verdict for one in wrong)
    title = f"Wrong: {counts['missed']} missed, {counts['false']} false"
    timeline.declare(Entity("/log/score", "wrong", title))
    decision_of = {(d.verdict, d.time_ns): d for d in decisions}
    for one in wrong:
        decision = decision_of.get((one.verdict, one.time_ns))
        why = one.text if decision is None else decision.line
        which = f" {decision.step}" if decision is not None and decision.step else ""
        said_of = f"{one.verdict} step{which}{f': {why}' if why else ''}"
        text = f"{timeline.seconds(one.time_ns)}  {said_of}"
        lines.add("score", one.time_ns, text, "ERROR" if one.verdict == "missed" else "WARN")


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided about a step.

    Attributes
    ----------
    time_ns
        Of the true step, or of a false detection [ns].
    verdict
        ``hit``, ``missed`` or ``false``.
    title, cause, remedy, effect
        What, why, what mends it, and what that does besides; the last three may be empty.
    gates
        What the gates said of the candidate; empty where there was none.
    silent
        Why each channel that did not pick a missed step has no pick, its name first.
    step
        The number of a missed step, as ``why --step`` takes it; 0 of other decisions.
    """

    time_ns: int
    verdict: str
    title: str
    cause: str = ""
    remedy: str = ""
    effect: str = ""
    gates: tuple[GateReading, ...] = ()
    silent: tuple[str, ...] = ()
    step: int = 0

    @property
    def line(self) -> str:
        """Cause and what mends it, in a line; of a value and its threshold no more than both."""
        cause = self.cause.removeprefix("threshold: ").partition(" (margin")[0]
        return f"{cause}; {self.remedy}" if self.remedy.startswith("--set") else cause

    @property
    def card(self) -> str:
        """All of it, markdown."""
        mended = f"`{self.remedy}`" if self.remedy.startswith("--set") else self.remedy
        lines = filter(None, (self.cause, mended, self.effect))
        return f"### {self.title}\n\n" + "  \n".join(lines)


#: Remedies are looked for of so many missed, and so many false steps of a recording. Chosen by
#: judgement: they take some seconds.
MOST_MENDED = 1000
NOT_TRIED = f"more than {MOST_MENDED} are wrong, no change was tried:"


def _decisions(evidence: Evidence, outcomes: Sequence[Verdict]) -> list[Decision]:
    """Return what was decided about every step, in the order of time."""
    from groundtrace.explain.why import explain_steps

    explained = explain_steps(evidence, TOLERANCE_S, MOST_MENDED)
    texts = {one.time_ns: one.text for one in outcomes}
    number = {m.step for m in explained.missed}
    right = [one for one in outcomes if one.verdict == "hit"]
    numbers = (n for n in range(1, len(outcomes) + 1) if n not in number)
    all_of = [
        *(_right(evidence, one, n) for one, n in zip(right, numbers, strict=False)),
        *(_missed(evidence, one, explained, n) for n, one in enumerate(explained.missed)),
        *(_false(evidence, one, texts, n) for n, one in enumerate(explained.false)),
    ]
    return sorted(all_of, key=lambda decision: (decision.time_ns, decision.verdict))


def _right(evidence: Evidence, one: Verdict, step: int) -> Decision:
    off_ms = ((one.found_ns or 0) - one.time_ns) / 1e6
    how = f"found {abs(off_ms):.0f} ms {'late' if off_ms > 0 else 'early'}"
    title = f"Right: step {step}, {_seconds(evidence, one.time_ns)}"
    return Decision(one.time_ns, "hit", title, how, gates=gates_at(evidence, one.found_ns))


def _missed(evidence: Evidence, one: Missed, explained: StepExplanation, index: int) -> Decision:
    time_ns = _nanoseconds(evidence, one.time_s)
    title = f"Missed: step {one.step}, {_seconds(evidence, time_ns)}"
    none = "no change of one or two parameters finds it without harm"
    if explained.untried:
        none = f"no change was tried: {explained.untried} needs a replay"
    elif index >= MOST_MENDED:
        none = f"{NOT_TRIED} groundtrace why --step {one.step} looks for one"
    remedy, effect = _mended(one.remedy, none)
    text = one.reason.text
    for channel in one.reason.channels[:1]:  # what each channel lacks stands at the sensors
        text = text.partition(f": {channel}")[0]
    cause = f"{one.reason.cause}: {text}"
    gates, silent = one.reason.readings, one.reason.channels
    return Decision(time_ns, "missed", title, cause, remedy, effect, gates, silent, one.step)


def _false(
    evidence: Evidence, one: FalseDetection, texts: Mapping[int, str], index: int
) -> Decision:
    time_ns = _nanoseconds(evidence, one.time_s)
    none = "no change of one or two parameters removes it"
    if index >= MOST_MENDED:
        none = f"{NOT_TRIED} groundtrace why --at {one.time_s:.3f} looks for one"
    remedy, effect = _mended(one.remedy, none)
    cause = "; ".join(filter(None, (texts.get(time_ns, ""), let_pass(one.narrowest))))
    title = f"False: {_seconds(evidence, time_ns)}"
    gates = gates_at(evidence, time_ns)
    return Decision(time_ns, "false", title, cause, remedy, effect, gates)


def let_pass(gate: GateReading | None) -> str:
    """Say which gate let something pass that should not have."""
    if gate is None:
        return "it passed every gate"
    unit = unit_after(gate.unit)
    value, threshold = readable(gate.value), readable(gate.threshold)
    return f"let pass by {gate.gate} {value}{unit} (threshold {threshold}{unit})"


def _mended(remedy: Remedy | None, none: str) -> tuple[str, str]:
    """Return the remedy and what it does, in words."""
    if remedy is None:
        return none, ""
    return remedy.options, remedy.effect


def _seconds(evidence: Evidence, time_ns: int) -> str:
    return f"{(time_ns - evidence.start_ns) / NS_PER_S:.3f} s"


def _nanoseconds(evidence: Evidence, time_s: float) -> int:
    return evidence.start_ns + round(time_s * NS_PER_S)


def _deciding(evidence: Evidence) -> list[StageEvidence]:
    """Return the last stage that finds steps, topic by topic."""
    finding = [part for part in evidence.stages if part.spec.emits == "step"]
    return [part for part in finding if part.spec.stage == finding[-1].spec.stage]


def gates_at(evidence: Evidence, time_ns: int | None) -> tuple[GateReading, ...]:
    """Return what the gates said of the candidate that was accepted at a time."""
    from groundtrace.explain.reasons import readings

    for part in _deciding(evidence):
        rows = np.flatnonzero((part.candidates.time_ns == time_ns) & part.accepted)
        if len(rows):
            return readings(part, int(rows[0]))
    return ()


def doublings(value: float, threshold: float, *, passed: bool) -> float:
    """Return how far a value is from its threshold, in doublings, below 0 where it fails.

    Parameters
    ----------
    value, threshold
        In the gate's unit. Where their ratio says nothing, as with a threshold of 0, it is all
        of :data:`REACH`.
    passed
        What the gate said, so that gates with an upper limit read as those with a lower one.
    """
    ratio = value / threshold if threshold else np.inf
    far = min(abs(float(np.log2(ratio))), REACH) if 0 < ratio < np.inf else REACH
    return far if passed else -far


#: A bar and the gates' plot end at this many doublings from the threshold.
REACH = 2.0
CARD, BARS, MARGINS = "/decision-at-cursor", "/gates-at-cursor", "/gates-over-time"
#: Height of a row of bars, half a bar's width, half a bar's length, and where words stand.
ROW, HALF_BAR, HALF_LENGTH, NAME_AT, VALUE_AT = 26.0, 4.5, 45.0, -104.0, 104.0
#: A label stands below its point: so much above the row it is centred on it.
LABEL_UP = 8.0
GROOVE = 0x23282EFF


class DecisionCard:
    """Logs each decision as a text and as bars, at its time.

    Parameters
    ----------
    timeline
        Where to.
    decisions
        In the order of time.
    """

    def __init__(self, timeline: Timeline, decisions: Sequence[Decision]) -> None:
        self._timeline = timeline
        self._decisions = decisions
        self._rows = max((len(d.gates) for d in decisions), default=0)

    def log(self, start_ns: int) -> None:
        """Log all; until the first one there is none from ``start_ns`` on [ns]."""
        import rerun as rr

        times = [start_ns, *(d.time_ns for d in self._decisions)]
        texts = ["Nothing decided yet.", *(d.card for d in self._decisions)]
        self._timeline.declare(Entity(CARD, "card", "Decision at the cursor"))
        types = ["text/markdown"] * len(texts)
        self._timeline.send(CARD, times, rr.TextDocument.columns(text=texts, media_type=types))
        if self._rows:
            self._log_bars(times, [(), *(d.gates for d in self._decisions)])

    def _log_bars(self, times: Sequence[int], gates: Sequence[tuple[GateReading, ...]]) -> None:
        import rerun as rr

        title = "Gates at the cursor"
        top = ROW * self._rows
        self._timeline.declare(Entity(BARS, "bars", title, self._rows, top=top))
        heights = ROW * np.arange(self._rows)
        grooves = strips_of([np.array([[-HALF_LENGTH, y], [HALF_LENGTH, y]]) for y in heights])
        middle = strips_of([np.array([[0.0, -ROW / 2], [0.0, top - ROW / 2]])])
        groove = rr.LineStrips2D(grooves, radii=HALF_BAR, colors=GROOVE, draw_order=1.0)
        self._timeline.static(f"{BARS}/groove", groove)
        line = rr.LineStrips2D(middle, radii=-1.2, colors=NORM, draw_order=3.0)
        self._timeline.static(f"{BARS}/threshold", line)
        marks = np.arange(-REACH, REACH + 1) * HALF_LENGTH / REACH
        scale = rr.Points2D(
            np.stack([marks, np.full(len(marks), top - LABEL_UP)], axis=1),
            labels=["¼", "½", "1", "2", "4"],
            show_labels=True,
            radii=0.0,
            colors=OUTLINE,
        )
        self._timeline.static(f"{BARS}/scale", scale)
        self._send_bars(times, gates)
        self._send_words("names", NAME_AT, times, gates, lambda gate: gate.gate)
        self._send_words("values", VALUE_AT, times, gates, _value)

    def _send_bars(self, times: Sequence[int], gates: Sequence[tuple[GateReading, ...]]) -> None:
        import rerun as rr

        strips, colours = [], []
        for row in gates:
            for index, gate in enumerate(row):
                far = doublings(gate.value, gate.threshold, passed=gate.passed)
                end = far * HALF_LENGTH / REACH
                strips.append([(0.0, ROW * index), (end, ROW * index)])
                colours.append(ACCEPTED if gate.passed else MISSED)
        style = rr.LineStrips2D.from_fields(radii=HALF_BAR, draw_order=2.0)
        self._timeline.static(f"{BARS}/bar", style)
        columns = rr.LineStrips2D.columns(
            strips=strips_of(strips), colors=np.array(colours, np.uint32)
        )
        self._timeline.send(f"{BARS}/bar", times, columns.partition([len(row) for row in gates]))

    def _send_words(
        self,
        name: str,
        x: float,
        times: Sequence[int],
        gates: Sequence[tuple[GateReading, ...]],
        words: Callable[[GateReading], str],
    ) -> None:
        import rerun as rr

        shown = [(index, gate) for row in gates for index, gate in enumerate(row)]
        path = f"{BARS}/{name}"
        style = rr.Points2D.from_fields(show_labels=True, radii=0.0)
        self._timeline.static(path, style)
        columns = rr.Points2D.columns(
            positions=np.array([(x, ROW * index - LABEL_UP) for index, _ in shown], np.float32),
            labels=[words(gate) for _, gate in shown],
            colors=np.array([NORM if gate.passed else MISSED for _, gate in shown], np.uint32),
        )
        self._timeline.send(path, times, columns.partition([len(row) for row in gates]))


#: Radius of a ring about a sensor, how far above it its verdict stands, and how far below where the
#: map's key is above, as parts of the site.
RING, ABOVE, BELOW = 0.035, 0.14, 0.11
VERDICTS = f"{SITE}/verdicts"


class SensorVerdicts:
    """Rings the sensors at a step that too few of them picked: green where picked, else red.

    Red is, too, where the step was.

    Parameters
    ----------
    timeline
        Where to.
    geometry
        Has their places.
    true
        Where true steps were [m], by their time [ns], as far as it is known.
    """

    def __init__(
        self, timeline: Timeline, geometry: Geometry, true: Mapping[int, tuple[float, float]]
    ) -> None:
        self._timeline = timeline
        self._true = true
        self._positions = {sensor.channel: (sensor.x, sensor.y) for sensor in geometry.sensors}
        places = np.array(list(self._positions.values()))
        self._extent = float(np.ptp(places, axis=0).max()) if len(places) else 0.0

    def log(self, decisions: Sequence[Decision]) -> None:
        """Log the verdicts at every step; there are none where a step is right, or has no group."""
        import rerun as rr

        if not self._extent or not any(decision.silent for decision in decisions):
            return
        rings = [self._rings(decision) for decision in decisions]
        times, counts = [d.time_ns for d in decisions], [len(row) for row in rings]
        shown = [ring for row in rings for ring in row]
        turn = np.linspace(0.0, 2 * np.pi, 25)
        circle = RING * self._extent * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        style = rr.LineStrips2D.from_fields(radii=-1.5, draw_order=5.0)
        self._timeline.static(f"{VERDICTS}/rings", style)
        colours = np.array([ring.colour for ring in shown], np.uint32)
        strips = strips_of([circle + np.array(ring.position) for ring in shown])
        columns = rr.LineStrips2D.columns(strips=strips, colors=colours)
        self._timeline.send(f"{VERDICTS}/rings", times, columns.partition(counts))
        words = rr.Points2D.from_fields(show_labels=True, radii=0.0)
        self._timeline.static(f"{VERDICTS}/words", words)
        labelled = [[ring for ring in row if ring.text] for row in rings]
        red = [ring for row in labelled for ring in row]
        word_columns = rr.Points2D.columns(
            positions=np.array([ring.position for ring in red], np.float32)
            + np.array([self._beside(ring.position) for ring in red], np.float32),
            labels=[ring.text for ring in red],
            colors=np.array([ring.colour for ring in red], np.uint32),
        )
        self._timeline.send(
            f"{VERDICTS}/words", times, word_columns.partition([len(row) for row in labelled])
        )

    def _beside(self, position: tuple[float, float]) -> tuple[float, float]:
        """Return where a verdict stands from its sensor: clear of its name and of the map's key."""
        highest = max(y for _, y in self._positions.values())
        near_key = position[1] > highest - ABOVE * self._extent
        return 0.0, (-BELOW if near_key else ABOVE) * self._extent

    def _rings(self, decision: Decision) -> list[Ring]:
        if not decision.silent:
            return []
        why = {}
        for channel in self._positions:
            texts = [text for text in decision.silent if text.startswith(f"{channel} ")]
            if texts:
                why[channel] = _short(texts[0].removeprefix(f"{channel} "))
        here = self._true.get(decision.time_ns)
        return [
            *(
                Ring(position, MISSED if channel in why else ACCEPTED, why.get(channel, ""))
                for channel, position in self._positions.items()
            ),
            *([] if here is None else [Ring(here, MISSED, "")]),
        ]


def _short(text: str) -> str:
    """Return a channel's verdict in a few letters: the numbers alone where there are some."""
    compared = re.match(r"\S+ (\S+)(?: \S+)? ([<>]) (\S+)", text)
    return " ".join(compared.groups()) if compared else textwrap.shorten(text, 18, placeholder="…")


class Ring(NamedTuple):
    """A ring: where [m], its colour, and what a sensor lacks; nothing where it lacks nothing."""

    position: tuple[float, float]
    colour: int
    text: str


def value_text(gate: GateReading, digits: int = 4) -> str:
    """Return a gate's value, in words where it has none."""
    if not np.isfinite(gate.value):
        return "no limit met" if gate.passed else "no number"
    return readable(gate.value, digits)


def _value(gate: GateReading) -> str:
    """Return a gate's value beside its threshold: short, since a name has the same room."""
    if not np.isfinite(gate.value):
        return value_text(gate)
    sign = "≥" if gate.value >= gate.threshold else "<"
    return f"{value_text(gate, 3)} {sign} {readable(gate.threshold, 3)}"


#: Shapes of gates in their plot, with what the title calls them.
SHAPES: Final[tuple[tuple[Literal["circle", "square", "diamond", "up", "down"], str], ...]] = (
    ("circle", "●"),
    ("square", "■"),
    ("diamond", "◆"),
    ("up", "▲"),
    ("down", "▼"),
)
#: With more candidates than this the gates have no plot: it would be a surface.
MOST_CANDIDATES = 50_000


class GatesPlot:
    """Logs how far every candidate was from each threshold, and missed steps as bands.

    Parameters
    ----------
    timeline
        Where to.
    evidence
        Of the replay.
    span_ns
        What is shown of the recording [ns].
    """

    def __init__(self, timeline: Timeline, evidence: Evidence, span_ns: tuple[int, int]) -> None:
        self._timeline = timeline
        self._parts = _deciding(evidence)
        self._span_ns = span_ns

    def log(self, wrong: Sequence[Verdict]) -> None:
        """Log all of it."""
        import rerun as rr

        gates = self._parts[0].spec.gates if self._parts else ()
        count = sum(len(part.candidates.time_ns) for part in self._parts)
        if not 1 <= len(gates) <= len(SHAPES) or count > MOST_CANDIDATES:
            return
        key = " ".join(
            f"{sign} {gate.name}" for gate, (_, sign) in zip(gates, SHAPES, strict=False)
        )
        title = f"Gates, doublings over threshold: {key}; below 0 fails"
        end = REACH + 0.5
        self._timeline.declare(Entity(MARGINS, "margins", title, len(gates), top=end, bottom=-end))
        level = rr.SeriesLines(names="threshold", colors=np.array([OUTLINE], np.uint32))
        self._timeline.static(f"{MARGINS}/threshold", level)
        self._timeline.level(f"{MARGINS}/threshold", self._span_ns, 0.0)
        _log_bands(self._timeline, (MARGINS, ""), wrong, (-end, end))
        for index, (gate, (shape, _)) in enumerate(zip(gates, SHAPES, strict=False)):
            style = rr.SeriesPoints(names=gate.name, markers=shape, marker_sizes=4.0)
            self._timeline.static(f"{MARGINS}/{index}", style)
            self._send(index)

    def _send(self, index: int) -> None:
        import rerun as rr

        times = np.concatenate([part.candidates.time_ns for part in self._parts])
        values = np.concatenate([part.gate_value[:, index] for part in self._parts])
        passed = np.concatenate([part.margin[:, index] >= 0 for part in self._parts])
        threshold = self._parts[0].spec.gates[index].threshold
        far = [
            doublings(float(value), threshold, passed=bool(ok))
            for value, ok in zip(values, passed, strict=True)
        ]
        order: NDArray[np.intp] = np.argsort(times, kind="stable")
        colours = np.where(passed, ACCEPTED, MISSED).astype(np.uint32)
        columns = [
            *rr.Scalars.columns(scalars=np.array(far)[order]),
            *rr.SeriesPoints.columns(colors=colours[order]),
        ]
        self._timeline.send(f"{MARGINS}/{index}", times[order], columns)


def _log_bands(
    timeline: Timeline, around: tuple[str, str], wrong: Sequence[Verdict], span: tuple[float, float]
) -> list[str]:
    """Log wrong steps as bands, as wide as the tolerance: what fills a plot is a deviation.

    Parameters
    ----------
    timeline
        Where to.
    around
        What stands before and after the verdict in the entity's path.
    wrong
        Which steps.
    span
        From where to where the bands go.

    Returns
    -------
    list
        The verdicts that have bands.
    """
    import rerun as rr

    before, after = around
    middle, variance = sum(span) / 2, ((span[1] - span[0]) / 2) ** 2
    kinds = list(dict.fromkeys(one.verdict for one in wrong))
    for verdict in kinds:
        path, colour = f"{before}/{verdict}{after}", VERDICT_COLOURS[verdict]
        at = [one.time_ns for one in wrong if one.verdict == verdict]
        edges = (-TOLERANCE_NS, TOLERANCE_NS, TOLERANCE_NS + 1)
        times = np.array([t + edge for t in at for edge in edges])
        style = rr.SeriesLines(names=verdict, colors=np.array([colour], np.uint32), widths=[0.01])
        timeline.static(path, style)
        columns = rr.Measurements.columns(
            values=np.tile([middle, middle, np.nan], len(at)),
            variances=np.tile([variance, variance, 0.0], len(at)),
            colors=np.full(len(times), colour, np.uint32),
        )
        timeline.send(path, times, columns)
    return kinds
