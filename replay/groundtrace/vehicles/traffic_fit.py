"""Fitting vehicles on a road to the powers of all stations, and how well so many explain them.

The cube root of a power over its mean is nearly Gaussian whatever its degrees of freedom; its
density with what is known beforehand is maximised by Fisher scoring, and integrated about the
maximum by Laplace's method, so that numbers of vehicles and their directions compare.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .traffic_model import MOMENT, Vehicle
from .traffic_scatter import Scatter, rooted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .traffic_model import RoadPowers

    Array = NDArray[np.float64]

_DAMPING = (1e-2, 0.3, 5.0)  # at the start; after a step that helps, and after one that does not
_LARGEST_STEP, _WORST_DAMPING = 1.5, 1e5
_TOLERANCE = 0.04  # of twice the log-likelihood


@dataclass(frozen=True, slots=True, eq=False)
class TrafficFit:
    """Vehicles that were fitted jointly.

    Attributes
    ----------
    vehicles
        In no order.
    information
        Shape (v k, v k), k values of each vehicle: the inverse of their covariance.
    mean
        Shape (r, n): fitted mean powers, those of the noise and other vehicles included [unit^2].
    evidence
        Logarithm of the likelihood, integrated over what vehicles may be, but for a constant.
    """

    vehicles: tuple[Vehicle, ...]
    information: Array
    mean: Array
    evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Some cycles, in which vehicles are fitted while others stay.

    Attributes
    ----------
    observed
        All cycles.
    rows
        Which of them.
    beside
        Shape (r, n): mean power of the noise and of the vehicles that stay [unit^2].
    scatter
        Of the powers.
    """

    observed: RoadPowers
    rows: slice
    beside: Array
    scatter: Scatter

    def fit(self, vehicles: Sequence[Vehicle], steps: int) -> TrafficFit:
        """Fit vehicles from where they are, in so many steps at most."""
        values = np.array([v.values for v in vehicles]).reshape(-1, len(self.observed.usual))
        around = np.tile(self.observed.usual, (len(values), 1))
        around[:, MOMENT] = values[:, MOMENT]
        signs = tuple(v.direction for v in vehicles)
        at, damping = self._at(values, signs, around), _DAMPING[0]
        for _ in range(steps if len(values) else 0):
            ridge = damping * np.diag(np.diag(at.information))
            step = np.linalg.solve(at.information + ridge, at.gradient)
            step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
            tried = self._at(at.values + step.reshape(values.shape), signs, around)
            if not tried.lost <= at.lost:  # NaN does not help either
                damping *= _DAMPING[2]
                if damping > _WORST_DAMPING:
                    break
                continue
            done, at = at.lost - tried.lost < _TOLERANCE, tried
            damping *= _DAMPING[1]
            if done:
                break
        return self._finished(at, signs)

    def _at(self, values: Array, signs: tuple[int, ...], around: Array) -> _State:
        observed = self.observed
        known = observed.known[self.rows]
        mean, parts, slopes = self._model(values, signs)
        variance, tempered = self.scatter.variance, self.scatter.effective
        ratio = np.where(known, observed.powers[self.rows], mean) / mean
        off = np.where(known, rooted(ratio) + variance / 3, 0.0)
        lower = np.linalg.cholesky(self.scatter.correlation(parts, known))
        white = np.linalg.solve(lower, np.concatenate([slopes, off[:, :, None]], axis=2))
        design = white[..., :-1].reshape(mean.size, slopes.shape[2])
        left = white[..., -1]
        # what the mean does to the density of a cube root: its Jacobian, and the determinant
        scale = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() - 2 / 3 * np.log(ratio).sum()
        weights = np.linalg.solve(np.swapaxes(lower, 1, 2), left[..., None])[..., 0]
        score = np.where(known, np.cbrt(ratio) * weights / tempered - variance / tempered / 3, 0.0)
        precision = np.tile(observed.precision, len(values))
        away = (values - around).ravel()
        lost = float(((left**2).sum() + scale * variance) / tempered + precision @ away**2)
        gradient = (
            slopes.reshape(mean.size, slopes.shape[2]).T @ score.reshape(-1) - precision * away
        )
        information = design.T @ design / tempered + np.diag(precision)
        return _State(values, mean, lost, gradient, information)

    def _model(self, values: Array, signs: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return the mean, each vehicle's part of it, and slopes of its logarithm."""
        found = [
            self.observed.power(Vehicle(row, sign), self.rows)
            for row, sign in zip(values, signs, strict=True)
        ]
        mean = self.beside + sum((power for power, _ in found), np.zeros_like(self.beside))
        parts = np.array([power / mean for power, _ in found]).reshape(-1, *mean.shape)
        slopes = np.concatenate([np.zeros((*mean.shape, 0)), *(s for _, s in found)], axis=2)
        known = self.observed.known[self.rows]
        return mean, parts, np.where(known, 1 / mean, 0.0)[:, :, None] * slopes

    def _finished(self, at: _State, signs: tuple[int, ...]) -> TrafficFit:
        """Return the fit, its evidence by Laplace's method."""
        prior = 0.5 * float(np.log(self.observed.precision).sum()) + self.observed.log_chance
        volume = float(np.linalg.slogdet(at.information)[1]) if len(signs) else 0.0
        evidence = -0.5 * (at.lost + volume) + len(signs) * prior
        vehicles = tuple(Vehicle(row, sign) for row, sign in zip(at.values, signs, strict=True))
        return TrafficFit(vehicles, at.information, at.mean, evidence)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The density at some values: twice what is lost, its gradient, and the information."""

    values: Array
    mean: Array
    lost: float
    gradient: Array
    information: Array
