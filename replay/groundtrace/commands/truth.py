"""The truth that score, why, sweep and compare use."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import RecordingError

if TYPE_CHECKING:
    from groundtrace_codecs.labels import Label

    from ..results import Results


def truth_of(result: Results, path: Path, truth: Path | None) -> tuple[Label, ...]:
    """Return the truth: a given file, the recording's own, or annotations beside the results."""
    from groundtrace_codecs.truth import read_truth

    start_ns = result.provenance.start_ns
    beside = path.with_name(f"{Path(result.provenance.recording).stem}.annotations.mcap")
    if truth is None and not result.labels and beside.is_file():
        truth = beside
    if truth is None:
        return result.labels
    if not truth.is_file():
        raise RecordingError(f"{truth}: expected a truth file, found no such file")
    return read_truth(truth, start_ns=start_ns, geometry=result.geometry, labels=result.labels)
