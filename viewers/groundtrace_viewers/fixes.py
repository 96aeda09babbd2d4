"""Places found, on the map: points and one-sigma ellipses, a colour for each stage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .palette import FIX_COLOURS
from .sensor_map import SITE
from .timeline import Entity

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rerun import ComponentColumnList

    from groundtrace_codecs.events import Fix

    from .sensor_map import Bounds
    from .timeline import Timeline

FIXES = f"{SITE}/fixes"
POINTS, ELLIPSES = f"{FIXES}/points", f"{FIXES}/ellipses"
#: Of fixes that come in every cycle and are crosses; and their size as a part of the map's width.
CROSSES, CROSS_ELLIPSES, CROSS = f"{SITE}/crosses/places", f"{SITE}/crosses/ellipses", 0.013
KEY = f"{FIXES}/key"
CORNERS = 33
#: The key stands above the site, this far up the margin.
MARGIN = 0.8


#: A cross as one line, from tip to tip through the middle.
TIPS = np.array([(-1, -1), (1, 1), (0, 0), (-1, 1), (1, -1)], np.float32)


def ellipse(fix: Fix) -> NDArray[np.float32]:
    """Return the closed line at one standard deviation about a fix, shape (CORNERS, 2) [m].

    A covariance that is unknown gives the place alone.
    """
    xx, xy, yy = fix.covariance
    place = np.array([fix.x_m, fix.y_m])
    matrix = np.array([[xx, xy], [xy, yy]])
    if not np.isfinite(matrix).all():
        return np.tile(place, (CORNERS, 1)).astype(np.float32)
    value, vector = np.linalg.eigh(matrix)
    turn = np.linspace(0.0, 2 * np.pi, CORNERS)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    line: NDArray[np.float64] = place + circle * np.sqrt(np.maximum(value, 0.0)) @ vector.T
    return line.astype(np.float32)


class FixLog:
    """Logs fixes: those of the last seconds are shown, the layout says how many.

    Parameters
    ----------
    timeline
        Where to.
    shown
        What of the site the map shows; the key stands in its margin.
    crosses
        Draw crosses, not points.
    """

    def __init__(self, timeline: Timeline, shown: Bounds, *, crosses: bool = False) -> None:
        self._crosses = crosses
        self._timeline = timeline
        self._shown = shown
        self._stages: list[str] = []
        self._pending: list[Fix] = []

    def begin(self, stage: str) -> None:
        """Give a stage that finds places its colour, and name it in the key."""
        import rerun as rr

        if stage in self._stages:
            return
        self._stages.append(stage)
        key = rr.Points2D(
            self._shown.key(len(self._stages), MARGIN),
            labels=self._stages,
            show_labels=True,
            colors=np.array([self.colour(s) for s in self._stages], np.uint32),
            radii=-5.0,
        )
        self._timeline.static(KEY, key)

    def add(self, fix: Fix) -> None:
        """Take a fix."""
        self.begin(fix.stage)
        self._pending.append(fix)

    def flush(self) -> None:
        """Log what is pending."""
        for stage in dict.fromkeys(fix.stage for fix in self._pending):
            self._send(stage, [fix for fix in self._pending if fix.stage == stage])
        self._pending = []

    def _send(self, stage: str, fixes: list[Fix]) -> None:
        import rerun as rr

        colours = np.full(len(fixes), self.colour(stage), np.uint32)
        lines = rr.LineStrips2D.columns(
            strips=np.stack([ellipse(fix) for fix in fixes]),
            colors=colours,
            radii=np.full(len(fixes), -0.8),
        )
        shapes = self._cross(fixes, colours) if self._crosses else _points(fixes, colours)
        paths = (CROSSES, CROSS_ELLIPSES) if self._crosses else (POINTS, ELLIPSES)
        for root, columns in zip(paths, (shapes, lines), strict=True):
            self._timeline.declare(Entity(f"{root}/{stage}", "map"))
            self._timeline.send(f"{root}/{stage}", [fix.time_ns for fix in fixes], columns)

    def _cross(self, fixes: list[Fix], colours: NDArray[np.uint32]) -> ComponentColumnList:
        import rerun as rr

        size = CROSS * (self._shown.x[1] - self._shown.x[0])
        places = np.array([(fix.x_m, fix.y_m) for fix in fixes], np.float32)
        return rr.LineStrips2D.columns(
            strips=places[:, np.newaxis, :] + size * TIPS,
            colors=colours,
            radii=np.full(len(fixes), -1.2),
        )

    def colour(self, stage: str) -> int:
        """Return the colour of the places of a stage that has begun."""
        return FIX_COLOURS[self._stages.index(stage) % len(FIX_COLOURS)]


def _points(fixes: list[Fix], colours: NDArray[np.uint32]) -> ComponentColumnList:
    import rerun as rr

    return rr.Points2D.columns(
        positions=np.array([(fix.x_m, fix.y_m) for fix in fixes], np.float32),
        colors=colours,
        radii=np.full(len(fixes), -4.0),
    )
