"""What a recording contains: streams, gaps, faults, clocks, truth, damage, as one document."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.device_clocks import merged_clocks
from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import Gap
from groundtrace_codecs.importers.base import CLOCKS
from groundtrace_codecs.importers.units import UnitWatch
from groundtrace_codecs.schemas.event_messages import TRUTH_TOPIC
from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S

from ..pipeline.source import Source
from .pipelines import suggested_pipelines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import Stream

    from ..detectors.fault_scan import FaultScan
    from ..detectors.signal_faults import Finding
    from ..inertial.placement import Measures, PlacementWatch
    from ..inertial.worn_sensor_faults import AxisCheck

#: Name of the metadata record that says where others published a recording, and by which licence.
SOURCE = "groundtrace.source"
#: How long a step is heard [ns]: a gap that begins in this time after it cuts it. Chosen by
#: judgement: most of the 200 ms that a step's signal lasts at most (thesis, section 3.2).
STEP_NS = 150_000_000
#: A stream that begins or ends so much off the others is worth a line [s, sampling intervals].
#: Chosen by judgement: streams are started one after the other, and the slowest ones have few
#: samples.
LATE_S, LATE_SAMPLES = 1.0, 20
#: A stream whose samples fill less than this part of its span is one of single shots. Chosen by
#: judgement: less than a fifth of a recording is lost by gaps.
SHOTS = 0.8


@dataclass(frozen=True, slots=True)
class GuessInfo:
    """Where a sensor may be worn, and what that was decided by (:mod:`~.inertial.placement`)."""

    placement: str
    confidence: float
    contradicts: bool
    measures: Measures
    text: str


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One sampled stream of a recording; times are seconds from its first sample."""

    topic: str
    rate_hz: float
    irregular: bool
    placement: str
    channels: list[dict[str, str]]
    samples: int | None
    start_s: float | None
    end_s: float | None
    placement_guess: GuessInfo | None


@dataclass(frozen=True, slots=True)
class GapInfo:
    """One interruption; ``steps`` is how many true steps it cuts or swallows."""

    topic: str
    start_s: float
    end_s: float
    reason: str
    lost: int
    bridged: bool
    steps: int


@dataclass(frozen=True, slots=True)
class DamageInfo:
    """One damaged place of the file."""

    offset: int
    length: int
    messages: int | None
    start_s: float | None
    end_s: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class FaultInfo:
    """One kind of fault of one channel; times are seconds from the recording's first sample."""

    topic: str
    channel: str
    kind: str
    start_s: float
    end_s: float
    events: int
    share: float
    what: str
    effect: str
    remedy: str


