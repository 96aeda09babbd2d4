"""The run of an import: chooses the importer that reads given files, and writes the recording."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Protocol, cast

from ..errors import Error, FormatError, SchemaError, did_you_mean
from ..geometry import Geometry, geometry_warnings
from ..signals import NS_PER_S
from ..truth import EARLY_NS, names_of, read_truth, unmatched_names
from .map import load_map
from .seismic import is_station_xml
from .units import UnitWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from ..signals import SignalBlock, Stream
    from .base import Imported, Importer, ImportMap, Source


class Listener(Protocol):
    """Hears what is imported while it is written, and says at the end what is wrong with it."""

    def update(self, block: SignalBlock) -> None:
        """Take the next block of a stream; streams come merged in time, block by block."""

    def remarks(self) -> Sequence[str]:
        """Return one line for each thing that is wrong; asked for once, after the last block."""


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
        First and last sample [ns].
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
        """From the first to the last sample [s]."""
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
    listener: Callable[[Sequence[Stream]], Listener] | None = None,
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
    listener
        Makes, of the streams, who hears them; what it remarks is a warning.

    Raises
    ------
    CodecError
        Where anything is not as its format says; found before anything is written.
    """
    from ..writer import write_recording

    map_ = None if map_path is None else load_map(map_path)
    tables = [p for p in (truth, geometry, map_path) if p is not None]
    importer, files, left_out = _chosen(paths, tables, format_name, map_)
    if stationxml is not None:
        files = [*(f for f in files if f != stationxml), *_stations(importer, stationxml)]
    states = [_state(file) for file in files]
    imported = _with_early_truth(_with_tables(importer.read(files, map_), geometry, truth))
    streams = [stream for stream, _, _ in imported.sources]
    stream_listener = None if listener is None else listener(streams)
    counts = _Counts({}, 0, {}, len(streams), stream_listener, strict, imported.start_ns, progress)
    counts.refuse([*left_out, *imported.warnings])
    write_recording(
        out,
        [
            (s, f, _unchanged(counts.counted(blocks), files, states))
            for s, f, blocks in imported.sources
        ],
        geometry=imported.geometry,
        labels=imported.labels,
        metadata={
            "groundtrace.import": _provenance(importer, files, map_, imported),
            **imported.metadata,
        },
        attachments=imported.attachments,
        force=force,
    )
    return _report(out, importer, files, imported, counts, left_out)


def _state(file: Path) -> tuple[int, int]:
    """Return what changes where a file does: its size [bytes] and when it was written [ns]."""
    try:
        status = file.stat()
    except OSError as error:
        raise SchemaError(f"{file}: expected a file to read, found: {error.strerror}") from error
    return status.st_size, status.st_mtime_ns


def _unchanged(
    blocks: Iterable[SignalBlock], files: Sequence[Path], states: Sequence[tuple[int, int]]
) -> Iterator[SignalBlock]:
    """Give blocks; at their end raise a SchemaError where a file is not what was begun with.

    A format that is a row of lines or samples does not tell that it was cut short meanwhile.
    """
    yield from blocks
    for file, state in zip(files, states, strict=True):
        if _state(file) != state:
            raise SchemaError(
                f"{file}: expected a file that stays as it is while it is read, found it changed"
            )


def _chosen(
    paths: Sequence[Path], tables: Sequence[Path], format_name: str | None, map_: ImportMap | None
) -> tuple[Importer, list[Path], tuple[str, ...]]:
    """Return who reads the files, those it reads, and a warning for each that it does not."""
    others = {path.resolve() for path in tables}
    files = [f for f in files_of(paths) if f.resolve() not in others] or files_of(paths)
    if format_name is None and map_ is not None:
        importer = choose(files, map_.format, f"{map_.file}: format")
    else:
        importer = choose(files, format_name)
    return importer, *_readable(importer, files, len(paths) == 1 and paths[0].is_dir())


def _report(
    out: Path,
    importer: Importer,
    files: Sequence[Path],
    imported: Imported,
    counts: _Counts,
    left_out: Sequence[str],
) -> ImportReport:
    """Return what was written."""
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
    readable = [f for f in files if importer.sniff(f) > 0] or files
    left_out = (f"{f.name}: left out: not known to {importer.name}" for f in files)
    return readable, tuple(w for w, f in zip(left_out, files, strict=True) if f not in readable)


