"""How amplitude falls with distance: A = A0 d^-n exp(-alpha d), over many impacts at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

PASSES = 20
#: Residuals beyond so many standard deviations count linearly (Huber's loss).
HUBER = 1.345


@dataclass(frozen=True, slots=True)
class Attenuation:
    """A law of attenuation.

    Attributes
    ----------
    exponent, exponent_sigma
        n and its standard deviation; 1/3 for the maximum of a floor's bending wave ((4.25) of the
        thesis), 1/2 for a surface wave of one frequency, 1 for a body wave.
    loss_per_m, loss_sigma
        alpha and its standard deviation [1/m].
    scatter
        Robust standard deviation of ln A about the law: coupling and radiation pattern.
    correlation
        Of n and alpha: near -1 the distances are too alike to tell spreading from loss.
    samples
        How many amplitudes.
    """

    exponent: float
    exponent_sigma: float
    loss_per_m: float
    loss_sigma: float
    scatter: float
    correlation: float
    samples: int


def fit_attenuation(distances_m: Array, amplitudes: Array) -> Attenuation | None:
    """Fit one law to the amplitudes of many impacts, each with a strength of its own.

    Parameters
    ----------
    distances_m
        Shape (impacts, sensors) [m].
    amplitudes
        Shape (impacts, sensors), in any one unit; NaN or 0 where a sensor saw nothing.

    Returns
    -------
    The law, or None where fewer than two amplitudes of an impact, or fewer than four beyond the
    strengths, leave it open.
    """
    seen = np.isfinite(amplitudes) & (amplitudes > 0) & (distances_m > 0)
    seen &= seen.sum(axis=1, keepdims=True) >= 2
    impact, _ = np.nonzero(seen)
    free = len(impact) - len(np.unique(impact)) - 2
    if free < 2:
        return None
    logs = np.log(amplitudes[seen])
    terms = np.stack([-np.log(distances_m[seen]), -distances_m[seen]], axis=1)
    weights = np.ones(len(logs))
    for _ in range(PASSES):
        y, x = (_within(v, impact, weights) for v in (logs, terms))
        information = x.T @ (x * weights[:, None])
        if np.linalg.cond(information) > 1e12:
            return None
        law = np.linalg.solve(information, x.T @ (weights * y))
        off = y - x @ law
        scatter = max(1.4826 * float(np.median(np.abs(off))), 1e-9)
        scatter *= float(np.sqrt(len(logs) / (free + 2)))
        weights = np.minimum(1.0, HUBER * scatter / np.maximum(np.abs(off), 1e-12))
    covariance = np.linalg.inv(information) * scatter**2
    n_sigma, loss_sigma = np.sqrt(np.diag(covariance)).tolist()
    correlation = float(covariance[0, 1] / (n_sigma * loss_sigma))
    n, loss = law.tolist()
    return Attenuation(n, n_sigma, loss, loss_sigma, scatter, correlation, len(logs))


def _within(values: Array, group: NDArray[np.intp], weights: Array) -> Array:
    """Return values less the weighted mean of their group: each impact has its own strength."""
    shape = (group.max() + 1, *values.shape[1:])
    sums, totals = np.zeros(shape), np.zeros(shape[0])
    spread = weights if values.ndim == 1 else weights[:, None]
    np.add.at(sums, group, values * spread)
    np.add.at(totals, group, weights)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (sums.T / totals).T
    centred: Array = values - means[group]
    return centred
