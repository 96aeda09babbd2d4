"""The power of short windows by frequency: the transform as a product with a matrix."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from .compiling import compiled_for, inlined, record

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    Real = NDArray[np.floating[Any]]
    Indices = NDArray[np.intp]

#: Frequencies of one record, even and odd each, and pairs of samples. Chosen by judgement: as many
#: frequencies as are counted at once; more take another record.
WAVES, PAIRS = 16, 16
#: Bytes of a line of the cache. Source: definition, of today's processors.
LINE = 64
_NAMES = ("even_cosine", "odd_cosine", "even_sine", "odd_sine")


def record_of(kind: DTypeLike, *shape: int) -> np.dtype[np.void]:
    """Return the type of a record of cosines and sines at even and at odd frequencies.

    Of shape (PAIRS, WAVES) are waves, of (PAIRS,) terms of pairs, of (WAVES,) sums over pairs.
    """
    return record(*((name, kind, shape) for name in _NAMES))


def zeros(kind: np.dtype[np.void], *shape: int) -> NDArray[np.void]:
    """Return records of zeros that begin where a line of the cache does: fewer lie across two."""
    size = math.prod(shape) * kind.itemsize
    room = np.zeros(size + LINE, np.uint8)
    start = -room.ctypes.data % LINE
    return room[start : start + size].view(kind).reshape(shape)


def _arguments(kind: np.dtype[Any]) -> Any:
    real = numba.from_dtype(kind)
    windows = numba.types.Array(real, 3, "A", readonly=True)
    shapes = ((PAIRS, WAVES), (PAIRS,), (WAVES,))
    waves, terms, sums = (numba.from_dtype(record_of(kind, *shape)) for shape in shapes)
    records = (waves[:, ::1], terms[::1], sums[::1])
    return numba.void(windows, numba.i8[:, ::1], real[:, ::1], real, *records, real[:, :, ::1])


@inlined
def _add(s: Any, t: Any, w: Any) -> None:
    """Add to sums the terms of pairs, each times its waves."""
    for i in range(PAIRS):
        for k in range(WAVES):
            even_cosine = s.even_cosine[k] + t.even_cosine[i] * w.even_cosine[i, k]
            odd_cosine = s.odd_cosine[k] + t.odd_cosine[i] * w.odd_cosine[i, k]
            even_sine = s.even_sine[k] + t.even_sine[i] * w.even_sine[i, k]
            odd_sine = s.odd_sine[k] + t.odd_sine[i] * w.odd_sine[i, k]
            # stored together at the end: sums stay in registers from pair to pair
            s.even_cosine[k], s.odd_cosine[k] = even_cosine, odd_cosine
            s.even_sine[k], s.odd_sine[k] = even_sine, odd_sine


@compiled_for(_arguments)
def window_power(
    windows: Real,
    pairs: Indices,
    weights: Real,
    share: float,
    waves: NDArray[np.void],
    terms: NDArray[np.void],
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
    windows
        Shape (n_channels, n_windows, window).
    pairs
        Shape (2, n): samples of a window's first half that are folded upon each other.
    weights
        Shape (2, n): by what a and b, c and d are multiplied.
    share
        Twice what a sample has in the mean that is taken away; 0 where none is.
    waves
        Shape (n_blocks, n_tiles): of so many frequencies and pairs.
    terms
        Shape (n_tiles,), zeros: written over.
    sums
        Shape (1,): written over.
    power
        Shape (n_channels, n_windows, 2 * WAVES * n_blocks): gets the power.
    """
    s, last = sums[0], windows.shape[2] - 1
    for channel in range(power.shape[0]):
        for index in range(power.shape[1]):
            mean = share - share
            if share != 0.0:
                for k in range(windows.shape[2]):
                    mean += share * windows[channel, index, k]
            for tile in range(len(terms)):
                t, begin = terms[tile], tile * PAIRS
                for k in range(min(PAIRS, pairs.shape[1] - begin)):
                    one, other = pairs[0, begin + k], pairs[1, begin + k]
                    a, b = windows[channel, index, one], windows[channel, index, last - one]
                    c, d = windows[channel, index, other], windows[channel, index, last - other]
                    weight, weight_far = weights[0, begin + k], weights[1, begin + k]
                    near, far = (a + b - mean) * weight, (c + d - mean) * weight_far
                    t.even_cosine[k], t.odd_cosine[k] = near + far, near - far
                    near, far = (a - b) * weight, (c - d) * weight_far
                    t.even_sine[k], t.odd_sine[k] = near - far, near + far
            for block in range(len(waves)):
                for k in range(WAVES):
                    s.even_cosine[k] = s.odd_cosine[k] = s.even_sine[k] = s.odd_sine[k] = 0.0
                for tile in range(len(terms)):
                    _add(s, terms[tile], waves[block, tile])
                begin = 2 * WAVES * block
                for k in range(WAVES):
                    even = s.even_cosine[k] ** 2 + s.even_sine[k] ** 2
                    odd = s.odd_cosine[k] ** 2 + s.odd_sine[k] ** 2
                    power[channel, index, begin + 2 * k] = even
                    power[channel, index, begin + 2 * k + 1] = odd
