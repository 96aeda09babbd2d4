"""Geometry of a site: outline, sensors, medium. TOML for people, JSON inside a recording."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from .errors import SchemaError
from .signals import SEISMIC_QUANTITIES
from .toml import toml_value

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .signals import Stream

    Array = NDArray[np.float64]

#: Name of the attachment that holds a recording's geometry.
SITE_NAME = "site.json"
#: Sensors no further apart are at one place [m].
_SAME_M = 0.01
#: Stations are in a line where they stray from it by less than this part of its length.
_STRAIGHT = 0.1
#: So many names are listed.
_LISTED = 8


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor at a place.

    Attributes
    ----------
    name
        Shown to people.
    channel
        Channel of the recording it feeds.
    x, y, z
        Position [m].
    axis
        Direction of sensitivity: ``x``, ``y`` or ``z``.
    clock_offset_s
        How far its clock is ahead of the common one [s]: subtracted from its arrivals.
    """

    name: str
    channel: str
    x: float
    y: float
    z: float = 0.0
    axis: str = "z"
    clock_offset_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Medium:
    """What the waves run through; unknown values are None.

    Attributes
    ----------
    thickness_m
        Of the floor [m].
    velocity_mps
        Calibrated propagation velocity [m/s].
    theta_s
        Time scale of the perceived velocity law [s].
    arrival_scale, arrival_exponent
        k [s/m^p] and p of arrivals t = t0 + k d^p.
    arrival_sigma_s
        Standard deviation of an arrival [s].
    """

    thickness_m: float | None = None
    velocity_mps: float | None = None
    theta_s: float | None = None
    arrival_scale: float | None = None
    arrival_exponent: float | None = None
    arrival_sigma_s: float | None = None


