"""Figures of a fleet's page: distributions over recordings, causes of misses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..score.svg import Axis, Plot, element, number, picture, text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

#: From so many recordings on they are counted in bars; fewer are drawn one by one.
ENOUGH_FOR_BARS = 20
BINS = 25
WIDE, BAR_PX = 1160, 30
_LABELS_PX, _COUNTS_PX = 150, 110


def distribution(
    values: NDArray[np.float64], names: Sequence[str], label: str, span: tuple[float, float]
) -> str:
    """Return how a figure is distributed over recordings.

    Parameters
    ----------
    values
        Of each recording, finite, shape (n,).
    names
        Of the recordings.
    label
        What the figure is, with its unit.
    span
        Ends of the axis; what lies outside is drawn at them.
    """
    held = np.clip(values, *span)
    if len(values) < ENOUGH_FOR_BARS:
        return _one_by_one(held, values, names, label, span)
    edges = np.linspace(*span, BINS + 1)
    counts, _ = np.histogram(held, edges)
    top = max(4.0, 1.12 * float(counts.max()))
    plot = Plot(Axis(label, *span), Axis("Recordings [count]", 0, top), height=250)
    for low, high, count in zip(edges, edges[1:], counts, strict=False):
        if count:
            said = f"{number(low)} to {number(high)}: {count}"
            plot.box((low, high), (0, float(count)), "bar", said)
    plot.vertical(float(np.median(held)), "mark", f"median {np.median(values):.4g}")
    return plot.svg(f"Distribution of {label}")


def _one_by_one(
    held: NDArray[np.float64],
    values: NDArray[np.float64],
    names: Sequence[str],
    label: str,
    span: tuple[float, float],
) -> str:
    order = np.argsort(held, kind="stable")
    top = len(held) + 0.6
    plot = Plot(Axis(label, *span), Axis("Recordings, in order", 0.4, top), height=250)
    for place, row in enumerate(order, 1):
        said = f"{names[row]}: {values[row]:.4g}"
        plot.dot(float(held[row]), place, "dot result", said, 5)
    plot.vertical(float(np.median(held)), "mark", f"median {np.median(values):.4g}")
    return plot.svg(f"{label}, recording by recording")


def span_for(values: NDArray[np.float64], *, signed: bool) -> tuple[float, float]:
    """Return the ends of an axis that shows all but the farthest values.

    Parameters
    ----------
    values
        Of all pipelines, finite.
    signed
        Whether the axis is to be even about zero.
    """
    reach = float(np.percentile(np.abs(values), 98)) if len(values) else 1.0
    reach = max(1.15 * reach, 1e-3)
    return (-reach, reach) if signed else (0.0, reach)


def cause_bars(counts: Sequence[tuple[str, int]]) -> str:
    """Return misses by cause as bars, the most frequent first."""
    total, most = sum(n for _, n in counts), max(n for _, n in counts)
    room = WIDE - _LABELS_PX - _COUNTS_PX
    parts = []
    for row, (cause, count) in enumerate(counts):
        y, width = row * BAR_PX + 4, max(2.0, room * count / most)
        said = f"{cause}: {count} of {total} misses"
        parts.append(text(_LABELS_PX - 10, y + 16, cause, "label end"))
        size = {"x": _LABELS_PX, "y": y, "width": width, "height": BAR_PX - 8}
        parts.append(element("rect", "bar", said, **size))
        share = f"{count} ({count / total:.0%})"
        parts.append(text(_LABELS_PX + width + 8, y + 16, share, "note"))
    return picture(WIDE, len(counts) * BAR_PX + 8, "Misses by cause", parts)
