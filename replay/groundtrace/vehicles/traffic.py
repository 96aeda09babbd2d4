"""Vehicles on a road, from the passes of single stations to the passes of all of them jointly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .passes import StationPass
from .roads import Road, associate
from .traffic_model import DISTANCE, GAINS, MOMENT, PEAK, SLOWNESS, Vehicle
from .traffic_search import vehicles_on

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from .traffic_model import RoadPowers
    from .traffic_search import Told


@dataclass(frozen=True, slots=True)
class Driven:
    """A vehicle on a road, and its passes.

    Attributes
    ----------
    speed_mps, speed_sigma_mps
        Speed and its standard deviation [m/s].
    direction
        1 towards greater distance along the road, else -1.
    passes
        Of each station by which it comes while cycles last.
    """

    speed_mps: float
    speed_sigma_mps: float
    direction: int
    passes: tuple[tuple[int, StationPass], ...]


def driven(
    observed: RoadPowers, passes: Sequence[Sequence[StationPass]], road: Road
) -> tuple[Driven, ...]:
    """Return the vehicles that all stations tell jointly, in order of time.

    Parameters
    ----------
    observed
        Powers of two stations or more, at different places along the road.
    passes
        Of each station by itself: where to start.
    road
        Stations and speeds by which those are put together.
    """
    start = list(_started(observed, passes, road))
    return tuple(_driven(observed, told) for told in vehicles_on(observed, start))


def _started(
    observed: RoadPowers, passes: Sequence[Sequence[StationPass]], road: Road
) -> Iterator[Vehicle]:
    """Give the vehicles of passes that lie on a line, then one for each pass that is left."""
    left = {(i, number): one for i, those in enumerate(passes) for number, one in enumerate(those)}
    for found in associate(road, passes):
        peaks = [np.log(left.pop(member).peak) for member in found.passes]
        values = observed.usual.copy()
        values[MOMENT] = found.time_at(float(observed.along_m.mean()))
        values[SLOWNESS], values[PEAK] = -np.log(found.speed_mps), np.mean(peaks)
        yield Vehicle(values, found.direction)
    for (station, _), one in left.items():
        values = observed.usual.copy()
        values[PEAK] = np.log(one.peak)
        values[MOMENT] = one.time_s - observed.centred_m[station] * np.exp(values[SLOWNESS])
        yield Vehicle(values, 1)


def _driven(observed: RoadPowers, told: Told) -> Driven:
    vehicle, speed = told.vehicle, told.vehicle.speed_mps
    first, last = observed.times_s[0], observed.times_s[-1]
    passes = tuple(
        (station, one)
        for station, one in enumerate(_passes(observed, told))
        if first <= one.time_s <= last
    )
    sigma = speed * float(np.sqrt(told.covariance[SLOWNESS, SLOWNESS]))
    return Driven(speed, sigma, vehicle.direction, passes)


def _passes(observed: RoadPowers, told: Told) -> Iterator[StationPass]:
    """Give a vehicle's pass at each station, errors by the delta method."""
    vehicle, spread = told.vehicle, told.covariance
    moments, widths, peaks = (
        f(vehicle).tolist() for f in (observed.moments, observed.widths, observed.peaks)
    )
    for station, along in enumerate(observed.centred_m):
        moment, width, peak = np.zeros((3, len(spread)))
        moment[[MOMENT, SLOWNESS]] = 1.0, vehicle.slowness * along
        width[[SLOWNESS, DISTANCE]] = 1.0
        peak[[PEAK, GAINS + station]] = 1.0
        time_sigma, width_sigma, peak_sigma = (
            float(np.sqrt(row @ spread @ row)) for row in (moment, width, peak)
        )
        floor = float(np.interp(moments[station], observed.times_s, observed.noise[:, station]))
        yield StationPass(
            moments[station],
            time_sigma,
            widths[station],
            width_sigma,
            peaks[station],
            peak_sigma,
            peaks[station] / floor,
            told.together,
        )
