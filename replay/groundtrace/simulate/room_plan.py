"""Plans of a walk through a room: options, sensors, and paths, drawn at random or given."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S

from ..errors import SimulationError
from ..localizers.wave_physics import Impact
from .footfall import Footfall, Shoe

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray
    from shapely import Polygon

    from .wave_laws import LawName

    Array = NDArray[np.float64]
    Outline = tuple[tuple[float, float], ...]

#: Side of the room of the thesis's test (section 6.2) [m]. Source: thesis, section 6.2.
SIDE_M = 5.4
#: Sensors in a room where nobody says how many. Source: thesis, its three rows of three.
CHANNELS = 9
#: Largest offset of a clock [s]. Chosen by judgement: more is no clock that is off, but another
#: recording.
LATEST_S = 0.1

ShoeName = Literal["heel", "bare", "mixed"]
PathName = Literal["straight", "l", "v", "u", "circle", "ellipse", "there-and-back", "crossing"]


def refused(option: str, expected: str, actual: object) -> SimulationError:
    """Return the error that an option of the room is not what it must be."""
    return SimulationError(f"simulate room: {option}: expected {expected}, found {actual}")


@dataclass(frozen=True, slots=True)
class RoomOptions:
    """What to simulate in the room. None leaves a choice open: see each, and ``random``.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; None: as long as the steps need.
    channels
        How many sensors, 3 to 16; None: 9, or those of ``geometry``.
    rate_hz
        Sampling rate [Hz], from 1000.
    steps
        How many steps of each walker, or impacts; None: as many as fit in ``duration_s``, or 20.
    snr
        Peak of a mean step at 1 m over the standard deviation of the noise; of a heel where shoes
        are mixed. The default leaves about 20 for the weakest step at the farthest of the sensors.
    geometry
        Outline of the room, convex or not, and sensors; its thickness where it has one. None: a
        rectangle with rows of sensors.
    side_m
        Sides of that rectangle along x and y [m], 2 to 30; None: 5.4 by 5.4.
    thickness_m
        Of the concrete slab [m], 0.05 to 1; None: 0.2.
    dispersion_m2s
        Dispersion constant a of the slab [m2/s], 46 to 913, in place of its thickness.
    loss_s
        theta of the slab's loss [s], 1e-6 to 1e-3; None: 1e-5.
    shoe
        ``heel``, ``bare`` or ``mixed`` (each step one or the other); None: heel.
    walls
        Reflection of a wave's amplitude at the outline, 0 to 0.9; None: 0.
    resonances
        True gives each sensor a resonance of its mounting, 150 to 600 Hz, Q 3 to 8.
    path
        Where people walk; None: ``u``, or ``crossing`` for two.
    walkers
        1, or 2 who cross in the middle; None: 1, or 2 for ``crossing``.
    impacts
        True: single impacts at random places, 1 to 3 s apart, and nobody walks.
    clock_offset_s
        Sensor and how late its samples are stamped [s], -0.1 to 0.1. The geometry of the recording
        does not tell; an offset that stands in ``geometry`` is simulated and told.
    clock_spread_s
        Standard deviation of a random clock offset of every other sensor [s], to 0.03.
    dead
        Sensors that give 0 all the time.
    clipped
        Sensors with so much gain that most steps clip.
    triaxial
        True makes a station of x, y and z of every sensor.
    wave_law
        How waves run, see :mod:`.wave_laws`; ``any`` draws it, and with it speed, gains, clipping,
        precursors and bursts where these are open; None: ``plate``.
    speed_mps
        Phase velocity at 100 Hz of a law other than the plate's [m/s], 80 to 3000; None: drawn.
    uneven
        Standard deviation of the logarithm of the waves' slowness from place to place, 0 to 0.5,
        see :class:`.wave_laws.UnevenFloor`; None: 0.
    gain_spread
        Standard deviation of the logarithm of the sensors' gains, 0 to 1; None: 0.
    clip_at
        Full scale of all channels over the peak of a mean step at 1 m, from 0.02; None: none clips.
    precursor_s
        Weak waves of the same source come up to so long before each strike [s], to 0.1; None: 0.
    bursts
        Slamming doors and rumbles a minute that are no steps, 0 to 60; None: 0.
    random
        True draws what is open of room, floor, shoe, walls and path from ``seed``.
    """

    seed: int = 1
    duration_s: float | None = None
    channels: int | None = None
    rate_hz: float = 20_000.0
    steps: int | None = None
    snr: float = 100.0
    geometry: Geometry | None = None
    side_m: tuple[float, float] | None = None
    thickness_m: float | None = None
    dispersion_m2s: float | None = None
    loss_s: float | None = None
    shoe: ShoeName | None = None
    walls: float | None = None
    resonances: bool = False
    path: PathName | None = None
    walkers: int | None = None
    impacts: bool = False
    clock_offset_s: tuple[tuple[str, float], ...] = ()
    clock_spread_s: float | None = None
    dead: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()
    triaxial: bool = False
    wave_law: LawName | Literal["any"] | None = None
    speed_mps: float | None = None
    uneven: float | None = None
    gain_spread: float | None = None
    clip_at: float | None = None
    precursor_s: float | None = None
    bursts: float | None = None
    random: bool = False

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range or two exclude each other."""
        for name, good, expected, actual in self._limits():
            if not good:
                raise refused(name, expected, actual)
        for name, other in self._excluded():
            raise refused(name, f"none beside {other}", "both")

    def _limits(self) -> Iterator[tuple[str, bool, str, Any]]:
        yield "channels", _within(self.channels, 3, 16), "3 to 16", self.channels
        yield "rate_hz", 1000 <= self.rate_hz <= 1e6, "1000 to 1e6", self.rate_hz
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "steps", self.steps is None or self.steps >= 1, "1 or more", self.steps
        yield "snr", self.snr > 0, "more than 0", self.snr
        duration_s = 1.0 if self.duration_s is None else self.duration_s
        yield "duration_s", 0 < duration_s < np.inf, "> 0", duration_s
        for side in self.side_m or ():
            yield "side_m", 2 <= side <= 30, "2 to 30", side
        yield "thickness_m", _within(self.thickness_m, 0.05, 1), "0.05 to 1", self.thickness_m
        a = self.dispersion_m2s
        yield "dispersion_m2s", _within(a, 46, 913), "46 to 913", a
        yield "loss_s", _within(self.loss_s, 1e-6, 1e-3), "1e-6 to 1e-3", self.loss_s
        yield "walls", _within(self.walls, 0, 0.9), "0 to 0.9", self.walls
        yield "walkers", _within(self.walkers, 1, 2), "1 or 2", self.walkers
        for name, offset_s in self.clock_offset_s:
            yield f"clock offset of {name}", abs(offset_s) <= LATEST_S, "-0.1 to 0.1 s", offset_s
        spread_s = self.clock_spread_s
        yield "clock_spread_s", _within(spread_s, 0, 0.03), "0 to 0.03", spread_s
        yield "speed_mps", _within(self.speed_mps, 80, 3000), "80 to 3000", self.speed_mps
        yield "uneven", _within(self.uneven, 0, 0.5), "0 to 0.5", self.uneven
        yield "gain_spread", _within(self.gain_spread, 0, 1), "0 to 1", self.gain_spread
        yield "clip_at", _within(self.clip_at, 0.02, 1e3), "0.02 or more", self.clip_at
        yield "precursor_s", _within(self.precursor_s, 0, 0.1), "0 to 0.1", self.precursor_s
        yield "bursts", _within(self.bursts, 0, 60), "0 to 60", self.bursts

    def _excluded(self) -> Iterator[tuple[str, str]]:
        if self.geometry is not None and self.side_m is not None:
            yield "side_m", "a geometry"
        if self.geometry is not None and self.geometry.sensors and self.channels is not None:
            yield "channels", "a geometry's sensors"
        if self.thickness_m is not None and self.dispersion_m2s is not None:
            yield "thickness_m", "dispersion_m2s"
        if self.impacts and (self.path is not None or self.walkers is not None):
            yield "impacts", "a path or walkers"
        if self.walkers == 2 and self.path not in (None, "crossing"):
            yield "path", "two walkers, who cross"
        if self.speed_mps is not None and self.wave_law in (None, "plate"):
            yield "speed_mps", "the law of a plate"
        if self.walkers == 1 and self.path == "crossing":
            yield "path crossing", "a single walker"


