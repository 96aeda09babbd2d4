"""A replay as commands and pages run it: its arguments, the run, and its report."""

from __future__ import annotations

import itertools
import signal
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording as File
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..explain.suitability import Prepared, prepared
from ..pipeline.config import PipelineConfig, checked_pipeline, load_pipeline, with_settings
from ..pipeline.engine import ReplayLoop, ReplaySession
from ..pipeline.plugins import load
from ..pipeline.results import (
    Provenance,
    ResultsSink,
    file_sha256,
    package_versions,
)
from ..pipeline.source import Source
from .files import existing, unheard
from .known_truth import annotations_to_show
from .pipelines import default_pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Note

    from ..pipeline.config import Pipeline as Chain
    from ..pipeline.engine import Clock, ReplayCounts, Sink
    from .files import Report

    #: First and last time of what is replayed [ns]; None where it begins or ends by itself.
    Span = tuple[int | None, int | None]


def replay_to_files(
    recording: Path,
    pipeline: str | Path,
    out: Path,
    rrd: Path,
    *,
    geometry: Path | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    full_rate: str = "",
    report: Report = unheard,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Replay a recording into new results and a viewer's file.

    Parameters
    ----------
    recording
        The recording.
    pipeline
        The name of a shipped pipeline, or a TOML file.
    out, rrd
        What is written: results, and the viewer's file.
    geometry
        Geometry TOML, in the place of the recording's own.
    from_s, to_s
        Replay from <= time < to alone [s since the first sample].
    full_rate
        Where fast signals are shown at every sample, as of ``groundtrace replay``.
    report
        Told what a person should know.
    progress
        Called with the part that is done, 0 to 1.

    Raises
    ------
    Error
        As :func:`replay` does, and where there is no viewer.
    """
    asked = checked_pipeline(str(pipeline))
    site = None if geometry is None else Geometry.from_toml(existing(geometry, "a geometry TOML"))
    with File.open(existing(recording)) as file:
        file.geometry = site or file.geometry
        ready = prepared(asked, file)
        session = session_of(file, recording, ready.chain, report)
        span = span_of(session, from_s, to_s)
        origin = provenance_of(session, recording, ready.chain, span)
        session = shown_part(session, span)
        shown = load("sinks", "rerun")(
            rrd, spawn=False, web=False, full_rate=full_rate, map_tiles=False
        )
        report(shown.expected(session))
        source = Source(file, start_ns=span[0], stop_ns=span[1])
        sinks = [ResultsSink(out, origin), shown]
        run_through(
            source,
            ready.chain,
            sinks,
            session,
            progress=progress,
            looked_at=ready.looked_at,
            first=ready.notes,
        )


def configured_for(
    recording: File, asked: PipelineConfig | None, settings: Sequence[str]
) -> Prepared:
    """Return a pipeline made ready for a recording: the one asked for, or the one that fits."""
    config = asked or with_settings(load_pipeline(default_pipeline(recording)), settings)
    return prepared(config, recording)


def session_of(
    recording: File, path: Path, chain: Chain, report: Report = unheard
) -> ReplaySession:
    """Return what a replay is about.

    Parameters
    ----------
    recording, path
        The recording, open, and its file, beside which annotations are looked for.
    chain
        The pipeline.
    report
        Told what is left out of the annotations.

    Raises
    ------
    RecordingError
        Where there is no signal.
    """
    streams = Source(recording).streams
    if not streams:
        raise RecordingError(f"{recording.name}: expected signals to replay, found none")
    return ReplaySession(
        name=path.name,
        application=chain.config.application,
        start_ns=recording.start_ns,
        end_ns=recording.end_ns,
        streams=streams,
        geometry=recording.geometry,
        labels=recording.labels,
        pipeline=chain.recipe(),
        annotations=annotations_to_show(recording, path, report),
    )


def provenance_of(
    session: ReplaySession, path: Path, chain: Chain, span_ns: Span, arguments: tuple[str, ...] = ()
) -> Provenance:
    """Return where the results of a replay come from; ``arguments`` are those of the command."""
    return Provenance(
        recording=session.name,
        sha256=file_sha256(path),
        start_ns=session.start_ns,
        end_ns=session.end_ns,
        pipeline=chain.recipe(),
        arguments=arguments,
        versions=package_versions(),
        from_ns=span_ns[0],
        to_ns=span_ns[1],
        placements={s.topic: s.placement for s in session.streams if s.placement},
    )


def span_of(session: ReplaySession, from_s: float | None, to_s: float | None) -> Span:
    """Return a span given in seconds since the first sample [ns].

    Raises
    ------
    RecordingError
        Where it ends before it begins, or begins after the recording.
    """

    def at(seconds: float | None) -> int | None:
        return None if seconds is None else session.start_ns + round(seconds * NS_PER_S)

    if from_s is not None and to_s is not None and to_s <= from_s:
        raise RecordingError(f"--to: expected more than --from {from_s:g}, found {to_s:g}")
    length_s = (session.end_ns - session.start_ns) / NS_PER_S
    if from_s is not None and from_s > length_s:
        raise RecordingError(
            f"--from: expected at most the {length_s:g} s of {session.name}, found {from_s:g}"
        )
    return at(from_s), at(to_s)


def shown_part(session: ReplaySession, span_ns: Span) -> ReplaySession:
    """Return the session with the part of it that is replayed."""
    if span_ns == (None, None):
        return session
    start_ns, end_ns = span_ns
    first_ns = session.start_ns if start_ns is None else start_ns
    last_ns = session.end_ns if end_ns is None else min(end_ns, session.end_ns)
    return replace(session, shown_ns=(first_ns, last_ns))


@contextmanager
def terminable() -> Iterator[None]:
    """End as with Ctrl-C where the system asks for it, so that what was begun is cleared away."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def run_through(
    source: Source,
    chain: Chain,
    sinks: Sequence[Sink],
    session: ReplaySession,
    *,
    clock: Clock | None = None,
    progress: Callable[[float], None] | None = None,
    looked_at: Iterable[str] = (),
    first: Sequence[Note] = (),
) -> ReplayCounts:
    """Replay into sinks, from opening to closing them.

    A replay that is stopped leaves no output under its name.

    Parameters
    ----------
    source, chain, sinks, session
        What is replayed, through what, and where to.
    clock
        Paces the replay; None means as fast as possible.
    progress
        Called with the part that is done, 0 to 1.
    looked_at
        Topics whose placement is known, so that none is guessed.
    first
        What is to be said of the recording before anything else.
    """
    # what filters is not imported before there is something to filter
    from ..inertial.placement import noted
    from ..inertial.worn_sensor_faults import judged

    first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
    length_ns = max(last_ns - first_ns, 1)

    def reached(time_ns: int) -> None:
        if progress is not None:
            progress(min(max((time_ns - first_ns) / length_ns, 0.0), 1.0))

    for sink in sinks:
        sink.open(session)
    done = False
    try:
        loop = ReplayLoop(chain, sinks, clock=clock, progress=reached)
        placed = noted(source, dict.fromkeys(looked_at))
        tally = loop.through(itertools.chain(first, judged(placed, source.streams)))
        done = True
        return tally
    finally:
        with ExitStack() as closing:  # each is closed, whatever comes of the others
            for sink in reversed(sinks):
                closing.callback(sink.close if done else getattr(sink, "abandon", sink.close))
