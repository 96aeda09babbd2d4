"""Headings on the timeline: fused, by gyroscope or compass alone, true; disturbances shaded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .lanes import Lane
from .palette import DISTURBED, DISTURBED_SHADE, HEADING_COLOURS, TRUTH
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Disturbance, Heading
    from groundtrace_codecs.labels import Label

    from .timeline import Timeline

HEADING = "/heading"
DISTURBANCES = "/state/6-disturbances"
#: Longer without a heading, the curve is interrupted [ns].
PATIENCE_NS = 2_000_000_000
#: The shade of disturbances reaches this far up and down [degrees]: beyond any plot, which is
#: scaled to the headings alone.
SHADE_DEG = 1e5
#: Columns of a heading stage's frames that are headings [degrees], by one kind of sensor alone.
ALONE = ("gyroscope", "compass")


class HeadingLog:
    """Logs headings in degrees, without jumps at the full turn.

    The truth is unwrapped, and each heading is given the turn that is nearest to it; without
    truth, nearest to the latest heading of the first stage. Those by gyroscope or compass alone
    come with the frames of their stage.

    Parameters
    ----------
    timeline
        Where to.
    labels
        Truth; those of kind ``heading`` are drawn.
    """

    def __init__(self, timeline: Timeline, labels: Sequence[Label]) -> None:
        self._timeline = timeline
        known = sorted(x for x in labels if x.kind == "heading" and x.value is not None)
        self._true_ns = np.array([x.time_ns for x in known], np.int64)
        self._true = np.degrees(np.unwrap([x.value or 0.0 for x in known]))
        self._pending: dict[str, list[Heading]] = {}
        self._frames: list[CandidateBlock] = []
        self._stages: list[str] = []
        self._latest: tuple[int, float] | None = None  # of the first stage [ns], [degrees]
        self._ended: dict[str, int] = {}
        self._shown: tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]] = ([], [])
        self._lane = Lane(timeline, DISTURBANCES, {"disturbed": DISTURBED})
        self._spans: list[Disturbance] = []

    def heading(self, heading: Heading) -> None:
        """Take a heading; those of a stage come in the order of time."""
        self._pending.setdefault(heading.stage, []).append(heading)

    def frames(self, block: CandidateBlock) -> None:
        """Take the frames of a stage; those with headings by one kind of sensor are drawn."""
        if block.spec.emits == "heading":
            self._frames.append(block)

    def disturbance(self, disturbance: Disturbance) -> None:
        """Take a span in which the field is disturbed."""
        self._spans.append(disturbance)
        self._lane.add(disturbance.time_ns, "disturbed", disturbance.end_ns)

    def flush(self) -> None:
        """Log the headings that are pending."""
        for stage, headings in self._pending.items():
            if stage not in self._stages:
                self._begin(stage)
            self._log(stage, headings)
        self._pending = {}
        for block in self._frames:
            names = [column.name for column in block.spec.columns]
            for name in (name for name in ALONE if name in names):
                degrees = block.value[:, names.index(name)].astype(np.float64)
                self._log_alone(f"{block.spec.stage}/{name}", block.time_ns, degrees)
        self._frames = []

    def close(self) -> None:
        """Log what is pending, and shade what is disturbed."""
        self.flush()
        self._lane.flush()
        if self._stages and self._spans:
            self._shade()

    def _begin(self, stage: str) -> None:
        if not self._stages and len(self._true):
            self._log_truth()
        name = list(HEADING_COLOURS)[len(self._stages) % len(HEADING_COLOURS)]
        title = f"{stage.replace('/', ': ')} {name}"
        self._timeline.declare(Entity(f"{HEADING}/{stage}", "heading", title))
        self._stages.append(stage)

    def _log_truth(self) -> None:
        import rerun as rr

        style = rr.SeriesLines(names="truth", colors=np.array([TRUTH], np.uint32), widths=1.5)
        self._timeline.declare(Entity(f"{HEADING}/truth", "heading", "truth violet"), style)
        self._timeline.scalars(f"{HEADING}/truth", self._true_ns, self._true[:, np.newaxis])

    def _log(self, stage: str, headings: list[Heading]) -> None:
        times = np.array([h.time_ns for h in headings], np.int64)
        degrees = self._turned(stage, times, np.degrees([h.heading_rad for h in headings]))
        sigma = np.degrees([h.sigma_rad for h in headings])
        if stage == self._stages[0]:
            self._shown[0].append(times)
            self._shown[1].append(degrees)
        self._interrupted(stage, times, degrees, sigma)

    def _log_alone(
        self, curve: str, times: NDArray[np.int64], degrees: NDArray[np.float64]
    ) -> None:
        """Log headings by one kind of sensor, with the turn nearest to the truth or the fused."""
        if curve not in self._stages:
            self._begin(curve)
        known = (self._true_ns, self._true)
        if not len(self._true) and self._shown[0]:
            known = (np.concatenate(self._shown[0]), np.concatenate(self._shown[1]))
        if len(known[0]):
            near = np.interp(times, *known)
            degrees = degrees + 360.0 * np.round((near - degrees) / 360.0)
        self._interrupted(curve, times, degrees, np.zeros(len(times)))

    def _interrupted(
        self,
        stage: str,
        times: NDArray[np.int64],
        degrees: NDArray[np.float64],
        sigma: NDArray[np.float64],
    ) -> None:
        """Log a curve, interrupted where nothing is known for long."""
        before = self._ended.get(stage)
        self._ended[stage] = int(times[-1])
        starts = np.append(before if before is not None else times[0], times[:-1])
        late = np.flatnonzero(times - starts > PATIENCE_NS)
        times = np.insert(times, late, starts[late] + 1)
        degrees, sigma = (np.insert(x, late, np.nan) for x in (degrees, sigma))
        self._send(stage, times, degrees, sigma)

    def _send(
        self,
        stage: str,
        times: NDArray[np.int64],
        degrees: NDArray[np.float64],
        sigma: NDArray[np.float64],
    ) -> None:
        import rerun as rr

        colours = list(HEADING_COLOURS.values())
        colour = colours[self._stages.index(stage) % len(colours)]
        rows = len(times)
        columns = rr.Measurements.columns(
            values=degrees,
            variances=np.nan_to_num(sigma) ** 2,
            units=["°"] * rows,
            colors=np.full(rows, colour, np.uint32),
            widths=np.full(rows, 1.5, np.float32),
            names=[stage] * rows,
        )
        self._timeline.send(f"{HEADING}/{stage}", times, columns)

    def _turned(
        self, stage: str, times: NDArray[np.int64], degrees: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return headings with the turn that is nearest to the truth, else to the first stage."""
        if len(self._true):
            near = np.interp(times, self._true_ns, self._true)
            return degrees + 360.0 * np.round((near - degrees) / 360.0)
        near_deg = self._latest[1] if self._latest is not None else float(degrees[0])
        whole = np.unwrap(np.append(near_deg, degrees), period=360.0)[1:]
        if stage == self._stages[0]:
            self._latest = (int(times[-1]), float(whole[-1]))
        return whole

    def _shade(self) -> None:
        """Log a band over each span: that of measurements whose deviation covers the plot."""
        import rerun as rr

        known_ns, known = np.concatenate(self._shown[0]), np.concatenate(self._shown[1])
        times: list[int] = []
        values: list[float] = []
        end_ns = 0
        for span in sorted(self._spans, key=lambda s: s.time_ns):
            start_ns = max(span.time_ns, end_ns)
            if span.end_ns > start_ns:
                times += [start_ns, span.end_ns - 1, span.end_ns]
                edges = np.interp([start_ns, span.end_ns], known_ns, known)
                values += [*edges.tolist(), math.nan]
                end_ns = span.end_ns + 1
        rows = len(times)
        columns = rr.Measurements.columns(
            values=np.array(values),
            variances=np.full(rows, SHADE_DEG**2),
            units=[""] * rows,
            colors=np.full(rows, DISTURBED_SHADE, np.uint32),
            widths=np.zeros(rows, np.float32),
            names=["disturbed"] * rows,
        )
        self._timeline.send(f"{HEADING}/disturbed", times, columns)