def _within(value: float | None, low: float, high: float) -> bool:
    return value is None or low <= value <= high


_AXES = ("x", "y", "z")


def site_of(options: RoomOptions) -> Geometry:
    """Return outline and sensors; start and medium as the geometry file has them.

    Raises
    ------
    SimulationError
        Where a geometry is not in metres, lacks an outline or sensors, or has too many.
    """
    site = options.geometry or _rectangle(options)
    if site.unit != "m":
        raise refused("geometry", "places in metres", f"the unit {site.unit}")
    if len(site.outline) < 3:
        raise refused("geometry", "an outline of 3 or more corners", f"{len(site.outline)}")
    if not 1 <= len(site.sensors) <= 64:
        raise refused("geometry", "1 to 64 sensors", f"{len(site.sensors)}")
    if options.triaxial:
        upright = {s.name: s for s in site.sensors}.values()
        stations = tuple(_axis(s, axis) for s in upright for axis in _AXES)
        site = replace(site, sensors=stations)
    for sensor in site.sensors:
        if sensor.axis not in _AXES:
            raise refused(f"axis of {sensor.name}", "x, y or z", repr(sensor.axis))
    if len({s.channel for s in site.sensors}) < len(site.sensors):
        raise refused("geometry", "another channel for every sensor", "one used twice")
    return site


