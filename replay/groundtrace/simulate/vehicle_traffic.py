"""Who passes when: vehicles, people on foot, and single impacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .road import Drive, Road
from .vehicle_options import DRAWN_MPS, SPEED_MPS
from .vehicle_site import middle_of, road_of

if TYPE_CHECKING:
    from groundtrace_codecs.geometry import Geometry

    from .vehicle_options import VehicleOptions

#: Root of the mean power of a mean vehicle at 1 m [m/s].
LEVEL_MPS = 5e-5
_LANE_M = 1.75  # of each lane's middle from the road's line, where there are several vehicles
_SPREAD_DB = 3.0
_JITTER = 0.25  # of the time between two passes, by which each is early or late
_OVERLAP_S = (0.5, 2.0)
_PACE_HZ, _WALK_MPS = 1.8, 1.4
_WALK_S = 20.0
_STEP, _IMPACT = 1.0, 4.0  # peak at 1 m over a mean vehicle's level
_AROUND_M = 15.0  # impacts lie so far from the middle of the sensors at most


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """One vehicle.

    Attributes
    ----------
    name
        ``V1`` and so on, in order of passing.
    drive
        Its way.
    mu
        Its energy parameter [(m/s)^2 m^n].
    seed
        Of its noise and its fading.
    """

    name: str
    drive: Drive
    mu: float
    seed: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Burst:
    """A blow on the ground: a decaying swing.

    Attributes
    ----------
    time_s
        After the first sample [s].
    x_m, y_m
        Place [m].
    peak_mps
        About the largest velocity at 1 m [m/s].
    frequency_hz, decay_s
        Of the swing.
    target
        Whose step; empty for an impact.
    """

    time_s: float
    x_m: float
    y_m: float
    peak_mps: float
    frequency_hz: float
    decay_s: float
    target: str = ""


def vehicles_of(options: VehicleOptions, site: Geometry) -> tuple[Vehicle, ...]:
    """Draw the vehicles, in order of passing the middle of the sensors."""
    rng = np.random.default_rng([options.seed, 1])
    road, middle = road_of(options, site), middle_of(site)
    times, forward = _times(options, rng)
    spread_db = options.level_spread_db
    if spread_db is None:
        spread_db = 0.0 if options.passes == 1 else _SPREAD_DB
    vehicles = []
    for number, (time_s, ahead) in enumerate(zip(times, forward, strict=True), 1):
        lane = road if options.passes == 1 else road.beside(-_LANE_M if ahead else _LANE_M)
        speed_mps = options.speed_mps or _drawn_mps(options, rng)
        drive = Drive(
            lane,
            pass_s=time_s,
            along_m=lane.nearest_m(middle),
            speed_mps=speed_mps,
            end_speed_mps=options.end_speed_mps or speed_mps,
            start_s=0.0,
            end_s=options.length_s,
            forward=ahead,
        )
        mu = LEVEL_MPS**2 * 10 ** (spread_db * rng.standard_normal() / 10)
        vehicles.append(Vehicle(f"V{number}", drive, mu, (options.seed, 11, number)))
    return tuple(vehicles)


def _drawn_mps(options: VehicleOptions, rng: np.random.Generator) -> float:
    return SPEED_MPS if options.passes == 1 else round(float(rng.uniform(*DRAWN_MPS)), 2)


def _times(options: VehicleOptions, rng: np.random.Generator) -> tuple[list[float], list[bool]]:
    """Return when each vehicle passes the middle [s], in order, and whether it goes forward."""
    length_s, count = options.length_s, options.passes
    if count == 1:
        return [length_s / 2], [True]
    slot_s = length_s / count
    times = (np.arange(count) + 0.5 + rng.uniform(-_JITTER, _JITTER, count)) * slot_s
    forward = rng.permutation(np.arange(count) % 2 == 0)
    if options.overlap:
        times[1] = times[0] + min(rng.uniform(*_OVERLAP_S), slot_s / 2)
        rest = rng.permutation(np.arange(count - 2) % 2 == 0)
        forward = np.concatenate([[True, False], rest])
    return [float(t) for t in times], [bool(f) for f in forward]


def bursts_of(options: VehicleOptions, site: Geometry) -> tuple[Burst, ...]:
    """Draw steps of people who walk by and single impacts, in order of time."""
    rng = np.random.default_rng([options.seed, 2])
    bursts = [b for n in range(options.walkers) for b in _walk(options, site, f"W{n + 1}", rng)]
    bursts += [_impact(options, site, rng) for _ in range(options.impacts)]
    return tuple(sorted(bursts, key=lambda b: (b.time_s, b.target)))


def _walk(
    options: VehicleOptions, site: Geometry, name: str, rng: np.random.Generator
) -> list[Burst]:
    """Walk straight by the middle of the sensors at 1.8 steps a second."""
    half_s = min(_WALK_S, options.length_s / 2) / 2
    when_s = rng.uniform(half_s, options.length_s - half_s)
    heading = rng.uniform(0, 2 * np.pi)
    aside = rng.uniform(-5.0, 5.0) * np.array([-np.sin(heading), np.cos(heading)])
    path = Road.straight(middle_of(site) + aside, heading)
    times = np.arange(when_s - half_s, when_s + half_s, 1 / _PACE_HZ)
    times += rng.normal(0, 0.02, len(times))
    level = LEVEL_MPS * _STEP * rng.uniform(0.8, 1.25)
    places = path.places(_WALK_MPS * (times - when_s))
    return [
        _burst(options, t, place, level * rng.uniform(0.85, 1.15), rng, name)
        for t, place in zip(times, places, strict=True)
        if 0 <= t < options.length_s
    ]


def _impact(options: VehicleOptions, site: Geometry, rng: np.random.Generator) -> Burst:
    angle, away_m = rng.uniform(0, 2 * np.pi), _AROUND_M * np.sqrt(rng.random())
    place = middle_of(site) + away_m * np.array([np.cos(angle), np.sin(angle)])
    time_s = rng.uniform(0, options.length_s)
    return _burst(options, time_s, place, LEVEL_MPS * _IMPACT * rng.uniform(0.6, 1.6), rng)


def _burst(
    options: VehicleOptions,
    time_s: float,
    place: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    peak_mps: float,
    rng: np.random.Generator,
    target: str = "",
) -> Burst:
    frequency_hz = min(rng.uniform(20.0, 35.0), 0.25 * options.rate_hz)
    x, y = (float(v) for v in place)
    return Burst(float(time_s), x, y, peak_mps, frequency_hz, rng.uniform(0.03, 0.06), target)
