"""Channels of seismic files as their station metadata describes them: units, gains, places."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..earth import ORIGIN, metres_per_radian
from ..geometry import Geometry, Sensor
from ..signals import NS_PER_S, Channel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .station_xml import Epoch, Stations


@dataclass(frozen=True, slots=True)
class Described:
    """What the channels of some files are.

    Attributes
    ----------
    channels
        By name.
    factors
        By name, for each segment: what its samples have to be multiplied with to be worth what
        the first segment's are.
    geometry
        Where the sensors stand, where that is known.
    origin
        Latitude, longitude [deg], height [m] of the site's zero.
    warnings, remarks
        One line each.
    """

    channels: dict[str, Channel]
    factors: dict[str, tuple[float, ...]]
    geometry: Geometry | None = None
    origin: tuple[float, float, float] | None = None
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The record of the origin, where there is one."""
        if self.origin is None:
            return {}
        names = ("latitude_deg", "longitude_deg", "height_m")
        return {ORIGIN: dict(zip(names, map(repr, self.origin), strict=True))}


def split(traces: Sequence[Any], stations: Stations) -> list[Any]:
    """Return ObsPy's traces, cut where what a count is worth changes."""
    parts = []
    for trace in traces:
        start_ns, rate_hz = int(trace.stats.starttime.ns), trace.stats.sampling_rate
        stop_ns = start_ns + round(trace.stats.npts * NS_PER_S / rate_hz)
        changes = stations.changes(trace.id, start_ns, stop_ns)
        rows = [math.ceil((t - start_ns) * rate_hz / NS_PER_S) for t in changes]
        edges = [0, *(r for r in rows if 0 < r < trace.stats.npts), trace.stats.npts]
        if len(edges) == 2:
            parts.append(trace)
            continue
        for first, stop in pairwise(edges):
            header = trace.stats.copy()
            begin_ns = start_ns + round(first * NS_PER_S / rate_hz)
            header.starttime = type(header.starttime)(ns=begin_ns)
            parts.append(type(trace)(trace.data[first:stop], header))
    return parts


def describe(
    channels: Mapping[str, Sequence[Any]], plain: Mapping[str, Channel], stations: Stations
) -> Described:
    """Return channels in the units and at the places of their epochs.

    Parameters
    ----------
    channels
        ObsPy's traces of each channel, in order of time.
    plain
        The channels without metadata: what stays where there is none.
    stations
        The metadata.
    """
    made, factors, places, warnings = dict(plain), {}, {}, []
    for name, traces in channels.items():
        epochs = [stations.at(trace.id, int(trace.stats.starttime.ns)) for trace in traces]
        known = [epoch for epoch in epochs if epoch is not None]
        if fault := _fault(traces, epochs, stations):
            warnings.append(f"{fault}: its samples stay counts")
        else:
            made[name] = replace(
                plain[name],
                quantity=known[0].quantity,
                unit=known[0].unit,
                axis=known[0].axis,
                scale=known[0].scale,
            )
            factors[name] = tuple(epoch.scale / known[0].scale for epoch in known)
        if known:
            places[name] = known[0].place
            if any(epoch.place != known[0].place for epoch in known):
                warnings.append(f"{stations.name}: {name}: was moved: its first place is kept")
    site = Described(made, factors, warnings=tuple(warnings))
    return _placed(site, places, stations.name) if places else site


def _fault(traces: Sequence[Any], epochs: Sequence[Epoch | None], stations: Stations) -> str | None:
    """Return why the channel of some traces cannot be brought to units."""
    name = traces[0].id
    if name not in stations.epochs:
        near = [other for other in stations.epochs if other.split(".")[:2] == name.split(".")[:2]]
        found = ", ".join(near) or "no channel of this station"
        return f"{stations.name}: {name}: expected this channel, found {found}"
    for trace, epoch in zip(traces, epochs, strict=True):
        if epoch is None:
            return (
                f"{stations.name}: {name}: expected an epoch at {trace.stats.starttime}, found none"
            )
        if epoch.fault:
            return f"{stations.name}: {name}: {epoch.fault}"
    if len({(e.quantity, e.unit, e.axis) for e in epochs if e is not None}) > 1:
        return f"{stations.name}: {name}: expected one quantity and axis, found several epochs'"
    return None


def _placed(
    site: Described, places: Mapping[str, tuple[float, float, float]], file: str
) -> Described:
    """Return the site with its sensors in metres east, north and up of the first one."""
    first, origin = next(iter(places.items()))
    across, along = metres_per_radian(math.radians(origin[0]))
    channels = dict(site.channels)
    sensors = []
    for name, place in places.items():
        turned = (place[1] - origin[1] + 180.0) % 360.0 - 180.0
        east, north = across * math.radians(turned), along * math.radians(place[0] - origin[0])
        position = (round(east, 3), round(north, 3), round(place[2] - origin[2], 3))
        channels[name] = replace(channels[name], position_m=position)
        sensors.append(Sensor(name, name, *position, channels[name].axis or "z"))
    said = (
        f"places are metres east, north and up of {origin[0]:.6f}, {origin[1]:.6f} at "
        f"{origin[2]:g} m, where {first} stands ({file})"
    )
    return replace(
        site,
        channels=channels,
        geometry=Geometry(sensors=tuple(sensors)),
        origin=origin,
        remarks=(said, *_scaled(site, file)),
    )


def _scaled(site: Described, file: str) -> list[str]:
    """Say what was done to the samples."""
    kinds = dict.fromkeys(
        f"{site.channels[name].quantity} in {site.channels[name].unit}" for name in site.factors
    )
    if not kinds:
        return []
    return [f"{', '.join(kinds)} by the sensitivity of {file}; the response was not taken out"]
