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
from ..pipeline import load_pipeline
from ..results import RUN
from .output import existing, progress, say
from .resuming import results_at
from .truth import truth_of, truth_of_recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pipeline import PipelineConfig


def all_jobs(jobs: int | None) -> int:
    """Return how many processes to use: those asked for, else one for each processor."""
    return jobs if jobs is not None else os.cpu_count() or 1


def subjects_of(
    inputs: Sequence[Path],
    pipeline: str | None,
    truth: Path | None,
    recordings: Sequence[Path],
    jobs: int,
) -> list[Subject]:
    """Read results, and measure recordings that were not replayed.

    Parameters
    ----------
    inputs
        Results or recordings.
    pipeline
        What recordings are measured with.
    truth
        Truth instead of that of the one input.
    recordings
        Where else to look for the recordings of results than beside them.
    jobs
        Processes for measuring.

    Raises
    ------
    RecordingError
        Where there is no input, no truth, no pipeline, or not the same one for all.
    """
    if not inputs:
        raise RecordingError("sweep: expected results or recordings, found none")
    if truth is not None and len(inputs) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(inputs)}")
    replayed = {path: _is_result(existing(path)) for path in inputs}
    config = resolved(load_pipeline(pipeline)) if pipeline else None
    fresh = [path for path in inputs if not replayed[path]]
    if fresh and config is None:
        raise RecordingError(
            f"{fresh[0].name}: expected --pipeline NAME to measure the recording with, found none"
        )
    measured = _measured(fresh, config, truth, jobs) if config is not None else {}
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


def _is_result(path: Path) -> bool:
    with Recording.open(path) as recording:
        return RUN in recording.metadata


def _measured(
    paths: Sequence[Path], config: PipelineConfig, truth: Path | None, jobs: int
) -> dict[Path, Subject]:
    total_s = 0.0
    labels = {}
    for path in paths:
        with Recording.open(path) as recording:
            labels[path] = truth_of_recording(recording, path, truth)
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
    return {
        path: Subject(replace(evidence, labels=labels[path]), (path,))
        for path, evidence in zip(paths, found, strict=True)
    }


def _read(path: Path, truth: Path | None, recordings: Sequence[Path]) -> Subject:
    result = results_at(path, evidence=True)
    origin = result.provenance
    evidence = evidence_of(result, truth_of(result, path, truth))
    part = any(argument.startswith(("--from", "--to")) for argument in origin.arguments)
    # what was replayed in part is not to be measured as a whole
    places = () if part else (path.parent / Path(origin.recording).name, *recordings)
    return Subject(evidence, places, origin.sha256)


def _one_pipeline(subjects: Sequence[Subject], config: PipelineConfig | None) -> None:
    """Refuse to sweep over different pipelines."""
    expected = (config or subjects[0].evidence.config).stage
    for subject in subjects:
        if subject.evidence.config.stage != expected:
            first = "--pipeline" if config is not None else subjects[0].evidence.name
            raise RecordingError(
                f"{subject.evidence.name}: pipeline: expected that of {first}, found other stages "
                f"or parameters"
            )
