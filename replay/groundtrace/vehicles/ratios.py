"""The ratio of the powers of two sensors, in which the vehicle's strength does not matter.

Source: the paper, equations (10) to (15). The squared envelopes of two sensors, exponentially
distributed by fading, have the ratio s = p_n / p_l with the density theta / (1 + theta s)^2, (10).
Two things are corrected here:

- under (10), theta is (r_n / r_l)^n, one over the median of s, and not (r_l / r_n)^n;
- (14) has no square in its denominator, sum theta s / (1 + theta s) = K / 2; as printed no term
  exceeds 1/4 and no theta solves it.

The mean of s, which the paper's figure 1 shows beside, has no expectation; it is not offered. The
standard deviations of the logarithm are, over the root of the number of independent samples:
sqrt(3) of maximum likelihood, 2 of the median, pi / sqrt(3) of the geometric mean, sqrt(2) of the
ratio of the means, which is the best while power is stationary, and wrong while it is not alike
at both sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Method = Literal["likelihood", "median", "geometric", "means"]
#: Standard deviation of ln theta times the root of the number of independent samples.
DEVIATIONS: dict[Method, float] = {
    "likelihood": 3**0.5,
    "median": 2.0,
    "geometric": float(np.pi / 3**0.5),
    "means": 2**0.5,
}
#: A power that is less above the noise counts as if this part of it were the vehicle's.
_LEAST_SHARE = 0.2
_NEWTON = 20
_LONGEST = 2.0  # of a Newton step in ln theta


@dataclass(frozen=True, slots=True, eq=False)
class RatioEstimate:
    """Ratios of distances to the power n, of one pair of sensors or many.

    Attributes
    ----------
    log_theta
        ln theta, shape (...).
    log_sigma
        Its standard deviation, shape (...).
    count
        How many independent samples that reckons with, shape (...).
    """

    log_theta: Array
    log_sigma: Array
    count: Array

    @property
    def theta(self) -> Array:
        """(r_n / r_l)^n, shape (...)."""
        return np.exp(self.log_theta)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What is known of the noise in the powers of one cycle.

    Attributes
    ----------
    share
        Shape (n,): part of each sensor's power that is the vehicle's, from 0.2 to 1.
    sigma
        Shape (n,): standard deviation of the noise's power over the vehicle's.
    """

    share: Array
    sigma: Array

    @classmethod
    def of(cls, powers: Array, floors: Array, floor_sigmas: Array) -> Noise:
        """Return it for powers with the noise, that of the noise, and its standard deviation."""
        heard = np.maximum(powers, np.finfo(np.float32).tiny)
        share = np.clip(1 - floors / heard, _LEAST_SHARE, 1.0)
        return cls(share, floor_sigmas / (share * heard))

    def variance(self, count: Array) -> Array:
        """Return by how much taking the noise off raises the variance of ln of power, shape (n,).

        From P to P - F the variance P^2 / K counts (P / (P - F))^2 times, and that of F is added.
        """
        return np.asarray((self.share**-2 - 1) / count.mean() + self.sigma**2)


def without_noise(found: RatioEstimate, noise: Noise) -> RatioEstimate:
    """Return ratios of what the vehicle alone gives, from those of all that is heard.

    Parameters
    ----------
    found
        Of n - 1 sensors to a reference, shape (n - 1,).
    noise
        Of the n sensors, the reference first.
    """
    log_share, more = np.log(noise.share), noise.variance(found.count)
    sigma = np.sqrt(found.log_sigma**2 + more[1:] + more[0])
    return RatioEstimate(found.log_theta + log_share[0] - log_share[1:], sigma, found.count)


def sensor_sigmas(found: RatioEstimate, noise: Noise) -> Array:
    """Return the standard deviations of ln of each sensor's own power, shape (n,).

    Of independent sensors those of :func:`without_noise` are made up of; parameters as there.
    """
    own = 0.5 * float(np.mean(found.log_sigma**2))
    return np.sqrt(own + noise.variance(found.count))


