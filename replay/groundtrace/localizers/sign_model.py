"""The Bernoulli model of sign errors: how likely each region makes the measured signs.

Source: the thesis on footstep localisation, section 5.3.2, with two corrections. The chance of a
wrong sign is (1 + erf(-|tau| / (sqrt 2 sigma))) / 2: (5.26) lacks the absolute value. And arrivals
err, not differences: sigma of a difference is sqrt 2 times that of an arrival, and as the
differences then hang together, the likelihood of N(N - 1)/2 signs is raised to the power 2 / N.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..physics.perceived import arrivals
from .location import LEAST_PICKS, Location, nowhere
from .so_tdoa import distances, measured_signs, spread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .regions import Regions

    Array = NDArray[np.float64]


def chance_wrong(
    times_s: Array, first: NDArray[np.intp], second: NDArray[np.intp], sigma_s: float
) -> Array:
    """Return the chance of each sign of a time difference to be measured wrong, (5.26) corrected.

    Parameters
    ----------
    times_s
        Shape (..., n): true arrivals [s].
    first, second
        Shape (n_pairs,): sensors of each pair.
    sigma_s
        Standard deviation of a difference [s]: sqrt 2 times that of an arrival.

    Returns
    -------
    Shape (..., n_pairs), at most 0.5.
    """
    from scipy.special import ndtr

    chance: Array = ndtr(-np.abs(times_s[..., first] - times_s[..., second]) / sigma_s)
    return chance


def likeliest(regions: Regions, times_s: Array, theta_s: float, sigma_s: float) -> Location:
    """Return the mean of all regions, weighted by area and likelihood of the signs.

    Parameters
    ----------
    regions
        Of the room.
    times_s
        Shape (n,): arrivals [s]; NaN where a sensor has none.
    theta_s
        Time scale of the velocity law (4.25) [s].
    sigma_s
        Standard deviation of an arrival [s].

    Returns
    -------
    The place; its residual is the part of the signs that the likeliest region contradicts.
    """
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    signs, compared = measured_signs(regions, times_s)
    right = _chance_right(regions, theta_s, sigma_s)
    agree = regions.signs * signs
    logs = np.where(agree > 0, np.log(right), np.log1p(-right)) * np.abs(agree)
    level = logs.sum(axis=1) * 2 / picks
    weight = regions.areas * np.exp(level - level.max())
    x, y = weight @ regions.centres / weight.sum()
    wrong = distances(regions, signs, compared)[int(np.argmax(level))]
    residual = float(wrong) / max(int(compared.sum()), 1)
    about = np.array([x, y])
    return Location(float(x), float(y), spread(regions, weight, about), residual, picks)


def _chance_right(regions: Regions, theta_s: float, sigma_s: float) -> Array:
    """Return the chance of each sign to be measured right, shape (q, n_pairs); at most 1 - 1e-3."""
    apart = np.linalg.norm(regions.centres[:, None] - regions.sensors, axis=2)
    times = arrivals(apart, theta_s)
    wrong = chance_wrong(times, regions.first, regions.second, np.sqrt(2) * sigma_s)
    return 1 - np.maximum(wrong, 1e-3)
