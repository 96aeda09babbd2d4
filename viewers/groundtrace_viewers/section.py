"""Record section: the traces of a shot side by side, each scaled to itself, with its picks.

True amplitudes of a shot span decades from the nearest geophone to the farthest. Scaled to its own
maximum every trace shows its onset, and picks lie on the travel-time curve.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .palette import ACCEPTED, TRACE, TRUTH
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import Stream

    from .recent import Recent
    from .timeline import Timeline

#: What is shown of a shot: from a little before it until the waves have passed.
BEFORE_NS = 50_000_000
AFTER_NS = 300_000_000
#: Largest deflection of a trace, in distances between traces.
DEFLECTION = 1.5


def scaled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return traces scaled to their own maximum and offset by channel.

    Parameters
    ----------
    values
        Shape (n, n_channels).

    Returns
    -------
    numpy.ndarray
        Shape (n, n_channels): channel ``i`` swings about ``i + 1``; a constant one is a line.
    """
    swing = values - np.median(values, axis=0)
    peak = np.abs(swing).max(axis=0)
    offset: NDArray[np.float64] = np.arange(1.0, values.shape[1] + 1.0)
    return offset + DEFLECTION * swing / np.where(peak > 0, peak, 1.0)


class Section:
    """Logs the section of one stream around its shots.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Its seismic channels are shown, in their order.
    labels
        Labelled impacts are shots; elsewhere a shot begins with its first pick.
    recent
        Holds the stream's last samples.
    """

    def __init__(
        self, timeline: Timeline, stream: Stream, labels: Iterable[Label], recent: Recent
    ) -> None:
        self._timeline = timeline
        self._columns = stream.columns_of(SEISMIC_QUANTITIES)
        self._names = [stream.channels[i].name for i in self._columns]
        self._topic = stream.topic
        self._path = f"/section/{stream.topic.strip('/')}"
        self._period_ns = round(stream.period_ns)
        self._recent = recent
        self._pending: list[tuple[int, int]] = []
        self._windows: list[tuple[int, int]] = []
        self._picks: list[Pick] = []
        known = sorted(labels)
        for label in known:
            if label.kind == "impact":
                self._open(label.time_ns)
        self._log_truth([x for x in known if x.kind == "pick" and x.channel in self._names])

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Whether a stream has seismic channels that can stand side by side."""
        return len(stream.columns_of(SEISMIC_QUANTITIES)) > 1

    def _open(self, time_ns: int) -> None:
        """Ask for the window of a shot, without what another window shows already."""
        start, end = time_ns - BEFORE_NS, time_ns + AFTER_NS
        place = bisect_right(self._windows, time_ns, key=lambda w: w[0])
        if place:
            if time_ns < self._windows[place - 1][1]:
                return
            start = max(start, self._windows[place - 1][1])
        if place < len(self._windows):
            end = min(end, self._windows[place][0])
        self._windows.insert(place, (start, end))
        self._pending.append((start, end))

    def add(self, pick: Pick) -> None:
        """Take a pick."""
        if pick.channel in self._names:
            self._picks.append(pick)
            self._open(pick.time_ns)

    def advance(self, end_ns: int | None = None) -> None:
        """Log the windows that end before a time, or all."""
        ready = [w for w in self._pending if end_ns is None or w[1] <= end_ns]
        self._pending = [w for w in self._pending if w not in ready]
        for start, end in sorted(ready):
            pieces = list(self._recent.between(start, end))
            if pieces:
                times = np.concatenate([t for t, _ in pieces])
                self._log_traces(times, np.concatenate([v for _, v in pieces])[:, self._columns])

    def _log_traces(self, times: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        import rerun as rr

        if not len(times):
            return
        count = len(self._names)
        scale = "each trace scaled to its own maximum, offset by channel"
        title = f"Section {self._topic}: {scale} (● picks, + truth)"
        style = rr.SeriesLines(
            names=self._names,
            colors=np.full(count, TRACE, np.uint32),
            widths=1.0,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        entity = Entity(f"{self._path}/traces", "section", title, count, top=count + 1.5)
        self._timeline.declare(entity, style)
        # Curves end with the window: the viewer would draw a line to the next.
        times = np.append(times, times[-1] + self._period_ns)
        rows = np.vstack([scaled(values), np.full((1, count), np.nan)])
        self._timeline.scalars(f"{self._path}/traces", times, rows)

    def flush(self) -> None:
        """Log the pending picks."""
        import rerun as rr

        if self._picks:
            style = rr.SeriesPoints(
                names="pick",
                colors=np.array([ACCEPTED], np.uint32),
                markers="circle",
                marker_sizes=3.5,
            )
            self._timeline.static(f"{self._path}/picks", style)
            marks = [(p.time_ns, p.channel) for p in self._picks]
            self._log_marks("picks", marks)
            self._picks = []

    def _log_truth(self, labels: list[Label]) -> None:
        """Log the arrivals of the truth, in a shape that shows whatever lies on it."""
        import rerun as rr

        if labels:
            style = rr.SeriesPoints(
                names="truth",
                colors=np.array([TRUTH], np.uint32),
                markers="plus",
                marker_sizes=8.0,
            )
            self._timeline.static(f"{self._path}/truth", style)
            self._log_marks("truth", [(x.time_ns, x.channel) for x in labels])

    def _log_marks(self, what: str, marks: list[tuple[int, str]]) -> None:
        heights = np.array([self._names.index(name) + 1.0 for _, name in marks])
        path = f"{self._path}/{what}"
        self._timeline.scalars(path, [t for t, _ in marks], heights[:, np.newaxis])
