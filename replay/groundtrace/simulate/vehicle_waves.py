"""Waves in the ground beside a road: of vehicles and of blows, as stations feel them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..vehicles.medium import PowerLaw, loss_per_m
from .road import LASTS_S
from .vehicle_source import between, margin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .vehicle_source import Source
    from .vehicle_traffic import Burst, Vehicle

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

#: Radial over vertical movement of a Rayleigh wave at the surface.
RADIAL = 0.65
_SCATTERERS = 32  # paths that make the fading of one vehicle at one station
_FULL_S = 150.0  # before and after its pass, a vehicle begins to fade away


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """What each channel feels; stations have one place each.

    Attributes
    ----------
    places
        Of the stations, shape (n_stations, 2) [m].
    station
        Of each channel, shape (n_channels,).
    axes
        ``x``, ``y`` or ``z`` of each channel.
    """

    places: Array
    station: NDArray[np.intp]
    axes: tuple[str, ...]

    def felt(self, waves: Complex, away: Array) -> Array:
        """Return what channels feel of retrograde Rayleigh waves.

        Parameters
        ----------
        waves
            Vertical motion at each station, analytic, shape (n, n_stations).
        away
            From the source to the station, shape (n, n_stations, 2) [m].

        Returns
        -------
        Shape (n, n_channels).
        """
        felt = waves.real[:, self.station].copy()
        flat = [i for i, axis in enumerate(self.axes) if axis != "z"]
        if flat:
            unit = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
            part = np.array(["xy".index(self.axes[i]) for i in flat])
            at = self.station[flat]
            felt[:, flat] = -RADIAL * waves.imag[:, at] * unit[:, at, part]
        return felt


@dataclass(frozen=True, slots=True)
class Ground:
    """What the waves run through.

    Attributes
    ----------
    velocity_mps
        Of the waves.
    exponent, loss_spm
        n and rho of the law of power, :class:`~groundtrace.vehicles.medium.PowerLaw`.
    coherence_m
        Way over which fading changes, or None without fading.
    """

    velocity_mps: float
    exponent: float
    loss_spm: float = 0.0
    coherence_m: float | None = None

    def amplitude(self, distance_m: Array, mu: float, frequency_hz: float) -> Array:
        """Return the root of the mean power at distances of any shape."""
        law = PowerLaw(mu, self.exponent, loss_per_m(self.loss_spm, frequency_hz))
        return np.sqrt(law.power(distance_m))


class Waves:
    """The waves of one vehicle at all stations, in pieces that follow each other."""

    def __init__(self, vehicle: Vehicle, source: Source, ground: Ground, channels: Channels):
        self.vehicle, self.source, self.ground, self.channels = vehicle, source, ground, channels
        self._frames = source.frames()
        self._fading = Fading.drawn(ground, len(channels.places), vehicle.seed)

    def lasts(self, time_s: Array) -> bool:
        """Return whether the vehicle is on the road at any of the times."""
        return bool(np.abs(time_s - self.vehicle.drive.pass_s).min() < LASTS_S)

    def felt(self, time_s: Array) -> Array:
        """Return what all channels feel at evenly spaced times, shape (n, n_channels) [m/s]."""
        drive, velocity = self.vehicle.drive, self.ground.velocity_mps
        places = self.channels.places
        emitted = drive.emitted_s(time_s, places, velocity)
        away = places - drive.places(emitted)
        distance = np.hypot(away[..., 0], away[..., 1])
        parts = np.concatenate([self._noise(emitted), self._tones(emitted)], axis=-1)
        waves = np.zeros(emitted.shape, np.complex128)
        for part, frequency_hz in enumerate(self.source.frequencies_hz()):
            amplitude = self.ground.amplitude(distance, self.vehicle.mu, float(frequency_hz))
            waves += amplitude * parts[..., part]
        waves *= self._fading.gain(drive.travelled(emitted))
        waves *= _there(time_s - drive.pass_s)[:, None]
        return self.channels.felt(waves, away)

    def _noise(self, emitted_s: Array) -> Complex:
        position = emitted_s * self.source.rate_hz
        first = int(np.floor(position.min())) - margin()
        last = int(np.ceil(position.max())) + margin()
        return between(self._frames.samples(first, last - first + 1), position - first)

    def _tones(self, emitted_s: Array) -> Complex:
        tones = self.source.tones(emitted_s.ravel())
        return tones.reshape(*emitted_s.shape, tones.shape[1])


def _there(since_s: Array) -> Array:
    """Return 1 for minutes about a pass and 0 beyond: who is a long way off costs no time."""
    part = np.clip((LASTS_S - np.abs(since_s)) / (LASTS_S - _FULL_S), 0, 1)
    there: Array = part**2 * (3 - 2 * part)
    return there


@dataclass(frozen=True, slots=True, eq=False)
class Fading:
    """Multipath: a factor that wanders as the vehicle goes, another at each station.

    It is the sum of many paths whose phases turn with the way, so that a signal's envelope is
    Rayleigh's and its momentary power exponential, as the paper has it before its equation (10);
    the mean power stays. Over a way d the factor correlates with itself by exp(-d^2 / 2 D^2).

    Attributes
    ----------
    turn_radpm, phase_rad
        Of each path at each station, shape (n_stations, n_paths), or None without fading.
    """

    turn_radpm: Array | None
    phase_rad: Array | None

    @classmethod
    def drawn(cls, ground: Ground, stations: int, seed: tuple[int, ...]) -> Fading:
        """Draw the paths of one vehicle to each station."""
        if ground.coherence_m is None:
            return cls(None, None)
        rng = np.random.default_rng([*seed, 2])
        shape = (stations, _SCATTERERS)
        return cls(rng.normal(0, 1 / ground.coherence_m, shape), rng.uniform(0, 2 * np.pi, shape))

    def gain(self, way_m: Array) -> Complex:
        """Return the factors where the vehicle has gone ``way_m``, shape (n, n_stations)."""
        if self.turn_radpm is None or self.phase_rad is None:
            return np.ones(way_m.shape, np.complex128)
        paths = np.exp(1j * (self.turn_radpm * way_m[..., None] + self.phase_rad))
        gain: Complex = paths.sum(axis=-1) / np.sqrt(_SCATTERERS)
        return gain


def burst_felt(burst: Burst, time_s: Array, ground: Ground, channels: Channels) -> Array:
    """Return what all channels feel of a burst, shape (n, n_channels) [m/s]."""
    away = channels.places - (burst.x_m, burst.y_m)
    distance = np.linalg.norm(away, axis=-1)
    late = time_s[:, None] - burst.time_s - distance / ground.velocity_mps
    after = np.maximum(late, 0.0)
    peak = burst.peak_mps * ground.amplitude(distance, 1.0, burst.frequency_hz)
    swing = -1j * np.exp((2j * np.pi * burst.frequency_hz - 1 / burst.decay_s) * after)
    waves = np.where(late > 0, peak * swing, 0.0)
    return channels.felt(waves, np.broadcast_to(away, (len(time_s), *away.shape)))
