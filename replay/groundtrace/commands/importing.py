"""``groundtrace import``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import CycloptsError, Parameter

from groundtrace_codecs.importers import choose, import_recording

from ..appearing import write_text
from ..errors import RecordingError
from .output import existing, print_json, progress, say, writable

if TYPE_CHECKING:
    from collections.abc import Sequence

#: An importer that is so sure of a file needs no map for it.
CERTAIN = 0.8


def import_(
    *sources: Path,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    geometry: Path | None = None,
    truth: Path | None = None,
    map_: Annotated[Path | None, Parameter(name="--map")] = None,
    stationxml: Path | None = None,
    guess: Annotated[bool, Parameter(negative="")] = False,
    strict: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    quiet: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
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
    force
        Overwrite an existing file.
    quiet
        Show no progress bar.
    json
        Print one JSON document.
    """
    if not sources:
        raise RecordingError("import: expected at least one file, found none")
    if guess:
        if json:
            raise RecordingError("import: expected --guess or --json, found both")
        _guess(sources, out, force=force)
        return
    if out is None:
        say("import: expected --out, found none")
        raise CycloptsError
    # what computes is not imported before there is something to compute
    from ..health.imu import ImportedImu

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
        say(f"warning: {warning}")
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
    from groundtrace_codecs.importers.guess import guess_map
    from groundtrace_codecs.importers.guess_toml import remark_line

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
