"""Reasons: why there is no step at a time, in the words of the stage that decided."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..parameters import build
from ..plugins import stage_named
from ..score.step_timing import (
    answers_text,
    found_text,
    later_text,
    off_text,
    step_reach_s,
    timing_pairs,
)
from .counted import matched
from .evidence import step_times
from .readings import GateReading, below, closeness, readings, told_apart
from .silence import MAXIMUM, silence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Gap

    from ..pipeline import StageConfig
    from ..score import StepMatch, TimingPair
    from .evidence import Evidence, StageEvidence, Unmuted

#: The cause of a miss, in one word; ``score`` and fleets count them.
CAUSES = (
    "timing",
    "refractory",
    "threshold",
    "coincidence",
    "dead",
    "clipped",
    "filter",
    "quiet",
    "shape",
    "walking",
    "gap",
    "taken",
    "undecided",
)


FILTERED = "the filter takes it out (change the band and replay)"


@dataclass(frozen=True, slots=True)
class Reason:
    """Why nothing was accepted at a time.

    Attributes
    ----------
    cause
        One of :data:`CAUSES`.
    text
        The same for people.
    stage, topic, channel
        Where.
    candidate_s
        Time of the nearest candidate [s since the first sample], or None.
    gate
        Name of the first gate that failed, or empty.
    readings
        All gates of that candidate, in order.
    channels
        For a group of picks: why each missing channel is missing.
    """

    cause: str
    text: str
    stage: str
    topic: str
    channel: str = ""
    candidate_s: float | None = None
    gate: str = ""
    readings: tuple[GateReading, ...] = ()
    channels: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class WrongTime:
    """A true step found at the wrong time: a missed and a false step that are one error.

    Attributes
    ----------
    step
        Number of the true step among the scored ones, from 1.
    time_s, found_s
        Of the true step and of its detection [s since the first sample].
    late_ms
        By how much it was found late (> 0) or early [ms].
    text
        What the detection is, for people: ``answers step 12, 126 ms late``.
    """

    step: int
    time_s: float
    found_s: float
    late_ms: float
    text: str


class StepReasons:
    """Says why there is no step at a time; knows which steps were found at the wrong one.

    Parameters
    ----------
    evidence
        Of the result, as decided.
    tolerance_s
        Candidates up to this far away count.
    matching
        What the detections answer; by default the true steps of the evidence.
    """

    def __init__(
        self, evidence: Evidence, tolerance_s: float, matching: StepMatch | None = None
    ) -> None:
        self.evidence = evidence
        self.tolerance_s = tolerance_s
        self.matching = matched(evidence, tolerance_s) if matching is None else matching
        self.pairs = timing_pairs(self.matching)
        self._by_time = {p.found_ns: p for p in self.pairs} | {p.truth_ns: p for p in self.pairs}
        #: What the time of a step is told by: true steps, or where none are known those found.
        known_ns = self.matching.truth_ns if len(self.matching.truth_ns) else step_times(evidence)
        self._known_s = (known_ns - evidence.start_ns) / NS_PER_S

    def pair_of(self, time_ns: int) -> TimingPair | None:
        """Return the pair whose true step, or whose detection, is at a time."""
        return self._by_time.get(time_ns)

    def wrong_time(self, time_ns: int) -> WrongTime | None:
        """Return the pair whose true step, or whose detection, is at a time, as it is told."""
        pair = self.pair_of(time_ns)
        if pair is None:
            return None
        start_ns = self.evidence.start_ns
        return WrongTime(
            pair.step,
            (pair.truth_ns - start_ns) / NS_PER_S,
            (pair.found_ns - start_ns) / NS_PER_S,
            pair.late_ns / 1e6,
            answers_text(pair, self.tolerance_s),
        )

    def at(self, time_ns: int) -> Reason:
        """Say why there is no step at a time, that of a true step or any other."""
        evidence = self.evidence
        if not evidence.config.stage:
            return Reason("undecided", "the pipeline has no stage: nothing decides", "", "")
        within = round(self.tolerance_s * NS_PER_S)
        final = _last_stage(evidence, "step") or evidence.config.stage[-1].key
        near = self._candidates(final, time_ns, within)
        pair = self.pair_of(time_ns)
        if pair is not None and pair.truth_ns == time_ns:
            return self._found(final, pair, near)
        if near:
            part, row = min(near, key=lambda item: closeness(item[0], item[1], time_ns))
            return self._failed(part, row, time_ns, within)
        far = self._candidates(final, time_ns, self._reach_ns(time_ns))
        own = [item for item in far if self._is_nearest(item, time_ns)]
        accepted = any(part.accepted[row] for part, row in own)
        nothing = None if accepted else _nothing(evidence, final, time_ns, within)
        # a candidate farther off that is no step says little where there was no signal at all
        if nothing is not None and (not own or nothing.cause in {"gap", "dead"}):
            return nothing
        part, row = min(own, key=lambda item: closeness(item[0], item[1], time_ns))
        return self._off(part, row, time_ns)

    def _candidates(self, stage: str, time_ns: int, reach: int) -> list[tuple[StageEvidence, int]]:
        return [
            (part, int(row))
            for part in self.evidence.of(stage)
            for row in part.between(time_ns - reach, time_ns + reach)
        ]

    def _reach_ns(self, time_ns: int) -> int:
        at_s = np.array([(time_ns - self.evidence.start_ns) / NS_PER_S])
        return round(float(step_reach_s(self._known_s, at_s)[0]) * NS_PER_S)

    def _is_nearest(self, item: tuple[StageEvidence, int], time_ns: int) -> bool:
        """Whether a candidate is nearer to a time than to any true step that is not there."""
        part, row = item
        found_ns = int(part.candidates.time_ns[row])
        others = self.matching.truth_ns[self.matching.truth_ns != time_ns]
        return bool((np.abs(others - found_ns) >= abs(found_ns - time_ns)).all())

    def _found(self, stage: str, pair: TimingPair, near: list[tuple[StageEvidence, int]]) -> Reason:
        """Say that a step was found at the wrong time, and what became of candidates in time."""
        text = found_text(pair, self.tolerance_s)
        rejected = [(part, row) for part, row in near if not part.accepted[row]]
        if rejected:
            part, row = min(rejected, key=lambda item: closeness(item[0], item[1], pair.truth_ns))
            off_ns = int(part.candidates.time_ns[row]) - pair.truth_ns
            first = next(r for r in readings(part, row) if not r.passed)
            text = f"{text}; a candidate {later_text(off_ns)} is rejected: {below(first)}"
        part, row = next(
            (part, int(row))
            for part in self.evidence.of(stage)
            for row in part.between(pair.found_ns, pair.found_ns)
            if part.accepted[row]
        )
        return self._timing(part, row, text)

    def _off(self, part: StageEvidence, row: int, time_ns: int) -> Reason:
        """Say that the candidate of a step lies beyond the tolerance, and what rejects it too."""
        found_ns = int(part.candidates.time_ns[row])
        off, tolerance = off_text(found_ns - time_ns, self.tolerance_s)
        first = next((r for r in readings(part, row) if not r.passed), None)
        other = self.pair_of(found_ns)
        if first is not None:
            text = f"a candidate {off} (tolerance {tolerance} ms), which {below(first)} rejects too"
            return self._timing(part, row, text, first.gate)
        if other is None:
            return self._timing(part, row, f"found {off}, tolerance {tolerance} ms")
        text = f"the detection {off} answers step {other.step}"
        return replace(self._timing(part, row, text), cause="taken")

    def _timing(self, part: StageEvidence, row: int, text: str, gate: str = "") -> Reason:
        spec = part.spec
        channel = spec.channels[int(part.candidates.channel[row])]
        at_s = (int(part.candidates.time_ns[row]) - self.evidence.start_ns) / NS_PER_S
        where = (spec.stage, spec.topic, channel, at_s)
        return Reason("timing", text, *where, gate, readings(part, row))

    def _failed(self, part: StageEvidence, row: int, time_ns: int, reach: int) -> Reason:
        """Say which gate a candidate failed first, or whose it is."""
        if not part.accepted[row]:
            return _failed(self.evidence, part, row, time_ns, reach)
        found_ns = int(part.candidates.time_ns[row])
        matching = self.matching
        answered = matching.truth_ns[
            matching.pairs[matching.found_ns[matching.pairs[:, 1]] == found_ns, 0]
        ]
        step = "another step"
        if len(answered):
            step = f"step {int(np.searchsorted(matching.truth_ns, answered[0])) + 1}"
        at_s = (found_ns - self.evidence.start_ns) / NS_PER_S
        text = f"its detection at {at_s:.3f} s answers {step}"
        return replace(self._timing(part, row, text), cause="taken")


def reason_at(evidence: Evidence, time_ns: int, tolerance_s: float) -> Reason:
    """Say why there is no step at one time; of several, ask one :class:`StepReasons`.

    Parameters
    ----------
    evidence
        Of the result, as decided.
    time_ns
        The moment.
    tolerance_s
        Candidates up to this far away count.
    """
    return StepReasons(evidence, tolerance_s).at(time_ns)


def _last_stage(evidence: Evidence, emits: str) -> str:
    stages = [part.spec.stage for part in evidence.stages if part.spec.emits == emits]
    return stages[-1] if stages else ""


def _failed(evidence: Evidence, part: StageEvidence, row: int, time_ns: int, reach: int) -> Reason:
    """Say which gate a rejected candidate failed first."""
    all_readings = readings(part, row)
    at_s = (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S
    channel = part.spec.channels[int(part.candidates.channel[row])]
    spec = part.spec
    first = next(r for r in all_readings if not r.passed)
    cause, text, missing = _verdict(evidence, part, row, first, time_ns, reach)
    more = [r.gate for r in all_readings if not r.passed and r.gate != first.gate]
    if more:
        text = f"{text}; {' and '.join(more)} would fail too"
    return Reason(
        cause, text, spec.stage, spec.topic, channel, at_s, first.gate, all_readings, missing
    )


def _verdict(
    evidence: Evidence,
    part: StageEvidence,
    row: int,
    first: GateReading,
    time_ns: int,
    reach: int,
) -> tuple[str, str, tuple[str, ...]]:
    """Return cause, sentence and, for a group of picks, the missing channels."""
    if first.gate == "refractory":
        return "refractory", _merged(first), ()
    if not part.spec.trace:  # a group of picks: say what its channels lack
        return _lacking(evidence, part, row, first, time_ns, reach)
    if first.gate == "activity":
        return "walking", f"nobody seems to walk: {below(first)}", ()
    channel = 0
    hint = silence(part, channel, time_ns - reach, time_ns + reach)
    if hint.cause in {"clipped", "dead"} and len(part.spec.channels) == 1:
        return hint.cause, f"{below(first)}; {hint.text}", ()
    if len(part.spec.channels) == 1 and evidence.unfiltered is not None:
        found = evidence.unfiltered.clipped(part, time_ns - reach, time_ns + reach)
        if found is not None:
            channel_text = f"{found[0]} is clipped: it stands still at its extreme"
            return "clipped", f"{below(first)}; {channel_text} for {found[1] * 1e3:.0f} ms", ()
    return "threshold", below(first), ()


def _lacking(
    evidence: Evidence,
    part: StageEvidence,
    row: int,
    first: GateReading,
    time_ns: int,
    reach: int,
) -> tuple[str, str, tuple[str, ...]]:
    """Say what the missing channels of a group of picks lack.

    A step is named by its coincidence where too few channels felt it. Those that are broken, lose
    it to the filter, or are held off by the refractory gate, as which only a candidate is that
    passes every level, say nothing against that: they are the cause where they would be enough.
    """
    missing = missing_channels(evidence, part, time_ns, reach, _span_of_group(part, row))
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    if first.gate != "channels":
        return "coincidence", below(first), names
    text = f"picked on {first.value:g} of {first.threshold:g} channels needed"
    cause = "coincidence"
    for other in ("refractory", "dead", "clipped", "filter"):
        if first.value + sum(m.cause == other for m in missing) >= first.threshold:
            cause = other
    source, signal = _upstream(evidence, part), evidence.unfiltered
    filtered = cause == "coincidence" and any(m.cause == "filter" for m in missing)
    if filtered and source is not None and signal is not None:
        found = signal.group(part, source, time_ns - reach, time_ns + reach)
        if found is not None:
            cause = "filter"
            text = f"{text}, by {found.value:g} without the filter (change the band and replay)"
    return cause, "; ".join([f"{text}: {names[0]}", *names[1:]]) if names else text, names


def _span_of_group(part: StageEvidence, row: int) -> tuple[int, int]:
    """Return first and last pick of a group [ns]; its candidate may hold how long it lasted."""
    begin = int(part.candidates.time_ns[row])
    names = [column.name for column in part.spec.columns]
    length_s = float(part.candidates.value[row, names.index("span")]) if "span" in names else 0.0
    return begin, begin + round(length_s * NS_PER_S) + 1000  # the stored length is rounded


def _merged(reading: GateReading) -> str:
    # a time is stored rounded: one that just fails may read as the threshold itself
    since_s = min(reading.value, reading.threshold - abs(reading.margin))
    since, least = told_apart(since_s * 1e3, reading.threshold * 1e3, 3)
    return f"merged with the step {since} ms earlier by the refractory gate ({least} ms)"


def _nothing(evidence: Evidence, stage: str, time_ns: int, reach: int) -> Reason:
    """Say why the final stage had no candidate at all."""
    parts = evidence.of(stage)
    if not parts:
        return Reason("quiet", "the stage ran on no stream", stage, "")
    part = parts[0]
    gap = _gap_at(evidence, part.spec.topic, time_ns - reach, time_ns + reach)
    if gap is not None:
        start_s, end_s = ((t - evidence.start_ns) / NS_PER_S for t in (gap.start_ns, gap.end_ns))
        text = f"no signal: {gap.reason} at {start_s:.3f} s"
        if gap.end_ns > gap.start_ns:
            lost = f"{gap.reason}, {gap.lost} samples"
            text = f"no signal from {start_s:.3f} to {end_s:.3f} s: {lost}"
        return Reason("gap", text, stage, part.spec.topic)
    within_ms = f"{reach / 1e6:.6g} ms"
    if part.spec.trace:
        cause, text = silent(evidence, part, 0, time_ns, reach)
        nearest = _nearest_text(part, time_ns)
        text = f"no candidate within {within_ms}: {text}{nearest}"
        return Reason(cause, text, stage, part.spec.topic)
    missing = missing_channels(evidence, part, time_ns, reach)
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    source = _upstream(evidence, part)
    signal = evidence.unfiltered
    if source is not None and signal is not None and signal.at_hand:
        found = signal.group(part, source, time_ns - reach, time_ns + reach)
        if found is not None:
            text = (
                f"{FILTERED}: without it {found.value:g} channels pick it "
                f"{later_text(found.time_ns - time_ns)}; no channel was picked: "
            )
            where = (stage, part.spec.topic)
            return Reason("filter", text + "; ".join(names), *where, channels=names)
    causes = [m.cause for m in missing]
    told = [cause for cause in causes if cause != "quiet"]
    # where most channels were quiet, what a few have of their own does not explain it
    quiet = 2 * len(told) < len(causes) or not told
    cause = "quiet" if quiet else max(told, key=told.count)
    picked = "taken" in causes or source is None or len(names) < len(source.spec.channels)
    text = f"no group of picks within {within_ms}" if picked else "no channel was picked"
    return Reason(
        cause,
        ": ".join(filter(None, (text, "; ".join(names)))),
        stage,
        part.spec.topic,
        channels=names,
    )


def _gap_at(evidence: Evidence, topic: str, start_ns: int, end_ns: int) -> Gap | None:
    """Return the gap of a stream that overlaps a span and ended a run."""
    gaps = (g for g in evidence.gaps if g.topic in (topic, "") and not g.bridged)
    return next((g for g in gaps if g.start_ns <= end_ns and g.end_ns >= start_ns), None)


def _nearest_text(part: StageEvidence, time_ns: int) -> str:
    """Say where the nearest candidate is; it belongs to another step."""
    if not len(part.candidates):
        return "; there is no candidate at all"
    times = part.candidates.time_ns
    off_ns = int(times[np.argmin(np.abs(times - time_ns))]) - time_ns
    return f"; the nearest candidate comes {later_text(off_ns)}"


def silent(
    evidence: Evidence, part: StageEvidence, channel: int, time_ns: int, reach: int
) -> tuple[str, str]:
    """Return cause and sentence of a channel without a candidate around a time.

    The filter is named where the recording is at hand, and without the filter there is a candidate
    that passes all thresholds.
    """
    stage = next((s for s in evidence.config.stage if s.key == part.spec.stage), None)
    floor, sought = None, MAXIMUM
    if stage is not None:
        floor = stage.parameters.get("floor")
        sought = getattr(stage_named(stage.use), "sought", MAXIMUM)
    quiet = silence(part, channel, time_ns - reach, time_ns + reach, floor, sought)
    if stage is None or quiet.cause not in {"quiet", "shape"}:
        return quiet.cause, quiet.text
    signal = evidence.unfiltered
    if signal is not None and signal.at_hand:
        found = signal.nearest(part, channel, time_ns - reach, time_ns + reach)
        if found is None:
            return quiet.cause, quiet.text
        levels = f"; {quiet.levels}" if quiet.levels else ""
        return "filter", f"{without_filter(part, found, time_ns)}; {quiet.text}{levels}"
    if not quiet.levels or unfiltered_kind(stage) is None:
        return quiet.cause, quiet.text
    return quiet.cause, (
        f"{quiet.text}; {quiet.levels}: it takes the recording to tell whether the filter took a "
        f"step out (why --recording)"
    )


def unfiltered_kind(stage: StageConfig) -> tuple[type[Any], Any] | None:
    """Return a detector's class and parameters without its filter; None where it has none."""
    kind: Any = stage_named(stage.use)
    hook = getattr(kind, "unfiltered", None)
    if hook is None:
        return None
    worker: tuple[type[Any], Any] = hook(build(kind.Parameters, stage.parameters, stage.key))
    return worker


