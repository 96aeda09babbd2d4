"""Reasons: why there is no step at a time, in the words of the stage that decided."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .readings import GateReading, below, closeness, readings
from .silence import silence

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .evidence import Evidence, StageEvidence

#: The cause of a miss, in one word; ``score`` and fleets count them.
CAUSES = (
    "refractory",
    "threshold",
    "coincidence",
    "dead",
    "clipped",
    "filter",
    "quiet",
    "walking",
    "gap",
    "taken",
    "undecided",
)


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


def reason_at(evidence: Evidence, time_ns: int, tolerance_s: float) -> Reason:
    """Say why there is no step at a time.

    Parameters
    ----------
    evidence
        Of the result, as decided.
    time_ns
        The moment.
    tolerance_s
        Candidates up to this far away count.
    """
    if not evidence.config.stage:
        return Reason("undecided", "the pipeline has no stage: nothing decides", "", "")
    reach = round(tolerance_s * NS_PER_S)
    final = _last_stage(evidence, "step") or evidence.config.stage[-1].key
    found = [
        (part, row)
        for part in evidence.of(final)
        for row in part.between(time_ns - reach, time_ns + reach)
    ]
    if not found:
        return _nothing(evidence, final, time_ns, reach)
    part, row = min(found, key=lambda item: closeness(item[0], int(item[1]), time_ns))
    return _failed(evidence, part, int(row), time_ns, reach)


def _last_stage(evidence: Evidence, emits: str) -> str:
    stages = [part.spec.stage for part in evidence.stages if part.spec.emits == emits]
    return stages[-1] if stages else ""


def _failed(evidence: Evidence, part: StageEvidence, row: int, time_ns: int, reach: int) -> Reason:
    """Say which gate a candidate failed first."""
    all_readings = readings(part, row)
    at_s = (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S
    channel = part.spec.channels[int(part.candidates.channel[row])]
    spec = part.spec
    first = next((r for r in all_readings if not r.passed), None)
    if first is None:
        text = f"its detection at {at_s:.3f} s answers another step"
        return Reason("taken", text, spec.stage, spec.topic, channel, at_s, "", all_readings)
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
    return "threshold", below(first), ()


def _lacking(
    evidence: Evidence,
    part: StageEvidence,
    row: int,
    first: GateReading,
    time_ns: int,
    reach: int,
) -> tuple[str, str, tuple[str, ...]]:
    """Say what the missing channels of a group of picks lack; broken ones are the cause."""
    missing = missing_channels(evidence, part, time_ns, reach, _span_of_group(part, row))
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    if first.gate != "channels":
        return "coincidence", below(first), names
    text = f"picked on {first.value:g} of {first.threshold:g} channels needed"
    cause = "coincidence"
    for broken in ("dead", "clipped"):
        if first.value + sum(m.cause == broken for m in missing) >= first.threshold:
            cause = broken
    return cause, "; ".join([f"{text}: {names[0]}", *names[1:]]) if names else text, names


def _span_of_group(part: StageEvidence, row: int) -> tuple[int, int]:
    """Return first and last pick of a group [ns]; its candidate may hold how long it lasted."""
    begin = int(part.candidates.time_ns[row])
    names = [column.name for column in part.spec.columns]
    length_s = float(part.candidates.value[row, names.index("span")]) if "span" in names else 0.0
    return begin, begin + round(length_s * NS_PER_S) + 1000  # the stored length is rounded


def _merged(reading: GateReading) -> str:
    return (
        f"merged with the step {reading.value * 1e3:.0f} ms earlier by the refractory gate "
        f"({reading.threshold * 1e3:.0f} ms)"
    )


def _nothing(evidence: Evidence, stage: str, time_ns: int, reach: int) -> Reason:
    """Say why the final stage had no candidate at all."""
    parts = evidence.of(stage)
    if not parts:
        return Reason("quiet", "the stage ran on no stream", stage, "")
    part = parts[0]
    gap = next(
        (g for g in evidence.gaps if g.start_ns - reach <= time_ns <= g.end_ns + reach), None
    )
    if gap is not None and not gap.bridged:
        text = f"no signal: {gap.reason}, {gap.lost} samples"
        return Reason("gap", text, stage, part.spec.topic)
    if part.spec.trace:
        quiet = silence(part, 0, time_ns - reach, time_ns + reach)
        return Reason(quiet.cause, f"no candidate: {quiet.text}", stage, part.spec.topic)
    missing = missing_channels(evidence, part, time_ns, reach)
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    causes = [m.cause for m in missing if m.cause != "quiet"]
    cause = max(causes, key=causes.count, default="quiet")
    text = "no channel was picked: " + "; ".join(names)
    return Reason(cause, text, stage, part.spec.topic, channels=names)


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
        MissingChannel(name, *channel_verdict(source, rows, channel, time_ns, reach))
        for channel, name in enumerate(source.spec.channels)
        if channel not in picked
    )


def channel_verdict(
    source: StageEvidence, rows: NDArray[np.intp], channel: int, time_ns: int, reach: int
) -> tuple[str, str]:
    """Return cause and sentence for one channel without a pick; ``rows`` are candidates near."""
    quiet = silence(source, channel, time_ns - reach, time_ns + reach)
    own = rows[source.candidates.channel[rows] == channel]
    if quiet.cause in {"dead", "clipped", "filter"} or not len(own):
        return quiet.cause, quiet.text
    row = int(min(own, key=lambda r: closeness(source, int(r), time_ns)))
    first = next((r for r in readings(source, row) if not r.passed), None)
    if first is None:
        later_ms = (int(source.candidates.time_ns[row]) - time_ns) / 1e6
        return "taken", f"was picked {later_ms:+.0f} ms from it, in another group"
    return ("refractory" if first.gate == "refractory" else "threshold"), below(first)
