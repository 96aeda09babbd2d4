"""Stations of three axes: the ground's motion at each step, and the direction its wave came from.

A hodogram shows the motion at a station just after a wave arrives. Each station has two squares of
one scale: from above (x to the right, y up) and from the side (radial, away from the source, to the
right, z up).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers.bearings import PARTS, polarization, stations
from groundtrace_codecs.signals import NS_PER_S

from .site import SITE
from .timeline import Entity, Strips, dimmed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Bearing, Pick
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from .samples import Traces
    from .timeline import SensorColours, Timeline

    Array = NDArray[np.float64]

#: Bearings of so many steps wait for their step's signal.
MOST_STEPS = 64


class StationViews:
    """Logs hodograms and bearings of the stations of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of their channels.
    geometry
        Where they stand.
    colours
        Of the sensors; a station has its vertical channel's.
    traces
        The last samples of all streams.
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        geometry: Geometry,
        colours: SensorColours,
        traces: Traces,
    ) -> None:
        self._stations = stations(stream, geometry)
        self._channels = [
            tuple(stream.channels[column].name for column in s.columns) for s in self._stations
        ]
        names = [s.name for s in self._stations]
        shades = [colours.of(channels[2]) for channels in self._channels]
        places = {s.name: s.position for s in self._stations}
        positions = np.array([*((s.x, s.y) for s in geometry.sensors), *geometry.outline])
        box = np.stack([positions.min(axis=0), positions.max(axis=0)])
        self._hodograms = HodogramView(timeline, names, shades)
        self._rays = BearingView(timeline, places, dict(zip(names, shades, strict=True)), box)
        self._traces, self._topic = traces, stream.topic
        self._bearings: dict[int, dict[str, Bearing]] = {}

    @staticmethod
    def fits(stream: Stream, geometry: Geometry) -> bool:
        """Whether a stream has stations of three axes."""
        return bool(stations(stream, geometry))

    def bearing(self, bearing: Bearing) -> None:
        """Take a bearing."""
        self._bearings.setdefault(bearing.time_ns, {})[bearing.station] = bearing
        while len(self._bearings) > MOST_STEPS:
            self._bearings.pop(min(self._bearings))

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Show a step."""
        bearings = self._bearings.pop(time_ns, {})
        self._rays.step(time_ns, bearings)
        moved = {}
        for index, station in enumerate(self._stations):
            arrivals_ns = [p.time_ns for p in picks if p.channel in self._channels[index]]
            values = self._motion(min(arrivals_ns, default=time_ns), index)
            if len(values) < 2 * PARTS or not np.ptp(values, axis=0).all():
                continue
            bearing = bearings.get(station.name)
            azimuth = bearing.azimuth_rad if bearing else polarization(values).azimuth_rad
            moved[index] = values, azimuth
        self._hodograms.step(time_ns, moved)

    def _motion(self, start_ns: int, index: int) -> NDArray[np.float64]:
        """Return the motion of a station from a time on, shape (n, 3)."""
        end_ns = start_ns + round(LENGTH_S * NS_PER_S)
        columns = self._stations[index].columns
        piece = self._traces.between(self._topic, start_ns, end_ns, columns)
        return np.empty((0, 3)) if piece is None else piece[1]

    def flush(self) -> None:
        """Log what is pending."""
        self._hodograms.flush()
        self._rays.flush()

    def clear(self, time_ns: int) -> None:
        """Show no bearings any more."""
        self._rays.clear(time_ns)


#: Brightness of a ray and of its sides as parts of the station's.
RAY, FAN = 0.75, 0.4
RAYS, FANS = f"{SITE}/bearings/rays", f"{SITE}/bearings/fans"


def ahead(
    origin: NDArray[np.float64], angle_rad: NDArray[np.float64], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where rays leave a box, shape (k, 2) [m].

    Parameters
    ----------
    origin
        Shape (2,): where they begin [m].
    angle_rad
        Shape (k,): whereto.
    box
        Shape (2, 2): lowest and highest corner [m]; rays that leave it at once are a tenth long.
    """
    towards = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(towards > 0, box[1] - origin, box[0] - origin) / towards
    length: NDArray[np.float64] = np.where(towards == 0, np.inf, far).min(axis=1, keepdims=True)
    least = 0.1 * float(np.max(box[1] - box[0]))
    end: NDArray[np.float64] = origin + np.maximum(length, least) * towards
    return end


