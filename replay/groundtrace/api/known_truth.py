"""The truth that score, why, sweep and compare use, and the annotations that replay shows.

The first of these that exists is used: the file of ``--truth``, the recording's own truth, the
annotations beside it, those inside it. Annotations are never added to a recording's own truth.
Remarks for a person go to a ``report``, a line each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import AnnotationError, RecordingError
from ..pipeline.results import file_sha256, replayed_labels
from .files import unheard

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation, RecordingKey
    from groundtrace_codecs.events import Label
    from groundtrace_codecs.recording import Recording

    from ..evaluation.truth import ScoredTruth
    from ..pipeline.results import Results
    from .files import Report


@dataclass(frozen=True, slots=True)
class _Source:
    """Where truth comes from: labels, or where there are none annotations."""

    name: str
    labels: tuple[Label, ...] = ()
    annotations: tuple[Annotation, ...] = ()


def scored_truth_of(
    result: Results,
    recording: Path,
    truth: Path | None = None,
    author: str | None = None,
    report: Report = unheard,
) -> ScoredTruth:
    """Return the truth of a result, of the span that was replayed, and say what is left out of it.

    What the pipeline was given is left out, and of a sensor on one foot the other foot's steps, see
    :mod:`.evaluation.truth`.

    Parameters
    ----------
    result
        The result.
    recording
        Where its recording is, or would be: its annotations are looked for beside it.
    truth
        A file instead.
    author
        Of annotations: whose are truth; None for everybody's.
    report
        Told what a person should know of it.

    Raises
    ------
    RecordingError, AnnotationError
        Where the file is not there, annotations are of another recording or none by ``author``.
    SchemaError
        Where the channels or stations that a file names are none of the recording's.
    """
    from groundtrace_codecs.annotations import RecordingKey

    origin = result.provenance
    key = RecordingKey(origin.recording, origin.sha256, origin.start_ns)
    labels = _chosen(_source(result, recording, key.start_ns, lambda: key, truth), author, report)
    if truth is not None:
        _report_unmatched(labels, _names_in(result), truth, report)
    # a replay, which shows what is marked, scores nothing
    from ..evaluation.truth import scored_truth

    scored = scored_truth(replayed_labels(labels, origin.from_ns, origin.to_ns), result)
    for remark in scored.remarks:
        report(f"truth: {remark}")
    return scored


def truth_beside(
    result: Results, path: Path, truth: Path | None = None, report: Report = unheard
) -> tuple[Label, ...]:
    """Return the labels of :func:`scored_truth_of`; ``path`` is the results' file."""
    recording = result.provenance.beside(path)
    return scored_truth_of(result, recording, truth, report=report).labels


def truth_of_recording(
    recording: Recording,
    path: Path,
    truth: Path | None = None,
    author: str | None = None,
    report: Report = unheard,
) -> tuple[Label, ...]:
    """Return the same for a recording, open, that was not replayed; ``path`` is its file."""
    from groundtrace_codecs.annotations import RecordingKey

    def key() -> RecordingKey:
        return RecordingKey(path.name, file_sha256(path), recording.start_ns)

    labels = _chosen(_source(recording, path, recording.start_ns, key, truth), author, report)
    if truth is not None:
        from groundtrace_codecs.truth import names_of

        names = names_of(recording.streams, recording.geometry)
        _report_unmatched(labels, names, truth, report)
    return labels


def _names_in(result: Results) -> dict[str, tuple[str, ...] | None]:
    """Return what truth may name of a result: channels are known where some were picked."""
    from groundtrace_codecs.events import StageSpec
    from groundtrace_codecs.truth import names_of

    specs = [e for e in result.events if isinstance(e, StageSpec) and e.emits == "pick"]
    picked = dict.fromkeys(name for spec in specs for name in spec.channels)
    return names_of((), result.geometry) | {"pick": tuple(picked) if specs else None}


def _report_unmatched(
    labels: Sequence[Label],
    names: Mapping[str, Sequence[str] | None],
    truth: Path,
    report: Report,
) -> None:
    """Say what truth names that is not there; refuse one that names nothing that is."""
    from groundtrace_codecs.truth import unmatched_names

    for text in unmatched_names(labels, names, truth.name):
        report(f"warning: {text}")


def _source(
    subject: Results | Recording,
    recording: Path,
    start_ns: int,
    key: Callable[[], RecordingKey],
    truth: Path | None,
) -> _Source:
    """Return where truth comes from; ``key`` is asked only where annotations lie beside."""
    from groundtrace_codecs.annotations import annotated, sidecar_path

    if truth is not None:
        return _given(subject, start_ns, key, truth)
    if subject.labels:
        return _Source(recording.name, subject.labels)
    if annotated(recording):
        from ..annotate.store import kept_in

        beside = sidecar_path(recording)
        return _Source(beside.name, (), kept_in(beside, key()).annotations)
    return _Source(recording.name, (), subject.annotations)


def _given(
    subject: Results | Recording, start_ns: int, key: Callable[[], RecordingKey], truth: Path
) -> _Source:
    """Return what a file says."""
    from groundtrace_codecs.annotations import is_sidecar
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.truth import read_truth

    from ..annotate.store import kept_in

    if not truth.is_file():
        raise RecordingError(f"{truth}: expected a truth file, found no such file")
    if truth.suffix.lower() == ".mcap":
        with Recording.open(truth) as opened:
            if not is_sidecar(opened.file):
                return _Source(truth.name, opened.labels, opened.annotations)
        return _Source(truth.name, (), kept_in(truth, key()).annotations)
    labels = read_truth(truth, start_ns=start_ns, geometry=subject.geometry, labels=subject.labels)
    return _Source(truth.name, labels)


def _chosen(source: _Source, author: str | None, report: Report) -> tuple[Label, ...]:
    """Return the labels of a source; of annotations, say what was made of them."""
    from ..annotate.agreement import truth_of_annotations

    if source.labels or not source.annotations:
        if author is not None:
            raise RecordingError(
                f"{source.name}: --author: expected annotations as truth, found "
                f"{'truth of its own' if source.labels else 'none'}"
            )
        return source.labels
    truth = truth_of_annotations(source.annotations, author or "", source.name)
    summary = f"truth: {len(truth.labels)} annotations of {source.name}"
    if truth.merged:
        summary += f"; {truth.merged} more that another author gives within 50 ms count once"
    if truth.conflicts:
        summary += f"; {truth.conflicts} conflicts (groundtrace annotate --conflicts lists them)"
    report(summary)
    steps = {a.label.kind for a in source.annotations} & {"step", "missed"}
    if steps == {"missed"}:
        report(
            "truth: every step in it is marked as missed: steps that were found need marking too"
        )
    return truth.labels


def annotations_to_show(
    recording: Recording, path: Path, report: Report = unheard
) -> tuple[Annotation, ...]:
    """Return what people marked; a sidecar that is of no use is said, and the replay goes on."""
    from groundtrace_codecs.annotations import annotated
    from groundtrace_codecs.errors import CodecError

    if not annotated(path):
        return recording.annotations
    from ..annotate.store import stored

    try:
        sidecar = stored(path).content
    except (AnnotationError, CodecError) as error:
        report(f"annotations are left out: {error}")
        return ()
    for remark in sidecar.remarks:
        report(remark)
    return sidecar.annotations
