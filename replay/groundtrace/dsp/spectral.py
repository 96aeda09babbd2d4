"""Power of short windows by frequency, for spectrograms.

A transform of a few tens of samples, or to a few frequencies, is fastest as a product with a
matrix. A window that is symmetric about its middle halves the work: the sums of the samples at
equal distances from the middle give the real part, their differences the imaginary one. So does the
transform: at distances that add up to half its length, cosines are the same in even frequencies and
opposite in odd ones, sines the other way round.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .. import kernels

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    Real = NDArray[np.floating[Any]]


def _folds(
    taper: NDArray[np.float64], transform: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return samples folded upon each other, and what they count, each of shape (2, n).

    Where there is none at half a transform less a sample's distance from the middle, the sample
    stands for it and counts nothing.
    """
    window, half = len(taper), (len(taper) + 1) // 2
    weight = np.array(taper[:half], np.float64)
    weight[window // 2 :] *= 0.5  # the middle sample is folded upon itself
    one = np.arange(half)
    other = window - 1 - transform // 2 - one if transform % 2 == 0 else np.full(half, -1)
    one, other = one[one >= other], other[one >= other]
    alone = other < 0
    other[alone] = one[alone]
    weights = np.stack([weight[one], np.where(alone, 0.0, weight[other])])
    weights[:, (one == other) & ~alone] *= 0.5
    return np.stack([one, other]), weights


class WindowPower:
    """Power of windows of a signal at the lowest frequencies of a transform.

    Parameters
    ----------
    taper
        Shape (window,): weights of a window's samples, the same from both ends.
    transform
        Length of the transform, zeros after the window's samples [samples]; at least the window.
    frequencies
        How many, from 0 on; None takes all.
    mean_removed
        Whether each window's mean is taken away first.
    kind
        What is computed with, float64 or float32.
    """

    def __init__(
        self,
        taper: NDArray[np.float64],
        transform: int,
        frequencies: int | None = None,
        *,
        mean_removed: bool = False,
        kind: DTypeLike = np.float64,
    ) -> None:
        self.window = len(taper)
        self.frequencies = transform // 2 + 1 if frequencies is None else frequencies
        self._pairs, weights = _folds(taper, transform)
        self._weights = weights.astype(kind)
        self._share = self._weights.dtype.type(2.0 / self.window if mean_removed else 0.0)
        before = (self.window - 1) / 2 - self._pairs[0]
        spectra = kernels.spectra
        blocks = -(-self.frequencies // (2 * spectra.WAVES))
        tiles = -(-len(before) // spectra.PAIRS)
        self._waves = spectra.zeros(
            spectra.record_of(kind, spectra.PAIRS, spectra.WAVES), blocks, tiles
        )
        self._terms = spectra.zeros(spectra.record_of(kind, spectra.PAIRS), tiles)
        self._sums = spectra.zeros(spectra.record_of(kind, spectra.WAVES), 1)
        frequency = np.arange(blocks * 2 * spectra.WAVES).reshape(blocks, 1, -1, 2)
        angle = 2 * np.pi / transform * before[:, None, None] * frequency
        waves = [part[..., odd] for part in (np.cos(angle), np.sin(angle)) for odd in range(2)]
        for name, values in zip(self._waves.dtype.names or (), waves, strict=True):
            for i in range(len(before)):
                tile, pair = divmod(i, spectra.PAIRS)
                self._waves[name][:, tile, pair] = values[:, i]

    def __call__(
        self,
        samples: NDArray[Any],
        start: int,
        hop: int,
        count: int,
        before: NDArray[Any] | None = None,
    ) -> Real:
        """Return the power of windows, shape (..., count, frequencies).

        Parameters
        ----------
        samples
            Shape (n,) or (n_channels, n), of any type of integers or of floating point.
        start, hop, count
            Where the first window begins, from one to the next [samples], and how many there are.
        before
            Samples that these follow: there ``start`` may lie, less than 0.
        """
        rows, kind = np.atleast_2d(samples), self._weights.dtype
        if before is not None and start < 0:
            earlier = before.shape[1]
            joined = np.empty((len(rows), earlier + rows.shape[1]), kind)
            joined[:, :earlier], joined[:, earlier:] = before, rows
            rows, start = joined, start + earlier
        rows = np.ascontiguousarray(rows, kind)
        room = 2 * kernels.spectra.WAVES * len(self._waves)
        power = np.empty((len(rows), count, room), self._weights.dtype)
        if count > 0:
            windows = sliding_window_view(rows[:, start:], self.window, axis=1)[:, ::hop]
            fold = (self._pairs, self._weights, self._share)
            kernels.spectra.window_power(kind)(
                windows[:, :count], *fold, self._waves, self._terms, self._sums, power
            )
        return power.reshape(*samples.shape[:-1], *power.shape[1:])[..., : self.frequencies]
