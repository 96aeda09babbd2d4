"""Sensors of the room: where they stand, along which axes, and how they are mounted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.geometry import Geometry, Sensor

from .options import CHANNELS, SIDE_M, RoomOptions, refused

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
    number = {place: i for i, place in enumerate(places)}
    of_channel = np.array([number[s.x, s.y] for s in site.sensors], np.intp)
    return np.array(list(places), np.float64), of_channel
