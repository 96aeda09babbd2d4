"""``groundtrace replay``."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording

from ..api.session import configured_for, provenance_of, session_of, shown_part, span_of
from ..clock import Clock
from ..errors import RecordingError
from ..pipeline import build_pipeline, checked_pipeline
from ..plugins import load
from ..results import ResultsSink, public_arguments
from ..source import Source
from .at_miss import Around, missed_step
from .output import existing, say, writable
from .replay_report import report
from .replay_run import run_into
from .showing import where_to_show

if TYPE_CHECKING:
    from ..sinks import Sink

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
        session = session_of(opened, path, chain, say)
        span = span_of(session, from_, to)
        arguments = public_arguments(sys.argv[1:])
        provenance = provenance_of(session, path, chain, span, arguments)
        session = shown_part(session, span)
        sinks: list[Sink] = [ResultsSink(results, provenance, force=force)]
        if at_miss is None and (rrd is not None or spawn or web):
            shown = load("sinks", "rerun")(
                rrd, spawn=spawn, web=web, full_rate=full_rate, map_tiles=map_tiles
            )
            say(shown.expected(session))
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
            run_into(Source(opened), again, [Around(shown, at_ns)], session, quiet=quiet)
        damage = len(set(opened.damage))
    timeline = shown.summary if shown is not None else ""
    report(session, chain, tally, results, rrd, timeline, damage, json=json)
    if web:
        _stay_with_the_page(shown)


def _bundled() -> Path:
    from groundtrace_recordings import path_of

    say("no recording given: replaying the bundled walk through a room")
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
    say(f"serving {url} (Ctrl-C ends it)")
    try:
        server.wait()
    finally:
        server.terminate()
        server.wait()
