"""A replay as commands and pages run it: its arguments, the run, and a part of it about a miss."""

from __future__ import annotations

import itertools
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.importers.units import RANGES
from groundtrace_codecs.live import LiveRecording
from groundtrace_codecs.mcap.follow import GrowingFile, PipeBytes
from groundtrace_codecs.recording import Recording as File
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..errors import RecordingError, UsageError
from ..explain.suitability import Prepared, prepared
from ..pipeline.chain import Pipeline, build_pipeline
from ..pipeline.config import PipelineConfig, checked_pipeline, load_pipeline, with_settings
from ..pipeline.engine import Clock, ReplayLoop, ReplaySession, part_of
from ..pipeline.plugins import load
from ..pipeline.results import (
    Provenance,
    ResultsSink,
    evidence_of,
    package_versions,
    read_results,
    replayed_labels,
)
from ..pipeline.source import Source
from .files import existing_file, existing_recording, named_recording, unheard
from .known_truth import annotations_to_show, truth_beside
from .pipelines import default_pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from concurrent.futures import Future
    from threading import Event as Stop

    from groundtrace_codecs.events import Event, Gap, Label, Note
    from groundtrace_codecs.mcap.follow import Growing

    from ..pipeline.engine import ReplayCounts, Sink
    from .files import Report

