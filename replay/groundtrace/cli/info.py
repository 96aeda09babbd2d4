"""``groundtrace info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from groundtrace_codecs.location import is_url
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import named_recording
from ..api.inspection import examine, summary
from ..explain.suitability import SIGNALS
from ..pipeline.config import parse_pipeline
from ..pipeline.results import RUN, provenance_in
from .console import (
    annotations_to_show,
    lost_messages,
    print_json,
    print_line,
    print_table,
    progress,
    quoted,
)
from .options import FLAG, Json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..api.inspection import FaultInfo, GapInfo, RecordingInfo, StreamInfo
    from ..pipeline.results import Provenance


def info(
    recording: Path,
    *,
    quick: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """Say what a recording holds: topics, rates, gaps, units, faults, geometry, truth, damage.

    Parameters
    ----------
    recording
        MCAP file, or its URL.
    quick
        Read the summary and no signal: nothing is said of gaps, units, faults and placements. So
        it is for a URL.
    """
    recording = named_recording(recording)
    with Recording.open(recording) as opened:
        size = opened.file.size
        origin = provenance_in(opened, recording.name) if _is_result(opened) else None
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
    if origin is not None:
        _print_results(found, origin, recording)
        return
    _print(found, recording)


def _is_result(opened: Recording) -> bool:
    return RUN in opened.metadata and not opened.streams


def _print_results(found: RecordingInfo, origin: Provenance, path: Path) -> None:
    """Print what results are of, by which pipeline, and what to do with them."""
    config = parse_pipeline(origin.pipeline.encode(), f"{path.name}: pipeline")
    print_line(
        f"{found.recording}: results of {origin.recording} by {config.name}, "
        f"{(origin.end_ns - origin.start_ns) / NS_PER_S:.3f} s, {found.bytes / 1e6:.2f} MB"
    )
    for stage in config.stage:
        values = ", ".join(f"{name} {value}" for name, value in stage.parameters.items())
        print_line(f"stage {stage.key}: {stage.use}: {values}")
    if found.truth:
        print_line("truth: " + ", ".join(f"{n} {kind}" for kind, n in found.truth.items()))
        print_line(f"next: groundtrace score {quoted(path)}")
    else:
        print_line(f"next: groundtrace export {quoted(path)} -o tables")


def _print(found: RecordingInfo, recording: Path) -> None:
    when = f", began {found.start}" if found.start else ""
    print_line(f"{found.recording}: {found.duration_s:.3f} s, {found.bytes / 1e6:.2f} MB{when}")
    if found.source is not None:
        print_line("source: " + "; ".join(found.source.values()))
    rows = [stream_row(s) for s in found.streams]
    print_table(("topic", "samples", "rate [Hz]", "placement", "channels"), rows)
    print_guesses(found.streams)
    for line in found.clocks:
        print_line(f"time: {line}")
    for warning in found.unit_warnings:
        print_line(f"unit: {warning}")
    for check in found.axes:
        print_line(f"axes: {check.topic} against {check.against}: {check.text}")
    print_faults(found.faults)
    for other in found.others:
        print_line(
            f"left alone: {other['topic']} ({other['schema']}, {other['messages']} messages)"
        )
    print_gaps(found.gaps)
    if not found.signals_read:
        print_line(
            "signals: not read, so nothing about gaps, units, faults (without --quick they are)"
        )
    for damage in found.damage:
        lost = lost_messages(damage.messages)
        print_line(f"damage: {lost}at byte {damage.offset}: {damage.reason}")
    if found.truth:
        print_line("truth: " + ", ".join(f"{n} {kind}" for kind, n in found.truth.items()))
    if found.annotations:
        marks = ", ".join(f"{n} {kind}" for kind, n in found.annotations.items())
        print_line(f"annotations: {marks} (groundtrace annotate lists them)")
    if found.geometry is not None:
        unit = "" if found.length_unit in (None, "m") else ", unit of length unknown"
        print_line(
            "geometry: " + ", ".join(f"{n} {kind}" for kind, n in found.geometry.items()) + unit
        )
    fitting = found.pipelines or [SIGNALS]
    print_line(f"fitting pipelines: {', '.join(fitting)}")
    print_line(f"next: groundtrace replay {quoted(recording)} --pipeline {fitting[0]}")


#: So many channels with one kind of fault are told one by one.
MOST_LINES = 4


def print_faults(faults: Sequence[FaultInfo]) -> None:
    """Print one line for each fault, of many channels alike the first few."""
    kinds = dict.fromkeys((fault.topic, fault.kind) for fault in faults)
    for kind in kinds:
        alike = [fault for fault in faults if (fault.topic, fault.kind) == kind]
        shown = alike if len(alike) <= MOST_LINES else alike[: MOST_LINES - 1]
        for fault in shown:
            where = " ".join(filter(None, (fault.topic, fault.channel)))
            print_line(
                f"fault: {where}: {fault.what}, first at {fault.start_s:.3f} s: "
                f"{fault.effect}; {fault.remedy}"
            )
        rest = alike[len(shown) :]
        if rest:
            names = ", ".join(fault.channel for fault in rest)
            print_line(f"fault: {kind[0]}: {kind[1]} on {len(rest)} more channels: {names}")


def print_guesses(streams: Sequence[StreamInfo]) -> None:
    """Print where each sensor may be worn."""
    for stream in streams:
        guess = stream.placement_guess
        if guess is not None:
            but = f"; stated: {stream.placement}, which is taken" if guess.contradicts else ""
            print_line(f"placement of {stream.topic}, a guess: {guess.text}{but}")


def stream_row(s: StreamInfo) -> tuple[str, ...]:
    """Return the cells of one stream."""
    kinds: dict[str, list[str]] = {}
    for channel in s.channels:
        kinds.setdefault(f"{channel['quantity']} [{channel['unit']}]", []).append(channel["name"])
    text = "; ".join(f"{_names(names)}: {kind}" for kind, names in kinds.items())
    rate = f"{s.rate_hz:g}" + (" irregular" if s.irregular else "")
    return (s.topic, "-" if s.samples is None else str(s.samples), rate, s.placement, text)


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)})"


def _cut(steps: int) -> str:
    return f", cuts or swallows {steps} true step{'s' * (steps > 1)}" if steps else ""


def print_gaps(gaps: Sequence[GapInfo]) -> None:
    """Print unbridged gaps one by one, the bridged ones as counts."""
    for gap in [g for g in gaps if not g.bridged][:20]:
        print_line(
            f"gap: {gap.topic} {gap.start_s:.3f} to {gap.end_s:.3f} s, {gap.reason}, "
            f"{gap.lost} samples{_cut(gap.steps)}"
        )
    more = sum(not g.bridged for g in gaps) - 20
    if more > 0:
        print_line(f"gap: and {more} more")
    bridged = Counter((g.topic, g.reason) for g in gaps if g.bridged)
    for (topic, reason), count in bridged.items():
        print_line(f"bridged: {topic} {count} times {reason}")
