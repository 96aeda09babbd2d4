"""The way of a walker on a street map, where it is asked for: the viewer loads its tiles.

Nothing here is shown by default, since the tiles' server learns where the recording was made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.reckoning.places import TangentPlane, satellite_columns, satellite_fixes

from .palette import SATELLITE, TRACK_COLOURS, TRUTH, WAYPOINT
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import TrackPoint
    from groundtrace_codecs.signals import SignalBlock

    from .timeline import Timeline

    #: Places on the map of metres [m].
    Places = list[tuple[float, float]]

ROOT = "/geo"
FIXES, PRESENT = f"{ROOT}/satellites", f"{ROOT}/present"


class StreetMap:
    """Logs satellite fixes, tracks, truth and waypoints by latitude and longitude.

    Parameters
    ----------
    timeline
        Where to.
    session
        Gives start and truth.
    """

    def __init__(self, timeline: Timeline, session: Session) -> None:
        site = session.geometry
        self._timeline = timeline
        self._plane = TangentPlane(site.start if site is not None and site.start else (0.0, 0.0))
        self._tracks: dict[str, list[TrackPoint]] = {}
        placed = sorted(x for x in session.labels if x.x_m is not None and x.y_m is not None)
        known: dict[str, Places] = {}
        for label in placed:
            known.setdefault(label.kind, []).append((label.x_m or 0.0, label.y_m or 0.0))
        self._truth = known.get("step") or known.get("heading", [])
        self._waypoints = known.get("waypoint", [])

    def signal(self, block: SignalBlock) -> None:
        """Take a block: satellite fixes are shown as they come."""
        if satellite_columns(block.stream) is None:
            return
        fixes = satellite_fixes(block, self._plane, 0.0)
        if fixes:
            places = [(fix.x_m, fix.y_m) for fix in fixes]
            self._log_points(FIXES, [fix.time_ns for fix in fixes], places, SATELLITE, 2.5)

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        self._tracks.setdefault(point.stage, []).append(point)

    def close(self) -> None:
        """Log what needs the first satellite fix: without one nothing else has a place on earth."""
        if self._plane.origin is None:
            return
        for number, (stage, points) in enumerate(self._tracks.items()):
            colour = TRACK_COLOURS[0][min(number, 1)]
            places = [(p.x_m, p.y_m) for p in points]
            self._log_line(f"{ROOT}/tracks/{stage}", places, colour)
            if number == 0:
                self._log_points(PRESENT, [p.time_ns for p in points], places, colour, 6.0)
        self._log_line(f"{ROOT}/truth", self._truth, TRUTH)
        if self._waypoints:
            self._log_waypoints(self._waypoints)

    def _degrees(self, places: Places) -> list[tuple[float, float]]:
        positions = [self._plane.position(*place) for place in places]
        return [tuple(pair) for pair in np.degrees(positions).tolist()]

    def _log_points(
        self, path: str, times_ns: Iterable[int], places: Places, colour: int, radius: float
    ) -> None:
        """Log a point a row; radii in the viewer's points."""
        import rerun as rr

        columns = rr.GeoPoints.columns(
            positions=self._degrees(places),
            colors=np.full(len(places), colour, np.uint32),
            radii=np.full(len(places), -radius),
        )
        self._timeline.declare(Entity(path, "geo"))
        self._timeline.send(path, list(times_ns), columns)

    def _log_line(self, path: str, places: Places, colour: int) -> None:
        import rerun as rr

        if len(places) > 1:
            line = rr.GeoLineStrings(
                lat_lon=[np.array(self._degrees(places))],
                colors=np.array([colour], np.uint32),
                radii=-1.5,
            )
            self._timeline.declare(Entity(path, "geo"), line)

    def _log_waypoints(self, places: Places) -> None:
        import rerun as rr

        points = rr.GeoPoints(
            lat_lon=self._degrees(places), colors=np.array([WAYPOINT], np.uint32), radii=-4.0
        )
        self._timeline.declare(Entity(f"{ROOT}/waypoints", "geo"), points)
