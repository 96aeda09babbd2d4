"""Comparisons of results: two of one recording, and many settings of one pipeline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.truth import kinds_of, own_truth
from ..explain.compare import compare as compared
from ..explain.reasons import TOLERANCE_S, event_noun, scored_event
from ..explain.redecide import make_grid, parse_axis
from ..explain.sweep import (
    Subject,
    count,
    in_processes,
    located,
    measure_evidence,
    measurements,
    rank,
    resolved,
    with_values,
    without_refused,
)
from ..pipeline.chain import build_pipeline
from ..pipeline.config import checked_pipeline, parse_pipeline
from ..pipeline.results import RUN, evidence_of, provenance_in, read_results
from .analysis import Comparison, Sweep
from .files import OriginFile, existing_recording, unheard
from .known_truth import truth_beside, truth_of_recording
from .pipelines import setting_text
from .progress import unseen
from .results import Results

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from ..explain.redecide import Grid
    from ..explain.sweep import Counted, Ranking
    from ..pipeline.config import PipelineConfig
    from ..pipeline.results import Provenance
    from .files import Report
    from .progress import Progress


def compare(
    a: Results,
    b: Results,
    *,
    tolerance_s: float = STEP_TOLERANCE_S,
    truth: str | Path | None = None,
) -> Comparison:
    """Compare two results of one recording, decision by decision.

    Parameters
    ----------
    a, b
        The results.
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        A file of truth instead of the recording's own.

    Raises
    ------
    Error
        Where they are of different recordings, or of different parts of one.

    Examples
    --------
    >>> import groundtrace as gt
    >>> a = gt.replay("waist-walk", "waist-steps")
    >>> gt.compare(a, gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8}))
    Comparison(waist-walk.mcap, 72 both right, 2 only A right, p = 0.5)
    """
    labels = a.scored_truth(truth).labels or b.scored_truth(truth).labels
    places = (a.recording_path, b.recording_path)
    return Comparison(compared(a.decided, b.decided, labels, tolerance_s, places))


def sweep(
    results: Results | Sequence[Results],
    grid: Mapping[str, Sequence[Any] | str],
    *,
    random: int | None = None,
    seed: int = 0,
    tolerance_s: float | None = None,
    truth: str | Path | None = None,
    top: int = 10,
    jobs: int = 1,
) -> Sweep:
    """Try many settings and report the best, with confidence intervals.

    Parameters
    ----------
    results
        Results, or several through one pipeline: each is then also left out in turn.
    grid
        By ``stage.parameter`` the values to try, or ``FROM:TO:COUNT``; all combinations are tried.
    random
        Number of random settings of those ranges to try instead.
    seed
        Of the random settings.
    tolerance_s
        Largest distance between a step, or a pass, and its detection [s]; None is 0.12 for steps
        and 1 for passes.
    truth
        A file of truth instead of the recording's own; of one recording alone.
    top
        How many of the highest F1 to keep.
    jobs
        Processes for measuring again where a parameter of the signal path is swept.

    Raises
    ------
    Error
        Where there is no truth, not one pipeline for all, or no such parameter or value.

    Examples
    --------
    >>> import groundtrace as gt
    >>> results = gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8})
    >>> gt.sweep(results, {"steps.score": [0.25, 0.5, 0.8]}).best
    {'steps.score': 0.25}
    """
    several = [results] if isinstance(results, Results) else list(results)
    if not several:
        raise RecordingError("sweep: expected results or recordings, found none")
    if truth is not None and len(several) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(several)}")
    config = several[0].pipeline.config
    texts = [f"{name}={_values_text(values)}" for name, values in grid.items()]
    asked = make_grid([parse_axis(text, config) for text in texts], random, seed)
    subjects = [_subject(each, truth) for each in several]
    check_subjects(subjects, config)
    return Sweep(SweepPlan.of(subjects, config, asked, tolerance_s).run(top, jobs)[1])


def _values_text(values: Sequence[Any] | str) -> str:
    return values if isinstance(values, str) else ",".join(map(setting_text, values))


def _subject(results: Results, truth: str | Path | None) -> Subject:
    origin = results.decided.provenance
    part = origin.from_ns is not None or origin.to_ns is not None
    # what was replayed in part is not to be measured as a whole
    places = () if part else (results.recording_path,)
    return Subject(results.evidence(truth), places, origin.sha256)


def check_subjects(subjects: Sequence[Subject], config: PipelineConfig) -> None:
    """Refuse to sweep what has no truth, or different pipelines.

    Raises
    ------
    RecordingError
        Where one has no truth, or another pipeline.
    """
    for subject in subjects:
        counted = scored_event(subject.evidence.config)
        needed = "step" if counted == "step" else "pass"
        if not any(label.kind == needed for label in subject.evidence.labels):
            raise RecordingError(
                f"{subject.evidence.name}: expected true {event_noun(counted)} (in the recording, "
                f"or --truth FILE), found {kinds_of(subject.evidence.labels)}"
            )
    for subject in subjects:
        if subject.evidence.config.stage != config.stage:
            named = "--pipeline" if subject is subjects[0] else subjects[0].evidence.name
            raise RecordingError(
                f"{subject.evidence.name}: pipeline: expected that of {named}, found other stages "
                f"or parameters"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SweepPlan:
    """A sweep that is checked and can begin.

    Attributes
    ----------
    subjects
        What is swept over, recordings found where they are needed.
    settings
        The settings that stored candidates can decide on, or that are measured again.
    tolerance_s
        Largest distance of a match [s].
    refused
        Which settings are left out, and why; empty for none.
    """

    subjects: tuple[Subject, ...]
    settings: Grid
    tolerance_s: float
    refused: str

    @classmethod
    def of(
        cls,
        subjects: Sequence[Subject],
        config: PipelineConfig,
        asked: Grid,
        tolerance_s: float | None = None,
    ) -> SweepPlan:
        """Check a sweep.

        Parameters
        ----------
        subjects, config
            What is swept over, and its pipeline.
        asked
            The settings.
        tolerance_s
            None is 0.12 s for steps and 1 s for passes.

        Raises
        ------
        PipelineError, RecordingError
            Where no setting is left, or a recording is needed and not to be found.
        """
        if tolerance_s is None:
            tolerance_s = TOLERANCE_S[scored_event(config)]
        settings, refused = without_refused(asked, config)
        return cls(tuple(located(subjects, settings)), settings, tolerance_s, refused or "")

    def measured(self) -> list[Subject]:
        """Return the subject of each measurement of a signal that is needed."""
        return measurements(self.subjects, self.settings)

    def run(
        self, top: int = 10, jobs: int = 1, done: Callable[[], None] = lambda: None
    ) -> tuple[Counted, Ranking]:
        """Return every setting's counts, and which settings are best.

        Parameters
        ----------
        top
            How many of the highest F1 to keep.
        jobs
            Processes for measuring.
        done
            Called after each measurement.
        """
        counted = count(self.subjects, self.settings, self.tolerance_s, jobs, done)
        ranking = rank(counted, top, jobs)
        notes = [f"{s.evidence.name}: {w.line}" for s in self.subjects for w in s.evidence.warnings]
        notes += [self.refused] if self.refused else []
        return counted, replace(ranking, notes=(*ranking.notes, *notes))


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
    origins = {path: _origin(existing_recording(path)) for path in inputs}
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
    if truth is not None and len(inputs) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(inputs)}")
    replayed = {path: _origin(existing_recording(path)) is not None for path in inputs}
    fresh = [path for path in inputs if not replayed[path]]
    measured = _measured(fresh, config, truth, jobs, report, progress) if fresh else {}
    read = {p: _read(p, truth, recordings, report) for p in inputs if replayed[p]}
    subjects = [measured[path] if path in measured else read[path] for path in inputs]
    check_subjects(subjects, config)
    return subjects


def origin_of(path: Path) -> Provenance | OriginFile:
    """Return the recording of results, or the recording that a file is."""
    return _origin(path) or OriginFile(path)


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
        measured = in_processes(
            partial(measure_evidence, config=config),
            list(paths),
            jobs,
            lambda: show(next(count) * total_s / len(paths)),
        )
    subjects = {}
    for path, evidence in zip(paths, measured, strict=True):
        specs = [stage.spec for stage in evidence.stages]
        scored_truth = own_truth(labels[path], specs, placements[path])
        for remark in scored_truth.remarks:
            report(f"truth: {remark}")
        subjects[path] = Subject(replace(evidence, labels=scored_truth.labels), (path,))
    return subjects


def _read(path: Path, truth: Path | None, recordings: Sequence[Path], report: Report) -> Subject:
    result = read_results(path, evidence=True)
    origin = result.provenance
    labels = truth_beside(result, path, truth, report)
    part = any(argument.startswith(("--from", "--to")) for argument in origin.arguments)
    # what was replayed in part is not to be measured as a whole
    places = () if part else (origin.beside(path), *recordings)
    return Subject(evidence_of(result, labels), places, origin.sha256)


def best_recipe(config: PipelineConfig, settings: Grid, ranking: Ranking) -> str:
    """Return the pipeline with the best settings of a sweep, as TOML."""
    best = with_values(config, settings.axes, list(ranking.best.settings.values()))
    best = replace(best, placements={})  # those are of one recording
    return build_pipeline(best).recipe()
