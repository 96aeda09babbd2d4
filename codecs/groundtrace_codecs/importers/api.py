"""What an importer is and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from ..geometry import Geometry
    from ..labels import Label
    from ..signals import SignalBlock, Stream
    from .maps import ImportMap

    Source = tuple[Stream, str, Iterable[SignalBlock]]


@dataclass(frozen=True, slots=True)
class Imported:
    """What one import read.

    Attributes
    ----------
    sources
        Per stream: what it is, the sample format to store (``i16le``, ``i32le``, ``f32le``,
        ``f64le``), and its blocks in time order, each a contiguous run.
    start_ns
        Time of the first sample over all streams [ns]; truth tables count from it.
    geometry
        Site, where the files describe one.
    labels
        Reference events, where the files hold some.
    metadata
        Records to keep with the recording, by name.
    warnings
        One line each: what was lost, merged or assumed.
    remarks
        One line each: what is good to know and no reason to doubt, such as where places count from.
    attachments
        Name, media type and content of files to keep with the recording.
    files
        Name and time of the first sample [ns] of each of several files that hold an event each;
        empty where the files are not apart in time.
    """

    sources: tuple[Source, ...]
    start_ns: int
    geometry: Geometry | None = None
    labels: tuple[Label, ...] = ()
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    attachments: tuple[tuple[str, str, bytes], ...] = ()
    files: tuple[tuple[str, int], ...] = ()


class Importer(Protocol):
    """Reads files of other tools.

    Attributes
    ----------
    name
        Given to ``import --format``.
    description
        One line for ``plugins``.
    """

    name: str
    description: str

    def sniff(self, path: Path) -> float:
        """Return how surely this importer reads ``path``: 0 not at all, 1 certain."""
        ...

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read files of one recording.

        Parameters
        ----------
        paths
            In the order given; several files become one recording.
        map_
            What the columns mean, for formats that do not say.

        Raises
        ------
        FormatError
            Where the bytes are not the format's.
        SchemaError
            Where map and file do not match, or the files do not make one recording.
        """
        ...
