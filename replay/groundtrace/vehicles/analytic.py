"""The analytic signal of a band, block by block: its modulus is the envelope."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from ..detectors.filters import corner

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Length of a window-designed filter times its transition's width over the rate (Hamming window).
_HAMMING = 3.3
#: The transition's width, as a part of the lower edge and of the band: what lies at negative
#: frequencies, twice the lower edge away, is then gone.
_TRANSITION = 0.5


class AnalyticBand:
    """A complex band-pass of linear phase: it lets the positive frequencies of a band through.

    The power of a signal in the band is half the mean square of its analytic signal. Samples whose
    surroundings are not complete, at both ends of a run, are left out.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    low_hz, high_hz
        The band [Hz], above 0; the upper edge comes down to what the rate allows.
    """

    def __init__(self, rate_hz: float, low_hz: float, high_hz: float) -> None:
        high = corner(high_hz, rate_hz)
        width = high - low_hz
        transition = _TRANSITION * min(low_hz, width)
        half = int(np.ceil(_HAMMING * rate_hz / transition / 2))
        base = signal.firwin(2 * half + 1, width / 2, fs=rate_hz)
        turn = 2j * np.pi * (low_hz + width / 2) / rate_hz * np.arange(-half, half + 1)
        self.kernel: NDArray[np.complex128] = 2 * base * np.exp(turn)
        self.delay = half
        self._zi: NDArray[np.complex128] | None = None
        self._times: NDArray[np.int64] = np.empty(0, np.int64)
        self._skip = 2 * half

    def __call__(
        self, times: NDArray[np.int64], x: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
        """Take times (n,) and signals (n_channels, n) [unit]; offsets need not be taken off.

        Returns
        -------
        Times and analytic signals of the samples that are complete, shapes (m,) and
        (n_channels, m).
        """
        if x.shape[1] == 0:  # lfilter would lose its state
            return times, x.astype(np.complex128)
        if self._zi is None:
            self._zi = np.zeros((x.shape[0], len(self.kernel) - 1), np.complex128)
        # two denominator terms keep lfilter sample by sample: the same sums whatever the blocks
        y, self._zi = signal.lfilter(self.kernel, [1.0, 0.0], x, axis=1, zi=self._zi)
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        y = np.asarray(y[:, skipped:])
        self._times = np.concatenate([self._times, times])
        done = slice(self.delay, self.delay + y.shape[1])
        found = self._times[done]
        self._times = self._times[y.shape[1] :]
        return found, y


def power(analytic: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the instantaneous power, half the squared envelope, any shape [unit^2]."""
    return np.asarray(0.5 * (analytic.real**2 + analytic.imag**2))
