"""Figures of a step score: F1 by tolerance, latency, and every step on a time axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .matching import metronome_f1, random_f1
from .svg import Axis, Plot, element, number, picture, text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .step_matching import StepMatch
    from .steps import StepScore

#: Lengths that a row of the timeline may have [s]; the first ones only as its sole row.
ROW_S = (5, 10, 15, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200)
SOLE_S = 30
MOST_ROWS = 24
WIDTH = 1160
ROW_PX = 58
MARGIN_PX = 46


def tolerance_figure(score: StepScore, matching: StepMatch, start_ns: int) -> str:
    """Return F1 over tolerance, with what random and metronome detections would reach."""
    truth = (matching.truth_ns - start_ns) / NS_PER_S
    tolerances = [t for t, _ in score.curve]
    plot = Plot(Axis("Tolerance [ms]", 0, 1e3 * tolerances[-1]), Axis("F1 (0 to 1)", 0, 1))
    for name, f1 in (("metronome", metronome_f1), ("random", random_f1)):
        values = [f1(truth, matching.spans, score.detected, t) for t in tolerances]
        _series(plot, tolerances, values, name, name)
    plot.vertical(1e3 * score.tolerance_s, "mark", "tolerance of the score")
    _series(plot, tolerances, [f1 for _, f1 in score.curve], "result", "this result")
    return plot.svg("F1 over tolerance, with two levels of chance")


def _series(
    plot: Plot, tolerances: list[float], values: list[float], style: str, name: str
) -> None:
    plot.line(zip([1e3 * t for t in tolerances], values, strict=True), style)
    for t, value in zip(tolerances, values, strict=True):
        plot.dot(1e3 * t, value, f"dot {style}", f"{name}: F1 {value:.3f} at {1e3 * t:.0f} ms", 2.6)


def latency_figure(score: StepScore, matching: StepMatch) -> str:
    """Return the histogram of detection minus truth of the matched steps."""
    pairs = matching.pairs
    late = (matching.found_ns[pairs[:, 1]] - matching.truth_ns[pairs[:, 0]]) / 1e6
    widest = 1.2 * float(np.abs(late).max(initial=0.0))
    reach = min(1e3 * score.tolerance_s, max(10.0, widest))
    edges = np.linspace(-reach, reach, 25)
    counts, _ = np.histogram(late, edges)
    top = max(4.0, 1.15 * float(counts.max()))
    plot = Plot(Axis("Detection minus truth [ms]", -reach, reach), Axis("Steps [count]", 0, top))
    for low, high, count in zip(edges, edges[1:], counts, strict=False):
        if count:
            plot.box((low, high), (0, float(count)), "bar", f"{low:.0f} to {high:.0f} ms: {count}")
    plot.vertical(0, "zero")
    if score.latency_ms is not None:
        plot.vertical(score.latency_ms.median, "mark", "median")
    return plot.svg("Histogram of latency")


def timeline_figure(matching: StepMatch, start_ns: int, end_ns: int) -> str:
    """Return every scored step in rows of time: truth above, detections below the line.

    Rows in which nothing happens are left out.
    """
    length = max((end_ns - start_ns) / NS_PER_S, 1.0)
    rows = 1 if length <= SOLE_S else MOST_ROWS
    fitting = (r for r in ROW_S if r * rows >= length and r >= min(length, SOLE_S))
    row_s = next(fitting, length / MOST_ROWS)
    marks = [
        *_marks(matching.truth_ns, matching.missed, "missed", start_ns),
        *_marks(matching.found_ns, matching.false, "false", start_ns),
    ]
    last = int(length / row_s)
    by_row: dict[int, list[Mark]] = {}
    for mark in marks:
        by_row.setdefault(min(max(int(mark.time_s / row_s), 0), last), []).append(mark)
    parts: list[str] = []
    for place, k in enumerate(sorted(by_row)):
        row = Row(k * row_s, row_s, place * ROW_PX)
        parts += [*row.frame(), *row.spans(matching.spans), *map(row.stroke, by_row[k])]
    foot = ROW_PX * len(by_row) + 16
    parts.append(text(WIDTH / 2, foot, "Time since the first sample [s]", "label mid"))
    return picture(WIDTH, foot + 6, "Steps over time", parts)


class Mark(NamedTuple):
    """A step on the timeline: when, what became of it, and whether it is a true one."""

    time_s: float
    style: str
    true: bool


def _marks(
    times_ns: NDArray[np.int64], alone: NDArray[np.intp], style: str, start_ns: int
) -> list[Mark]:
    unmatched = set(alone.tolist())
    return [
        Mark((int(t) - start_ns) / NS_PER_S, style if i in unmatched else "hit", style == "missed")
        for i, t in enumerate(times_ns)
    ]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the timeline: its first second, its length, its place from the top [px]."""

    begin_s: float
    length_s: float
    top: float

    def px(self, time_s: float) -> float:
        """Return the horizontal place of a time, within the row [px]."""
        part = min(max((time_s - self.begin_s) / self.length_s, 0.0), 1.0)
        return MARGIN_PX + part * (WIDTH - MARGIN_PX - 14)

    def frame(self) -> list[str]:
        """Return the middle line, ticks and names of the halves."""
        end_s, middle = self.begin_s + self.length_s, self.top + 22
        x1, x2 = self.px(self.begin_s), self.px(end_s)
        out = [element("line", "zero", x1=x1, x2=x2, y1=middle, y2=middle)]
        for tick in Axis("", self.begin_s, end_s).ticks(12):
            x = self.px(tick)
            out.append(element("line", "grid", x1=x, x2=x, y1=self.top + 41, y2=self.top + 45))
            out.append(text(x, self.top + 55, number(tick), "tick mid"))
        for y, name in ((16, "truth"), (36, "found")):
            out.append(text(MARGIN_PX - 6, self.top + y, name, "tick end"))
        return out

    def spans(self, spans: NDArray[np.float64]) -> list[str]:
        """Return the shades of what is scored."""
        end_s = self.begin_s + self.length_s
        return [
            element(
                "rect",
                "scored",
                f"scored: {a:.2f} to {b:.2f} s",
                x=self.px(a),
                y=self.top + 2,
                width=self.px(b) - self.px(a),
                height=40,
            )
            for a, b in spans
            if a < end_s and b > self.begin_s
        ]

    def stroke(self, mark: Mark) -> str:
        """Return the stroke of a step: above the line for a true one."""
        x = self.px(mark.time_s)
        y1, y2 = (self.top + 5, self.top + 21) if mark.true else (self.top + 23, self.top + 39)
        name = {"hit": "matched"}.get(mark.style, mark.style)
        title = f"{'step' if mark.true else 'detection'} at {mark.time_s:.3f} s: {name}"
        return element("line", f"stroke {mark.style}", title, x1=x, x2=x, y1=y1, y2=y2)
