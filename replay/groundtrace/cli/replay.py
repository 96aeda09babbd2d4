"""``groundtrace replay``."""

from __future__ import annotations

import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from groundtrace_codecs.events import EVENTS
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.location import Location
from groundtrace_codecs.mcap.chunks import Damage
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import OriginFile, existing_file, named_recording, results_writable, writable
from ..api.replay import (
    STANDARD_INPUT,
    PlannedReplay,
    TimeWindowSink,
    check_order,
    configured_for,
    growing,
    missed_step,
)
from ..errors import RecordingError, Usage
from ..pipeline.config import checked_pipeline
from ..pipeline.plugins import load
from ..pipeline.results import ResultsSink, public_arguments
from .console import (
    counted,
    print_json,
    print_line,
    print_stderr,
    print_warnings,
    progress,
    where_to_show,
)
from .exit_codes import ExitCode
from .options import (
    AT_LEAST_ONE,
    FLAG,
    NOT_NEGATIVE,
    PIPELINE,
    RECORDING,
    ForceOthers,
    Json,
    Quiet,
    Settings,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from concurrent.futures import Future
    from subprocess import Popen

    from groundtrace_codecs.live import LiveRecording
    from groundtrace_codecs.signals import Stream

    from ..fleet.split import SplitReplay
    from ..pipeline.chain import Pipeline
    from ..pipeline.config import PipelineConfig
    from ..pipeline.engine import ReplayCounts, ReplaySession, Sink


def replay(
    recording: Annotated[Path | None, RECORDING] = None,
    *,
    pipeline: Annotated[str, PIPELINE] = "",
    geometry: Path | None = None,
    set_: Settings = None,
    from_: Annotated[float | None, Parameter(name="--from"), NOT_NEGATIVE] = None,
    to: Annotated[float | None, NOT_NEGATIVE] = None,
    at_miss: Annotated[int | None, AT_LEAST_ONE] = None,
    rrd: Path | None = None,
    out: Path | None = None,
    spawn: Annotated[bool, FLAG] = False,
    web: Annotated[bool, FLAG] = False,
    no_viewer: Annotated[bool, FLAG] = False,
    full_rate: str = "",
    map_tiles: Annotated[bool, FLAG] = False,
    rate: Annotated[float, NOT_NEGATIVE] = 0.0,
    strict: Annotated[bool, FLAG] = False,
    follow: Annotated[bool, FLAG] = False,
    engine: str = "",
    workers: Annotated[int | None, AT_LEAST_ONE] = None,
    force: ForceOthers = False,
    quiet: Quiet = False,
    json: Json = False,
) -> ExitCode:
    """Stream a recording through a pipeline; show and store what was decided.

    Parameters
    ----------
    recording
        MCAP file, or its URL (https://, s3://, ...), read in ranges; - is standard input.
    pipeline
        Name of a shipped pipeline (see groundtrace pipelines) or a TOML file.
    geometry
        Geometry TOML instead of the recording's own.
    set_
        A parameter of a stage, as stage.param=value; may be given several times.
    from_
        Begin this many seconds after the first sample, with the decisions of the whole recording:
        what stages need of before is replayed too.
    to
        End this many seconds after the first sample, with the decisions of the whole recording.
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
        Serve the finished replay to a browser on this machine; with --follow, while it runs.
    no_viewer
        Write no timeline unless --rrd is given, and open no viewer.
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
    follow
        Replay a file that is still being written, as it grows, until its own end; Ctrl-C ends it
        before and keeps what was decided.
    engine
        Cut a long recording into spans, replay them in several processes, and join them to what one
        replay decides: local, dask, dask:ADDRESS, ray, ray:ADDRESS. Without --rrd no timeline is
        written.
    workers
        With --engine: processes; one for each processor without it. A cluster has its own.
    """
    settings, usage = set_ or [], Usage()
    asked: PipelineConfig | None = None
    with usage.collected():
        asked = checked_pipeline(pipeline, settings) if pipeline else None
    with usage.collected():
        check_order(from_, to)
    follow = follow or recording == STANDARD_INPUT
    partly = from_ is not None or to is not None or rate
    usage.refuse(
        "--at-miss: expected no --from, --to, --rate or --no-viewer with it",
        at_miss is not None and (partly or no_viewer),
    )
    usage.refuse(
        "--follow: expected a recording, and no --from, --to, --rate, --strict or --at-miss",
        follow and (recording is None or partly or strict or at_miss is not None),
    )
    usage.refuse(
        "--engine: expected no --from, --to, --rate, --strict, --follow or --at-miss with it",
        bool(engine) and (partly or strict or follow or at_miss is not None),
    )
    usage.refuse("--workers: expected it with --engine, found it alone", workers and not engine)
    usage.check()
    many = workers or os.cpu_count() or 1
    computed = None
    if engine:
        # what fleets load is not imported by a replay of one's own
        from ..fleet.engines import engine_of

        computed = engine_of(engine, many)
    path = _bundled() if recording is None else recording if follow else named_recording(recording)
    shown: Any = None
    page: Any = None
    site = (
        None if geometry is None else Geometry.from_toml(existing_file(geometry, "a geometry TOML"))
    )
    with ExitStack() as stack:
        live = stack.enter_context(_followed(path)) if follow else None
        opened = live.head if live else stack.enter_context(Recording.open(path, strict=strict))
        path = _PIPED if path == STANDARD_INPUT else path
        opened.geometry = site or opened.geometry
        ready = configured_for(opened, asked, settings)
        results = out or Path(f"{_stem(path, at_miss)}.results.mcap")
        origin = OriginFile(path)
        results_writable(results, origin, force=force)
        viewer = {"spawn": spawn, "web": web, "no_viewer": no_viewer}
        if computed is not None and rrd is None and not (spawn or web or no_viewer):
            viewer["no_viewer"] = True
            print_stderr("no timeline is written with --engine: --rrd FILE writes one")
        spawn, rrd = _where_to_show(origin, results, rrd, force=force, **viewer)
        plan = PlannedReplay.of(opened, path, ready, from_, to, print_stderr, live)
        if computed is not None and not opened.file.remote:
            plan = replace(plan, hashed=stack.enter_context(_hashing(opened)))
        provenance = plan.provenance(public_arguments(sys.argv[1:]))
        sinks: list[Sink] = [ResultsSink(results, provenance, force=True)]
        if at_miss is None and (rrd is not None or spawn or web):
            shown = load("sinks", "rerun")(
                rrd, spawn=spawn, web=web, full_rate=full_rate, map_tiles=map_tiles
            )
            print_stderr(shown.expected(plan.session))
            page = load("views", "web-live")(shown, print_stderr) if web and follow else None
            sinks.append(page or shown)
        left_out = set[Damage]()
        if computed is None:
            tally = _run(plan, sinks, rate, quiet=quiet)
        else:
            from ..fleet.split import SplitReplay

            split = SplitReplay(plan, Location(path), computed, many, print_stderr, damage=left_out)
            tally = _run_split(split, sinks, signal=shown is not None, quiet=quiet)
        if at_miss is not None:
            at_ns = missed_step(results, at_miss, print_stderr)
            shown = load("sinks", "rerun-moment")(rrd, at_ns=at_ns, spawn=spawn, web=web)
            _run(plan.again(), [TimeWindowSink(shown, at_ns)], quiet=quiet)
        damage = len({*(live or opened).damage, *left_out})
    timeline = shown.summary if shown is not None else ""
    report(plan.session, ready.chain, tally, results, rrd, timeline, damage, json=json)
    if page is not None:
        _stay_with(page.server)
    elif web:
        url, server = load("views", "web")(shown, path)
        print_stderr(f"serving {url} (Ctrl-C ends it)")
        _stay_with(server)
    return ExitCode.of(losses=damage > 0)


#: What outputs are named after that are made of standard input.
_PIPED = Path("stdin.mcap")


@contextmanager
def _followed(path: Path) -> Iterator[LiveRecording]:
    """Open a recording that grows; the first Ctrl-C ends the recording, the second the replay."""
    stop = Event()

    def end(number: int, _frame: object) -> None:
        signal.signal(number, before[signal.Signals(number)])
        stop.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        name = "standard input" if path == STANDARD_INPUT else path
        print_stderr(f"following {name} (Ctrl-C ends it and keeps what was decided)")
        with growing(path, stop, print_stderr) as live:
            yield live
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _hashing(recording: Recording) -> Iterator[Future[str]]:
    """Compute the hash of a recording beside a replay."""
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(recording.file.sha256)


def _bundled() -> Path:
    from groundtrace_recordings import path_of

    print_stderr("no recording given: replaying the bundled walk through a room")
    return path_of("room-walk.mcap")


def _stem(path: Path, at_miss: int | None) -> str:
    """Return what outputs are named after; what shows a miss stands beside the whole replay."""
    return path.stem if at_miss is None else f"{path.stem}-miss{at_miss}"


def _where_to_show(
    origin: OriginFile,
    results: Path,
    rrd: Path | None,
    *,
    spawn: bool,
    web: bool,
    no_viewer: bool,
    force: bool,
) -> tuple[bool, Path | None]:
    """Return whether to open the viewer, and which file to write."""
    name = results.with_name(f"{results.stem.removesuffix('.results')}.rrd")
    checked = partial(writable, force=force, sources=[origin.path], of=lambda: origin)
    shown, rrd = where_to_show(rrd, name, checked, spawn=spawn and not no_viewer)
    if rrd is None and not (spawn or web or no_viewer):
        rrd = checked(name)
    if rrd is not None and rrd.resolve() == results.resolve():
        raise RecordingError(f"{rrd}: expected another file than the results, found the same")
    return shown, rrd


def _stay_with(server: Popen[bytes]) -> None:
    """Serve what was shown to browsers until the user stops."""
    try:
        server.wait()
    finally:
        server.terminate()
        server.communicate()  # it closes the pipe, too


def _run(
    plan: PlannedReplay, sinks: Sequence[Sink], rate: float = 0.0, *, quiet: bool
) -> ReplayCounts:
    """Replay, showing how far it is; ``quiet`` shows nothing."""
    first_ns, last_ns = plan.session.shown_ns or (plan.session.start_ns, plan.session.end_ns)
    length_s = (last_ns - first_ns) / NS_PER_S
    with progress(length_s, "replaying", quiet=quiet) as show:
        return plan.run(sinks, rate=rate, progress=lambda part: show(part * length_s))


def _run_split(
    split: SplitReplay, sinks: Sequence[Sink], *, signal: bool, quiet: bool
) -> ReplayCounts:
    """Replay on an engine, showing how far it is."""
    session = split.plan.session
    length_s = (session.end_ns - session.start_ns) / NS_PER_S
    with progress(length_s, "replaying", quiet=quiet) as show:
        return split.run(sinks, signal=signal, progress=lambda part: show(part * length_s))


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
    warnings = tally.warnings.summary(session.start_ns)
    if json:
        print_json(
            {
                "recording": session.name,
                "pipeline": chain.config.name,
                "topics": [s.topic for s in session.streams],
                "recorded_s": tally.recorded_s,
                "samples": tally.samples,
                "events": counts,
                "lost_s": {topic: ns / NS_PER_S for topic, ns in tally.lost_ns.items()},
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
    print_line(f"results: {results}")
    if rrd is not None:
        size = f"{rrd.stat().st_size / 1e6:.1f} MB, {timeline}"
        print_line(f"timeline: {rrd}, {size} (open it with: rerun {rrd})")
    if damage:
        seen = "" if session.live else f"; see groundtrace info {session.name}"
        print_line(f"damage: {counted(damage, 'place')} skipped{seen}")


def _print_report(
    streams: tuple[Stream, ...], chain: Pipeline, tally: ReplayCounts, counts: dict[str, int]
) -> None:
    signals = ", ".join(f"{s.topic} ({len(s.channels)} x {s.rate_hz:g} Hz)" for s in streams)
    print_line(f"replayed {tally.recorded_s:.1f} s of {signals} through {chain.config.name}")
    one = {kind.plural: kind.name for kind in EVENTS.values()} | {"candidates": "candidate"}
    event_counts = [counted(count, one[name], name) for name, count in counts.items() if count]
    print_line(", ".join(event_counts) or "no events")
    lost = [f"{ns / NS_PER_S:.1f} s of {topic}" for topic, ns in tally.lost_ns.items() if ns > 0]
    if lost:
        print_line(f"not recorded: {', '.join(lost)}, in gaps that are too long to be filled")
