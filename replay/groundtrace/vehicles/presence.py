"""What tells a vehicle from footsteps and impacts, per window of signal.

A vehicle shakes the ground without a break: Gaussian noise of a band, whose kurtosis is that of a
normal law and whose envelope has no line. Footsteps are impulses at a cadence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..detectors.filters import StreamingFilter, bandpass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Cadence of walking [steps/s].
CADENCE_HZ = (1.4, 2.5)
#: The envelope's spectrum is looked at in this range: from half a slow cadence to a few harmonics.
_ENVELOPE_HZ = (0.9, 8.0)
#: Rate the envelope is brought down to [Hz].
_ENVELOPE_RATE_HZ = 40.0
#: Samples are levelled by their running root mean square under a Hann window of this length [s]:
#: longer than a step's interval, shorter than a vehicle takes to pass.
_LEVEL_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of windows of signal.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: end of each window.
    power
        Shape (n_channels, n): mean square in the band [unit^2].
    kurtosis
        Shape (n_channels, n): excess over a normal law's, 0 for Gaussian noise.
    impulsiveness
        Shape (n_channels, n): the same of levelled samples, so that a vehicle that comes near
        within the window has none.
    flatness
        Shape (n_channels, n): geometric over arithmetic mean of the spectrum in the band, from 0
        for a line to 1 for white noise.
    centroid_hz
        Shape (n_channels, n): mean frequency of power in the band [Hz].
    cadence
        Shape (n_channels, n): part of the envelope's fluctuation that is at one cadence of walking
        and its second harmonic, from 0 to 1.
    cadence_hz
        Shape (n_channels, n): that cadence [Hz].
    """

    time_ns: NDArray[np.int64]
    power: Array
    kurtosis: Array
    impulsiveness: Array
    flatness: Array
    centroid_hz: Array
    cadence: Array
    cadence_hz: Array


def kurtosis(samples: Array) -> Array:
    """Return the excess kurtosis of rows, shape (n_channels,) from (n_channels, n)."""
    centred = samples - samples.mean(axis=1, keepdims=True)
    square = np.mean(centred**2, axis=1)
    fourth = np.mean(centred**4, axis=1)
    ratio = np.divide(fourth, square**2, out=np.full(len(square), 3.0), where=square > 0)
    return np.asarray(ratio - 3)


def levelled(samples: Array, rate_hz: float) -> Array:
    """Return rows over their running root mean square, shape (n_channels, n)."""
    length = min(round(_LEVEL_S * rate_hz), samples.shape[1])
    window = np.hanning(length + 2)[1:-1]
    weight = np.convolve(np.ones(samples.shape[1]), window, "same")
    square = np.array([np.convolve(row, window, "same") for row in samples**2]) / weight
    found: Array = samples / np.sqrt(np.maximum(square, np.finfo(float).tiny))
    return found


