"""Where a joint fit starts: a pace by trial, places on a lattice, offsets by what is left over."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .arrival_fit import Model, distances, heard_by, lattice, losses, search
from .floor import EXPONENT, Floor, reference_distance
from .joint_fit import Free, fit
from .location import LEAST_PICKS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .joint_fit import Impacts, JointFit

    Array = NDArray[np.float64]

#: Paces tried, and the largest of them over the smallest.
PACES, SPAN = 14, 16.0
#: Impacts that the trial of paces looks at, and those that the first fit does, out of all.
TRIED, STARTED = 24, 40
#: With unknown clocks: factors of the pace tried, and how often places are sought anew.
FACTORS, ALTERNATIONS = (0.5, 0.7, 1.0, 1.4, 2.0), 4


def bounds_of(positions: Array, outline: Array | None) -> Array:
    """Return the lowest and highest x and y of the room, shape (2, 2) [m]."""
    corners = np.array(lattice(positions, outline).room.bounds)
    return corners.reshape(2, 2)


def places_on(
    impacts: Impacts, floor: Floor, outline: Array | None, threshold_s: float = float("inf")
) -> Array:
    """Return the places that fit a floor best, shape (m, 2) [m]; the middle where too few arrive.

    Parameters
    ----------
    impacts
        The arrivals.
    floor
        Pace, exponent and offsets, as given.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    threshold_s
        Residuals beyond it count linearly [s].
    """
    area = lattice(impacts.positions, outline)
    area = replace(area, u=area.u**floor.exponent)
    model = Model(floor.exponent, floor.scale, threshold_s)
    times, heard = impacts.times_s - floor.offsets_s, np.isfinite(impacts.times_s)
    found = np.tile(impacts.positions.mean(axis=0), (len(times), 1))
    patterns, which = np.unique(heard, axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        rows = np.flatnonzero(which.reshape(-1) == index)
        if pattern.sum() >= LEAST_PICKS:
            here = heard_by(area, pattern), impacts.positions[pattern]
            # a row at a time: a threshold holds an array for each
            for row in rows:
                found[row] = search(*here, times[None, row, pattern], model).places[0]
    return found


def first_pace(
    impacts: Impacts,
    outline: Array | None,
    exponent: float = EXPONENT,
    threshold_s: float = float("inf"),
) -> float:
    """Return the pace of those tried with which the arrivals fit best [s], clocks being right.

    No pace can be smaller than the spread of arrivals over that of distances allows.
    """
    area = lattice(impacts.positions, outline)
    reference = reference_distance(impacts.positions)
    u = (area.u / reference) ** exponent
    enough = np.flatnonzero(np.isfinite(impacts.times_s).sum(axis=1) > LEAST_PICKS)
    rows = enough[:: max(1, -(-len(enough) // TRIED))]
    spread = np.nanmax(impacts.times_s[rows], axis=1) - np.nanmin(impacts.times_s[rows], axis=1)
    least = 0.5 * float(np.median(spread)) / float(np.ptp(u, axis=0).max())
    tried = least * SPAN ** np.linspace(0, 1, PACES)
    cost = [_misfit(impacts.times_s[rows], u, Model(1.0, pace, threshold_s)) for pace in tried]
    return float(tried[int(np.argmin(cost))])


def _misfit(times_s: Array, u: Array, model: Model) -> float:
    """Return the median over impacts of the least loss of any node [s^2]."""
    heard = np.isfinite(times_s)
    best = [
        float(losses(u[own], row[None, own], model).min())
        for row, own in zip(times_s, heard, strict=True)
    ]
    return float(np.median(best))


def start(
    impacts: Impacts,
    outline: Array | None,
    *,
    offsets: bool = False,
    exponent: float = EXPONENT,
) -> JointFit:
    """Return a first fit of impacts of which nothing is known.

    Parameters
    ----------
    impacts
        The arrivals.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    offsets
        Whether the clocks may differ. They may differ by more than waves take, so that the pace
        is tried about the one that makes arrivals scatter as places in the room would.
    exponent
        The exponent, kept.
    """
    enough = np.flatnonzero(np.isfinite(impacts.times_s).sum(axis=1) > LEAST_PICKS)
    some = impacts.rows(enough[:: max(1, -(-len(enough) // STARTED))])
    floor = _first_floor(some, outline, exponent, offsets=offsets)
    places = places_on(impacts, floor, outline)
    return fit(impacts, floor, places, free=Free(exponent=False, offsets=offsets))


def known_start(impacts: Impacts, *, offsets: bool = False, exponent: float = EXPONENT) -> JointFit:
    """Return a first fit of impacts whose places are known: at a given exponent it is linear."""
    assert impacts.known is not None
    reference = reference_distance(impacts.positions)
    heard = np.isfinite(impacts.times_s)
    u = np.where(heard, distances(impacts.known, impacts.positions) / reference, np.nan)
    farther = u**exponent - np.nanmean(u**exponent, axis=1, keepdims=True)
    late = impacts.times_s - np.nanmean(impacts.times_s, axis=1, keepdims=True)
    square = float(np.nansum(farther**2))
    # arrivals that do not grow with distance leave a pace too small to matter
    pace = max(float(np.nansum(farther * late)) / max(square, 1e-12), 1e-6)
    floor = Floor(reference, pace, exponent, np.zeros(len(impacts.positions)))
    free = Free(exponent=False, offsets=offsets)
    return fit(impacts, floor, impacts.known, free=free)


def _first_floor(
    impacts: Impacts, outline: Array | None, exponent: float, *, offsets: bool
) -> Floor:
    still = Free(exponent=False, offsets=offsets)
    kind = _unclocked if offsets else _clocked
    tried = kind(impacts, outline, exponent)
    found = []
    for floor in tried:
        current = fit(impacts, floor, places_on(impacts, floor, outline), free=still, rounds=3)
        for _ in range(ALTERNATIONS if offsets else 0):
            again = places_on(impacts, current.floor, outline, 1.345 * current.sigma_s)
            current = fit(impacts, current.floor, again, free=still, rounds=3)
        found.append(current)
    return min(found, key=lambda one: one.sigma_s).floor


def _clocked(impacts: Impacts, outline: Array | None, exponent: float) -> list[Floor]:
    pace = first_pace(impacts, outline, exponent)
    reference = reference_distance(impacts.positions)
    return [Floor(reference, pace, exponent, np.zeros(len(impacts.positions)))]


def _unclocked(impacts: Impacts, outline: Array | None, exponent: float) -> list[Floor]:
    """Return floors whose paces lie about that of the scatter, each with its offsets."""
    reference = reference_distance(impacts.positions)
    u = (lattice(impacts.positions, outline).u.T / reference) ** exponent
    late, scatter = _scatter(impacts.times_s)
    farther, apart = _scatter(u)
    floors = []
    for factor in FACTORS:
        pace = factor * scatter / apart
        ahead = late - pace * farther
        floors.append(Floor(reference, pace, exponent, ahead - ahead.mean()))
    return floors


def _scatter(rows: Array) -> tuple[Array, float]:
    """Return the median of each column less the row's mean, shape (n,), and what is left over."""
    left = rows - np.nanmean(rows, axis=1, keepdims=True)
    column = np.nanmedian(left, axis=0)
    return column, float(np.nanmedian(np.abs(left - column)))
