"""Results: an MCAP file beside the recording with everything a replay decided, written and read."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import secrets
import shutil
import tomllib
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, Protocol, cast

import msgspec
import numpy as np

from groundtrace_codecs.errors import Error, NoRoomError
from groundtrace_codecs.events import (
    SMOOTHED,
    CandidateBlock,
    Gap,
    StageSpec,
    TraceBlock,
    TrackPoint,
)
from groundtrace_codecs.location import Location, is_url
from groundtrace_codecs.mcap.byte_source import RemoteBytes
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..errors import OutputError, RecordingError
from ..runtime import installed_version
from .config import parse_pipeline
from .gates import Candidates, GateState, Refractory
from .parameters import given_waypoints
from .stage import Frames
from .warned import warnings_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event, Label
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.writer import RecordingWriter

    from .config import PipelineConfig
    from .engine import ReplaySession
    from .warned import Warned

RUN = "groundtrace.run"
#: First and last time. Source: definition, int64.
FIRST_NS, LAST_NS = -(2**63), 2**63 - 1
PACKAGES = ("groundtrace", "numpy", "scipy", "mcap")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a result comes from, kept in its metadata.

    Attributes
    ----------
    recording
        File name of the recording.
    sha256
        Of its bytes.
    start_ns, end_ns
        Its first and last sample [ns].
    pipeline
        The resolved pipeline, TOML.
    arguments
        The command line, every path reduced to its file name.
    from_ns, to_ns
        Half-open span that was replayed [ns]; None where it begins or ends with the recording.
    versions
        Of the packages that took part.
    placements
        Where on the body the sensor of a topic is worn, of those that state it.
    """

    recording: str
    sha256: str
    start_ns: int
    end_ns: int
    pipeline: str
    arguments: tuple[str, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
    from_ns: int | None = None
    to_ns: int | None = None
    placements: dict[str, str] = field(default_factory=dict)

    def beside(self, results: Path) -> Path:
        """Return where the recording would lie beside results."""
        return results.parent / PureWindowsPath(self.recording).name


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide a result."""
    # reading results needs none, and it takes a while to load
    from importlib.metadata import version

    versions = {name: version(name) for name in PACKAGES if name != "groundtrace"}
    return {"python": platform.python_version(), "groundtrace": installed_version()} | versions


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits; of a URL's, all are fetched."""
    if is_url(path):
        return RemoteBytes(Location(path)).sha256()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def timeline_id(name: str) -> str:
    """Return the id of a recording in the viewer, by its file name."""
    return hashlib.sha256(name.encode()).hexdigest()[:16]


def is_result_of(path: Path, sha256: str) -> bool:
    """Whether a file is results, and nothing else, of a recording with these bytes."""
    from groundtrace_codecs.recording import Recording

    try:
        with Recording.open(path) as opened:
            return not opened.streams and provenance_in(opened, path.name).sha256 == sha256
    except Error:
        return False


def previous_results(path: Path) -> Path:
    """Return where a replay keeps the results that it replaces: NAME.previous.results.mcap."""
    name = path.name.removesuffix(path.suffix)
    kind = ".results" if name.endswith(".results") else ""
    return path.with_name(f"{name.removesuffix(kind)}.previous{kind}{path.suffix}")


def recording_in(places: Sequence[Path], sha256: str = "") -> Path | None:
    """Return the first of some places where a recording is, by its SHA-256 where that is given."""
    for path in places:
        if path.is_file() and (not sha256 or file_sha256(path) == sha256):
            return path
    return None


def public_arguments(arguments: Sequence[str]) -> tuple[str, ...]:
    """Return a command line without folders: what is shared must not tell where people work."""
    return tuple(_without_folders(argument) for argument in arguments)


def _without_folders(argument: str) -> str:
    option, equals, value = argument.rpartition("=")
    if "/" in option or "\\" in option:  # the equals sign belongs to a path
        option, equals, value = "", "", argument
    # a Windows path splits at both kinds of slashes
    return option + equals + PureWindowsPath(value).name if set(value) & set("/\\") else argument


#: Length at which a chunk of results is ended [bytes]: a replay that is killed keeps those before.
#: Chosen by judgement: some seconds of a replay.
CHUNK_BYTES = 256 << 10


class ResultsSink:
    """Writes events, labels and geometry to a results MCAP; signals stay in the recording.

    Parameters
    ----------
    path
        The file.
    provenance
        Where the results come from.
    force
        Replace an existing file.
    """

    def __init__(self, path: Path, provenance: Provenance, *, force: bool = False) -> None:
        self.path = path
        self.provenance = provenance
        self.force = force
        self._writer: RecordingWriter | None = None

    def open(self, session: ReplaySession) -> None:
        """Begin the file."""
        from groundtrace_codecs.writer import RecordingWriter

        self._writer = RecordingWriter(self.path, force=self.force, chunk_bytes=CHUNK_BYTES)
        self._writer.__enter__()
        if session.geometry is not None:
            self._writer.set_geometry(session.geometry)
        self._writer.add_labels(session.labels)
        if session.annotations:
            self._writer.add_annotations(session.annotations)
        self._state(self.provenance)

    def complete(self, provenance: Provenance, labels: Sequence[Label]) -> None:
        """State what is known of the recording only when it ends: its bytes, and labels in it."""
        self.provenance = provenance
        self._state(provenance)
        if self._writer is not None:
            self._writer.add_labels(labels)

    def _state(self, provenance: Provenance) -> None:
        """Write where the results come from; the last that is written counts."""
        if self._writer is not None:
            self._writer.add_metadata(RUN, {"json": msgspec.json.encode(provenance).decode()})

    def write(self, item: SignalBlock | Event) -> None:
        """Take an event; signals are left out."""
        if self._writer is not None and not isinstance(item, SignalBlock):
            self._writer.add_event(item)

    def abandon(self) -> None:
        """End without giving the file its name: what was written stays in NAME.partial."""
        writer, self._writer = self._writer, None
        if writer is not None:
            error = RuntimeError("the replay did not end")
            writer.__exit__(RuntimeError, error, None)

    def close(self) -> None:
        """Finish the file and give it its name; results of the recording it had are kept."""
        if self._writer is not None:
            if self.path.exists() and is_result_of(self.path, self.provenance.sha256):
                _keep(self.path)
            self._writer.__exit__(None, None, None)
            self._writer = None


def _keep(path: Path) -> None:
    """Keep results that are about to be replaced; until then they have both names."""
    previous = previous_results(path)
    fresh = previous.with_name(f".{previous.name}.{secrets.token_hex(4)}")
    try:
        fresh.hardlink_to(path)
    except OSError:  # of file systems without hard links
        shutil.copyfile(path, fresh)
    fresh.replace(previous)


@dataclass(frozen=True, slots=True)
class Results:
    """A results file, read.

    Attributes
    ----------
    name
        File name.
    provenance
        What made it.
    labels
        Truth copied from the recording.
    geometry
        Copied from the recording.
    events
        In the order of the file.
    annotations
        As they were when the recording was replayed.
    given
        Waypoints that stages of the pipeline were given: they are no truth to it.
    """

    name: str
    provenance: Provenance
    labels: tuple[Label, ...]
    geometry: Geometry | None
    events: tuple[Event, ...]
    annotations: tuple[Annotation, ...] = ()
    given: tuple[Label, ...] = ()

    @property
    def warnings(self) -> tuple[Warned, ...]:
        """What the replay warned of, each once."""
        return warnings_of(self.events, self.provenance.start_ns)


def read_results(path: Path, *, blocks: bool = True, evidence: bool = False) -> Results:
    """Read a results file.

    Parameters
    ----------
    path
        The file.
    blocks
        Whether candidates and decision functions are among the events.
    evidence
        Whether the events are only what decisions are explained by, many candidates to a block:
        their memory is a fraction.

    Raises
    ------
    RecordingError
        Where the file is not a groundtrace result.
    CodecError
        Where it is not a readable MCAP.
    """
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.schemas.event_messages import events_of

    if not path.is_file():
        raise RecordingError(f"{path.name}: expected a results file, found no such file")
    with Recording.open(path) as recording:
        provenance = provenance_in(recording, path.name)
        labels = replayed_labels(recording.labels, provenance.from_ns, provenance.to_ns)
        if evidence:
            events = tuple(joined(events_of(recording.file, only=KINDS)))
        else:
            events = tuple(events_of(recording.file, blocks=blocks))
        given = given_to(provenance.pipeline, recording.labels)
        return Results(
            path.name, provenance, labels, recording.geometry, events, recording.annotations, given
        )


def given_to(pipeline: str, labels: Sequence[Label]) -> tuple[Label, ...]:
    """Return the waypoints that the stages of a resolved pipeline, TOML, are given of labels."""
    try:
        stages = tomllib.loads(pipeline).get("stage", [])
    except tomllib.TOMLDecodeError:
        return ()  # who asks for the pipeline says it
    updates = [str(stage.get("parameters", {}).get("updates", "")) for stage in stages]
    return max((tuple(given_waypoints(labels, each)) for each in updates), key=len, default=())


def provenance_of(path: Path) -> Provenance:
    """Return where results come from.

    Raises
    ------
    RecordingError
        Where the file is not a groundtrace result.
    CodecError
        Where it is not a readable MCAP.
    """
    from groundtrace_codecs.recording import Recording

    with Recording.open(path) as opened:
        return provenance_in(opened, path.name)


def provenance_in(recording: Recording, name: str) -> Provenance:
    """Return where the results in an open file come from; ``name`` names it in errors.

    Raises
    ------
    RecordingError
        Where the file is not a groundtrace result.
    """
    run = recording.metadata.get(RUN)
    if run is None and recording.streams:
        raise RecordingError(
            f"{name}: expected results, found a recording; "
            f"replay it first: groundtrace replay {name}"
        )
    if run is None:
        raise RecordingError(
            f"{name}: metadata: expected {RUN} as groundtrace replay --out writes it, "
            f"found {', '.join(recording.metadata) or 'none'}"
        )
    try:
        return msgspec.json.decode(run.get("json", ""), type=Provenance)
    except msgspec.DecodeError as error:
        raise RecordingError(
            f"{name}: metadata: {RUN}: expected a provenance, found: {error}"
        ) from None


def replayed_labels(
    labels: Sequence[Label], from_ns: int | None, to_ns: int | None
) -> tuple[Label, ...]:
    """Return the labels of the span that was replayed; labelled spans are cut to it."""
    first = FIRST_NS if from_ns is None else from_ns
    last = LAST_NS if to_ns is None else to_ns
    cut = (label.within(first, last) for label in labels)
    return tuple(label for label in cut if label is not None)


#: What the system says where no more bytes go into a file, whichever it is.
NO_ROOM = frozenset((errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)))


