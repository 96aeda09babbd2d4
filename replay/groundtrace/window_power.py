"""Power of short windows by frequency: what spectrograms are made of.

Of a few tens of samples, or of a few frequencies of many, a transform is done fastest as a product
with a matrix. A window that is symmetric about its middle halves the work: the sums of the samples
at equal distances from the middle give the real part, their differences the imaginary one. Taking
the mean away is part of the matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    Real = NDArray[np.floating[Any]]

#: Windows that are transformed at once, so that the memory stays small.
BATCH = 1024


@compiled
def _fold(
    samples: NDArray[Any], start: int, hop: int, window: int, sums: Real, differences: Real
) -> None:
    """Fold windows about their middles.

    Parameters
    ----------
    samples
        Shape (n,).
    start, hop, window
        First sample of the first window, from one to the next, length of each.
    sums, differences
        Shape (windows, half a window): get sum and difference of samples as far from the middle.
    """
    half = sums.shape[1]
    for i in range(len(sums)):
        first = start + i * hop
        last = first + window - 1
        for j in range(half):
            sums[i, j] = samples[first + j]
        for j in range(half):
            differences[i, j] = samples[last - j]
        for j in range(half):  # apart, so that integers are converted many at once
            one, other = sums[i, j], differences[i, j]
            sums[i, j] = one + other
            differences[i, j] = one - other


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
        half = (self.window + 1) // 2
        share = np.ones((half, 1))
        share[self.window // 2 :] = 0.5  # the middle sample is folded upon itself
        weight = share * np.asarray(taper, np.float64)[:half, None]
        before = np.arange(half)[:, None] - (self.window - 1) / 2
        angle = 2 * np.pi / transform * before * np.arange(self.frequencies)
        real = weight * np.cos(angle)
        if mean_removed:
            real -= share * (2 * real.sum(axis=0) / self.window)
        self._real = real.astype(kind)
        self._imaginary = (weight * np.sin(angle)).astype(kind)

    def __call__(self, samples: NDArray[Any], start: int, hop: int, count: int) -> Real:
        """Return the power of windows, shape (count, frequencies).

        Parameters
        ----------
        samples
            Shape (n,), contiguous, of any type of floating point or of integers of 16 bits.
        start, hop, count
            Where the first window begins, from one to the next [samples], and how many there are.
        """
        power = np.empty((count, self.frequencies), self._real.dtype)
        for first in range(0, count, BATCH):
            part = power[first : first + BATCH]
            folded = np.empty((2, len(part), len(self._real)), self._real.dtype)
            _fold(samples, start + first * hop, hop, self.window, folded[0], folded[1])
            np.matmul(folded[0], self._real, out=part)
            np.multiply(part, part, out=part)
            imaginary = folded[1] @ self._imaginary
            part += np.multiply(imaginary, imaginary, out=imaginary)
        return power


class RunningPower:
    """Power of windows of all channels of a run, whatever the blocks.

    Parameters
    ----------
    power
        Of each window.
    hop
        From one window to the next [samples]: window k of the run begins with sample k * hop.
    """

    def __init__(self, power: WindowPower, hop: int) -> None:
        self._power = power
        self._hop = hop
        self._tail: NDArray[Any] | None = None

    def __call__(self, samples: NDArray[Any]) -> Real:
        """Take samples, shape (n_channels, n); return the windows they complete.

        Returns
        -------
        Shape (n_channels, windows, frequencies).
        """
        if self._tail is not None:
            samples = np.concatenate([self._tail, samples], axis=1)
        samples = np.ascontiguousarray(samples)
        count = max(0, (samples.shape[1] - self._power.window) // self._hop + 1)
        self._tail = samples[:, count * self._hop :].copy()
        return np.stack([self._power(channel, 0, self._hop, count) for channel in samples])
