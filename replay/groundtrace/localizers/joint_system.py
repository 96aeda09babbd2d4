"""The normal equations of a joint fit: what impacts own, what they share, and a step of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .floor import Floor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .floor import Prior
    from .joint_fit import Free, Impacts

    Array = NDArray[np.float64]

#: Exponents a fit may try.
EXPONENTS = (0.4, 2.5)
#: Distances count as at least this part of the reference: beside a sensor the slope has no limit.
NEAREST = 1e-3


@dataclass(slots=True)
class Point:
    """Where a fit stands: the floor, places (m, 2) [m], residuals (m, n) [s] with 0 for none."""

    floor: Floor
    places: Array
    residuals: Array


def point_at(
    impacts: Impacts, heard: NDArray[np.bool_], floor: Floor, places: Array, weight: Array
) -> Point:
    """Return where a floor and places leave the arrivals, about the best moments under weights."""
    travel = floor.travel_s(_distances(impacts, floor, places)) + floor.offsets_s
    left = np.where(heard, np.nan_to_num(impacts.times_s) - travel, 0.0)
    moment = (weight * left).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-12)
    return Point(floor, places, np.where(heard, left - moment[:, None], 0.0))


def _distances(impacts: Impacts, floor: Floor, places: Array) -> Array:
    apart = places[:, None, :] - impacts.positions
    return np.maximum(np.hypot(apart[..., 0], apart[..., 1]), NEAREST * floor.reference_m)


def cost_of(point: Point, weight: Array, sigma: float, prior: Prior) -> float:
    """Return the weighted squares of residuals and prior, in units of sigma."""
    pull = _pull(point.floor, prior)
    return float((weight * point.residuals**2).sum()) / sigma**2 + float(pull @ pull)


def _pull(floor: Floor, prior: Prior) -> Array:
    """Return how far pace and exponent are from the prior, in its deviations, shape (2,).

    An exponent of deviation 0 is kept, and so is nowhere else.
    """
    kept = prior.exponent_deviation == 0
    off = 0.0 if kept else (floor.exponent - prior.exponent) / prior.exponent_deviation
    return np.array([np.log(floor.pace_s / prior.pace_s) / prior.pace_deviation, off])


@dataclass(slots=True)
class System:
    """Normal equations: of each impact's own unknowns, of the shared ones, and across.

    ``own`` has shape (m, a, a), ``across`` (m, a, s), ``shared`` (s, s); ``own_side`` (m, a) and
    ``shared_side`` (s,) are the right-hand sides.
    """

    own: Array
    across: Array
    shared: Array
    own_side: Array
    shared_side: Array

    def reduced(self, damping: float) -> tuple[Array, Array, Array, Array]:
        """Return matrix and right-hand side of the shared unknowns, the own ones eliminated.

        And what brings the own ones back: the own right-hand side and the coupling, solved.
        """
        size = self.own.shape[1]
        ridge = np.einsum("maa->ma", self.own) * (damping + 1e-12) + 1e-12
        own = self.own + ridge[:, :, None] * np.eye(size)
        solved = np.linalg.solve(own, np.concatenate([self.own_side[..., None], self.across], 2))
        side, coupling = solved[..., 0], solved[..., 1:]
        matrix = self.shared - np.einsum("mas,mat->st", self.across, coupling)
        right = self.shared_side - np.einsum("mas,ma->s", self.across, side)
        return matrix, right, side, coupling

    def step(self, point: Point, free: Free, damping: float) -> tuple[Floor, Array]:
        """Return the floor and the places one damped step on."""
        matrix, right, side, coupling = self.reduced(damping)
        floor, free_ones = point.floor, used(free, len(point.floor.offsets_s))
        inner = matrix[np.ix_(free_ones, free_ones)]
        inner = inner + damping * np.diag(np.diag(inner)) + 1e-12 * np.eye(len(free_ones))
        moved = np.zeros(len(matrix))
        moved[free_ones] = np.linalg.solve(inner, right[free_ones])
        own = side - coupling @ moved
        places = point.places if own.shape[1] == 1 else point.places + _held(own[:, 1:], floor)
        offsets = floor.offsets_s + moved[2:]
        stepped = Floor(
            floor.reference_m,
            float(floor.pace_s * np.exp(np.clip(moved[0], -1, 1))),
            float(np.clip(floor.exponent + np.clip(moved[1], -0.5, 0.5), *EXPONENTS)),
            offsets - offsets.mean() if free.offsets else offsets,
        )
        return stepped, places


def _held(moves: Array, floor: Floor) -> Array:
    """Return moves of places, none farther than half the reference."""
    length = np.hypot(moves[:, 0], moves[:, 1])
    allowed = np.minimum(1.0, 0.5 * floor.reference_m / np.maximum(length, 1e-12))
    held: Array = moves * allowed[:, None]
    return held


def used(free: Free, sensors: int) -> NDArray[np.intp]:
    """Return the indices of the shared unknowns that are estimated."""
    mask = np.concatenate([[True, free.exponent], np.full(sensors, free.offsets)])
    return np.flatnonzero(mask)


def normal_equations(
    impacts: Impacts, point: Point, weight: Array, sigma: float, free: Free, prior: Prior
) -> System:
    """Return the normal equations of the linearised arrivals, in units of sigma."""
    own, shared = _slopes(impacts, point)
    scaled = weight / sigma**2
    weighted_own, weighted_shared = own * scaled[..., None], shared * scaled[..., None]
    matrix = np.einsum("mns,mnt->st", shared, weighted_shared)
    side = np.einsum("mns,mn->s", weighted_shared, point.residuals)
    deviation = np.array([prior.pace_deviation, prior.exponent_deviation])
    # an exponent of deviation 0 is none of the unknowns
    precision = np.where(deviation > 0, deviation, np.inf) ** -2.0
    matrix[:2, :2] += np.diag(precision)
    side[:2] -= _pull(point.floor, prior) * np.sqrt(precision)
    if free.offsets:
        # a common offset is a shift of all moments: the sum of the offsets stays 0
        matrix[2:, 2:] += matrix[2:, 2:].trace() / len(matrix[2:])
    return System(
        np.einsum("mna,mnb->mab", own, weighted_own),
        np.einsum("mna,mns->mas", own, weighted_shared),
        matrix,
        np.einsum("mna,mn->ma", weighted_own, point.residuals),
        side,
    )


def _slopes(impacts: Impacts, point: Point) -> tuple[Array, Array]:
    """Return the derivatives of arrivals by own, (m, n, a), and shared unknowns, (m, n, s)."""
    floor, (m, n) = point.floor, point.residuals.shape
    apart = _distances(impacts, floor, point.places)
    travel = floor.travel_s(apart)
    shared = np.zeros((m, n, 2 + n))
    shared[..., 0] = travel
    shared[..., 1] = travel * np.log(apart / floor.reference_m)
    shared[:, np.arange(n), 2 + np.arange(n)] = 1.0
    own = np.ones((m, n, impacts.owned))
    if impacts.known is None:
        slope = floor.exponent * travel / apart**2
        own[..., 1:] = slope[..., None] * (point.places[:, None] - impacts.positions)
    return own, shared