@dataclass(frozen=True, slots=True)
class Geometry:
    """A site: right-handed, z up; metres, unless the unit of length is unknown.

    Attributes
    ----------
    sensors
        In the order of the file.
    outline
        Corners of the room or site [m].
    start
        Where a walk starts [m], or None.
    sources
        Named places of controlled impacts [m], e.g. shot points.
    medium
        What the waves run through.
    unit
        ``m``, or ``unknown``: then every length, also in the medium's values, is in the unknown
        unit that the places were written in.
    road
        Corners of the line of a road, in its forward direction [m].
    paths
        Corners of lines that people walk along, one each [m].
    origin
        Latitude, longitude [deg] and height [m] of the site's zero, from which x points east and y
        north; None where nobody knows.
    """

    sensors: tuple[Sensor, ...] = ()
    outline: tuple[tuple[float, float], ...] = ()
    start: tuple[float, float] | None = None
    sources: tuple[tuple[str, float, float], ...] = ()
    medium: Medium = Medium()
    unit: str = "m"
    road: tuple[tuple[float, float], ...] = ()
    paths: tuple[tuple[tuple[float, float], ...], ...] = ()
    origin: tuple[float, float, float] | None = None

    @property
    def length_unit(self) -> str:
        """What to write behind a length: ``m``, or ``units`` where the unit is unknown."""
        return "units" if self.unit == UNKNOWN_UNIT else "m"

    def clock_offsets(self, channels: Iterable[str]) -> Array:
        """Return how far the clock of each channel is ahead, 0 where unknown, shape (n,) [s]."""
        ahead = {s.channel: s.clock_offset_s for s in self.sensors}
        return np.array([ahead.get(name, 0.0) for name in channels], np.float64)

    def placed(self, channels: Sequence[str]) -> tuple[dict[str, int], Array]:
        """Return the row of each channel whose place is known, and the places, shape (n, 2) [m].

        Channels of several axes at one place are one sensor: that of z, which the waves of a step
        move most, or of the first axis where there is no z.
        """
        by_channel = {s.channel: s for s in self.sensors}
        sensors = [by_channel[name] for name in dict.fromkeys(channels) if name in by_channel]
        axis: dict[tuple[float, float, float], str] = {}
        for s in sensors:
            position = s.x, s.y, s.z
            axis[position] = "z" if s.axis == "z" else axis.get(position, s.axis)
        placed = [s for s in sensors if axis[s.x, s.y, s.z] == s.axis]
        positions = np.array([(s.x, s.y) for s in placed], np.float64).reshape(-1, 2)
        return {s.channel: index for index, s in enumerate(placed)}, positions

    def stations(self) -> Stations:
        """Return the stations: the sensors of one place are one."""
        names: list[str] = []
        places: list[tuple[float, float]] = []
        of_channel: dict[str, int] = {}
        for sensor in self.sensors:
            here = (sensor.x, sensor.y)
            apart = [np.hypot(here[0] - x, here[1] - y) for x, y in places]
            index = next((i for i, d in enumerate(apart) if d < _SAME_M), len(places))
            if index == len(places):
                names.append(sensor.name)
                places.append(here)
            of_channel[sensor.channel] = index
        velocity = self.medium.velocity_mps
        return Stations(
            tuple(names),
            np.array(places, np.float64).reshape(-1, 2),
            of_channel,
            np.array(self.road, np.float64).reshape(-1, 2),
            float("inf") if velocity is None else velocity,
        )

    def to_json(self) -> bytes:
        """Return the geometry as the JSON of a recording's ``site.json``."""
        return msgspec.json.encode(self)

    @classmethod
    def from_json(cls, data: bytes, where: str = SITE_NAME) -> Geometry:
        """Read a recording's ``site.json``.

        Raises
        ------
        SchemaError
            Where the JSON is not a geometry; names ``where``.
        """
        try:
            return msgspec.json.decode(data, type=cls)
        except msgspec.DecodeError as error:
            raise SchemaError(f"{where}: expected a geometry, found: {error}") from error

    @classmethod
    def from_toml(cls, path: Path) -> Geometry:
        """Read a geometry TOML: ``unit``, ``outline``, ``road``, ``[[sensor]]``, ``[medium]``, ...

        Places in a known unit become metres; those in an ``unknown`` one stay.

        Raises
        ------
        SchemaError
            Where the file is not TOML, has an unknown key, a wrong type, or an unknown unit.
        """
        try:
            return msgspec.convert(geometry_table(path), cls)
        except msgspec.ValidationError as error:
            raise SchemaError(f"{path.name}: expected a geometry, found: {error}") from error

    def to_toml(self) -> str:
        """Return the geometry as a TOML that :meth:`from_toml` reads as the same."""
        return geometry_text(msgspec.to_builtins(self))


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations, a road beside them, and the ground.

    Attributes
    ----------
    names
        Of the stations; a station of three axes is one.
    places
        Shape (n, 2) [m].
    of_channel
        The station of each channel, by index.
    road
        Shape (k, 2): corners of the road in its forward direction [m]; k is 0 where none is known.
    velocity_mps
        Of the waves [m/s]; inf where unknown.
    """

    names: tuple[str, ...]
    places: Array
    of_channel: dict[str, int]
    road: Array
    velocity_mps: float

    def along_road(self) -> tuple[Array, Array]:
        """Return how far along the road each station is, and how far from it, shapes (n,) [m].

        Without a road: along the line through the stations, from the first on, and 0.
        """
        if len(self.road) < 2:
            along = _axis(self.places)
            way = (self.places - self.places[0]) @ along
            return way * (1 if way[-1] >= 0 else -1), np.zeros(len(way))
        projections = [_projected(position, self.road) for position in self.places]
        return np.array([a for a, _ in projections]), np.array([d for _, d in projections])

    def in_line(self) -> bool:
        """Return whether the stations are in a line along the road, as they are beside one."""
        if len(self.names) < 2:
            return True
        centred = self.places - self.places.mean(axis=0)
        spread = np.linalg.svd(centred, compute_uv=False)
        straight = len(spread) < 2 or spread[1] < _STRAIGHT * spread[0]
        if len(self.road) < 2:
            return bool(straight)
        along, _ = self.along_road()
        length = float(np.linalg.norm(self.places[:, None] - self.places, axis=2).max())
        return bool(straight and np.ptp(along) > 0.7 * length)


def _axis(places: Array) -> Array:
    centred = places - places.mean(axis=0)
    return np.asarray(np.linalg.svd(centred)[2][0])


def _projected(position: Array, road: Array) -> tuple[float, float]:
    """Return the way along the corners of a road to its point nearest to a place; the distance."""
    best, gone = (0.0, float("inf")), 0.0
    for a, b in pairwise(road):
        length = float(np.hypot(*(b - a)))
        part = float(np.clip((position - a) @ (b - a) / length**2, 0, 1)) if length else 0.0
        away = float(np.hypot(*(position - a - part * (b - a))))
        if away < best[1]:
            best = gone + part * length, away
        gone += length
    return best


def placed(stream: Stream, geometry: Geometry | None) -> Stream:
    """Return the stream with the positions its geometry gives to channels of the same name."""
    if geometry is None:
        return stream
    where = {s.channel: (s.x, s.y, s.z) for s in geometry.sensors}
    channels = tuple(
        replace(c, position_m=where.get(c.name, c.position_m)) for c in stream.channels
    )
    return replace(stream, channels=channels)


def geometry_warnings(geometry: Geometry | None, streams: Sequence[Stream]) -> list[str]:
    """Return what a geometry and the seismic channels of a recording do not have in common."""
    if geometry is None or not geometry.sensors:
        return []
    channels = [s.channels[c].name for s in streams for c in s.columns_of(SEISMIC_QUANTITIES)]
    placed = {sensor.channel for sensor in geometry.sensors}
    silent = [s for s in geometry.sensors if s.channel not in channels]
    loose = [name for name in dict.fromkeys(channels) if name not in placed]
    warnings = []
    if silent:
        names = [s.channel if s.name == s.channel else f"{s.name} ({s.channel})" for s in silent]
        warnings.append(
            f"{len(silent)} of {len(geometry.sensors)} sensors of the geometry have no channel in "
            f"the recording: {_listed(names)}"
        )
    if loose:
        warnings.append(
            f"{len(loose)} of {len(set(channels))} seismic channels of the recording have no place "
            f"in the geometry: {_listed(loose)}"
        )
    return warnings


def _listed(names: Sequence[str]) -> str:
    """Return names with commas between, of many the first ones and how many more there are."""
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


#: The unit of places that nobody measured against a known length.
UNKNOWN_UNIT = "unknown"
#: Metres of each unit that places may be written in.
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
KEYS = ("unit", "outline", "start", "road", "paths", "origin", "sensor", "source", "medium")
#: Where numbers that are lengths in the unit of the file stand in a table.
PLACES = ("x", "y", "z")


def geometry_table(path: Path) -> dict[str, Any]:
    """Return the fields of a geometry as a TOML has them, lengths of a known unit in metres.

    The medium's values carry their own units and are not converted.

    Raises
    ------
    SchemaError
        Where the file is not TOML, has an unknown key, or a unit that is none of length.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SchemaError(f"{path.name}: expected TOML, found: {error}") from error
    unknown = sorted(set(table) - set(KEYS))
    if unknown:
        raise SchemaError(
            f"{path.name}: {unknown[0]}: expected one of {', '.join(KEYS)}, found an unknown key"
        )
    unit = table.pop("unit", "m")
    if unit != UNKNOWN_UNIT and unit not in METRES:
        raise SchemaError(
            f"{path.name}: unit: expected one of {', '.join(METRES)}, {UNKNOWN_UNIT}, "
            f"found {unit!r}"
        )
    metres = 1.0 if unit == UNKNOWN_UNIT else METRES[unit]
    return {
        "origin": table.pop("origin", None),
        "sensors": _scaled(table.pop("sensor", []), metres),
        "sources": _scaled(table.pop("source", []), metres),
        "unit": unit if unit == UNKNOWN_UNIT else "m",
        "medium": table.pop("medium", {}),
    } | {key: _scaled(value, metres) for key, value in table.items()}


