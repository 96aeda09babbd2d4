"""The truth that score, why, sweep and compare use."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import RecordingError

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.recording import Recording

    from ..results import Results


def truth_of(result: Results, path: Path, truth: Path | None) -> tuple[Label, ...]:
    """Return the truth: a given file, the recording's own, or annotations beside the results."""
    origin = result.provenance
    name = path.parent / Path(origin.recording).name
    return _chosen(result.labels, result.geometry, origin.start_ns, name, truth)


def truth_of_recording(recording: Recording, path: Path, truth: Path | None) -> tuple[Label, ...]:
    """Return the same for a recording that was not replayed."""
    return _chosen(recording.labels, recording.geometry, recording.start_ns, path, truth)


def _chosen(
    labels: tuple[Label, ...],
    geometry: Geometry | None,
    start_ns: int,
    recording: Path,
    truth: Path | None,
) -> tuple[Label, ...]:
    from groundtrace_codecs.truth import read_truth

    beside = recording.with_name(f"{recording.stem}.annotations.mcap")
    if truth is None and not labels and beside.is_file():
        truth = beside
    if truth is None:
        return labels
    if not truth.is_file():
        raise RecordingError(f"{truth}: expected a truth file, found no such file")
    return read_truth(truth, start_ns=start_ns, geometry=geometry, labels=labels)
