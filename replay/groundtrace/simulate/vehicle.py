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

from groundtrace_codecs.signals import Channel, Stream

from .simulation import Simulation, described
from .vehicle_options import VehicleOptions
from .vehicle_signal import RoadSignal
from .vehicle_site import places_of, site_of
from .vehicle_source import PARTS, Source
from .vehicle_traffic import LEVEL_MPS, bursts_of, vehicles_of
from .vehicle_truth import labels_of
from .vehicle_waves import Channels, Ground

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .vehicle_traffic import Burst, Vehicle

_NOISE_COUNTS = 4.0  # of the digitiser: real noise, yet most of every sample compresses away
_SNR_AT_M = 10.0
_ENGINE_SHARE = 0.3  # of a vehicle's power, where it has tones
#: Full scale over the root of the mean power at the closest approach: Gaussian noise, and twice
#: that where fading adds to it.
_HEADROOM, _FADING = 7.0, 2.0


def simulate_vehicle(options: VehicleOptions | None = None) -> Simulation:
    """Simulate vehicles on a road beside sensors, with people on foot and impacts if asked for.

    The truth: ``pass`` per vehicle and station at the moment of the closest approach, with the
    vehicle's place, its speed as value, the station's name as channel, ``forward`` or ``backward``
    along the road as label; ``waypoint`` with each vehicle's place at every whole second while it
    is within 100 m of a station; ``step`` and one ``walking`` span per walker, ``impact``.
    ``target`` says who: V1, V2 are vehicles, W1, W2 walkers. All are times of the source; waves are
    felt r / c later. The metadata record ``vehicle_mu`` holds each vehicle's energy parameter
    [(m/s)^2 m^n], ``sensor_gain`` gains that are not 1.

    Raises
    ------
    SimulationError
        Where an option is out of its range, two exclude each other, or a geometry cannot be used.
    """
    options = options or VehicleOptions()
    options.check()
    site = site_of(options)
    vehicles, bursts = vehicles_of(options, site), bursts_of(options, site)
    gains = _gains(options, site)
    signal = _signal(options, site, vehicles, bursts, gains)
    return Simulation(
        sources=[(signal.stream, "i16le", signal)],
        geometry=site,
        labels=labels_of(vehicles, bursts, site, options.length_s),
        metadata=described("vehicle", replace(options, geometry=None))
        | {"vehicle_mu": {v.name: repr(v.mu) for v in vehicles}}
        | _gains_said(options, site, gains),
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
    for place in (np.array(p) for p in places_of(site).values()):
        for vehicle in vehicles:
            time_s = vehicle.drive.times(options.length_s, 0.05)
            near = vehicle.drive.distances(time_s, place).min()
            loudest.append(headroom * float(ground.amplitude(near, vehicle.mu, 0.0)))
        for burst in bursts:
            near = np.hypot(*(place - (burst.x_m, burst.y_m)))
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
