"""Golden masses of two sources on a frame of two hypotheses, worked out by hand in fractions."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import strategies as st

from groundtrace.detectors.dempster_shafer import HypothesisSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

PEAK = HypothesisSet(("peak", "other"))
OTHER_RULES = ("smets", "yager", "disjunctive", "dubois-prade", "florea")


def exact(*masses: object) -> NDArray:
    """Masses as exact fractions, out of numbers or of texts such as ``"0.72"``."""
    return np.array([Fraction(m) for m in masses], object)


def assert_masses(masses: NDArray) -> None:
    """Check that masses are nowhere negative and add up to 1."""
    assert (masses >= 0).all()
    assert np.allclose(masses.sum(axis=-1), 1, rtol=0, atol=1e-9)


@dataclass(frozen=True)
class Golden:
    """Two sources and what every rule makes of them; empty, peak, other, whole."""

    first: NDArray
    second: NDArray
    conflict: Fraction
    smets: NDArray
    disjunctive: NDArray
    yager: NDArray
    florea: NDArray
    dempster: NDArray | None

    @property
    def dubois_prade(self) -> NDArray:
        """On two hypotheses the same as Yager's."""
        return self.yager


def over(whole: int, *parts: int) -> NDArray:
    return exact(*(Fraction(part, whole) for part in parts))


#: (III.4) gives the masses: accelerometer p = .9, q = .8; gyroscope p = .6, q = .3 in the first.
GOLDEN = {
    "sources of two minds": Golden(
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, "0.18", "0.42", "0.40"),
        Fraction(837, 2500),
        exact("0.3348", "0.4356", "0.1896", "0.04"),
        exact(0, "0.1296", "0.0756", "0.7948"),
        exact(0, "0.4356", "0.1896", "0.3748"),
        over(4858069, 0, 2082195, 946455, 1829419),
        over(1663, 0, 1089, 474, 100),
    ),
    "sources that agree": Golden(
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, "0.63", "0.07", "0.30"),
        Fraction("0.1638"),
        exact("0.1638", "0.7326", "0.0736", "0.03"),
        exact(0, "0.4536", "0.0126", "0.5338"),
        exact(0, "0.7326", "0.0736", "0.1938"),
        exact(0, "0.795916075", "0.073703310", "0.130380616"),
        exact(0, "0.876106195", "0.088017221", "0.035876585"),
    ),
    "a second source that knows nothing": Golden(
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, 0, 0, 1),
        Fraction(0),
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, 0, 0, 1),
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, "0.72", "0.18", "0.10"),
        exact(0, "0.72", "0.18", "0.10"),
    ),
    "hardly anything in common": Golden(
        exact(0, "0.99", "0.01", 0),
        exact(0, "0.01", "0.99", 0),
        Fraction("0.9802"),
        exact("0.9802", "0.0099", "0.0099", 0),
        exact(0, "0.0099", "0.0099", "0.9802"),
        exact(0, "0.0099", "0.0099", "0.9802"),
        exact(0, "0.010095942", "0.010095942", "0.979808117"),
        exact(0, "0.5", "0.5", 0),
    ),
    "nothing in common": Golden(
        exact(0, 1, 0, 0),
        exact(0, 0, 1, 0),
        Fraction(1),
        exact(1, 0, 0, 0),
        exact(0, 0, 0, 1),
        exact(0, 0, 0, 1),
        exact(0, 0, 0, 1),
        None,
    ),
    "half in common": Golden(
        exact(0, "0.5", "0.5", 0),
        exact(0, "0.5", "0.5", 0),
        Fraction(1, 2),
        exact("0.5", "0.25", "0.25", 0),
        exact(0, "0.25", "0.25", "0.5"),
        exact(0, "0.25", "0.25", "0.5"),
        over(3, 0, 1, 1, 1),
        exact(0, "0.5", "0.5", 0),
    ),
}


def masses_of(hypotheses: int) -> st.SearchStrategy[NDArray]:
    """Exact masses on a frame of some hypotheses, nothing on the empty set."""
    count = 2**hypotheses - 1
    parts = st.lists(st.integers(0, 9), min_size=count, max_size=count).filter(any)
    return parts.map(lambda found: over(sum(found), 0, *found))
