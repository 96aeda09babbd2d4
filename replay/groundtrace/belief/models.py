"""Models of masses: how what a source measures becomes masses, shape (..., 2^k).

Numbers may be floats, arrays of floats or exact fractions; arrays give one row each.

Source: Dempster-Shafer thesis, chapter II, section III.2, and chapter III, section V.2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BeliefError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .frame import Frame


def specialised(frame: Frame, subset: int, support: Any, against: Any) -> NDArray[Any]:
    """Return masses on a subset, its complement, and the rest on the whole frame: (II.9)."""
    zero = (np.asarray(support) + np.asarray(against)) * 0
    masses = np.stack([zero] * frame.size, axis=-1)
    for part, mass in ((subset, support), (frame.complement(subset), against)):
        masses[..., part] = masses[..., part] + mass
    masses[..., -1] = masses[..., -1] + (1 - masses.sum(axis=-1))
    return masses


def graded(frame: Frame, hypothesis: int, certainty: Any, truth: Any) -> NDArray[Any]:
    """Return the masses of a source that can tell with ``certainty``, and then says ``truth``.

    ``m(A) = p q``, ``m(not A) = p (1 - q)``, ``m(whole) = 1 - p``: thesis, equations (III.4) and
    (III.5), p the certainty and q the probability that the hypothesis is true.
    """
    p, q = np.asarray(certainty), np.asarray(truth)
    return specialised(frame, hypothesis, p * q, p * (1 - q))


def trapezoid(x: Any, rise: float, full: float, fade: float, gone: float) -> NDArray[Any]:
    """Return the membership in a trapezoid, shape of ``x``, from 0 to 1.

    It is 0 up to ``rise``, 1 from ``full`` to ``fade`` and 0 again from ``gone`` on, linear in
    between; equal corners make an edge upright, and the upper side of an edge counts as inside.
    Thesis, chapter III, section V.2, which names the function but none of its corners.

    Raises
    ------
    BeliefError
        Where the corners are not in that order.
    """
    if not rise <= full <= fade <= gone:
        raise BeliefError(
            f"trapezoid: expected rising corners, found {rise:g}, {full:g}, {fade:g}, {gone:g}"
        )
    x = np.asarray(x)
    up = (x - rise) / (full - rise) if full > rise else (x >= full) * 1.0
    down = (gone - x) / (gone - fade) if gone > fade else (x <= fade) * 1.0
    return np.asarray(np.clip(np.minimum(up, down), 0, 1))
