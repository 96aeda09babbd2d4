"""What masses say of each subset: belief, plausibility, pignistic probability; and decisions.

Masses have shape (..., 2^k), floats or exact fractions.

Source: Dempster-Shafer thesis, chapter II, section III.4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import TotalConflictError
from .frame import hypotheses_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

#: What a decision takes the largest of.
Criterion = Literal["belief", "plausibility", "pignistic"]


def belief(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the belief of every subset: the masses of what is in it, shape (..., 2^k)."""
    return _gathered(masses, lambda inner, outer: inner != 0 and inner & ~outer == 0)


def plausibility(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the plausibility of every subset: the masses of what it meets, shape (..., 2^k)."""
    return _gathered(masses, lambda inner, outer: inner & outer != 0)


def pignistic(masses: NDArray[Any]) -> NDArray[Any]:
    """Return the pignistic probability of every hypothesis, shape (..., k).

    Raises
    ------
    TotalConflictError
        Where all mass lies on the empty set in some row.

    Notes
    -----
    Source: thesis, equation (II.27), which lacks the division by ``1 - m(empty)``; without it the
    probabilities do not add up to 1 after Smets's rule.
    """
    k = hypotheses_of(masses)
    somewhere = np.asarray(masses[..., 1:].sum(axis=-1))
    total = np.asarray(somewhere == 0)
    if total.any():
        raise TotalConflictError(
            f"pignistic: expected mass on some hypothesis, found all on the empty set in "
            f"{int(total.sum())} of {total.size} rows"
        )
    shares = masses[..., :k] * 0
    for subset in range(1, masses.shape[-1]):
        for hypothesis in range(k):
            if subset >> hypothesis & 1:
                share = masses[..., subset] / subset.bit_count()
                shares[..., hypothesis] = shares[..., hypothesis] + share
    return np.asarray(shares / somewhere[..., None])


def scores(masses: NDArray[Any], criterion: Criterion) -> NDArray[Any]:
    """Return belief, plausibility or pignistic probability of each hypothesis, shape (..., k)."""
    if criterion == "pignistic":
        return pignistic(masses)
    singles = [1 << hypothesis for hypothesis in range(hypotheses_of(masses))]
    of = belief if criterion == "belief" else plausibility
    return of(masses)[..., singles]


def decision(masses: NDArray[Any], criterion: Criterion) -> NDArray[np.intp]:
    """Return the hypothesis that scores most, shape (...); of equal ones the first.

    Source: thesis, equations (II.25), (II.26) and (II.28).
    """
    return np.asarray(np.argmax(scores(masses, criterion), axis=-1))


def over_ignorance(masses: NDArray[Any], subset: int) -> NDArray[Any]:
    """Return ``m(subset) - m(whole)``, shape (...): above 0 the sources know more than they doubt.

    Source: thesis, chapter III, section V.4. It stands there beside the decision by the largest
    belief as if it followed from it; it is a test of its own.
    """
    hypotheses_of(masses)
    return np.asarray(masses[..., subset] - masses[..., -1])


def _gathered(masses: NDArray[Any], counts: Callable[[int, int], bool]) -> NDArray[Any]:
    hypotheses_of(masses)
    found = np.asarray(masses * 0)
    for outer in range(masses.shape[-1]):
        for inner in range(masses.shape[-1]):
            if counts(inner, outer):
                found[..., outer] = found[..., outer] + masses[..., inner]
    return found
