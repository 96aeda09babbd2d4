"""The power of short windows by frequency: the transform as a product with a matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from .compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    Real = NDArray[np.floating[Any]]
    Indices = NDArray[np.intp]

#: Frequencies of one record, even and odd each. Chosen by judgement: more take another
#: record.
WAVES = 32
_TERMS = ("even_cosine", "odd_cosine", "even_sine", "odd_sine")


def record_of(kind: DTypeLike) -> np.dtype[np.void]:
    """Return the type of a record of waves: cosines and sines at even and at odd frequencies."""
    return np.dtype([(name, kind, (WAVES,)) for name in _TERMS])


def _arguments(kind: Any) -> Any:
    waves = numba.from_dtype(record_of(np.dtype(kind.name)))
    window = (numba.i8[:, ::1], kind[:, ::1], kind, waves[:, ::1], waves[::1])
    return numba.void(kind[:, ::1], numba.i8, numba.i8, numba.i8, *window, kind[:, :, ::1])


@compiled([_arguments(numba.f4), _arguments(numba.f8)])
def window_power(
    samples: Real,
    start: int,
    hop: int,
    window: int,
    pairs: Indices,
    weights: Real,
    share: float,
    waves: NDArray[np.void],
    sums: NDArray[np.void],
    power: Real,
) -> None:
    """Write the power of windows of each channel.

    With a, b samples at equal distances from a window's middle, c, d those at half a transform less
    that distance: cosines of even frequencies are the same at both distances and those of odd ones
    opposite, and sines the other way round. So four terms of each pair are enough::

        even cosines (a + b) + (c + d),   odd cosines (a + b) - (c + d)
        even sines   (a - b) - (c - d),   odd sines   (a - b) + (c - d)

    Parameters
    ----------
    samples
        Shape (n_channels, n).
    start, hop, window
        Where the first window begins, from one to the next, and the length of each.
    pairs
        Shape (2, n): samples of a window's first half that are folded upon each other.
    weights
        Shape (2, n): by what a and b, c and d are multiplied.
    share
        Twice what a sample has in the mean that is taken away; 0 where none is.
    waves
        Shape (blocks, n): what the terms of each pair are multiplied by.
    sums
        Shape (1,): written over.
    power
        Shape (n_channels, windows, frequencies), an even number of frequencies: gets the power.
    """
    s = sums[0]
    for channel in range(len(samples)):
        for index in range(power.shape[1]):
            first = start + index * hop
            own = samples[channel, first : first + window]
            mean = own[0] - own[0]
            if share != 0.0:
                for x in own:
                    mean += share * x
            for block in range(len(waves)):
                begin = block * 2 * WAVES
                count = min(WAVES, (power.shape[2] - begin) // 2)
                for k in range(count):
                    s.even_cosine[k] = s.odd_cosine[k] = s.even_sine[k] = s.odd_sine[k] = 0.0
                for i in range(pairs.shape[1]):
                    one, other, w = pairs[0, i], pairs[1, i], waves[block, i]
                    a, b = own[one], own[window - 1 - one]
                    c, d = own[other], own[window - 1 - other]
                    near, far = (a + b - mean) * weights[0, i], (c + d - mean) * weights[1, i]
                    even_cosine, odd_cosine = near + far, near - far
                    near, far = (a - b) * weights[0, i], (c - d) * weights[1, i]
                    even_sine, odd_sine = near - far, near + far
                    for k in range(count):
                        s.even_cosine[k] += even_cosine * w.even_cosine[k]
                        s.odd_cosine[k] += odd_cosine * w.odd_cosine[k]
                        s.even_sine[k] += even_sine * w.even_sine[k]
                        s.odd_sine[k] += odd_sine * w.odd_sine[k]
                for k in range(count):
                    even = s.even_cosine[k] ** 2 + s.even_sine[k] ** 2
                    odd = s.odd_cosine[k] ** 2 + s.odd_sine[k] ** 2
                    power[channel, index, begin + 2 * k] = even
                    power[channel, index, begin + 2 * k + 1] = odd
