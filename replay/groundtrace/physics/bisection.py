"""Roots of many equations at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_HALVINGS = 60  # more than the bits of a double


def bisect(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return where an increasing function changes its sign, for each pair of bounds.

    Parameters
    ----------
    function
        Takes and gives shape (n,), one equation per element: negative below its root.
    low, high
        Shape (n,): bounds of the roots.

    Returns
    -------
    NDArray
        Shape (n,). Where nothing changes its sign, the bound on whose side the root would lie.
    """
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = function(middle) < 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)
