"""``groundtrace replay``."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter, validators

from groundtrace_codecs.events import EVENTS, CandidateBlock, StageSpec, TraceBlock
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..api.files import existing, writable
from ..api.replay import (
    configured_for,
    provenance_of,
    run_through,
    session_of,
    shown_part,
    span_of,
    terminable,
)
from ..errors import RecordingError
from ..pipeline.config import build_pipeline, checked_pipeline
from ..pipeline.engine import Clock
from ..pipeline.plugins import load
from ..pipeline.results import (
    ResultsSink,
    evidence_of,
    public_arguments,
    read_results,
    replayed_labels,
)
from ..pipeline.source import Source
from .console import print_json, print_stderr, print_warnings, progress, truth_of, where_to_show

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event, Note
    from groundtrace_codecs.signals import Stream

    from ..pipeline.config import Pipeline
    from ..pipeline.engine import ReplayCounts, ReplaySession, Sink

NOT_NEGATIVE = Parameter(validator=validators.Number(gte=0, lt=math.inf))


def replay(
    recording: Path | None = None,
    *,
    pipeline: str = "",
    geometry: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    from_: Annotated[float | None, Parameter(name="--from"), NOT_NEGATIVE] = None,
    to: Annotated[float | None, NOT_NEGATIVE] = None,
    at_miss: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    rrd: Path | None = None,
    out: Path | None = None,
    spawn: Annotated[bool, Parameter(negative="")] = False,
    web: Annotated[bool, Parameter(negative="")] = False,
    no_viewer: Annotated[bool, Parameter(negative="")] = False,
    full_rate: str = "",
    map_tiles: Annotated[bool, Parameter(negative="")] = False,
    rate: Annotated[float, NOT_NEGATIVE] = 0.0,
    strict: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    quiet: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Stream a recording through a pipeline; show and store what was decided.

    Parameters
    ----------
    recording
        MCAP file, or its URL (https://, s3://, ...), read in ranges.
    pipeline
        Name of a shipped pipeline (see groundtrace pipelines) or a TOML file.
    geometry
        Geometry TOML instead of the recording's own.
    set_
        A parameter of a stage, as stage.param=value; may be given several times.
    from_
        Begin this many seconds after the first sample.
    to
        End this many seconds after the first sample.
    at_miss
        Replay everything, then show 5 s before and after the missed step of this number, N; the
        outputs are NAME-missN.rrd and NAME-missN.results.mcap.
    rrd
        Write the viewer's file here; without it beside the results and named as they are.
    out
        Write the results here.
    spawn
        Open the native viewer and show the replay while it runs.
    web
        Serve the finished replay to a browser on this machine.
    no_viewer
        Make no viewer's file but the one of --rrd, and open none.
    full_rate
        Where fast signals are shown at every sample: none, misses, events, all, or FROM-TO in
        seconds. Without it misses, without truth events, up to a size that is said before;
        everything where it fits into 32 MB or with --spawn.
    map_tiles
        Show positions on a street map too, whose tiles the viewer loads from the internet.
    rate
        Recorded seconds per second; 0 is as fast as possible.
    strict
        Stop at the first damage of the recording instead of leaving it out.
    force
        Overwrite existing outputs.
    quiet
        Show no progress bar.
    json
        Print one JSON document.
    """
    settings = set_ or []
    asked = checked_pipeline(pipeline, settings) if pipeline else None
    path = existing(recording) if recording is not None else _bundled()
    partly = from_ is not None or to is not None or rate or no_viewer
    if at_miss is not None and partly:
        raise RecordingError("--at-miss: expected no --from, --to, --rate or --no-viewer with it")
    shown: Any = None
    site = None if geometry is None else Geometry.from_toml(existing(geometry, "a geometry TOML"))
    with Recording.open(path, strict=strict) as opened:
        opened.geometry = site or opened.geometry
        ready = configured_for(opened, asked, settings)
        chain = ready.chain
        results = out or Path(f"{_stem(path, at_miss)}.results.mcap")
        writable(results, force=force, sources=[path])
        spawn, rrd = _where_to_show(
            (path, results),
            rrd,
            spawn=spawn,
            web=web,
            no_viewer=no_viewer,
            force=force,
        )
        if rrd is not None and rrd.resolve() == results.resolve():
            raise RecordingError(f"{rrd}: expected another file than the results, found the same")
        session = session_of(opened, path, chain, print_stderr)
        span = span_of(session, from_, to)
        arguments = public_arguments(sys.argv[1:])
        provenance = provenance_of(session, path, chain, span, arguments)
        session = shown_part(session, span)
        sinks: list[Sink] = [ResultsSink(results, provenance, force=force)]
        if at_miss is None and (rrd is not None or spawn or web):
            shown = load("sinks", "rerun")(
                rrd, spawn=spawn, web=web, full_rate=full_rate, map_tiles=map_tiles
            )
            print_stderr(shown.expected(session))
            sinks.append(shown)
        source = Source(opened, start_ns=span[0], stop_ns=span[1], block_s=0.0 if rate else None)
        tally = run_into(
            source,
            chain,
            sinks,
            session,
            Clock(rate) if rate else None,
            quiet=quiet,
            looked_at=ready.looked_at,
            first=ready.notes,
        )
        if at_miss is not None:
            at_ns = missed_step(results, at_miss)
            shown = load("sinks", "rerun-moment")(rrd, at_ns=at_ns, spawn=spawn, web=web)
            again = build_pipeline(chain.config, opened.geometry, opened.labels)
            run_into(Source(opened), again, [TimeWindowSink(shown, at_ns)], session, quiet=quiet)
        damage = len(set(opened.damage))
    timeline = shown.summary if shown is not None else ""
    report(session, chain, tally, results, rrd, timeline, damage, json=json)
    if web:
        _stay_with_the_page(shown)


