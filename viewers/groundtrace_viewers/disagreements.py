"""Localizers that place a step apart: a line between the two places, and a line of the log."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from .palette import DISAGREEMENT
from .sensor_map import SITE
from .timeline import Entity

if TYPE_CHECKING:
    from groundtrace_codecs.events import Disagreement, Fix

    from .events import LogLines
    from .timeline import Timeline

LINES = f"{SITE}/disagreements"
#: Places of so many fixes are remembered: a step is compared when the next has been located.
MOST_FIXES = 64


class DisagreementLog:
    """Logs disagreements.

    Parameters
    ----------
    timeline
        Where to.
    lines
        The log.
    unit
        Of lengths.
    on_map
        Whether there is a map.
    """

    def __init__(self, timeline: Timeline, lines: LogLines, unit: str, *, on_map: bool) -> None:
        self._timeline = timeline
        self._lines = lines
        self._unit = unit
        self._on_map = on_map
        self._places: dict[tuple[int, str], tuple[float, float]] = {}
        self._order: deque[tuple[int, str]] = deque()

    def fix(self, fix: Fix) -> None:
        """Remember a place."""
        key = (fix.time_ns, fix.stage)
        self._places[key] = (fix.x_m, fix.y_m)
        self._order.append(key)
        if len(self._order) > MOST_FIXES:
            self._places.pop(self._order.popleft(), None)

    def add(self, found: Disagreement) -> None:
        """Take a disagreement."""
        where = self._timeline.seconds(found.time_ns)
        text = (
            f"{where}  {found.methods.replace(', ', ' and ')} disagree by "
            f"{found.distance_m:.2f} {self._unit}, {found.value:.1f} sigma ({found.stage})"
        )
        self._lines.add("disagreements", found.time_ns, text, "WARN")
        stages = found.methods.split(", ")
        ends = [self._places.get((found.time_ns, stage)) for stage in stages]
        if self._on_map and len(ends) == 2 and None not in ends:
            self._line(found.time_ns, np.array(ends, np.float32))

    def _line(self, time_ns: int, ends: np.ndarray) -> None:
        import rerun as rr

        columns = rr.LineStrips2D.columns(
            strips=ends[np.newaxis],
            colors=np.array([DISAGREEMENT], np.uint32),
            radii=np.array([-0.8], np.float32),
        )
        self._timeline.declare(Entity(LINES, "map"))
        self._timeline.send(LINES, [time_ns], columns)
