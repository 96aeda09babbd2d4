"""Plots of F1 over one swept parameter, or over two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..score.svg import Axis as PlotAxis
from ..score.svg import Plot, span_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .grid import Axis, Grid
    from .ranking import Ranked

WIDTH, HEIGHT = 540, 340
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


def that_matter(grid: Grid, f1: NDArray[np.float64]) -> list[int]:
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
    plot = Plot(bins.plot_axis, span_of(best, "F1", 0.05), WIDTH, HEIGHT)
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
    plot = Plot(x.plot_axis, y.plot_axis, WIDTH - 52, HEIGHT)
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
