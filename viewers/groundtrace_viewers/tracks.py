"""Tracks on the map: growing lines, filtered and smoothed, and where each walker is now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.estimates import SMOOTHED
from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import NS_PER_S

from .fixes import ellipse
from .growing_line import GrowingLine
from .palette import TRACK_COLOURS
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
MARGIN = 0.55
#: More would not fit below the site.
MOST_NAMED = 4


class TrackLog:
    """Logs tracks; a smoothed one is known when it ends, but drawn at the times of its steps.

    Parameters
    ----------
    timeline
        Where to.
    shown
        What of the site the map shows; the key stands in its margin. None where that is not known
        yet: :meth:`name` then says so at the end.
    """

    def __init__(self, timeline: Timeline, shown: Bounds | None) -> None:
        self._timeline = timeline
        self._shown = shown
        self._keys: list[tuple[str, int]] = []
        self._last: dict[tuple[str, int], TrackPoint] = {}
        self._lines: dict[tuple[str, int], GrowingLine] = {}
        self._pending: list[TrackPoint] = []

    def add(self, point: TrackPoint) -> None:
        """Take a point; those of a track come in the order of time."""
        if (point.stage, point.track) not in self._keys:
            self._keys.append((point.stage, point.track))
            if self._shown is not None:
                self.name(self._shown)
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
        for line in self._lines.values():
            line.close()
        for (stage, track), point in self._last.items():
            if not stage.endswith(SMOOTHED):
                time_ns = point.time_ns + round(HOLD_S * NS_PER_S)
                for path, columns in _drawn(_present_path(stage, track), [point]):
                    none = [column.partition([0]) for column in columns]
                    self._timeline.send(path, [time_ns], none)

    def _line(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        """Log the way to each point from the one before it."""
        if key not in self._lines:
            path = f"{LINES}/{key[0]}/{key[1]}"
            self._lines[key] = GrowingLine(self._timeline, path, _colour(*key), -1.8)
        self._lines[key].add([(p.time_ns, (p.x_m, p.y_m)) for p in points])

    def _present(self, key: tuple[str, int], points: list[TrackPoint]) -> None:
        for path, columns in _drawn(_present_path(*key), points):
            self._timeline.declare(Entity(path, "map"))
            self._timeline.send(path, [p.time_ns for p in points], columns)

    def name(self, shown: Bounds) -> None:
        """Name the tracks in the key: by their stages, and where there are several by number."""
        import rerun as rr

        if not self._keys:
            return
        known = sorted(self._keys)[:MOST_NAMED]
        several = len({number for _, number in self._keys}) > 1
        texts = [f"{stage} {number}" if several else stage for stage, number in known]
        key = rr.Points2D(
            shown.key(len(known), -MARGIN),
            labels=texts,
            show_labels=True,
            colors=np.array([_colour(*key) for key in known], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(KEY, key)


def _present_path(stage: str, track: int) -> str:
    return f"{PRESENT}/{stage}/{track}"


def _drawn(path: str, points: list[TrackPoint]) -> list[tuple[str, list[ComponentColumn]]]:
    """Return where and how to log walkers: a point, and the line at one standard deviation."""
    import rerun as rr

    colours = np.array([_colour(p.stage, p.track) for p in points], np.uint32)
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


def _colour(stage: str, track: int) -> int:
    filtered, smoothed = TRACK_COLOURS[(track - 1) % len(TRACK_COLOURS)]
    return smoothed if stage.endswith(SMOOTHED) else filtered
