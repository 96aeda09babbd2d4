"""Recursive filters, weighted means and exponential means over blocks.

What crosses blocks is ``memory``, in the transposed direct form II that scipy's ``sosfilt`` and
``lfilter`` keep, and the sums are theirs, bit by bit. But scipy.signal imports most of SciPy, which
takes most of a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .compiling import compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled("void(f8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1])")
def sections(x: Array, sos: Array, memory: Array, y: Array) -> None:
    """Filter by second-order sections, one after the other.

    Each is::

        y = b0 x + p1,   p1 = b1 x - a1 y + p2,   p2 = b2 x - a2 y

    Parameters
    ----------
    x, y
        Shape (n_channels, n): signal, and where it goes filtered.
    sos
        Shape (n_sections, 6).
    memory
        Shape (n_sections, n_channels, 2): p1 and p2.
    """
    for channel in range(len(x)):
        into = y[channel]
        into[:] = x[channel]
        for s in range(len(sos)):
            b0, b1, b2, a1, a2 = sos[s, 0], sos[s, 1], sos[s, 2], sos[s, 4], sos[s, 5]
            p1, p2 = memory[s, channel, 0], memory[s, channel, 1]
            for i in range(len(into)):
                given = into[i]
                filtered = b0 * given + p1
                p1 = b1 * given - a1 * filtered + p2
                p2 = b2 * given - a2 * filtered
                into[i] = filtered
            memory[s, channel, 0], memory[s, channel, 1] = p1, p2


@compiled("void(f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])")
def weighted(x: Array, weights: Array, memory: Array, y: Array) -> None:
    """Return sums of the last samples, the newest by the first weight.

    Parameters
    ----------
    x, y
        Shape (n_channels, n): signal, and where the sums go.
    weights
        Shape (k,).
    memory
        Shape (n_channels, k): what samples before add to the next sums; the last is always 0.
    """
    last = len(weights) - 1
    for channel in range(len(x)):
        p = memory[channel]
        for i in range(x.shape[1]):
            given = x[channel, i]
            y[channel, i] = p[0] + weights[0] * given
            for k in range(last):
                p[k] = p[k + 1] + given * weights[k + 1]


@compiled("void(f8[:, ::1], f8, f8[::1], f8[:, ::1])")
def recursive_means(x: Array, coefficient: float, memory: Array, y: Array) -> None:
    """Return m, of ``m += coefficient * (x - m)``.

    Parameters
    ----------
    x, y
        Shape (n_channels, n): signal, and where the means go.
    coefficient
        Forgetting factor.
    memory
        Shape (n_channels,): what is left of each mean.
    """
    keep = 1.0 - coefficient
    for channel in range(len(x)):
        left = memory[channel]
        for i in range(x.shape[1]):
            mean = left + coefficient * x[channel, i]
            y[channel, i] = mean
            left = mean * keep
        memory[channel] = left