def without_filter(part: StageEvidence, found: Unmuted, time_ns: int) -> str:
    """Say that the filter takes something out, by the candidate that is there without it."""
    first = part.spec.columns[0]
    unit = "" if first.unit == "1" else f" {first.unit}"
    return (
        f"{FILTERED}: without it a candidate {later_text(found.time_ns - time_ns)} passes every "
        f"threshold ({first.name} {found.value:.4g}{unit})"
    )


def _upstream(evidence: Evidence, part: StageEvidence) -> StageEvidence | None:
    """Return the picking stage before an associator, on the same topic."""
    order = [stage.key for stage in evidence.config.stage]
    before = order[: order.index(part.spec.stage)]
    sources = [
        e
        for key in before
        for e in evidence.of(key)
        if e.spec.emits == "pick" and e.spec.topic == part.spec.topic
    ]
    return sources[-1] if sources else None


@dataclass(frozen=True, slots=True)
class MissingChannel:
    """A channel without a pick, and why."""

    channel: str
    cause: str
    text: str


def missing_channels(
    evidence: Evidence,
    part: StageEvidence,
    time_ns: int,
    reach: int,
    group_ns: tuple[int, int] | None = None,
) -> tuple[MissingChannel, ...]:
    """Say for each channel without a pick in a group, or around a time, why it has none."""
    source = _upstream(evidence, part)
    if source is None:
        return ()
    rows = source.between(time_ns - reach, time_ns + reach)
    group = source.between(*(group_ns or (time_ns - reach, time_ns + reach)))
    picked = set(source.candidates.channel[group[source.accepted[group]]].tolist())
    return tuple(
        MissingChannel(name, *channel_verdict(source, rows, channel, time_ns, reach, evidence))
        for channel, name in enumerate(source.spec.channels)
        if channel not in picked
    )


def channel_verdict(
    source: StageEvidence,
    rows: NDArray[np.intp],
    channel: int,
    time_ns: int,
    reach: int,
    evidence: Evidence | None = None,
) -> tuple[str, str]:
    """Return cause and sentence for one channel without a pick; ``rows`` are candidates near."""
    own = rows[source.candidates.channel[rows] == channel]
    if not len(own) and evidence is not None:
        return silent(evidence, source, channel, time_ns, reach)
    quiet = silence(source, channel, time_ns - reach, time_ns + reach)
    if quiet.cause in {"dead", "clipped"} or not len(own):
        return quiet.cause, quiet.text
    row = int(min(own, key=lambda r: closeness(source, int(r), time_ns)))
    first = next((r for r in readings(source, row) if not r.passed), None)
    if first is None:
        later_ms = (int(source.candidates.time_ns[row]) - time_ns) / 1e6
        return "taken", f"was picked {later_ms:+.0f} ms from it, in another group"
    return ("refractory" if first.gate == "refractory" else "threshold"), below(first)