def _scaled(value: Any, metres: float) -> Any:
    """Return a value with its lengths in metres; what is no length stays as it is."""
    if isinstance(value, dict):
        return {k: _scaled(v, metres) if k in PLACES else v for k, v in value.items()}
    if isinstance(value, list):
        return [_scaled(item, metres) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool) and metres != 1.0:
        return value * metres
    return value


def geometry_text(fields: Mapping[str, Any]) -> str:
    """Return a geometry, as its fields, as TOML; fields without a value are left out."""
    lines = [f"unit = {toml_value(fields['unit'])}"]
    keys = [key for key in ("outline", "start", "road", "paths", "origin") if fields[key]]
    lines += [f"{key} = {toml_value(fields[key])}" for key in keys]
    if fields["sources"]:
        lines.append(f"source = {toml_value(fields['sources'])}")
    for sensor in fields["sensors"]:
        lines += ["", "[[sensor]]", *_pairs(sensor)]
    lines += ["", "[medium]", *_pairs(fields["medium"])]
    return "\n".join(lines) + "\n"


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {toml_value(value)}" for key, value in table.items() if value is not None]


#: Radius of the equator, and first eccentricity squared (NIMA TR8350.2, third edition).
EQUATOR_M, ECCENTRICITY = 6_378_137.0, 6.694_379_990_14e-3


def metres_per_radian(latitude_rad: float) -> tuple[float, float]:
    """Return metres per radian of longitude and per radian of latitude at a latitude [rad]."""
    bent = 1 - ECCENTRICITY * math.sin(latitude_rad) ** 2
    east = EQUATOR_M / math.sqrt(bent) * math.cos(latitude_rad)
    return east, EQUATOR_M * (1 - ECCENTRICITY) / bent**1.5


@dataclass(slots=True)
class TangentPlane:
    """Turns latitude and longitude into metres east and north of the first fix.

    Attributes
    ----------
    at
        Where the first fix lies on the map [m].
    origin
        Its latitude and longitude [rad]; None before.
    """

    at: tuple[float, float] = (0.0, 0.0)
    origin: tuple[float, float] | None = None

    def map_position(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return the place of a fix on the map [m]; angles in rad."""
        if self.origin is None:
            self.origin = (latitude, longitude)
        start, meridian = self.origin
        across, along = metres_per_radian(start)
        east_rad = (longitude - meridian + math.pi) % (2 * math.pi) - math.pi
        return self.at[0] + across * east_rad, self.at[1] + along * (latitude - start)

    def position(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return latitude and longitude of a place on the map [rad]; the first fix comes before.

        Raises
        ------
        ValueError
            Before the first fix.
        """
        if self.origin is None:
            raise ValueError("plane: expected a first fix, found none")
        start, meridian = self.origin
        across, along = metres_per_radian(start)
        return start + (y_m - self.at[1]) / along, meridian + (x_m - self.at[0]) / across


def tangent_plane(site: Geometry | None) -> TangentPlane:
    """Return the plane of a site's metres.

    It touches the earth at the site's origin, where that is known; else at the first fix, which
    lies where walks start.
    """
    if site is not None and site.origin is not None:
        return TangentPlane(origin=(math.radians(site.origin[0]), math.radians(site.origin[1])))
    return TangentPlane(site.start if site is not None and site.start else (0.0, 0.0))
