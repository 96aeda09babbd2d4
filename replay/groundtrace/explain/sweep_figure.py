"""The figure of a sweep: misses against false steps, and F1 over the swept parameters."""

from __future__ import annotations

from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..score.svg import Axis as PlotAxis
from ..score.svg import Plot, element, number, text
from .parameter_plots import binned, bins_place, colour, curve, heat_map, that_matter
from .sweep import f1_of

if TYPE_CHECKING:
    from .ranking import Ranking
    from .sweep import Counted

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
    axes = that_matter(counted.grid, f1)
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
