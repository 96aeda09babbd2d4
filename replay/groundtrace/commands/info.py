"""``groundtrace info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from groundtrace_codecs.events import Gap
from groundtrace_codecs.importers.plausible import UnitWatch
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..source import Source
from .info_lines import print_gaps, print_guesses, stream_row
from .output import FIRST_DATE_NS, existing, print_json, print_table, progress
from .truth import annotations_to_show

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..placement import Measures
    from ..placement_watch import PlacementWatch


@dataclass(frozen=True, slots=True)
class GuessInfo:
    """Where a sensor may be worn, and what that was decided by (:mod:`groundtrace.placement`)."""

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
    samples: int
    start_s: float | None
    end_s: float | None
    placement_guess: GuessInfo | None


@dataclass(frozen=True, slots=True)
class GapInfo:
    """One interruption."""

    topic: str
    start_s: float
    end_s: float
    reason: str
    lost: int
    bridged: bool


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
class RecordingInfo:
    """Everything ``info`` says."""

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


def info(recording: Path, *, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """Say what a recording holds: topics, rates, gaps, units, geometry, truth, damage.

    Parameters
    ----------
    recording
        MCAP file.
    json
        Print one JSON document.
    """
    existing(recording)
    with Recording.open(recording) as opened:
        duration_s = (opened.end_ns - opened.start_ns) / NS_PER_S
        with progress(duration_s, "reading") as show:
            found = examine(opened, recording.stat().st_size, show)
        marked = Counter(a.label.kind for a in annotations_to_show(opened, recording))
        found = replace(found, annotations=dict(marked))
    if json:
        print_json(found)
        return
    _print(found)


def examine(recording: Recording, size: int, show: Callable[[float], None]) -> RecordingInfo:
    """Read a recording from end to end and say what it holds."""
    start_ns = recording.start_ns
    samples: Counter[str] = Counter()
    spans: dict[str, tuple[int, int]] = {}
    gaps: list[GapInfo] = []
    watches = _watches(recording)
    units = {s.topic: UnitWatch(s) for s in recording.streams}
    for item in Source(recording):
        if isinstance(item, Gap):
            gaps.append(_gap(item, start_ns))
            if item.topic in watches and not item.bridged:
                watches[item.topic].gap()
            continue
        if item.topic in watches:
            watches[item.topic].hear(item)
        units[item.topic].hear(item)
        samples[item.topic] += len(item)
        first, last = spans.get(item.topic, (item.start_ns, item.last_ns))
        spans[item.topic] = (min(first, item.start_ns), max(last, item.last_ns))
        show((item.last_ns - start_ns) / NS_PER_S)
    return RecordingInfo(
        recording=recording.name,
        bytes=size,
        start_ns=start_ns,
        start=_date(start_ns),
        duration_s=(recording.end_ns - start_ns) / NS_PER_S,
        streams=[
            _stream(s, samples[s.topic], spans.get(s.topic), start_ns, watches.get(s.topic))
            for s in recording.streams
        ],
        others=[
            {"topic": o.topic, "schema": o.schema, "encoding": o.encoding, "messages": o.messages}
            for o in recording.others
        ],
        gaps=gaps,
        damage=_damage(recording, start_ns),
        truth=dict(Counter(label.kind for label in recording.labels)),
        geometry=_geometry(recording.geometry),
        length_unit=recording.geometry.length_unit if recording.geometry is not None else None,
        metadata=sorted(recording.metadata),
        unit_warnings=[line for watch in units.values() for line in watch.remarks()],
    )


def _date(time_ns: int) -> str | None:
    """Return a time as ISO 8601, or None where the clock is not that of the calendar."""
    if time_ns < FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(time_ns / NS_PER_S, UTC).isoformat(timespec="milliseconds")


def _watches(recording: Recording) -> dict[str, PlacementWatch]:
    # what filters is not imported before there is something to filter
    from ..placement_watch import PlacementWatch

    fitting = (s for s in recording.streams if PlacementWatch.fits(s))
    return {s.topic: PlacementWatch(s) for s in fitting}


def _guess(watch: PlacementWatch | None) -> GuessInfo | None:
    found = None if watch is None else watch.guess()
    if watch is None or found is None:
        return None
    sure = found.contradicts(watch.stated)
    return GuessInfo(found.site, found.confidence, sure, found.measures, found.text)


def _stream(
    stream: Stream,
    samples: int,
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


def _gap(gap: Gap, start_ns: int) -> GapInfo:
    return GapInfo(
        gap.topic,
        (gap.start_ns - start_ns) / NS_PER_S,
        (gap.end_ns - start_ns) / NS_PER_S,
        gap.reason,
        gap.lost,
        gap.bridged,
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


def _print(found: RecordingInfo) -> None:
    when = f", began {found.start}" if found.start else ""
    print(f"{found.recording}: {found.duration_s:.3f} s, {found.bytes / 1e6:.2f} MB{when}")
    rows = [stream_row(s) for s in found.streams]
    print_table(("topic", "samples", "rate [Hz]", "placement", "channels"), rows)
    print_guesses(found.streams)
    for warning in found.unit_warnings:
        print(f"unit: {warning}")
    for other in found.others:
        print(f"left alone: {other['topic']} ({other['schema']}, {other['messages']} messages)")
    print_gaps(found.gaps)
    for damage in found.damage:
        lost = "?" if damage.messages is None else damage.messages
        print(f"damage: {lost} messages lost at byte {damage.offset}: {damage.reason}")
    if found.truth:
        print("truth: " + ", ".join(f"{n} {kind}" for kind, n in found.truth.items()))
    if found.annotations:
        marks = ", ".join(f"{n} {kind}" for kind, n in found.annotations.items())
        print(f"annotations: {marks} (groundtrace annotate lists them)")
    if found.geometry is not None:
        unit = "" if found.length_unit in (None, "m") else ", unit of length unknown"
        print("geometry: " + ", ".join(f"{n} {kind}" for kind, n in found.geometry.items()) + unit)
