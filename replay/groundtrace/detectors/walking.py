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

    def __call__(self, block: SignalBlock) -> NDArray[np.float64]:
        """Return the signal of a block [m/s2], shape (1, n_samples)."""
        values = planar(block)
        norm = np.sqrt(np.einsum("cn,cn->n", values, values))
        return self._filter(norm[None, :])