def _with_tables(imported: Imported, geometry: Path | None, truth: Path | None) -> Imported:
    """Return the import with the given geometry's sensors and the given truth's labels."""
    site = imported.geometry
    warnings = list(imported.warnings)
    if geometry is not None:
        given = Geometry.from_toml(geometry)
        warnings += _check_channels(given, imported.sources, geometry.name)
        source_site = site if site is not None and not given.sources else given
        site = replace(given, sources=source_site.sources)
    labels = imported.labels
    if truth is not None:
        added = read_truth(
            truth,
            start_ns=imported.start_ns,
            geometry=site,
            labels=labels,
            files=dict(imported.files),
        )
        names = names_of([stream for stream, _, _ in imported.sources], site)
        warnings += unmatched_names(added, names, truth.name)
        labels = tuple(sorted((*labels, *added), key=lambda label: label.time_ns))
    return replace(imported, geometry=site, labels=labels, warnings=tuple(warnings))


def _with_early_truth(imported: Imported) -> Imported:
    """Return the import with what is to be said of truth from before the first sample.

    Such truth is kept at its time; where that would be before the clock's zero, all is later.
    """
    early = [label for label in imported.labels if label.time_ns < imported.start_ns]
    if not early:
        return imported
    first_ns = min(label.time_ns for label in early)
    early_ns = imported.start_ns - first_ns
    if first_ns < 0 and early_ns > EARLY_NS:
        raise SchemaError(
            f"truth: expected no {early[0].kind} more than {EARLY_NS / NS_PER_S:g} s before the "
            f"first sample, found one {early_ns / NS_PER_S:.3f} s before"
        )
    text = (
        f"truth: {len(early)} of {len(imported.labels)} lie before the first sample, by up to "
        f"{early_ns / NS_PER_S:.3f} s: kept"
    )
    if early_ns > EARLY_NS:
        text += "; is it the truth of another recording?"
    by_ns = max(0, -first_ns)
    if by_ns:
        text += f", and all times are {by_ns / NS_PER_S:.3f} s later"
    return replace(
        imported,
        sources=tuple((s, form, _later(blocks, by_ns)) for s, form, blocks in imported.sources),
        start_ns=imported.start_ns + by_ns,
        labels=tuple(label.later(by_ns) for label in imported.labels),
        files=tuple((name, start_ns + by_ns) for name, start_ns in imported.files),
        warnings=(*imported.warnings, text),
    )


def _later(blocks: Iterable[SignalBlock], by_ns: int) -> Iterator[SignalBlock]:
    for block in blocks:
        times = None if block.times_ns is None else block.times_ns + by_ns
        yield replace(block, anchor_ns=block.anchor_ns + by_ns, times_ns=times)


def _check_channels(geometry: Geometry, sources: Sequence[Source], name: str) -> list[str]:
    """Refuse a sensor that feeds a channel the recording does not have; tell of the reverse."""
    channels = {c.name for stream, _, _ in sources for c in stream.channels}
    for sensor in geometry.sensors:
        if sensor.channel not in channels:
            raise SchemaError(
                f"{name}: sensor {sensor.name}: expected a channel of "
                f"{', '.join(sorted(channels))}, found {sensor.channel!r}"
            )
    return [f"{name}: {text}" for text in geometry_warnings(geometry, [s for s, _, _ in sources])]


def _provenance(
    importer: Importer, files: Sequence[Path], map_: ImportMap | None, imported: Imported
) -> dict[str, str]:
    record = {"importer": importer.name, "files": "\n".join(f.name for f in files)}
    if len(imported.files) > 1:
        record["starts_ns"] = "\n".join(f"{name}: {start}" for name, start in imported.files)
    return record if map_ is None else {**record, "map": map_.file}


