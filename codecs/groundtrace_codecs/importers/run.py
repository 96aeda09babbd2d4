"""One import from files to a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..errors import FormatError, SchemaError
from ..geometry import Geometry
from ..signals import NS_PER_S
from ..truth import read_truth
from .maps import load_map
from .plausible import UnitWatch
from .registry import choose, files_of
from .station_xml import is_station_xml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from ..signals import SignalBlock
    from .api import Imported, Importer, Source
    from .maps import ImportMap


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What an import wrote.

    Attributes
    ----------
    path
        The recording.
    importer
        Name of the importer used.
    files
        Names of the files read.
    samples
        Samples (rows) of each topic.
    start_ns, end_ns
        First sample, and one period after the last [ns].
    sensors
        How many sensors the geometry places.
    labels
        How many labels of each kind.
    warnings
        One line each: what was lost, merged or assumed.
    remarks
        One line each: what is good to know, such as where places count from.
    """

    path: Path
    importer: str
    files: tuple[str, ...]
    samples: dict[str, int]
    start_ns: int
    end_ns: int
    sensors: int
    labels: dict[str, int]
    warnings: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Length of the recording [s]."""
        return (self.end_ns - self.start_ns) / 1e9


def import_recording(
    paths: Sequence[Path],
    out: Path,
    *,
    format_name: str | None = None,
    geometry: Path | None = None,
    truth: Path | None = None,
    map_path: Path | None = None,
    stationxml: Path | None = None,
    strict: bool = False,
    force: bool = False,
    progress: Callable[[float], None] | None = None,
) -> ImportReport:
    """Read files of another tool and write them as one recording.

    Parameters
    ----------
    paths
        Files of one recording, or folders of them.
    out
        The recording to write.
    format_name
        Name of an importer; by default the map's, else the surest.
    geometry
        Geometry TOML; its sensors replace those the files name.
    truth
        Truth to add: .csv, .sgt or .mcap.
    map_path
        Map TOML, for tables and archives.
    stationxml
        Station metadata for seismic files; without it the only one beside them is taken.
    strict
        Refuse what would be a warning.
    force
        Overwrite ``out``.
    progress
        Told how much of the recording is written [s].

    Raises
    ------
    CodecError
        Where anything is not as its format says; found before anything is written.
    """
    from ..writer import write_recording

    map_ = None if map_path is None else load_map(map_path)
    files = files_of(paths)
    importer = choose(files, format_name or (map_.format if map_ else None))
    files, left_out = _readable(importer, files, len(paths) == 1 and paths[0].is_dir())
    if stationxml is not None:
        files = [*(f for f in files if f != stationxml), *_stations(importer, stationxml)]
    imported = _with_tables(importer.read(files, map_), geometry, truth)
    counts = _Counts({}, 0, {}, strict, imported.start_ns, progress)
    counts.refuse([*left_out, *imported.warnings])
    write_recording(
        out,
        [(s, f, counts.counted(blocks)) for s, f, blocks in imported.sources],
        geometry=imported.geometry,
        labels=imported.labels,
        metadata={"groundtrace.import": _provenance(importer, files, map_), **imported.metadata},
        attachments=imported.attachments,
        force=force,
    )
    kinds = [label.kind for label in imported.labels]
    return ImportReport(
        path=out,
        importer=importer.name,
        files=tuple(f.name for f in files),
        samples=counts.samples,
        start_ns=imported.start_ns,
        end_ns=counts.end_ns,
        sensors=len(imported.geometry.sensors) if imported.geometry else 0,
        labels={k: kinds.count(k) for k in sorted(set(kinds))},
        warnings=(*left_out, *imported.warnings, *counts.remarks()),
        remarks=imported.remarks,
    )


def _stations(importer: Importer, path: Path) -> list[Path]:
    """Return the StationXML as a file to read, if it is one and the importer knows what it is."""
    (file,) = files_of([path])
    if not is_station_xml(file):
        raise FormatError(f"{path.name}: expected StationXML, found another file")
    if importer.sniff(file) <= 0:
        raise SchemaError(
            f"--stationxml: expected files of seismic traces to go with it, found {importer.name}"
        )
    return [file]


def _readable(
    importer: Importer, files: list[Path], folder: bool
) -> tuple[list[Path], tuple[str, ...]]:
    """Return the files of a folder the importer knows, and a warning for each other."""
    if not folder:
        return files, ()
    known = [f for f in files if importer.sniff(f) > 0] or files
    left_out = (f"{f.name}: left out: not known to {importer.name}" for f in files)
    return known, tuple(w for w, f in zip(left_out, files, strict=True) if f not in known)


def _with_tables(imported: Imported, geometry: Path | None, truth: Path | None) -> Imported:
    """Return the import with the given geometry's sensors and the given truth's labels."""
    site = imported.geometry
    if geometry is not None:
        given = Geometry.from_toml(geometry)
        _check_channels(given, imported.sources, geometry.name)
        kept = site if site is not None and not given.sources else given
        site = replace(given, sources=kept.sources)
    labels = imported.labels
    if truth is not None:
        added = read_truth(truth, start_ns=imported.start_ns, geometry=site, labels=labels)
        labels = tuple(sorted((*labels, *added), key=lambda label: label.time_ns))
    return replace(imported, geometry=site, labels=labels)


def _check_channels(geometry: Geometry, sources: Sequence[Source], name: str) -> None:
    """Refuse a sensor that feeds a channel the recording does not have."""
    channels = {c.name for stream, _, _ in sources for c in stream.channels}
    for sensor in geometry.sensors:
        if sensor.channel not in channels:
            raise SchemaError(
                f"{name}: sensor {sensor.name}: expected a channel of "
                f"{', '.join(sorted(channels))}, found {sensor.channel!r}"
            )


def _provenance(
    importer: Importer, files: Sequence[Path], map_: ImportMap | None
) -> dict[str, str]:
    record = {"importer": importer.name, "files": "\n".join(f.name for f in files)}
    return record if map_ is None else {**record, "map": map_.file}


@dataclass(slots=True)
class _Counts:
    """What passed by on its way to the writer."""

    samples: dict[str, int]
    end_ns: int
    units: dict[str, UnitWatch]
    strict: bool = False
    start_ns: int = 0
    progress: Callable[[float], None] | None = None

    def refuse(self, warnings: Sequence[str]) -> None:
        """Raise a SchemaError for the first warning, where none is allowed."""
        if self.strict and warnings:
            raise SchemaError(f"--strict: {warnings[0]}")

    def remarks(self) -> list[str]:
        return [line for watch in self.units.values() for line in watch.remarks()]

    def counted(self, blocks: Iterable[SignalBlock]) -> Iterator[SignalBlock]:
        for block in blocks:
            self.samples[block.topic] = self.samples.get(block.topic, 0) + len(block)
            self.end_ns = max(self.end_ns, block.end_ns)
            if self.progress is not None:
                self.progress((self.end_ns - self.start_ns) / NS_PER_S)
            self.units.setdefault(block.topic, UnitWatch(block.stream)).hear(block)
            yield block
        self.refuse(self.remarks())
