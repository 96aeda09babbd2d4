"""``groundtrace import``, ``cut``, ``filter``, ``convert`` and ``export``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.copies import convert as convert_file
from groundtrace_codecs.copies import filter_topics
from groundtrace_codecs.importers.run import check_needs_map, import_recording
from groundtrace_codecs.mcap.writer import CHUNK_BYTES

from ..api.exporting import cut_span, export_file
from ..api.files import existing_file, named_recording, writable
from ..errors import UsageError
from ..export.base import Origin
from ..pipeline.results import write_text
from .console import (
    counted,
    damage_text,
    print_json,
    print_line,
    print_stderr,
    print_table,
    progress,
    quoted,
)
from .exit_codes import ExitCode
from .options import FLAG, OUT, RECORDING, Force, Json, Quiet

if TYPE_CHECKING:
    from groundtrace_codecs.copies import Copied
    from groundtrace_codecs.importers.run import ImportReport


def import_(
    *sources: Path,
    out: Annotated[Path | None, OUT] = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    geometry: Path | None = None,
    truth: Path | None = None,
    map_: Annotated[Path | None, Parameter(name="--map")] = None,
    stationxml: Path | None = None,
    guess: Annotated[bool, FLAG] = False,
    strict: Annotated[bool, FLAG] = False,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Import files from other tools.

    Parameters
    ----------
    sources
        Files of one recording, or folders of them.
    out
        The recording to write; with --guess the map, FILE.map.toml without it.
    format_
        Name of the importer (groundtrace plugins lists them); chosen by content without it.
    geometry
        TOML with sensors, outline and medium.
    truth
        What is known to have happened: CSV, .sgt hand picks, or another MCAP.
    map_
        TOML that says what the columns are; a path, or the name of a shipped map.
    stationxml
        Sensitivities and places of the channels of seismic files; without it the only StationXML
        beside them is taken.
    guess
        Import nothing: guess the map of one text table and write it, to be checked and given
        with --map.
    strict
        Stop at the first thing that would be a warning.
    """
    if not sources:
        raise UsageError("import: expected at least one file, found none")
    if guess:
        if json:
            raise UsageError("import: expected --guess or --json, found both")
        _guess(sources, out, force=force)
        return
    if out is None:
        raise UsageError("import: expected --out, found none")
    read = [path for path in (stationxml, map_, geometry, truth) if path is not None]
    # what computes is not imported before there is something to compute
    from ..inertial.worn_sensor_faults import ImportedImu

    with progress(None, "importing", quiet=quiet) as show:
        report = import_recording(
            sources,
            writable(out, force=force, sources=[*sources, *read]),
            format_name=format_,
            geometry=geometry,
            truth=truth,
            map_path=_map(map_),
            stationxml=stationxml,
            strict=strict,
            force=force,
            progress=show,
            listener=ImportedImu,
        )
    for warning in report.warnings:
        print_stderr(f"warning: {warning}")
    if json:
        print_json(report)
    else:
        _print_import(report)


#: So many files of an import are named.
MOST_NAMES = 3


def _print_import(report: ImportReport) -> None:
    few = len(report.files) <= MOST_NAMES
    files = ", ".join(report.files) if few else f"{len(report.files)} files"
    streams = counted(len(report.samples), "stream")
    extent = f"{streams}, {report.duration_s:.3f} s"
    print_line(f"imported {files} ({report.importer}) into {report.path}: {extent}")
    for topic, samples in report.samples.items():
        print_line(f"  {topic}: {counted(samples, 'sample')}")
    if report.sensors:
        print_line(f"  {counted(report.sensors, 'sensor')} placed")
    for remark in report.remarks:
        print_line(f"  {remark}")
    if report.labels:
        print_line("  truth: " + ", ".join(f"{n} {kind}" for kind, n in report.labels.items()))
    print_line(f"next: groundtrace info {quoted(report.path)}")


def _guess(sources: tuple[Path, ...], out: Path | None, *, force: bool) -> None:
    """Write the guessed map of a table and say what was guessed."""
    from groundtrace_codecs.importers.guess import guess_map, remark_line

    if len(sources) != 1:
        raise UsageError(f"import --guess: expected one table, found {len(sources)} files")
    table = existing_file(sources[0], "a table")
    check_needs_map(table)
    written = out or table.with_name(f"{table.name}.map.toml")
    writable(written, force=force, sources=sources)
    guessed_map = guess_map(table)
    write_text(written, guessed_map.toml)
    for remark in guessed_map.remarks:
        print_line(remark_line(remark))
    print_line(
        f"wrote {written}: check it, then: groundtrace import {table} --map {written} -o OUT.mcap"
    )


def _map(path: Path | None) -> Path | None:
    """Return a map's path; a bare name may be that of a shipped one."""
    if path is None or path.exists() or path.parent != Path():
        return path
    from groundtrace_recordings import maps

    return maps().get(f"{path.stem}.toml", path)


Compression = Literal["zstd", "lz4", "none"]
SIZE = Parameter(validator=validators.Number(gt=0, lt=1e6))
SECONDS = Parameter(validator=validators.Number(gte=0, lt=1e9))


def cut_(
    recording: Annotated[Path, RECORDING],
    *,
    out: Annotated[Path, OUT],
    from_: Annotated[float | None, Parameter(name="--from"), SECONDS] = None,
    to: Annotated[float | None, SECONDS] = None,
    force: Force = False,
    json: Json = False,
) -> ExitCode:
    """Copy a span of a recording, cut to the sample; labels, geometry, attachments stay.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    from_
        Where it begins [s since the first sample].
    to
        Where it ends [s since the first sample]; a sample at this time is not in it.
    """
    recording = named_recording(recording)
    writable(out, force=force, sources=[recording])
    copied = cut_span(recording, out, from_ or 0.0, to, force=force)
    return _report(recording, out, copied, json=json)


