"""The figure of a sweep: misses against false steps, and F1 over the swept parameters."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation.drawing import COLOURS, Drawing, style
from .sweep import f1_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .redecide import Axis, Grid
    from .sweep import Counted, Ranked, Ranking

WIDTH, HEIGHT = 1100, 440
#: Letters to a line of what stands above.
LINE = 150
#: Colours of F1 from the least to the most, ever darker, so that they can be read in grey too.
SCALE = ("#f2f5f8", "#d3e2ee", "#a6c8e0", "#6ba6cd", "#3381b5", "#14588f", "#08335c")
SHADES = 40
#: A parameter with more values than this is cut into so many bins.
MOST_VALUES, BINS = 60, 12
#: Ranges shorter than this are drawn in thousandths.
SHORT = 0.1


def sweep_figure(counted: Counted, ranking: Ranking) -> str:
    """Return the figure as an SVG document that stands alone.

    Left, every outcome as missed against false steps, with the front that no setting beats; right,
    F1 over the parameter, or over the two that matter most, each with the best of the others.
    """
    best = ranking.best
    title = f"{len(counted.grid)} settings on {', '.join(ranking.recordings)}"
    chosen = ", ".join(f"{name} {shown(value)}" for name, value in best.settings.items())
    subtitle = (
        f"best F1 {best.f1:.3f} (90 %: {best.interval.low:.3f} to {best.interval.high:.3f}) at "
        f"{chosen}; as it is {ranking.now.f1:.3f}"
    )
    with style():
        plot = Drawing(title, width=WIDTH, height=HEIGHT, panels=2)
        plot.figure.suptitle(f"{fill(title, LINE)}\n{fill(subtitle, LINE)}", x=0.006, ha="left")
        _front(plot, counted, ranking)
        plot.figure.legend(loc="outside lower left", ncols=4, frameon=False)
        plot.axes = plot.panels[1]
        _parameters(plot, counted, ranking)
        return plot.svg(alone=True) + "\n"


def shown(value: Any) -> str:
    """Return a parameter's value as short text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _front(plot: Drawing, counted: Counted, ranking: Ranking) -> None:
    """Draw around the front; what is far worse is left out."""
    front, best, now = ranking.front, ranking.best, ranking.now
    marked = np.array([(r.fp, r.fn) for r in (best, now)] + [(p.false, p.missed) for p in front])
    reach = 1.25 * marked.max(axis=0) + 4
    pairs, times = np.unique(counted.counts.sum(axis=0)[:, 1:], axis=0, return_counts=True)
    near = (pairs <= reach).all(axis=1)
    (false, missed), times = pairs[near].T, times[near]
    tried = zip(false, missed, times, strict=True)
    tips = [f"{n} settings: {m} missed, {f} false" for f, m, n in tried]
    plot.dots(false, missed, "chance", tips, 5, label="tried", alpha=0.6)
    tips = [f"{p.missed} missed, {p.false} false, F1 {p.f1:.3f}" for p in front]
    x, y = np.array([(p.false, p.missed) for p in front]).reshape(-1, 2).T
    plot.line(x, y, "result", drawstyle="steps-post")
    plot.dots(x, y, "result", tips, 8, label="not beaten by any")
    _stand_and_best(plot, (now.fp, now.fn), (best.fp, best.fn))
    plot.axes.set(
        title=f"Missed against false {ranking.counted}",
        xlabel=f"false {ranking.counted}",
        ylabel=f"missed {ranking.counted}",
        xlim=(-0.04 * reach[0], reach[0]),
        ylim=(-0.04 * reach[1], reach[1]),
    )


def _stand_and_best(plot: Drawing, now: tuple[float, float], best: tuple[float, float]) -> None:
    """Mark where the pipeline stands and the best setting: one is seen around the other."""
    ring: dict[str, Any] = {"markerfacecolor": COLOURS["paper"], "markeredgewidth": 2}
    tips = ["the pipeline as it is"], ["the best"]
    plot.dots(*now, "ink", tips[0], 14, label="pipeline as it is", **ring)
    edge: dict[str, Any] = {"markeredgecolor": COLOURS["paper"], "markeredgewidth": 1.2}
    plot.dots(*best, "missed", tips[1], 9, label="best", **edge)


def _parameters(plot: Drawing, counted: Counted, ranking: Ranking) -> None:
    """Draw the right half: a line over one parameter, or a map over two."""
    f1 = f1_of(counted.counts.sum(axis=0))
    axes = most_influential(counted.grid, f1)
    others = ", best of the others" if len(counted.grid.axes) > len(axes) else ""
    bins = [binned(counted.grid, i) for i in axes]
    if len(axes) == 1:
        plot.axes.set_title(f"F1 over the parameter{others}")
        _curve(plot, bins[0], f1, ranking)
    else:
        plot.axes.set_title(f"F1 over two parameters{others}")
        _heat_map(plot, bins[0], bins[1], f1, ranking)


