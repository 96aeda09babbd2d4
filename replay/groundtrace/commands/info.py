"""``groundtrace info``."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from groundtrace_codecs.mcap.remote import is_url
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.inspection import examine, summary
from .info_faults import print_faults
from .info_lines import print_gaps, print_guesses, stream_row
from .output import existing, print_json, print_table, progress
from .truth import annotations_to_show

if TYPE_CHECKING:
    from ..api.inspection import RecordingInfo


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
