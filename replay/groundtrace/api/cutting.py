"""A span of a recording as one of its own, which says where it is from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.copies import cut
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..pipeline.results import RUN, file_sha256

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.copies import Copied


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
        found = f"{from_s:g} s to " + ("the end" if to_s is None else f"{to_s:g} s")
        raise RecordingError(
            f"{recording.name}: --from, --to: expected a span of 0 to {duration_s:.3f} s, "
            f"found {found}"
        )
    start_ns = recording.start_ns + round(from_s * NS_PER_S)
    stop_ns = recording.end_ns + 1 if to_s is None else recording.start_ns + round(to_s * NS_PER_S)
    return start_ns, stop_ns
