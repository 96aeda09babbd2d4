"""Hyperbolic localisation: differences of arrivals times one velocity are those of distances.

Source: the thesis on footstep localisation, equation (5.14). The sum over all pairs of squares is
n times the sum of squares about the mean, so arrivals are fitted directly, with the moment of the
impact free.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import PipelineError
from .arrival_fit import (
    Model,
    distances,
    heard_by,
    in_blocks,
    lattice,
    moments,
    noise_s,
    search,
)
from .location import LEAST_PICKS, Location, nowhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Place and moment.
UNKNOWNS = 3


def locate(
    positions: Array,
    times_s: Array,
    velocity_mps: float,
    outline: Array | None = None,
    sigma_s: float = 5e-4,
) -> Location:
    """Return the place whose distances fit the arrivals best at a velocity.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    velocity_mps
        Calibrated velocity [m/s].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    sigma_s
        Standard deviation of an arrival that the covariance reckons with at least [s].

    Returns
    -------
    The place; its residual is the root mean square of what the arrivals are off [s].
    """
    heard = np.isfinite(times_s)
    picks = int(heard.sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    area = heard_by(lattice(positions, outline), heard)
    best = search(area, positions[heard], times_s[None, heard], Model(1.0, 1.0 / velocity_mps))
    noise = float(noise_s(best, picks, UNKNOWNS, sigma_s)[0])
    _, covariance = moments(area, best.losses[0] * picks, noise)
    x, y = best.places[0]
    return Location(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


def places(
    positions: Array, times_s: Array, velocity_mps: float, outline: Array | None = None
) -> Array:
    """Return the places of many impacts, shape (m, 2) [m], as :func:`locate` does of one.

    Parameters
    ----------
    positions, velocity_mps, outline
        As of :func:`locate`.
    times_s
        Shape (m, n): arrivals [s], all finite.
    """
    area, model = lattice(positions, outline), Model(1.0, 1.0 / velocity_mps)
    found = [search(area, positions, block, model).places for block in in_blocks(area, times_s)]
    return np.concatenate([np.empty((0, 2)), *found])


def calibrated_velocity(sources: Array, positions: Array, times_s: Array) -> float:
    """Return the velocity that best turns time differences into those of distances [m/s].

    Parameters
    ----------
    sources
        Shape (m, 2): places of controlled impacts [m].
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (m, n): arrivals [s]; NaN where there is none.

    Raises
    ------
    PipelineError
        Where the arrivals do not grow with distance.
    """
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isfinite(times_s), distances(sources, positions), np.nan)
    tau = times_s - np.nanmean(times_s, axis=1, keepdims=True)
    further = apart - np.nanmean(apart, axis=1, keepdims=True)
    along = float(np.nansum(tau * further))
    if not along > 0:
        raise PipelineError("calibration: expected arrivals that grow with distance, found others")
    return along / float(np.nansum(tau**2))
