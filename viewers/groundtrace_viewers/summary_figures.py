"""The figures of a summary, as inline SVG in the colours of the score's page."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.score.picks import pick_residuals
from groundtrace.score.place_figures import map_figure, pick_figure
from groundtrace.score.places import true_places
from groundtrace.score.report import last_word
from groundtrace.score.step_figures import timeline_figure, tolerance_figure
from groundtrace.score.svg import Axis, Plot, span_of
from groundtrace.score.turn import turn_onto
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.score.places import Places
    from groundtrace_codecs.events import TrackPoint

    from .share_sources import Sources

#: Longer pauses between steps are no rhythm [s].
PAUSE_S = 2.0


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure: SVG, what to say below it, and what its colours stand for."""

    svg: str
    caption: str
    keys: dict[str, str] = field(default_factory=dict)


def place_map(sources: Sources) -> Drawn | None:
    """Return truth, places and tracks on the plan, to scale; None where no place was found."""
    said, geometry = sources.said, sources.results.geometry
    truth = true_places(sources.labels)
    fixes = last_word(said.fixes)
    if not (fixes or said.points):
        return None
    caption = ""
    if sources.free:
        truth = _turned(truth, said.points)
        caption = "The track begins and heads anywhere: the truth is turned and shifted onto it."
    keys = {"truth": "truth"} if len(truth) else {}
    keys |= {"fix": f"places of {fixes[0].stage}"} if fixes else {}
    keys |= {"result": f"track of {said.points[0].stage}"} if said.points else {}
    keys |= {"sensor": "sensors"} if geometry is not None and geometry.sensors else {}
    return Drawn(map_figure(truth, fixes, said.points, geometry), caption, keys)


def _turned(truth: Places, points: Sequence[TrackPoint]) -> Places:
    """Return the truth turned and shifted onto the only track, where both are at its times."""
    ordered = sorted(points, key=lambda point: point.time_ns)
    since = np.array([point.time_ns - ordered[0].time_ns for point in ordered], np.float64)
    at = (truth.time_ns - ordered[0].time_ns).astype(np.float64)
    columns = ([p.x_m for p in ordered], [p.y_m for p in ordered])
    tracked = np.column_stack([np.interp(at, since, column) for column in columns])
    during = (at >= since[0]) & (at <= since[-1])
    if during.sum() < 2:
        return truth
    return replace(truth, xy=turn_onto(truth.xy[during], tracked[during])(truth.xy))


def pick_plot(sources: Sources) -> Drawn | None:
    """Return the errors of arrivals, impact by impact; None without true ones."""
    score = sources.score.picks
    if score is None or not score.all.truth:
        return None
    keys = {"result": "answered", "false": "more than 50 ms off", "missed": "no pick"}
    drawn = pick_figure(pick_residuals(sources.labels, sources.said.picks))
    return Drawn(drawn, "Channels side by side.", keys | {"median": "median"})


def tolerance_plot(sources: Sources) -> Drawn | None:
    """Return F1 over tolerance beside two levels of chance; None without true steps."""
    score, matching = sources.score.steps, sources.matching
    if score is None or matching is None:
        return None
    keys = {"result": "this result", "metronome": "blind metronome", "random": "random times"}
    start_ns = sources.results.provenance.start_ns
    drawn = tolerance_figure(score, matching, start_ns)
    return Drawn(drawn, "What counts is the distance to chance.", keys)


def steps_plot(sources: Sources) -> Drawn | None:
    """Return every step and what became of it; None without true steps."""
    matching, origin = sources.matching, sources.results.provenance
    if matching is None:
        return None
    keys = {"hit": "matched", "missed": "missed", "false": "false"}
    drawn = timeline_figure(matching, origin.start_ns, origin.end_ns)
    return Drawn(drawn, "Shaded time is scored. Rest the mouse on a stroke for its time.", keys)


def interval_plot(sources: Sources) -> Drawn | None:
    """Return the time from step to step, in which missed and doubled steps stand out."""
    start_ns = sources.results.provenance.start_ns
    since = np.array([step.time_ns - start_ns for step in sources.said.steps], np.int64)
    times = np.sort(since) / NS_PER_S
    apart = np.diff(times)
    kept = (apart > 0) & (apart <= PAUSE_S)
    if not kept.any():
        return None
    ends, lengths = times[1:][kept], apart[kept]
    x = span_of(ends, "Time since the first sample [s]", 1.0)
    plot = Plot(x, Axis("From step to step [s]", 0.0, 1.15 * float(lengths.max())))
    middle = float(np.median(lengths))
    plot.horizontal(middle, "mark")
    for at, length in zip(ends, lengths, strict=True):
        plot.dot(float(at), float(length), "dot result", f"{at:.2f} s: {length:.3f} s later", 2.6)
    said = f"Broken line: median {middle:.2f} s. Pauses of more than {PAUSE_S:g} s are left out."
    return Drawn(plot.svg("Time from step to step"), said)
