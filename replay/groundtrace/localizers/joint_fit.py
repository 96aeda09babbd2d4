"""All impacts at once: one floor, t_ij = t0_i + k d_ij^p + o_j, and the place of every impact.

What an impact owns (its moment and, where unknown, its place) is eliminated impact by impact, so
that a fit of many impacts costs little more than the small system of what they share: the pace of
the floor, its exponent, and the clock offset of every sensor. Robust losses are reached by
reweighting (P. J. Huber, E. M. Ronchetti: Robust Statistics, 2009, section 7.8), steps are those
of Levenberg and Marquardt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .floor import Floor, Prior
from .joint_system import Point, cost_of, normal_equations, point_at, used

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Loss = Literal["huber", "soft-l1", "cauchy", "trimmed"]
LOSSES: tuple[Loss, ...] = ("huber", "soft-l1", "cauchy", "trimmed")
#: Weight of a residual, in standard deviations; the constants give 95 % efficiency, the trimmed
#: loss drops what a normal law gives once in 150.
WEIGHTS: dict[Loss, Callable[[Array], Array]] = {
    "huber": lambda z: 1.345 / np.maximum(np.abs(z), 1.345),
    "soft-l1": lambda z: 1 / np.sqrt(1 + (z / 1.345) ** 2),
    "cauchy": lambda z: 1 / (1 + (z / 2.385) ** 2),
    "trimmed": lambda z: (np.abs(z) <= 2.7).astype(np.float64),
}
#: Reweightings, steps within each, and the relative gain below which steps end.
ROUNDS, STEPS, GAIN = 12, 6, 1e-6
#: A sigma is never estimated below this [s].
LEAST_SIGMA_S = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Impacts:
    """Arrivals of several impacts at the same sensors.

    Attributes
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (m, n) [s], each row from any origin; NaN where a sensor has no arrival.
    bounds
        Shape (2, 2): lowest and highest x and y that a place may have [m].
    known
        Shape (m, 2): places of controlled impacts [m]; None where they are unknown.
    """

    positions: Array
    times_s: Array
    bounds: Array
    known: Array | None = None

    def rows(self, index: NDArray[np.intp]) -> Impacts:
        """Return some of the impacts, in the order of ``index``."""
        known = None if self.known is None else self.known[index]
        return Impacts(self.positions, self.times_s[index], self.bounds, known)

    @property
    def owned(self) -> int:
        """How many unknowns each impact owns: its moment, and its place where unknown."""
        return 1 if self.known is not None else 3


@dataclass(frozen=True, slots=True)
class Free:
    """Which of the shared unknowns are estimated; the pace always is."""

    exponent: bool = True
    offsets: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """A fit of all impacts.

    Attributes
    ----------
    floor
        What the impacts share.
    places
        Shape (m, 2) [m].
    residuals_s
        Shape (m, n) [s]; NaN where a sensor has no arrival.
    weights
        Shape (m, n): what the loss made of each arrival, 0 to 1.
    sigma_s
        Standard deviation of an arrival, robust [s].
    covariance
        Shape (2 + n, 2 + n): of log pace, exponent, and offsets [s]; 0 where they are not
        estimated, inf on the diagonal where nothing determines them.
    free
        Which were estimated.
    """

    floor: Floor
    places: Array
    residuals_s: Array
    weights: Array
    sigma_s: float
    covariance: Array
    free: Free

    @property
    def deviations(self) -> Array:
        """Standard deviations of log pace, exponent, offsets [s], shape (2 + n,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(
    impacts: Impacts,
    start: Floor,
    places: Array,
    *,
    loss: Loss = "huber",
    free: Free | None = None,
    prior: Prior | None = None,
    rounds: int = ROUNDS,
) -> JointFit:
    """Fit the floor and all places together.

    Parameters
    ----------
    impacts
        The arrivals; impacts with fewer than their own unknowns of them add nothing.
    start
        Floor to start from.
    places
        Shape (m, 2): places to start from [m]; the known ones stay.
    loss
        What bounds the influence of late and false arrivals.
    free
        What is estimated beside the pace.
    prior
        What is known of pace and exponent beforehand.
    rounds
        Reweightings at most.
    """
    free, prior = free or Free(), prior or Prior()
    heard = np.isfinite(impacts.times_s)
    given = places if impacts.known is None else impacts.known
    point = point_at(impacts, heard, start, np.array(given, np.float64), heard.astype(np.float64))
    sigma = _sigma(impacts, point, heard, free)
    weight = heard.astype(np.float64)
    for _ in range(rounds):
        weight = heard * WEIGHTS[loss](point.residuals / sigma)
        before = point.floor
        point = _steps(impacts, point, weight, sigma, free, prior)
        sigma_before, sigma = sigma, _sigma(impacts, point, heard, free)
        if before.near(point.floor) and abs(sigma / sigma_before - 1) < 1e-3:
            break
    covariance = _covariance(impacts, point, weight, sigma, free, prior)
    residuals = np.where(heard, point.residuals, np.nan)
    return JointFit(point.floor, point.places, residuals, weight, sigma, covariance, free)


def _sigma(impacts: Impacts, point: Point, heard: NDArray[np.bool_], free: Free) -> float:
    """Return the standard deviation of an arrival by the median size of the residuals [s]."""
    count = int(heard.sum())
    shared = 1 + free.exponent + free.offsets * (heard.shape[1] - 1)
    enough = heard.sum(axis=1) >= impacts.owned
    left = max(1, count - impacts.owned * int(enough.sum()) - shared)
    size = float(np.median(np.abs(point.residuals[heard]))) if count else 0.0
    # every unknown takes away as much scatter as an arrival brings
    return max(LEAST_SIGMA_S, size / 0.6745 * float(np.sqrt(count / left)))


def _steps(
    impacts: Impacts, point: Point, weight: Array, sigma: float, free: Free, prior: Prior
) -> Point:
    """Take steps of Levenberg and Marquardt at fixed weights."""
    damping, cost = 1e-3, cost_of(point, weight, sigma, prior)
    for _ in range(STEPS):
        system = normal_equations(impacts, point, weight, sigma, free, prior)
        floor, places = system.step(point, free, damping)
        if impacts.known is None:  # a room is no more than a bound, yet a strong one
            places = np.clip(places, *impacts.bounds)
        trial = point_at(impacts, weight > 0, floor, places, weight)
        reached = cost_of(trial, weight, sigma, prior)
        if not reached < cost:
            damping *= 10
            continue
        gain, point, cost = cost - reached, trial, reached
        damping /= 10
        if gain < GAIN * cost:
            break
    return point


def _covariance(
    impacts: Impacts, point: Point, weight: Array, sigma: float, free: Free, prior: Prior
) -> Array:
    """Return the covariance of what is shared, shape (2 + n, 2 + n); inf where undetermined."""
    matrix, *_ = normal_equations(impacts, point, weight, sigma, free, prior).reduced(0.0)
    shared = used(free, len(point.floor.offsets_s))
    inner = matrix[np.ix_(shared, shared)]
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    values, vectors = np.linalg.eigh(inner / np.outer(size, size))
    known = values > 1e-9
    spread = (vectors[:, known] / values[known]) @ vectors[:, known].T
    unknown = (vectors[:, ~known] ** 2).sum(axis=1) > 1e-6
    out = np.zeros((len(matrix), len(matrix)))
    out[np.ix_(shared, shared)] = spread / np.outer(size, size)
    out[shared[unknown], shared[unknown]] = np.inf
    return out