@dataclass(frozen=True, slots=True)
class StageInfo:
    """One stage of a pipeline, with every parameter as it stood."""

    name: str
    use: str
    parameters: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ResultsInfo:
    """What results hold: of which recording, by which pipeline, how many events, how well."""

    recording: str
    sha256: str
    pipeline: str
    duration_s: float
    stages: list[StageInfo]
    events: dict[str, int]
    score: dict[str, float]


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Everything that there is to say of a recording; what ``info --json`` prints."""

    recording: str
    bytes: int
    start_ns: int
    start: str | None
    duration_s: float
    streams: list[StreamInfo]
    others: list[dict[str, str | int]]
    gaps: list[GapInfo]
    damage: list[DamageInfo]
    truth: dict[str, int]
    geometry: dict[str, int] | None
    length_unit: str | None
    metadata: list[str]
    annotations: dict[str, int] = field(default_factory=dict)
    unit_warnings: list[str] = field(default_factory=list)
    faults: list[FaultInfo] = field(default_factory=list)
    axes: list[AxisCheck] = field(default_factory=list)
    clocks: list[str] = field(default_factory=list)
    signals_read: bool = True
    pipelines: list[str] = field(default_factory=list)
    source: dict[str, str] | None = None
    results: ResultsInfo | None = None


def summary(recording: Recording, size: int, *, labels: bool = True) -> RecordingInfo:
    """Say what a recording's summary tells, without its signal.

    Without ``labels``, which lie among the signals, those of truth are counted and not read.
    """
    start_ns = recording.start_ns
    return RecordingInfo(
        recording=recording.name,
        bytes=size,
        start_ns=start_ns,
        start=_date(start_ns),
        duration_s=(recording.end_ns - start_ns) / NS_PER_S,
        streams=[_stream(s, None, None, start_ns, None) for s in recording.streams],
        others=[
            {"topic": o.topic, "schema": o.schema, "encoding": o.encoding, "messages": o.messages}
            for o in recording.others
        ],
        gaps=[],
        damage=_damage(recording, start_ns),
        truth=_truth(recording, read=labels),
        geometry=_geometry(recording.geometry),
        length_unit=recording.geometry.length_unit if recording.geometry is not None else None,
        metadata=sorted(recording.metadata),
        clocks=clock_lines(recording),
        unit_warnings=list(recording.assumed),
        signals_read=False,
        pipelines=suggested_pipelines(recording),
        source=recording.metadata.get(SOURCE),
    )


def _truth(recording: Recording, *, read: bool) -> dict[str, int]:
    if read:
        return dict(Counter(label.kind for label in recording.labels))
    count = recording.topic_counts.get(TRUTH_TOPIC, 0)
    return {"label": count} if count else {}


def examine(recording: Recording, size: int, show: Callable[[float], None]) -> RecordingInfo:
    """Read a recording from end to end and say what it holds."""
    # what computes is not imported before there is something to compute
    from ..detectors.fault_scan import FaultScan, MonitoredRecording
    from ..inertial.worn_sensor_faults import ImuWatch

    start_ns = recording.start_ns
    samples: Counter[str] = Counter()
    spans: dict[str, tuple[int, int]] = {}
    gaps: list[Gap] = []
    watches = _watches(recording)
    units = {s.topic: UnitWatch(s) for s in recording.streams}
    health = {s.topic: FaultScan(s) for s in recording.streams}
    worn = ImuWatch(Source(recording).streams, limits=False)
    for item in Source(MonitoredRecording(recording, health)):
        health[item.topic].update(item)
        worn.update(item)
        if isinstance(item, Gap):
            gaps.append(item)
            if item.topic in watches and not item.bridged:
                watches[item.topic].gap()
            continue
        if item.topic in watches:
            watches[item.topic].update(item)
        units[item.topic].update(item)
        samples[item.topic] += len(item)
        first, last = spans.get(item.topic, (item.start_ns, item.last_ns))
        spans[item.topic] = (min(first, item.start_ns), max(last, item.last_ns))
        show((item.last_ns - start_ns) / NS_PER_S)
    worn.flush()
    remarks = [line for watch in units.values() for line in watch.remarks()]
    streams = [
        _stream(s, samples[s.topic], spans.get(s.topic), start_ns, watches.get(s.topic))
        for s in recording.streams
    ]
    return replace(
        summary(recording, size),
        streams=streams,
        gaps=[_gap(gap, start_ns, recording.labels) for gap in gaps],
        unit_warnings=[*recording.assumed, *remarks],
        faults=_faults(recording, [*worn.findings(remarks)], health, streams),
        axes=list(worn.checks()),
        signals_read=True,
    )


def _faults(
    recording: Recording,
    worn: list[Finding],
    health: dict[str, FaultScan],
    streams: list[StreamInfo],
) -> list[FaultInfo]:
    zero = {(f.topic, f.channel) for f in worn if f.kind == "zero"}
    faults = [fault_of(f, recording.start_ns) for f in worn]
    for topic, watch in health.items():
        quantities = {c.name: c.quantity for c in watch.stream.channels}
        faults += (
            fault_of(f, recording.start_ns)
            for f in watch.findings()
            # what is zero in all axes was said once
            if f.kind != "constant" or (topic, quantities[f.channel]) not in zero
        )
    length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    for stream, info in zip(recording.streams, streams, strict=True):
        if info.samples and info.start_s is not None and info.end_s is not None:
            sampled_s = info.samples / stream.rate_hz
            faults += absences(stream, (info.start_s, info.end_s), sampled_s, length_s)
    return faults


def _date(time_ns: int) -> str | None:
    """Return a time as ISO 8601, or None where the clock is not that of the calendar."""
    if time_ns < FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(time_ns / NS_PER_S, UTC).isoformat(timespec="milliseconds")


def _watches(recording: Recording) -> dict[str, PlacementWatch]:
    # what filters is not imported before there is something to filter
    from ..inertial.placement import PlacementWatch

    fitting = (s for s in recording.streams if PlacementWatch.fits(s))
    return {s.topic: PlacementWatch(s) for s in fitting}


def _guess(watch: PlacementWatch | None) -> GuessInfo | None:
    guess = None if watch is None else watch.guess()
    if watch is None or guess is None:
        return None
    sure = guess.contradicts(watch.stated)
    return GuessInfo(guess.site, guess.confidence, sure, guess.measures, guess.text)


def _stream(
    stream: Stream,
    samples: int | None,
    span: tuple[int, int] | None,
    start_ns: int,
    watch: PlacementWatch | None,
) -> StreamInfo:
    channels = [
        {"name": c.name, "quantity": c.quantity, "unit": c.unit, "axis": c.axis}
        for c in stream.channels
    ]
    first, last = (None, None) if span is None else ((t - start_ns) / NS_PER_S for t in span)
    return StreamInfo(
        stream.topic,
        stream.rate_hz,
        stream.irregular,
        stream.placement,
        channels,
        samples,
        first,
        last,
        _guess(watch),
    )


def _gap(gap: Gap, start_ns: int, labels: Sequence[Label]) -> GapInfo:
    early_ns, late_ns = gap.start_ns - STEP_NS, gap.end_ns
    steps = sum(label.kind == "step" and early_ns < label.time_ns < late_ns for label in labels)
    return GapInfo(
        gap.topic,
        (gap.start_ns - start_ns) / NS_PER_S,
        (gap.end_ns - start_ns) / NS_PER_S,
        gap.reason,
        gap.lost,
        gap.bridged,
        0 if gap.bridged else steps,
    )


def _damage(recording: Recording, start_ns: int) -> list[DamageInfo]:
    def seconds(time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - start_ns) / NS_PER_S

    return [
        DamageInfo(d.offset, d.length, d.messages, seconds(d.start_ns), seconds(d.end_ns), d.reason)
        for d in recording.damage
    ]


def _geometry(geometry: Geometry | None) -> dict[str, int] | None:
    if geometry is None:
        return None
    return {
        "sensors": len(geometry.sensors),
        "outline": len(geometry.outline),
        "sources": len(geometry.sources),
    }


def clock_lines(recording: Recording) -> list[str]:
    """Return what a recording keeps of the clocks that its samples were recorded with."""
    try:
        merged = merged_clocks(recording)
    except SchemaError as error:
        return [str(error)]
    lines = [clock.line(merged[0].file) for clock in merged if clock.how != "reference"]
    for name, values in recording.metadata.items():
        if name.partition("/")[0] == CLOCKS:
            lines += [f"{topic}: {text}" for topic, text in values.items()]
    return lines


def fault_of(finding: Finding, start_ns: int) -> FaultInfo:
    """Return a finding as the command says it."""
    return FaultInfo(
        finding.topic,
        finding.channel,
        finding.kind,
        (finding.start_ns - start_ns) / NS_PER_S,
        (finding.end_ns - start_ns) / NS_PER_S,
        finding.events,
        finding.share,
        finding.what,
        finding.effect,
        finding.remedy,
    )


def absences(
    stream: Stream, span_s: tuple[float, float], heard_s: float, length_s: float
) -> Iterator[FaultInfo]:
    """Yield that a stream begins late or ends early; one of single shots does neither.

    Parameters
    ----------
    stream
        Which.
    span_s
        Times of its first and last sample [s].
    heard_s
        How long its samples last [s].
    length_s
        Time of the last sample of all [s].
    """
    least_s = max(LATE_S, LATE_SAMPLES / stream.rate_hz)
    first_s, last_s = span_s
    if heard_s < SHOTS * (last_s - first_s):
        return
    for kind, start_s, end_s, what, effect in (
        ("late", 0.0, first_s, "begins late", "until then"),
        ("ends early", last_s, length_s, "ends early", "from there on"),
    ):
        missing_s = end_s - start_s
        if missing_s > least_s:
            yield FaultInfo(
                stream.topic,
                "",
                kind,
                start_s,
                end_s,
                1,
                missing_s / length_s,
                f"{what}: nothing for {missing_s:.3f} s",
                f"{effect} the stages go on with the other streams",
                "look at when it was switched on and off",
            )
