"""How a vehicle's seismic power falls with distance, how a geophone changes it, how it scatters.

Source: the paper, equations (1) to (4). Two are corrected here:

- (2) has the prefactor N0 / (2 r^2); the square of r^-0.5 in (1) is 1 / r. Only with it do (2) and
  an integral that falls as r^-0.5 make the r^-1.5 of (4).
- (3) has j 4 pi f xi and (2 pi f T)^2 with T = 1 / f0, which is off by 2 pi; it is 2 j xi f / f0
  and (f / f0)^2.

Nor does the integral fall as r^-0.5 but at one distance (a table is in docs/vehicles.md). And (3)
is a low-pass, while a geophone is a high-pass. So the exponent of the law (4) is a parameter.

Mean powers are fitted by the gamma law. The power of Gaussian noise over a cycle has a standard
deviation that is a fixed part of its mean, as the paper's third in (7); its law is the gamma law,
of which the Gaussian of (7) is the limit of many degrees of freedom. Maximum likelihood of the
gamma law needs no more than that the mean and that proportion are right (P. McCullagh, J. A.
Nelder: Generalized Linear Models, 1989, chapter 8), and the powers may contain the noise of the
ground, whose mean is then a part of the model.

Powers scatter about their mean alike at all stations or each by itself, and alike from cycle to
cycle or not. All stations detect a vehicle's own noise, so that where nothing fades they scatter
alike, and their ratio tells far more than each of them. Where paths interfere, each scatters by
itself, and for as long as a fade lasts. Which it is, is estimated from the powers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Exponent of (4). Source: NSTU, equation (4).
EXPONENT = 1.5
#: Points and weights of Gauss's quadrature within a cycle: a vehicle at speed is not in one place.
#: Chosen by judgement: three are exact for powers up to the fifth.
CYCLE_POINTS, CYCLE_WEIGHTS = np.polynomial.legendre.leggauss(3)
#: Distances are taken to be at least this [m]: the law has no end on top of a sensor. Chosen by
#: judgement: no vehicle is nearer to a sensor that survives.
NEAREST_M = 0.5
Kind = Literal["low-pass", "high-pass"]


def clamped(distance_m: Array) -> Array:
    """Return distances, each at least :data:`NEAREST_M`, any shape [m]."""
    return np.maximum(distance_m, NEAREST_M)


def ranges(places: Array, sensors: Array) -> Array:
    """Return clamped distances of places to sensors.

    Parameters
    ----------
    places
        Shape (..., 2) [m].
    sensors
        Shape (n, 2) [m].

    Returns
    -------
    Shape (..., n) [m].
    """
    return clamped(np.linalg.norm(places[..., None, :] - sensors, axis=-1))


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """Mean power at a distance, P = mu r^-n exp(-a r): (4), and the loss of (1) in a narrow band.

    Attributes
    ----------
    mu
        Energy parameter: power at 1 m without loss [unit^2 m^n].
    exponent
        n.
    loss_per_m
        a = 2 rho pi f of the band [1/m], see :func:`loss_per_m`.
    """

    mu: float = 1.0
    exponent: float = EXPONENT
    loss_per_m: float = 0.0

    def power(self, distance_m: Array) -> Array:
        """Return the mean power at distances of any shape, clamped [unit^2]."""
        r = clamped(distance_m)
        return self.mu * np.exp(-self.exponent * np.log(r) - self.loss_per_m * r)

    def slope(self, distance_m: Array) -> Array:
        """Return d ln P / d r [1/m]; 0 where the distance is clamped."""
        r = clamped(distance_m)
        return np.where(distance_m > NEAREST_M, -self.exponent / r - self.loss_per_m, 0.0)


def loss_per_m(loss_spm: float, frequency_hz: float) -> float:
    """Return a = 2 rho pi f, by which power of one frequency falls, twice that of (1) [1/m].

    Parameters
    ----------
    loss_spm
        rho of (1) [s/m].
    frequency_hz
        f [Hz].
    """
    return 2 * np.pi * loss_spm * frequency_hz


@dataclass(frozen=True, slots=True)
class Geophone:
    """An oscillator on the ground.

    Attributes
    ----------
    natural_hz
        f0 [Hz].
    damping
        xi, as a part of the critical.
    kind
        ``low-pass``: (3) as corrected. ``high-pass``: what a geophone makes of the ground's
        velocity, (f / f0)^2 times that.
    """

    natural_hz: float = 10.0
    damping: float = 0.7
    kind: Kind = "high-pass"

    def response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Return H(j 2 pi f) for numpy's sign of time, exp(+i w t); any shape.

        The low-pass is 1 at 0 Hz, the high-pass far above its natural frequency.
        """
        x = frequency_hz / self.natural_hz
        low = 1 / (1 + 2j * self.damping * x - x**2)
        transfer = low if self.kind == "low-pass" else -(x**2) * low
        return np.asarray(transfer, np.complex128)


