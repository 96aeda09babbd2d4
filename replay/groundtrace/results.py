"""Results: a sidecar MCAP with everything a replay decided, and the way back from it."""

from __future__ import annotations

import hashlib
import platform
import tomllib
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

import msgspec

from groundtrace_codecs.mcap.remote import RemoteBytes, as_url, is_url
from groundtrace_codecs.signals import SignalBlock

from .errors import RecordingError
from .parameters import given_waypoints
from .version import installed_version
from .warned import warnings_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.writer import RecordingWriter

    from .sinks import Session
    from .warned import Warned

RUN = "groundtrace.run"
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


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide a result."""
    found = {name: version(name) for name in PACKAGES if name != "groundtrace"}
    return {"python": platform.python_version(), "groundtrace": installed_version()} | found


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits; of a URL's, all are fetched."""
    if is_url(path):
        return RemoteBytes(as_url(path), hashed=True).sha256()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
CHUNK_BYTES = 256 << 10


class ResultsSink:
    """Writes events, labels and geometry to a results MCAP; signals stay in the recording."""

    def __init__(self, path: Path, provenance: Provenance, *, force: bool = False) -> None:
        self.path = path
        self.provenance = provenance
        self.force = force
        self._writer: RecordingWriter | None = None

    def open(self, session: Session) -> None:
        """Begin the file."""
        from groundtrace_codecs.writer import RecordingWriter

        self._writer = RecordingWriter(self.path, force=self.force, chunk_bytes=CHUNK_BYTES)
        self._writer.__enter__()
        if session.geometry is not None:
            self._writer.set_geometry(session.geometry)
        self._writer.add_labels(session.labels)
        if session.annotations:
            self._writer.add_annotations(session.annotations)
        provenance = msgspec.json.encode(self.provenance).decode()
        self._writer.add_metadata(RUN, {"json": provenance})

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
        """Finish the file and give it its name."""
        if self._writer is not None:
            self._writer.__exit__(None, None, None)
            self._writer = None


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
    from groundtrace_codecs.event_codec import events_of
    from groundtrace_codecs.recording import Recording

    if not path.is_file():
        raise RecordingError(f"{path.name}: expected a results file, found no such file")
    with Recording.open(path) as recording:
        provenance = provenance_in(recording, path.name)
        labels = replayed_labels(recording.labels, provenance.from_ns, provenance.to_ns)
        if evidence:
            from .explain.evidence import KINDS, joined

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


def provenance_in(recording: Recording, name: str) -> Provenance:
    """Return where the results in an open file come from; ``name`` names it in errors.

    Raises
    ------
    RecordingError
        Where the file is not a groundtrace result.
    """
    run = recording.metadata.get(RUN)
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
