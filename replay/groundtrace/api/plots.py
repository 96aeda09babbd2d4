"""Drawings of a moment with matplotlib, for notebooks and for print."""

from __future__ import annotations

import textwrap
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.location import is_url

from ..errors import RecordingError
from ..evaluation.drawing import COLOURS, style
from ..pipeline.results import atomic_write, recording_in
from .files import mark_of
from .recording import Recording, open_recording

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..evaluation.matching import StepTimes
    from ..explain.reasons import Chain

#: Signal that is drawn on each side of a moment [s]. Chosen by judgement: three steps to either
#: side.
AROUND_S = 2.0
#: Inches of a drawing: its width, its signal, and each of its gates with the axis below. Chosen by
#: judgement: at 200 dots an inch the picture fills a page.
WIDTH_IN, SIGNAL_IN, GATE_IN = 9.0, 3.4, 0.42
#: So many letters are on a line. Chosen by judgement: of 11 points they fit into the width.
LINE = 110
#: Formats of files, and the field of their metadata that says of which recording they are.
FORMATS = {".png": "Description", ".svg": "Description", ".pdf": "Subject"}
#: What makes a file the same each time.
_SAME: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def recording_at(name: str, sha256: str, places: Sequence[Path]) -> Recording:
    """Return the recording, from the first place that holds it.

    Parameters
    ----------
    name, sha256
        Of the recording.
    places
        Where it may be; a URL is taken as it is.

    Raises
    ------
    RecordingError
        Where it is nowhere.
    """
    url = next((location for location in places if is_url(location)), None)
    path = url or recording_in(places, sha256)
    if path is None:
        raise RecordingError(f"{name}: expected the recording to draw, found no file of its bytes")
    return open_recording(path)


def plot_moment(
    recording: Recording,
    time_s: float,
    chain: Sequence[Chain],
    texts: tuple[str, str],
    steps: StepTimes,
    around_s: float = AROUND_S,
) -> Any:
    """Draw the signal about a moment with steps and candidates, and the gates of the nearest one.

    Parameters
    ----------
    recording
        The recording.
    time_s
        The moment [s since the first sample].
    chain
        Candidates about it.
    texts
        What stands above: a heading, and the reason with what mends it, a line each.
    steps
        Those that are drawn.
    around_s
        Signal that is drawn on each side [s].

    Returns
    -------
    Two ``matplotlib.axes.Axes``, as an array: signal, gates.
    """
    nearest = min(chain, key=lambda link: abs(link.time_s - time_s), default=None)
    gates_in = GATE_IN * (2 + (1 if nearest is None else len(nearest.readings)))
    topics = {stream.topic for stream in recording.streams}
    topic = next((link.topic for link in chain if link.topic in topics), None)
    with style():
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(
            2,
            1,
            figsize=(WIDTH_IN, SIGNAL_IN + gates_in),
            height_ratios=(SIGNAL_IN, gates_in),
            layout="constrained",
        )
        draw_signal(axes[0], recording, topic, time_s, around_s)
        if nearest is not None:
            verdict = "accepted" if nearest.accepted else "rejected"
            label = f"candidate, {verdict}"
            axes[0].axvline(nearest.time_s, color=COLOURS["ink"], lw=1.4, ls=":", label=label)
        draw_steps(axes[0], steps, time_s, around_s)
        heading, reason = texts
        figure.suptitle(heading, x=0.01, ha="left", weight="bold")
        wrapped = "\n".join(textwrap.fill(line, LINE) for line in reason.splitlines())
        axes[0].set_title(wrapped, loc="left", fontsize=11, weight="normal")
        _draw_gates(axes[1], nearest)
    return axes


def save_figure(figure: Any, path: Path, sha256: str, dpi: float) -> None:
    """Write a drawing, which then says of which recording it is, and is the same each time.

    Parameters
    ----------
    figure
        A ``matplotlib.figure.Figure``.
    path
        A file of one of :data:`FORMATS`.
    sha256
        Of the recording.
    dpi
        Dots an inch, of PNG.
    """
    # whole before it is written: on a full disk the writer of PDF fails by an error of zlib
    content = figure_bytes(figure, path.suffix.lower(), sha256, dpi)
    with atomic_write(path) as fresh:
        fresh.write_bytes(content)


