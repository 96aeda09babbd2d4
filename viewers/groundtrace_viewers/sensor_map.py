"""The site from above: outline, sensors in their colours, shot points and the true path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .arrivals_map import ArrivalSigns
from .palette import IMPACT, OUTLINE
from .road_map import log_road
from .timeline import Entity
from .truth_map import log_truth_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace.sinks import Session
    from groundtrace_codecs.geometry import Geometry, Sensor
    from groundtrace_codecs.labels import Label

    from .palette import SensorColours
    from .timeline import Timeline

#: Everything on the map hangs below this entity, which turns y upwards.
SITE = "/map/site"
ARRIVALS = f"{SITE}/arrivals"
NAMES = f"{SITE}/names"
#: Above this many sensors only some are named: labels must not cover each other.
MOST_NAMES = 16
#: Radius of a sensor in screen points, how much larger one is that a wave reaches, and the width
#: that a map may count on.
RADIUS, LIT, MAP_POINTS = 6.0, 1.4, 480.0
#: Around the site, as parts of its extent: at the sides, and above and below.
SIDE, MARGIN = 0.1, 0.16
#: Side of a shot point's triangle and height of its name, as parts of the site's extent.
TRIANGLE, NAME = 0.022, 0.09
#: What is shown beyond sensors that vehicles pass: a part of their extent, and this at least [m].
REACH, LEAST_REACH_M = 0.45, 10.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """What of the site to show [m], y upwards; above and below is room for the map's key."""

    x: tuple[float, float]
    y: tuple[float, float]

    def key(self, count: int, height: float) -> NDArray[np.float64]:
        """Return places in a row beside the site, shape (count, 2) [m].

        Parameters
        ----------
        count
            How many.
        height
            How far up the margin above the site; below it where negative.
        """
        (left, right), (low, high) = self.x, self.y
        extent = max((right - left) / (1 + 2 * SIDE), (high - low) / (1 + 2 * MARGIN))
        margin = MARGIN * extent
        across = left + (right - left) * (np.arange(count) + 0.5) / count
        up = (high if height > 0 else low) + (height - np.sign(height)) * margin
        return np.stack([across, np.full(count, up)], axis=1)


@dataclass(frozen=True, slots=True)
class Sign:
    """The name of a sensor on the map, or of several at one place.

    Attributes
    ----------
    name, colour
        As shown.
    x, y
        Where [m].
    channels
        That are recorded there.
    """

    name: str
    colour: int
    x: float
    y: float
    channels: tuple[str, ...]


def signs_of(geometry: Geometry, colours: SensorColours) -> list[Sign]:
    """Return one sign for each place with sensors, of the vertical sensor's colour."""
    placed: dict[tuple[float, float], list[Sensor]] = {}
    for sensor in geometry.sensors:
        placed.setdefault((sensor.x, sensor.y), []).append(sensor)
    found = []
    for (x, y), sensors in placed.items():
        main = next((s for s in sensors if s.axis == "z"), sensors[0])
        channels = tuple(s.channel for s in sensors)
        found.append(Sign(main.name, colours.of(main.channel), x, y, channels))
    return found


def placed(session: Session) -> list[Label]:
    """Return the labels that the map shows as places; vehicles come from afar, and go."""
    if session.application == "vehicle":
        return []
    return [x for x in session.labels if x.x_m is not None and x.y_m is not None]


def places(session: Session) -> NDArray[np.float64]:
    """Return every place the map must show, shape (n, 2) [m]."""
    points: list[tuple[float, float]] = [
        (label.x_m or 0.0, label.y_m or 0.0) for label in placed(session)
    ]
    if session.geometry is not None:
        geometry = session.geometry
        points += [(s.x, s.y) for s in geometry.sensors]
        points += list(geometry.outline)
        points += [(x, y) for _, x, y in geometry.sources]
    known = np.array(points, np.float64).reshape(-1, 2)
    return _around(known) if session.application == "vehicle" and len(known) else known


