"""Assignment of estimates to truth: the cheapest of the largest sets of allowed pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def assign(cost: NDArray[np.float64], gate: float) -> NDArray[np.intp]:
    """Assign rows to columns one to one, no pair dearer than the gate.

    The gate acts before the assignment: a minimum over all pairs that is filtered afterwards
    loses matches where the counts differ.

    Parameters
    ----------
    cost
        Shape (n, m), >= 0; infinite or NaN where a pair is impossible.
    gate
        Largest cost of a pair.

    Returns
    -------
    Index pairs (row, column), shape (k, 2), by row: as many as can be, and of those sets the one
    with the least total cost.
    """
    allowed = np.isfinite(cost) & (cost <= gate)
    if not allowed.any():
        return np.empty((0, 2), np.intp)
    # One forbidden pair costs more than all allowed ones, so that as few as can be are taken.
    forbidden = 1.0 + 2.0 * float(cost[allowed].max()) * min(cost.shape)
    rows, columns = cheapest(np.where(allowed, cost, forbidden))
    allowed_pairs = allowed[rows, columns]
    return np.column_stack([rows[allowed_pairs], columns[allowed_pairs]])


def cheapest(cost: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pairs, as many as can be, of the least total cost.

    Parameters
    ----------
    cost
        Shape (n, m), finite.
    """
    if cost.size and 1 in cost.shape:  # one walker, one fix: to solve for more takes long to load
        row, column = divmod(int(np.argmin(cost)), cost.shape[1])
        return np.array([row]), np.array([column])
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return np.asarray(rows), np.asarray(columns)


def distances(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances between places of shapes (n, 2) and (m, 2), shape (n, m)."""
    apart = x[:, None, :] - y[None, :, :]
    return np.hypot(apart[..., 0], apart[..., 1])