#: Stands for standard input; the command line takes ``-`` for it.
STANDARD_INPUT = Path("/dev/stdin")
#: What is shown before and after a missed step [s]. Chosen by judgement: some steps to either side.
AROUND_S = 5.0


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
    beside: Sequence[Sink] = (),
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
    beside
        Other sinks. Where there are some, somebody looks on: the viewer's file has all as it comes.

    Raises
    ------
    Error
        As :func:`replay` does, and where there is no viewer.
    """
    asked = checked_pipeline(str(pipeline))
    site = (
        None if geometry is None else Geometry.from_toml(existing_file(geometry, "a geometry TOML"))
    )
    with File.open(named_recording(recording)) as file:
        file.geometry = site or file.geometry
        plan = PlannedReplay.of(file, recording, prepared(asked, file), from_s, to_s, report)
        shown = load("sinks", "rerun")(
            rrd, watched=bool(beside), full_rate=full_rate, map_tiles=False
        )
        report(shown.expected(plan.session))
        sinks = [ResultsSink(out, plan.provenance()), shown, *beside]
        plan.run(sinks, progress=progress)


def configured_for(
    recording: File, asked: PipelineConfig | None, settings: Sequence[str]
) -> Prepared:
    """Return a pipeline made ready for a recording: the one asked for, or the one that fits."""
    config = asked or with_settings(load_pipeline(default_pipeline(recording)), settings)
    return prepared(config, recording)


@dataclass(frozen=True, slots=True)
class PlannedReplay:
    """A replay that is checked and can begin.

    Attributes
    ----------
    recording, path
        The recording, open, and its file, beside which annotations are looked for.
    ready
        The pipeline.
    session
        What is replayed and shown of it.
    span
        First and last time [ns]; None where it begins or ends by itself.
    live
        The recording where it still grows; ``recording`` is its beginning then.
    hashed
        The SHA-256 of the recording, where it is computed beside the replay.
    """

    recording: File
    path: Path
    ready: Prepared
    session: ReplaySession
    span: tuple[int | None, int | None]
    live: LiveRecording | None = None
    hashed: Future[str] | None = None

    @classmethod
    def of(
        cls,
        recording: File,
        path: Path,
        ready: Prepared,
        from_s: float | None = None,
        to_s: float | None = None,
        report: Report = unheard,
        live: LiveRecording | None = None,
    ) -> PlannedReplay:
        """Check a replay.

        Parameters
        ----------
        recording, path, ready
            What is replayed, and through what.
        from_s, to_s
            Replay from <= time < to alone [s since the first sample].
        report
            Told what is left out of the annotations.
        live
            The recording where it still grows, of which ``recording`` is the beginning.

        Raises
        ------
        RecordingError
            Where there is no signal, or none in that span.
        """
        streams = Source(recording).streams
        if not streams:
            raise RecordingError(f"{recording.name}: expected signals to replay, found none")
        session = ReplaySession(
            name=path.name,
            application=ready.chain.config.application,
            start_ns=recording.start_ns,
            end_ns=recording.end_ns,
            streams=streams,
            geometry=recording.geometry,
            labels=recording.labels,
            pipeline=ready.chain.recipe(),
            annotations=annotations_to_show(recording, path, report),
            live=live is not None,
        )
        start_ns, end_ns = _span(session, from_s, to_s)
        if (start_ns, end_ns) != (None, None):
            first_ns = session.start_ns if start_ns is None else start_ns
            last_ns = session.end_ns if end_ns is None else min(end_ns, session.end_ns)
            session = replace(session, shown_ns=(first_ns, last_ns))
        plan = cls(recording, path, ready, session, (start_ns, end_ns), live)
        if beside := plan.beside_span():
            report(beside)
        return plan

    def again(self) -> PlannedReplay:
        """Return the same with a pipeline that has seen nothing yet."""
        chain = build_pipeline(
            self.ready.chain.config, self.recording.geometry, self.recording.labels
        )
        return replace(self, ready=Prepared(chain, self.ready.asked, (), ()))

    def provenance(self, arguments: tuple[str, ...] = ()) -> Provenance:
        """Return where its results come from; ``arguments`` are those of the command.

        Of a recording that grows or comes from elsewhere the bytes are known when it was read, and
        of a part of one from elsewhere they are not.
        """
        session = self.session
        return Provenance(
            recording=session.name,
            sha256="" if self._known_late else self.recording.file.sha256(),
            start_ns=session.start_ns,
            end_ns=session.end_ns,
            pipeline=session.pipeline,
            arguments=arguments,
            versions=package_versions(),
            from_ns=self.span[0],
            to_ns=self.span[1],
            placements={s.topic: s.placement for s in session.streams if s.placement},
        )

    @property
    def _known_late(self) -> bool:
        """Whether the recording's bytes are known only when it was read."""
        late = self.live is not None or self.hashed is not None
        return late or self.recording.file.remote

    def _complete(self, sinks: Sequence[Sink], *, read: bool) -> None:
        """Let results say which bytes they are of, where these end, and what truth came late.

        ``read`` is whether the whole recording was read here: else it is not fetched to be hashed.
        """
        if not self._known_late:
            return
        live = self.live
        late: list[Label] = []
        if live is not None:
            early = set(live.head.labels)
            late = [label for label in live.labels if label not in early]
        sha256 = ""
        if live is not None:
            sha256 = live.sha256()
        elif self.hashed is not None:
            sha256 = self.hashed.result()
        elif read and self.read_span == (None, None):
            sha256 = self.recording.file.sha256()
        end_ns = self.session.end_ns if live is None else live.end_ns
        for sink in sinks:
            if isinstance(sink, ResultsSink):
                sink.complete(replace(sink.provenance, sha256=sha256, end_ns=end_ns), late)

    @property
    def read_span(self) -> tuple[int | None, int | None]:
        """What is replayed so that the span has the decisions of a replay of the whole [ns].

        It begins and ends by the memory of the pipeline's stages before and after the span; None is
        no bound.
        """
        memory, (start_ns, stop_ns) = self.ready.chain.memory, self.span
        if start_ns is not None:
            before_s = memory.warm_up_s
            start_ns = None if before_s is None else start_ns - round(before_s * NS_PER_S)
        if stop_ns is not None:
            after_s = memory.delay_s
            stop_ns = None if after_s is None else stop_ns + round(after_s * NS_PER_S)
        return start_ns, stop_ns

    def beside_span(self) -> str:
        """Return in one line what is replayed beside the span, for people; empty for little."""
        session, stages = self.session, self.ready.chain.memories
        start_ns, stop_ns = self.span
        parts = []
        before = [name for name, memory in stages.items() if memory.warm_up_s is None]
        if before and start_ns is not None and start_ns > session.start_ns:
            seconds = (start_ns - session.start_ns) / NS_PER_S
            parts.append(f"the {seconds:.1f} s before it, on all of which {before[0]} depends")
        after = [name for name, memory in stages.items() if memory.delay_s is None]
        if after and stop_ns is not None and stop_ns < session.end_ns:
            seconds = (session.end_ns - stop_ns) / NS_PER_S
            parts.append(f"the {seconds:.1f} s after it, on all of which {after[0]} depends")
        return f"the span is replayed with {' and '.join(parts)}" if parts else ""

    def signal(self, block_s: float | None = None) -> Iterable[SignalBlock | Gap | Note]:
        """Return what is replayed of the recording, with warnings of worn sensors.

        Blocks are as long as those of :class:`.pipeline.source.Source`.
        """
        start_ns, stop_ns = self.read_span
        source = Source(
            self.live or self.recording,
            start_ns=start_ns,
            stop_ns=stop_ns,
            block_s=block_s,
            bridge_s=self.ready.chain.bridge_s,
            in_whole=True,
        )
        return with_warnings(source, self.ready.looked_at)

    def run(
        self,
        sinks: Sequence[Sink],
        *,
        rate: float = 0.0,
        progress: Callable[[float], None] | None = None,
        given: tuple[Pipeline, Iterable[SignalBlock | Gap | Note]] | None = None,
    ) -> ReplayCounts:
        """Replay into sinks, from opening to closing them.

        A replay that is stopped leaves no output under its name. One of a recording that grows is
        ended by whoever follows it, and then is a whole one of what there was.

        Parameters
        ----------
        sinks
            Where to.
        rate
            Recorded seconds per second; 0 is as fast as possible.
        progress
            Called with the part that is done, 0 to 1.
        given
            A pipeline and what goes through it, in the place of its own and of the recording.
        """
        session = self.session
        first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
        length_ns = max(last_ns - first_ns, 1)

        def reached(time_ns: int) -> None:
            if progress is not None:
                progress(min(max((time_ns - first_ns) / length_ns, 0.0), 1.0))

        # who waits for samples is given them as they come, and nothing is taken ahead
        waits = bool(rate) or self.live is not None
        chain, items = given or (self.ready.chain, self.signal(block_s=0.0 if waits else None))
        for sink in sinks:
            sink.open(session)
        done = False
        try:
            clock = Clock(rate) if waits else None
            loop = ReplayLoop(chain, sinks, clock=clock, progress=reached, span=self.span)
            tally = loop.through(itertools.chain(self.ready.notes, items))
            self._complete(sinks, read=given is None)
            done = True
            return tally
        finally:
            with ExitStack() as closing:  # each is closed, whatever comes of the others
                for sink in reversed(sinks):
                    closing.callback(sink.close if done else getattr(sink, "abandon", sink.close))


