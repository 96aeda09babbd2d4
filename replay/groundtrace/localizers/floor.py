"""What all impacts of a recording share: how long waves take over a floor, and the clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Of a thin plate, from the thesis on footstep localisation, equation (4.24).
EXPONENT = 4 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Arrivals t = t0 + pace (d / reference)^exponent + offset.

    The pace is the scale k of t = t0 + k d^p where d is the reference: unlike k it hardly depends
    on the exponent, so that both can be estimated together.

    Attributes
    ----------
    reference_m
        A distance typical of the layout [m].
    pace_s
        How long a wave takes over it [s].
    exponent
        p; 4/3 on a thin plate, 1 where velocity is constant.
    offsets_s
        Shape (n,): how far the clock of each sensor is ahead [s]; their sum is 0.
    """

    reference_m: float
    pace_s: float
    exponent: float
    offsets_s: Array

    @property
    def scale(self) -> float:
        """The scale k of t = t0 + k d^p [s/m^p]."""
        return float(self.pace_s * self.reference_m**-self.exponent)

    def travel_s(self, distance_m: Array) -> Array:
        """Return how long waves take over distances [s]."""
        taken: Array = self.pace_s * (distance_m / self.reference_m) ** self.exponent
        return taken

    def near(self, other: Floor) -> bool:
        """Whether another floor is the same to 1e-5 of the pace."""
        least = 1e-5 * self.pace_s
        return (
            abs(self.pace_s - other.pace_s) < least
            and abs(self.exponent - other.exponent) < 1e-5
            and bool(np.all(np.abs(self.offsets_s - other.offsets_s) < least))
        )


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a floor beforehand; infinite deviations know nothing.

    Attributes
    ----------
    pace_s, pace_deviation
        The pace [s], and the standard deviation of its logarithm.
    exponent, exponent_deviation
        The exponent and its standard deviation.
    """

    pace_s: float = 1.0
    pace_deviation: float = float("inf")
    exponent: float = EXPONENT
    exponent_deviation: float = float("inf")


def reference_distance(positions: Array) -> float:
    """Return the root mean square distance of sensors, shape (n, 2), from their middle [m]."""
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))
