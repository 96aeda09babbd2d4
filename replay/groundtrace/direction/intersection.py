"""The place where bearings cross, by the sum of distances to their lines.

Source: the thesis on footstep localisation, equations (A.10) and (A.11), in the norms L1, which
bears outliers, and L2, which averages noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from ..localizers.location import Location, nowhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Norm = Literal["l1", "l2"]
PASSES = 30
#: Lines whose directions differ by less cross nowhere in particular: a condition number.
MAX_CONDITION = 1e4
#: Distances below count as this one in the weights [m].
LEAST_M = 1e-3


def intersect(positions: Array, azimuths_rad: Array, sigmas_rad: Array, norm: Norm) -> Location:
    """Return the place nearest to all bearings.

    Parameters
    ----------
    positions
        Shape (n, 2): stations [m].
    azimuths_rad
        Shape (n,): bearings [rad]; NaN where a station has none. The sense along the line does
        not matter, so that an ambiguity of pi does no harm.
    sigmas_rad
        Shape (n,): their standard deviations [rad].
    norm
        ``l1`` or ``l2`` of the distances to the lines, each over its own error.

    Returns
    -------
    The place, with the covariance by the bearings' errors there, and as residual the root mean
    square of what the bearings are off [rad]. Nowhere with fewer than two bearings, or parallel.
    """
    known = np.isfinite(azimuths_rad)
    count = int(known.sum())
    if count < 2:
        return nowhere(count)
    stations, azimuths = positions[known], azimuths_rad[known]
    sigmas = np.maximum(sigmas_rad[known], 1e-3)
    normals = np.stack([-np.sin(azimuths), np.cos(azimuths)], axis=1)
    offsets = np.sum(normals * stations, axis=1)
    if np.linalg.cond(normals.T @ normals) > MAX_CONDITION:
        return nowhere(count)
    place = np.linalg.lstsq(normals, offsets, rcond=None)[0]
    for _ in range(PASSES):
        errors = sigmas * np.maximum(np.hypot(*(stations - place).T), LEAST_M)
        weights = 1 / errors**2
        if norm == "l1":
            weights /= np.maximum(np.abs(normals @ place - offsets) / errors, 1e-6)
        information = normals.T @ (normals * weights[:, None])
        moved = np.linalg.solve(information, normals.T @ (weights * offsets))
        if np.hypot(*(moved - place)) < LEAST_M:
            break
        place = moved
    return _located(place, stations, normals, sigmas)


def _located(place: Array, stations: Array, normals: Array, sigmas: Array) -> Location:
    away = place - stations
    errors = sigmas * np.maximum(np.hypot(*away.T), LEAST_M)
    covariance = np.linalg.inv(normals.T @ (normals / errors[:, None] ** 2))
    along = np.abs(away[:, 0] * normals[:, 1] - away[:, 1] * normals[:, 0])
    off = np.arctan2(np.abs(np.sum(normals * away, axis=1)), along)
    residual = float(np.sqrt(np.mean(off**2)))
    return Location(float(place[0]), float(place[1]), covariance, residual, len(stations))
