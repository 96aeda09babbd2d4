"""Sensors beside a road, and the road."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.geometry import Geometry, Medium, Sensor

from .road import Road
from .vehicle_options import refused

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .vehicle_options import VehicleOptions

_AXES = ("x", "y", "z")
_ANTENNA_M, _STATION_M = 10.0, 20.0
_ROAD_M = 100.0  # of a straight road that the geometry tells, either way from the sensors


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
        sensors = tuple(replace(s, channel=f"{s.name}{a}", axis=a) for s in upright for a in _AXES)
        site = replace(site, sensors=sensors)
    for sensor in site.sensors:
        if sensor.axis not in _AXES:
            raise refused(f"axis of {sensor.name}", "x, y or z", repr(sensor.axis))
    if len({s.channel for s in site.sensors}) < len(site.sensors):
        raise refused("geometry", "another channel for every sensor", "one used twice")
    road = road_of(options, site)
    corners = road.corners
    if len(corners) == 2 and not options.waypoints and not site.road:
        corners = road.places(np.array([-_ROAD_M, _ROAD_M]))
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
    place = middle_of(site) + offset_m * np.array([-np.sin(heading), np.cos(heading)])
    if options.radius_m is None:
        return Road.straight(place, heading)
    return Road.bend(place, heading, options.radius_m)


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
