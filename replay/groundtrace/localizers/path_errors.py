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
#: Where the slopes' products and their inverse are larger, sensors lie in a line. Chosen by
#: judgement: far below what doubles hold.
SINGULAR = 1e10


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
        position = np.array([estimate.x, estimate.y])
        fit = _Fit.at(self.sensors[arrived], position, self.exponent, free=self.scale is None)
        if fit is None:
            return estimate
        times = times_s[arrived][fit.order]
        if self.scale is not None:
            times -= self.scale * fit.powers
        self._learn(fit, times)
        return replace(estimate, covariance=fit.factor(self.share) * estimate.covariance)

    def _learn(self, fit: _Fit, times: Array) -> None:
        left = times - fit.weights @ (fit.slopes.T @ times)
        most = CLIP * MAD_SIGMA * float(medians(np.abs(left)))
        left = left.clip(-most, most)
        square = float(left @ left)
        if fit.spare < 2 or square <= 0:
            return
        alone, common = fit.alone, fit.common
        excess = float(left @ _beside(left)) / square - alone
        # a ratio of so many residuals scatters by about the root of 2 / n
        weight = len(times) / 2
        self._moments.append((weight * excess * (common - alone), weight * (common - alone) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """What a fit of a place takes from the arrivals of n sensors, with k unknowns.

    Attributes
    ----------
    order
        The sensors around the place, shape (n,); all that follows is in this order.
    powers
        Shape (n,): powers of the distances.
    slopes
        Shape (n, k): by x, y, the moment and, where it is free, the pace.
    inverse, weights
        Of the slopes' products, shape (k, k), and the slopes times it, (n, k).
    correlation, along
        Covariance of errors in common, of mean 1, shape (n, n), and its product with the slopes.
    hidden
        The sum of squares that such errors leave over.
    """

    order: NDArray[np.intp]
    powers: Array
    slopes: Array
    inverse: Array
    weights: Array
    correlation: Array
    along: Array
    hidden: float

    @classmethod
    def at(cls, sensors: Array, position: Array, exponent: float, *, free: bool) -> _Fit | None:
        """Return it for a place; None where no arrival is to spare, or sensors are in a line."""
        unknowns = 3 + free
        if len(sensors) <= unknowns:
            return None
        away = sensors - position
        order = np.argsort(np.arctan2(away[:, 1], away[:, 0]))
        away = away[order]
        apart = np.hypot(away[:, 0], away[:, 1])
        distance = np.maximum(apart, NEAREST * apart.max())
        relative, direction = distance / distance.mean(), away / np.maximum(apart, 1e-9)[:, None]
        slopes = np.ones((len(sensors), unknowns))
        slopes[:, :2] = direction * relative[:, None] ** (exponent - 1)
        if free:
            slopes[:, 3] = relative**exponent
        products = slopes.T @ slopes
        try:
            inverse: Array = np.linalg.inv(products).astype(np.float64, copy=False)
        except np.linalg.LinAlgError:
            return None
        if not np.trace(products) * np.trace(inverse) < SINGULAR:
            return None
        # von Mises' law, which is a covariance on the circle; near 0 it is a normal law's
        correlation = np.exp((direction @ direction.T - 1) / ALIKE_RAD**2)
        correlation *= np.outer(relative, relative / np.mean(relative**2))
        weights, along = slopes @ inverse, correlation @ slopes
        hidden = float(np.trace(correlation) - np.vdot(weights, along))
        powers = distance**exponent
        return cls(order, powers, slopes, inverse, weights, correlation, along, hidden)

    @property
    def spare(self) -> int:
        """Arrivals that the unknowns leave over."""
        arrivals, unknowns = self.slopes.shape
        return int(arrivals - unknowns)

    @property
    def alone(self) -> float:
        """How alike residuals next to each other are where each arrival errs on its own."""
        return -float(np.vdot(self.weights, _beside(self.slopes))) / self.spare

    @property
    def common(self) -> float:
        """How alike they are where arrivals err in common."""
        beside = _beside(self.weights)
        of_errors = np.trace(self.correlation, 1) + self.correlation[-1, 0]
        crossed = np.vdot(self.weights, _beside(self.along)) + np.vdot(self.along, beside)
        twice = np.vdot(self.weights @ (self.slopes.T @ self.along), beside)
        return float(of_errors - crossed + twice) / self.hidden

    def factor(self, share: float) -> float:
        """Return how much larger the variance of the place is than residuals alone tell, from 1.

        Parameters
        ----------
        share
            What part of the residuals errors in common make.
        """
        moved = self.weights.T @ self.along @ self.inverse
        # variances of both kinds that leave such parts over
        separate, common = (1 - share) * self.hidden, share * self.spare
        still = float(self.inverse[0, 0] + self.inverse[1, 1])
        squared_error = separate + common * float(moved[0, 0] + moved[1, 1]) / still
        # together they leave over what residuals tell
        return max(squared_error / self.hidden, 1.0) if self.hidden > 0 else 1.0


def _beside(rows: Array) -> Array:
    """Return what stands at the next sensor around the place; behind the last one is the first."""
    return np.concatenate([rows[1:], rows[:1]])
