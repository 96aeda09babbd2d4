"""The signal that step detectors on the body share: smoothed norm of the acceleration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from groundtrace_codecs.signals import NS_PER_S

from .filters import StreamingFilter, corner, phase_delay_s, planar

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

#: Corners that leave every step as it was recorded [Hz]: the low-pass as high as the rate allows,
#: the high-pass so low that it takes out gravity alone, of which 20 s of it leave 0.2 %.
OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ = 1e9, 0.05
#: Step frequency at which the filter's delay is taken out of the times [Hz].
NOMINAL_CADENCE_HZ = 1.8


class WalkingSignal:
    """Norm of the acceleration without gravity, low-passed, with the delay known.

    A Bessel low-pass keeps the delay the same for all step frequencies; a first-order high-pass
    takes gravity away. Both are derived from the rate, so that 6 Hz recordings work too.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    cutoff_hz
        Corner of the low-pass [Hz]; lowered where the rate does not allow it.
    gravity_hz
        Corner of the high-pass [Hz].
    """

    def __init__(self, rate_hz: float, cutoff_hz: float, gravity_hz: float) -> None:
        low = signal.bessel(
            2, corner(cutoff_hz, rate_hz), "low", fs=rate_hz, output="sos", norm="mag"
        )
        high = signal.butter(1, corner(gravity_hz, rate_hz), "high", fs=rate_hz, output="sos")
        sos = np.concatenate([low, high])
        self._filter = StreamingFilter(sos)
        self.delay_ns = round(phase_delay_s(sos, NOMINAL_CADENCE_HZ, rate_hz) * NS_PER_S)

    def __call__(self, block: SignalBlock) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the norm and the filtered signal of a block [m/s2], shape (1, n_samples) each."""
        values = planar(block)
        norm = np.sqrt(np.einsum("cn,cn->n", values, values))
        return norm[None, :], self._filter(norm[None, :])


class Activity:
    """Level of the walking signal in the time around a sample, which tells walking from rest.

    Parameters
    ----------
    reach
        Samples before and after that count; fewer at the ends of a run.
    """

    def __init__(self, reach: int) -> None:
        self.reach = reach
        self.first = 0  # index in the run of the first value kept
        self._power = np.empty(0)

    @property
    def end(self) -> int:
        """Index in the run just after the last value taken."""
        return self.first + len(self._power)

    def add(self, values: NDArray[np.float64]) -> None:
        """Take the next values."""
        self._power = np.concatenate([self._power, values * values])

    def around(self, index: int) -> float:
        """Return the level around a sample of the run; its reach must have been taken."""
        low = max(index - self.reach - self.first, 0)
        return float(np.sqrt(self._power[low : index + self.reach + 1 - self.first].mean()))

    def forget_before(self, index: int) -> None:
        """Drop what no sample from ``index`` on reaches back to."""
        cut = max(0, index - self.reach - self.first)
        self._power = self._power[cut:]
        self.first += cut
