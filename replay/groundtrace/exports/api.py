"""What an exporter is, and what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ..errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.recording import Recording

    from ..explain.evidence import Evidence


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the site's zero lies on earth.

    Attributes
    ----------
    latitude_rad, longitude_rad
        WGS 84.
    azimuth_rad
        Direction of the site's y axis, clockwise from north.
    """

    latitude_rad: float
    longitude_rad: float
    azimuth_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Material:
    """What may be exported of a result, or of a recording.

    Attributes
    ----------
    name
        File name of the results, or of the recording.
    start_ns
        First sample of the recording [ns]: times count from it.
    events
        In the order of the file.
    labels, annotations
        The recording's own truth, and what people marked.
    geometry
        Of the site, or None.
    from_ns
        Where the replay began [ns], or None.
    origin
        Where the site lies, as far as somebody said so.
    recording
        Opens the recording itself, or returns None where it is not there.
    evidence
        Reads what the decisions rest on, with truth; None for a recording.
    """

    name: str
    start_ns: int
    events: tuple[Event, ...] = ()
    labels: tuple[Label, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    geometry: Geometry | None = None
    from_ns: int | None = None
    origin: Origin | None = None
    recording: Callable[[], Recording | None] = lambda: None
    evidence: Callable[[], Evidence] | None = None

    def signals(self) -> Recording:
        """Return the recording, open.

        Raises
        ------
        RecordingError
            Where it is not there.
        """
        found = self.recording()
        if found is None:
            raise RecordingError(
                f"{self.name}: expected its recording beside it, or --recording FILE, found none"
            )
        return found


@dataclass(frozen=True, slots=True)
class Written:
    """What an exporter wrote.

    Attributes
    ----------
    counts
        How many of each kind.
    remarks
        One line each: what the format cannot hold, or was left out.
    """

    counts: dict[str, int]
    remarks: tuple[str, ...] = ()


class Exporter(Protocol):
    """Writes one format; registered in the entry-point group ``groundtrace.exporters``.

    Attributes
    ----------
    name
        Given to ``export --format``.
    description
        One line for people.
    suffixes
        Ends of file names that mean this format, lower case, with the dot.
    kinds
        What it can write, by the names of :mod:`groundtrace.exports.kinds`.
    one_kind
        True where a file holds a single kind; a folder then takes a file of each.
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    kinds: tuple[str, ...]
    one_kind: bool

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write some kinds.

        Parameters
        ----------
        material
            What there is.
        kinds
            Some of its kinds, one where a file holds no more.
        path
            A new file; or, with ``one_kind``, an empty folder.

        Raises
        ------
        RecordingError
            Where the material lacks what the format needs.
        CodecError
            Where a package that the format needs is not installed.
        """
        ...
