"""Power of short windows by frequency: what spectrograms are made of.

Of a few tens of samples, or of a few frequencies of many, a transform is done fastest as a product
with a matrix. A window that is symmetric about its middle halves the work: the sums of the samples
at equal distances from the middle give the real part, their differences the imaginary one. So does
the transform: at distances that add up to half its length, cosines are the same in even frequencies
and opposite in odd ones, sines the other way round. As many windows are done at once as a row has
lanes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .compiled import compiled
from .lanes import LANES, LANES_32, every, put_row, row, row_from
from .tiles import TILE, turn

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    Real = NDArray[np.floating[Any]]


@compiled
def _put_side_by_side(samples: NDArray[Any], first: int, hop: int, turned: Real) -> None:
    """Put runs of samples, a hop apart, into columns.

    Parameters
    ----------
    samples
        Shape (n,).
    first, hop
        Where the first run begins, and from one to the next.
    turned
        Shape (length, runs), no less than TILE of each.
    """
    length, runs = turned.shape
    for begin in range(0, runs, TILE):
        run = min(begin, runs - TILE)
        for j in range(0, length, TILE):
            turn(samples, first + run * hop + j, hop, turned, j * runs + run, runs)


@compiled
def _fold(
    turned: Real,
    window: int,
    hop: int,
    pairs: NDArray[np.int64],
    weights: Real,
    share: Real,
    folded: Real,
) -> None:
    """Fold the windows of all lanes about their middle, and about a quarter of the transform.

    Parameters
    ----------
    turned
        Shape (length, runs): sample ``j`` of the first window is in row ``j % hop`` of run
        ``j // hop``, those of the other windows in the runs after it.
    window, hop
        Length of a window, and from one to the next.
    pairs, weights
        Shape (2, n): samples of a window's first half that are folded upon each other, and by what
        they, and those of the second half, are multiplied.
    share
        Shape (1,): what a sample has in twice the mean that is taken away; nothing where none is.
    folded
        Shape (4, n, lanes): gets the terms of even and odd cosines, and of even and odd sines.
    """
    runs, last = turned.shape[1], window - 1
    level = every(share[0]) * row_from(turned, 0)
    for j in range(1, window if share[0] else 0):
        level = level + every(share[0]) * row_from(turned, j % hop * runs + j // hop)
    for i in range(pairs.shape[1]):
        j, k = pairs[0, i], pairs[1, i]
        a = row_from(turned, j % hop * runs + j // hop)
        b = row_from(turned, (last - j) % hop * runs + (last - j) // hop)
        c = row_from(turned, k % hop * runs + k // hop)
        d = row_from(turned, (last - k) % hop * runs + (last - k) // hop)
        weight, other = every(weights[0, i]), every(weights[1, i])
        near, far = (a + b - level) * weight, (c + d - level) * other
        put_row(folded[0], i, near + far)
        put_row(folded[1], i, near - far)
        near, far = (a - b) * weight, (c - d) * other
        put_row(folded[2], i, near - far)
        put_row(folded[3], i, near + far)


@compiled
def _multiply(folded: Real, cosines: Real, sines: Real, power: Real) -> None:
    """Write the power of the windows of all lanes, shape (frequencies, lanes).

    Parameters
    ----------
    folded
        Shape (4, n, lanes).
    cosines, sines
        Shape (frequencies, n); frequencies are a multiple of 4.
    """
    for k in range(len(cosines)):
        if k & 2:  # with that two before, of the same terms
            continue
        terms, others = folded[k & 1], folded[2 + (k & 1)]
        real, real_2 = (
            every(cosines[k, 0]) * row(terms, 0),
            every(cosines[k + 2, 0]) * row(terms, 0),
        )
        imaginary = every(sines[k, 0]) * row(others, 0)
        imaginary_2 = every(sines[k + 2, 0]) * row(others, 0)
        for i in range(1, cosines.shape[1]):
            term, other = row(terms, i), row(others, i)
            real = real + every(cosines[k, i]) * term
            real_2 = real_2 + every(cosines[k + 2, i]) * term
            imaginary = imaginary + every(sines[k, i]) * other
            imaginary_2 = imaginary_2 + every(sines[k + 2, i]) * other
        put_row(power, k, real * real + imaginary * imaginary)
        put_row(power, k + 2, real_2 * real_2 + imaginary_2 * imaginary_2)


@compiled
def _put_power(
    samples: NDArray[Any],
    start: int,
    window: int,
    hop: int,
    pairs: NDArray[np.int64],
    weights: Real,
    share: Real,
    cosines: Real,
    sines: Real,
    power: Real,
) -> None:
    """Write the power of windows of each channel.

    Parameters
    ----------
    samples
        Shape (n_channels, n).
    start, window, hop
        Where the first window begins, length of each, and from one to the next.
    pairs, weights, share, cosines, sines
        Of a window.
    power
        Shape (n_channels, windows, frequencies): multiples of the lanes and of TILE. Windows that
        end behind the samples are of no meaning.
    """
    frequencies, n = cosines.shape
    lanes = LANES if cosines.itemsize == 8 else LANES_32
    length, runs = -(-min(hop, window) // TILE) * TILE, lanes + (window - 1) // hop
    turned = np.empty((length, runs), cosines.dtype)
    folded = np.empty((4, n, lanes), cosines.dtype)
    found = np.empty((frequencies, lanes), cosines.dtype)
    rest = np.zeros((runs - 1) * hop + length, samples.dtype)
    for channel in range(len(samples)):
        own = samples[channel]
        for first in range(0, power.shape[1], lanes):
            begin = start + first * hop
            if begin + len(rest) <= len(own):
                _put_side_by_side(own, begin, hop, turned)
            else:
                rest[: len(own) - begin] = own[begin:]
                _put_side_by_side(rest, 0, hop, turned)
            _fold(turned, window, hop, pairs, weights, share, folded)
            _multiply(folded, cosines, sines, found)
            for lane in range(0, lanes, TILE):
                for k in range(0, frequencies, TILE):
                    place = (first + lane) * frequencies + k
                    turn(found, k * lanes + lane, lanes, power[channel], place, frequencies)


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
        self._share = np.array([2.0 / self.window if mean_removed else 0.0], kind)
        before = (self.window - 1) / 2 - self._pairs[0]
        padded = -(-self.frequencies // TILE) * TILE
        angle = 2 * np.pi / transform * before * np.arange(padded)[:, None]
        self._cosines, self._sines = np.cos(angle).astype(kind), np.sin(angle).astype(kind)

    def __call__(self, samples: NDArray[Any], start: int, hop: int, count: int) -> Real:
        """Return the power of windows, shape (..., count, frequencies).

        Parameters
        ----------
        samples
            Shape (n,) or (n_channels, n), of any type of integers or of floating point.
        start, hop, count
            Where the first window begins, from one to the next [samples], and how many there are.
        """
        rows = np.ascontiguousarray(np.atleast_2d(samples))
        lanes = LANES if self._cosines.itemsize == 8 else LANES_32
        shape = (len(rows), -(-count // lanes) * lanes, len(self._cosines))
        power = np.empty(shape, self._cosines.dtype)
        window = (self._pairs, self._weights, self._share, self._cosines, self._sines)
        _put_power(rows, start, self.window, hop, *window, power)
        return power.reshape(*samples.shape[:-1], *shape[1:])[..., :count, : self.frequencies]


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
        count = max(0, (samples.shape[1] - self._power.window) // self._hop + 1)
        self._tail = samples[:, count * self._hop :].copy()
        return self._power(samples, 0, self._hop, count)
