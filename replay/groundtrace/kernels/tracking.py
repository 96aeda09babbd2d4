"""Viterbi's recursion over a line of channels: the best way to each moment from those before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .compiling import compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled("void(f8[::1], i8, i8, f8, f8[::1])")
def best_steps(score: Array, later: int, earlier: int, cost: float, best_score: Array) -> None:
    """Write the best score of a step to each cell, from cells of the channel before.

    Parameters
    ----------
    score, best_score
        Shape (n_cells,): of the channel before, and what becomes of it.
    later, earlier
        By how many cells the step may go on in time, and back.
    cost
        Of a cell of the step's length.
    """
    for t in range(len(score)):
        best = score[t]
        for s in range(max(0, t - later), min(len(score), t + earlier + 1)):
            best = max(best, score[s] - cost * abs(t - s))
        best_score[t] = best
