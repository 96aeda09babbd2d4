"""``groundtrace export``."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from groundtrace_codecs.event_codec import events_of
from groundtrace_codecs.recording import Recording

from ..errors import RecordingError
from ..exports import Material, Origin, choose, export, exporters
from ..exports.kinds import stage_of
from ..exports.run import chosen_kinds, is_folder
from ..results import RUN, read_results
from .output import existing, print_json, say, writable
from .sharing import recording_of
from .truth import annotations_to_show, truth_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..explain.evidence import Evidence
    from ..results import Results

FLAG = Parameter(negative="")


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
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    kind: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    stage: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    recording: Path | None = None,
    origin: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
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
    json
        Print one JSON document.
    """
    known, troubles = exporters()
    for trouble in troubles:
        say(f"warning: {trouble}")
    exporter = choose(known, out, format_)
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
    _report(
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
        from ..explain import evidence_of
        from ..explain.unfiltered import beside, with_recording

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


def _report(report: ExportReport, *, json: bool) -> None:
    """Say what was written, and what the format does not hold."""
    for reason in report.damage:
        say(f"warning: {report.source}: damage, not exported: {reason}")
    if json:
        print_json(report)
        return
    words = {"signals": "samples"}
    counts = ", ".join(f"{n} {words.get(kind, kind)}" for kind, n in report.counts.items())
    print(f"wrote {report.path}: {report.format}, {counts}")
    for remark in report.remarks:
        print(f"  {remark}")
