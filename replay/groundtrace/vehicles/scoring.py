"""Fitting mean powers: a power averaged over a cycle is gamma distributed about its mean.

The power of Gaussian noise over a cycle has a standard deviation that is a fixed part of its mean,
as the paper's third in (7); its law is the gamma law, of which the Gaussian of (7) is the limit of
many degrees of freedom. Maximum likelihood of the gamma law needs no more than that the mean and
that proportion are right (P. McCullagh, J. A. Nelder: Generalized Linear Models, 1989, chapter 8),
and the powers may contain the noise of the ground, whose mean is then a part of the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Gives the mean of each power and the derivatives of its logarithm, shapes (n,) and (n, p).
MeanPower = Callable[["NDArray[np.float64]"], tuple["NDArray[np.float64]", "NDArray[np.float64]"]]
_STEPS = 60
_DAMPING = (1e-3, 0.3, 4.0)  # at the start; after a step that helps, and after one that does not
_TOLERANCE = 1e-10
_OPEN = 1e-12  # of the information on one parameter over that on another


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The parameters at which powers are likeliest.

    Attributes
    ----------
    values
        Shape (p,).
    covariance
        Shape (p, p), by the expected Hessian; inf where the powers leave a parameter open.
    deviance
        Twice the log-likelihood lost against a mean for every power of its own, for a relative
        variance of 1.
    relative_sigma
        Standard deviation of a power over its mean, given or found.
    samples
        How many powers.
    """

    values: Array
    covariance: Array
    deviance: float
    relative_sigma: float
    samples: int

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood, less that of a mean for every power of its own."""
        return -self.deviance / (2 * self.relative_sigma**2)


def deviance(powers: Array, mean: Array) -> Array:
    """Return 2 (U / m - 1 - ln(U / m)) for each power; shapes that numpy joins."""
    ratio = powers / mean
    found: Array = 2 * (ratio - 1 - np.log(ratio))
    return found


def usable(powers: Array) -> NDArray[np.bool_]:
    """Return which powers a fit can take: those above 0, which a channel that is off is not."""
    return np.isfinite(powers) & (powers > 0)


def fit_powers(
    model: MeanPower, powers: Array, start: Array, relative_sigma: float | None = None
) -> Fitted:
    """Fit the mean of powers by Fisher scoring with damping.

    Parameters
    ----------
    model
        Of the mean.
    powers
        Shape (n,), above 0.
    start
        Shape (p,): where to start; scoring goes to the nearest maximum.
    relative_sigma
        Standard deviation of a power over its mean; None: from the residuals.

    Returns
    -------
    The maximum.
    """
    values = np.array(start, np.float64)
    damping, better, worse = _DAMPING
    mean, slopes = model(values)
    lost = float(deviance(powers, mean).sum())
    for _ in range(_STEPS):
        information = slopes.T @ slopes
        gradient = slopes.T @ (powers / mean - 1)
        ridge = damping * np.diag(np.diag(information) + _TOLERANCE)
        try:
            step = np.linalg.solve(information + ridge, gradient)
        except np.linalg.LinAlgError:  # too little damping, where a parameter is open
            step = np.full_like(values, np.nan)
        tried_mean, tried_slopes = model(values + step)
        tried = float(deviance(powers, tried_mean).sum())
        if not tried <= lost:  # NaN does not help either
            damping *= worse
            if damping > 1e8:
                break
            continue
        done = lost - tried <= _TOLERANCE * (1 + lost)
        values, mean, slopes, lost = values + step, tried_mean, tried_slopes, tried
        damping *= better
        if done:
            break
    return _finished(values, slopes, powers / mean - 1, lost, relative_sigma)


def _finished(
    values: Array, slopes: Array, off: Array, lost: float, relative_sigma: float | None
) -> Fitted:
    n, p = slopes.shape
    sigma = relative_sigma
    if sigma is None:
        sigma = float(np.sqrt(np.sum(off**2) / (n - p))) if n > p else float("inf")
        sigma = max(sigma, 1e-12)
    information = slopes.T @ slopes
    scale = np.sqrt(np.diag(information))
    covariance = np.full((p, p), np.inf)
    if scale.min() > _OPEN * max(float(scale.max()), 1.0):  # a vehicle of no strength has none
        alike = information / np.outer(scale, scale)
        if np.linalg.cond(alike) < 1 / _OPEN:
            covariance = np.linalg.inv(alike) / np.outer(scale, scale) * sigma**2
    return Fitted(values, covariance, lost, sigma, n)
