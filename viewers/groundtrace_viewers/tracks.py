"""Tracks on the map: growing lines, filtered and smoothed, and where each walker is now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.trackers.api import SMOOTHED
from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import NS_PER_S

from .fixes import ellipse
from .palette import FILTERED_TRACK, SMOOTHED_TRACK
from .sensor_map import SITE
from .timeline import Entity

if TYPE_CHECKING:
    from rerun import ComponentColumn

    from groundtrace_codecs.events import TrackPoint

    from .sensor_map import Bounds
    from .timeline import Timeline

TRACKS = f"{SITE}/tracks"
LINES, PRESENT = f"{TRACKS}/lines", f"{TRACKS}/present"
KEY = f"{TRACKS}/key"
#: A walker is shown where it was last for so long after its last step [s].
HOLD_S = 2.0
#: The key stands below the site, this far down the margin.
MARGIN = 0.3


class TrackLog:
    """Logs tracks; a smoothed one is known when it ends, but drawn at the times of its steps.

    Parameters
    ----------
    timeline
        Where to.
    shown
        What of the site the map shows; the key stands in its margin.
    """

    def __init__(self, timeline: Timeline, shown: Bounds) -> None:
        self._timeline = timeline
        self._shown = shown
        self._stages: list[str] = []
        self._last: dict[tuple[str, int], TrackPoint] = {}
        self._pending: list[TrackPoint] = []

    def add(self, point: TrackPoint) -> None:
        """Take a point; those of a track come in the order of time."""
        if point.stage not in self._stages:
            self._stages.append(point.stage)
            self._name()
        self._pending.append(point)

    def flush(self) -> None:
        """Log what is pending."""
        for key in dict.fromkeys((p.stage, p.track) for p in self._pending):
            points = [p for p in self._pending if (p.stage, p.track) == key]
            self._line(key, points)
            if not key[0].endswith(SMOOTHED):
                self._present(key, points)
            self._last[key] = points[-1]
        self._pending = []

    def close(self) -> None:
        """Log what is pending, and that the walkers are gone some time after their last step."""
        self.flush()
        for (stage, track), point in self._last.items():
            if not stage.endswith(SMOOTHED):
                time_ns = point.time_ns + round(HOLD_S * NS_PER_S)
                for path, columns in _drawn(_present_path(stage, track), [point]):
                    none = [column.partition([0]) for column in columns]
                    self._timeline.send(path, [time_ns], none)

    def _line(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        """Log the way to each point from the one before it, a row each."""
        import rerun as rr

        known = [self._last[key], *points] if key in self._last else points
        if len(known) < 2:
            return
        places = np.array([(p.x_m, p.y_m) for p in known], np.float32)
        rows = len(known) - 1
        columns = rr.LineStrips2D.columns(
            strips=np.stack([places[:-1], places[1:]], axis=1),
            colors=np.full(rows, _colour(key[0]), np.uint32),
            radii=np.full(rows, -1.8),
        )
        path = f"{LINES}/{key[0]}/{key[1]}"
        self._timeline.declare(Entity(path, "map"))
        self._timeline.send(path, [p.time_ns for p in known[1:]], columns)

    def _present(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        for path, columns in _drawn(_present_path(*key), points):
            self._timeline.declare(Entity(path, "map"))
            self._timeline.send(path, [p.time_ns for p in points], columns)

    def _name(self) -> None:
        """Name the stages in the key."""
        import rerun as rr

        (left, right), (low, high) = self._shown.x, self._shown.y
        count = len(self._stages)
        pad = 0.1 / 1.2 * max(right - left, high - low)
        across = left + (right - left) * (np.arange(count) + 0.5) / count
        key = rr.Points2D(
            np.stack([across, np.full(count, low + (1 - MARGIN) * pad)], axis=1),
            labels=self._stages,
            show_labels=True,
            colors=np.array([_colour(s) for s in self._stages], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(KEY, key)


def _present_path(stage: str, track: int) -> str:
    return f"{PRESENT}/{stage}/{track}"


def _drawn(path: str, points: list[TrackPoint]) -> list[tuple[str, list[ComponentColumn]]]:
    """Return where and how to log walkers: a point, and the line at one standard deviation."""
    import rerun as rr

    colours = np.array([_colour(p.stage) for p in points], np.uint32)
    dots = rr.Points2D.columns(
        positions=np.array([(p.x_m, p.y_m) for p in points], np.float32),
        colors=colours,
        radii=np.full(len(points), -6.0),
    )
    lines = rr.LineStrips2D.columns(
        strips=np.stack([ellipse(_place(p)) for p in points]),
        colors=colours,
        radii=np.full(len(points), -1.0),
    )
    return [(f"{path}/place", list(dots)), (f"{path}/ellipse", list(lines))]


def _place(point: TrackPoint) -> Fix:
    """Return a point as the fix it amounts to."""
    unknown = float("nan")
    return Fix(
        point.time_ns, point.x_m, point.y_m, point.covariance, unknown, "track", 0, point.stage
    )


def _colour(stage: str) -> int:
    return SMOOTHED_TRACK if stage.endswith(SMOOTHED) else FILTERED_TRACK
