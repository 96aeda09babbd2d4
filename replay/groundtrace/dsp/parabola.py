"""The parabola through three neighbours, by which a maximum is found between samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def highest(before: Array, at: Array, after: Array) -> Array:
    """Return where parabolas are highest, from the middle one of three neighbours [samples].

    Where they do not bend down that is the middle one. Arrays are of any shape, the same for all.
    """
    bend = before - 2 * at + after
    return np.divide(before - after, 2 * bend, out=np.zeros_like(bend), where=bend < 0)
