"""Results or a recording written anew: as files of other tools, or a span of one cut out."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

from groundtrace_codecs.copies import cut
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.event_messages import events_of
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError, UsageError
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
from ..pipeline.results import RUN, file_sha256, read_results
from .files import (
    check_replaceable,
    in_folder,
    named_recording,
    recording_of,
    unheard,
    writable,
)
from .known_truth import annotations_to_show, truth_beside

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.copies import Copied

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
    available, troubles = exporters()
    for trouble in troubles:
        report(f"warning: {trouble}")
    exporter = exporter_of(available, out, format_name)
    folder = is_folder(exporter, out)
    source = named_recording(source)
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
    if out.exists() and not out.is_dir():
        raise RecordingError(f"{out}: expected a folder, found a file")
    if out.exists() and not force:
        raise RecordingError(f"{out}: expected a new folder, found an existing one; see --force")
    if out.exists():
        check_replaceable(out)
    in_folder(out)


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
        from ..explain.unfiltered import with_recording
        from ..pipeline.results import evidence_of

        sha256 = result.provenance.sha256
        places = [result.provenance.beside(source), *([] if given is None else [given])]
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
    stage_names = dict.fromkeys(name for name, _ in named if name)
    for stage in stages:
        if stage not in stage_names:
            available = ", ".join(stage_names) or "none"
            raise RecordingError(
                f"{material.name}: --stage: expected one of {available}, found {stage!r}"
            )
    return replace(material, events=tuple(e for name, e in named if name in stages))


def cut_span(path: Path, out: Path, from_s: float, to_s: float | None, *, force: bool) -> Copied:
    """Copy from <= time < to of a recording.

    Parameters
    ----------
    path, out
        The recording, and the copy.
    from_s, to_s
        Since the first sample [s]; None is the end.
    force
        Overwrite an existing file.

    Raises
    ------
    RecordingError
        Where it is the results of one, or has no such span.
    """
    with Recording.open(path) as opened:
        if RUN in opened.metadata:
            raise RecordingError(
                f"{path.name}: expected a recording, found results; cut their recording and "
                f"replay it"
            )
        start_ns, stop_ns = _span(opened, from_s, to_s)
        origin = {
            "recording": path.name,
            "sha256": file_sha256(path),
            "from_ns": str(start_ns),
            "to_ns": str(stop_ns),
        }
        return cut(opened, out, start_ns, stop_ns, origin=origin, force=force)


def _span(recording: Recording, from_s: float, to_s: float | None) -> tuple[int, int]:
    """Return the half-open span that is asked for [ns]."""
    duration_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    if from_s > duration_s or (to_s is not None and to_s <= from_s):
        given = f"{from_s:g} s to " + ("the end" if to_s is None else f"{to_s:g} s")
        raise UsageError(
            f"{recording.name}: --from, --to: expected a span of 0 to {duration_s:.3f} s, "
            f"found {given}"
        )
    start_ns = recording.start_ns + round(from_s * NS_PER_S)
    stop_ns = recording.end_ns + 1 if to_s is None else recording.start_ns + round(to_s * NS_PER_S)
    return start_ns, stop_ns