def _curve(plot: Drawing, bins: Bins, f1: NDArray[np.float64], ranking: Ranking) -> None:
    """Draw the best F1 over one parameter."""
    best = np.full(len(bins.centres), np.nan)
    best_f1 = best_in(bins.cell, f1)
    best[: len(best_f1)] = best_f1
    name = bins.axis.name
    tips = [f"{name} {x:.4g}: F1 {y:.3f}" for x, y in zip(bins.centres, best, strict=True)]
    plot.line(bins.centres, best, "result")
    plot.dots(bins.centres, best, "result", tips, 6)
    marks = [(bins_place(bins, r), r.f1) for r in (ranking.now, ranking.best)]
    _stand_and_best(plot, *marks)
    plot.axes.set(xlabel=bins.label, ylabel="F1", xlim=bins.edges[[0, -1]])


def _heat_map(plot: Drawing, x: Bins, y: Bins, f1: NDArray[np.float64], ranking: Ranking) -> None:
    """Draw the best F1 over two parameters, with the scale of its colours."""
    from matplotlib.colors import LinearSegmentedColormap

    columns = len(x.centres)
    best = np.full(len(y.centres) * columns, np.nan)
    best_f1 = best_in(y.cell * columns + x.cell, f1)
    best[: len(best_f1)] = best_f1
    tips = [
        ""
        if np.isnan(value)
        else f"{x.centres[cell % columns]:.4g}, {y.centres[cell // columns]:.4g}: F1 {value:.3f}"
        for cell, value in enumerate(best)
    ]
    shades = LinearSegmentedColormap.from_list("F1", SCALE, SHADES)
    cells = plot.axes.pcolormesh(
        x.edges, y.edges, best.reshape(-1, columns), cmap=shades, edgecolors="face"
    )
    plot.tell(cells, tips)
    scale = plot.figure.colorbar(cells, ax=plot.axes, label="F1")
    scale.outline.set_visible(False)
    if scale.solids is not None:
        scale.solids.set_edgecolor("face")
    marks = [(bins_place(x, r), bins_place(y, r)) for r in (ranking.now, ranking.best)]
    _stand_and_best(plot, *marks)
    plot.axes.set(xlabel=x.label, ylabel=y.label)
    plot.axes.grid(visible=False)


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
    def label(self) -> str:
        """Its name and unit."""
        unit = "" if self.axis.unit in ("", "1") else self.axis.unit
        if self.scale != 1:
            unit = "ms" if unit == "s" else f"{unit}/1000"
        return f"{self.axis.name} [{unit}]" if unit else self.axis.name


def binned(grid: Grid, index: int) -> Bins:
    """Return a parameter's values, or bins of them where there are many."""
    axis = grid.axes[index]
    numbers = np.array([_number(axis, row[index]) for row in grid.rows], np.float64)
    scale = 1000.0 if np.ptp(numbers) < SHORT and np.abs(numbers).max() < 1 else 1.0
    numbers = numbers * scale
    distinct, cell = np.unique(numbers, return_inverse=True)
    if len(distinct) > MOST_VALUES:
        edges = np.linspace(distinct[0], distinct[-1], BINS + 1)
        cell = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, BINS - 1)
        return Bins(axis, scale, edges, (edges[1:] + edges[:-1]) / 2, cell)
    between = (distinct[1:] + distinct[:-1]) / 2
    half = (
        (distinct[1] - distinct[0], distinct[-1] - distinct[-2])
        if len(distinct) > 1
        else (1.0, 1.0)
    )
    edges = np.concatenate([[distinct[0] - half[0] / 2], between, [distinct[-1] + half[1] / 2]])
    return Bins(axis, scale, edges, distinct, cell)


def _number(axis: Axis, value: Any) -> float:
    """Return a value, or its place in the list where it is no number."""
    return float(value) if axis.numeric else float(axis.values.index(value))


def bins_place(bins: Bins, ranked: Ranked) -> float:
    """Return where a ranked setting lies on the axis; NaN where it is not on it."""
    value = ranked.settings[bins.axis.name]
    if not bins.axis.numeric and value not in bins.axis.values:
        return float("nan")
    position = _number(bins.axis, value) * bins.scale
    return position if bins.edges[0] <= position <= bins.edges[-1] else float("nan")


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
