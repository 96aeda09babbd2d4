"""Ratios of powers on the timeline: theta by each estimator, its deviation, and the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import ESTIMATOR_COLOURS, FAINT, TRUTH
from .timeline import Entity
from .true_ways import true_ways

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import StageSpec, TraceBlock

    from .timeline import Timeline

    Array = NDArray[np.float64]

RATIOS = "/ratios"
SIGMA = " sigma"
#: Decibels of a natural logarithm of powers.
DB = 10 / np.log(10)
#: Estimators of a cycle stand beside each other, this far apart [ns].
APART_NS = 60_000_000
#: A vehicle is no nearer to a sensor than this [m], as in the computations.
NEAREST_M = 0.5


class RatioCurves:
    """Logs the ratios of one topic's pairs: a plot each, with a colour for every estimator.

    Parameters
    ----------
    timeline
        Where to.
    spec
        A stage whose trace holds ln theta by estimators, and its deviations.
    span_ns
        What is shown of the recording: start and end [ns].
    """

    def __init__(self, timeline: Timeline, spec: StageSpec, span_ns: tuple[int, int]) -> None:
        self._span_ns = span_ns
        self._timeline = timeline
        self._spec = spec
        names = [quantity.name for quantity in spec.trace]
        self._columns = {
            name: (i, names.index(name + SIGMA))
            for i, name in enumerate(names)
            if name + SIGMA in names
        }
        self._pending: list[TraceBlock] = []
        for pair in spec.channels:
            self._begin(pair)

    @staticmethod
    def fits(spec: StageSpec) -> bool:
        """Whether the trace of a stage holds estimates and their deviations, of pairs."""
        names = {quantity.name for quantity in spec.trace}
        paired = all("/" in channel for channel in spec.channels)
        return paired and any(name + SIGMA in names for name in names)

    def _path(self, pair: str) -> str:
        return f"{RATIOS}/{self._spec.topic.strip('/')}/{pair.replace('/', '-')}"

    def _begin(self, pair: str) -> None:
        import rerun as rr

        of = pair.replace("/", " / ")
        told = ", ".join(f"{a} {b}" for a, b in zip(self._columns, ESTIMATOR_COLOURS, strict=False))
        first = pair == self._spec.channels[0]
        title = f"θ {of} [dB] ± σ: {told}" if first else f"θ {of}"
        self._timeline.declare(Entity(self._path(pair), "ratio", title, len(self._columns)))
        # a plot of the whole recording, though cycles are where there are vehicles
        alike = rr.SeriesLines(names="alike", colors=np.array([FAINT], np.uint32), widths=1.0)
        self._timeline.static(f"{self._path(pair)}/alike", alike)
        self._timeline.scalars(f"{self._path(pair)}/alike", self._span_ns, np.zeros((2, 1)))
        for name, colour in zip(self._columns, ESTIMATOR_COLOURS.values(), strict=False):
            shade = np.array([colour], np.uint32)
            points = rr.SeriesPoints(
                names=name, colors=shade, markers=rr.components.MarkerShape.Circle, marker_sizes=2.5
            )
            bars = rr.SeriesLines(
                names=f"{name} ± σ",
                colors=shade,
                widths=1.0,
                aggregation_policy=rr.components.AggregationPolicy.MinMax,
            )
            self._timeline.static(f"{self._path(pair)}/{name}/value", points)
            self._timeline.static(f"{self._path(pair)}/{name}/sigma", bars)

    def trace(self, block: TraceBlock) -> None:
        """Take the estimates of cycles."""
        self._pending.append(block)

    def flush(self) -> None:
        """Log what is pending."""
        if not self._pending:
            return
        found = DB * np.concatenate([b.value for b in self._pending]).astype(np.float64)
        time_ns = np.concatenate([b.time_ns for b in self._pending])
        self._pending = []
        middle = (len(self._columns) - 1) / 2
        for place, (name, (theta, sigma)) in enumerate(self._columns.items()):
            times = time_ns + round((place - middle) * APART_NS)
            for row, pair in enumerate(self._spec.channels):
                path = f"{self._path(pair)}/{name}"
                self._log(path, times, found[:, row, theta], found[:, row, sigma])

    def _log(self, path: str, times: NDArray[np.int64], value: Array, sigma: Array) -> None:
        """Log estimates as points, and their deviations as upright bars."""
        self._timeline.scalars(f"{path}/value", times, value[:, np.newaxis])
        ends = np.stack([value - sigma, value + sigma, np.full(len(value), np.nan)], axis=1)
        bar_ns = (times[:, np.newaxis] + np.arange(3)).ravel()
        self._timeline.scalars(f"{path}/sigma", bar_ns, ends.reshape(-1, 1))

    def log_truth(self, session: Session, exponent: float) -> None:
        """Log what true distances make of the ratios by the law, of each vehicle."""
        site = session.geometry
        places = {s.channel: (s.x, s.y) for s in site.sensors} if site is not None else {}
        for name, way in true_ways(session.labels).items():
            times, route = way.steps_ns(), way.between(way.places)
            for pair in self._spec.channels:
                ends = [places[channel] for channel in pair.split("/", 1) if channel in places]
                if len(ends) < 2:
                    continue
                r, r0 = (np.maximum(np.hypot(*(route - end).T), NEAREST_M) for end in ends)
                self._log_true(f"{self._path(pair)}/truth/{name}", times, r / r0, exponent)

    def _log_true(self, path: str, times: NDArray[np.int64], ratio: Array, exponent: float) -> None:
        import rerun as rr

        style = rr.SeriesLines(names="truth", colors=np.array([TRUTH], np.uint32), widths=1.0)
        self._timeline.static(path, style)
        self._timeline.scalars(path, times, 10 * exponent * np.log10(ratio)[:, np.newaxis])
