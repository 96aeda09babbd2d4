"""A walker on the timeline: the detectors' signals, masses, headings, and the map.

The street map is shown only where it is asked for: the viewer loads its tiles from a server, which
learns where the recording was made.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from groundtrace_codecs.events import CandidateBlock, TrackPoint
from groundtrace_codecs.geometry import tangent_plane
from groundtrace_codecs.signals import SignalBlock

from .context import View
from .decisions import worn
from .places import TrackView
from .site import MOST_NAMES, SITE, TRUE, framed, log_outline, log_truth_places
from .timeline import (
    MARGIN,
    NORM,
    SATELLITE,
    TRACK_COLOURS,
    TRUTH,
    WAYPOINT,
    Entity,
    GrowingLine,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace.inertial.steps import PositionReference
    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import TangentPlane

    from .context import ViewContext
    from .timeline import Bounds

    #: Places on the map of metres [m].
    Places = list[tuple[float, float]]


SATELLITES = f"{SITE}/satellites"
WAYPOINTS = f"{TRUE}/waypoints"
FRAME = f"{SITE}/frame"
KEY = f"{SITE}/key"
AXES = ("x_m", "y_m")
#: Waypoints this close are one on the map, as a part of its extent.
SAME = 0.01
#: Lengths of the scale's bar are these times a power of ten, at most this part of the map's extent.
ROUND, LONGEST = (5.0, 2.0, 1.0), 0.2
#: The bar is this far up the margin: its label stands above the key of tracks.
BAR_UP = 1.05


def _satellite_fixes(block: SignalBlock, plane: TangentPlane) -> list[PositionReference]:
    """Return the satellite fixes of a block; none where it is of something else."""
    from groundtrace.inertial.steps import satellite_columns, satellite_fixes

    has_fixes = satellite_columns(block.stream) is not None
    return list(satellite_fixes(block, plane, 0.0)) if has_fixes else []


class WalkMap(View):
    """Logs what is known about where the walker was; shows nothing where nothing is."""

    def __init__(self, context: ViewContext) -> None:
        timeline, session = context.timeline, context.session
        self._timeline = timeline
        site = session.geometry
        self._plane = tangent_plane(site)
        self._points: list[tuple[float, float]] = []
        self._true: list[Label] = []
        self._passed: dict[str, list[TrackPoint]] = {}
        self._keys: list[tuple[str, int]] = []
        self._between = GrowingLine(timeline, f"{SATELLITES}/lines", SATELLITE & 0xFFFFFF50, -0.6)
        self._tracks = TrackView(timeline, None)
        self._begun = False
        quantities = {c.quantity for s in session.streams for c in s.channels}
        self._northward = bool(quantities & {"magnetic_field", "latitude"})
        if site is not None and site.outline:
            self._reach(*site.outline)
            log_outline(timeline, site.outline)
        self._log_truth(session)

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether a walker is replayed."""
        return context.session.application == "walker"

    @property
    def bounds(self) -> Bounds | None:
        """What the map must show; None where fewer than two places are known."""
        true = [(x.x_m or 0.0, x.y_m or 0.0) for x in self._true]
        return framed(np.array([*self._points, *true], np.float64).reshape(-1, 2))

    def signal(self, block: SignalBlock) -> None:
        """Take a block: satellite fixes are shown."""
        for fix in _satellite_fixes(block, self._plane):
            self._log_fix(fix.time_ns, (fix.x_m, fix.y_m))

    def track(self, point: TrackPoint) -> None:
        """Take a point of a track."""
        self._reach((point.x_m, point.y_m))
        self._passed.setdefault(point.stage, []).append(point)
        self._tracks.add(point)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        self._tracks.flush()

    def close(self) -> None:
        """Log what is pending, the key, north and the scale."""
        self._tracks.close()
        self._between.close()
        if not self._northward:
            self._turn_truth()
        bounds = self.bounds
        if bounds is None or not self._begun:
            return
        self._tracks.name(bounds)
        self._log_key(bounds)
        self._log_scale(bounds)
        if self._northward:
            self._log_north(bounds)

    def _turn_truth(self) -> None:
        """Turn and shift the truth onto the last track, whose direction is free."""
        import rerun as rr

        from groundtrace.evaluation.positions import turn_onto

        points = next(reversed(self._passed.values()), [])
        times = np.array([p.time_ns for p in points])
        near = [x for x in self._true if points and times[0] <= x.time_ns <= times[-1]]
        if len(near) < 2:
            return
        at = np.array([x.time_ns for x in near])
        tracked = [np.interp(at, times, [getattr(p, axis) for p in points]) for axis in AXES]
        turn = turn_onto(
            np.array([(x.x_m or 0.0, x.y_m or 0.0) for x in near]), np.stack(tracked, 1)
        )
        rotation, shift = np.eye(3), np.zeros(3)
        rotation[:2, :2], shift[:2] = turn.rotation, turn.shift
        self._timeline.static(TRUE, rr.Transform3D(translation=shift, mat3x3=rotation))
        places = turn(np.array([(x.x_m or 0.0, x.y_m or 0.0) for x in self._true]))
        moved = zip(self._true, places.tolist(), strict=True)
        self._true = [replace(x, x_m=position[0], y_m=position[1]) for x, position in moved]
        self._keys = [(f"{name}, turned onto the track", colour) for name, colour in self._keys]

    def _begin(self) -> None:
        import rerun as rr

        if not self._begun:
            upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
            self._timeline.declare(Entity(SITE, "map"), upwards)
            self._begun = True

    def _reach(self, *places: tuple[float, float]) -> None:
        self._begin()
        self._points += places

    def _log_truth(self, session: ReplaySession) -> None:
        placed = [x for x in session.labels if x.x_m is not None and x.y_m is not None]
        if not placed:
            return
        self._begin()
        self._true = placed
        walked = [x for x in placed if x.kind == "step"]
        walked = walked or [x for x in placed if x.kind == "heading"]
        if walked:
            log_truth_places(self._timeline, walked)
            self._keys.append(("truth", TRUTH))
        self._log_waypoints([x for x in placed if x.kind == "waypoint"])

    def _log_waypoints(self, labels: list[Label]) -> None:
        """Log the distinct waypoints, named by their labels, else by number."""
        import rerun as rr

        positions = np.array([(x.x_m or 0.0, x.y_m or 0.0) for x in self._true])
        apart = SAME * float(np.ptp(positions, axis=0).max())
        places: list[tuple[float, float]] = []
        names: list[list[str]] = []
        for label in sorted(labels):
            position = (label.x_m or 0.0, label.y_m or 0.0)
            same = [i for i, p in enumerate(places) if np.hypot(*np.subtract(p, position)) <= apart]
            if not same:
                places.append(position)
                names.append([])
            entry = names[same[0] if same else -1]
            if label.label and label.label not in entry:
                entry.append(label.label)
        if not places:
            return
        texts = [", ".join(name) or str(number) for number, name in enumerate(names, 1)]
        points = rr.Points2D(
            places,
            labels=texts if len(places) <= MOST_NAMES else None,
            show_labels=len(places) <= MOST_NAMES,
            colors=np.full(len(places), WAYPOINT, np.uint32),
            radii=-4.0,
        )
        self._timeline.static(WAYPOINTS, points)
        self._keys.append(("waypoint", WAYPOINT))

    def _log_fix(self, time_ns: int, position: tuple[float, float]) -> None:
        """Log a satellite fix, and a line to it from the one before."""
        import rerun as rr

        if ("GNSS", SATELLITE) not in self._keys:
            self._keys.append(("GNSS", SATELLITE))
        self._reach(position)
        points = rr.Points2D.columns(
            positions=[position], colors=np.array([SATELLITE], np.uint32), radii=[-1.8]
        )
        self._timeline.declare(Entity(f"{SATELLITES}/points", "map", visible_s=np.inf))
        self._timeline.send(f"{SATELLITES}/points", [time_ns], points)
        self._between.add([(time_ns, position)])

    def _log_key(self, bounds: Bounds) -> None:
        import rerun as rr

        if self._keys:
            key = rr.Points2D(
                bounds.key(len(self._keys), 0.6),
                labels=[name for name, _ in self._keys],
                show_labels=True,
                colors=np.array([colour for _, colour in self._keys], np.uint32),
                radii=-5.0,
            )
            self._timeline.static(KEY, key)

    def _log_north(self, bounds: Bounds) -> None:
        """Log an arrow in the upper right corner."""
        import rerun as rr

        (left, right), (low, high) = bounds.x, bounds.y
        length = 0.07 * max(right - left, high - low)
        at = (right - 0.3 * length, high - 1.3 * length)
        arrow = rr.Arrows2D(
            origins=[at], vectors=[(0.0, length)], labels=["N"], colors=[NORM], radii=-1.5
        )
        self._timeline.static(f"{FRAME}/north", arrow)

    def _log_scale(self, bounds: Bounds) -> None:
        """Log a bar of a round length in the lower left corner."""
        import rerun as rr

        (left, right), (low, high) = bounds.x, bounds.y
        extent = max(right - left, high - low)
        most = LONGEST * extent
        decade = 10.0 ** np.floor(np.log10(most))
        length = next(float(part * decade) for part in ROUND if part * decade <= most)
        x, y = left + 0.02 * extent, low + MARGIN * extent * BAR_UP
        bar = rr.LineStrips2D(
            [[(x, y), (x + length, y)]],
            labels=[f"{length:g} m"],
            show_labels=True,
            colors=[NORM],
            radii=-1.5,
        )
        self._timeline.static(f"{FRAME}/scale", bar)

    kinds: ClassVar = {SignalBlock: signal, TrackPoint: track}


