"""What a sweep is given: results or recordings, as evidence with truth."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..explain import evidence_of
from ..explain.counted import counted_kind, noun_of
from ..explain.measuring import in_processes, measure_evidence, resolved
from ..explain.sweep import Subject
from ..pipeline import checked_pipeline, parse_pipeline
from ..results import RUN, provenance_in, read_results
from ..score.truth import own_truth
from .output import existing, progress, say
from .truth import truth_of, truth_of_recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pipeline import PipelineConfig
    from ..results import Provenance


def all_jobs(jobs: int | None) -> int:
    """Return how many processes to use: those asked for, else one for each processor."""
    return jobs if jobs is not None else os.cpu_count() or 1


def config_of(inputs: Sequence[Path], pipeline: str | None) -> PipelineConfig:
    """Return the pipeline that is swept: the one named, or that of the first results.

    Raises
    ------
    RecordingError
        Where there is no input, or a recording and no pipeline to measure it with.
    PipelineError, PluginError
        Where the one named is none.
    """
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

    Raises
    ------
    RecordingError
        Where there is no truth, or not the same pipeline for all.
    """
    if truth is not None and len(inputs) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(inputs)}")
    replayed = {path: _origin(existing(path)) is not None for path in inputs}
    fresh = [path for path in inputs if not replayed[path]]
    measured = _measured(fresh, config, truth, jobs) if fresh else {}
    read = {p: _read(p, truth, recordings) for p in inputs if replayed[p]}
    subjects = [measured[path] if path in measured else read[path] for path in inputs]
    for subject in subjects:
        counted = counted_kind(subject.evidence.config)
        needed = "step" if counted == "step" else "pass"
        if not any(label.kind == needed for label in subject.evidence.labels):
            raise RecordingError(
                f"{subject.evidence.name}: expected true {noun_of(counted)} (in the recording, or "
                f"--truth FILE), found none"
            )
    _one_pipeline(subjects, config)
    return subjects


def _origin(path: Path) -> Provenance | None:
    """Return where results come from; None for a recording."""
    with Recording.open(path) as opened:
        return provenance_in(opened, path.name) if RUN in opened.metadata else None


def _measured(
    paths: Sequence[Path], config: PipelineConfig, truth: Path | None, jobs: int
) -> dict[Path, Subject]:
    total_s = 0.0
    labels, placements = {}, {}
    for path in paths:
        with Recording.open(path) as recording:
            labels[path] = truth_of_recording(recording, path, truth)
            placements[path] = {s.topic: s.placement for s in recording.streams}
            total_s += (recording.end_ns - recording.start_ns) / NS_PER_S
    if paths:
        say(f"measuring {len(paths)} recordings ({total_s:.0f} s)")
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
            say(f"truth: {remark}")
        subjects[path] = Subject(replace(evidence, labels=own.labels), (path,))
    return subjects


def _read(path: Path, truth: Path | None, recordings: Sequence[Path]) -> Subject:
    result = read_results(path, evidence=True)
    origin = result.provenance
    evidence = evidence_of(result, truth_of(result, path, truth))
    part = any(argument.startswith(("--from", "--to")) for argument in origin.arguments)
    # what was replayed in part is not to be measured as a whole
    places = () if part else (path.parent / Path(origin.recording).name, *recordings)
    return Subject(evidence, places, origin.sha256)


def _one_pipeline(subjects: Sequence[Subject], config: PipelineConfig) -> None:
    """Refuse to sweep over different pipelines."""
    for subject in subjects:
        if subject.evidence.config.stage != config.stage:
            first = "--pipeline" if subject is subjects[0] else subjects[0].evidence.name
            raise RecordingError(
                f"{subject.evidence.name}: pipeline: expected that of {first}, found other stages "
                f"or parameters"
            )