def spectral_shape(
    samples: Array, rate_hz: float, band_hz: tuple[float, float]
) -> tuple[Array, Array]:
    """Return flatness and centroid [Hz] of rows in a band, shapes (n_channels,).

    Parameters
    ----------
    samples
        Shape (n_channels, n).
    rate_hz
        Sampling rate [Hz].
    band_hz
        Lower and upper edge [Hz].

    Notes
    -----
    Spectra are means over half overlapping Hann windows of a quarter of the samples (Welch), else
    the flatness of noise would be that of its periodogram, 0.56.
    """
    length = max(8, samples.shape[1] // 4)
    starts = range(0, samples.shape[1] - length + 1, length // 2)
    window = np.hanning(length + 2)[1:-1]
    parts = np.stack([samples[:, a : a + length] for a in starts]) * window
    spectrum = (np.abs(np.fft.rfft(parts, axis=2)) ** 2).mean(axis=0)
    frequency = np.fft.rfftfreq(length, 1 / rate_hz)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    power = np.maximum(spectrum[:, inside], np.finfo(float).tiny)
    flatness = np.exp(np.log(power).mean(axis=1)) / power.mean(axis=1)
    return flatness, power @ frequency[inside] / power.sum(axis=1)


def cadence(samples: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return how much of the envelope is at a cadence of walking, and that cadence [Hz].

    The envelope is the root of mean squares over 25 ms, less its line; its spectrum at a cadence
    and at twice that is compared to all from 0.9 to 8 Hz.

    Parameters
    ----------
    samples
        Shape (n_channels, n): of a band, for 3 s at least.
    rate_hz
        Sampling rate [Hz].

    Returns
    -------
    Shapes (n_channels,).
    """
    step = max(1, round(rate_hz / _ENVELOPE_RATE_HZ))
    n = samples.shape[1] // step
    cells = samples[:, : n * step].reshape(len(samples), n, step)
    envelope = np.sqrt(np.mean(cells**2, axis=2))
    time = np.arange(n) - (n - 1) / 2
    slope = envelope @ time / (time @ time)
    level = envelope - envelope.mean(axis=1, keepdims=True) - slope[:, None] * time
    window = np.hanning(n + 2)[1:-1]
    size = 8 * n
    spectrum = np.asarray(np.abs(np.fft.rfft(level * window, size, axis=1)) ** 2, np.float64)
    frequency = np.asarray(np.fft.rfftfreq(size, step / rate_hz), np.float64)
    return _line(spectrum, frequency, rate_hz / step / n)


def _line(spectrum: Array, frequency: Array, resolution_hz: float) -> tuple[Array, Array]:
    """Return the strongest line with its harmonic; a line is two resolutions wide either way."""
    low, high = _ENVELOPE_HZ
    inside = (frequency >= low) & (frequency <= high)
    total = np.maximum(spectrum[:, inside].sum(axis=1), np.finfo(float).tiny)
    cumulative = np.concatenate([np.zeros((len(spectrum), 1)), spectrum.cumsum(axis=1)], axis=1)

    def about(centres: Array) -> Array:
        ends = [centres - resolution_hz, centres + resolution_hz]
        a, b = (np.searchsorted(frequency, np.clip(e, low, high)) for e in ends)
        return np.asarray(cumulative[:, b] - cumulative[:, a])

    candidates = frequency[(frequency >= CADENCE_HZ[0]) & (frequency <= CADENCE_HZ[1])]
    parts = about(candidates) + about(2 * candidates)
    best = parts.argmax(axis=1)
    return parts[np.arange(len(parts)), best] / total, candidates[best]


class PresenceFeatures:
    """Features of windows that end with every cycle, on multiples of its length.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    channels
        Number of channels.
    cycle_s, window_s
        Lengths of a cycle and of the window that ends with it [s]; until a window is full, there
        are no features.
    low_hz, high_hz
        Band [Hz].
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        cycle_s: float = 1.0,
        window_s: float = 4.0,
        low_hz: float = 5.0,
        high_hz: float = 40.0,
    ) -> None:
        self.rate_hz, self.band_hz = rate_hz, (low_hz, high_hz)
        self.cycle_ns = round(cycle_s * NS_PER_S)
        self.window = round(window_s * rate_hz)
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=4))
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((channels, 0))

    def add(self, times: NDArray[np.int64], x: Array) -> Features:
        """Take samples, shapes (n,) and (n_channels, n); return the features they complete."""
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, self._filter(x)], axis=1)
        number = self._times // self.cycle_ns
        ends = np.flatnonzero(np.diff(number)) + 1
        full = ends[ends >= self.window]
        windows = [self._samples[:, e - self.window : e] for e in full]
        found = self._features(number[full] * self.cycle_ns, windows)
        # the next cycle ends at the next sample at the earliest: no more than a window is needed
        drop = max(0, len(self._times) - self.window)
        self._times, self._samples = self._times[drop:], self._samples[:, drop:]
        return found

    def _features(self, times: NDArray[np.int64], windows: list[Array]) -> Features:
        rows = np.empty((7, len(self._samples), len(windows)))
        for column, window in enumerate(windows):
            rows[0, :, column] = np.mean(window**2, axis=1)
            rows[1, :, column] = kurtosis(window)
            rows[2, :, column] = kurtosis(levelled(window, self.rate_hz))
            rows[3:5, :, column] = spectral_shape(window, self.rate_hz, self.band_hz)
            rows[5:7, :, column] = cadence(window, self.rate_hz)
        return Features(times, *rows)