ROOT = "/geo"
FIXES, PRESENT = f"{ROOT}/satellites", f"{ROOT}/present"


class StreetMap(View):
    """Logs satellite fixes, tracks, truth and waypoints by latitude and longitude."""

    def __init__(self, context: ViewContext) -> None:
        session = context.session
        site = session.geometry
        self._timeline = context.timeline
        self._plane = tangent_plane(site)
        self._tracks: dict[str, list[TrackPoint]] = {}
        placed = sorted(x for x in session.labels if x.x_m is not None and x.y_m is not None)
        by_kind: dict[str, Places] = {}
        for label in placed:
            by_kind.setdefault(label.kind, []).append((label.x_m or 0.0, label.y_m or 0.0))
        self._truth = by_kind.get("step") or by_kind.get("heading", [])
        self._waypoints = by_kind.get("waypoint", [])

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether a walker is replayed, and a street map asked for."""
        return context.map_tiles and context.session.application == "walker"

    def signal(self, block: SignalBlock) -> None:
        """Take a block: satellite fixes are shown as they come."""
        fixes = _satellite_fixes(block, self._plane)
        if fixes:
            places = [(fix.x_m, fix.y_m) for fix in fixes]
            entity = Entity(FIXES, "geo", visible_s=np.inf)
            times_ns = [fix.time_ns for fix in fixes]
            self._log_points(entity, times_ns, places, SATELLITE, 2.5)

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
                times_ns = [p.time_ns for p in points]
                self._log_points(Entity(PRESENT, "geo"), times_ns, places, colour, 6.0)
        self._log_line(f"{ROOT}/truth", self._truth, TRUTH)
        if self._waypoints:
            self._log_waypoints(self._waypoints)

    def _degrees(self, places: Places) -> list[tuple[float, float]]:
        positions = [self._plane.position(*point) for point in places]
        return [tuple(pair) for pair in np.degrees(positions).tolist()]

    def _log_points(
        self,
        entity: Entity,
        times_ns: Iterable[int],
        places: Places,
        colour: int,
        radius: float,
    ) -> None:
        """Log a point a row; radii in the viewer's points."""
        import rerun as rr

        columns = rr.GeoPoints.columns(
            positions=self._degrees(places),
            colors=np.full(len(places), colour, np.uint32),
            radii=np.full(len(places), -radius),
        )
        self._timeline.declare(entity)
        self._timeline.send(entity.path, list(times_ns), columns)

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

    kinds: ClassVar = {SignalBlock: signal, TrackPoint: track}