def _bundled() -> Path:
    from groundtrace_recordings import path_of

    print_stderr("no recording given: replaying the bundled walk through a room")
    return path_of("room-walk.mcap")


def _stem(path: Path, at_miss: int | None) -> str:
    """Return what outputs are named after; what shows a miss stands beside the whole replay."""
    return path.stem if at_miss is None else f"{path.stem}-miss{at_miss}"


def _where_to_show(
    files: tuple[Path, Path],
    rrd: Path | None,
    *,
    spawn: bool,
    web: bool,
    no_viewer: bool,
    force: bool,
) -> tuple[bool, Path | None]:
    """Return whether to open the viewer, and which file to write; ``files``: recording, results."""
    path, results = files
    if no_viewer:
        return where_to_show(rrd, path, spawn=False, force=force, sources=[path])
    stem = results.stem.removesuffix(".results")
    name = results.with_name(f"{stem}.rrd")
    shown, rrd = where_to_show(rrd, name, spawn=spawn, force=force, sources=[path])
    if rrd is not None or spawn or web:
        return shown, rrd
    return shown, writable(name, force=force, sources=[path])


def _stay_with_the_page(shown: Any) -> None:
    """Serve what was shown to browsers until the user stops."""
    url, server = load("views", "web")(shown)
    print_stderr(f"serving {url} (Ctrl-C ends it)")
    try:
        server.wait()
    finally:
        server.terminate()
        server.wait()


def run_into(
    source: Source,
    chain: Pipeline,
    sinks: Sequence[Sink],
    session: ReplaySession,
    clock: Clock | None = None,
    *,
    quiet: bool,
    looked_at: Iterable[str] = (),
    first: Sequence[Note] = (),
) -> ReplayCounts:
    """Replay as :func:`~.api.replay.run_through`; with ``quiet`` nothing is shown."""
    first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
    length_s = (last_ns - first_ns) / NS_PER_S
    with terminable(), progress(length_s, "replaying", quiet=quiet) as show:
        return run_through(
            source,
            chain,
            sinks,
            session,
            clock=clock,
            progress=lambda part: show(part * length_s),
            looked_at=looked_at,
            first=first,
        )


#: What is counted of a replay beside candidates, by what several of a kind are called.
COUNTED = ("picks", "steps", "fixes", "passes", "crossings", "gaps", "notes")


def counts_of(tally: ReplayCounts) -> dict[str, int]:
    """Return how many there are of what is counted."""
    named = {kind.plural: cls.__name__ for cls, kind in EVENTS.items()}
    counted = {"candidates": "CandidateBlock"} | {name: named[name] for name in COUNTED}
    return {name: tally.counts.get(cls, 0) for name, cls in counted.items()}