@contextmanager
def room_for(path: Path, *written: Path) -> Iterator[None]:
    """Say that ``path`` cannot be written where the system refuses it in the block.

    Parameters
    ----------
    path
        The output, as the user knows it.
    written
        Files or folders that stand for it while they are written.

    Raises
    ------
    OutputError
        In place of an OSError of a full disk, or of one of those places.
    """
    try:
        yield
    except (NoRoomError, OutputError) as error:  # of a place that goes with the block
        raise OutputError(path, error.reason) from error
    except OSError as error:
        places = {str(output) for output in (path, *written)}
        of = {str(error.filename), *map(str, Path(str(error.filename)).parents)}
        if error.errno not in NO_ROOM and not places & of:
            raise
        raise OutputError(path, os.strerror(error.errno) if error.errno else str(error)) from error


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a place beside ``path``; the file or folder written there then takes its name.

    What had the name before is there until then, and stays where an exception ends the block.

    Raises
    ------
    OutputError
        Where the disk is full, or nothing may be written there.
    """
    mark = secrets.token_hex(4)
    fresh, old = (path.with_name(f".{path.stem}.{mark}.{what}{path.suffix}") for what in "no")
    try:
        with room_for(path, fresh):
            yield fresh
            if path.is_dir():  # a folder that is not empty cannot be renamed over
                path.rename(old)
            fresh.replace(path)
    except BaseException:
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    finally:
        for left in _beginning(fresh, old):
            if left.is_dir():
                shutil.rmtree(left)
            else:
                left.unlink()


def _beginning(*places: Path) -> list[Path]:
    """Return what is there of some places, and what their writers began beside them."""
    folder, names = places[0].parent, tuple(path.name for path in places)
    return [p for p in folder.iterdir() if p.name.startswith(names)] if folder.is_dir() else []


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 so that it appears whole or not at all."""
    with atomic_write(path) as fresh:
        fresh.write_text(text, encoding="utf-8")


