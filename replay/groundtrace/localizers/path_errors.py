"""How far arrivals err alike: what a floor that is faster here than there does to the places on it.

Errors of picks average out over sensors. Where a floor is stiffer in one part than in another, all
waves that cross that part are early, and the place moves, however many sensors hear it. So an
arrival's error is taken for the sum of two: one of its own, and one that grows with distance and is
alike at sensors that a step is heard at from about the same direction. What the fits leave over
tells how much there is of each: next to each other, seen from the place, residuals of the first
kind differ, those of the second do not. The covariance of a place, which reckons with errors of
the first kind alone, is widened by what the second adds.

Of the second kind a fit hides the most, as a place that is moved explains it: the share that is
left over is far below the share that there is. This is reckoned with.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..dsp.robust import MAD_SIGMA, medians

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..pipeline.stage import LocationEstimate

    Array = NDArray[np.float64]

#: Errors of arrivals are alike about this angle apart, a standard deviation [rad]; how much of the
#: residuals they make where nothing is known, and how far that may be off. Bench: uneven_floor.py
#: --first 1 --last 8, floors uneven by 0.15 over 2 m, of 0.9, 1.2, 1.8 and 2.5; and with it
#: room_laws.py --first 101 --last 140, of 0.1 and 0.2, and 0.2 and 0.3.
ALIKE_RAD, SHARED, SHARED_DEVIATION = 1.8, 0.1, 0.2
#: Places looked back on. Chosen by judgement: as many as tell the deviation of an arrival.
MEMORY = 64
#: Residuals count up to this, in deviations. Chosen by judgement: late picks tell nothing here.
CLIP = 2.5
#: Distances count as at least this part of the farthest. Chosen by judgement: beside a sensor a
#: direction says nothing.
NEAREST = 0.1


@dataclass(slots=True)
class PathErrors:
    """The share of errors that arrivals have in common, by the places so far.

    Attributes
    ----------
    sensors
        Shape (n, 2) [m].
    exponent
        Power of distance that arrivals grow with.
    scale
        What they grow by [s/m^exponent]; None where each place has a pace of its own.
    """

    sensors: Array
    exponent: float = 1.0
    scale: float | None = None
    _moments: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MEMORY))

    @property
    def share(self) -> float:
        """The part of the residuals that errors in common make by now, 0 to 1."""
        precision = SHARED_DEVIATION**-2
        along = SHARED * precision + sum(product for product, _ in self._moments)
        return min(max(along / (precision + sum(square for _, square in self._moments)), 0.0), 0.98)

    def widened(self, estimate: LocationEstimate, times_s: Array) -> LocationEstimate:
        """Learn from a place, and return it with what such errors add to its covariance.

        Parameters
        ----------
        estimate
            The place.
        times_s
            Shape (n,): arrivals [s], NaN where a sensor has none.
        """
        if not estimate.located:
            return estimate
        arrived = np.isfinite(times_s)
        fit = _Fit.at(
            self.sensors[arrived], np.array([estimate.x, estimate.y]), self.exponent, self.scale
        )
        if fit is None:
            return estimate
        times = times_s[arrived] - (0.0 if self.scale is None else self.scale * fit.powers)
        self._learn(fit, times)
        return replace(estimate, covariance=fit.factor(self.share) * estimate.covariance)

    def _learn(self, fit: _Fit, times: Array) -> None:
        left = times - fit.across @ (fit.across.T @ times)
        most = CLIP * MAD_SIGMA * float(medians(np.abs(left)))
        left = left.clip(-most, most)
        square = float(left @ left)
        if fit.spare < 2 or square <= 0:
            return
        alone, common = fit.alone, fit.common
        excess = float(left @ fit.beside @ left) / square - alone
        # a ratio of so many residuals scatters by about the root of 2 / n
        weight = len(times) / 2
        self._moments.append((weight * excess * (common - alone), weight * (common - alone) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """What a fit of a place takes from the arrivals of n sensors, with k unknowns.

    Attributes
    ----------
    powers
        Shape (n,): powers of the distances.
    across, inverse
        Orthonormal columns of its slopes, shape (n, k), and the inverse of what makes them so,
        (k, k).
    beside, correlation
        Shape (n, n): which sensors are next to each other seen from the place, and the covariance
        of errors in common, of mean 1.
    """

    powers: Array
    across: Array
    inverse: Array
    beside: Array
    correlation: Array

    @classmethod
    def at(
        cls, sensors: Array, position: Array, exponent: float, scale: float | None
    ) -> _Fit | None:
        """Return it for a place; None where no arrival is to spare."""
        away = sensors - position
        distance = np.hypot(*away.T)
        distance = np.maximum(distance, NEAREST * distance.max())
        angle = np.arctan2(away[:, 1], away[:, 0])
        powers, slope = distance**exponent, distance ** (exponent - 1)
        columns = [slope * np.cos(angle), slope * np.sin(angle), np.ones_like(distance)]
        slopes = np.array(columns if scale is not None else [*columns, powers]).T
        if len(slopes) <= slopes.shape[1]:
            return None
        across, upper = np.linalg.qr(slopes)
        size = np.abs(np.diag(upper))
        if size.min() < 1e-6 * size.max():  # sensors in one line
            return None
        order = np.argsort(angle)
        beside = np.zeros((len(angle), len(angle)))
        beside[order, np.roll(order, -1)] = 0.5
        # von Mises' law, which is a covariance on the circle; near 0 it is a normal law's
        correlation = np.exp((np.cos(angle[:, None] - angle) - 1) / ALIKE_RAD**2)
        correlation *= np.outer(distance, distance)
        correlation /= np.mean(distance**2)
        return cls(powers, across, np.linalg.inv(upper), beside + beside.T, correlation)

    @property
    def spare(self) -> int:
        """Arrivals that the unknowns leave over."""
        arrivals, unknowns = self.across.shape
        return int(arrivals - unknowns)

    @property
    def alone(self) -> float:
        """How alike residuals next to each other are where each arrival errs on its own."""
        return -float(np.sum(self.across * (self.beside @ self.across))) / self.spare

    @property
    def common(self) -> float:
        """How alike they are where arrivals err in common."""
        taken = np.eye(len(self.across)) - self.across @ self.across.T
        left = taken @ self.correlation @ taken
        return float(np.sum(self.beside * left)) / float(np.trace(left))

    def factor(self, share: float) -> float:
        """Return how much larger the variance of the place is than residuals alone tell, from 1.

        Parameters
        ----------
        share
            What part of the residuals errors in common make.
        """
        inner = self.across.T @ self.correlation @ self.across
        hidden = float(np.trace(self.correlation) - np.trace(inner))
        # parts of the errors, of which the fit leaves so much over
        separate = (1 - share) * hidden
        common = share * self.spare
        moved = (self.inverse @ inner @ self.inverse.T)[:2, :2].trace()
        still = (self.inverse @ self.inverse.T)[:2, :2].trace()
        squared_error = (separate * still + common * moved) / still
        left = (separate * self.spare + common * hidden) / self.spare
        return max(float(squared_error / left), 1.0) if left > 0 else 1.0