@contextmanager
def growing(path: Path, stop: Stop, report: Report = unheard) -> Iterator[LiveRecording]:
    """Open a recording that is still being written, and wait until its streams are known.

    Parameters
    ----------
    path
        The file; the one that grows beside it as ``NAME.partial``, as our own writer names it; or
        :data:`STANDARD_INPUT`.
    stop
        Set to end the replay as if the recording ended there.
    report
        Told what a person should know of the writer.

    Raises
    ------
    RecordingError
        Where there is no such file.
    CodecError
        Where it is no recording, or has no signals.
    """
    source: Growing
    if path == STANDARD_INPUT:
        # unbuffered: a thread that waits inside a buffer would hold the interpreter's end
        source = PipeBytes(open(0, "rb", buffering=0, closefd=False), "standard input")  # noqa: SIM115
    else:
        partial = path.with_name(f"{path.name}.partial")
        source = GrowingFile(partial if partial.is_file() else existing_recording(path))
    with LiveRecording.open(source, stop, report) as live:
        yield live


def with_warnings(source: Source, looked_at: Iterable[str]) -> Iterable[SignalBlock | Gap | Note]:
    """Return what a source gives, with warnings of worn sensors: where they are worn, and faults.

    Parameters
    ----------
    source
        Of the recording.
    looked_at
        Topics whose placement is known, so that none is guessed.
    """
    if not any(c.quantity in RANGES for stream in source.streams for c in stream.channels):
        return source  # geophones are worn by nobody
    # what filters is not imported before there is something to filter
    from ..inertial.placement import noted
    from ..inertial.worn_sensor_faults import judged

    return judged(noted(source, dict.fromkeys(looked_at)), source.streams)


def check_order(from_s: float | None, to_s: float | None) -> None:
    """Raise UsageError where a part ends before it begins [s since the first sample]."""
    if from_s is not None and to_s is not None and to_s <= from_s:
        raise UsageError(f"--to: expected more than --from {from_s:g}, found {to_s:g}")


def _span(
    session: ReplaySession, from_s: float | None, to_s: float | None
) -> tuple[int | None, int | None]:
    """Return a span given in seconds since the first sample [ns]."""

    def at(seconds: float | None) -> int | None:
        return None if seconds is None else session.start_ns + round(seconds * NS_PER_S)

    check_order(from_s, to_s)
    length_s = (session.end_ns - session.start_ns) / NS_PER_S
    if from_s is not None and from_s > length_s:
        raise UsageError(
            f"--from: expected at most the {length_s:g} s of {session.name}, found {from_s:g}"
        )
    return at(from_s), at(to_s)


def missed_step(results: Path, number: int, report: Report = unheard) -> int:
    """Return the time of a missed step of a result [ns]; the first has the number 1.

    Parameters
    ----------
    results
        The file.
    number
        Of the step among those that were missed.
    report
        Told what a person should know of the truth.

    Raises
    ------
    RecordingError
        Where there is no truth, or there are not so many.
    """
    # what explains is not imported by a replay that asks for no reason
    from ..evaluation.matching import STEP_TOLERANCE_S
    from ..evaluation.truth import kinds_of
    from ..explain.reasons import matched

    result = read_results(results)
    labels = truth_beside(result, results, report=report)
    name = result.provenance.recording
    if not any(label.kind == "step" for label in labels):
        raise RecordingError(
            f"{name}: --at-miss: expected true steps in the recording, found {kinds_of(labels)}"
        )
    matching = matched(evidence_of(result, labels), tolerance_s=STEP_TOLERANCE_S)
    if not 1 <= number <= len(matching.missed):
        raise RecordingError(
            f"{name}: --at-miss: expected one of the {len(matching.missed)} missed steps, "
            f"found {number}"
        )
    return int(matching.truth_ns[matching.missed[number - 1]])


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
        part = part_of(item, self._start_ns, self._end_ns)
        if part is not None:
            self._sink.write(part)

    def abandon(self) -> None:
        """End the replay without an output."""
        abandon = getattr(self._sink, "abandon", self._sink.close)
        abandon()

    def close(self) -> None:
        """End the replay."""
        self._sink.close()
