"""``groundtrace info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from groundtrace_codecs.events import Gap
from groundtrace_codecs.importers.plausible import UnitWatch
from groundtrace_codecs.label_codec import TRUTH_TOPIC
from groundtrace_codecs.mcap.remote import is_url
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import FIRST_DATE_NS, NS_PER_S

from ..source import Source
from .info_clocks import clock_lines
from .info_document import DamageInfo, GapInfo, GuessInfo, RecordingInfo, StreamInfo
from .info_faults import absences, fault_of, print_faults
from .info_lines import print_gaps, print_guesses, stream_row
from .output import existing, print_json, print_table, progress
from .truth import annotations_to_show

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import Stream

    from ..health import Finding, HealthWatch
    from ..placement_watch import PlacementWatch
    from .info_faults import FaultInfo


#: How long a step is heard [ns]: a gap that begins in this time after it cuts it.
STEP_NS = 150_000_000


def info(
    recording: Path,
    *,
    quick: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Say what a recording holds: topics, rates, gaps, units, faults, geometry, truth, damage.

    Parameters
    ----------
    recording
        MCAP file, or its URL.
    quick
        Read the summary and no signal: nothing is said of gaps, units, faults and placements. So
        it is for a URL.
    json
        Print one JSON document.
    """
    existing(recording)
    with Recording.open(recording) as opened:
        size = opened.file.size
        duration_s = (opened.end_ns - opened.start_ns) / NS_PER_S
        if is_url(recording):  # all of a remote recording is not fetched for this
            found = summary(opened, size, labels=False)
        elif quick:
            found = summary(opened, size)
        else:
            with progress(duration_s, "reading") as show:
                found = examine(opened, size, show)
        marked = Counter(a.label.kind for a in annotations_to_show(opened, recording))
        found = replace(found, annotations=dict(marked))
    if json:
        print_json(found)
        return
    _print(found)


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
    )


def _truth(recording: Recording, *, read: bool) -> dict[str, int]:
    if read:
        return dict(Counter(label.kind for label in recording.labels))
    count = recording.topic_counts.get(TRUTH_TOPIC, 0)
    return {"label": count} if count else {}


def examine(recording: Recording, size: int, show: Callable[[float], None]) -> RecordingInfo:
    """Read a recording from end to end and say what it holds."""
    # what computes is not imported before there is something to compute
    from ..health import HealthWatch, Listened
    from ..health.imu import ImuWatch

    start_ns = recording.start_ns
    samples: Counter[str] = Counter()
    spans: dict[str, tuple[int, int]] = {}
    gaps: list[Gap] = []
    watches = _watches(recording)
    units = {s.topic: UnitWatch(s) for s in recording.streams}
    health = {s.topic: HealthWatch(s) for s in recording.streams}
    worn = ImuWatch(Source(recording).streams, limits=False)
    for item in Source(Listened(recording, health)):
        health[item.topic].hear(item)
        worn.hear(item)
        if isinstance(item, Gap):
            gaps.append(item)
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
    worn.finish()
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
    health: dict[str, HealthWatch],
    streams: list[StreamInfo],
) -> list[FaultInfo]:
    zero = {(f.topic, f.channel) for f in worn if f.kind == "zero"}
    found = [fault_of(f, recording.start_ns) for f in worn]
    for topic, watch in health.items():
        quantities = {c.name: c.quantity for c in watch.stream.channels}
        found += (
            fault_of(f, recording.start_ns)
            for f in watch.findings()
            # what is zero in all axes was said once
            if f.kind != "constant" or (topic, quantities[f.channel]) not in zero
        )
    length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    for stream, told in zip(recording.streams, streams, strict=True):
        if told.samples and told.start_s is not None and told.end_s is not None:
            heard_s = told.samples / stream.rate_hz
            found += absences(stream, (told.start_s, told.end_s), heard_s, length_s)
    return found


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


def _print(found: RecordingInfo) -> None:
    when = f", began {found.start}" if found.start else ""
    print(f"{found.recording}: {found.duration_s:.3f} s, {found.bytes / 1e6:.2f} MB{when}")
    rows = [stream_row(s) for s in found.streams]
    print_table(("topic", "samples", "rate [Hz]", "placement", "channels"), rows)
    print_guesses(found.streams)
    for line in found.clocks:
        print(f"time: {line}")
    for warning in found.unit_warnings:
        print(f"unit: {warning}")
    for check in found.axes:
        print(f"axes: {check.topic} against {check.against}: {check.text}")
    print_faults(found.faults)
    for other in found.others:
        print(f"left alone: {other['topic']} ({other['schema']}, {other['messages']} messages)")
    print_gaps(found.gaps)
    if not found.signals_read:
        print("signals: not read, so nothing about gaps, units, faults (without --quick they are)")
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
