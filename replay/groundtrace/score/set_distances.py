"""Distances between sets of places: OSPA and GOSPA."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .assignment import distances

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Gospa:
    """A GOSPA distance and its parts.

    Attributes
    ----------
    distance
        Root of order p of the sum of the parts [m].
    localisation, missed, false
        The parts, to the power p [m^p]. For alpha other than 2 a pair further apart than c counts
        in ``localisation``, and only the surplus of one set is missed or false.
    pairs
        How many places are assigned to each other.
    """

    distance: float
    localisation: float
    missed: float
    false: float
    pairs: int


def ospa(x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float) -> float:
    """Return the optimal sub-pattern assignment distance [m].

    Parameters
    ----------
    x, y
        Places [m], shapes (n, 2) and (m, 2).
    c, p
        Cut-off [m] and order.

    Notes
    -----
    D. Schuhmacher, B.-T. Vo, B.-N. Vo: A consistent metric for performance evaluation of
    multi-object filters, IEEE Transactions on Signal Processing 56 (2008), equation (3).
    """
    largest = max(len(x), len(y))
    if not largest:
        return 0.0
    surplus = c**p * abs(len(x) - len(y))
    return float(((_least_costs(x, y, c, p).sum() + surplus) / largest) ** (1 / p))


def gospa(
    x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float, alpha: float = 2.0
) -> Gospa:
    """Return the generalised OSPA distance and its parts.

    Parameters
    ----------
    x, y
        True and estimated places [m], shapes (n, 2) and (m, 2).
    c, p, alpha
        Cut-off [m], order, and weight of what is left over, 0 < alpha <= 2.

    Notes
    -----
    A. S. Rahmathullah, A. F. Garcia-Fernandez, L. Svensson: Generalized optimal sub-pattern
    assignment metric, FUSION 2017, definition 1 and, for alpha = 2, proposition 1.
    """
    costs = _least_costs(x, y, c, p)
    near = costs < c**p
    # With alpha = 2 a pair at the cut-off costs just what leaving both alone does.
    alone = int((~near).sum()) if alpha == 2 else 0
    pairs = len(costs) - alone
    localisation = float(costs[near].sum() if alpha == 2 else costs.sum())
    unit = c**p / alpha
    missed, false = unit * (len(x) - pairs), unit * (len(y) - pairs)
    return Gospa((localisation + missed + false) ** (1 / p), localisation, missed, false, pairs)


def _least_costs(
    x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float
) -> NDArray[np.float64]:
    """Return the costs min(d, c)^p of the cheapest assignment of the smaller set."""
    from scipy.optimize import linear_sum_assignment

    if not len(x) or not len(y):
        return np.empty(0)
    cost = np.minimum(distances(x, y), c) ** p
    rows, columns = linear_sum_assignment(cost)
    return np.asarray(cost[rows, columns], np.float64)
