"""Figures of a step score: F1 by tolerance, latency, and every step on a time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .matching import metronome_f1, random_f1
from .svg import Axis, Plot, number, picture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .step_matching import StepMatch
    from .steps import StepScore

#: Lengths that a row of the timeline may have [s].
ROW_S = (10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200)
MOST_ROWS = 24
WIDTH = 1160
ROW_PX = 58
MARGIN_PX = 46


def tolerance_figure(score: StepScore, matching: StepMatch, start_ns: int) -> str:
    """Return F1 over tolerance, with what random and metronome detections would reach."""
    truth = (matching.truth_ns - start_ns) / NS_PER_S
    tolerances = [t for t, _ in score.curve]
    plot = Plot(Axis("Tolerance [ms]", 0, 1e3 * tolerances[-1]), Axis("F1 [1]", 0, 1))
    chance = [
        ("metronome", "metronome", metronome_f1),
        ("random", "random", random_f1),
    ]
    for name, style, f1 in chance:
        values = [f1(truth, matching.spans, score.detected, t) for t in tolerances]
        _series(plot, tolerances, values, style, name)
    plot.vertical(1e3 * score.tolerance_s, "mark", "tolerance of the score")
    _series(plot, tolerances, [f1 for _, f1 in score.curve], "result", "this result")
    legend = (("result", "this result"), ("metronome", "metronome"), ("random", "random"))
    for row, (style, name) in enumerate(legend):
        y = 168 + 18 * row + 60
        plot.add("rect", f"swatch {style}", x=plot.width - 130, y=y - 9, width=14, height=4)
        plot.text(plot.width - 110, y - 3, name)
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
    reach = 1e3 * score.tolerance_s
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
        text = f"median {score.latency_ms.median:+.0f} ms, IQR {score.latency_ms.iqr:.0f} ms"
        plot.text(68, 26, text)
    return plot.svg("Histogram of latency")


def timeline_figure(matching: StepMatch, start_ns: int, end_ns: int) -> str:
    """Return every scored step in rows of time: truth above, detections below the line."""
    truth = (matching.truth_ns - start_ns) / NS_PER_S
    found = (matching.found_ns - start_ns) / NS_PER_S
    length = max((end_ns - start_ns) / NS_PER_S, 1.0)
    row_s = next((r for r in ROW_S if length / r <= MOST_ROWS), length / MOST_ROWS)
    rows = [k for k in range(int(length / row_s) + 1) if _busy(matching, k * row_s, row_s)]
    parts: list[str] = []
    hits = np.zeros(len(truth), np.bool_)
    hits[matching.pairs[:, 0]] = True
    right = np.zeros(len(found), np.bool_)
    right[matching.pairs[:, 1]] = True
    for place, k in enumerate(rows):
        row = _Row(k * row_s, row_s, place * ROW_PX)
        row.spans(matching.spans)
        row.marks(truth, hits, ("hit", "missed"), above=True)
        row.marks(found, right, ("hit", "false"), above=False)
        parts += row.parts()
    return picture(WIDTH, ROW_PX * len(rows) + 22, "Steps over time", [*parts, *_foot(len(rows))])


def _busy(matching: StepMatch, begin: float, row_s: float) -> bool:
    spans = matching.spans
    return bool(((spans[:, 0] < begin + row_s) & (spans[:, 1] > max(begin, 1e-9))).any())


def _foot(rows: int) -> list[str]:
    return [
        f'<text class="label mid" x="{WIDTH / 2}" y="{ROW_PX * rows + 16}">'
        "Time since the first sample [s]</text>"
    ]


class _Row:
    """One row of the timeline."""

    def __init__(self, begin_s: float, length_s: float, top: float) -> None:
        self.begin, self.end, self.top = begin_s, begin_s + length_s, top
        axis = Axis("", begin_s, begin_s + length_s)
        self.ticks = axis.ticks(12)
        self._plot = Plot(axis, Axis("", 0, 1), WIDTH + 2 * 0)

    def parts(self) -> list[str]:
        """Return the elements of the row."""
        middle = self.top + 22
        self._plot.add(
            "line", "zero", x1=self.px(self.begin), x2=self.px(self.end), y1=middle, y2=middle
        )
        for tick in self.ticks:
            x = self.px(tick)
            self._plot.add("line", "grid", x1=x, x2=x, y1=self.top + 40, y2=self.top + 44)
            self._plot.text(x, self.top + 54, number(tick), "tick mid")
        return self._plot.parts

    def px(self, time_s: float) -> float:
        """Return the horizontal place of a time [px]."""
        part = (min(max(time_s, self.begin), self.end) - self.begin) / (self.end - self.begin)
        return MARGIN_PX + part * (WIDTH - MARGIN_PX - 14)

    def spans(self, spans: NDArray[np.float64]) -> None:
        """Shade what is scored and name the halves."""
        for a, b in spans:
            if a < self.end and b > self.begin:
                left, right = self.px(a), self.px(b)
                title = f"scored: {a:.2f} to {b:.2f} s"
                self._plot.add(
                    "rect", "scored", title, x=left, y=self.top + 2, width=right - left, height=40
                )
        self._plot.text(MARGIN_PX - 6, self.top + 16, "truth", "tick end")
        self._plot.text(MARGIN_PX - 6, self.top + 36, "found", "tick end")

    def marks(
        self,
        times: NDArray[np.float64],
        good: NDArray[np.bool_],
        styles: tuple[str, str],
        *,
        above: bool,
    ) -> None:
        """Add a stroke for each time in the row, thick where it is not matched."""
        y1, y2 = (self.top + 5, self.top + 21) if above else (self.top + 23, self.top + 39)
        for index in np.flatnonzero((times >= self.begin) & (times < self.end)):
            style = styles[0] if good[index] else styles[1]
            name = "matched" if good[index] else style
            x = self.px(float(times[index]))
            self._plot.add(
                "line", f"stroke {style}", f"{name}: {times[index]:.3f} s", x1=x, x2=x, y1=y1, y2=y2
            )