#: Messages that evidence is made of, and what the replay warned of.
KINDS = frozenset({"CandidateBlock", "TraceBlock", "Gap", "Note", "TrackPoint"})
#: So many blocks of a stage are joined. Chosen by judgement: it bounds memory.
JOINED = 256


@dataclass(frozen=True, slots=True, eq=False)
class StageEvidence:
    """All candidates and frames of one stage on one topic.

    Attributes
    ----------
    spec
        What the columns mean, and the gates as they stood.
    candidates
        In the order they were decided.
    gate_value, margin
        Shape (n, n_gates), float32, as decided.
    accepted
        Shape (n,), bool, as decided.
    frames
        The trace; empty for associators.
    """

    spec: StageSpec
    candidates: Candidates
    gate_value: NDArray[np.float32]
    margin: NDArray[np.float32]
    accepted: NDArray[np.bool_]
    frames: Frames

    def between(self, start_ns: int, end_ns: int) -> NDArray[np.intp]:
        """Return the rows of candidates with start <= time <= end."""
        times = self.candidates.time_ns
        return np.flatnonzero((times >= start_ns) & (times <= end_ns))

    def carried(self) -> GateState:
        """Return what decisions before the first candidates left behind, where they tell it.

        Those of a span do: each channel's first one says how long before another was accepted.
        """
        state = GateState()
        channels, first = np.unique(self.candidates.channel, return_index=True)
        for column, gate in enumerate(self.spec.gates):
            if gate.parameter != Refractory().parameter:
                continue
            since_s = self.gate_value[first, column].astype(np.float64)
            valid = np.isfinite(since_s)
            back_ns = np.rint(since_s[valid] * NS_PER_S).astype(np.int64)
            last_ns = self.candidates.time_ns[first[valid]] - back_ns
            pairs = zip(channels[valid].tolist(), last_ns.tolist(), strict=True)
            state.last_ns[gate.name] = dict(pairs)
        return state


