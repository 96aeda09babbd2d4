"""The figures of a score."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .drawing import COLOURS, WIDE, Drawing
from .matching import metronome_f1, random_f1
from .page import shown
from .picks import ANSWER_S
from .vehicles import match_passes, scored_passes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from markupsafe import Markup
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, Label, Pass, TrackPoint
    from groundtrace_codecs.geometry import Geometry

    from .matching import StepMatch
    from .picks import PickResiduals
    from .positions import Places, PositionScore
    from .steps import StepScore
    from .tracks import Moment

    #: F1 of detections that know nothing: true times, spans, how many, tolerance [s].
    ChanceF1 = Callable[[NDArray[np.float64], NDArray[np.float64], int, float], float]

TIME = "Time since the first sample [s]"
#: Lengths that a row of the timeline may have [s]; the first ones only as its sole row.
ROW_S = (5, 10, 15, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200)
SOLE_S = 30
MOST_ROWS = 24


def tolerance_figure(score: StepScore, matching: StepMatch, start_ns: int) -> Markup:
    """Return F1 over tolerance, with what random and metronome detections would reach."""
    truth = (matching.truth_ns - start_ns) / NS_PER_S
    tolerances = [t for t, _ in score.curve]
    title = "F1 over tolerance, with two levels of chance"
    plot = Drawing(title, "Tolerance [ms]", "F1 (0 to 1)")

    def chance(f1: ChanceF1) -> list[float]:
        return [f1(truth, matching.spans, score.detected, t) for t in tolerances]

    f1_curve = [f1 for _, f1 in score.curve]
    for name, colour, style, values in (
        ("metronome", "chance", "--", chance(metronome_f1)),
        ("random", "random", ":", chance(random_f1)),
        ("this result", "result", "-", f1_curve),
    ):
        at_ms = 1e3 * np.array(tolerances)
        tips = [f"{name}: F1 {v:.3f} at {t:.0f} ms" for t, v in zip(at_ms, values, strict=True)]
        plot.line(at_ms, values, colour, style)
        plot.dots(at_ms, values, colour, tips)
    plot.mark(x=1e3 * score.tolerance_s)
    plot.axes.set(xlim=(0, 1.03e3 * tolerances[-1]), ylim=(-0.02, 1.03))
    return plot.svg()


def latency_figure(score: StepScore, matching: StepMatch) -> Markup:
    """Return the histogram of detection minus truth of the matched steps."""
    pairs = matching.pairs
    late = (matching.found_ns[pairs[:, 1]] - matching.truth_ns[pairs[:, 0]]) / 1e6
    widest = 1.2 * float(np.abs(late).max(initial=0.0))
    reach = min(1e3 * score.tolerance_s, max(10.0, widest))
    edges = np.linspace(-reach, reach, 25)
    counts, _ = np.histogram(late, edges)
    plot = Drawing("Histogram of latency", "Detection minus truth [ms]", "Steps [count]")
    ends = zip(edges, edges[1:], counts, strict=False)
    plot.bars(edges, counts, [f"{low:.0f} to {high:.0f} ms: {n}" for low, high, n in ends])
    plot.axes.axvline(0, color=COLOURS["soft"], linewidth=1)
    if score.latency_ms is not None:
        plot.mark(x=score.latency_ms.median)
    plot.axes.set(xlim=(-reach, reach), ylim=(0, max(4.0, 1.15 * float(counts.max()))))
    return plot.svg()


def timeline_figure(matching: StepMatch, start_ns: int, end_ns: int) -> Markup:
    """Return every scored step in rows of time: truth above, detections below the line.

    Rows in which nothing happens are left out.
    """
    length = max((end_ns - start_ns) / NS_PER_S, 1.0)
    rows = 1 if length <= SOLE_S else MOST_ROWS
    fitting = (r for r in ROW_S if r * rows >= length and r >= min(length, SOLE_S))
    row_s = next(fitting, length / MOST_ROWS)
    sides = [
        (times_ns, (times_ns - start_ns) / NS_PER_S, alone, wrong, what, lift)
        for times_ns, alone, wrong, what, lift in (
            (matching.truth_ns, matching.missed, "missed", "step", 0.2),
            (matching.found_ns, matching.false, "false", "detection", -0.2),
        )
    ]
    row_of = [np.clip(side[1] // row_s, 0, length // row_s).astype(int) for side in sides]
    used = np.unique(np.concatenate(row_of))
    label, side = "Time since the start of the row [s]", "Row from [s]"
    if row_s >= length:
        label, side = TIME, ""
    plot = Drawing("Steps over time", label, side, WIDE, 66 + 40 * max(len(used), 1))
    for row_index, row in enumerate(used):
        begin, end = row * row_s, (row + 1) * row_s
        inside = [(max(a, begin), min(b, end)) for a, b in matching.spans if a < end and b > begin]
        spans = [(a - begin, b - a) for a, b in inside]
        plot.axes.broken_barh(spans, (-row_index - 0.42, 0.84), color=COLOURS["scored"])
        plot.axes.axhline(-row_index, color=COLOURS["soft"], linewidth=0.8)
    for (_, seconds, alone, wrong, what, lift), rows_at in zip(sides, row_of, strict=True):
        missing = np.zeros(len(seconds), np.bool_)
        missing[alone] = True
        up = lift - np.searchsorted(used, rows_at)
        for colour, word, selected in (("hit", "matched", ~missing), (wrong, wrong, missing)):
            tips = [f"{what} at {t:.3f} s: {word}" for t in seconds[selected]]
            at = np.clip(seconds - rows_at * row_s, 0, row_s)[selected]
            width = 1.6 if colour == "hit" else 3.2
            plot.dots(at, up[selected], colour, tips, 14, marker="|", markeredgewidth=width)
    plot.axes.set(xlim=(-0.004 * row_s, 1.004 * row_s), ylim=(0.5 - max(len(used), 1), 0.5))
    if side:
        plot.axes.set_yticks(-np.arange(len(used)), [f"{row * row_s:g}" for row in used])
    else:
        plot.axes.set_yticks([0.2, -0.2], ["truth", "found"])
    plot.axes.grid(visible=False, axis="y")
    return plot.svg()


def pick_figure(residuals: PickResiduals) -> Markup:
    """Return the errors of the first picks, impact by impact; far ones at the edge."""
    errors, states = residuals.error_s * 1e3, np.array(residuals.states())
    abs_errors = np.abs(errors[~np.isnan(errors)])
    reach = float(
        np.clip(1.3 * np.percentile(abs_errors, 98) if len(abs_errors) else 1, 0.5, ANSWER_S * 1e3)
    )
    at, height = np.empty(len(errors)), np.where(np.isnan(errors), -1.05 * reach, errors)
    tips = [
        f"{residuals.impacts[i]}, {channel}: " + ("no pick" if np.isnan(e) else f"{e:+.2f} ms")
        for i, channel, e in zip(residuals.impact, residuals.channels, errors, strict=True)
    ]
    title = "Errors of picks by impact"
    plot = Drawing(title, "Impact [number]", "Pick minus arrival [ms]", WIDE, 300)
    plot.axes.axhline(0, color=COLOURS["soft"], linewidth=1)
    for i in range(len(residuals.impacts)):
        of = np.flatnonzero(residuals.impact == i)
        at[of] = i + 1 + 0.44 * (np.arange(len(of)) / max(len(of) - 1, 1) - 0.5)
        good = errors[of][states[of] != "missed"]
        if len(good):
            middle = float(np.clip(np.median(good), -reach, reach))
            plot.line([i + 0.75, i + 1.25], [middle, middle], "ink")
    none = np.isnan(errors)
    for colour, selected in (
        ("missed", none),
        ("false", ~none & (states == "missed")),
        ("result", ~none & (states != "missed")),
    ):
        selected_tips = [tip for tip, each in zip(tips, selected, strict=True) if each]
        plot.dots(
            at[selected], np.clip(height, -1.05 * reach, reach)[selected], colour, selected_tips
        )
    plot.axes.set(xlim=(0.4, len(residuals.impacts) + 0.6), ylim=(-1.15 * reach, 1.1 * reach))
    plot.axes.locator_params(axis="x", integer=True)
    plot.axes.grid(visible=False, axis="x")
    return plot.svg()


def error_figure(errors: NDArray[np.float64], score: PositionScore) -> Markup:
    """Return the errors of fixes in the plane, with the circles that hold 50 and 95 %."""
    from matplotlib.patches import Circle

    reach = 1.15 * float(max(np.abs(errors).max(initial=0.0), score.cep95_m or 0.0, 0.01))
    plot = _to_scale("Errors of position fixes", "Error in x [m]", "Error in y [m]")
    for zero in (plot.axes.axvline, plot.axes.axhline):
        zero(0, color=COLOURS["soft"], linewidth=1)
    tips = [f"{x:+.2f} m, {y:+.2f} m" for x, y in errors]
    plot.dots(errors[:, 0], errors[:, 1], "random", tips)
    for name, radius in (("CEP50", score.cep50_m), ("CEP95", score.cep95_m)):
        if radius is not None:
            ring = Circle((0, 0), radius, fill=False, edgecolor=COLOURS["ink"], linestyle="--")
            plot.axes.add_patch(ring)
            plot.tell(ring, [f"{name}: {radius:.2f} m"])
            plot.note(0.72 * radius, 0.72 * radius, name)
    if score.bias_x_m is not None and score.bias_y_m is not None:
        ring_style = {"markeredgewidth": 2.2, "markerfacecolor": "none"}
        plot.dots(score.bias_x_m, score.bias_y_m, "missed", ["mean error"], 10, **ring_style)
    plot.axes.update_datalim([(-reach, -reach), (reach, reach)])
    plot.axes.autoscale_view()
    return plot.svg()


def map_figure(
    truth: Places, fixes: Sequence[Fix], points: Sequence[TrackPoint], geometry: Geometry | None
) -> Markup:
    """Return truth, fixes, tracks and sensors in the plane, to scale."""
    plot = _to_scale("Map of truth, fixes and tracks", "x [m]", "y [m]")
    if geometry is not None:
        outline = np.array([*geometry.outline, *geometry.outline[:1]]).reshape(-1, 2)
        plot.line(outline[:, 0], outline[:, 1], "soft", linewidth=1.2)
        places = np.array([(s.x, s.y) for s in geometry.sensors], np.float64).reshape(-1, 2)
        names = [s.name for s in geometry.sensors]
        plot.dots(places[:, 0], places[:, 1], "soft", names, 8, marker="s")
    x, y = truth.xy.reshape(-1, 2).T
    plot.line(x, y, "hit", linewidth=1.2)
    plot.dots(x, y, "hit", [f"truth {x:.2f} m, {y:.2f} m" for x, y in truth.xy])
    for number in sorted({p.track for p in points}):
        track = np.array([(p.x_m, p.y_m) for p in points if p.track == number])
        plot.line(track[:, 0], track[:, 1], "result")
    tips = [f"fix {fix.x_m:.2f} m, {fix.y_m:.2f} m" for fix in fixes]
    plot.dots([fix.x_m for fix in fixes], [fix.y_m for fix in fixes], "random", tips)
    plot.axes.margins(0.06)
    return plot.svg()


def _to_scale(title: str, x: str, y: str) -> Drawing:
    """Return a figure in which a metre is as long in x as in y."""
    plot = Drawing(title, x, y, height=370)
    plot.axes.set_aspect("equal", adjustable="datalim")
    return plot


def distance_figure(moments: Sequence[Moment], start_ns: int) -> Markup:
    """Return OSPA and GOSPA over time."""
    seconds = [(m.time_ns - start_ns) / NS_PER_S for m in moments]
    plot = Drawing("OSPA and GOSPA over time", TIME, "Distance [m]")
    plot.line(seconds, [m.gospa_m for m in moments], "chance", "--")
    plot.line(seconds, [m.ospa_m for m in moments], "result")
    plot.axes.set_ylim(0, 1.1 * max(0.1, *(max(m.ospa_m, m.gospa_m) for m in moments)))
    return plot.svg()


def heading_figure(
    times_ns: NDArray[np.int64], errors_rad: NDArray[np.float64], start_ns: int
) -> Markup:
    """Return the error of the heading over time."""
    seconds, errors = (times_ns - start_ns) / NS_PER_S, np.degrees(errors_rad)
    plot = Drawing("Error of the heading over time", TIME, "Heading minus truth [deg]")
    plot.axes.axhline(0, color=COLOURS["soft"], linewidth=1)
    tips = [f"{t:.2f} s: {error:+.1f} deg" for t, error in zip(seconds, errors, strict=True)]
    plot.line(seconds, errors, "result", linewidth=1)
    plot.dots(seconds, errors, "result", tips, 4)
    return plot.svg()


def pass_figure(
    labels: Sequence[Label], passes: Sequence[Pass], span_ns: tuple[int, int]
) -> Markup:
    """Return true and found passes on a time axis, a row for each station.

    Parameters
    ----------
    labels, passes
        What was scored.
    span_ns
        First and last sample of the recording [ns].
    """
    truth, detected = scored_passes(labels, passes)
    matched_ids = {id(item) for pair in match_passes(truth, detected) for item in pair}
    stations = sorted({x.channel for x in truth} | {p.station for p in detected}, reverse=True)
    plot = Drawing("Every pass", TIME, "", WIDE, 80 + 42 * len(stations))
    marks: dict[str, list[tuple[float, float, str]]] = {}
    for x in truth:
        at_s, words = (x.time_ns - span_ns[0]) / NS_PER_S, shown(x.value, "m/s", 1)
        tip = f"{at_s:.2f} s: true, {x.target}, {x.label}, {words}"
        row = stations.index(x.channel) + 0.14
        marks.setdefault("hit" if id(x) in matched_ids else "missed", []).append((at_s, row, tip))
    for p in detected:
        at_s = (p.time_ns - span_ns[0]) / NS_PER_S
        words = f"vehicle {p.vehicle or 'untold'}, {p.direction or 'no direction'}"
        tip = f"{at_s:.2f} s: found, {words}, {p.speed_mps:.1f} m/s"
        row = stations.index(p.station) - 0.14
        marks.setdefault("result" if id(p) in matched_ids else "false", []).append((at_s, row, tip))
    for colour, of in marks.items():
        seconds, rows, tips = zip(*of, strict=True)
        plot.dots(seconds, rows, colour, tips, 9)
    plot.axes.set_yticks(range(len(stations)), stations)
    span_s = (span_ns[1] - span_ns[0]) / NS_PER_S
    plot.axes.set(xlim=(-0.01 * span_s, 1.01 * span_s), ylim=(-0.6, len(stations) - 0.4))
    return plot.svg()
