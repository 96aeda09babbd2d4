"""What a sweep is over: files of results, and recordings that are measured for it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.truth import own_truth
from ..pipeline.config import build_pipeline, checked_pipeline, parse_pipeline
from ..pipeline.results import RUN, evidence_of, provenance_in, read_results
from .files import existing, recording_beside, unheard
from .known_truth import scored_truth_of, truth_of_recording
from .progress import unseen

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..explain.redecide import Grid
    from ..explain.sweep import Ranking, Subject
    from ..pipeline.config import PipelineConfig
    from ..pipeline.results import Provenance
    from .files import Report
    from .progress import Progress


def config_of(inputs: Sequence[Path], pipeline: str | None) -> PipelineConfig:
    """Return the pipeline that is swept: the one named, or that of the first results.

    Raises
    ------
    RecordingError
        Where there is no input, or a recording and no pipeline to measure it with.
    PipelineError, PluginError
        Where the one named is none.
    """
    from ..explain.sweep import resolved

    if not inputs:
        raise RecordingError("sweep: expected results or recordings, found none")
    if pipeline:
        return resolved(checked_pipeline(pipeline))
    origins = {path: _origin(existing(path)) for path in inputs}
    for path, origin in origins.items():
        if origin is None:
            raise RecordingError(
                f"{path.name}: expected --pipeline NAME to measure the recording with, found none"
            )
    first, text = next((p, o.pipeline) for p, o in origins.items() if o is not None)
    return parse_pipeline(text.encode(), f"{first.name}: pipeline")


def subjects_of(
    inputs: Sequence[Path],
    config: PipelineConfig,
    truth: Path | None,
    recordings: Sequence[Path],
    jobs: int,
    report: Report = unheard,
    progress: Progress = unseen,
) -> list[Subject]:
    """Read results, and measure recordings that were not replayed.

    Parameters
    ----------
    inputs
        Results or recordings.
    config
        The pipeline that recordings are measured with, and results were.
    truth
        Truth instead of that of the one input.
    recordings
        Where else to look for the recordings of results than beside them.
    jobs
        Processes for measuring.
    report, progress
        Told what a person should know, and how much is measured.

    Raises
    ------
    RecordingError
        Where there is no truth, or not the same pipeline for all.
    """
    from ..api.comparing import check_subjects

    if truth is not None and len(inputs) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(inputs)}")
    replayed = {path: _origin(existing(path)) is not None for path in inputs}
    fresh = [path for path in inputs if not replayed[path]]
    measured = _measured(fresh, config, truth, jobs, report, progress) if fresh else {}
    read = {p: _read(p, truth, recordings, report) for p in inputs if replayed[p]}
    subjects = [measured[path] if path in measured else read[path] for path in inputs]
    check_subjects(subjects, config)
    return subjects


def _origin(path: Path) -> Provenance | None:
    """Return where results come from; None for a recording."""
    with Recording.open(path) as opened:
        return provenance_in(opened, path.name) if RUN in opened.metadata else None


def _measured(
    paths: Sequence[Path],
    config: PipelineConfig,
    truth: Path | None,
    jobs: int,
    report: Report,
    progress: Progress,
) -> dict[Path, Subject]:
    from ..explain.sweep import Subject, in_processes, measure_evidence

    total_s = 0.0
    labels, placements = {}, {}
    for path in paths:
        with Recording.open(path) as recording:
            labels[path] = truth_of_recording(recording, path, truth, report=report)
            placements[path] = {s.topic: s.placement for s in recording.streams}
            total_s += (recording.end_ns - recording.start_ns) / NS_PER_S
    if paths:
        report(f"measuring {len(paths)} recordings ({total_s:.0f} s)")
    with progress(total_s, "measuring") as show:
        count = iter(range(1, len(paths) + 1))
        found = in_processes(
            partial(measure_evidence, config=config),
            list(paths),
            jobs,
            lambda: show(next(count) * total_s / len(paths)),
        )
    subjects = {}
    for path, evidence in zip(paths, found, strict=True):
        specs = [stage.spec for stage in evidence.stages]
        own = own_truth(labels[path], specs, placements[path])
        for remark in own.remarks:
            report(f"truth: {remark}")
        subjects[path] = Subject(replace(evidence, labels=own.labels), (path,))
    return subjects


def _read(path: Path, truth: Path | None, recordings: Sequence[Path], report: Report) -> Subject:
    from ..explain.sweep import Subject

    result = read_results(path, evidence=True)
    origin = result.provenance
    recording = recording_beside(path, origin)
    labels = scored_truth_of(result, recording, truth, report=report).labels
    part = any(argument.startswith(("--from", "--to")) for argument in origin.arguments)
    # what was replayed in part is not to be measured as a whole
    places = () if part else (recording, *recordings)
    return Subject(evidence_of(result, labels), places, origin.sha256)


def best_recipe(config: PipelineConfig, settings: Grid, ranking: Ranking) -> str:
    """Return the pipeline with the best settings of a sweep, as TOML."""
    from ..explain.sweep import with_values

    best = with_values(config, settings.axes, list(ranking.best.settings.values()))
    best = replace(best, placements={})  # those are of one recording
    return build_pipeline(best).recipe()
