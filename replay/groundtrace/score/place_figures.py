"""Figures of picks, places, tracks and headings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .picks import ANSWER_S
from .svg import Axis, Plot, span_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, TrackPoint
    from groundtrace_codecs.geometry import Geometry

    from .picks import PickResiduals
    from .places import Places
    from .positions import PositionScore
    from .tracks import Moment

WIDE = 1160


def pick_figure(residuals: PickResiduals) -> str:
    """Return the errors of the first picks, impact by impact; far ones at the edge."""
    errors, states = residuals.error_s * 1e3, residuals.states()
    known = np.abs(errors[~np.isnan(errors)])
    reach = float(np.clip(1.3 * np.percentile(known, 98) if len(known) else 1, 0.5, ANSWER_S * 1e3))
    count = len(residuals.impacts)
    axis = Axis("Impact [number]", 0.4, count + 0.6)
    plot = Plot(axis, Axis("Pick minus arrival [ms]", -1.1 * reach, 1.1 * reach), WIDE, 300)
    plot.horizontal(0, "zero")
    for i, name in enumerate(residuals.impacts):
        of = np.flatnonzero(residuals.impact == i)
        good = errors[[k for k in of if states[k] != "missed"]]
        if len(good):
            middle = float(np.clip(np.median(good), -reach, reach))
            plot.line([(i + 0.75, middle), (i + 1.25, middle)], "median")
        for place, k in enumerate(of):
            x = i + 1 + 0.44 * (place / max(len(of) - 1, 1) - 0.5)
            title = f"{name}, {residuals.channels[k]}: "
            if np.isnan(errors[k]):
                plot.dot(x, -reach, "dot missed", title + "no pick")
                continue
            style = "dot false" if states[k] == "missed" else "dot result"
            y = float(np.clip(errors[k], -reach, reach))
            plot.dot(x, y, style, f"{title}{errors[k]:+.2f} ms", 2.6)
    return plot.svg("Errors of picks by impact")


def error_figure(errors: NDArray[np.float64], score: PositionScore) -> str:
    """Return the errors of fixes in the plane, with the circles that hold 50 and 95 %."""
    reach = 1.15 * float(max(np.abs(errors).max(initial=0.0), score.cep95_m or 0.0, 0.01))
    plot = _to_scale(Axis("Error in x [m]", -reach, reach), Axis("Error in y [m]", -reach, reach))
    plot.vertical(0, "zero")
    plot.horizontal(0, "zero")
    names: list[tuple[float, float, str]] = []
    for name, radius in (("CEP50", score.cep50_m), ("CEP95", score.cep95_m)):
        if radius is not None:
            size = plot.px(radius) - plot.px(0)
            title = f"{name}: {radius:.2f} m"
            plot.add("circle", "ring", title, cx=plot.px(0), cy=plot.py(0), r=size)
            names.append((plot.px(0) + 0.72 * size, plot.py(0) - 0.72 * size, name))
    for x, y in errors:
        plot.dot(float(x), float(y), "dot fix", f"{x:+.2f} m, {y:+.2f} m")
    if score.bias_x_m is not None and score.bias_y_m is not None:
        plot.dot(score.bias_x_m, score.bias_y_m, "dot bias", "mean error", 5)
    for across, down, name in names:
        plot.text(across, down, name)
    return plot.svg("Errors of position fixes")


def map_figure(
    truth: Places,
    fixes: Sequence[Fix],
    points: Sequence[TrackPoint],
    geometry: Geometry | None,
) -> str:
    """Return truth, fixes, tracks and sensors in the plane, to scale."""
    outline = [*geometry.outline, *geometry.outline[:1]] if geometry is not None else []
    sensors = geometry.sensors if geometry is not None else ()
    everything = [
        *truth.xy.tolist(),
        *((e.x_m, e.y_m) for e in fixes),
        *((e.x_m, e.y_m) for e in points),
        *outline,
        *((s.x, s.y) for s in sensors),
    ]
    xy = np.array(everything, np.float64)
    plot = _to_scale(span_of(xy[:, 0], "x [m]", 1.0), span_of(xy[:, 1], "y [m]", 1.0))
    plot.line(outline, "outline")
    for s in sensors:
        plot.add(
            "rect", "sensor", s.name, x=plot.px(s.x) - 4, y=plot.py(s.y) - 4, width=8, height=8
        )
    plot.line(truth.xy, "truth")
    for x, y in truth.xy:
        plot.dot(float(x), float(y), "dot truth", f"truth {x:.2f} m, {y:.2f} m")
    for number in sorted({p.track for p in points}):
        plot.line([(p.x_m, p.y_m) for p in points if p.track == number], "result")
    for fix in fixes:
        plot.dot(fix.x_m, fix.y_m, "dot fix", f"fix {fix.x_m:.2f} m, {fix.y_m:.2f} m", 2.6)
    return plot.svg("Map of truth, fixes and tracks")


def _to_scale(x: Axis, y: Axis) -> Plot:
    """Return a plot that holds both axes and in which a metre is as long in x as in y."""
    plot = Plot(x, y, 560, 404)
    across = plot.px(x.high) - plot.px(x.low)
    upward = plot.py(y.low) - plot.py(y.high)
    metre = min(across / (x.high - x.low), upward / (y.high - y.low))
    plot.x, plot.y = _stretched(x, across / metre), _stretched(y, upward / metre)
    return plot


def _stretched(axis: Axis, length: float) -> Axis:
    extra = (length - (axis.high - axis.low)) / 2
    return Axis(axis.label, axis.low - extra, axis.high + extra)


def distance_figure(found: Sequence[Moment], start_ns: int) -> str:
    """Return OSPA and GOSPA over time."""
    seconds = np.array([(m.time_ns - start_ns) / NS_PER_S for m in found])
    top = 1.1 * max(0.1, *(max(m.ospa_m, m.gospa_m) for m in found))
    x = span_of(seconds, "Time since the first sample [s]", 1.0)
    plot = Plot(x, Axis("Distance [m]", 0, top))
    plot.line(zip(seconds, (m.gospa_m for m in found), strict=True), "metronome")
    plot.line(zip(seconds, (m.ospa_m for m in found), strict=True), "result")
    return plot.svg("OSPA and GOSPA over time")


def heading_figure(
    times_ns: NDArray[np.int64], errors_rad: NDArray[np.float64], start_ns: int
) -> str:
    """Return the error of the heading over time."""
    seconds = (times_ns - start_ns) / NS_PER_S
    errors = np.degrees(errors_rad)
    x = span_of(seconds, "Time since the first sample [s]", 1.0)
    plot = Plot(x, span_of(np.append(errors, 0.0), "Heading minus truth [deg]", 2.0))
    plot.horizontal(0, "zero")
    plot.line(zip(seconds, errors, strict=True), "result")
    for t, error in zip(seconds, errors, strict=True):
        if np.isfinite(error):
            plot.dot(float(t), float(error), "dot result", f"{t:.2f} s: {error:+.1f} deg", 2.2)
    return plot.svg("Error of the heading over time")
