"""``groundtrace import``, ``export``, ``cut``, ``filter`` and ``convert``."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import CycloptsError, Parameter, validators

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.copies import convert as convert_file
from groundtrace_codecs.copies import cut, filter_topics
from groundtrace_codecs.importers.run import choose, import_recording
from groundtrace_codecs.mcap.writer import CHUNK_BYTES
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import events_of
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import existing, writable
from ..errors import RecordingError
from ..export.base import (
    Material,
    Origin,
    chosen_kinds,
    export,
    exporter_of,
    exporters,
    is_folder,
    stage_of,
)
from ..pipeline.results import RUN, file_sha256, read_results, write_text
from .console import annotations_to_show, print_json, print_stderr, print_table, progress, truth_of
from .options import FLAG, OUT, Force, Json, Quiet
from .share import recording_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.copies import Copied

    from ..pipeline.results import Evidence, Results

#: An importer that is so sure of a file needs no map for it.
CERTAIN = 0.8


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
    """Turn files of another tool into a recording.

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
        raise RecordingError("import: expected at least one file, found none")
    if guess:
        if json:
            raise RecordingError("import: expected --guess or --json, found both")
        _guess(sources, out, force=force)
        return
    if out is None:
        print_stderr("import: expected --out, found none")
        raise CycloptsError
    # what computes is not imported before there is something to compute
    from ..inertial.worn_sensor_faults import ImportedImu

    with progress(None, "importing", quiet=quiet) as show:
        report = import_recording(
            sources,
            writable(out, force=force, sources=_read(sources, stationxml, map_, geometry, truth)),
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
        return
    print(f"wrote {report.path}: {len(report.files)} files by {report.importer}")
    for topic, samples in report.samples.items():
        print(f"  {topic}: {samples} samples")
    print(f"  {report.duration_s:.3f} s, {report.sensors} sensors placed")
    for remark in report.remarks:
        print(f"  {remark}")
    if report.labels:
        print("  truth: " + ", ".join(f"{n} {kind}" for kind, n in report.labels.items()))


def _read(sources: Sequence[Path], *others: Path | None) -> list[Path]:
    """Return all that is read: none of it may be written over."""
    return [*sources, *(path for path in others if path is not None)]


def _guess(sources: tuple[Path, ...], out: Path | None, *, force: bool) -> None:
    """Write the guessed map of a table and say what was guessed."""
    from groundtrace_codecs.importers.guess import guess_map, remark_line

    if len(sources) != 1:
        raise RecordingError(f"import --guess: expected one table, found {len(sources)} files")
    (table,) = sources
    existing(table)
    known = choose([table])
    if known.sniff(table) >= CERTAIN and known.name != "csv":
        raise RecordingError(
            f"import --guess: expected a table that needs a map, found one that the importer "
            f"{known.name} reads by itself: groundtrace import {table} -o OUT.mcap"
        )
    written = out or table.with_name(f"{table.name}.map.toml")
    writable(written, force=force, sources=sources)
    found = guess_map(table)
    write_text(written, found.toml)
    for remark in found.remarks:
        print(remark_line(remark))
    print(
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


@dataclass(frozen=True, slots=True)
class CopyReport:
    """What a copy holds, as JSON."""

    path: str
    source: str
    bytes: int
    source_bytes: int
    messages: dict[str, int]
    left: dict[str, int]
    damage: list[str]
    lost: int | None


def cut_(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    from_: Annotated[float | None, Parameter(name="--from"), SECONDS] = None,
    to: Annotated[float | None, SECONDS] = None,
    force: Force = False,
    json: Json = False,
) -> None:
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
    writable(out, force=force, sources=[existing(recording)])
    with Recording.open(recording) as opened:
        if RUN in opened.metadata:
            raise RecordingError(
                f"{recording.name}: expected a recording, found results; cut their recording and "
                f"replay it"
            )
        start_ns, stop_ns = _span(opened, from_ or 0.0, to)
        origin = {
            "recording": recording.name,
            "sha256": file_sha256(recording),
            "from_ns": str(start_ns),
            "to_ns": str(stop_ns),
        }
        found = cut(opened, out, start_ns, stop_ns, origin=origin, force=force)
    _report(recording, out, found, json=json)


def _span(recording: Recording, from_s: float, to_s: float | None) -> tuple[int, int]:
    """Return the half-open span that is asked for [ns]."""
    duration_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    if from_s > duration_s or (to_s is not None and to_s <= from_s):
        found = f"{from_s:g} s to " + ("the end" if to_s is None else f"{to_s:g} s")
        raise RecordingError(
            f"{recording.name}: --from, --to: expected a span of 0 to {duration_s:.3f} s, "
            f"found {found}"
        )
    start_ns = recording.start_ns + round(from_s * NS_PER_S)
    stop_ns = recording.end_ns + 1 if to_s is None else recording.start_ns + round(to_s * NS_PER_S)
    return start_ns, stop_ns


def filter_(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    topic: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    without: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    force: Force = False,
    json: Json = False,
) -> None:
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
        raise RecordingError("filter: expected --topic or --without, found neither")
    writable(out, force=force, sources=[existing(recording)])
    found = filter_topics(recording, out, topic or (), without or (), force=force)
    _report(recording, out, found, json=json)


def convert(
    recording: Path,
    *,
    out: Annotated[Path, OUT],
    compression: Compression = "zstd",
    chunk_kb: Annotated[int, SIZE] = CHUNK_BYTES >> 10,
    block_ms: Annotated[float | None, SIZE] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
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
    writable(out, force=force, sources=[existing(recording)])
    with progress(None, "copying", quiet=quiet) as show:
        found = convert_file(
            recording,
            out,
            compression=compression,
            chunk_bytes=chunk_kb << 10,
            block_ns=None if block_ms is None else round(block_ms * 1e6),
            force=force,
            progress=show,
        )
    _report(recording, out, found, json=json)


def _report(source: Path, out: Path, found: Copied, *, json: bool) -> None:
    """Say what is in the copy, and what of the source is not."""
    lost = [damage.messages for damage in found.damage]
    report = CopyReport(
        str(out),
        source.name,
        out.stat().st_size,
        source.stat().st_size,
        found.messages,
        found.left,
        [*(damage.reason for damage in found.damage), *found.faults],
        None if None in lost else sum(filter(None, lost)),
    )
    for damage in found.damage:
        count = "some" if damage.messages is None else damage.messages
        print_stderr(f"warning: {source.name}: damage, {count} messages lost: {damage.reason}")
    for fault in found.faults:
        print_stderr(f"warning: {fault}; it is not in the copy")
    if sidecar_path(source).exists():
        print_stderr(
            f"annotations beside {source.name} are not in the copy: groundtrace annotate "
            f"{source.name} --commit -o NEW.mcap makes a recording with them inside"
        )
    if json:
        print_json(report)
        return
    print(f"wrote {out}: {report.bytes / 1e6:.2f} MB out of {report.source_bytes / 1e6:.2f} MB")
    topics = dict.fromkeys((*found.messages, *found.left))
    rows = [(t, str(found.messages.get(t, 0)), str(found.left.get(t, 0))) for t in topics]
    print_table(("topic", "messages", "left out"), rows)


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What an export wrote, as JSON."""

    path: str
    source: str
    format: str
    counts: dict[str, int]
    remarks: list[str]
    damage: list[str]


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
) -> None:
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
    known, troubles = exporters()
    for trouble in troubles:
        print_stderr(f"warning: {trouble}")
    exporter = exporter_of(known, out, format_)
    folder = is_folder(exporter, out)
    existing(source, "results or a recording")
    _check_target(out, [source, *([recording] if recording else [])], folder=folder, force=force)
    with ExitStack() as stack:
        opened = stack.enter_context(Recording.open(source))
        material = _material(stack, opened, source, recording, _origin(origin))
        material = _of_stages(material, stage or ())
        kinds = chosen_kinds(exporter, material, kind or (), folder=folder)
        written = export(exporter, material, kinds, out, folder=folder)
        damage = [d.reason for d in opened.damage]
    _export_report(
        ExportReport(
            str(out), source.name, exporter.name, written.counts, list(written.remarks), damage
        ),
        json=json,
    )


def _check_target(out: Path, sources: Sequence[Path], *, folder: bool, force: bool) -> None:
    """Refuse to overwrite what is read, or what was not asked for."""
    if not folder:
        writable(out, force=force, sources=sources)
        return
    if not out.resolve().parent.is_dir():
        raise RecordingError(f"{out}: expected an existing folder to write it in, found none")
    if out.exists() and not out.is_dir():
        raise RecordingError(f"{out}: expected a folder, found a file")
    if out.exists() and not force:
        raise RecordingError(f"{out}: expected a new folder, found an existing one; see --force")


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
        raise RecordingError(
            f"--origin: expected LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,AZIMUTH [deg], "
            f"found {text!r}"
        )
    return Origin(*map(math.radians, numbers))


def _material(
    stack: ExitStack, opened: Recording, source: Path, given: Path | None, origin: Origin | None
) -> Material:
    """Return what there is to be exported; what needs more reading is read when asked for."""
    if RUN in opened.metadata:
        return _of_results(stack, read_results(source), source, given, origin)
    if given is not None:
        raise RecordingError(f"--recording: expected results to go with it, found {source.name}")
    return Material(
        source.name,
        opened.start_ns,
        tuple(events_of(opened.file)),
        opened.labels,
        annotations_to_show(opened, source),
        opened.geometry,
        origin=origin,
        recording=lambda: opened,
    )


def _of_results(
    stack: ExitStack, result: Results, source: Path, given: Path | None, origin: Origin | None
) -> Material:
    @cache
    def recording() -> Recording | None:
        path = recording_of(source, given)
        return None if path is None else stack.enter_context(Recording.open(path))

    @cache
    def evidence() -> Evidence:
        from ..explain.unfiltered import beside, with_recording
        from ..pipeline.results import evidence_of

        name, sha256 = result.provenance.recording, result.provenance.sha256
        places = [beside(source, name), *([] if given is None else [given])]
        return with_recording(evidence_of(result, truth_of(result, source, None)), sha256, places)

    return Material(
        result.name,
        result.provenance.start_ns,
        result.events,
        result.labels,
        result.annotations,
        result.geometry,
        result.provenance.from_ns,
        origin,
        recording,
        evidence,
    )


def _of_stages(material: Material, stages: Sequence[str]) -> Material:
    """Return what there is with the events of some stages only."""
    if not stages:
        return material
    named = [(stage_of(event), event) for event in material.events]
    known = dict.fromkeys(name for name, _ in named if name)
    for stage in stages:
        if stage not in known:
            found = ", ".join(known) or "none"
            raise RecordingError(
                f"{material.name}: --stage: expected one of {found}, found {stage!r}"
            )
    return replace(material, events=tuple(e for name, e in named if name in stages))


def _export_report(report: ExportReport, *, json: bool) -> None:
    """Say what was written, and what the format does not hold."""
    for reason in report.damage:
        print_stderr(f"warning: {report.source}: damage, not exported: {reason}")
    if json:
        print_json(report)
        return
    words = {"signals": "samples"}
    counts = ", ".join(f"{n} {words.get(kind, kind)}" for kind, n in report.counts.items())
    print(f"wrote {report.path}: {report.format}, {counts}")
    for remark in report.remarks:
        print(f"  {remark}")
