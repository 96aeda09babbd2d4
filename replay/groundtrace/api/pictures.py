"""Shows results: the viewer in a notebook, or a drawing where there is none."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..evaluation.drawing import style
from ..pipeline.engine import ReplaySession
from ..pipeline.plugins import load
from ..pipeline.results import ResultsSink, recording_in
from ..scratch import scratch_folder
from .plots import SIGNAL_IN, WIDTH_IN, draw_signal, draw_steps, recording_at

if TYPE_CHECKING:
    from .results import Results

#: What is drawn on each side of the moment [s]. Chosen by judgement: some steps to either side.
AROUND_S = 5.0


def show(results: Results, *, at: float | None = None, height: int = 720) -> Any:
    """Show results: the viewer in a notebook, a drawing where ``rerun-notebook`` is not installed.

    Parameters
    ----------
    results
        What was decided.
    at
        Where the cursor of the viewer stands, or the moment that is drawn, 5 s on each side
        [s since the first sample]; None draws the first missed step, else the first step.
    height
        Of the viewer [px].

    Returns
    -------
    The widget, or a ``matplotlib.figure.Figure``: shown where it is the last line of a cell.

    Raises
    ------
    Error
        Where the recording is not at hand.

    Examples
    --------
    >>> import groundtrace as gt
    >>> figure = gt.show(gt.replay("waist-walk", "waist-steps", to_s=12), at=8.0)
    """
    if find_spec("rerun_notebook") is None:
        return draw(results, at)
    with scratch_folder() as folder:
        path = results.path or save(results, Path(folder, "shown.results.mcap"))
        view = load("views", "notebook")
        recording = recording_in(results.places, results.decided.provenance.sha256)
        return view(path, recording=recording, height=height, at_s=at)


def draw(results: Results, at: float | None = None) -> Any:
    """Draw the signal about a moment, with detected, missed and false steps.

    Parameters
    ----------
    results, at
        As of :func:`show`.

    Returns
    -------
    A ``matplotlib.figure.Figure``.
    """
    recording = recording_at(results.name, results.decided.provenance.sha256, results.places)
    steps = results.step_times
    if at is None:
        at = next(iter((*steps.missed, *steps.detected)), 0.0)
    topics = {stream.topic for stream in recording.streams}
    topic = next((t for t in results.steps.topic.tolist() if t in topics), None)
    with style():
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(figsize=(WIDTH_IN, SIGNAL_IN), layout="constrained")
        draw_signal(axes, recording, topic, at, AROUND_S)
        draw_steps(axes, steps, at, AROUND_S)
        axes.set_title(repr(results))
    return figure


def save(results: Results, path: Path) -> Path:
    """Write results that are in memory alone; return where."""
    decided = results.decided
    origin = decided.provenance
    session = ReplaySession(
        name=origin.recording,
        application=results.pipeline.config.application,
        start_ns=origin.start_ns,
        end_ns=origin.end_ns,
        streams=(),
        geometry=decided.geometry,
        labels=decided.labels,
        pipeline=origin.pipeline,
        annotations=decided.annotations,
    )
    sink = ResultsSink(path, origin)
    sink.open(session)
    try:
        for event in decided.events:
            sink.write(event)
    except BaseException:
        sink.abandon()
        raise
    sink.close()
    return path
