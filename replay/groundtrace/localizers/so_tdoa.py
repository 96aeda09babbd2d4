"""SO-TDOA: a place from the signs of time differences alone.

Source: the thesis on footstep localisation, chapter 5: regions whose signs differ least from the
measured ones (5.5), and the mean of their centres (5.10). Nothing is presumed of the medium but
that a wave reaches the nearer of two sensors first.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from .location import LEAST_PICKS, Location, nowhere
from .outline import outline_of
from .regions import Regions, find_regions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Regions count less by this factor for every sign more that contradicts them; for the covariance.
#: The more signs contradict even the best region, the less one more sign says.
NEAR = 0.25
#: Distances of so many impacts times regions are held at once.
CELLS = 2_000_000


def locate(positions: Array, times_s: Array, outline: Array | None = None) -> Location:
    """Return the mean centre of the regions whose signs differ least from the measured ones.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.

    Returns
    -------
    The place; its residual is the part of the compared signs that differ.
    """
    return among(known_regions(positions, outline), times_s)


def known_regions(positions: Array, outline: Array | None = None) -> Regions:
    """Return the regions of a layout; the layouts used last are remembered."""
    positions = np.ascontiguousarray(positions, np.float64)
    corners = None if outline is None else np.ascontiguousarray(outline, np.float64).tobytes()
    return _regions(positions.tobytes(), corners)


@lru_cache(maxsize=8)
def _regions(positions: bytes, outline: bytes | None) -> Regions:
    sensors = np.frombuffer(positions).reshape(-1, 2)
    corners = None if outline is None else np.frombuffer(outline).reshape(-1, 2)
    return find_regions(sensors, outline_of(sensors, corners))


def among(regions: Regions, times_s: Array) -> Location:
    """Return the mean centre of the regions that fit the arrivals best, as :func:`locate`."""
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    signs, compared = measured_signs(regions, times_s)
    wrong = distances(regions, signs, compared)
    best = wrong == wrong.min()
    x, y = mean_of_nearest(regions, wrong)
    weight = regions.areas * NEAR ** ((wrong - wrong.min()) / (1 + wrong.min() / 2))
    covariance = spread(regions, weight, np.array([x, y]))
    residual = float(wrong.min()) / max(int(compared.sum()), 1)
    return Location(float(x), float(y), covariance, residual, picks, int(best.sum()))


def places(regions: Regions, times_s: Array) -> Array:
    """Return the places of many impacts, as :func:`among` does of one.

    Parameters
    ----------
    regions
        Of the room.
    times_s
        Shape (m, n): arrivals [s], all finite.

    Returns
    -------
    Shape (m, 2) [m].
    """
    rows = max(1, CELLS // max(len(regions), 1))
    blocks = (times_s[i : i + rows] for i in range(0, len(times_s), rows))
    found = [
        mean_of_nearest(regions, distances(regions, *measured_signs(regions, block)))
        for block in blocks
    ]
    return np.concatenate([np.empty((0, 2)), *found])


def mean_of_nearest(regions: Regions, wrong: Array) -> Array:
    """Return the mean of the centres of least distance (5.10), shape (..., 2) for (..., q)."""
    best = wrong == wrong.min(axis=-1, keepdims=True)
    mean: Array = best @ regions.centres / best.sum(axis=-1, keepdims=True)
    return mean


def measured_signs(regions: Regions, times_s: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return sign(t_i - t_j) of all pairs, and which of them are measured and tell regions apart.

    Two arrivals at the same time have the sign 0. Shape (..., n_pairs) for arrivals (..., n).
    """
    with np.errstate(invalid="ignore"):
        signs = np.sign(times_s[..., regions.first] - times_s[..., regions.second])
    compared = np.isfinite(signs) & regions.told
    return np.where(compared, signs, 0.0), compared


def distances(regions: Regions, signs: Array, compared: NDArray[np.bool_]) -> Array:
    """Return the Hamming distance (5.6) of each region over the compared pairs, shape (..., q).

    A sign of 0 is as far from +1 as from -1: it counts a half.
    """
    agreement = signs @ regions.across
    apart: Array = (compared.sum(axis=-1, keepdims=True) - agreement) / 2
    return apart


def spread(regions: Regions, weight: Array, about: Array) -> Array:
    """Return the mean square distance of weighted regions from a place, shape (2, 2) [m^2].

    A region counts with its centre and, as a square of its area would, with a twelfth of it.
    """
    share = weight / weight.sum()
    offset = regions.centres - about
    within = float(share @ regions.areas) / 12
    covariance: Array = (offset * share[:, None]).T @ offset + within * np.eye(2)
    return covariance
