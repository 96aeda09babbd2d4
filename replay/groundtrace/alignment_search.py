"""The search for shifts of two trains of moments: their cross-correlation over all lags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Clocks differ by no more than this [1e-6].
DRIFT_MAX_PPM = 100.0
_BIN_S = 0.01
_SMOOTH_S = 0.03
#: Drift may move a moment by this over what both recorded without being searched for [s].
_SMEAR_S = 0.04
_CANDIDATES = 40
#: Candidates nearer than this are one [s].
_ONE_S = 0.05


def coinciding(a: Array, b: Array) -> list[tuple[float, float]]:
    """Return the shifts [s] and drifts [1e-6] under which most moments coincide.

    The maxima of the cross-correlation of the two trains in bins of 10 ms, smoothed; where a drift
    would smear them, for drifts up to 100e-6 in steps that do not.

    Parameters
    ----------
    a, b
        Moments since the start of each recording, ascending, shapes (n,), (m,) [s].
    """
    shared_s = max(min(np.ptp(a), np.ptp(b)), 1.0)
    drifts = [0.0]
    if DRIFT_MAX_PPM * 1e-6 * shared_s > _SMEAR_S:
        count = int(np.ceil(DRIFT_MAX_PPM * 1e-6 * shared_s / _SMEAR_S))
        drifts = np.linspace(-DRIFT_MAX_PPM, DRIFT_MAX_PPM, 2 * count + 1).tolist()
    found = sorted((p for drift in drifts for p in _peaks(a, b, drift * 1e-6)), reverse=True)
    chosen: list[tuple[float, float]] = []
    for _, lag, gained in found:
        if len(chosen) < _CANDIDATES and all(abs(lag - other) > _ONE_S for other, _ in chosen):
            chosen.append((lag, gained * 1e6))
    return chosen


def _peaks(a: Array, b: Array, gained: float) -> list[tuple[float, float, float]]:
    """Return height, shift [s] and gain of the highest maxima of the correlation of two trains."""
    b = b * (1 - gained)
    size = int(max(np.ptp(a), np.ptp(b)) / _BIN_S) + 2
    offset_s = b[0] - a[0]
    trains = [
        np.bincount(np.rint((t - t[0]) / _BIN_S).astype(np.int64), minlength=size).astype(float)
        for t in (a, b)
    ]
    length = 1 << int(np.ceil(np.log2(2 * max(map(len, trains)))))
    spectra = [np.fft.rfft(t, length) for t in trains]
    together = np.fft.irfft(np.conj(spectra[0]) * spectra[1], length)
    together = np.fft.fftshift(together)
    half = round(3 * _SMOOTH_S / _BIN_S)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * _BIN_S / _SMOOTH_S) ** 2)
    smooth = np.convolve(together, kernel, "same")
    inner = smooth[1:-1]
    tops = np.flatnonzero((inner >= smooth[:-2]) & (inner > smooth[2:]) & (inner > 0.5)) + 1
    highest = tops[np.argsort(-smooth[tops], kind="stable")][:_CANDIDATES]
    return [
        (float(smooth[k]), (k - length // 2) * _BIN_S + offset_s, gained) for k in highest.tolist()
    ]
