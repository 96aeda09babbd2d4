"""The truth that commands use, see :mod:`groundtrace.api.known_truth`; its remarks are printed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..api import known_truth
from ..api.known_truth import kinds_of as kinds_of
from .output import say

if TYPE_CHECKING:
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.recording import Recording

    from ..results import Results
    from ..score.truth import ScoredTruth


def truth_of(
    result: Results, path: Path, truth: Path | None, author: str | None = None
) -> tuple[Label, ...]:
    """Return the labels of :func:`scored_truth_of`."""
    return scored_truth_of(result, path, truth, author).labels


def scored_truth_of(
    result: Results, path: Path, truth: Path | None, author: str | None = None
) -> ScoredTruth:
    """Return the truth of a result; annotations are looked for beside its file, ``path``."""
    recording = path.parent / Path(result.provenance.recording).name
    return known_truth.scored_truth_of(result, recording, truth, author, say)


def truth_of_recording(
    recording: Recording, path: Path, truth: Path | None, author: str | None = None
) -> tuple[Label, ...]:
    """Return the truth of a recording that was not replayed."""
    return known_truth.truth_of_recording(recording, path, truth, author, say)


def annotations_to_show(recording: Recording, path: Path) -> tuple[Annotation, ...]:
    """Return what people marked; a sidecar that is of no use is said, and the replay goes on."""
    return known_truth.annotations_to_show(recording, path, say)
