"""What is shared of a result: the result, its truth, what people marked, and the recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PureWindowsPath
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.annotate import annotated, kept_in
from groundtrace.api.known_truth import scored_truth_of
from groundtrace.api.reports import unheard
from groundtrace.errors import AnnotationError
from groundtrace.pipeline import parse_pipeline
from groundtrace.results import read_results
from groundtrace.score import match_steps, score_events
from groundtrace.score.report import answers_of
from groundtrace_codecs.annotations import RecordingKey, sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.recording import Recording

from .moments import moments_of_results
from .verdict import TOLERANCE_S

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.api.reports import Report
    from groundtrace.pipeline import PipelineConfig
    from groundtrace.results import Results
    from groundtrace.score import Score, StepMatch
    from groundtrace.score.report import Answers
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import Stream

    from .moments import Moments


@dataclass(frozen=True, slots=True)
class Sources:
    """What a shared folder is made of.

    Attributes
    ----------
    path
        The file of the results.
    results, config
        What it holds, and its pipeline.
    labels, score
        The truth, and how well the results answer it.
    said
        The results' events, sorted by the truth they answer.
    moments
        What a page jumps to.
    recording
        The recording, or None where it is not there.
    streams
        Of the recording; none where it is not there.
    annotations
        What people marked, by time.
    sidecar
        The file that it is kept in, or None.
    """

    path: Path
    results: Results
    config: PipelineConfig
    labels: tuple[Label, ...]
    score: Score
    said: Answers
    moments: Moments
    recording: Path | None
    streams: tuple[Stream, ...]
    annotations: tuple[Annotation, ...]
    sidecar: Path | None

    @property
    def name(self) -> str:
        """File name of the recording, without any folder."""
        return PureWindowsPath(self.results.provenance.recording).name

    @property
    def stem(self) -> str:
        """The same without its ending."""
        return PureWindowsPath(self.name).stem

    @property
    def key(self) -> RecordingKey:
        """The recording as annotations name it."""
        origin = self.results.provenance
        return RecordingKey(self.name, origin.sha256, origin.start_ns)

    @property
    def matching(self) -> StepMatch | None:
        """Which steps answer which true ones; None without true steps."""
        if self.score.steps is None or not self.score.steps.truth:
            return None
        origin = self.results.provenance
        found_ns = np.array([step.time_ns for step in self.said.steps], np.int64)
        return match_steps(self.labels, found_ns, origin.start_ns, origin.end_ns, TOLERANCE_S)

    @property
    def free(self) -> bool:
        """Whether the track is a walker's that begins anywhere and heads anywhere."""
        quantities = {c.quantity for stream in self.streams for c in stream.channels}
        known = not quantities or quantities & {"magnetic_field", "latitude"}
        track = self.score.track
        closed = track is not None and track.closure is not None
        return self.config.application == "walker" and closed and not known

    @property
    def scored(self) -> bool:
        """Whether there is truth to score anything by."""
        parts = (getattr(self.score, name) for name in self.score.__dataclass_fields__)
        return any(part is not None for part in parts)


def sources_of(path: Path, recording: Path | None, report: Report = unheard) -> Sources:
    """Read everything that a shared folder is made of.

    Parameters
    ----------
    path
        The results; annotations are looked for beside the recording, then beside them.
    recording
        Their recording, or None where it is not there.
    report
        Told what a person should know of truth and annotations.

    Raises
    ------
    GroundtraceError, CodecError
        Where one of the files cannot be read.
    """
    results = read_results(path)
    origin = results.provenance
    beside = path.parent / PureWindowsPath(origin.recording).name
    labels = scored_truth_of(results, beside, report=report).labels
    streams: tuple[Stream, ...] = ()
    if recording is not None:
        with Recording.open(recording) as opened:
            streams = opened.streams
    annotations, sidecar = _marks(results, beside, recording, report)
    return Sources(
        path,
        results,
        parse_pipeline(origin.pipeline.encode(), f"{path.name}: pipeline"),
        labels,
        score_events(labels, results.events, origin.start_ns, origin.end_ns, TOLERANCE_S),
        answers_of(results.events),
        moments_of_results(results, streams, labels, recording),
        recording,
        streams,
        annotations,
        sidecar,
    )


def _marks(
    results: Results, beside: Path, recording: Path | None, report: Report
) -> tuple[tuple[Annotation, ...], Path | None]:
    """Return what people marked, and the sidecar; a sidecar of no use is said and left out."""
    origin = results.provenance
    key = RecordingKey(origin.recording, origin.sha256, origin.start_ns)
    for place in (recording, beside):
        if place is None or not annotated(place):
            continue
        try:
            kept = kept_in(sidecar_path(place), key)
        except (AnnotationError, CodecError) as error:
            report(f"annotations are left out: {error}")
            continue
        for remark in kept.remarks:
            report(remark)
        sidecar = sidecar_path(place)
        return kept.annotations, sidecar if sidecar.is_file() else None
    return results.annotations, None