def _around(known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of what is shown around sensors that vehicles pass."""
    low, high = known.min(axis=0), known.max(axis=0)
    reach = np.maximum(REACH * (high - low), LEAST_REACH_M)
    return np.array([low - reach, high + reach])


def bounds(session: Session) -> Bounds | None:
    """Return what the map must show, or None where the session knows fewer than two places."""
    return framed(places(session))


def framed(known: NDArray[np.float64]) -> Bounds | None:
    """Return what a map of places, shape (n, 2) [m], must show; None for fewer than two."""
    if len(np.unique(known, axis=0)) < 2:
        return None
    low, high = known.min(axis=0), known.max(axis=0)
    extent = float(np.max(high - low))
    side, margin = SIDE * extent, MARGIN * extent
    return Bounds(
        (float(low[0]) - side, float(high[0]) + side),
        (float(low[1]) - margin, float(high[1]) + margin),
    )


def labelled(count: int) -> list[int]:
    """Return which of the sensors are named: all, or every fourth and the last."""
    if count <= MOST_NAMES:
        return list(range(count))
    kept = list(range(0, count - 2, 4))
    return [*kept, count - 1]


def marker_radius(points: Sequence[tuple[float, float]], extent_m: float) -> float:
    """Return the radius [screen points] that keeps neighbours apart on a map of that extent."""
    if len(points) < 2:
        return RADIUS
    apart = np.linalg.norm(np.diff(np.array(points), axis=0), axis=1)
    nearest = float(np.median(apart)) / extent_m * MAP_POINTS
    return float(np.clip(0.3 * nearest, 2.0, RADIUS))


def log_outline(timeline: Timeline, outline: Sequence[tuple[float, float]]) -> None:
    """Log the walls."""
    import rerun as rr

    line = rr.LineStrips2D([[*outline, outline[0]]], colors=[OUTLINE], radii=-1.0)
    timeline.static(f"{SITE}/outline", line)


class SensorMap:
    """Logs the map of a session and lights sensors up as waves arrive.

    Parameters
    ----------
    timeline
        Where to.
    session
        Gives geometry and truth.
    colours
        Of the sensors.

    Attributes
    ----------
    signs, names
        The sensors that are named, and what their names say over time.
    """

    def __init__(self, timeline: Timeline, session: Session, colours: SensorColours) -> None:
        import rerun as rr

        self._timeline = timeline
        self._colours = colours
        sensors = session.geometry.sensors if session.geometry else ()
        self._place = {s.channel: (s.x, s.y) for s in sensors}
        self._arrivals: list[tuple[int, str]] = []
        self.signs: tuple[Sign, ...] = ()
        self._extent = float(np.ptp(places(session), axis=0).max())
        self._radius = marker_radius(list(dict.fromkeys(self._place.values())), self._extent)
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        timeline.declare(Entity(SITE, "map"), upwards)
        if session.geometry is not None:
            self._log_geometry(session.geometry)
        self.names = ArrivalSigns(timeline, NAMES, self.signs, session.start_ns)
        log_truth_places(timeline, placed(session))

    def _log_geometry(self, geometry: Geometry) -> None:
        import rerun as rr

        if geometry.outline:
            log_outline(self._timeline, geometry.outline)
        if geometry.road:
            log_road(self._timeline, SITE, geometry.road, self._extent)
        signs = signs_of(geometry, self._colours)
        if signs:
            sensors = rr.Points2D(
                [(s.x, s.y) for s in signs],
                colors=np.array([s.colour for s in signs], np.uint32),
                radii=-self._radius,
            )
            self._timeline.static(f"{SITE}/sensors", sensors)
            self.signs = tuple(signs[i] for i in labelled(len(signs)))
            # what the names say is logged over time
            names = rr.Points2D.from_fields(
                positions=[(s.x, s.y) for s in self.signs],
                show_labels=True,
                radii=[-self._radius],
            )
            self._timeline.static(NAMES, names)
        if geometry.sources:
            self._log_sources(geometry.sources)

    def _log_sources(self, sources: Sequence[tuple[str, float, float]]) -> None:
        """Log a triangle that stands on each shot point, clear of the sensors' names below."""
        import rerun as rr

        x = np.array([s[1] for s in sources])
        y = np.array([s[2] for s in sources])
        side, name = TRIANGLE * self._extent, NAME * self._extent
        corners = np.array([(0.0, 0.3), (-0.5, 1.2), (0.5, 1.2), (0.0, 0.3), (0.0, 1.2)]) * side
        strips = np.stack([x, y], axis=1)[:, np.newaxis, :] + corners
        colours = np.full(len(sources), IMPACT, np.uint32)
        triangles = rr.LineStrips2D(list(strips.astype(np.float32)), colors=colours, radii=-2.2)
        self._timeline.static(f"{SITE}/sources", triangles)
        if len(sources) <= MOST_NAMES:
            names = rr.Points2D(
                np.stack([x, y + name], axis=1),
                labels=[s[0] for s in sources],
                show_labels=True,
                colors=colours,
                radii=-0.1,
            )
            self._timeline.static(f"{SITE}/sources/names", names)

    def arrival(self, time_ns: int, channel: str) -> None:
        """Take the arrival of a wave at a sensor."""
        if channel in self._place:
            self._arrivals.append((time_ns, channel))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        self.names.flush()
        if not self._arrivals:
            return
        times = [t for t, _ in self._arrivals]
        names = [name for _, name in self._arrivals]
        columns = rr.Points2D.columns(
            positions=np.array([self._place[n] for n in names], np.float32),
            colors=np.array([self._colours.of(n) for n in names], np.uint32),
            radii=np.full(len(names), -LIT * self._radius),
        )
        self._timeline.declare(Entity(ARRIVALS, "map"))
        self._timeline.send(ARRIVALS, times, columns)
        self._arrivals = []
