"""A place without calibration: arrivals grow with a power of distance, t = t0 + k d^p.

Source: the thesis on footstep localisation, equation (4.24): t grows with d^(4/3), and the constant
of the floor only scales it. So the moment t0 and the scale k are fitted along with the place, and
no velocity is needed. Huber's loss bounds what a late or false arrival may do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .arrival_fit import Model, heard_by, in_blocks, lattice, moments, noise_s, search, shares
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
    heard = np.isfinite(times_s)
    picks = int(heard.sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    area = heard_by(lattice(positions, outline, exponent), heard)
    model = Model(exponent, None, huber * sigma_s)
    best = search(area, positions[heard], times_s[None, heard], model)
    noise = float(noise_s(best, picks, UNKNOWNS, sigma_s)[0])
    mean, covariance = moments(area, best.losses[0] * picks, noise)
    x, y = best.places[0] if picks > UNKNOWNS else mean
    return Location(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


def places(
    positions: Array,
    times_s: Array,
    outline: Array | None = None,
    exponent: float = EXPONENT,
    sigma_s: float = 5e-4,
) -> Array:
    """Return the places of many impacts, shape (m, 2) [m], as :func:`locate` with huber = inf.

    Least squares cost a product of arrays for all impacts, any threshold an array for each.

    Parameters
    ----------
    positions, outline, exponent, sigma_s
        As of :func:`locate`.
    times_s
        Shape (m, n): arrivals [s], all finite.
    """
    area, model = lattice(positions, outline, exponent), Model(exponent)
    picks, found = len(positions), [np.empty((0, 2))]
    for block in in_blocks(area, times_s):
        best = search(area, positions, block, model)
        if picks > UNKNOWNS:
            found.append(best.places)
        else:
            noise = noise_s(best, picks, UNKNOWNS, sigma_s)
            found.append(shares(best.losses * picks, noise) @ area.nodes)
    return np.concatenate(found)
