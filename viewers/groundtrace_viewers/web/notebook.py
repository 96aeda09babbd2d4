"""Shows a result in a notebook: the viewer as a widget of the package ``rerun-notebook``."""

from __future__ import annotations

import io
import os
import re
import sys
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from groundtrace.scratch import scratch_folder

from ..errors import ViewerError

PACKAGE = "rerun_notebook"
#: Where the widget takes the viewer from: the installed package, or by default a server of others.
ASSET = "RERUN_NOTEBOOK_ASSET"
#: Stands before the widget's program. The viewer asks a code host for its latest release when it
#: starts, which no option of the widget prevents; its program has no other way to a network.
GUARD = """
const fetch = async (...asked) => {
  const url = new URL(asked[0].url ?? asked[0], document.baseURI);
  if (!["data:", "blob:"].includes(url.protocol) && url.origin !== location.origin)
    throw new TypeError(`${url.origin} is not asked: groundtrace shows results without a network`);
  return globalThis.fetch(...asked);
};
"""


def show(
    results: Path | str,
    *,
    recording: Path | str | None = None,
    rrd: Path | str | None = None,
    height: int = 720,
    at_s: float | None = None,
) -> Any:
    """Show a result in a notebook, without a network.

    Parameters
    ----------
    results
        Results MCAP that ``groundtrace replay`` wrote.
    recording
        Their recording, where it does not lie beside them.
    rrd
        A timeline that ``groundtrace replay`` wrote, instead of replaying the recording.
    height
        Of the widget [px]; it is as wide as its cell.
    at_s
        Where its cursor stands [s since the first sample]; None stands for where a page opens:
        the first wrong decision, else the first step or event.

    Returns
    -------
    The widget of ``rerun-notebook``: shown where it is the last line of a cell.

    Raises
    ------
    GroundtraceError, CodecError, ViewerError
        Where ``rerun-notebook`` is not installed, or there is nothing to show.
    """
    widget_class = _widget_class()
    # what replays is not imported with the package
    from groundtrace.api.files import recording_of
    from groundtrace.pipeline.results import read_results

    from ..rerun.blueprint import layout_of
    from ..rerun.moments import moments_of_results
    from ..rerun.timeline import TIMELINE
    from .share import timeline_file
    from .summary import sources_of

    path = Path(results)
    recording_path = recording_of(path, None if recording is None else Path(recording))
    with scratch_folder() as folder:
        target = Path(folder, "replay.rrd")
        given = None if rrd is None else Path(rrd)
        timeline_file(sources_of(path, recording_path), given, False, target)
        # the layout goes first: without one the viewer makes its own, and keeps it
        parts = layout_of(target), target.read_bytes()
    widget = widget_class(width="auto", height=height)
    for part in parts:
        widget.send_rrd(part)
    if at_s is None:
        at_s = moments_of_results(read_results(path), within_s=0.0).opens_s  # when, not why
    widget.set_time_ctrl(TIMELINE, duration_nanos=round(at_s * 1e9), play=False)
    return widget


def _widget_class() -> Any:
    """Return the widget, which decides when it is imported where it takes the viewer from."""
    if PACKAGE not in sys.modules:
        if find_spec(PACKAGE) is None:
            raise ViewerError(
                "show: expected the package rerun-notebook (pip install 'groundtrace[notebook]'), "
                "found none; groundtrace share makes a page instead"
            )
        os.environ.setdefault(ASSET, "inline")
    with redirect_stdout(io.StringIO()):  # it says that it does as it was asked
        package = import_module(PACKAGE)
    program = getattr(package, "ESM_MOD", "")
    # the program itself, where it is not the address of one
    return _guarded(package.Viewer, program) if "\n" in str(program) else package.Viewer


@cache
def _guarded(widget: Any, program: str) -> Any:
    """Return the widget with a program that asks no other host."""
    offline = GUARD + re.sub(r"\w+\.fetch\(", "fetch(", program)
    return type("Viewer", (widget,), {"_esm": offline, "__doc__": widget.__doc__})