def figure_bytes(figure: Any, kind: str, sha256: str, dpi: float) -> bytes:
    """Return the file of a drawing.

    Parameters
    ----------
    figure, sha256, dpi
        As of :func:`save_figure`.
    kind
        One of :data:`FORMATS`.
    """
    metadata = {FORMATS[kind]: mark_of(sha256)} | _SAME.get(kind, {})
    more = {"svg.hashsalt": sha256, "pdf.fonttype": 42}  # 42: letters stay letters
    drawn = BytesIO()
    with style(**more):
        figure.savefig(drawn, dpi=dpi, format=kind.removeprefix("."), metadata=metadata)
    return drawn.getvalue()


def draw_signal(
    axes: Any, recording: Recording, topic: str | None, time_s: float, around_s: float
) -> None:
    """Draw a stream about a moment: all channels of the quantity of its first one.

    Parameters
    ----------
    axes
        Where.
    recording, topic
        Of what; None is the first stream.
    time_s
        The moment [s since the first sample].
    around_s
        What is drawn on each side [s].
    """
    stream = recording.streams[0] if topic is None else recording[topic]
    samples = stream.read(max(time_s - around_s, 0.0), time_s + around_s)
    axes.set_prop_cycle(color=[COLOURS[name] for name in SIGNALS])
    columns = [i for i, q in enumerate(stream.quantities) if q == stream.quantities[0]]
    for column in columns:
        label = samples.channels[column] if len(columns) <= MOST_NAMES else None
        axes.plot(samples.time_s, samples[:, column], lw=1, label=label)
    axes.set_xlim(max(time_s - around_s, 0.0), min(time_s + around_s, recording.duration_s))
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{stream.topic} [{stream.units[0]}]")


#: Colours of signals, in turn: none is one of what became of steps.
SIGNALS = ("result", "random", "chance", "ink")
#: So many channels are named one by one. Chosen by judgement: more hide the signal.
MOST_NAMES = 8


def draw_steps(axes: Any, steps: StepTimes, time_s: float, around_s: float) -> None:
    """Draw the steps about a moment over a signal, and say beside it what is what."""
    kinds = (("step", "hit"), ("missed step", "missed"), ("false step", "false"))
    for (name, colour), times in zip(kinds, steps, strict=True):
        near = [t for t in times if abs(t - time_s) <= around_s]
        for number, at_s in enumerate(near):
            label = None if number else name
            axes.axvline(at_s, color=COLOURS[colour], lw=1.4, label=label, zorder=1)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)


#: A bar ends at so many times its threshold. Chosen by judgement: the line at 1 stays in sight.
MOST_TIMES = 4.0


def _draw_gates(axes: Any, link: Chain | None) -> None:
    """Draw what each gate saw, as a part of its threshold: the line at 1."""
    if link is None or not link.readings:
        axes.set_axis_off()
        axes.text(0, 0.5, "no candidate", transform=axes.transAxes)
        return
    names, parts = [], []
    for r in link.readings:
        part = r.value / r.threshold if r.threshold else np.nan
        names.append(f"{r.gate} {r.value:.4g} / {r.threshold:.4g} {r.unit.removesuffix('1')}")
        parts.append(min(part, MOST_TIMES) if np.isfinite(part) else 0.0)
    colours = [COLOURS["hit" if r.passed else "missed"] for r in link.readings]
    bars = axes.barh(names, parts, height=0.6, color=colours)
    words = ["passed" if r.passed else "failed" for r in link.readings]
    axes.bar_label(bars, words, padding=4, fontsize="small")
    axes.axvline(1.0, color=COLOURS["ink"], lw=1)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set_xlim(0, max(2.0, *parts) * 1.15)
    axes.set_xlabel(f"value / threshold of {link.stage} at {link.time_s:.3f} s")
