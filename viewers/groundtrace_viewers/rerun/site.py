"""The site from above, with outline, sensors, shot points and true path."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle, pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from groundtrace_codecs.events import Pick
from groundtrace_codecs.signals import NS_PER_S

from .context import View
from .timeline import (
    IMPACT,
    LEFT,
    MARGIN,
    OUTLINE,
    RIGHT,
    ROAD,
    ROAD_SIGN,
    ROOM_MARGIN,
    SIDE,
    SILENT,
    WALKED,
    WALKER_COLOURS,
    Bounds,
    Entity,
    GrowingLine,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import Geometry, Sensor

    from .context import ViewContext
    from .timeline import SensorColours, Timeline

#: Everything on the map hangs below this entity, which turns y upwards.
SITE = "/map/site"
ARRIVALS = f"{SITE}/arrivals"
NAMES = f"{SITE}/names"
#: Above this many sensors only some are named: labels must not cover each other.
MOST_NAMES = 16
#: Radius of a sensor in screen points, how much larger one is that a wave reaches, and the width
#: that a map may count on.
RADIUS, LIT, MAP_POINTS = 6.0, 1.4, 480.0
#: Side of a shot point's triangle and height of its name, as parts of the site's extent.
TRIANGLE, NAME = 0.022, 0.09
#: What is shown beyond sensors that vehicles pass: a part of their extent, and this at least [m].
REACH, LEAST_REACH_M = 0.45, 10.0


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
    sensor_signs = []
    for (x, y), sensors in placed.items():
        main = next((s for s in sensors if s.axis == "z"), sensors[0])
        channels = tuple(s.channel for s in sensors)
        sensor_signs.append(Sign(main.name, colours.of(main.channel), x, y, channels))
    return sensor_signs


def placed(session: ReplaySession) -> list[Label]:
    """Return the labels that the map shows as places; vehicles come from afar, and go."""
    if session.application == "vehicle":
        return []
    return [x for x in session.labels if x.x_m is not None and x.y_m is not None]


def places(session: ReplaySession) -> NDArray[np.float64]:
    """Return every place the map must show, shape (n, 2) [m]."""
    points: list[tuple[float, float]] = [
        (label.x_m or 0.0, label.y_m or 0.0) for label in placed(session)
    ]
    if session.geometry is not None:
        geometry = session.geometry
        points += [(s.x, s.y) for s in geometry.sensors]
        points += list(geometry.outline)
        points += [(x, y) for _, x, y in geometry.sources]
    positions = np.array(points, np.float64).reshape(-1, 2)
    return _around(positions) if session.application == "vehicle" and len(positions) else positions


def _around(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of what is shown around sensors that vehicles pass."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    reach = np.maximum(REACH * (high - low), LEAST_REACH_M)
    return np.array([low - reach, high + reach])


def bounds(session: ReplaySession) -> Bounds | None:
    """Return what the map must show, or None where the session knows fewer than two places.

    A walker has a map of its own.
    """
    if session.application == "walker":
        return None
    return framed(places(session), ROOM_MARGIN if session.application == "room" else MARGIN)


def framed(positions: NDArray[np.float64], margin: float = MARGIN) -> Bounds | None:
    """Return what a map of places, shape (n, 2) [m], must show; None for fewer than two."""
    if len(np.unique(positions, axis=0)) < 2:
        return None
    low, high = positions.min(axis=0), positions.max(axis=0)
    extent = float(np.max(high - low))
    side, above = SIDE * extent, margin * extent
    return Bounds(
        (float(low[0]) - side, float(high[0]) + side),
        (float(low[1]) - above, float(high[1]) + above),
        margin,
    )


def labelled(count: int) -> list[int]:
    """Return which of the sensors are named: all, or every fourth and the last."""
    if count <= MOST_NAMES:
        return list(range(count))
    every_fourth = list(range(0, count - 2, 4))
    return [*every_fourth, count - 1]


def named(signs: Sequence[Sign]) -> list[Sign]:
    """Return the signs that are named."""
    return [signs[i] for i in labelled(len(signs))]


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


class SensorMap(View):
    """Logs the map of a session and lights sensors up as waves arrive."""

    def __init__(self, context: ViewContext) -> None:
        import rerun as rr

        session, timeline = context.session, context.timeline
        self._bounds = bounds(session)
        self._stages = context.stages
        self._timeline = timeline
        self._colours = context.colours
        sensors = session.geometry.sensors if session.geometry else ()
        self._positions = {s.channel: (s.x, s.y) for s in sensors}
        self._arrivals: list[tuple[int, str]] = []
        self._extent = float(np.ptp(places(session), axis=0).max())
        self._radius = marker_radius(list(dict.fromkeys(self._positions.values())), self._extent)
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        timeline.declare(Entity(SITE, "map"), upwards)
        if session.geometry is not None:
            self._log_geometry(session.geometry)
        names = ArrivalSigns(timeline, session.geometry, self._colours)
        names.clear(session.start_ns)
        names.flush()
        log_truth_places(timeline, placed(session))

    def _log_geometry(self, geometry: Geometry) -> None:
        import rerun as rr

        if geometry.outline:
            log_outline(self._timeline, geometry.outline)
        if geometry.paths:
            lines = [list(path) for path in geometry.paths]
            paths = rr.LineStrips2D(
                lines, colors=[WALKED] * len(lines), radii=-1.5, draw_order=-25.0
            )
            self._timeline.static(f"{SITE}/paths", paths)
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
            # what the names say is logged over time
            names = rr.Points2D.from_fields(
                positions=[(s.x, s.y) for s in named(signs)],
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

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether there are places to show."""
        return bounds(context.session) is not None

    @property
    def bounds(self) -> Bounds | None:
        """What the map must show."""
        return self._bounds

    def pick(self, pick: Pick) -> None:
        """Take the arrival of a wave at a sensor, of the stage that is reported."""
        if pick.channel in self._positions and self._stages.decides("pick", pick):
            self._arrivals.append((pick.time_ns, pick.channel))

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        import rerun as rr

        if not self._arrivals:
            return
        times = [t for t, _ in self._arrivals]
        names = [name for _, name in self._arrivals]
        columns = rr.Points2D.columns(
            positions=np.array([self._positions[n] for n in names], np.float32),
            colors=np.array([self._colours.of(n) for n in names], np.uint32),
            radii=np.full(len(names), -LIT * self._radius),
        )
        self._timeline.declare(Entity(ARRIVALS, "map", visible_s=0.25))
        self._timeline.send(ARRIVALS, times, columns)
        self._arrivals = []

    kinds: ClassVar = {Pick: pick}


