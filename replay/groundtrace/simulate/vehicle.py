"""Vehicles that pass seismic sensors beside a road.

A vehicle is a continuous source of Gaussian noise whose band wanders, and whose power falls with
distance as mu / r^n: Yu. V. Morozov, M. A. Raifeld, A. A. Spektor, Processing of seismic signals
for estimating the trajectory of a moving vehicle, Novosibirsk State Technical University, 2018 (in
Russian), equation (4). Its waves need r / c to a sensor, which gives them the Doppler shift; paths
that interfere fade as the paper says before its equation (10). Without options one car crosses the
lines of two antennas of three geophones each, as in the paper's figure 2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S, Channel, Stream

from .nodes import nodes_of
from .recording import AUTHOR, START_NS, Simulation, described
from .road import VehicleOptions, places_of, site_of
from .vehicle_signal import (
    LEVEL_MPS,
    PARTS,
    Channels,
    Ground,
    RoadSignal,
    Source,
    bursts_of,
    vehicles_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .vehicle_signal import Burst, Vehicle

#: Chosen by judgement: a trade of the two; a usual distance to a road; an engine heard beside the
#: tyres.
_NOISE_COUNTS = 4.0  # of the digitiser: real noise, yet most of every sample compresses away
_SNR_AT_M = 10.0
_ENGINE_SHARE = 0.3  # of a vehicle's power, where it has tones
#: Full scale over the root of the mean power at the closest approach: Gaussian noise, and twice
#: that where fading adds to it. Chosen by judgement: no vehicle clips.
_HEADROOM, _FADING = 7.0, 2.0


def simulate_vehicle(options: VehicleOptions | None = None) -> Simulation:
    """Simulate vehicles on a road beside sensors, with people on foot and impacts if asked for.

    The truth: ``pass`` per vehicle and station at the moment of the closest approach, with the
    vehicle's place, its speed as value, the station's name as channel, ``forward`` or ``backward``
    along the road as label; ``waypoint`` with each vehicle's place at every whole second while it
    is within 100 m of a station; ``step`` and one ``walking`` span per walker, ``impact``.
    ``target`` says who: V1, V2 are vehicles, W1, W2 walkers. All are times of the source; waves are
    felt r / c later. The metadata record ``vehicle_mu`` holds each vehicle's energy parameter
    [(m/s)^2 m^n], ``sensor_gain`` gains that are not 1. Beside nodes, ``vehicle_kind`` tells what
    each vehicle is and ``site`` what was drawn; of gusts and of trucks far away there is no truth.

    Raises
    ------
    SimulationError
        Where an option is out of its range, two exclude each other, or a geometry cannot be used.
    """
    options = options or VehicleOptions()
    options.check()
    if options.layout == "nodes":
        return _beside_nodes(options)
    site = site_of(options)
    vehicles, bursts = vehicles_of(options, site), bursts_of(options, site)
    gains = _gains(options, site)
    signal = _signal(options, site, vehicles, bursts, gains)
    return Simulation(
        sources=[(signal.stream, "i16le", signal)],
        geometry=site,
        labels=labels_of(vehicles, bursts, site, options.length_s),
        metadata=described(
            "vehicle", replace(options, geometry=None, components=options.components or 1)
        )
        | {"vehicle_mu": {v.name: repr(v.mu) for v in vehicles}}
        | _gains_said(options, site, gains),
    )


def _beside_nodes(options: VehicleOptions) -> Simulation:
    signal = nodes_of(options)
    vehicles, site = [ride.vehicle for ride in signal.rides], signal.site
    return Simulation(
        sources=[(signal.stream, "i32le", signal)],
        geometry=site.geometry,
        labels=labels_of(vehicles, signal.bursts, site.geometry, options.length_s),
        metadata=described("vehicle", options)
        | {
            "vehicle_kind": {ride.vehicle.name: ride.kind for ride in signal.rides},
            "site": site.metadata(),
        },
    )


def _signal(
    options: VehicleOptions,
    site: Geometry,
    vehicles: Sequence[Vehicle],
    bursts: Sequence[Burst],
    gains: NDArray[np.float64],
) -> RoadSignal:
    """Return what generates the samples, scaled so that noise is some counts and nothing clips."""
    ground = Ground(options.velocity_mps, options.exponent, options.loss_spm, options.coherence_m)
    sigma_mps = float(ground.amplitude(np.array(_SNR_AT_M), LEVEL_MPS**2, 0.0)) / options.snr
    loudest_mps = _loudest(options, site, ground, vehicles, bursts) * gains.max()
    scale = max(sigma_mps / _NOISE_COUNTS, loudest_mps / 32767)
    channels = tuple(
        Channel(s.channel, "ground_velocity", "m/s", s.axis, scale, (s.x, s.y, s.z))
        for s in site.sensors
    )
    return RoadSignal(
        Stream("/seismic", channels, options.rate_hz),
        options.seed,
        options.length_s,
        vehicles,
        [_source(options, vehicle) for vehicle in vehicles],
        bursts,
        ground,
        _channels(site),
        sigma_mps,
        wind_mps=sigma_mps * options.wind,
        gains=gains,
        geophone_hz=options.geophone_hz,
    )


def _source(options: VehicleOptions, vehicle: Vehicle) -> Source:
    return Source(
        options.rate_hz,
        options.source_hz,
        PARTS if options.loss_spm else 1,
        options.engine_hz,
        _ENGINE_SHARE,
        vehicle.seed,
    )


def _channels(site: Geometry) -> Channels:
    names = list(places_of(site))
    station = np.array([names.index(s.name) for s in site.sensors], np.intp)
    places = np.array(list(places_of(site).values()), np.float64)
    return Channels(places, station, tuple(s.axis for s in site.sensors))


def _loudest(
    options: VehicleOptions,
    site: Geometry,
    ground: Ground,
    vehicles: Sequence[Vehicle],
    bursts: Sequence[Burst],
) -> float:
    """Return a velocity that no sensor exceeds but by a rare swing [m/s]."""
    headroom = _HEADROOM * (1.0 if options.coherence_m is None else _FADING)
    loudest = [0.0]
    for position in (np.array(p) for p in places_of(site).values()):
        for vehicle in vehicles:
            time_s = vehicle.drive.times(options.length_s, 0.05)
            near = vehicle.drive.distances(time_s, position).min()
            loudest.append(headroom * float(ground.amplitude(near, vehicle.mu, 0.0)))
        for burst in bursts:
            near = np.hypot(*(position - (burst.x_m, burst.y_m)))
            loudest.append(2 * burst.peak_mps * float(ground.amplitude(near, 1.0, 0.0)))
    return max(loudest)


def _gains(options: VehicleOptions, site: Geometry) -> NDArray[np.float64]:
    rng = np.random.default_rng([options.seed, 5])
    gains: NDArray[np.float64] = np.exp(
        options.gain_spread * rng.standard_normal(len(site.sensors))
    )
    return gains


def _gains_said(
    options: VehicleOptions, site: Geometry, gains: NDArray[np.float64]
) -> dict[str, dict[str, str]]:
    if not options.gain_spread:
        return {}
    pairs = zip(site.sensors, gains.tolist(), strict=True)
    return {"sensor_gain": {sensor.channel: repr(gain) for sensor, gain in pairs}}


#: Within so much of a station, waypoints tell a vehicle's way [m]. Chosen by judgement: as far as
#: stations hear.
REACH_M = 100.0
#: Chosen by judgement: half a step.
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
        position = np.array([x, y])
        closest_s = drive.closest_s(position, duration_s)
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
            note=f"{drive.distances(at, position):.2f} m away, heading {heading_deg:.1f} deg",
            target=vehicle.name,
        )


def _waypoints(vehicle: Vehicle, site: Geometry, duration_s: float) -> Iterator[Label]:
    """Give the vehicle's place at every whole second while it is near any station."""
    time_s = vehicle.drive.times(duration_s, 1.0)
    stations = [np.array(position) for position in places_of(site).values()]
    near = np.min([vehicle.drive.distances(time_s, position) for position in stations], axis=0)
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
