"""A place without calibration: arrivals grow with a power of distance, t = t0 + k d^p.

Source: the thesis on footstep localisation, equation (4.24): t grows with d^(4/3), and the constant
of the floor only scales it. So the moment t0 and the scale k are fitted along with the place, and
no velocity is needed. Huber's loss bounds what a late or false arrival may do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .arrival_fit import Model, lattice, moments, noise_s, search
from .location import LEAST_PICKS, Location, nowhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

EXPONENT = 4 / 3
#: Residuals beyond this many standard deviations count linearly.
HUBER = 1.345
#: Place, moment and scale: with fewer arrivals than this a curve of places fits equally well.
UNKNOWNS = 4


def locate(
    positions: Array,
    times_s: Array,
    outline: Array | None = None,
    exponent: float = EXPONENT,
    sigma_s: float = 5e-4,
    huber: float = HUBER,
) -> Location:
    """Return the place from which arrivals grow most nearly with a power of distance.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    exponent
        p; 4/3 on a thin plate, 1 where velocity is constant.
    sigma_s
        Standard deviation of an arrival [s]; the covariance reckons with at least that.
    huber
        Residuals beyond this many ``sigma_s`` count linearly; inf counts all squared.

    Returns
    -------
    The place; its residual is the root of the mean loss [s]. Up to four arrivals leave a curve of
    places that all fit: then the place is its middle.
    """
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    area = lattice(positions, outline, exponent)
    best = search(area, positions, times_s, Model(exponent, None, huber * sigma_s))
    noise = noise_s(best, picks, UNKNOWNS, sigma_s)
    mean, covariance = moments(area, best.losses * picks, noise)
    x, y = best.place if picks > UNKNOWNS else mean
    return Location(float(x), float(y), covariance, float(np.sqrt(best.loss)), picks)