def filter_(
    recording: Annotated[Path, RECORDING],
    *,
    out: Annotated[Path, OUT],
    topic: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    without: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    force: Force = False,
    json: Json = False,
) -> ExitCode:
    """Copy some topics of a recording, message by message as they are.

    Truth is the topic /truth, annotations are /annotations. Attachments and metadata stay.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    topic
        Topics to copy; * stands for anything. Without it, all.
    without
        Topics to leave out of these.
    """
    if not (topic or without):
        raise UsageError("filter: expected --topic or --without, found neither")
    recording = named_recording(recording)
    writable(out, force=force, sources=[recording])
    copied = filter_topics(recording, out, topic or (), without or (), force=force)
    return _report(recording, out, copied, json=json)


def convert(
    recording: Annotated[Path, RECORDING],
    *,
    out: Annotated[Path, OUT],
    compression: Compression = "zstd",
    chunk_kb: Annotated[int, SIZE] = CHUNK_BYTES >> 10,
    block_ms: Annotated[float | None, SIZE] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> ExitCode:
    """Copy a recording with another compression, chunks or blocks; no sample changes.

    Parameters
    ----------
    recording
        MCAP file, which stays as it is.
    out
        The copy.
    compression
        Of the chunks.
    chunk_kb
        Length at which a chunk is ended, before compression [KiB].
    block_ms
        Length of the messages of fast signals [ms]; without it every message stays as it is.
    """
    recording = named_recording(recording)
    writable(out, force=force, sources=[recording])
    with progress(None, "copying", quiet=quiet) as show:
        copied = convert_file(
            recording,
            out,
            compression=compression,
            chunk_bytes=chunk_kb << 10,
            block_ns=None if block_ms is None else round(block_ms * 1e6),
            force=force,
            progress=show,
        )
    return _report(recording, out, copied, json=json)


def _report(source: Path, out: Path, copied: Copied, *, json: bool) -> ExitCode:
    """Say what is in the copy, and what of the source is not; return how the command ends."""
    ended = ExitCode.of(losses=bool(copied.damage or copied.faults))
    for damage in copied.damage:
        print_stderr(f"warning: {source.name}: {damage_text(damage)}")
    for fault in copied.faults:
        print_stderr(f"warning: {fault}; it is not in the copy")
    if sidecar_path(source).exists():
        print_stderr(
            f"annotations beside {source.name} are not in the copy: groundtrace annotate "
            f"{source.name} --commit -o NEW.mcap makes a recording with them inside"
        )
    size, source_size = out.stat().st_size, source.stat().st_size
    if json:
        lost = [damage.messages for damage in copied.damage]
        print_json(
            {
                "path": str(out),
                "source": source.name,
                "bytes": size,
                "source_bytes": source_size,
                "messages": copied.messages,
                "left": copied.left,
                "damage": [*(damage.reason for damage in copied.damage), *copied.faults],
                "lost": None if None in lost else sum(filter(None, lost)),
            }
        )
        return ended
    print_line(f"wrote {out}: {size / 1e6:.2f} MB out of {source_size / 1e6:.2f} MB")
    topics = dict.fromkeys((*copied.messages, *copied.left))
    rows = [(t, str(copied.messages.get(t, 0)), str(copied.left.get(t, 0))) for t in topics]
    print_table(("topic", "messages", "left out"), rows)
    return ended


def export_(
    source: Path,
    *,
    out: Annotated[Path, OUT],
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    kind: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    stage: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    recording: Path | None = None,
    origin: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> ExitCode:
    """Write events of a result, or signals of a recording, for other tools.

    Parameters
    ----------
    source
        Results MCAP that groundtrace replay wrote, or a recording.
    out
        The file to write; a name without suffix is a folder that takes a table of each kind.
    format_
        csv, parquet, quakeml, geojson, gpx, audacity, miniseed or that of a plugin; by default as
        the file's name ends.
    kind
        steps, picks, fixes, tracks, bearings, headings, disturbances, disagreements, presence,
        passes, crossings, gaps, notes, truth, annotations, misses, candidates, signals; by default
        all that the format takes, but for signals.
    stage
        Only events of these stages of the pipeline.
    recording
        The recording of results, where it does not lie beside them.
    origin
        Where the site's zero lies: LATITUDE,LONGITUDE [deg], then where its y axis does not point
        north ,AZIMUTH [deg clockwise from north].
    force
        Overwrite what was exported there before.
    """
    report = export_file(
        source,
        out,
        format_,
        kind or (),
        stage or (),
        recording,
        _origin(origin),
        force=force,
        report=print_stderr,
    )
    for reason in report.damage:
        print_stderr(f"warning: {report.source}: damage, not exported: {reason}")
    ended = ExitCode.of(losses=bool(report.damage))
    if json:
        print_json(report)
        return ended
    words = {"signals": "samples"}
    counts = ", ".join(f"{n} {words.get(name, name)}" for name, n in report.counts.items())
    print_line(f"wrote {report.path}: {report.format}, {counts}")
    for remark in report.remarks:
        print_line(f"  {remark}")
    return ended


def _origin(text: str | None) -> Origin | None:
    """Read ``LATITUDE,LONGITUDE[,AZIMUTH]``."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    fits = len(numbers) in (2, 3) and all(map(math.isfinite, numbers))
    if not fits or abs(numbers[0]) > 89.9 or abs(numbers[1]) > 360:
        raise UsageError(
            f"--origin: expected LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,AZIMUTH [deg], "
            f"found {text!r}"
        )
    return Origin(*map(math.radians, numbers))
