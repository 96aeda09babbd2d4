"""The truth beside a road: passes, ways, and who else struck the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S

from .simulation import AUTHOR, START_NS
from .vehicle_site import places_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.geometry import Geometry

    from .vehicle_traffic import Burst, Vehicle

#: Within so much of a station, waypoints tell a vehicle's way [m].
REACH_M = 100.0
_BEYOND_S = 0.25  # a walking span before its first step and after its last


def labels_of(
    vehicles: Sequence[Vehicle], bursts: Sequence[Burst], site: Geometry, duration_s: float
) -> tuple[Label, ...]:
    """Return the labels in order of time."""
    labels: list[Label] = []
    for vehicle in vehicles:
        labels += _passes(vehicle, site, duration_s)
        labels += _waypoints(vehicle, site, duration_s)
    labels += [_struck(burst) for burst in bursts]
    labels += _spans(bursts)
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.target, x.channel)))


def _passes(vehicle: Vehicle, site: Geometry, duration_s: float) -> Iterator[Label]:
    """Give the moment at which the vehicle is closest to each station that it passes."""
    drive = vehicle.drive
    for station, (x, y) in places_of(site).items():
        place = np.array([x, y])
        closest_s = drive.closest_s(place, duration_s)
        if closest_s is None:
            continue
        at = np.array(closest_s)
        vehicle_x, vehicle_y = drive.places(at)
        heading_deg = np.rad2deg(drive.headings(at))
        yield Label(
            _ns(closest_s),
            "pass",
            x_m=float(vehicle_x),
            y_m=float(vehicle_y),
            value=float(drive.speeds(at)),
            channel=station,
            label="forward" if drive.forward else "backward",
            author=AUTHOR,
            note=f"{drive.distances(at, place):.2f} m away, heading {heading_deg:.1f} deg",
            target=vehicle.name,
        )


def _waypoints(vehicle: Vehicle, site: Geometry, duration_s: float) -> Iterator[Label]:
    """Give the vehicle's place at every whole second while it is near any station."""
    time_s = vehicle.drive.times(duration_s, 1.0)
    stations = [np.array(place) for place in places_of(site).values()]
    near = np.min([vehicle.drive.distances(time_s, place) for place in stations], axis=0)
    for second in time_s[near <= REACH_M]:
        x, y = vehicle.drive.places(np.array(second))
        yield Label(
            _ns(second),
            "waypoint",
            x_m=float(x),
            y_m=float(y),
            author=AUTHOR,
            target=vehicle.name,
        )


def _struck(burst: Burst) -> Label:
    # A step's place is a note: the places that scores look at are the vehicles'.
    return Label(
        _ns(burst.time_s),
        "step" if burst.target else "impact",
        author=AUTHOR,
        note=f"at {burst.x_m:.2f}, {burst.y_m:.2f} m",
        target=burst.target,
    )


def _spans(bursts: Sequence[Burst]) -> Iterator[Label]:
    """Give the walking span of each walker."""
    for walker in sorted({b.target for b in bursts if b.target}):
        times = [b.time_s for b in bursts if b.target == walker]
        start_ns, end_ns = _ns(max(times[0] - _BEYOND_S, 0.0)), _ns(times[-1] + _BEYOND_S)
        yield Label(start_ns, "walking", end_ns, author=AUTHOR, target=walker)


def _ns(time_s: float) -> int:
    return START_NS + round(float(time_s) * NS_PER_S)
