"""``groundtrace info``."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from groundtrace_codecs.events import EVENTS
from groundtrace_codecs.location import is_url
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import named_recording
from ..api.inspection import ResultsInfo, StageInfo, examine, summary
from ..api.known_truth import annotations_to_show
from ..errors import RecordingError
from ..explain.suitability import SIGNALS
from ..pipeline.results import RUN
from .console import (
    lost_messages,
    print_json,
    print_line,
    print_stderr,
    print_table,
    progress,
    quoted,
)
from .options import FLAG, RECORDING, Json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..api.inspection import FaultInfo, GapInfo, RecordingInfo, StreamInfo


def info(
    recording: Annotated[Path, RECORDING],
    *,
    quick: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """Show what a recording contains: topics, rates, gaps, units, faults, geometry, truth, damage.

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
        is_result = _is_result(opened)
        duration_s = (opened.end_ns - opened.start_ns) / NS_PER_S
        if is_url(recording):  # all of a remote recording is not fetched for this
            contents = summary(opened, size, labels=False)
        elif quick:
            contents = summary(opened, size)
        else:
            with progress(duration_s, "reading") as show:
                contents = examine(opened, size, show)
        marked = Counter(a.label.kind for a in annotations_to_show(opened, recording, print_stderr))
        contents = replace(contents, annotations=dict(marked))
    if is_result:
        contents = replace(contents, results=results_info(recording, scored=not quick))
    if json:
        print_json(contents)
    elif contents.results is not None:
        _print_results(contents, contents.results, recording)
    else:
        _print(contents, recording)


def _is_result(opened: Recording) -> bool:
    return RUN in opened.metadata and not opened.streams


def results_info(path: Path, *, scored: bool) -> ResultsInfo:
    """Return what results hold; with their score, where they have truth and it is asked for."""
    # what scores is not imported before there are results to score
    from ..api.results import load_results
    from ..api.scores import numbers_of

    results = load_results(path)
    origin, config = results.decided.provenance, results.pipeline.config
    kinds = Counter(type(event) for event in results.decided.events)
    events = {EVENTS[kind].plural: n for kind, n in kinds.items() if kind in EVENTS}
    score: dict[str, float] = {}
    if scored and results.decided.labels:
        with suppress(RecordingError):  # there is truth, but none that the stages answer
            parts = results.score().details.parts
            score = {f"{part}.{name}": value for part, name, value in numbers_of(parts)}
    return ResultsInfo(
        origin.recording,
        origin.sha256,
        config.name,
        (origin.end_ns - origin.start_ns) / NS_PER_S,
        [StageInfo(stage.key, stage.use, dict(stage.parameters)) for stage in config.stage],
        events,
        score,
    )


#: Figures of a score that are printed of results, in words.
HEADLINES = {
    "steps.f1": "steps F1 {:.3f}",
    "positions.rmse_m": "positions RMSE {:.2f} m",
    "picks.all.median_abs_ms": "picks {:.2f} ms off in the median",
    "track.ospa_m": "track OSPA {:.2f} m",
    "heading.rmse_deg": "heading RMSE {:.2f} deg",
    "passes.matched": "{:.0f} passes found",
}


def _print_results(contents: RecordingInfo, results: ResultsInfo, path: Path) -> None:
    """Print what results are of, by which pipeline, what they hold, and what to do with them."""
    print_line(
        f"{contents.recording}: results of {results.recording} by {results.pipeline}, "
        f"{results.duration_s:.3f} s, {contents.bytes / 1e6:.2f} MB"
    )
    for stage in results.stages:
        values = ", ".join(f"{name} {value}" for name, value in stage.parameters.items())
        print_line(f"stage {stage.name}: {stage.use}: {values}")
    events = ", ".join(f"{n} {name}" for name, n in results.events.items())
    print_line(f"found: {events or 'nothing'}")
    if contents.truth:
        print_line("truth: " + ", ".join(f"{n} {kind}" for kind, n in contents.truth.items()))
    figures = [text.format(results.score[k]) for k, text in HEADLINES.items() if k in results.score]
    if figures:
        print_line(f"score: {', '.join(figures)}")
    after = f"score {quoted(path)}" if contents.truth else f"export {quoted(path)} -o tables"
    print_line(f"next: groundtrace {after}")


def _print(contents: RecordingInfo, recording: Path) -> None:
    when = f", began {contents.start}" if contents.start else ""
    print_line(
        f"{contents.recording}: {contents.duration_s:.3f} s, {contents.bytes / 1e6:.2f} MB{when}"
    )
    if contents.source is not None:
        print_line("source: " + "; ".join(contents.source.values()))
    rows = [stream_row(s) for s in contents.streams]
    print_table(("topic", "samples", "rate [Hz]", "placement", "channels"), rows)
    print_guesses(contents.streams)
    for line in contents.clocks:
        print_line(f"time: {line}")
    for warning in contents.unit_warnings:
        print_line(f"unit: {warning}")
    for check in contents.axes:
        print_line(f"axes: {check.topic} against {check.against}: {check.text}")
    print_faults(contents.faults)
    for other in contents.others:
        print_line(
            f"left alone: {other['topic']} ({other['schema']}, {other['messages']} messages)"
        )
    print_gaps(contents.gaps)
    if not contents.signals_read:
        print_line(
            "signals: not read, so nothing about gaps, units, faults (without --quick they are)"
        )
    for damage in contents.damage:
        lost = lost_messages(damage.messages)
        print_line(f"damage: {lost}at byte {damage.offset}: {damage.reason}")
    if contents.truth:
        print_line("truth: " + ", ".join(f"{n} {kind}" for kind, n in contents.truth.items()))
    if contents.annotations:
        marks = ", ".join(f"{n} {kind}" for kind, n in contents.annotations.items())
        print_line(f"annotations: {marks} (groundtrace annotate lists them)")
    if contents.geometry is not None:
        unit = "" if contents.length_unit in (None, "m") else ", unit of length unknown"
        print_line(
            "geometry: " + ", ".join(f"{n} {kind}" for kind, n in contents.geometry.items()) + unit
        )
    fitting = contents.pipelines or [SIGNALS]
    print_line(f"fitting pipelines: {', '.join(fitting)}")
    print_line(f"next: groundtrace replay {quoted(recording)} --pipeline {fitting[0]}")


#: So many channels with one kind of fault are told one by one.
MOST_LINES = 4


def print_faults(faults: Sequence[FaultInfo]) -> None:
    """Print one line for each fault, of many channels alike the first few."""
    kinds = dict.fromkeys((fault.topic, fault.kind) for fault in faults)
    for kind in kinds:
        same_kind = [fault for fault in faults if (fault.topic, fault.kind) == kind]
        shown = same_kind if len(same_kind) <= MOST_LINES else same_kind[: MOST_LINES - 1]
        for fault in shown:
            where = " ".join(filter(None, (fault.topic, fault.channel)))
            print_line(
                f"fault: {where}: {fault.what}, first at {fault.start_s:.3f} s: "
                f"{fault.effect}; {fault.remedy}"
            )
        rest = same_kind[len(shown) :]
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
