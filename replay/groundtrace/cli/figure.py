"""``groundtrace figure``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from ..api.files import recording_of, writable
from ..api.plots import FORMATS, save_figure
from ..api.results import load_results
from ..errors import UsageError
from ..pipeline.results import provenance_of
from ..runtime import unconfigured
from .console import print_json, print_line, print_stderr
from .options import AT_LEAST_ONE, OUT, POSITIVE, ForceOthers, Json, Results


def figure(
    results: Results,
    *,
    out: Annotated[Path, OUT],
    step: Annotated[int | None, AT_LEAST_ONE] = None,
    at: float | None = None,
    around: Annotated[float, POSITIVE] = 2.0,
    dpi: Annotated[float, POSITIVE] = 200.0,
    recording: Path | None = None,
    force: ForceOthers = False,
    json: Json = False,
) -> None:
    """Draw one moment for print: the signal with its steps, and the gates of the candidate.

    Parameters
    ----------
    out
        The drawing, by its suffix: .png, .svg or .pdf.
    step
        Draw the true step of this number, as why counts them.
    at
        Draw this moment instead [s since the first sample].
    around
        Signal that is drawn on each side [s].
    dpi
        Dots an inch, of a .png.
    recording
        The recording, where it is not beside its results.
    """
    with unconfigured():
        import matplotlib

    if out.suffix.lower() not in FORMATS:
        suffixes = ", ".join(FORMATS)
        raise UsageError(f"{out}: expected a name that ends in {suffixes}, found {out.name}")
    if (step is None) == (at is None):
        given = "neither" if step is None else "both"
        raise UsageError(f"figure: expected --step or --at, found {given}")
    matplotlib.use("agg")  # a file needs no display, and none is asked for
    writable(out, force=force, sources=[results], of=lambda: provenance_of(results))
    decided = load_results(results)
    path = recording_of(results, recording, print_stderr)
    if path is not None:
        decided = replace(decided, recording_path=path)
    why = decided.why(step, at=at)
    save_figure(why.plot(around)[0].figure, out, why.sha256, dpi)
    if json:
        document = {"path": str(out), "recording": why.recording, "time_s": why.time_s}
        print_json(document | {"step": why.step, "cause": why.cause, "text": why.text})
        return
    print_line(f"wrote {out}: {why.heading}")