def first_at(owner: Mapping[str, str], picks: Sequence[Pick]) -> dict[str, int]:
    """Return first arrivals [ns] by the names of signs, which own channels."""
    arrivals_ns: dict[str, int] = {}
    for pick in picks:
        name = owner.get(pick.channel)
        if name is not None:
            arrivals_ns[name] = min(arrivals_ns.get(name, pick.time_ns), pick.time_ns)
    return arrivals_ns


def shown_names(signs: Sequence[Sign], arrived: Mapping[str, int]) -> list[str]:
    """Return the signs' texts: name, and how long after the first arrival its own came."""
    first_ns = min(arrived.values(), default=0)
    return [
        f"{sign.name} {(arrived[sign.name] - first_ns) / NS_PER_S * 1e3:+.1f} ms"
        if sign.name in arrived
        else sign.name
        for sign in signs
    ]


class ArrivalSigns:
    """Logs the names of the sensors; at a step with their arrivals, grey where there is none.

    Parameters
    ----------
    timeline
        Where to.
    geometry
        Where the sensors are: places and sizes of their names are on the map already.
    colours
        Of the sensors.
    """

    def __init__(
        self, timeline: Timeline, geometry: Geometry | None, colours: SensorColours
    ) -> None:
        self._timeline = timeline
        self._signs = named(signs_of(geometry, colours)) if geometry is not None else []
        self._owner = {channel: sign.name for sign in self._signs for channel in sign.channels}
        self._rows: list[tuple[int, list[str], list[int]]] = []

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Show a step's arrivals."""
        arrived = first_at(self._owner, picks)
        shades = [s.colour if s.name in arrived else SILENT for s in self._signs]
        self._rows.append((time_ns, shown_names(self._signs, arrived), shades))

    def clear(self, time_ns: int) -> None:
        """Show names alone."""
        names = [sign.name for sign in self._signs]
        self._rows.append((time_ns, names, [sign.colour for sign in self._signs]))

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        if not self._signs or not self._rows:
            return
        columns = rr.Points2D.columns(
            labels=[text for _, texts, _ in self._rows for text in texts],
            colors=np.array([colours for _, _, colours in self._rows], np.uint32).ravel(),
        )
        counts = [len(self._signs)] * len(self._rows)
        self._timeline.send(NAMES, [row[0] for row in self._rows], columns.partition(counts))
        self._rows = []