def _axis(sensor: Sensor, axis: str) -> Sensor:
    return replace(sensor, channel=f"{sensor.name}{axis}", axis=axis)


def _rectangle(options: RoomOptions) -> Geometry:
    side_m = options.side_m or (SIDE_M, SIDE_M)
    places = sensor_places(options.channels or CHANNELS, side_m).tolist()
    return Geometry(
        sensors=tuple(Sensor(f"G{i}", f"G{i}", x, y) for i, (x, y) in enumerate(places, 1)),
        outline=((0.0, 0.0), (side_m[0], 0.0), side_m, (0.0, side_m[1])),
    )


def sensor_places(
    count: int, side_m: tuple[float, float] = (SIDE_M, SIDE_M)
) -> NDArray[np.float64]:
    """Return places of ``count`` sensors, spread in rows over the room, shape (count, 2) [m]."""
    rows = round(np.sqrt(count))
    share = [len(part) for part in np.array_split(np.arange(count), rows)]
    places = []
    for y, n in zip(np.linspace(0, side_m[1], rows), share, strict=True):
        across = np.linspace(0, side_m[0], n) if n > 1 else [side_m[0] / 2]
        places += [(x, y) for x in across]
    return np.round(np.array(places), 3)


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """Resonances of the sensors' mountings: a mass on a spring and a damper.

    Attributes
    ----------
    frequency_hz
        Shape (n_stations,), 150 to 600 Hz; inf where a sensor is fixed firmly.
    quality
        Q, shape (n_stations,), 3 to 8.
    """

    frequency_hz: NDArray[np.float64]
    quality: NDArray[np.float64]

    @classmethod
    def drawn(cls, stations: int, seed: int) -> Mounting:
        """Draw the resonance of each station."""
        rng = np.random.default_rng([seed, 5])
        return cls(rng.uniform(150, 600, stations), rng.uniform(3, 8, stations))

    def response(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return velocity of the sensor over that of the floor, shape (n_stations, n_f)."""
        ratio = frequency_hz / self.frequency_hz[:, None]
        damped = 1j * ratio / self.quality[:, None]
        transmitted: NDArray[np.complex128] = (1 + damped) / (1 - ratio**2 + damped)
        return transmitted


def stations_of(site: Geometry) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the places of the stations, shape (n_stations, 2) [m], and each channel's station."""
    places = dict.fromkeys((s.x, s.y) for s in site.sensors)
    number = {position: i for i, position in enumerate(places)}
    of_channel = np.array([number[s.x, s.y] for s in site.sensors], np.intp)
    return np.array(list(places), np.float64), of_channel


#: People keep this far from walls [m], less in rooms narrower than five times as much. Chosen by
#: judgement: an arm's length.
_CLEAR_M = 0.7
#: From the middle of the path to a foot [m]. Chosen by judgement: a usual walker's step width; the
#: rest fits paths into rooms.
_ASIDE_M = 0.07
_TICKS = 14  # of the corners a rectangle is looked for with, per axis
_FLAT = 0.65  # shorter axis of an ellipse over the longer one, at most
_LANE_M = 0.8  # between going there and coming back

#: Open lines over the unit square, walked to and fro with a turn on the spot at the ends. No leg
#: lies on a line of symmetry, where feet would be equally far from rows of sensors. Chosen by
#: judgement: L and V are those of the thesis, chapter 6.
_LINES = {
    "straight": ((0.0, 0.3), (1.0, 0.6)),
    "l": ((0.0, 0.025), (1.0, 0.025), (1.0, 1.0)),
    "v": ((0.0, 1.0), (0.45, 0.0), (1.0, 1.0)),
    "u": ((0.0, 0.025), (1.0, 0.025), (1.0, 1.0), (0.0, 1.0)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A line to walk along.

    Attributes
    ----------
    points
        Shape (n, 2) [m].
    closed
        True: round and round; False: to and fro.
    """

    points: Array
    closed: bool = False

    @property
    def length_m(self) -> float:
        """From the first point to the last [m]."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())

    def feet(self, run_m: Array) -> Array:
        """Return the feet's places after ``run_m`` metres of path, left foot first, (n, 2)."""
        path = self.points
        legs = np.diff(path, axis=0)
        length = np.hypot(*legs.T)
        along = np.concatenate(([0.0], np.cumsum(length)))
        phase = run_m % (along[-1] if self.closed else 2 * along[-1])
        back = phase > along[-1]
        arc = np.where(back, 2 * along[-1] - phase, phase)
        leg = np.clip(np.searchsorted(along, arc, side="right") - 1, 0, len(legs) - 1)
        heading = legs[leg] / length[leg, None] * np.where(back, -1.0, 1.0)[:, None]
        middle = np.stack([np.interp(arc, along, path[:, axis]) for axis in (0, 1)], axis=1)
        left = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
        aside = np.where(np.arange(len(run_m)) % 2 == 0, _ASIDE_M, -_ASIDE_M)
        feet: Array = np.round(middle + aside[:, None] * left, 4)
        return feet


def paths_in(outline: tuple[tuple[float, float], ...], name: PathName) -> tuple[Path, ...]:
    """Return the path of each walker: two for ``crossing``, else one.

    Raises
    ------
    SimulationError
        Where the outline encloses no area, crosses itself, or is too narrow to walk in.
    """
    low, high = clear_rectangle(outline)
    size = high - low
    if name == "crossing":
        ends = np.array([[(0, 0), (1, 1)], [(0, 1), (1, 0)]], np.float64)
        return tuple(Path(low + line * size) for line in ends)
    if name in _LINES:
        line = low + np.array(_LINES[name]) * size
        return (Path(_rounded(line)),)
    middle, half = (low + high) / 2, size / 2
    if name == "circle":
        half = np.full(2, half.min())
    if name == "ellipse":  # in a square too
        half[int(half[1] <= half[0])] = min(half.min(), _FLAT * half.max())
    if name == "there-and-back":
        return (Path(_hairpin(middle, half), closed=True),)
    angle = np.linspace(0, 2 * np.pi, 73)[:, None]
    round_ = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    return (Path(middle + half * round_, closed=True),)


def _rounded(path: Array) -> Array:
    for _ in range(4):  # Chaikin's corner cutting
        inner = np.stack([0.75 * path[:-1] + 0.25 * path[1:], 0.25 * path[:-1] + 0.75 * path[1:]])
        path = np.concatenate([path[:1], inner.transpose(1, 0, 2).reshape(-1, 2), path[-1:]])
    return path


def _hairpin(middle: Array, half: Array) -> Array:
    """Return a way along the longer side, a half circle, and back beside it."""
    longer = int(half[1] > half[0])
    radius = min(_LANE_M / 2, float(half.min()))
    reach = float(half[longer]) - radius
    angle = np.linspace(-np.pi / 2, np.pi / 2, 19)
    turn = np.stack([reach + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    ring = np.concatenate([[(-reach, -radius)], turn, -turn, [(-reach, -radius)]])
    # the turns' ends meet the lanes' ends, and a leg without length has no heading
    ring = ring[np.concatenate(([True], np.hypot(*np.diff(ring, axis=0).T) > 1e-9))]
    there: Array = middle + (ring[:, ::-1] * (1, -1) if longer else ring)
    return there


def clear_rectangle(outline: tuple[tuple[float, float], ...]) -> tuple[Array, Array]:
    """Return lower and upper corner of the largest upright rectangle people walk in, (2,) [m].

    Raises
    ------
    SimulationError
        As :func:`paths_in`.
    """
    import shapely

    room = polygon(outline)
    low, high = np.array(room.bounds).reshape(2, 2)
    clear = room.buffer(-min(_CLEAR_M, float((high - low).min()) / 5), join_style="mitre")
    if clear.is_empty:
        raise refused("outline", "room to walk in", "none")
    corners = shapely.get_coordinates(clear)
    low, high = np.array(clear.bounds).reshape(2, 2)
    x, y = (
        np.unique(
            np.round(np.concatenate([corners[:, i], np.linspace(low[i], high[i], _TICKS)]), 6)
        )
        for i in (0, 1)
    )
    (x_low, x_high), (y_low, y_high) = (_intervals(ticks) for ticks in (x, y))
    i, j = (k.ravel() for k in np.indices((len(x_low), len(y_low))))
    order = np.argsort(-(x_high - x_low)[i] * (y_high - y_low)[j], kind="stable")
    box = np.stack([x_low[i], y_low[j], x_high[i], y_high[j]], axis=1)[order]
    return _first_inside(box, clear)


def _first_inside(box: Array, clear: Polygon) -> tuple[Array, Array]:
    """Return the first of the boxes (n, 4) that lies in ``clear``."""
    import shapely

    grown = clear.buffer(1e-5, join_style="mitre")
    shapely.prepare(grown)
    for part in np.array_split(box, max(len(box) // 500, 1)):
        inside = shapely.contains(grown, shapely.box(*part.T))
        if inside.any():
            rectangle = part[int(np.argmax(inside))]
            if float((rectangle[2:] - rectangle[:2]).min()) >= 0.5:
                return rectangle[:2], rectangle[2:]
    raise refused("outline", "0.5 m or more to walk in", "less")


def _intervals(ticks: Array) -> tuple[Array, Array]:
    low, high = np.triu_indices(len(ticks), 1)
    return ticks[low], ticks[high]


def polygon(outline: tuple[tuple[float, float], ...]) -> Polygon:
    """Return the outline as an area.

    Raises
    ------
    SimulationError
        Where it encloses none or crosses itself.
    """
    import shapely

    room = shapely.Polygon(outline)
    if not room.is_valid or room.area <= 0:
        why = shapely.is_valid_reason(room) if room.area > 0 else "none"
        raise refused("outline", "corners around an area", why)
    return room


#: Of a room drawn at random: sides [m], sensors, thickness of the floor [m], its loss [s],
#: reflection of walls. Chosen by judgement: rooms and floors of houses, with the loss of the
#: thesis's chapter 5.
_SIDE_M = (4.0, 10.0)
_SENSORS = (4, 16)
_THICKNESS_M = (0.12, 0.3)
_LOSS_S = (5e-6, 5e-5)
_REFLECTION = (0.3, 0.6)
_SHOES: tuple[ShoeName, ...] = ("heel", "bare", "mixed")
_PATHS: tuple[PathName, ...] = ("straight", "l", "v", "u", "circle", "ellipse", "there-and-back")


def drawn(options: RoomOptions) -> RoomOptions:
    """Return the options with what was open drawn; what was given stays as it is.

    Sides of 4 to 10 m, one room in four square, one L-shaped; 4 to 16 sensors near corners, along
    walls and inside; a slab of 12 to 30 cm with a loss of 5e-6 to 5e-5 s; any shoe, any path,
    walls that reflect 0.3 to 0.6, a resonance in every mounting. What is drawn does not depend on
    what is given, so that one option can be changed in an otherwise equal room.
    """
    rng = np.random.default_rng([options.seed, 3])
    side_m = np.round(rng.uniform(*_SIDE_M, 2), 1)
    kind = rng.choice(["square", "rectangle", "rectangle", "l"])
    count = int(rng.integers(_SENSORS[0], _SENSORS[1] + 1))
    notch = rng.uniform(0.3, 0.5, 2)
    thickness_m = round(rng.uniform(*_THICKNESS_M), 3)
    loss_s = float(f"{np.exp(rng.uniform(*np.log(_LOSS_S))):.2e}")
    walls = round(rng.uniform(*_REFLECTION), 2)
    shoe, path = _SHOES[rng.integers(len(_SHOES))], _PATHS[rng.integers(len(_PATHS))]
    site = options.geometry
    if site is None or not site.sensors:
        if site is None:
            site = Geometry(outline=_outline(options.side_m, side_m, str(kind), notch))
        site = replace(site, sensors=_sensors(rng, site, options.channels or count))
    if options.thickness_m is None and options.dispersion_m2s is None:
        site_thickness_m = site.medium.thickness_m
        options = replace(
            options, thickness_m=thickness_m if site_thickness_m is None else site_thickness_m
        )
    walking = not options.impacts and options.walkers != 2
    return replace(
        options,
        geometry=site,
        channels=None,
        side_m=None,
        loss_s=options.loss_s or loss_s,
        shoe=options.shoe or shoe,
        walls=walls if options.walls is None else options.walls,
        resonances=True,
        path=options.path or (path if walking else None),
    )


def _outline(
    given_m: tuple[float, float] | None, drawn_m: Array, kind: str, notch: Array
) -> tuple[tuple[float, float], ...]:
    """Return a rectangle, or an L without its upper right part of ``notch`` of the sides."""
    x, y = given_m or (float(drawn_m[0]), float(drawn_m[0 if kind == "square" else 1]))
    if kind != "l" or given_m is not None:
        return ((0.0, 0.0), (x, 0.0), (x, y), (0.0, y))
    a, b = np.round((1 - notch) * (x, y), 1).tolist()
    return ((0.0, 0.0), (x, 0.0), (x, b), (a, b), (a, y), (0.0, y))


def _sensors(rng: np.random.Generator, site: Geometry, count: int) -> tuple[Sensor, ...]:
    """Draw sensors one after the other, each of many places the one farthest from those before.

    The places are near the corners, along the walls (5 to 30 cm off) and anywhere inside.
    """
    import shapely

    room = polygon(site.outline)
    edges = [room.buffer(-rng.uniform(0.05, 0.3), join_style="mitre").exterior for _ in range(6)]
    corners = np.concatenate([shapely.get_coordinates(edge)[:-1] for edge in edges[:2]])
    along = np.array(
        [
            edge.interpolate(share, normalized=True).coords[0]
            for edge in edges
            for share in rng.random(8)
        ]
    )
    low, high = np.array(room.bounds).reshape(2, 2)
    inside = rng.uniform(low, high, (120, 2))
    inside = inside[shapely.contains_xy(room.buffer(-0.3), *inside.T)]
    # the farthest would nearly always be at the walls
    pool = np.concatenate([corners, along, inside])
    ease = np.concatenate([np.ones(len(corners) + len(along)), np.full(len(inside), 1.15)])
    chosen = [int(rng.integers(len(corners)))]
    while len(chosen) < count:
        apart = np.hypot(*(pool[:, None] - pool[chosen]).transpose(2, 0, 1)).min(axis=1)
        chosen.append(int(np.argmax(apart * ease)))
    return tuple(
        Sensor(f"G{i}", f"G{i}", x, y)
        for i, (x, y) in enumerate(np.round(pool[chosen], 3).tolist(), 1)
    )


#: What is drawn with ``any``: laws, the spread of gains, full scale over the peak of a mean step at
#: 1 m, precursors [s], bursts a minute. Chosen by judgement: sensors of one kind differ by a tenth
#: to four; two recordings in three clip, the hardest beside the step, half have precursors, a third
#: bursts.
_LAWS: tuple[LawName, ...] = ("plate", "f0.5", "f0.3", "f0", "f-0.3", "layered")
_GAIN_SPREAD, _CLIP_AT, _PRECURSOR_S, _BURSTS = (0.1, 0.4), (0.15, 3.0), (0.02, 0.1), (4.0, 12.0)


def any_law(options: RoomOptions) -> RoomOptions:
    """Return the options with a wave law, and what goes with it, drawn where it was open."""
    rng = np.random.default_rng([options.seed, 13])
    law = _LAWS[rng.integers(len(_LAWS))]
    gains, precursor_s, bursts = (
        round(float(rng.uniform(*x)), 3) for x in (_GAIN_SPREAD, _PRECURSOR_S, _BURSTS)
    )
    clip_at = round(float(np.exp(rng.uniform(*np.log(_CLIP_AT)))), 3)
    clips, precedes, bursts_come = rng.random(3) < (2 / 3, 1 / 2, 1 / 3)
    given = options
    return replace(
        options,
        wave_law=law,
        speed_mps=None if law == "plate" else options.speed_mps,
        gain_spread=gains if options.gain_spread is None else options.gain_spread,
        clip_at=clip_at if options.clip_at is None and clips else options.clip_at,
        precursor_s=precursor_s if given.precursor_s is None and precedes else given.precursor_s,
        bursts=bursts if options.bursts is None and bursts_come else options.bursts,
    )


#: First step and end after the last [s], steps of a walk, and impacts. Chosen by judgement: noise
#: enough before and after, and no impact in the ringing of another.
_FIRST_S = 0.8
_AFTER_LAST_S = 1.2
_STEPS = 20
_IMPACT_S = (1.0, 3.0)  # between two impacts
_FROM_WALL_M = 0.3  # of an impact


@dataclass(frozen=True, slots=True)
class Strike:
    """A step or an impact.

    Attributes
    ----------
    time_ns
        After the first sample [ns].
    x_m, y_m
        Place [m].
    footfall
        Its force.
    foot
        ``left`` or ``right``; empty for an impact.
    target
        Which walker; empty where there is one.
    disturbs
        True: no step and no impact, and not in the truth.
    """

    time_ns: int
    x_m: float
    y_m: float
    footfall: Footfall
    foot: str = ""
    target: str = ""
    disturbs: bool = False


@dataclass(frozen=True, slots=True)
class Gait:
    """How a person walks; the defaults are the thesis's pace, 0.5 to 0.6 s a step.

    Attributes
    ----------
    interval_s, interval_sd_s
        From one step to the next, mean and standard deviation [s].
    shortest_s, longest_s
        Limits of it [s].
    pace_m, pace_sd_m
        Length of a step [m].
    strength, hardness
        Factors of the footfall's force and frequencies.
    """

    interval_s: float = 0.55
    interval_sd_s: float = 0.025
    shortest_s: float = 0.5
    longest_s: float = 0.6
    pace_m: float = 0.58
    pace_sd_m: float = 0.02
    strength: float = 1.0
    hardness: float = 1.0


#: The first walker, and a second one: slower, longer steps, lighter and softer.
GAITS = (Gait(), Gait(0.63, 0.03, 0.55, 0.71, 0.64, 0.025, 0.8, 0.88))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What strikes the floor during the recording.

    Attributes
    ----------
    strikes
        In order of time.
    duration_s
        Of the recording [s].
    start
        Where the first walker starts [m], or None.
    """

    strikes: tuple[Strike, ...]
    duration_s: float
    start: tuple[float, float] | None = None


def course_of(options: RoomOptions, outline: Outline, shoes: Sequence[Shoe]) -> Course:
    """Draw the strikes.

    Raises
    ------
    SimulationError
        Where the outline is too narrow or the steps do not fit in the duration.
    """
    kind = _impacts if options.impacts else _walks
    course = kind(options, outline, shoes)
    others = [*_precursors(options, course), *_bursts(options, course, outline)]
    return replace(course, strikes=tuple(sorted((*course.strikes, *others), key=_time_of)))


def _time_of(strike: Strike) -> int:
    return strike.time_ns


#: Of a precursor: its force over the strike's, and how early it may be at least [s]. Chosen by
#: judgement: a falling weight's rope, a lifted foot.
_PRECURSOR, _PRECURSOR_LEAST_S = (0.03, 0.15), 0.01
#: A slamming door, and a rumble's single blows [N], [Hz], [s]; how many blows, how far apart [s].
#: Chosen by judgement: both lower than a heel, a door as strong.
_DOOR = Shoe((Impact(150.0, 45.0, 0.02), Impact(60.0, 130.0, 0.008)), ())
_RUMBLE = Shoe((Impact(40.0, 18.0, 0.06),), ())
_BLOWS, _BLOW_S = 12, (0.04, 0.12)


def _precursors(options: RoomOptions, course: Course) -> Iterator[Strike]:
    """Give the weak waves that come before strikes, from the same place."""
    rng = np.random.default_rng([options.seed, 14])
    for strike in course.strikes if options.precursor_s else ():
        early_s = rng.uniform(_PRECURSOR_LEAST_S, max(options.precursor_s or 0, _PRECURSOR_LEAST_S))
        strength = strike.footfall.strength * rng.uniform(*_PRECURSOR)
        footfall = replace(strike.footfall, strength=strength, toe=0.0)
        time_ns = strike.time_ns - round(early_s * NS_PER_S)
        yield replace(strike, time_ns=time_ns, footfall=footfall, disturbs=True)


def _bursts(options: RoomOptions, course: Course, outline: Outline) -> Iterator[Strike]:
    """Give doors and rumbles at places along the walls."""
    rng = np.random.default_rng([options.seed, 15])
    wall = polygon(outline).buffer(-0.1).exterior
    for _ in range(rng.poisson((options.bursts or 0.0) * course.duration_s / 60)):
        x, y = np.round(wall.interpolate(rng.random(), normalized=True).coords[0], 4).tolist()
        time_s = rng.uniform(0.1, course.duration_s - 0.5)
        door = rng.random() < 0.5
        for _ in range(1 if door else _BLOWS):
            footfall = replace(Footfall.drawn(rng), shoe=_DOOR if door else _RUMBLE, toe=0.0)
            yield Strike(round(time_s * NS_PER_S), x, y, footfall, disturbs=True)
            time_s += rng.uniform(*_BLOW_S)


def _walks(options: RoomOptions, outline: Outline, shoes: Sequence[Shoe]) -> Course:
    paths = paths_in(outline, options.path or ("crossing" if options.walkers == 2 else "u"))
    delays_s = _meeting(paths)
    strikes: list[Strike] = []
    duration_s = 0.0
    for number, (path, delay_s) in enumerate(zip(paths, delays_s, strict=True)):
        rng = np.random.default_rng([options.seed, 1 if number == 0 else 3 + number])
        walked, needed_s = _walked(options, GAITS[number], path, rng, delay_s)
        target = str(number + 1) if len(paths) > 1 else ""
        strikes += [replace(x, target=target) for x in walked]
        duration_s = max(duration_s, needed_s)
    strikes.sort(key=lambda x: x.time_ns)
    x, y = np.round(paths[0].points[0], 4).tolist()
    return Course(_shod(strikes, shoes, options.seed), duration_s, (x, y))


def _meeting(paths: Sequence[Path]) -> list[float]:
    """Return how long each walker waits, so that all are halfway along their paths at once [s]."""
    halfway_s = [
        path.length_m / 2 * gait.interval_s / gait.pace_m
        for path, gait in zip(paths, GAITS, strict=False)
    ]
    return [max(halfway_s) - x for x in halfway_s]


def _walked(
    options: RoomOptions, gait: Gait, path: Path, rng: np.random.Generator, delay_s: float
) -> tuple[list[Strike], float]:
    """Draw the steps of a walker and the duration they need [s]."""
    wanted = _wanted(options, 0.5)
    gaps = rng.normal(gait.interval_s, gait.interval_sd_s, wanted)
    gaps = np.clip(gaps, gait.shortest_s, gait.longest_s)
    time_s = _FIRST_S + delay_s + np.concatenate(([0.0], np.cumsum(gaps[1:])))
    fitting, duration_s = _fitting(options, time_s)
    run_m = np.cumsum(rng.normal(gait.pace_m, gait.pace_sd_m, wanted))
    places = path.feet(run_m[:fitting] - run_m[0]).tolist()
    times_ns = np.rint(time_s[:fitting] * NS_PER_S).astype(np.int64).tolist()
    footfalls = [Footfall.drawn(rng) for _ in range(fitting)]
    strikes = [
        Strike(
            time_ns,
            x,
            y,
            replace(
                footfall,
                strength=footfall.strength * gait.strength,
                hardness=footfall.hardness * gait.hardness,
            ),
            ("left", "right")[index % 2],
        )
        for index, (time_ns, (x, y), footfall) in enumerate(
            zip(times_ns, places, footfalls, strict=True)
        )
    ]
    return strikes, duration_s


def _impacts(options: RoomOptions, outline: Outline, shoes: Sequence[Shoe]) -> Course:
    import shapely

    rng = np.random.default_rng([options.seed, 1])
    gaps = rng.uniform(*_IMPACT_S, _wanted(options, _IMPACT_S[0]))
    time_s = _FIRST_S + np.concatenate(([0.0], np.cumsum(gaps[1:])))
    fitting, duration_s = _fitting(options, time_s)
    clear = polygon(outline).buffer(-_FROM_WALL_M)
    if clear.is_empty:
        raise refused("outline", "room for impacts", "none")
    low, high = np.array(clear.bounds).reshape(2, 2)
    strikes: list[Strike] = []
    while len(strikes) < fitting:
        x, y = np.round(rng.uniform(low, high), 4).tolist()
        if shapely.intersects_xy(clear, x, y):
            footfall = replace(Footfall.drawn(rng), toe=0.0)
            time_ns = round(time_s[len(strikes)] * NS_PER_S)
            strikes.append(Strike(time_ns, x, y, footfall))
    return Course(_shod(strikes, shoes, options.seed), duration_s)


def _wanted(options: RoomOptions, shortest_s: float) -> int:
    most = _STEPS if options.duration_s is None else int(options.duration_s / shortest_s)
    return options.steps or max(most, 1)


def _fitting(options: RoomOptions, time_s: NDArray[np.float64]) -> tuple[int, float]:
    """Return how many of the strikes fit, and the duration [s]."""
    duration_s = options.duration_s or float(np.ceil(time_s[-1] + _AFTER_LAST_S))
    fitting = int(np.count_nonzero(time_s < duration_s - _AFTER_LAST_S / 2))
    wanted = options.steps or 1
    if fitting < wanted:
        raise refused("steps", f"{fitting} or fewer in {duration_s:g} s", wanted)
    return fitting, duration_s


def _shod(strikes: Sequence[Strike], shoes: Sequence[Shoe], seed: int) -> tuple[Strike, ...]:
    """Put a shoe on every strike, one of them at random."""
    chosen = np.random.default_rng([seed, 7]).integers(len(shoes), size=len(strikes)).tolist()
    return tuple(
        replace(x, footfall=replace(x.footfall, shoe=shoes[k]))
        for x, k in zip(strikes, chosen, strict=True)
    )
