"""How much arrivals err, by the places found so far: covariances that mean what they say."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .location import Location

#: Places looked back on, and how many of them the value given beforehand counts as.
MEMORY, PRIOR_COUNT = 64, 4


@dataclass(slots=True)
class RunningSigma:
    """The standard deviation of an arrival: the median of those that single places tell.

    One place has few arrivals to spare and tells little; a median of many stands false picks.

    Attributes
    ----------
    prior_s
        What it is before there are places [s].
    unknowns
        How many arrivals a place uses up.
    """

    prior_s: float
    unknowns: int
    told: deque[float] = field(default_factory=lambda: deque(maxlen=MEMORY))

    @property
    def value_s(self) -> float:
        """The estimate by now [s]."""
        return median([*self.told, *[self.prior_s] * PRIOR_COUNT])

    def learn(self, found: Location) -> None:
        """Take in the residual of a place, the root of its mean loss [s]."""
        spare = found.picks - self.unknowns
        if not found.found or spare < 1:
            return
        # the median of a root of chi-square, by the approximation of Wilson and Hilferty (1931)
        typical = (1 - 2 / (9 * spare)) ** 1.5
        self.told.append(found.residual * (found.picks / spare) ** 0.5 / typical)