#: Columns of a reckoner's candidates that the table shows, with their names there.
SHOWN = {"azimuth": "azimuth_deg", "length": "length_m", "mounting": "mounting_deg"}


class AzimuthView(View):
    """Adds columns to the rows of steps that a reckoner took.

    A row of the table is a moment, so that what is logged at the time of a step stands in its row.
    """

    def __init__(self, context: ViewContext) -> None:
        self._timeline = context.timeline
        self._pending: list[CandidateBlock] = []

    fits = staticmethod(worn)

    def candidates(self, block: CandidateBlock) -> None:
        """Take decided candidates; those of a reckoner are the steps, moment by moment."""
        names = {column.name for column in block.spec.columns}
        if block.spec.emits == "track" and SHOWN.keys() <= names:
            self._pending.append(block)

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        import rerun as rr

        for spec in dict.fromkeys(block.spec for block in self._pending):
            blocks = [block for block in self._pending if block.spec == spec]
            taken = np.concatenate([block.accepted for block in blocks])
            times = np.concatenate([block.time_ns for block in blocks])[taken]
            values = np.concatenate([block.value for block in blocks])[taken]
            names = [column.name for column in spec.columns]
            # more digits would only fill the table
            values = values.astype(np.float64).round(2)
            shown = {title: values[:, names.index(name)] for name, title in SHOWN.items()}
            if len(times):
                self._timeline.send("/table/steps", times, rr.AnyValues.columns(**shown))
        self._pending = []

    kinds: ClassVar = {CandidateBlock: candidates}
