"""What a localizer gives: a place, how sure it is, and what it leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Fix

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: A place in the plane has two coordinates, and the moment of the impact is unknown too.
LEAST_PICKS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """A place found.

    Attributes
    ----------
    x, y
        Where [m]; NaN where there are too few arrivals.
    covariance
        Shape (2, 2) [m^2]; NaN likewise.
    residual
        What the method leaves unexplained, in its own unit; NaN likewise.
    picks
        From how many arrivals.
    ties
        How many regions or nodes explain the arrivals equally well.
    """

    x: float
    y: float
    covariance: NDArray[np.float64]
    residual: float
    picks: int
    ties: int = 1

    @property
    def found(self) -> bool:
        """Whether there is a place."""
        return bool(np.isfinite(self.x))

    @property
    def larger_sigma_m(self) -> float:
        """Standard deviation along the longer axis of its ellipse [m]; inf where that is open."""
        if not np.isfinite(self.covariance).all():
            return float("inf")
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))

    def fix(self, time_ns: int, method: str, stage: str) -> Fix:
        """Return the place as the fix of a moment, found by a method in a stage."""
        (xx, xy), (_, yy) = self.covariance.tolist()
        spread = (xx, xy, yy)
        return Fix(time_ns, self.x, self.y, spread, self.residual, method, self.picks, stage)


def nowhere(picks: int) -> Location:
    """Return the answer to fewer arrivals than :data:`LEAST_PICKS`."""
    nan = float("nan")
    return Location(nan, nan, np.full((2, 2), nan), nan, picks, 0)
