"""The samples of sensors beside a road: vehicles, walkers, wind, noise, the digitiser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SignalBlock, Stream

from ..vehicles.medium import Geophone
from .simulation import START_NS
from .vehicle_source import BEFORE, Frames, band
from .vehicle_waves import Waves, burst_felt

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from .vehicle_source import Source
    from .vehicle_traffic import Burst, Vehicle
    from .vehicle_waves import Channels, Ground

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

_LASTS = 12.0  # times its decay that a burst is computed for
_WIND_HZ = (0.5, 8.0)
_GUST = 0.5  # standard deviation of the logarithm of the wind's level


@dataclass(frozen=True, slots=True, eq=False)
class RoadSignal:
    """The samples beside a road, generated a second at a time; iterating again gives the same.

    Attributes
    ----------
    stream
        Its channels' scales are counts of a digitiser.
    seed
        Of noise and wind.
    duration_s
        Length [s].
    vehicles, sources
        Who drives by, and the noise of each.
    bursts
        In order of time.
    ground, channels
        What the waves run through, and who feels them.
    sigma_mps, wind_mps
        Standard deviations of noise (each channel has 0.8 to 1.2 of it) and of wind [m/s].
    gains
        Of each channel, shape (n_channels,).
    geophone_hz
        Natural frequency of the sensors, or None.
    """

    stream: Stream
    seed: int
    duration_s: float
    vehicles: Sequence[Vehicle]
    sources: Sequence[Source]
    bursts: Sequence[Burst]
    ground: Ground
    channels: Channels
    sigma_mps: float
    wind_mps: float
    gains: Array
    geophone_hz: float | None

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.stream.rate_hz
        total, size = round(self.duration_s * rate), round(rate)
        pairs = zip(self.vehicles, self.sources, strict=True)
        waves = [Waves(v, source, self.ground, self.channels) for v, source in pairs]
        noise, wind, sense = self._noise(), self._wind(), self._sensing()
        for first in range(0, total, size):
            time_s = (first + np.arange(size)) / rate
            moved = wind.samples(first, size).real.copy()
            for one in waves:
                if one.lasts(time_s):
                    moved += one.felt(time_s)
            for burst in self._heard(time_s):
                moved += burst_felt(burst, time_s, self.ground, self.channels)
            measured = (sense(moved) + next(noise)) * self.gains
            counts = np.rint(measured[: total - first] / self.stream.scales)
            samples = np.clip(counts, -32768, 32767).astype(np.int16)
            yield SignalBlock(self.stream, START_NS, first, samples)

    def _heard(self, time_s: Array) -> list[Burst]:
        """Return the bursts that any station may feel in a block."""
        places = self.channels.places
        heard = []
        for burst in self.bursts:
            farthest_m = np.hypot(*(places - (burst.x_m, burst.y_m)).T).max()
            over_s = burst.time_s + farthest_m / self.ground.velocity_mps + _LASTS * burst.decay_s
            if burst.time_s <= time_s[-1] and over_s >= time_s[0]:
                heard.append(burst)
        return heard

    def _noise(self) -> Iterator[Array]:
        """Give a second of white noise at a time, shape (n_samples, n_channels) [m/s]."""
        rng = np.random.default_rng([self.seed, 3])
        n_channels, size = len(self.stream.channels), round(self.stream.rate_hz)
        level = self.sigma_mps * rng.uniform(0.8, 1.2, n_channels)
        while True:
            yield rng.standard_normal((size, n_channels)) * level

    def _wind(self) -> Frames:
        """Return wind, one column a channel; its real part moves the sensors [m/s].

        Its density of power falls with frequency, and its gusts are those of all channels.
        """
        rate, n_channels = self.stream.rate_hz, len(self.stream.channels)
        count = 2 * round(rate)
        f = np.arange(count // 2) * rate / count
        density = band(f, *_WIND_HZ) / np.maximum(f, _WIND_HZ[0])
        line = self.wind_mps * np.sqrt(density / density.sum())

        def draw(number: int) -> Complex:
            rng = np.random.default_rng([self.seed, 4, number + BEFORE])
            gust = np.exp(_GUST * rng.standard_normal() - _GUST**2)
            drawn = rng.standard_normal((2, len(f), n_channels))
            spectrum = gust * line[:, None] * (drawn[0] + 1j * drawn[1])
            frame: Complex = np.fft.ifft(spectrum, count, axis=0) * count
            return frame

        return Frames(round(rate), draw)

    def _sensing(self) -> Callable[[Array], Array]:
        """Return what makes the sensors' signal of the ground's velocity, piece after piece.

        A bilinear transform of the geophone's high-pass, exact at its natural frequency.
        """
        if self.geophone_hz is None:
            return lambda moved: moved
        from scipy.signal import lfilter

        numerator, denominator = sampled(Geophone(self.geophone_hz), self.stream.rate_hz)
        state = np.zeros((2, len(self.stream.channels)))

        def sense(moved: Array) -> Array:
            nonlocal state
            sensed, state = lfilter(numerator, denominator, moved, axis=0, zi=state)
            velocity: Array = sensed
            return velocity

        return sense


def sampled(geophone: Geophone, rate_hz: float) -> tuple[Array, Array]:
    """Return the filter of samples that a high-pass geophone is, numerator and denominator."""
    warped = np.tan(np.pi * geophone.natural_hz / rate_hz)
    damped = 2 * geophone.damping * warped
    numerator = np.array([1.0, -2.0, 1.0])
    denominator = np.array(
        [1 + damped + warped**2, 2 * warped**2 - 2, 1 - damped + warped**2], np.float64
    )
    return numerator / denominator[0], denominator / denominator[0]
