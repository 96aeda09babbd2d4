"""An export as the command line runs it: what there is of results or a recording, written."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import events_of

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
from ..pipeline.results import RUN, read_results
from .files import existing, recording_of, unheard, writable
from .known_truth import annotations_to_show, truth_beside

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..pipeline.results import Evidence, Results
    from .files import Report


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What an export wrote, as JSON."""

    path: str
    source: str
    format: str
    counts: dict[str, int]
    remarks: list[str]
    damage: list[str]


def export_file(
    source: Path,
    out: Path,
    format_name: str | None = None,
    kinds: Sequence[str] = (),
    stages: Sequence[str] = (),
    recording: Path | None = None,
    origin: Origin | None = None,
    *,
    force: bool = False,
    report: Report = unheard,
) -> ExportReport:
    """Write events of a result, or signals of a recording, for other tools.

    Parameters
    ----------
    source
        Results or a recording.
    out
        A file, or a folder that takes a table of each kind.
    format_name
        Name of an exporter; None goes by how the file's name ends.
    kinds, stages
        What is written, and of which stages; empty: all but signals.
    recording
        The recording of results, where it does not lie beside them.
    origin
        Where the site's zero lies.
    force
        Overwrite what was exported there before.
    report
        Told what a person should know.

    Raises
    ------
    GroundtraceError
        Where the format takes none of it, or the target cannot be written.
    """
    known, troubles = exporters()
    for trouble in troubles:
        report(f"warning: {trouble}")
    exporter = exporter_of(known, out, format_name)
    folder = is_folder(exporter, out)
    existing(source, "results or a recording")
    _check_target(out, [source, *([recording] if recording else [])], folder=folder, force=force)
    with ExitStack() as stack:
        opened = stack.enter_context(Recording.open(source))
        material = _material(stack, opened, source, recording, origin, report)
        material = _of_stages(material, stages)
        chosen = chosen_kinds(exporter, material, kinds, folder=folder)
        written = export(exporter, material, chosen, out, folder=folder)
        damage = [d.reason for d in opened.damage]
    return ExportReport(
        str(out), source.name, exporter.name, written.counts, list(written.remarks), damage
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


def _material(
    stack: ExitStack,
    opened: Recording,
    source: Path,
    given: Path | None,
    origin: Origin | None,
    report: Report,
) -> Material:
    """Return what there is to be exported; what needs more reading is read when asked for."""
    if RUN in opened.metadata:
        return _of_results(stack, read_results(source), source, given, origin, report)
    if given is not None:
        raise RecordingError(f"--recording: expected results to go with it, found {source.name}")
    return Material(
        source.name,
        opened.start_ns,
        tuple(events_of(opened.file)),
        opened.labels,
        annotations_to_show(opened, source, report),
        opened.geometry,
        origin=origin,
        recording=lambda: opened,
    )


def _of_results(
    stack: ExitStack,
    result: Results,
    source: Path,
    given: Path | None,
    origin: Origin | None,
    report: Report,
) -> Material:
    @cache
    def recording() -> Recording | None:
        path = recording_of(source, given, report)
        return None if path is None else stack.enter_context(Recording.open(path))

    @cache
    def evidence() -> Evidence:
        from ..explain.unfiltered import beside, with_recording
        from ..pipeline.results import evidence_of

        name, sha256 = result.provenance.recording, result.provenance.sha256
        places = [beside(source, name), *([] if given is None else [given])]
        labels = truth_beside(result, source, report=report)
        return with_recording(evidence_of(result, labels), sha256, places)

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