def log_likelihood(log_theta: Array, log_s: Array) -> Array:
    """Return the logarithm of (11) less the part without theta.

    Parameters
    ----------
    log_theta
        Shape (...).
    log_s
        Shape (..., K).
    """
    terms = log_theta[..., None] - 2 * np.logaddexp(0, log_theta[..., None] + log_s)
    return np.asarray(terms.sum(axis=-1))


def by_likelihood(log_s: Array) -> Array:
    """Return ln theta of the maximum of (11): (14) as corrected, by Newton's method in ln theta.

    Parameters
    ----------
    log_s
        Shape (..., K): ln(p_n / p_l).

    Returns
    -------
    Shape (...).
    """
    log_theta = by_geometric_mean(log_s)
    for _ in range(_NEWTON):
        share = _share(log_theta, log_s)  # theta s / (1 + theta s)
        slope = (share * (1 - share)).mean(axis=-1)
        step = (0.5 - share.mean(axis=-1)) / np.maximum(slope, np.finfo(float).tiny)
        log_theta = log_theta + np.clip(step, -_LONGEST, _LONGEST)
    return log_theta


def by_median(log_s: Array) -> Array:
    """Return ln theta = -ln median(s), (15), shape (...) from (..., K)."""
    return np.asarray(-np.median(log_s, axis=-1))


def by_geometric_mean(log_s: Array) -> Array:
    """Return ln theta = -mean(ln s), closed and nearly as sure as the maximum of (11)."""
    return np.asarray(-log_s.mean(axis=-1))


def by_means(power_n: Array, power_l: Array) -> Array:
    """Return ln theta = ln(mean p_l / mean p_n), shape (...) from two of (..., K)."""
    return np.asarray(np.log(power_l.mean(axis=-1) / power_n.mean(axis=-1)))


def independent(log_theta: Array, log_s: Array) -> Array:
    """Return how many independent samples neighbouring ones are worth.

    K over one plus twice the sum of the autocorrelation of the score of (13), which is bounded, up
    to where it first falls below 0 (C. J. Geyer: Practical Markov chain Monte Carlo, 1992).

    Parameters
    ----------
    log_theta
        Shape (...).
    log_s
        Shape (..., K), evenly in time.

    Returns
    -------
    Shape (...), from 1 to K.
    """
    score = _share(log_theta, log_s) - 0.5
    score = score - score.mean(axis=-1, keepdims=True)
    k = score.shape[-1]
    spectrum = np.abs(np.fft.rfft(score, 2 * k, axis=-1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=-1)[..., :k]
    power = covariance[..., :1]
    alike = np.divide(covariance, power, out=np.zeros_like(covariance), where=power > 0)
    until = np.cumprod(alike > 0, axis=-1)
    length = 2 * (alike * until).sum(axis=-1) - 1
    return np.asarray(np.clip(k / np.maximum(length, 1.0), 1.0, k))


def _share(log_theta: Array, log_s: Array) -> Array:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * (log_theta[..., None] + log_s))))


def estimate(
    power_n: Array, power_l: Array, method: Method = "geometric", correlated: bool = True
) -> RatioEstimate:
    """Estimate theta = (r_n / r_l)^n from instantaneous powers of two sensors.

    Parameters
    ----------
    power_n, power_l
        Shapes that numpy joins to (..., K), above 0: squared envelopes at the same moments.
    method
        See :data:`DEVIATIONS`.
    correlated
        Whether neighbouring samples may be alike, as those of a band are; else K counts.

    Returns
    -------
    Estimates, shape (...).
    """
    tiny = np.finfo(float).tiny
    log_s = np.log(np.maximum(power_n, tiny)) - np.log(np.maximum(power_l, tiny))
    named: dict[Method, Callable[[], Array]] = {
        "likelihood": lambda: by_likelihood(log_s),
        "median": lambda: by_median(log_s),
        "geometric": lambda: by_geometric_mean(log_s),
        "means": lambda: by_means(power_n, power_l),
    }
    log_theta = named[method]()
    count = np.full(log_theta.shape, float(log_s.shape[-1]))
    if correlated:
        count = independent(log_theta, log_s)
    return RatioEstimate(log_theta, DEVIATIONS[method] / np.sqrt(count), count)