def report(
    session: ReplaySession,
    chain: Pipeline,
    tally: ReplayCounts,
    results: Path,
    rrd: Path | None,
    timeline: str,
    damage: int,
    *,
    json: bool,
) -> None:
    """Print what a replay did.

    Parameters
    ----------
    session
        What was replayed.
    chain
        Through what.
    tally
        What came of it.
    results
        Where it is stored.
    rrd
        The viewer's file, or None.
    timeline
        What is shown at full rate.
    damage
        Number of places that were skipped.
    json
        As one JSON document.
    """
    counts = counts_of(tally)
    warnings = tally.warnings.told(session.start_ns)
    if json:
        print_json(
            {
                "recording": session.name,
                "pipeline": chain.config.name,
                "topics": [s.topic for s in session.streams],
                "recorded_s": tally.recorded_s,
                "samples": tally.samples,
                "events": counts,
                "damage": damage,
                "results": str(results),
                "rrd": str(rrd) if rrd is not None else None,
                "rrd_bytes": rrd.stat().st_size if rrd is not None else None,
            },
            warnings,
        )
        return
    quiet_notes = counts["notes"] - sum(warned.count for warned in warnings)
    _print_report(session.streams, chain, tally, counts | {"notes": quiet_notes})
    print_warnings(warnings)
    print(f"results: {results}")
    if rrd is not None:
        size = f"{rrd.stat().st_size / 1e6:.1f} MB, {timeline}"
        print(f"timeline: {rrd}, {size} (open it with: rerun {rrd})")
    if damage:
        print(f"damage: {damage} places were skipped; see groundtrace info {session.name}")


def _print_report(
    streams: tuple[Stream, ...], chain: Pipeline, tally: ReplayCounts, counts: dict[str, int]
) -> None:
    signals = ", ".join(f"{s.topic} ({len(s.channels)} x {s.rate_hz:g} Hz)" for s in streams)
    print(f"replayed {tally.recorded_s:.1f} s of {signals} through {chain.config.name}")
    print(", ".join(f"{count} {name}" for name, count in counts.items() if count) or "no events")


#: What is shown before and after the step [s].
AROUND_S = 5.0


def missed_step(results: Path, number: int) -> int:
    """Return the time of a missed step of a result [ns]; the first has the number 1.

    Raises
    ------
    RecordingError
        Where there is no truth, or there are not so many.
    """
    # explaining is not loaded by a replay that explains nothing
    from ..api.known_truth import kinds_of
    from ..explain.reasons import matched

    result = read_results(results)
    labels = truth_of(result, results, None)
    name = result.provenance.recording
    if not any(label.kind == "step" for label in labels):
        raise RecordingError(
            f"{name}: --at-miss: expected true steps in the recording, found {kinds_of(labels)}"
        )
    found = matched(evidence_of(result, labels), tolerance_s=0.12)
    if not 1 <= number <= len(found.missed):
        raise RecordingError(
            f"{name}: --at-miss: expected one of the {len(found.missed)} missed steps, "
            f"found {number}"
        )
    return int(found.truth_ns[found.missed[number - 1]])


class TimeWindowSink:
    """Passes on what lies around a moment; it is decided by a replay of the whole recording.

    Parameters
    ----------
    sink
        Where to.
    at_ns
        The moment [ns].
    """

    def __init__(self, sink: Sink, at_ns: int) -> None:
        self._sink = sink
        reach = round(AROUND_S * NS_PER_S)
        self._start_ns, self._end_ns = at_ns - reach, at_ns + reach

    def open(self, session: ReplaySession) -> None:
        """Begin, with the labels and annotations of the window."""
        shown_ns = (max(self._start_ns, session.start_ns), min(self._end_ns, session.end_ns))
        labels = replayed_labels(session.labels, *shown_ns)
        annotations = tuple(
            replace(annotation, label=label)
            for annotation in session.annotations
            for label in replayed_labels((annotation.label,), *shown_ns)
        )
        window = replace(session, labels=labels, annotations=annotations, shown_ns=shown_ns)
        self._sink.open(window)

    def write(self, item: SignalBlock | Event) -> None:
        """Pass on the part of an item that lies in the window."""
        part = self._part(item)
        if part is not None:
            self._sink.write(part)

    def abandon(self) -> None:
        """End the replay without an output."""
        abandon = getattr(self._sink, "abandon", self._sink.close)
        abandon()

    def close(self) -> None:
        """End the replay."""
        self._sink.close()

    def _part(self, item: SignalBlock | Event) -> SignalBlock | Event | None:
        if isinstance(item, StageSpec):
            return item
        if isinstance(item, SignalBlock):
            times = item.sample_times()
            first, last = np.searchsorted(times, (self._start_ns, self._end_ns))
            return item.slice(int(first), int(last)) if last > first else None
        if isinstance(item, CandidateBlock | TraceBlock):
            return _rows(item, (item.time_ns >= self._start_ns) & (item.time_ns < self._end_ns))
        return item if self._start_ns <= item.time_ns < self._end_ns else None


def _rows(block: Any, rows: NDArray[np.bool_]) -> CandidateBlock | TraceBlock | None:
    """Return some rows of a block of columns; None of none."""
    if not rows.any():
        return None
    names = [f for f in type(block).__dataclass_fields__ if f != "spec"]
    part: CandidateBlock | TraceBlock = replace(
        block, **{name: getattr(block, name)[rows] for name in names}
    )
    return part