#: Gives the mean of each power and the derivatives of its logarithm, shapes (n,) and (n, p).
MeanPower = Callable[["NDArray[np.float64]"], tuple["NDArray[np.float64]", "NDArray[np.float64]"]]
#: Steps of a damped fit at most; its damping; where a step gains so little, it ends. Chosen by
#: judgement: far more steps than it takes, and factors that neither stall nor jump.
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
    deviances: Array = 2 * (ratio - 1 - np.log(ratio))
    return deviances


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
        correlation = information / np.outer(scale, scale)
        if np.linalg.cond(correlation) < 1 / _OPEN:
            covariance = np.linalg.inv(correlation) / np.outer(scale, scale) * sigma**2
    return Fitted(values, covariance, lost, sigma, n)


#: Cycles with a mean above so many times the noise tell the scatter. Chosen by judgement: the
#: vehicle is then twice the noise; fewer cycles tell no variance, and no powers scatter by less
#: than a seventh or wholly alike.
_CLEAR = 3.0
_FEWEST = 20
_LEAST_VARIANCE = 0.02
_MOST_SHARED, _MOST_LASTING = 0.95, 0.8


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of powers about their mean.

    Attributes
    ----------
    variance
        Relative.
    shared
        Correlation between stations, where one vehicle is all that they hear.
    lasting
        Correlation from a cycle to the next.
    """

    variance: float = 0.15
    shared: float = 0.0
    lasting: float = 0.0

    @property
    def effective(self) -> float:
        """Variance by which as many independent cycles would tell as little."""
        return self.variance * (1 + self.lasting) / (1 - self.lasting)

    def correlation(self, parts: Array, valid: NDArray[np.bool_]) -> Array:
        """Return how alike stations scatter, shape (c, n, n).

        Parameters
        ----------
        parts
            Shape (v, c, n): part of the mean power that is each vehicle's.
        valid
            Shape (c, n): where there is a power.
        """
        correlations = self.shared * np.einsum("vci,vcj->cij", parts, parts)
        correlations[~(valid[:, :, None] & valid[:, None, :])] = 0
        diagonal = np.arange(valid.shape[1])
        correlations[:, diagonal, diagonal] = 1.0
        return np.asarray(correlations)


def cube_root_normalised(ratio: Array) -> Array:
    """Return 3 (ratio^(1/3) - 1), any shape: a gamma deviate becomes nearly Gaussian.

    E. B. Wilson, M. M. Hilferty: The distribution of chi-square, PNAS 17, 1931.
    """
    return np.asarray(3 * (np.cbrt(ratio) - 1))


def scatter_of(powers: Array, noise: Array, valid: NDArray[np.bool_], mean: Array) -> Scatter:
    """Return the scatter of powers about a mean, by quantiles.

    A few cycles in which the mean is wrong, as a vehicle lacks, tell little in it.

    Parameters
    ----------
    powers, noise
        Shape (c, n): noise included, and of the noise alone [unit^2].
    valid
        Shape (c, n): where there is a power.
    mean
        Shape (c, n) [unit^2].
    """
    clear = valid & (mean > _CLEAR * noise)
    off = np.where(clear, cube_root_normalised(np.where(clear, powers, 1.0) / mean), np.nan)
    if clear.sum() < _FEWEST:
        return Scatter()
    spread = _spread(off[clear])
    one, other = np.triu_indices(off.shape[1], 1)
    shared = _correlation(off[:, one].ravel(), off[:, other].ravel())
    variance = max(spread**2, _LEAST_VARIANCE)
    return Scatter(variance, float(np.clip(shared, 0, _MOST_SHARED)), autocorrelation(off))


def autocorrelation(off: Array) -> float:
    """Return how alike what is off the mean is from a cycle to the next, shape (c, n); 0 to 0.8."""
    return float(np.clip(_correlation(off[1:].ravel(), off[:-1].ravel()), 0, _MOST_LASTING))


def repeated(off: Array) -> float:
    """Return of how many cycles one tells as much as an independent one, shape (c, n); 1 to 9.

    What is off the mean may stay so for some cycles, as under fading.
    """
    lasting = autocorrelation(off)
    return (1 + lasting) / (1 - lasting)


def _spread(values: Array) -> float:
    low, high = np.percentile(values, [16, 84])
    return float(high - low) / 2


def _correlation(one: Array, other: Array) -> float:
    """Return the correlation of pairs, by the spreads of their sums and differences."""
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST:
        return 0.0
    sums, differences = _spread((one + other)[both]) ** 2, _spread((one - other)[both]) ** 2
    return float((sums - differences) / max(sums + differences, np.finfo(float).tiny))
