"""Filters that run on blocks of any length and give the same samples as one run over the whole.

scipy.signal is imported by what filters: who decides again, from what was stored, needs none of its
60 MB.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

#: Highest usable corner as a part of the sampling rate: a corner at Nyquist cannot be designed.
HIGHEST_CORNER = 0.45


def planar(block: SignalBlock) -> NDArray[np.float64]:
    """Return a block's values channel by channel, shape (n_channels, n_samples), contiguous."""
    scales = block.stream.scales
    return np.ascontiguousarray(block.samples.T, dtype=np.float64) * scales[:, None]


def planar_as_stored(block: SignalBlock) -> NDArray[Any]:
    """Return a block's samples channel by channel, as compiled functions take them: not scaled."""
    samples = np.ascontiguousarray(block.samples.T, block.samples.dtype.newbyteorder("="))
    return samples if samples.flags.behaved else samples.copy()


def corner(hz: float, rate_hz: float) -> float:
    """Return a corner frequency that can be designed at ``rate_hz`` [Hz]."""
    return min(hz, HIGHEST_CORNER * rate_hz)


def bandpass(low_hz: float, high_hz: float, rate_hz: float, order: int = 2) -> NDArray[np.float64]:
    """Design a Butterworth band-pass; a band edge that cannot be had is left out.

    Parameters
    ----------
    low_hz
        Lower corner [Hz]; 0 leaves it out.
    high_hz
        Upper corner [Hz]; 0, or one above 0.45 of the rate, leaves it out.
    rate_hz
        Sampling rate [Hz].
    order
        Order of each edge.

    Returns
    -------
    Second-order sections, shape (n_sections, 6); a unit section where both edges are left out.
    """
    has_high = 0 < high_hz <= HIGHEST_CORNER * rate_hz
    has_low = 0 < low_hz < HIGHEST_CORNER * rate_hz
    if has_low and has_high and low_hz < high_hz:
        edges: float | list[float] = [low_hz, high_hz]
        kind = "bandpass"
    elif has_low:
        edges, kind = low_hz, "highpass"
    elif has_high:
        edges, kind = high_hz, "lowpass"
    else:
        return np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    from scipy import signal

    sos: NDArray[np.float64] = signal.butter(order, edges, kind, fs=rate_hz, output="sos")
    return sos


def phase_delay_s(sos: NDArray[np.float64], frequency_hz: float, rate_hz: float) -> float:
    """Return by how much ``sos`` delays a sinusoid of ``frequency_hz`` [s]."""
    from scipy import signal

    _, response = signal.freqz_sos(sos, worN=[frequency_hz], fs=rate_hz)
    return float(-np.angle(response[0]) / (2 * np.pi * frequency_hz))


class StreamingFilter:
    """Second-order sections over blocks, state kept in float64.

    It starts in the steady state of the first sample, so that an offset rings no bell.

    Parameters
    ----------
    sos
        Shape (n_sections, 6).
    """

    def __init__(self, sos: NDArray[np.float64]) -> None:
        self.sos = sos
        self.zi: NDArray[np.float64] | None = None

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Filter a block, shape (n_channels, n_samples); return the same shape."""
        from scipy import signal

        if x.shape[1] == 0:
            return x
        if self.zi is None:
            steady = signal.sosfilt_zi(self.sos)
            self.zi = steady[:, None, :] * x[None, :, :1]
        y, self.zi = signal.sosfilt(self.sos, x, axis=1, zi=self.zi)
        return np.asarray(y)


class ExponentialMean:
    """Recursive mean ``m += coefficient * (x - m)`` over blocks, one per channel, from 0.

    Parameters
    ----------
    coefficient
        Forgetting factor, 0 < coefficient <= 1.
    """

    def __init__(self, coefficient: float) -> None:
        self.coefficient = coefficient
        self.zi: NDArray[np.float64] | None = None

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average a block, shape (n_channels, n_samples)."""
        from scipy import signal

        if x.shape[1] == 0:  # lfilter would lose its state
            return x
        if self.zi is None:
            self.zi = np.zeros((x.shape[0], 1))
        c = self.coefficient
        y, self.zi = signal.lfilter([c], [1.0, c - 1.0], x, axis=1, zi=self.zi)
        return np.asarray(y)


class UnbiasedMean:
    """Exponential mean divided by the sum of its weights: right from the first sample on.

    Parameters
    ----------
    memory
        Number of samples after which a weight has fallen to 1/e.
    """

    def __init__(self, memory: float) -> None:
        self._keep = float(np.exp(-1 / memory))
        self._mean = ExponentialMean(1 - self._keep)
        self._count = 0

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average a block, shape (n_channels, n_samples)."""
        index = np.arange(self._count + 1, self._count + x.shape[1] + 1)
        self._count += x.shape[1]
        return self._mean(x) / (1 - self._keep**index)


class SmoothedSlope:
    """Centred slope of a signal smoothed by a Hann window: linear phase, so no delay remains.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    smooth_s
        Full length of the smoothing window [s].
    slope_s
        Distance of the two points of the slope [s].
    """

    def __init__(self, rate_hz: float, smooth_s: float, slope_s: float) -> None:
        half = round(smooth_s * rate_hz / 2)
        window = np.hanning(2 * half + 3)[1:-1]
        reach = max(1, round(slope_s * rate_hz / 2))
        ends = np.zeros(2 * reach + 1)
        ends[0], ends[-1] = 1.0, -1.0
        self.kernel = np.convolve(window / window.sum(), ends / (2 * reach))
        self.delay = len(self.kernel) // 2
        self._zi: NDArray[np.float64] | None = None
        self._offset: NDArray[np.float64] = np.empty(0)
        self._signal: NDArray[np.float64] = np.empty((0, 0))
        self._skip = self.delay

    def __call__(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Take a signal, shape (n_channels, n).

        Returns
        -------
        Signal and slope of the samples whose slope is complete, aligned; before the run the signal
        is taken to have been constant.
        """
        from scipy import signal

        if x.shape[1] == 0:  # lfilter would lose its state
            return x, x
        if self._zi is None:
            self._offset = x[:, :1]
            self._zi = np.zeros((x.shape[0], len(self.kernel) - 1))
            self._signal = np.empty((x.shape[0], 0))
        # two denominator terms keep lfilter sample by sample: the same sums whatever the blocks
        slope, self._zi = signal.lfilter(
            self.kernel, [1.0, 0.0], x - self._offset, axis=1, zi=self._zi
        )
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        slope = slope[:, skipped:]
        x = np.concatenate([self._signal, x], axis=1)
        done = slope.shape[1]
        self._signal = x[:, done:]
        return x[:, :done], slope

    def finish(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what the last samples lack; after the run the signal is taken to be constant."""
        waiting = self._signal.shape[1]
        if not waiting:
            return self._signal, self._signal
        x, slope = self(np.repeat(self._signal[:, -1:], self.delay, axis=1))
        return x[:, :waiting], slope[:, :waiting]
