"""Roads, the sensors beside them, and the vehicles that drive along them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groundtrace_codecs.geometry import Geometry, Medium, Sensor

from ..errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LayoutName = Literal["antennas", "stations", "nodes"]

#: Of the fastest vehicle, and of the slowest wave [m/s]: nobody drives faster than sound. Chosen by
#: judgement: 108 km/h, and no ground is softer.
FASTEST_MPS, SLOWEST_WAVE_MPS = 30.0, 80.0
#: Speed of one vehicle, and of several, where nobody says which [m/s]. Chosen by judgement: 36
#: km/h, and 29 to 72 km/h.
SPEED_MPS, DRAWN_MPS = 10.0, (8.0, 20.0)
#: Highest frequency felt, as a part of the sampling rate; by what factor a band may reach beyond
#: its edge as it moves. Chosen by judgement: below Nyquist.
_HIGHEST, _BEYOND = 0.4, 1.2


def refused(option: str, expected: str, actual: object) -> SimulationError:
    """Return the error that an option of the road is not what it must be."""
    return SimulationError(f"simulate vehicle: {option}: expected {expected}, found {actual}")


#: Options that a site of nodes draws by itself, or does not have. Source: definition.
_NOT_OF_NODES = (
    *("geometry", "end_speed_mps", "heading_deg", "radius_m", "waypoints", "velocity_mps"),
    *("exponent", "loss_spm", "coherence_m", "band_hz", "engine_hz", "snr", "level_spread_db"),
    *("wind", "gain_spread", "geophone_hz"),
)


@dataclass(frozen=True, slots=True)
class VehicleOptions:
    """What to simulate beside a road. None leaves a choice open: see each.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; None: 30 for each pass.
    rate_hz
        Sampling rate [Hz], 50 to 1000.
    layout
        ``antennas``: two lines of three geophones that the road crosses, as in the paper's
        experiment; ``stations``: beside the road; ``nodes``: in a row beside a road, the ground,
        the vehicles and the noise drawn by the seed: options that are None or 0 are, too.
    geometry
        Sensors, and the road where it has one, in place of a layout.
    stations
        How many, 2 to 4, nodes 1 to 16; None: 3, nodes 3 to 5.
    spacing_m
        Between stations or the geophones of an antenna [m], 2 to 100; None: 20, antennas 10.
    components
        1: vertical, or 3: x, y and z of every sensor; None: 1, nodes 3.
    passes
        How many vehicles pass, nodes 0 too; several come at random times, from both sides, on two
        lanes.
    overlap
        True: the second and the first of several pass within two seconds, against each other.
    speed_mps
        2 to 30 [m/s]; None: 10 for one vehicle, 8 to 20 drawn for each of several.
    end_speed_mps
        What the speed of a single vehicle changes to, evenly over the recording; None: nothing.
    offset_m
        Of the road from the middle of the sensors, to the road's left [m]; None: 5, antennas 1.
    heading_deg
        Of the road, counter-clockwise from x; None: 0, antennas 75.
    radius_m
        Of a road that bends to the left, or, negative, to the right [m]; None: straight.
    waypoints
        Corners of the road [m] in place of offset, heading and radius.
    velocity_mps
        Of the waves, 80 to 3000 [m/s].
    exponent
        n of the power P = mu / r^n, 0.5 to 6.
    loss_spm
        rho of the ground's loss exp(-2 rho pi f r) [s/m], to 0.01.
    coherence_m
        Way of a vehicle over which its fading changes [m]; None: no fading.
    band_hz
        Of the vehicles' noise; None: 10 to 40 Hz, or a quarter of the sampling rate.
    engine_hz
        Firing rate of the engine, whose first four orders have 0.3 of the power; None: no tones.
    snr
        Root of the mean power of a vehicle at 10 m over the noise.
    level_spread_db
        Standard deviation of the vehicles' levels; None: 0 for one vehicle, 3 for several.
    wind
        Root of the mean power of wind, 0.5 to 8 Hz, over that of the noise.
    gain_spread
        Standard deviation of the logarithm of the sensors' gains, which nobody knows.
    geophone_hz
        Natural frequency of the geophones (damping 0.7); None: they feel all frequencies alike.
    walkers, impacts
        How many people walk by, and how many single impacts there are; of nodes, doors that slam.
    swells, stops
        Of nodes: how many gusts and trucks far away, and how many vehicles stop on their way; None:
        none.
    """

    seed: int = 1
    duration_s: float | None = None
    rate_hz: float = 200.0
    layout: LayoutName = "antennas"
    geometry: Geometry | None = None
    stations: int | None = None
    spacing_m: float | None = None
    components: int | None = None
    passes: int = 1
    overlap: bool = False
    speed_mps: float | None = None
    end_speed_mps: float | None = None
    offset_m: float | None = None
    heading_deg: float | None = None
    radius_m: float | None = None
    waypoints: tuple[tuple[float, float], ...] = ()
    velocity_mps: float = 250.0
    exponent: float = 1.5
    loss_spm: float = 0.0
    coherence_m: float | None = None
    band_hz: tuple[float, float] | None = None
    engine_hz: float | None = None
    snr: float = 10.0
    level_spread_db: float | None = None
    wind: float = 0.0
    gain_spread: float = 0.0
    geophone_hz: float | None = None
    walkers: int = 0
    impacts: int = 0
    swells: int | None = None
    stops: int | None = None

    @property
    def length_s(self) -> float:
        """Length of the recording [s]."""
        return 30.0 * max(self.passes, 1) if self.duration_s is None else self.duration_s

    @property
    def source_hz(self) -> tuple[float, float]:
        """Edges of the vehicles' band [Hz]."""
        return self.band_hz or (10.0, min(40.0, 0.25 * self.rate_hz))

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range or two exclude each other."""
        for name, value, low, high in self._ranges():
            if value is not None and not low <= value <= high:
                raise refused(name, f"{low:g} to {high:g}", value)
        for name, good, expected, actual in self._others():
            if not good:
                raise refused(name, expected, actual)
        for name, other in self._excluded():
            raise refused(name, f"none beside {other}", "both")

    @property
    def _top_hz(self) -> float:
        """Highest edge of a band that the fastest vehicle does not shift beyond what is felt."""
        fastest = self.speed_mps or (SPEED_MPS if self.passes == 1 else DRAWN_MPS[1])
        fastest = max(fastest, self.end_speed_mps or 0.0)
        return _HIGHEST * self.rate_hz / _BEYOND * (1 - fastest / self.velocity_mps)

    def _ranges(self) -> Iterator[tuple[str, float | None, float, float]]:
        yield "duration_s", self.duration_s, 2, 86400
        yield "rate_hz", self.rate_hz, 50, 1000
        nodes = self.layout == "nodes"
        yield "stations", self.stations, *((1, 16) if nodes else (2, 4))
        yield "spacing_m", self.spacing_m, 2, 100
        yield "passes", self.passes, 0 if nodes else 1, 1000
        yield "speed_mps", self.speed_mps, 2, FASTEST_MPS
        yield "end_speed_mps", self.end_speed_mps, 2, FASTEST_MPS
        yield "offset_m", self.offset_m, -1000, 1000
        yield "velocity_mps", self.velocity_mps, SLOWEST_WAVE_MPS, 3000
        yield "exponent", self.exponent, 0.5, 6
        yield "loss_spm", self.loss_spm, 0, 0.01
        yield "coherence_m", self.coherence_m, 0.1, 1000
        yield "snr", self.snr, 1e-3, 1e9
        yield "level_spread_db", self.level_spread_db, 0, 10
        yield "wind", self.wind, 0, 1000
        yield "gain_spread", self.gain_spread, 0, 1
        yield "geophone_hz", self.geophone_hz, 0.5, 0.3 * self.rate_hz
        yield "walkers", self.walkers, 0, 10
        yield "impacts", self.impacts, 0, 1000
        yield "swells", self.swells, 0, 1000
        yield "stops", self.stops, 0, self.passes

    def _others(self) -> Iterator[tuple[str, bool, str, Any]]:
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "rate_hz", self.rate_hz == round(self.rate_hz), "a whole number", self.rate_hz
        yield "components", self.components in (None, 1, 3), "1 or 3", self.components
        yield "overlap", not self.overlap or self.passes > 1, "2 passes or more", self.passes
        low, high = self.source_hz
        top = self._top_hz
        yield "band_hz", 1 <= low < 0.9 * high < top, f"1 to {top:.0f} Hz", f"{low:g}-{high:g}"
        tone = self.engine_hz
        yield "engine_hz", tone is None or 1 <= tone <= top, f"1 to {top:.0f}", tone
        bend = self.radius_m
        yield "radius_m", bend is None or 10 <= abs(bend) <= 1e5, "10 to 1e5 or negative", bend
        yield "heading_deg", np.isfinite(self.heading_deg or 0), "an angle", self.heading_deg
        corners = self.waypoints
        apart = all(a != b for a, b in pairwise(corners))
        yield "waypoints", len(corners) != 1 and apart, "2 places or more, each another", corners

    def _excluded(self) -> Iterator[tuple[str, str]]:
        if self.geometry is not None and (self.stations or self.spacing_m):
            yield "stations and spacing_m", "a geometry"
        if self.layout == "antennas" and self.stations:
            yield "stations", "the layout antennas"
        if self.layout == "nodes":
            defaults = VehicleOptions()
            for name in _NOT_OF_NODES:
                if getattr(self, name) != getattr(defaults, name):
                    yield name, "the layout nodes"
        elif self.swells or self.stops:
            yield "swells and stops", f"the layout {self.layout}"
        drawn = (self.offset_m, self.heading_deg, self.radius_m)
        if self.waypoints and any(x is not None for x in drawn):
            yield "waypoints", "offset, heading or radius"
        if self.end_speed_mps is not None and self.passes > 1:
            yield "end_speed_mps", "several passes"


#: Names of components. Source: definition.
AXES = ("x", "y", "z")
#: Side of an antenna and distance of stations where nobody says them [m]. Chosen by judgement: some
#: cycles of a vehicle.
_ANTENNA_M, _STATION_M = 10.0, 20.0
#: Chosen by judgement: as far as stations hear.
ROAD_M = 100.0  # of a straight road that the geometry tells, either way from the sensors


def site_of(options: VehicleOptions) -> Geometry:
    """Return sensors, the velocity of the waves and the line of the road.

    Raises
    ------
    SimulationError
        Where a geometry is not in metres or has no sensors, or several for one channel.
    """
    site = options.geometry or Geometry(sensors=tuple(_sensors(options)))
    if site.unit != "m":
        raise refused("geometry", "places in metres", f"the unit {site.unit}")
    if not 1 <= len(site.sensors) <= 64:
        raise refused("geometry", "1 to 64 sensors", f"{len(site.sensors)}")
    if options.components == 3:
        upright = {s.name: s for s in site.sensors}.values()
        sensors = tuple(replace(s, channel=f"{s.name}{a}", axis=a) for s in upright for a in AXES)
        site = replace(site, sensors=sensors)
    for sensor in site.sensors:
        if sensor.axis not in AXES:
            raise refused(f"axis of {sensor.name}", "x, y or z", repr(sensor.axis))
    if len({s.channel for s in site.sensors}) < len(site.sensors):
        raise refused("geometry", "another channel for every sensor", "one used twice")
    road = road_of(options, site)
    corners = road.corners
    if len(corners) == 2 and not options.waypoints and not site.road:
        corners = road.places(np.array([-ROAD_M, ROAD_M]))
    line = tuple((round(float(x), 3), round(float(y), 3)) for x, y in corners)
    return replace(site, medium=Medium(velocity_mps=options.velocity_mps), road=line)


def road_of(options: VehicleOptions, site: Geometry) -> Road:
    """Return the road: by the options' waypoints, the geometry's, or offset, heading and bend."""
    drawn = (options.offset_m, options.heading_deg, options.radius_m)
    if options.waypoints or (site.road and all(x is None for x in drawn)):
        corners = np.array(options.waypoints or site.road, np.float64)
        if len(corners) < 2:
            raise refused("geometry", "a road of 2 corners or more", f"{len(corners)}")
        return Road.through(corners)
    antennas = options.geometry is None and options.layout == "antennas"
    heading_deg, offset_m = (75.0, 1.0) if antennas else (0.0, 5.0)
    heading = np.deg2rad(heading_deg if options.heading_deg is None else options.heading_deg)
    offset_m = offset_m if options.offset_m is None else options.offset_m
    position = middle_of(site) + offset_m * np.array([-np.sin(heading), np.cos(heading)])
    if options.radius_m is None:
        return Road.straight(position, heading)
    return Road.bend(position, heading, options.radius_m)


def middle_of(site: Geometry) -> NDArray[np.float64]:
    """Return the mean place of the sensors, shape (2,) [m]."""
    middle: NDArray[np.float64] = np.array(list(places_of(site).values())).mean(axis=0)
    return middle


def places_of(site: Geometry) -> dict[str, tuple[float, float]]:
    """Return the place of each station by its name [m]."""
    return {s.name: (s.x, s.y) for s in site.sensors}


def _sensors(options: VehicleOptions) -> list[Sensor]:
    if options.layout == "stations":
        count, spacing_m = options.stations or 3, options.spacing_m or _STATION_M
        return [Sensor(f"S{i + 1}", f"S{i + 1}", i * spacing_m, 0.0) for i in range(count)]
    spacing_m = options.spacing_m or _ANTENNA_M
    return [
        Sensor(f"{antenna}{i + 1}", f"{antenna}{i + 1}", i * spacing_m, row * 2 * spacing_m)
        for row, antenna in enumerate("AB")
        for i in range(3)
    ]


#: So long before and after its pass a vehicle is on the road at most [s]. Chosen by judgement: at 8
#: m/s a vehicle is then 1.4 km away.
LASTS_S = 180.0
#: Chosen by judgement: finer than a vehicle's place matters; the rounds settle to a nanosecond.
_ARC_STEP_RAD = 0.01  # between two corners of a bend
_NEAR_S = 0.01  # grid on which the closest approach is looked for
_CONVERGED_S = 1e-9
_ROUNDS = 60  # each gains a factor of wave velocity over speed, 2.6 at least


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """The line of a road, straight between its corners and beyond its ends.

    Attributes
    ----------
    corners
        Shape (n, 2), n >= 2 [m].
    reached_m
        Distance along the road of each corner, shape (n,) [m].
    units
        Directions between corners, of length 1, shape (n - 1, 2).
    """

    corners: Array
    reached_m: Array
    units: Array

    @classmethod
    def through(cls, corners: Array) -> Road:
        """Return the road through corners, shape (n, 2), each another place than the last [m]."""
        steps = np.diff(corners, axis=0)
        lengths = np.hypot(*steps.T)
        return cls(corners, np.append(0.0, np.cumsum(lengths)), steps / lengths[:, None])

    @classmethod
    def straight(cls, position: Array, heading_rad: float) -> Road:
        """Return a straight road through a place; distances along it count from there."""
        ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
        return cls.through(np.array([position, position + ahead]))

    @classmethod
    def bend(cls, position: Array, heading_rad: float, radius_m: float) -> Road:
        """Return an arc of a third of a circle, whose middle is a place with a heading there.

        A positive radius turns left, a negative one right.
        """
        arc_rad = np.arange(-np.pi / 3, np.pi / 3 + _ARC_STEP_RAD / 2, _ARC_STEP_RAD)
        angle = heading_rad + arc_rad * np.sign(radius_m)
        centre = position + radius_m * np.array([-np.sin(heading_rad), np.cos(heading_rad)])
        return cls.through(centre + radius_m * np.column_stack([np.sin(angle), -np.cos(angle)]))

    def places(self, along_m: Array) -> Array:
        """Return the places at distances along the road, shape (..., 2) [m]."""
        segment = self._segment(along_m)
        beyond = along_m - self.reached_m[segment]
        places: Array = self.corners[segment] + beyond[..., None] * self.units[segment]
        return places

    def headings(self, along_m: Array) -> Array:
        """Return the road's heading at distances along it, the shape of ``along_m`` [rad]."""
        x, y = np.moveaxis(self.units[self._segment(along_m)], -1, 0)
        headings: Array = np.arctan2(y, x)
        return headings

    def nearest_m(self, position: Array) -> float:
        """Return the distance along the road of its point closest to a place [m]."""
        along = np.sum((position - self.corners[:-1]) * self.units, axis=1)
        low, high = np.zeros(len(along)), np.diff(self.reached_m)
        low[0], high[-1] = -np.inf, np.inf
        along = self.reached_m[:-1] + np.clip(along, low, high)
        return float(along[np.argmin(np.hypot(*(self.places(along) - position).T))])

    def beside(self, left_m: float) -> Road:
        """Return the road moved to its left, parallel to itself."""
        mitre = np.vstack([self.units[:1], self.units]) + np.vstack([self.units, self.units[-1:]])
        mitre *= 2 / np.maximum(np.sum(mitre**2, axis=1), 0.1)[:, None]
        return Road.through(self.corners + left_m * np.column_stack([-mitre[:, 1], mitre[:, 0]]))

    def _segment(self, along_m: Array) -> NDArray[np.intp]:
        after = np.searchsorted(self.reached_m, along_m, side="right") - 1
        return np.clip(after, 0, len(self.corners) - 2)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One vehicle's way along a road, its speed constant or changing evenly between some times.

    Attributes
    ----------
    road
        Its lane.
    pass_s, along_m
        When it is at which distance along the road [s, m].
    knots_s, speeds_mps
        Times, increasing, and the speeds then; between them it changes evenly, before the first
        and after the last it stays [s, m/s].
    forward
        Whether it goes as the road is drawn.
    """

    road: Road
    pass_s: float
    along_m: float
    knots_s: tuple[float, ...]
    speeds_mps: tuple[float, ...]
    forward: bool = True

    def speeds(self, time_s: Array) -> Array:
        """Return the speed at times of any shape [m/s]."""
        return np.asarray(np.interp(time_s, self.knots_s, self.speeds_mps))

    def travelled(self, time_s: Array) -> Array:
        """Return the way since ``pass_s`` at times of any shape, negative before [m]."""
        way: Array = self._way(time_s) - self._way(np.array(self.pass_s))
        return way

    def places(self, time_s: Array) -> Array:
        """Return where the vehicle is, shape (..., 2) [m]."""
        return self.road.places(self._along(time_s))

    def headings(self, time_s: Array) -> Array:
        """Return where it goes to, counter-clockwise from x [rad, -pi to pi]."""
        offset_rad = 0.0 if self.forward else np.pi
        angle: Array = self.road.headings(self._along(time_s)) + offset_rad
        return np.arctan2(np.sin(angle), np.cos(angle))

    def distances(self, time_s: Array, places: Array) -> Array:
        """Return how far it is from a place, (2,), or from the place of each last index [m]."""
        away = self.places(time_s) - places
        distance: Array = np.hypot(away[..., 0], away[..., 1])
        return distance

    def emitted_s(self, heard_s: Array, places: Array, velocity_mps: float) -> Array:
        """Return when it made what is heard at places: received = t + r(t) / c, solved for t.

        Parameters
        ----------
        heard_s
            Shape (n,) [s].
        places
            Shape (n_places, 2) [m].
        velocity_mps
            c of the waves, more than the vehicle's speed.

        Returns
        -------
        Shape (n, n_places) [s].
        """
        received = np.repeat(heard_s[:, None], len(places), axis=1)
        emitted = received
        for _ in range(_ROUNDS):
            before, emitted = emitted, received - self.distances(emitted, places) / velocity_mps
            if np.abs(emitted - before).max(initial=0.0) < _CONVERGED_S:
                break
        return emitted

    def times(self, duration_s: float, step_s: float) -> Array:
        """Return the multiples of a step, from 0 to before the end, when it is on the road [s]."""
        first = np.ceil(max(0.0, self.pass_s - LASTS_S) / step_s)
        last = np.ceil(min(duration_s, self.pass_s + LASTS_S) / step_s)
        return np.arange(first, last, dtype=np.float64) * step_s

    def closest_s(self, position: Array, duration_s: float) -> float | None:
        """Return when it passes a place, or None where it does not before ``duration_s``."""
        time_s = self.times(duration_s, _NEAR_S)
        square = self.distances(time_s, position) ** 2
        near = int(np.argmin(square))
        if not 0 < near < len(time_s) - 1:
            return None
        before, at, after = square[near - 1 : near + 2]
        bend = before - 2 * at + after
        return float(time_s[near] + (_NEAR_S * (before - after) / (2 * bend) if bend else 0.0))

    def _along(self, time_s: Array) -> Array:
        return self.along_m + (1 if self.forward else -1) * self.travelled(time_s)

    def _way(self, time_s: Array) -> Array:
        knots, speeds = np.array(self.knots_s), np.array(self.speeds_mps)
        steps = np.diff(knots)
        reached = np.append(0.0, np.cumsum(steps * (speeds[1:] + speeds[:-1]) / 2))
        gains = np.append(np.diff(speeds) / steps, 0.0)
        last = np.searchsorted(knots, time_s, side="right") - 1
        k = np.maximum(last, 0)
        since = time_s - knots[k]
        gain = np.where(last < 0, 0.0, gains[k])
        return np.asarray(reached[k] + speeds[k] * since + gain * since**2 / 2)
