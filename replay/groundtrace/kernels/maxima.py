"""Running maxima."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .compiling import compiled, inlined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@inlined
def _larger(one: Array, other: Array, out: Array) -> None:
    for i in range(len(out)):
        first, second = one[i], other[i]
        out[i] = first if first >= second or first != first else second


@compiled("f8[:, ::1](f8[:, ::1], i8)")
def window_maxima(line: Array, width: int) -> Array:
    """Return the maximum of every window of a line, shape (rows, n) to (rows, n - width + 1).

    The maximum of twice as many neighbours is that of two maxima, again and again; what overlaps
    counts twice without harm. A window with a number that is none has none.
    """
    rows, n = line.shape
    maxima = np.empty((rows, n - width + 1))
    room, more = np.empty(n), np.empty(n)
    for r in range(rows):
        some, reach = line[r], 1
        while 2 * reach < width:
            _larger(some, some[reach:], more[: n - 2 * reach + 1])
            some, room, more = more, more, room
            reach *= 2
        _larger(some, some[width - reach :], maxima[r])
    return maxima
