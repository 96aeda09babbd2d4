"""Drawings of a moment with matplotlib, where nobody has a viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.location import is_url

from ..errors import RecordingError
from ..pipeline.results import recording_in
from .recording import Recording, open_recording
from .tables import needed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..explain.reasons import Chain

#: Signal that is drawn on each side of a moment [s]. Chosen by judgement: three steps to either
#: side.
AROUND_S = 2.0
#: Colours of what passed, what failed, and what is true.
PASSED, FAILED, TRUE = "#2a7f3f", "#c0392b", "#555555"


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
    url = next((place for place in places if is_url(place)), None)
    path = url or recording_in(places, sha256)
    if path is None:
        raise RecordingError(f"{name}: expected the recording to draw, found no file of its bytes")
    return open_recording(path)


def plot_moment(recording: Recording, time_s: float, chain: Sequence[Chain], text: str) -> Any:
    """Draw the signal about a moment with its candidates, and below the gates of the nearest.

    Parameters
    ----------
    recording
        The recording.
    time_s
        The moment [s since the first sample].
    chain
        Candidates about it.
    text
        What stands above.

    Returns
    -------
    Two ``matplotlib.axes.Axes``, as an array: signal, gates.
    """
    pyplot = needed("matplotlib.pyplot", "plot")
    _, axes = pyplot.subplots(2, 1, figsize=(9, 5), height_ratios=(3, 2), layout="constrained")
    topics = {stream.topic for stream in recording.streams}
    topic = next((link.topic for link in chain if link.topic in topics), None)
    draw_signal(axes[0], recording, topic, time_s)
    for link in chain:
        axes[0].axvline(link.time_s, color=PASSED if link.accepted else FAILED, lw=1)
    axes[0].set_title(text or f"{recording.name} at {time_s:.3f} s", loc="left", fontsize="medium")
    nearest = min(chain, key=lambda link: abs(link.time_s - time_s), default=None)
    _draw_gates(axes[1], nearest)
    return axes


def draw_signal(
    axes: Any, recording: Recording, topic: str | None, time_s: float, around_s: float = AROUND_S
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
    for column, channel in enumerate(samples.channels):
        if stream.quantities[column] == stream.quantities[0]:
            axes.plot(samples.time_s, samples[:, column], lw=0.8, label=channel)
    axes.axvline(time_s, color=TRUE, ls="--", lw=1)
    axes.set_xlim(time_s - around_s, time_s + around_s)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{stream.topic} [{stream.units[0]}]")
    if len(axes.lines) <= 8:
        axes.legend(loc="upper right", fontsize="small")


def _draw_gates(axes: Any, link: Chain | None) -> None:
    """Draw what each gate saw, as a part of its threshold: the line at 1."""
    if link is None or not link.readings:
        axes.set_axis_off()
        axes.text(0, 0.5, "no candidate", transform=axes.transAxes)
        return
    names, parts, colours = [], [], []
    for r in link.readings:
        part = r.value / r.threshold if r.threshold else np.nan
        names.append(f"{r.gate} {r.value:.4g} / {r.threshold:.4g} {r.unit.removesuffix('1')}")
        parts.append(part if np.isfinite(part) else 0.0)
        colours.append(PASSED if r.passed else FAILED)
    axes.barh(names, parts, color=colours)
    axes.axvline(1.0, color=TRUE, lw=1)
    axes.invert_yaxis()
    axes.set_xlim(0, min(max(2.0, *parts) * 1.05, 5.0))
    axes.set_xlabel(f"value / threshold of {link.stage} at {link.time_s:.3f} s")
