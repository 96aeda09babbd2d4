"""The loop over the fields of a recording, compiled: which of them differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray


@compiled
def far_apart(fields: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Return which fields, shape (n, 3), are farther than ``least`` from the last that was.

    The first one is; the distance is that of the component that differs most.
    """
    far, last = np.zeros(len(fields), np.bool_), 0
    for i in range(len(fields)):
        off = 0.0
        for k in range(3):
            off = max(off, abs(fields[i, k] - fields[last, k]))
        far[i] = i == 0 or off > least
        last = i if far[i] else last
    return far
