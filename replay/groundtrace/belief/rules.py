"""Rules that combine the masses of several sources, and discounting of a source.

Every rule takes all sources at once, since Yager's, Dubois and Prade's and Florea's are not
associative: chained in pairs, their result would depend on the order. Masses have shape
(..., 2^k), floats or exact fractions; leading axes are combined row by row.

Source: Dempster-Shafer thesis, chapter II, section III.3.
"""

from __future__ import annotations

from functools import reduce
from itertools import product
from operator import and_, mul, or_
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import BeliefError, TotalConflictError
from .frame import hypotheses_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

#: Names of the rules of :data:`RULES`.
Rule = Literal["dempster", "smets", "yager", "disjunctive", "dubois-prade", "florea"]


def smets(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections; the conflict stays on the empty set.

    Source: thesis, equation (II.19), which leaves out the empty set although its mass is K.
    """
    return reduce(lambda a, b: _paired(a, b, and_), _checked(sources))


def conflict(*sources: NDArray[Any]) -> NDArray[Any]:
    """Return the conflict K of the sources, shape (...): thesis, equation (II.18)."""
    return np.asarray(smets(*sources)[..., 0])


def dempster(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections and divide by what is no conflict: thesis, equation (II.17).

    Raises
    ------
    TotalConflictError
        Where the sources agree on nothing (K = 1) in some row.
    """
    masses = smets(*sources)
    # the sum of what agrees, and not 1 - K, is exactly 0 only where every product is
    agreed = np.asarray(masses[..., 1:].sum(axis=-1))
    total = np.asarray(agreed == 0)
    if total.any():
        raise TotalConflictError(
            f"dempster: expected sources that agree on something, found total conflict in "
            f"{int(total.sum())} of {total.size} rows"
        )
    masses[..., 0] = masses[..., 0] * 0
    return np.asarray(masses / agreed[..., None])


def yager(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections; the conflict becomes ignorance: thesis, equation (II.20)."""
    masses = smets(*sources)
    masses[..., -1] = masses[..., -1] + masses[..., 0]
    masses[..., 0] = masses[..., 0] * 0
    return masses


def disjunctive(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by unions: thesis, equation (II.21)."""
    return reduce(lambda a, b: _paired(a, b, or_), _checked(sources))


def dubois_prade(*sources: NDArray[Any]) -> NDArray[Any]:
    """Combine by intersections, by unions where there is none: thesis, equation (II.22)."""
    given = _checked(sources)
    masses = _zeros(*given)
    for subsets in product(range(masses.shape[-1]), repeat=len(given)):
        subset = reduce(and_, subsets) or reduce(or_, subsets)
        parts = [m[..., each] for m, each in zip(given, subsets, strict=True)]
        masses[..., subset] = masses[..., subset] + reduce(mul, parts)
    return masses


def florea(*sources: NDArray[Any]) -> NDArray[Any]:
    """Mix unions and intersections by how much conflict there is: thesis, equation (II.23)."""
    masses = smets(*sources)
    k = masses[..., :1].copy()
    masses[..., 0] = masses[..., 0] * 0
    mixed = (k * disjunctive(*sources) + (1 - k) * masses) / (1 - k + k * k)
    return np.asarray(mixed)


#: The rules by name.
RULES: dict[Rule, Callable[..., NDArray[Any]]] = {
    "dempster": dempster,
    "smets": smets,
    "yager": yager,
    "disjunctive": disjunctive,
    "dubois-prade": dubois_prade,
    "florea": florea,
}


def discount(masses: NDArray[Any], reliability: Any) -> NDArray[Any]:
    """Move a part of a source's masses to the whole frame.

    Parameters
    ----------
    masses
        Shape (..., 2^k).
    reliability
        Number or shape (...), from 0 (the source says nothing) to 1 (as it is).

    Raises
    ------
    BeliefError
        Where a reliability is outside [0, 1].

    Notes
    -----
    Source: thesis, equation (II.24), whose second line holds for the whole frame only; printed for
    every subset, the masses do not add up to 1. Corrected: all are multiplied by the reliability,
    and what is lost goes to the whole frame.
    """
    hypotheses_of(masses)
    factor = np.asarray(reliability)
    if not ((factor >= 0) & (factor <= 1)).all():
        raise BeliefError(f"discount: expected a reliability from 0 to 1, found {reliability}")
    kept = np.asarray(masses * factor[..., None])
    kept[..., -1] = kept[..., -1] + (1 - factor)
    return kept


def _checked(sources: tuple[NDArray[Any], ...]) -> tuple[NDArray[Any], ...]:
    sizes = {hypotheses_of(masses) for masses in sources}
    if len(sizes) != 1:
        found = [masses.shape for masses in sources]
        raise BeliefError(f"sources: expected masses on one frame, found shapes {found}")
    # a single source is returned as a copy: rules write into what they get
    return (sources[0].copy(), *sources[1:])


def _zeros(*sources: NDArray[Any]) -> NDArray[Any]:
    """Return zeros of the kind of number the sources are made of, fractions included."""
    return np.asarray(reduce(mul, sources) * 0)


def _paired(
    first: NDArray[Any], second: NDArray[Any], subset_of: Callable[[int, int], int]
) -> NDArray[Any]:
    masses = _zeros(first, second)
    for a in range(masses.shape[-1]):
        for b in range(masses.shape[-1]):
            to = subset_of(a, b)
            masses[..., to] = masses[..., to] + first[..., a] * second[..., b]
    return masses
