"""Ways to lay two recordings over each other, and when one is out of the question."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: What the best shift must have over the second best, as a logarithm of likelihoods: a little, and
#: this many deviations of what two scatters of n moments that are alike differ by, the root of n.
_MARGIN, _MARGIN_DEVIATIONS = 4.0, 3.5
#: Or this much by the number of moments that agree alone: two starts or stops that do not.
_MARGIN_COUNTED = 15.0
#: Least and largest probability that a recording lacks a moment of the other, and the logarithm of
#: that it lacks any number in a row: a room hears nothing of a walk outside.
_MISSED, _UNHEARD = (0.1, 0.6), -5.0


class Shift(NamedTuple):
    """One way to lay two recordings over each other.

    ``ahead_s`` is what the other's seconds since its start exceed those of the reference by, at its
    start; ``matched`` moments of ``possible`` agree with a scatter of ``sigma_s``, ``alone`` is
    the logarithm of how likely it is that so many of either have no partner where both recorded,
    ``worth`` of how much likelier than by chance one moment agrees so well.
    """

    ahead_s: float
    drift_ppm: float
    matched: int
    possible: int
    sigma_s: float
    ahead_sigma_s: float
    drift_sigma_ppm: float
    drift_fitted: bool
    alone: float
    worth: float

    @property
    def score(self) -> float:
        """Logarithm of how much likelier than by chance so many moments agree so well.

        By chance the nearest moment is anywhere within an interval; of one that agrees the
        distance is normal. Those that are alone were missed, or not heard for a while.
        """
        return self.matched * self.worth + self.alone

    def beats(self, other: Shift) -> bool:
        """Whether another shift is out of the question."""
        margin = self.score - other.score
        counted = (self.matched - other.matched) * self.worth + self.alone - other.alone
        return margin >= needed(self) or min(margin, counted) >= _MARGIN_COUNTED


class Judged(NamedTuple):
    """A shift, and the lengths of runs without a partner and the numbers of moments, of both."""

    shift: Shift
    runs: tuple[NDArray[np.intp], NDArray[np.intp]]
    counts: tuple[int, int]

    @property
    def lacking(self) -> tuple[float, float]:
        """How likely it is that a moment of each recording lacks a partner."""
        low, high = _MISSED
        a, b = (min(max(1 - self.shift.matched / max(n, 1), low), high) for n in self.counts)
        return a, b

    def with_alone(self, lacking: tuple[float, float]) -> Shift:
        """Return the shift with how likely its moments without partner are."""
        alone = sum(
            float(np.maximum(runs * np.log(each), _UNHEARD).sum())
            for runs, each in zip(self.runs, lacking, strict=True)
        )
        return self.shift._replace(alone=alone)


def needed(best: Shift) -> float:
    """Return what its margin must be over a shift under which as many moments agree."""
    return _MARGIN + _MARGIN_DEVIATIONS * float(np.sqrt(best.matched))