@dataclass(slots=True)
class _Counts:
    """What passed by on its way to the writer."""

    samples: dict[str, int]
    end_ns: int
    units: dict[str, UnitWatch]
    open: int
    listener: Listener | None
    strict: bool = False
    start_ns: int = 0
    progress: Callable[[float], None] | None = None
    listener_remarks: Sequence[str] = ()

    def refuse(self, warnings: Sequence[str]) -> None:
        """Raise a SchemaError for the first warning, where none is allowed."""
        if self.strict and warnings:
            raise SchemaError(f"--strict: {warnings[0]}")

    def remarks(self) -> list[str]:
        units = [line for watch in self.units.values() for line in watch.remarks()]
        return [*units, *self.listener_remarks]

    def counted(self, blocks: Iterable[SignalBlock]) -> Iterator[SignalBlock]:
        for block in blocks:
            self.samples[block.topic] = self.samples.get(block.topic, 0) + len(block)
            self.end_ns = max(self.end_ns, block.last_ns)
            if self.progress is not None:
                self.progress((self.end_ns - self.start_ns) / NS_PER_S)
            self.units.setdefault(block.topic, UnitWatch(block.stream)).update(block)
            if self.listener is not None:
                self.listener.update(block)
            yield block
        self.open -= 1
        if not self.open and self.listener is not None:
            self.listener_remarks = self.listener.remarks()
        self.refuse(self.remarks())


#: Entry points that name importer classes.
GROUP = "groundtrace.importers"


def importers() -> dict[str, Importer]:
    """Return the installed importers by name; one that fails to load warns and is left out."""
    installed: dict[str, Importer] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            importer = cast("Importer", point.load()())
        except Exception as error:  # a foreign package may fail in any way
            warnings.warn(f"importer {point.name}: not loaded: {error}", stacklevel=2)
            continue
        installed[importer.name] = importer
    return installed


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the files meant: a folder stands for the files in it, in natural order.

    Raises
    ------
    FormatError
        Where a path does not exist, or there is no file.
    """
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = (p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
            files += sorted(inside, key=_natural)
        elif path.is_file():
            files.append(path)
        else:
            raise FormatError(f"{path.name}: expected a file or folder, found none")
    if not files:
        raise FormatError(f"{paths[0].name if paths else 'import'}: expected files, found none")
    return files


def choose(
    paths: Sequence[Path], format_name: str | None = None, where: str = "--format"
) -> Importer:
    """Return the importer for some files: the one named, or the surest.

    Parameters
    ----------
    paths
        Files of one recording.
    format_name
        Name of an importer, or None to look at the files.
    where
        Where the name stands, for the message.

    Raises
    ------
    FormatError
        Where no importer has the name, or none knows the files; names the formats known.
    """
    installed = importers()
    names = ", ".join(sorted(installed)) or "none installed"
    if format_name is not None:
        if format_name not in installed:
            raise FormatError(
                f"{where}: expected one of {names}, found {format_name!r}"
                f"{did_you_mean(format_name, installed)}"
            )
        return installed[format_name]
    scores = {name: max(i.sniff(p) for p in paths) for name, i in installed.items()}
    best = max(scores, key=lambda name: scores[name], default="")
    if not best or scores[best] <= 0:
        raise FormatError(
            f"{paths[0].name}: expected a format of {names}, found none of them "
            f"(name one with --format)"
        )
    return installed[best]


#: An importer that is so sure of a file needs no map for it, unless it always does.
CERTAIN = 0.8
#: Importers that need a map, and what they read.
MAPPED = {
    "csv": "a text table",
    "mat": "a MATLAB file",
    "hdf5": "an HDF5 file",
    "npz": "a NumPy archive",
}


def check_needs_map(table: Path) -> None:
    """Refuse to guess a map of a file that an importer reads without one, or of an archive.

    Raises
    ------
    FormatError
        Where it is one.
    """
    importer = choose([table])
    if importer.name == "csv":
        return
    if importer.name in MAPPED:
        raise FormatError(
            f"import --guess: expected a text table, found {MAPPED[importer.name]}: write its map "
            f"by hand, and give it with --map"
        )
    if importer.sniff(table) >= CERTAIN and _reads(importer, table):
        raise FormatError(
            f"import --guess: expected a table that needs a map, found one that the importer "
            f"{importer.name} reads by itself: groundtrace import {table} -o OUT.mcap"
        )


def _reads(importer: Importer, table: Path) -> bool:
    """Return whether an importer can read a file without a map."""
    try:
        importer.read([table], None)
    except Error:
        return False
    return True


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key that puts ``10.dat`` after ``9.dat``."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in parts]