def rays(
    bearing: Bearing, position: tuple[float, float], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return lines of a bearing: the ray, and one standard deviation to either side.

    Parameters
    ----------
    bearing
        Of one station.
    position
        Where it stands [m].
    box
        Shape (2, 2): lowest and highest corner of the site [m].

    Returns
    -------
    numpy.ndarray
        Shape (k, 2, 2) [m]: the ray first, then its sides where the deviation is known; an
        ambiguous bearing is a line through the station.
    """
    sigma = bearing.sigma_rad if np.isfinite(bearing.sigma_rad) else 0.0
    angles = bearing.azimuth_rad + np.array([0.0, sigma, -sigma] if sigma else [0.0])
    at = np.array(position, np.float64)
    end = ahead(at, angles, box)
    start = ahead(at, angles + np.pi, box) if bearing.ambiguous else np.broadcast_to(at, end.shape)
    return np.stack([start, end], axis=1)


class BearingView:
    """Logs the bearings of each step.

    Parameters
    ----------
    timeline
        Where to.
    places, colours
        Of the stations, by name [m].
    box
        Shape (2, 2): lowest and highest corner of the site [m], where rays end.
    """

    def __init__(
        self,
        timeline: Timeline,
        places: Mapping[str, tuple[float, float]],
        colours: Mapping[str, int],
        box: NDArray[np.float64],
    ) -> None:
        self._rays = Strips(timeline, RAYS, -10.0)
        self._fans = Strips(timeline, FANS, -12.0)
        self._places = places
        self._colours = colours
        self._box = box

    def step(self, time_ns: int, bearings: Mapping[str, Bearing]) -> None:
        """Show the bearings of a step, by station."""
        middles, sides = [], []
        shades, faint = [], []
        for name, bearing in bearings.items():
            if name in self._places:
                middle, *others = rays(bearing, self._places[name], self._box)
                middles.append(middle)
                sides += others
                shades.append(dimmed(self._colours[name], RAY))
                faint += [dimmed(self._colours[name], FAN)] * len(others)
        self._rays.add(time_ns, middles, shades, [-1.0] * len(middles))
        self._fans.add(time_ns, sides, faint, [-0.6] * len(sides))

    def clear(self, time_ns: int) -> None:
        """Show none any more."""
        self._rays.clear(time_ns)
        self._fans.clear(time_ns)

    def flush(self) -> None:
        """Log what is pending."""
        self._rays.flush()
        self._fans.flush()


ROOT = "/hodogram"
PLOTS = f"{ROOT}/plots"
MOTION, HODOGRAM_RAYS = f"{PLOTS}/motion", f"{PLOTS}/bearing"
#: How long after its arrival a station's motion is drawn [s], and by how many points at most.
LENGTH_S, POINTS = 0.02, 120
#: Distances between the middles of two squares, whose sides are 2, and of a title above one: the
#: viewer writes below the place of a title.
PITCH, LINE, TITLE = 2.4, 3.0, 1.75
FRAME, WORDS, WHITE = 0x39404AFF, 0xA8B0BAFF, 0xFFFFFFFF
#: Stations side by side.
ACROSS = 4


def middles(count: int) -> Array:
    """Return the middles of the squares, shape (count, 2, 2): from above, and below it the side."""
    row, column = np.divmod(np.arange(count), ACROSS)
    above = np.stack([PITCH * column, -2 * LINE * row], axis=1)
    return np.stack([above, above - np.array([0.0, LINE])], axis=1)


def extent(count: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return what all squares cover, titles included: from and to of x, and of y."""
    low, high = (edge(middles(count), axis=(0, 1)) for edge in (np.min, np.max))
    return (low[0] - 1.2, high[0] + 1.2), (low[1] - 1.2, high[1] + 1.2 * TITLE)


def motion(values: NDArray[np.floating], azimuth_rad: float) -> Array:
    """Return the motion to be drawn.

    Parameters
    ----------
    values
        Shape (n, 3): x, y and z (up).
    azimuth_rad
        Towards the source, counter-clockwise from x [rad].

    Returns
    -------
    numpy.ndarray
        Shape (2, n, 2), within [-1, 1]: x and y, then away from the source and up.
    """
    x, y, z = (values - values.mean(axis=0)).T.astype(np.float64)
    away = -(np.cos(azimuth_rad) * x + np.sin(azimuth_rad) * y)
    largest = max(float(np.abs([x, y, z, away]).max()), np.finfo(np.float64).tiny)
    return np.stack([np.stack([x, y], axis=1), np.stack([away, z], axis=1)]) / largest


class HodogramView:
    """Logs the hodograms of each step, which stay until the next.

    Parameters
    ----------
    timeline
        Where to.
    names
        Of the stations.
    colours
        Of the stations.
    """

    def __init__(self, timeline: Timeline, names: Sequence[str], colours: Sequence[int]) -> None:
        import rerun as rr

        self._timeline = timeline
        self._colours = tuple(colours)
        self._motion = Strips(timeline, MOTION, 0.0, "part")
        self._rays = Strips(timeline, HODOGRAM_RAYS, 10.0, "part")
        self._middles = middles(len(names))
        upwards = rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]])
        title = f"Hodograms, {LENGTH_S * 1e3:g} ms"
        self._timeline.declare(Entity(PLOTS, "hodogram", title, len(names)), upwards)
        self._frames(names)

    def _frames(self, names: Sequence[str]) -> None:
        import rerun as rr

        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], np.float64)
        cross = [np.array([(-1, 0), (1, 0)]), np.array([(0, -1), (0, 1)])]
        flat = self._middles.reshape(-1, 2)
        frames = [middle + part for middle in flat for part in (square, *cross)]
        strips = rr.LineStrips2D(
            [f.astype(np.float32) for f in frames],
            colors=np.full(len(frames), FRAME, np.uint32),
            radii=-0.5,
            draw_order=-10.0,
        )
        self._timeline.static(f"{PLOTS}/frames", strips)
        texts = [text for name in names for text in (f"{name} x–y", f"{name} r–z")]
        titles = rr.Points2D(
            flat + np.array([0.0, TITLE]),
            labels=texts,
            show_labels=True,
            colors=np.full(len(flat), WORDS, np.uint32),
            radii=-0.1,
        )
        self._timeline.static(f"{PLOTS}/titles", titles)

    def step(self, time_ns: int, moved: Mapping[int, tuple[Array, float]]) -> None:
        """Show a step.

        Parameters
        ----------
        time_ns
            When [ns].
        moved
            By the index of a station: its motion, shape (n, 3), and the azimuth of the source
            [rad].
        """
        lines, shades, rays = [], [], []
        for index, (values, azimuth) in moved.items():
            every = max(1, -(-len(values) // POINTS))
            lines += list(motion(values, azimuth)[:, ::every] + self._middles[index][:, None])
            shades += [self._colours[index]] * 2
            middle = self._middles[index, 0]
            ahead = middle + np.array([np.cos(azimuth), np.sin(azimuth)])
            rays.append(np.stack([middle, ahead]))
        self._motion.add(time_ns, lines, shades, [-0.9] * len(lines))
        self._rays.add(time_ns, rays, [WHITE] * len(rays), [-0.7] * len(rays))

    def flush(self) -> None:
        """Log what is pending."""
        self._motion.flush()
        self._rays.flush()