@dataclass(frozen=True, slots=True)
class Unmuted:
    """A candidate that is there without the filter.

    Attributes
    ----------
    time_ns
        Its time.
    value
        What its decision function reaches, in the unit of the candidates' first column.
    """

    time_ns: int
    value: float


class WithoutFilters(Protocol):
    """The signal of a result, measured again without the filters of its stages."""

    @property
    def at_hand(self) -> bool:
        """Whether the recording is."""

    def around(self, part: StageEvidence, time_ns: int) -> StageEvidence | None:
        """Return what a stage measures without its filter in the stretch that a time lies in."""

    def nearest(
        self, part: StageEvidence, channel: int, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return what passes all thresholds in a span without the filter, nearest its middle."""

    def group(
        self, part: StageEvidence, source: StageEvidence, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return the accepted group of picks in a span where they are picked without the filter."""

    def clipped(self, part: StageEvidence, start_ns: int, end_ns: int) -> tuple[str, float] | None:
        """Return the channel that stood still at its extreme for longest, and for how long [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Everything needed to decide again.

    Attributes
    ----------
    name
        File name of the recording.
    config
        The pipeline, every parameter as it stood.
    stages
        In the order of the pipeline, then of the topics.
    gaps
        Interruptions of the streams.
    labels
        The truth.
    start_ns, end_ns
        First and last sample of the recording [ns].
    geometry
        Where the sensors are; None where unknown.
    track
        Where targets were tracked, by the last stage that tracks.
    warnings
        What the replay warned of.
    unfiltered
        Measures the recording again without a stage's filter; None where it is not known.
    """

    name: str
    config: PipelineConfig
    stages: tuple[StageEvidence, ...]
    gaps: tuple[Gap, ...]
    labels: tuple[Label, ...]
    start_ns: int
    end_ns: int
    geometry: Geometry | None = None
    track: tuple[TrackPoint, ...] = ()
    warnings: tuple[Warned, ...] = ()
    unfiltered: WithoutFilters | None = None

    @property
    def clock_steps_s(self) -> tuple[float, ...]:
        """Where a clock stepped and ended a run [s since the first sample].

        A replay forgets there what it accepted before; stored candidates do not tell on which
        side of the step they lie, so that decisions after it may not be decided again exactly.
        """
        steps = [g.start_ns for g in self.gaps if g.reason == "clock step" and not g.bridged]
        return tuple((time_ns - self.start_ns) / NS_PER_S for time_ns in steps)

    def of(self, stage: str) -> tuple[StageEvidence, ...]:
        """Return the evidence of a stage, topic by topic."""
        return tuple(e for e in self.stages if e.spec.stage == stage)


def evidence_of(results: Results, labels: tuple[Label, ...] | None = None) -> Evidence:
    """Return the evidence of a result; ``labels`` replace its own truth where given."""
    origin = results.provenance
    config = parse_pipeline(origin.pipeline.encode(), f"{results.name}: pipeline")
    order = [stage.key for stage in config.stage]
    return Evidence(
        origin.recording,
        config,
        stage_evidence(results.events, order),
        tuple(e for e in results.events if isinstance(e, Gap)),
        results.labels if labels is None else labels,
        origin.start_ns,
        origin.end_ns,
        results.geometry,
        _last_track(results.events, order),
        results.warnings,
    )


def step_times(evidence: Evidence) -> NDArray[np.int64]:
    """Return the times of the steps of the last stage that emits them, sorted [ns]."""
    stages = [part for part in evidence.stages if part.spec.emits == "step"]
    last = stages[-1].spec.stage if stages else ""
    times = [p.candidates.time_ns[p.accepted] for p in stages if p.spec.stage == last]
    return np.sort(np.concatenate([np.empty(0, np.int64), *times]))


def joined(events: Iterable[Event]) -> Iterator[Event]:
    """Yield events, the candidates and frames of each stage and topic many to a block.

    An hour has a hundred thousand blocks of a few candidates, and each block its own arrays.
    """
    waiting: dict[tuple[type[Event], int], list[Any]] = {}
    for event in events:
        if not isinstance(event, CandidateBlock | TraceBlock):
            yield event
            continue
        parts = waiting.setdefault((type(event), id(event.spec)), [])
        parts.append(event)
        if len(parts) == JOINED:
            yield _one_block(parts)
            parts.clear()
    for parts in waiting.values():
        if parts:
            yield _one_block(parts)


def _one_block(parts: Sequence[Any]) -> Event:
    """Return blocks of one kind, stage and topic as one."""
    columns = (field.name for field in fields(parts[0]) if field.name != "spec")
    joint = (np.concatenate([getattr(part, name) for part in parts]) for name in columns)
    return cast("Event", type(parts[0])(parts[0].spec, *joint))


def _last_track(events: Iterable[Event], order: Sequence[str]) -> tuple[TrackPoint, ...]:
    """Return the points of the last stage that tracks: a smoother comes after what it smooths."""
    points = [e for e in events if isinstance(e, TrackPoint)]
    tracked = {p.stage for p in points}
    both = [name for stage in order for name in (stage, stage + SMOOTHED)]
    last = next((name for name in reversed(both) if name in tracked), "")
    return tuple(p for p in points if p.stage == last)


def stage_evidence(events: Iterable[Event], order: list[str]) -> tuple[StageEvidence, ...]:
    """Gather the blocks of each stage and topic; stages come in ``order``."""
    specs: dict[tuple[str, str], StageSpec] = {}
    blocks: dict[tuple[str, str], list[CandidateBlock]] = {}
    traces: dict[tuple[str, str], list[TraceBlock]] = {}
    for event in events:
        if isinstance(event, StageSpec):
            specs.setdefault((event.stage, event.topic), event)
        elif isinstance(event, CandidateBlock):
            blocks.setdefault((event.spec.stage, event.spec.topic), []).append(event)
        elif isinstance(event, TraceBlock):
            traces.setdefault((event.spec.stage, event.spec.topic), []).append(event)
    keys = sorted(specs, key=lambda key: order.index(key[0]))
    return tuple(_gathered(specs[k], blocks.get(k, []), traces.get(k, [])) for k in keys)


def _gathered(
    spec: StageSpec, blocks: list[CandidateBlock], traces: list[TraceBlock]
) -> StageEvidence:
    gates, n_channels = len(spec.gates), len(spec.channels)
    none = Candidates.empty(len(spec.columns))
    parts = [Candidates(b.time_ns, b.channel, b.value) for b in blocks]
    margins = np.empty((0, gates), np.float32)
    frames = np.empty((0, n_channels, len(spec.trace)), np.float32)
    return StageEvidence(
        spec,
        Candidates.concatenate([none, *parts]),
        np.concatenate([margins, *(b.gate_value for b in blocks)]),
        np.concatenate([margins, *(b.margin for b in blocks)]),
        np.concatenate([np.empty(0, np.bool_), *(b.accepted for b in blocks)]),
        Frames(
            np.concatenate([np.empty(0, np.int64), *(t.time_ns for t in traces)]),
            np.concatenate([frames, *(t.value for t in traces)]),
        ),
    )
