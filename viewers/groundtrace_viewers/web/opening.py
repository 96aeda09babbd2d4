"""The moment that a page opens at, as a drawing: it is seen before the viewer is there."""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from groundtrace.api.pictures import draw
from groundtrace.api.plots import figure_bytes
from groundtrace.api.results import Results as Shown
from groundtrace.errors import GroundtraceError, OutputError
from groundtrace.pipeline.results import atomic_write
from groundtrace.runtime import unconfigured
from groundtrace.scratch import scratch_folder_until_exit
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.location import is_url

from .server import OPENING

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.results import Results

#: Dots an inch: 1080 across. Chosen by judgement: sharp where the page is 1280 px wide.
DPI = 120.0


def opening_drawing(results: Results, recording: Path | None, at_s: float) -> bytes:
    """Return the moment as ``groundtrace figure`` draws it, PNG; empty where it cannot be drawn.

    Parameters
    ----------
    results
        What was decided.
    recording
        Their recording, known to be it; None where it is not there. One at a URL is not drawn: it
        is read once.
    at_s
        The moment [s since the first sample].
    """
    if recording is None or is_url(recording):
        return b""
    with unconfigured():
        import matplotlib
    matplotlib.use("agg")  # a file needs no display, and none is asked for
    from matplotlib import pyplot

    provenance = replace(results.provenance, sha256="")
    shown = Shown(replace(results, provenance=provenance), recording)
    try:
        figure = _drawn(shown, at_s)
        drawing = figure_bytes(figure, ".png", results.provenance.sha256, DPI)
    except (GroundtraceError, CodecError, OSError):
        return b""
    pyplot.close(figure)
    return drawing


def _drawn(shown: Shown, at_s: float) -> Any:
    try:
        return shown.why(at=at_s).plot()[0].figure
    except GroundtraceError:  # no stage decides steps: the signal alone
        return draw(shown, at_s)


def drawn_meanwhile(results: Results, recording: Path | None, at_s: float) -> Path:
    """Begin to draw the moment; return the file that comes: empty where it cannot be drawn.

    Parameters
    ----------
    results, recording, at_s
        As of :func:`opening_drawing`.
    """
    path = scratch_folder_until_exit() / OPENING

    def write() -> None:
        content = b""
        try:
            content = opening_drawing(results, recording, at_s)
        finally:  # who waits for it goes on
            # without its folder the program ends
            with suppress(OutputError), atomic_write(path) as fresh:
                fresh.write_bytes(content)

    threading.Thread(target=write, daemon=True).start()
    return path