TRUE = "/map/site/truth"
PATH, FOOTFALLS = f"{TRUE}/path", f"{TRUE}/footfalls"


def log_truth_places(timeline: Timeline, labels: Sequence[Label]) -> None:
    """Log where steps and impacts were, and between steps the path, which grows."""
    import rerun as rr

    if not labels:
        return
    truth = sorted(labels)
    targets = sorted({x.target for x in truth})
    walkers = dict(zip(targets, cycle(WALKER_COLOURS), strict=False))
    feet = {"left": LEFT, "right": RIGHT} if len(targets) == 1 else {}
    columns = rr.Points2D.columns(
        positions=np.array([(x.x_m, x.y_m) for x in truth], np.float32),
        colors=np.array([feet.get(x.label, walkers[x.target]) for x in truth], np.uint32),
        radii=np.full(len(truth), -4.0),
    )
    timeline.declare(Entity(FOOTFALLS, "map", visible_s=3.0))
    timeline.send(FOOTFALLS, [x.time_ns for x in truth], columns)
    for target in targets:
        walked = [x for x in truth if x.kind != "impact" and x.target == target]
        path = f"{PATH}/{target}" if target else PATH
        line = GrowingLine(timeline, path, walkers[target], -1.2)
        line.add([(x.time_ns, (x.x_m or 0.0, x.y_m or 0.0)) for x in walked])
        line.close()


#: Between two signs and size of one, as parts of the site's extent; more would hide the road.
APART, SIZE, MOST_SIGNS = 0.2, 0.03, 60
#: A tip that points along x.
TIP = np.array([(-1.0, 0.8), (0.0, 0.0), (-1.0, -0.8)])


def log_road(
    timeline: Timeline, site: str, road: Sequence[tuple[float, float]], extent_m: float
) -> None:
    """Log a road below the entity of a site, beneath all else.

    Parameters
    ----------
    timeline
        Where to.
    site
        Entity of the site.
    road
        Corners [m].
    extent_m
        Of the site.
    """
    import rerun as rr

    line = rr.LineStrips2D([list(road)], colors=[ROAD], radii=-5.0, draw_order=-25.0)
    timeline.static(f"{site}/road", line)
    tips = signs(road, APART * extent_m, SIZE * extent_m)
    if tips:
        drawn = rr.LineStrips2D(tips, colors=[ROAD_SIGN], radii=-0.8, draw_order=-3.0)
        timeline.static(f"{site}/road/forward", drawn)


def signs(
    road: Sequence[tuple[float, float]], apart_m: float, size_m: float
) -> list[NDArray[np.float32]]:
    """Return tips along a road, each of shape (3, 2) [m], the same way apart from one another."""
    corners = np.array(road, np.float64)
    length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    apart_m = max(apart_m, length / MOST_SIGNS)
    tips: list[NDArray[np.float32]] = []
    gone = 0.0
    for start, end in pairwise(corners):
        way = float(np.hypot(*(end - start)))
        if way == 0.0:
            continue
        x, y = (end - start) / way
        rotated = size_m * TIP @ np.array([(x, y), (-y, x)])
        first = np.ceil(gone / apart_m) * apart_m
        along = np.arange(first, gone + way, apart_m) - gone
        at = start + np.outer(along, (x, y))
        tips += list((at[:, np.newaxis] + rotated).astype(np.float32))
        gone += way
    return tips
