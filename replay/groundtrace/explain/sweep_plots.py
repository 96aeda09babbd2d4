"""The figure of a sweep: misses against false steps, and F1 over the swept parameters."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation.html import Axis as PlotAxis
from ..evaluation.html import Plot, element, number, span_of, text
from .sweep import f1_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .redecide import Axis, Grid
    from .sweep import Counted, Ranked, Ranking

WIDTH, HEIGHT, HEAD, FOOT, GAP = 540, 340, 74, 40, 30
STYLE = """
svg{font:13px system-ui,-apple-system,'Segoe UI',sans-serif}.paper{fill:#fff}
.tick,.note{fill:#5c6673;font-size:12px}.label{fill:#1b2028;font-size:13px}
.title{fill:#1b2028;font-size:17px;font-weight:600}.sub{fill:#5c6673;font-size:13px}
.panel{fill:#1b2028;font-size:14px;font-weight:600}
.mid{text-anchor:middle}.end{text-anchor:end}
.grid{stroke:#e3e7ec}.line{fill:none;stroke-width:2.2;stroke-linejoin:round}
.line.front{stroke:#0072b2}.line.along{stroke:#0072b2}
.dot.tried{fill:#aab4bf}.dot.front{fill:#0072b2}.dot.along{fill:#0072b2}
.dot.now{fill:#fff;stroke:#1b2028;stroke-width:2}
.dot.best{fill:#d1480f;stroke:#fff;stroke-width:1.5}.ring{fill:none;stroke:#d1480f;stroke-width:2.5}
"""


def sweep_figure(counted: Counted, ranking: Ranking) -> str:
    """Return the figure as an SVG document that stands alone.

    Left, every outcome as missed against false steps, with the front that no setting beats; right,
    F1 over the parameter, or over the two that matter most, each with the best of the others.
    """
    width, height = 2 * WIDTH + GAP, HEAD + HEIGHT + FOOT
    best = ranking.best
    title = f"{len(counted.grid)} settings on {', '.join(ranking.recordings)}"
    chosen = ", ".join(f"{name} {shown(value)}" for name, value in best.settings.items())
    said = (
        f"best F1 {best.f1:.3f} (90 %: {best.interval.low:.3f} to {best.interval.high:.3f}) at "
        f"{chosen}; as it is {ranking.now.f1:.3f}"
    )
    parts = [
        f'<rect class="paper" width="{width}" height="{height}"/>',
        text(14, 26, title, "title"),
        text(14, 47, said, "sub"),
        *_panel(front_plot(counted, ranking), 0, f"Missed against false {ranking.counted}"),
        *_parameters(counted, ranking),
        *_legend(height - 12),
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'
        f"<style>{STYLE}</style>{''.join(parts)}</svg>\n"
    )


def shown(value: Any) -> str:
    """Return a parameter's value as short text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _panel(plot: Plot, x: int, title: str) -> list[str]:
    """Return a plot as a part of a larger picture, with its title above."""
    place = f'<svg x="{x}" y="{HEAD}" width="{plot.width}" height="{plot.height}" '
    return [text(x + 14, HEAD - 2, title, "panel"), plot.svg(title).replace("<svg ", place, 1)]


def _parameters(counted: Counted, ranking: Ranking) -> list[str]:
    """Return the right half: a line over one parameter, or a map over two."""
    f1 = f1_of(counted.counts.sum(axis=0))
    axes = most_influential(counted.grid, f1)
    others = ", best of the others" if len(counted.grid.axes) > len(axes) else ""
    bins = [binned(counted.grid, i) for i in axes]
    shown_at = (ranking.now, ranking.best)
    if len(axes) == 1:
        marks = [(bins_place(bins[0], r), r.f1) for r in shown_at]
        plot = curve(bins[0], f1, marks)
        return _panel(plot, WIDTH + GAP, f"F1 over the parameter{others}")
    marks = [(bins_place(bins[0], r), bins_place(bins[1], r)) for r in shown_at]
    plot, low, high = heat_map(bins[0], bins[1], f1, marks)
    bar = _colour_bar(WIDTH + GAP + plot.width + 2, low, high)
    return [*_panel(plot, WIDTH + GAP, f"F1 over two parameters{others}"), *bar]


def _legend(y: float) -> list[str]:
    def key(x: float, style: str, words: str) -> str:
        mark = f'<circle class="dot {style}" cx="{number(x)}" cy="{number(y - 4)}" r="5"/>'
        return mark + text(x + 11, y, words)

    names = ("tried", "front", "best", "now")
    words = ("tried", "not beaten by any", "best", "pipeline as it is")
    places = (64, 124, 262, 318)
    return [key(x, name, said) for x, name, said in zip(places, names, words, strict=True)]


def front_plot(counted: Counted, ranking: Ranking) -> Plot:
    """Draw around the front; what is far worse is left out."""
    total = counted.counts.sum(axis=0)
    front = ranking.front
    marked = [(r.fp, r.fn) for r in (ranking.best, ranking.now)] + [
        (p.false, p.missed) for p in front
    ]
    reach_false = 1.25 * max(x for x, _ in marked) + 4
    reach_missed = 1.25 * max(y for _, y in marked) + 4
    plot = Plot(
        PlotAxis(f"false {ranking.counted}", -0.04 * reach_false, reach_false),
        PlotAxis(f"missed {ranking.counted}", -0.04 * reach_missed, reach_missed),
        WIDTH,
        HEIGHT,
    )
    pairs, times = np.unique(total[:, 1:], axis=0, return_counts=True)
    for (false, missed), n in zip(pairs.tolist(), times.tolist(), strict=True):
        if false <= reach_false and missed <= reach_missed:
            plot.dot(false, missed, "dot tried", f"{n} settings: {missed} missed, {false} false")
    corners = [(p.false, p.missed) for p in front]
    steps = [corners[:1], *([(b[0], a[1]), b] for a, b in pairwise(corners))]
    plot.line([point for step in steps for point in step], "front")
    for point in front:
        words = f"{point.missed} missed, {point.false} false, F1 {point.f1:.3f}"
        plot.dot(point.false, point.missed, "dot front", words, 4.5)
    plot.dot(ranking.now.fp, ranking.now.fn, "dot now", "the pipeline as it is", 8)
    plot.dot(ranking.best.fp, ranking.best.fn, "dot best", "the best", 6)
    return plot


def _colour_bar(x: float, low: float, high: float) -> list[str]:
    """Return the scale of F1."""
    top, length, parts = HEAD + 14, HEIGHT - 58, []
    for k in range(50):
        y, tall = top + length * (49 - k) / 50, length / 50 + 0.5
        parts.append(element("rect", "bar", x=x, y=y, width=14, height=tall, fill=colour(k / 49)))
    for part in (0.0, 0.5, 1.0):
        y = top + length * (1 - part) + 4
        parts.append(text(x + 19, y, f"{low + part * (high - low):.2f}", "tick"))
    return [*parts, text(x - 2, top + length + 24, "F1", "label")]


PLOT_WIDTH, PLOT_HEIGHT = 540, 340
#: Colours of F1 from the least to the most, ever darker, so that they can be read in grey too.
SCALE = ("#f2f5f8", "#d3e2ee", "#a6c8e0", "#6ba6cd", "#3381b5", "#14588f", "#08335c")
#: A parameter with more values than this is cut into so many bins.
MOST_VALUES, BINS = 60, 12
#: Ranges shorter than this are drawn in thousandths.
SHORT = 0.1
#: Of the dots for what stands and for the best: one is seen around the other [px].
RADII = {"now": 8.0, "best": 5.5}


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A parameter as an axis of a plot.

    Attributes
    ----------
    axis
        The parameter.
    scale
        What its values are multiplied by to be drawn.
    edges
        Shape (m + 1,): where its bins end, as drawn.
    centres
        Shape (m,).
    cell
        Shape (n_settings,): the bin of each setting.
    """

    axis: Axis
    scale: float
    edges: NDArray[np.float64]
    centres: NDArray[np.float64]
    cell: NDArray[np.intp]

    @property
    def plot_axis(self) -> PlotAxis:
        """The axis with its name and unit."""
        unit = "" if self.axis.unit in ("", "1") else self.axis.unit
        if self.scale != 1:
            unit = "ms" if unit == "s" else f"{unit}/1000"
        label = f"{self.axis.name} [{unit}]" if unit else self.axis.name
        return PlotAxis(label, float(self.edges[0]), float(self.edges[-1]))


def binned(grid: Grid, index: int) -> Bins:
    """Return a parameter's values, or bins of them where there are many."""
    axis = grid.axes[index]
    numbers = np.array([_number(axis, row[index]) for row in grid.rows], np.float64)
    scale = 1000.0 if np.ptp(numbers) < SHORT and np.abs(numbers).max() < 1 else 1.0
    numbers = numbers * scale
    known, cell = np.unique(numbers, return_inverse=True)
    if len(known) > MOST_VALUES:
        edges = np.linspace(known[0], known[-1], BINS + 1)
        cell = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, BINS - 1)
        return Bins(axis, scale, edges, (edges[1:] + edges[:-1]) / 2, cell)
    between = (known[1:] + known[:-1]) / 2
    half = (known[1] - known[0], known[-1] - known[-2]) if len(known) > 1 else (1.0, 1.0)
    edges = np.concatenate([[known[0] - half[0] / 2], between, [known[-1] + half[1] / 2]])
    return Bins(axis, scale, edges, known, cell)


def _number(axis: Axis, value: Any) -> float:
    """Return a value, or its place in the list where it is no number."""
    return float(value) if axis.numeric else float(axis.values.index(value))


def bins_place(bins: Bins, ranked: Ranked) -> float:
    """Return where a ranked setting lies on the axis; NaN where it is not on it."""
    value = ranked.settings[bins.axis.name]
    if not bins.axis.numeric and value not in bins.axis.values:
        return float("nan")
    place = _number(bins.axis, value) * bins.scale
    return place if bins.edges[0] <= place <= bins.edges[-1] else float("nan")


def most_influential(grid: Grid, f1: NDArray[np.float64]) -> list[int]:
    """Return the one or two parameters along which the best F1 changes most, in their order."""
    several = [i for i, axis in enumerate(grid.axes) if len(axis.values) > 1] or [0]
    change = {i: np.ptp(best_in(binned(grid, i).cell, f1)) for i in several}
    return sorted(sorted(several, key=lambda i: -change[i])[:2])


def best_in(cell: NDArray[np.intp], f1: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the best F1 in each cell; NaN where there is no setting."""
    best = np.full(int(cell.max()) + 1, -1.0)
    np.maximum.at(best, cell, f1)
    return np.where(best < 0, np.nan, best)


def colour(part: float) -> str:
    """Return the colour of a part of the scale, 0 to 1."""
    place = min(max(part, 0.0), 1.0) * (len(SCALE) - 1)
    low = min(int(place), len(SCALE) - 2)
    ends = [[int(SCALE[low + k][i : i + 2], 16) for i in (1, 3, 5)] for k in (0, 1)]
    mixed = [round(a + (place - low) * (b - a)) for a, b in zip(*ends, strict=True)]
    return "#" + "".join(f"{level:02x}" for level in mixed)


def curve(bins: Bins, f1: NDArray[np.float64], marks: Sequence[tuple[float, float]]) -> Plot:
    """Return the best F1 over one parameter; ``marks`` are what stands and the best."""
    best = np.full(len(bins.centres), np.nan)
    found = best_in(bins.cell, f1)
    best[: len(found)] = found
    plot = Plot(bins.plot_axis, span_of(best, "F1", 0.05), PLOT_WIDTH, PLOT_HEIGHT)
    points = list(zip(bins.centres.tolist(), best.tolist(), strict=True))
    plot.line(points, "along")
    for x, y in points:
        if np.isfinite(y):
            plot.dot(x, y, "dot along", f"{bins.axis.name} {x:.4g}: F1 {y:.3f}", 3)
    for (x, y), style in zip(marks, ("now", "best"), strict=True):
        if np.isfinite(x) and plot.y.low <= y <= plot.y.high:
            plot.dot(x, y, f"dot {style}", radius=RADII[style])
    return plot


def heat_map(
    x: Bins, y: Bins, f1: NDArray[np.float64], marks: Sequence[Sequence[float]]
) -> tuple[Plot, float, float]:
    """Return the best F1 over two parameters, and the ends of its scale."""
    plot = Plot(x.plot_axis, y.plot_axis, PLOT_WIDTH - 52, PLOT_HEIGHT)
    columns = len(x.centres)
    best = best_in(y.cell * columns + x.cell, f1)
    low, high = float(np.nanmin(best)), float(np.nanmax(best))
    for place, value in enumerate(best.tolist()):
        if np.isfinite(value):
            row, column = divmod(place, columns)
            left, right = plot.px(x.edges[column]), plot.px(x.edges[column + 1])
            floor, top = plot.py(y.edges[row]), plot.py(y.edges[row + 1])
            words = f"{x.centres[column]:.4g}, {y.centres[row]:.4g}: F1 {value:.3f}"
            shade = colour((value - low) / ((high - low) or 1))
            plot.add(
                "rect", "cell", words, x=left, y=top, width=right - left + 0.4,
                height=floor - top + 0.4, fill=shade,
            )  # fmt: skip
    for (a, b), style in zip(marks, ("now", "best"), strict=True):
        if np.isfinite(a) and np.isfinite(b):
            plot.dot(a, b, f"dot {style}", radius=RADII[style])
    return plot, low, high
