"""The samples of a room: waves of every strike at every channel, noise, and the digitiser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, SignalBlock, Stream

from .plate import Plate, Synthesis
from .simulation import START_NS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .walkers import Strike
    from .walls import Walls

    Array = NDArray[np.float64]
    Spectra = NDArray[np.complex128]

_HUM = ((50.0, 0.25), (11.0, 0.5))  # frequency [Hz] and amplitude over the noise's deviation
#: Horizontal over vertical movement at 200 Hz, in the middle of a footstep's band; a Rayleigh wave
#: has about as much at any frequency. In a plate it grows with the wave number.
_RADIAL, _RADIAL_HZ = 0.6, 200.0
_LEAD = 16  # samples: a waveform is band-limited and rings before its onset


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """What each channel feels.

    Attributes
    ----------
    stations
        Places, shape (n_stations, 2) [m].
    station
        Of each channel, shape (n_channels,).
    axes
        ``x``, ``y`` or ``z`` of each channel.
    offset_s
        How late each is stamped, shape (n_channels,) [s].
    """

    stations: Array
    station: NDArray[np.intp]
    axes: tuple[str, ...]
    offset_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class Wavefield:
    """Waves in the floor, as the channels feel them.

    Attributes
    ----------
    synthesis
        Of the waveforms.
    channels
        Who feels them.
    walls
        What sends them back.
    mounting
        Velocity of each station's sensor over the floor's, shape (n_stations, n_frequencies), or
        None where all are fixed firmly.
    """

    synthesis: Synthesis
    channels: Channels
    walls: Walls
    mounting: Spectra | None = None

    def lead(self, strike: Strike) -> int:
        """Return the sample at which the waveforms of ``strike`` start."""
        rate = self.synthesis.rate_hz
        early = int(np.ceil(max(0.0, -float(self.channels.offset_s.min())) * rate))
        return int(strike.time_ns * rate // NS_PER_S) - _LEAD - early

    def waves(self, strike: Strike) -> Array:
        """Return what all channels feel of ``strike``, shape (n_samples, n_channels) [m/s]."""
        synthesis, frequency = self.synthesis, self.synthesis.frequency_hz
        delay_s = strike.time_ns / NS_PER_S - self.lead(strike) / synthesis.rate_hz
        force = strike.footfall.spectrum(frequency) * synthesis.sensor()
        force *= np.exp(-2j * np.pi * delay_s * frequency)
        transfer = self._transfer(np.array([strike.x_m, strike.y_m]))
        if self.channels.offset_s.any():
            transfer *= np.exp(-2j * np.pi * np.multiply.outer(self.channels.offset_s, frequency))
        return synthesis.inverse(transfer, force).T

    def _transfer(self, source: Array) -> Spectra:
        """Return velocity over force, all images together, shape (n_channels, n_frequencies)."""
        channels, frequency = self.channels, self.synthesis.frequency_hz
        images = self.walls.images(source, channels.stations)
        total = np.zeros((len(channels.axes), len(frequency)), np.complex128)
        columns = {axis: [i for i, a in enumerate(channels.axes) if a == axis] for axis in "xyz"}
        for place, gains in zip(images.places, images.gains, strict=True):
            away = channels.stations - place
            distance = np.hypot(*away.T)
            vertical = self._mounted(self.synthesis.plate.response(distance, frequency), gains)
            total[columns["z"]] += vertical[channels.station[columns["z"]]]
            if columns["x"] or columns["y"]:
                radial = self.synthesis.plate.radial(distance, frequency, self._lever_m)
                radial = self._mounted(radial, gains)
                direction = away / np.maximum(distance, 1e-9)[:, None]
                for part, axis in enumerate("xy"):
                    at = channels.station[columns[axis]]
                    total[columns[axis]] += direction[at, part, None] * radial[at]
        return total

    def _mounted(self, spectra: Spectra, gains: Array) -> Spectra:
        spectra *= gains[:, None]
        if self.mounting is not None:
            spectra *= self.mounting
        return spectra

    @property
    def _lever_m(self) -> float:
        return float(
            _RADIAL / np.sqrt(2 * np.pi * _RADIAL_HZ / self.synthesis.plate.dispersion_m2s)
        )


def synthesis_of(plate: Plate, rate_hz: float, reach_m: float, spread_s: float) -> Synthesis:
    """Return the synthesis of waveforms long enough for waves that run ``reach_m``.

    Parameters
    ----------
    plate
        The floor.
    rate_hz
        Sampling rate.
    reach_m
        Of the farthest image [m].
    spread_s
        Between the earliest and the latest clock [s].
    """
    slowest_mps = 2 * np.sqrt(plate.dispersion_m2s * 2 * np.pi * 20.0)  # group velocity at 20 Hz
    return Synthesis.lasting(plate, rate_hz, max(0.4, 0.3 + reach_m / slowest_mps) + spread_s)


@dataclass(frozen=True, slots=True, eq=False)
class RoomSignal:
    """The samples of a room, generated a second at a time; iterating again gives the same.

    Attributes
    ----------
    stream
        Its channels' scales are counts of a digitiser.
    seed
        Of the noise.
    duration_s
        Length [s].
    strikes
        In order of time.
    field
        The waves.
    sigma_mps
        Mean standard deviation of the noise [m/s]; each channel has 0.8 to 1.2 of it.
    dead
        Channels that give 0, shape (n_channels,).
    """

    stream: Stream
    seed: int
    duration_s: float
    strikes: Sequence[Strike]
    field: Wavefield
    sigma_mps: float
    dead: NDArray[np.bool_]

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.stream.rate_hz
        total, size = round(self.duration_s * rate), round(rate)
        length = self.field.synthesis.samples
        noise = self._noise()
        pending = np.zeros((size + length, len(self.stream.channels)))
        coming = list(self.strikes)
        for first in range(0, total, size):
            while coming and self.field.lead(coming[0]) < first + size:
                pending_from = self.field.lead(coming[0]) - first
                pending[pending_from : pending_from + length] += self.field.waves(coming.pop(0))
            count = min(size, total - first)
            counts = (pending[:count] + next(noise)[:count]) / self.stream.scales
            samples = np.clip(np.rint(counts), -32768, 32767).astype(np.int16)
            samples[:, self.dead] = 0
            yield SignalBlock(self.stream, START_NS, first, samples)
            pending[:length] = pending[size:].copy()
            pending[length:] = 0.0

    def _noise(self) -> Iterator[Array]:
        """Give a second of white noise and hum at a time, shape (n_samples, n_channels) [m/s]."""
        rng = np.random.default_rng([self.seed, 2])
        n_channels, size = len(self.stream.channels), round(self.stream.rate_hz)
        level = self.sigma_mps * rng.uniform(0.8, 1.2, n_channels)
        phase = rng.uniform(0, 2 * np.pi, (len(_HUM), n_channels))
        first = 0
        while True:
            time_s = (first + np.arange(size)) / self.stream.rate_hz
            noise = rng.standard_normal((size, n_channels))
            for (hum_hz, amplitude), angle in zip(_HUM, phase, strict=True):
                turn = 2 * np.pi * hum_hz * time_s
                noise += amplitude * (
                    np.outer(np.sin(turn), np.cos(angle)) + np.outer(np.cos(turn), np.sin(angle))
                )
            yield noise * level
            first += size
