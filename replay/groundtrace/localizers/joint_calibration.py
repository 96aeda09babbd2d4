"""A localizer that calibrates the floor while people walk: one k and p for all impacts so far.

A single location leaves the scale k free for every impact, so that four sensors have as many
unknowns as times. The floor is the same under all impacts: with k and p estimated over those so
far, four sensors have one arrival to spare, and more of them locate as well as with a calibrated
floor.

All impacts are fitted at once: one floor, t_ij = t0_i + k d_ij^p + o_j, and the location of every
impact. What belongs to one impact (its time and, where unknown, its location) is eliminated impact
by impact, so that a fit of many impacts costs little more than the small system of what they share:
the pace of the floor, its exponent, and the clock offset of every sensor. Robust losses are reached
by reweighting (P. J. Huber, E. M. Ronchetti: Robust Statistics, 2009, section 7.8), steps are those
of Levenberg and Marquardt.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..dsp.robust import CAUCHY, HUBER, medians
from ..pipeline.stage import LEAST_PICKS, LocationEstimate, no_location
from . import tdoa
from .base import EXPONENT, ArrivalModel, ArrivalPrior, reference_distance
from .tdoa import Model, distances, for_sensors, lattice, losses, posterior, search

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Medium

    Array = NDArray[np.float64]

#: An impact tells of the floor what its own three unknowns leave over. Source: definition, one more
#: than those.
TELLING = 4
#: Reweightings with each impact: the fit goes on from the one before. Chosen by judgement: a second
#: one changes little and costs as much.
ROUNDS_EACH = 1
#: The floor is estimated anew when one in so many of the impacts is new. Chosen by judgement: it
#: bounds the cost of an impact however many there are.
RENEWAL = 4
#: A pace known to this is taken as it is. Chosen by judgement: three paces are then not worth three
#: times the work.
SURE = 0.05
#: The paces a place is averaged over: three points that have the moments of a normal law, by
#: deviations from the best one, and their weights. Source: definition: Gauss-Hermite quadrature of
#: three points.
ABSCISSA, WEIGHTS = 3**0.5, (2 / 3, 1 / 6, 1 / 6)
#: How far a floor may stray from the one that the geometry names, of the logarithm of its pace.
#: Chosen by judgement: what is stated is trusted, but not against many arrivals.
KNOWN_DEVIATION = 0.1
#: How far the pace may stray from the one that scatters the arrivals as impacts all over the room
#: would, of its logarithm. Without it arrivals of four sensors that no pace explains are explained
#: best by impacts in the middle and waves that are endlessly slow. Chosen by judgement: people keep
#: to a part of a room.
SCATTER_DEVIATION = 0.7
#: How far errors of two impacts are alike: what a law of waves gets wrong it does at each of them,
#: so that many tell as much as 1 / ALIKE that err on their own. Chosen by judgement: a law that
#: errs by half as much as arrivals do.
ALIKE = 0.2


@dataclass(slots=True)
class RunningFloor:
    """The floor by the impacts so far.

    Attributes
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    prior
        What is known beforehand.
    first
        The floor before there are impacts; None where nothing is known of it.
    least
        Impacts needed for a first estimate where nothing is known.
    memory
        Impacts looked back on.
    apart
        How far impacts all over the room scatter, in paces (:func:`scatter_of_room`).
    """

    positions: Array
    outline: Array | None
    prior: ArrivalPrior
    first: ArrivalModel | None
    least: int
    memory: int
    apart: float
    calibration: JointCalibration | None = None
    rows: deque[Array] = field(default_factory=deque)
    places: deque[Array] = field(default_factory=deque)
    fresh: int = 0

    @property
    def floor(self) -> ArrivalModel | None:
        """The best estimate by now; None before there is one."""
        return self.first if self.calibration is None else self.calibration.floor

    @property
    def pace_deviation(self) -> float:
        """Standard deviation of the logarithm of its pace."""
        deviation = (
            self.prior.pace_deviation
            if self.calibration is None
            else self.calibration.deviations[0]
        )
        return float(min(deviation, 1.0))

    def learn(self, times_s: Array, position: Array) -> None:
        """Take an impact in: arrivals, shape (n,) [s], and about where it was, shape (2,) [m]."""
        if np.isfinite(times_s).sum() < TELLING:
            return
        self.rows.append(times_s)
        self.places.append(position)
        if len(self.rows) > self.memory:
            self.rows.popleft()
            self.places.popleft()
        self.fresh += 1
        if len(self.rows) < self.least or self.fresh < len(self.rows) // RENEWAL:
            return
        self.fresh = 0
        impacts = Impacts(
            self.positions, np.array(self.rows), bounds_of(self.positions, self.outline)
        )
        places, floor = np.array(self.places), self.floor
        if floor is None:
            begun = start(impacts, self.outline, exponent=self.prior.exponent)
            floor, places = begun.floor, begun.places
        free = FreeParameters(exponent=self.prior.exponent_deviation > 0)
        prior = self.prior
        if not np.isfinite(prior.pace_deviation):
            pace = scattered_pace(impacts.times_s, self.apart)
            prior = replace(prior, pace_s=pace, pace_deviation=SCATTER_DEVIATION)
        # the more impacts err alike, the less all tell against what is known beforehand
        times_too_sure = 1 + ALIKE * (len(self.rows) - 1)
        prior = prior.surer(times_too_sure)
        fitted = fit(
            impacts, floor, places, loss="cauchy", free=free, prior=prior, rounds=ROUNDS_EACH
        )
        self.calibration = replace(fitted, covariance=times_too_sure * fitted.covariance)
        self.places = deque(fitted.places)


def running_arrival_model(
    positions: Array,
    outline: Array | None,
    medium: Medium,
    exponent: float,
    exponent_deviation: float,
    least: int,
    memory: int,
) -> RunningFloor:
    """Return a floor to learn; the geometry's arrival scale and exponent are its prior."""
    exponent = medium.arrival_exponent or exponent
    reference = reference_distance(positions)
    prior = ArrivalPrior(exponent=exponent, exponent_deviation=exponent_deviation)
    first = None
    if medium.arrival_scale is not None:
        pace = medium.arrival_scale * reference**exponent
        first = ArrivalModel(reference, pace, exponent, np.zeros(len(positions)))
        prior = replace(prior, pace_s=pace, pace_deviation=KNOWN_DEVIATION)
    _, apart = scatter_of_room(positions, outline, exponent)
    return RunningFloor(positions, outline, prior, first, least, memory, apart)


def locate(
    running: RunningFloor, times_s: Array, sigma_s: float = 5e-4, huber: float = HUBER
) -> LocationEstimate:
    """Return the place of an impact on the floor that is known by now, and learn from it.

    Parameters
    ----------
    running
        The floor by the impacts before; it takes this one in.
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    sigma_s
        Standard deviation of an arrival until the impacts tell it [s].
    huber
        Residuals beyond this many deviations count linearly.

    Returns
    -------
    The place; its residual is the root of the mean loss [s]. Before the floor is known it is that
    of the power law with a scale of its own.
    """
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    floor = running.floor
    if floor is None:
        exponent = running.prior.exponent
        estimate = tdoa.locate_power_law(
            running.positions, times_s, running.outline, exponent, sigma_s, huber
        )
    else:
        estimate = _on_floor(running, floor, times_s, sigma_s, huber)
    running.learn(times_s, np.array([estimate.x, estimate.y]))
    return estimate


def _on_floor(
    running: RunningFloor, floor: ArrivalModel, times_s: Array, sigma_s: float, huber: float
) -> LocationEstimate:
    """Return the place on a floor whose pace is as uncertain as the fit says."""
    arrived = np.isfinite(times_s)
    here, picks = running.positions[arrived], int(arrived.sum())
    times = times_s[None, arrived] - times_s[arrived].min()
    sigma = sigma_s if running.calibration is None else running.calibration.sigma_s
    area = for_sensors(lattice(running.positions, running.outline, floor.exponent), arrived)
    model = Model(floor.exponent, floor.scale, huber * sigma)
    best = search(area, here, times, model)
    fits = [np.concatenate([best.losses[0], best.finer_losses[0]])]
    if running.pace_deviation > SURE:
        finer, outside = distances(here, best.finer) ** floor.exponent, ~area.inside(best.finer)
        for sign in (1, -1):
            factor = float(np.exp(sign * ABSCISSA * running.pace_deviation))
            other = replace(model, slope=floor.scale * factor)
            inner = losses(finer, times, other)
            inner[outside] = np.inf
            fits.append(np.concatenate([losses(area.u, times, other)[0], inner[0]]))
    excess = picks * (np.array(fits) - np.min(fits))
    noise = float(tdoa.noise_s(best, times, tdoa.HYPERBOLIC_UNKNOWNS, sigma)[0])
    likelihood = np.array(WEIGHTS[: len(fits)]) @ np.exp(-excess / (2 * noise**2))
    (mean,), (covariance,) = posterior(area, best, likelihood[None])
    x, y = best.places[0] if picks > tdoa.POWER_LAW_UNKNOWNS else mean
    return LocationEstimate(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


Loss = Literal["huber", "soft-l1", "cauchy", "trimmed"]
LOSSES: tuple[Loss, ...] = ("huber", "soft-l1", "cauchy", "trimmed")
#: Weight of a residual, in standard deviations; the trimmed loss drops what a normal law gives once
#: in 144. Source: those of groundtrace.dsp.robust; the rest chosen by judgement: soft-l1 is Huber's
#: loss rounded off, and few arrivals are trimmed that are right.
LOSS_WEIGHTS: dict[Loss, Callable[[Array], Array]] = {
    "huber": lambda z: HUBER / np.maximum(np.abs(z), HUBER),
    "soft-l1": lambda z: 1 / np.sqrt(1 + (z / HUBER) ** 2),
    "cauchy": lambda z: 1 / (1 + (z / CAUCHY) ** 2),
    "trimmed": lambda z: (np.abs(z) <= 2.7).astype(np.float64),
}
#: Reweightings, steps within each, and the relative gain below which steps end. Chosen by
#: judgement: fits settle in fewer.
ROUNDS, STEPS, GAIN = 12, 6, 1e-6
#: A sigma is never estimated below this [s]. Chosen by judgement: far below a sample at 20 kHz, so
#: that arrivals without error can be fitted.
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
    true_places
        Shape (m, 2): places of controlled impacts [m]; None where they are unknown.
    """

    positions: Array
    times_s: Array
    bounds: Array
    true_places: Array | None = None

    def rows(self, index: NDArray[np.intp]) -> Impacts:
        """Return some of the impacts, in the order of ``index``."""
        positions = None if self.true_places is None else self.true_places[index]
        return Impacts(self.positions, self.times_s[index], self.bounds, positions)

    @property
    def owned(self) -> int:
        """How many unknowns each impact owns: its moment, and its place where unknown."""
        return 1 if self.true_places is not None else 3


@dataclass(frozen=True, slots=True)
class FreeParameters:
    """Which of the shared unknowns are estimated; the pace always is."""

    exponent: bool = True
    offsets: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class JointCalibration:
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

    floor: ArrivalModel
    places: Array
    residuals_s: Array
    weights: Array
    sigma_s: float
    covariance: Array
    free: FreeParameters

    @property
    def deviations(self) -> Array:
        """Standard deviations of log pace, exponent, offsets [s], shape (2 + n,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(
    impacts: Impacts,
    start: ArrivalModel,
    places: Array,
    *,
    loss: Loss = "huber",
    free: FreeParameters | None = None,
    prior: ArrivalPrior | None = None,
    rounds: int = ROUNDS,
) -> JointCalibration:
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
    free, prior = free or FreeParameters(), prior or ArrivalPrior()
    arrived = np.isfinite(impacts.times_s)
    given = places if impacts.true_places is None else impacts.true_places
    point = point_at(
        impacts, arrived, start, np.array(given, np.float64), arrived.astype(np.float64)
    )
    sigma = _sigma(impacts, point, arrived, free)
    weight = arrived.astype(np.float64)
    for _ in range(rounds):
        weight = arrived * LOSS_WEIGHTS[loss](point.residuals / sigma)
        before = point.floor
        point = _steps(impacts, point, weight, sigma, free, prior)
        sigma_before, sigma = sigma, _sigma(impacts, point, arrived, free)
        if before.near(point.floor) and abs(sigma / sigma_before - 1) < 1e-3:
            break
    covariance = _covariance(impacts, point, weight, sigma, free, prior)
    residuals = np.where(arrived, point.residuals, np.nan)
    return JointCalibration(point.floor, point.places, residuals, weight, sigma, covariance, free)


def _sigma(
    impacts: Impacts, point: Point, arrived: NDArray[np.bool_], free: FreeParameters
) -> float:
    """Return the standard deviation of an arrival by the median size of the residuals [s]."""
    count = int(arrived.sum())
    shared = 1 + free.exponent + free.offsets * (arrived.shape[1] - 1)
    enough = arrived.sum(axis=1) >= impacts.owned
    left = max(1, count - impacts.owned * int(enough.sum()) - shared)
    size = float(np.median(np.abs(point.residuals[arrived]))) if count else 0.0
    # every unknown takes away as much scatter as an arrival brings
    return max(LEAST_SIGMA_S, size / 0.6745 * float(np.sqrt(count / left)))


def _steps(
    impacts: Impacts,
    point: Point,
    weight: Array,
    sigma: float,
    free: FreeParameters,
    prior: ArrivalPrior,
) -> Point:
    """Take steps of Levenberg and Marquardt at fixed weights."""
    damping, cost = 1e-3, cost_of(point, weight, sigma, prior)
    for _ in range(STEPS):
        system = normal_equations(impacts, point, weight, sigma, free, prior)
        floor, places = system.step(point, free, damping)
        if impacts.true_places is None:  # a room is no more than a bound, yet a strong one
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
    impacts: Impacts,
    point: Point,
    weight: Array,
    sigma: float,
    free: FreeParameters,
    prior: ArrivalPrior,
) -> Array:
    """Return the covariance of what is shared, shape (2 + n, 2 + n); inf where undetermined."""
    matrix, *_ = normal_equations(impacts, point, weight, sigma, free, prior).reduced(0.0)
    shared = used(free, len(point.floor.offsets_s))
    inner = matrix[np.ix_(shared, shared)]
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    values, vectors = np.linalg.eigh(inner / np.outer(size, size))
    determined = values > 1e-9
    spread = (vectors[:, determined] / values[determined]) @ vectors[:, determined].T
    unknown = (vectors[:, ~determined] ** 2).sum(axis=1) > 1e-6
    every = 2 + len(point.floor.offsets_s)
    out = np.zeros((every, every))
    out[np.ix_(shared, shared)] = spread / np.outer(size, size)
    out[shared[unknown], shared[unknown]] = np.inf
    return out


#: Paces tried, and the largest of them over the smallest. Chosen by judgement: a factor of 1.24
#: apart, within reach of the fit that follows.
PACES, SPAN = 14, 16.0
#: Impacts that the trial of paces looks at, and those that the first fit does, out of all. Chosen
#: by judgement: they bound the cost of a start that is refined with all.
TRIED, STARTED = 24, 40
#: With unknown clocks: factors of the pace tried, and how often places are sought anew. Chosen by
#: judgement: a factor of two to either side of the first pace, which clocks bend.
FACTORS, ALTERNATIONS = (0.5, 0.7, 1.0, 1.4, 2.0), 4


def bounds_of(positions: Array, outline: Array | None) -> Array:
    """Return the lowest and highest x and y of the room, shape (2, 2) [m]."""
    corners = np.array(lattice(positions, outline).room.bounds)
    return corners.reshape(2, 2)


def places_on(
    impacts: Impacts, floor: ArrivalModel, outline: Array | None, threshold_s: float = float("inf")
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
    times, arrived = impacts.times_s - floor.offsets_s, np.isfinite(impacts.times_s)
    places = np.tile(impacts.positions.mean(axis=0), (len(times), 1))
    patterns, which = np.unique(arrived, axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        rows = np.flatnonzero(which.reshape(-1) == index)
        if pattern.sum() >= LEAST_PICKS:
            here = for_sensors(area, pattern), impacts.positions[pattern]
            # a row at a time: a threshold holds an array for each
            for row in rows:
                places[row] = search(*here, times[None, row, pattern], model).places[0]
    return places


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
    arrived = np.isfinite(times_s)
    best = [
        float(losses(u[sensors], row[None, sensors], model).min())
        for row, sensors in zip(times_s, arrived, strict=True)
    ]
    return float(np.median(best))


def start(
    impacts: Impacts,
    outline: Array | None,
    *,
    offsets: bool = False,
    exponent: float = EXPONENT,
) -> JointCalibration:
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
    return fit(impacts, floor, places, free=FreeParameters(exponent=False, offsets=offsets))


def known_start(
    impacts: Impacts, *, offsets: bool = False, exponent: float = EXPONENT
) -> JointCalibration:
    """Return a first fit of impacts whose places are known: at a given exponent it is linear."""
    assert impacts.true_places is not None
    reference = reference_distance(impacts.positions)
    arrived = np.isfinite(impacts.times_s)
    u = np.where(arrived, distances(impacts.true_places, impacts.positions) / reference, np.nan)
    farther = u**exponent - np.nanmean(u**exponent, axis=1, keepdims=True)
    late = impacts.times_s - np.nanmean(impacts.times_s, axis=1, keepdims=True)
    square = float(np.nansum(farther**2))
    # arrivals that do not grow with distance leave a pace too small to matter
    pace = max(float(np.nansum(farther * late)) / max(square, 1e-12), 1e-6)
    floor = ArrivalModel(reference, pace, exponent, np.zeros(len(impacts.positions)))
    free = FreeParameters(exponent=False, offsets=offsets)
    return fit(impacts, floor, impacts.true_places, free=free)


def _first_floor(
    impacts: Impacts, outline: Array | None, exponent: float, *, offsets: bool
) -> ArrivalModel:
    still = FreeParameters(exponent=False, offsets=offsets)
    kind = _unclocked if offsets else _clocked
    tried = kind(impacts, outline, exponent)
    fits = []
    for floor in tried:
        current = fit(impacts, floor, places_on(impacts, floor, outline), free=still, rounds=3)
        for _ in range(ALTERNATIONS if offsets else 0):
            again = places_on(impacts, current.floor, outline, HUBER * current.sigma_s)
            current = fit(impacts, current.floor, again, free=still, rounds=3)
        fits.append(current)
    return min(fits, key=lambda one: one.sigma_s).floor


def _clocked(impacts: Impacts, outline: Array | None, exponent: float) -> list[ArrivalModel]:
    pace = first_pace(impacts, outline, exponent)
    reference = reference_distance(impacts.positions)
    return [ArrivalModel(reference, pace, exponent, np.zeros(len(impacts.positions)))]


def _unclocked(impacts: Impacts, outline: Array | None, exponent: float) -> list[ArrivalModel]:
    """Return floors whose paces lie about that of the scatter, each with its offsets."""
    reference = reference_distance(impacts.positions)
    late, _ = _scatter(impacts.times_s)
    farther, apart = scatter_of_room(impacts.positions, outline, exponent)
    about = scattered_pace(impacts.times_s, apart)
    floors = []
    for factor in FACTORS:
        pace = factor * about
        ahead = late - pace * farther
        floors.append(ArrivalModel(reference, pace, exponent, ahead - ahead.mean()))
    return floors


def scattered_pace(times_s: Array, apart: float) -> float:
    """Return the pace that scatters arrivals, (m, n) [s], as :func:`scatter_of_room` says [s]."""
    return max(_scatter(times_s)[1] / apart, LEAST_SIGMA_S)


def scatter_of_room(
    positions: Array, outline: Array | None, exponent: float
) -> tuple[Array, float]:
    """Return how arrivals of impacts all over a room scatter, in paces, as :func:`_scatter`."""
    reference = reference_distance(positions)
    return _scatter((lattice(positions, outline).u.T / reference) ** exponent)


def _scatter(rows: Array) -> tuple[Array, float]:
    """Return the median of each column less the row's mean, shape (n,), and what is left over."""
    left = rows - np.nanmean(rows, axis=1, keepdims=True)
    column = medians(left.T)
    return column, float(medians(np.abs(left - column).ravel()))


#: Exponents a fit may try. Chosen by judgement: 1 is a constant velocity, 4/3 a thin plate (thesis,
#: equation (4.24)); both have room about them.
EXPONENTS = (0.4, 2.5)
#: Distances count as at least this part of the reference: beside a sensor the slope has no limit.
#: Chosen by judgement.
NEAREST = 1e-3


@dataclass(slots=True)
class Point:
    """Where a fit stands: the floor, places (m, 2) [m], residuals (m, n) [s] with 0 for none."""

    floor: ArrivalModel
    places: Array
    residuals: Array


def point_at(
    impacts: Impacts, arrived: NDArray[np.bool_], floor: ArrivalModel, places: Array, weight: Array
) -> Point:
    """Return where a floor and places leave the arrivals, about the best moments under weights."""
    travel = floor.travel_s(_distances(impacts, floor, places)) + floor.offsets_s
    left = np.where(arrived, np.nan_to_num(impacts.times_s) - travel, 0.0)
    moment = (weight * left).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-12)
    return Point(floor, places, np.where(arrived, left - moment[:, None], 0.0))


def _distances(impacts: Impacts, floor: ArrivalModel, places: Array) -> Array:
    apart = places[:, None, :] - impacts.positions
    return np.maximum(np.hypot(apart[..., 0], apart[..., 1]), NEAREST * floor.reference_m)


def cost_of(point: Point, weight: Array, sigma: float, prior: ArrivalPrior) -> float:
    """Return the weighted squares of residuals and prior, in units of sigma."""
    pull = _pull(point.floor, prior)
    return float((weight * point.residuals**2).sum()) / sigma**2 + float(pull @ pull)


def _pull(floor: ArrivalModel, prior: ArrivalPrior) -> Array:
    """Return how far pace and exponent are from the prior, in its deviations, shape (2,).

    An exponent of deviation 0 is kept, and so is nowhere else.
    """
    fixed = prior.exponent_deviation == 0
    off = 0.0 if fixed else (floor.exponent - prior.exponent) / prior.exponent_deviation
    return np.array([np.log(floor.pace_s / prior.pace_s) / prior.pace_deviation, off])


@dataclass(slots=True)
class System:
    """Normal equations: of each impact's own unknowns, of the shared ones, and across.

    ``per_impact`` has shape (m, a, a), ``across`` (m, a, s), ``shared`` (s, s);
    ``per_impact_side`` (m, a) and ``shared_side`` (s,) are the right-hand sides.
    """

    per_impact: Array
    across: Array
    shared: Array
    per_impact_side: Array
    shared_side: Array

    def reduced(self, damping: float) -> tuple[Array, Array, Array, Array]:
        """Return matrix and right-hand side of the shared unknowns, the own ones eliminated.

        And what brings the own ones back: the own right-hand side and the coupling, solved.
        """
        size = self.per_impact.shape[1]
        ridge = np.einsum("maa->ma", self.per_impact) * (damping + 1e-12) + 1e-12
        damped = self.per_impact + ridge[:, :, None] * np.eye(size)
        solved = np.linalg.solve(
            damped, np.concatenate([self.per_impact_side[..., None], self.across], 2)
        )
        side, coupling = solved[..., 0], solved[..., 1:]
        matrix = self.shared - np.einsum("mas,mat->st", self.across, coupling)
        right = self.shared_side - np.einsum("mas,ma->s", self.across, side)
        return matrix, right, side, coupling

    def step(
        self, point: Point, free: FreeParameters, damping: float
    ) -> tuple[ArrivalModel, Array]:
        """Return the floor and the places one damped step on."""
        matrix, right, side, coupling = self.reduced(damping)
        floor, free_ones = point.floor, used(free, len(point.floor.offsets_s))
        inner = matrix[np.ix_(free_ones, free_ones)]
        inner = inner + damping * np.diag(np.diag(inner)) + 1e-12 * np.eye(len(free_ones))
        moved = np.zeros(len(matrix))
        moved[free_ones] = np.linalg.solve(inner, right[free_ones])
        moves = side - coupling @ moved
        places = (
            point.places if moves.shape[1] == 1 else point.places + _limited(moves[:, 1:], floor)
        )
        offsets = floor.offsets_s + moved[2:] if free.offsets else floor.offsets_s
        stepped = ArrivalModel(
            floor.reference_m,
            float(floor.pace_s * np.exp(np.clip(moved[0], -1, 1))),
            float(np.clip(floor.exponent + np.clip(moved[1], -0.5, 0.5), *EXPONENTS)),
            offsets - offsets.mean() if free.offsets else offsets,
        )
        return stepped, places


def _limited(moves: Array, floor: ArrivalModel) -> Array:
    """Return moves of places, none farther than half the reference."""
    length = np.hypot(moves[:, 0], moves[:, 1])
    allowed = np.minimum(1.0, 0.5 * floor.reference_m / np.maximum(length, 1e-12))
    limited: Array = moves * allowed[:, None]
    return limited


def used(free: FreeParameters, sensors: int) -> NDArray[np.intp]:
    """Return the indices of the shared unknowns that are estimated."""
    mask = np.concatenate([[True, free.exponent], np.full(sensors, free.offsets)])
    return np.flatnonzero(mask)


def normal_equations(
    impacts: Impacts,
    point: Point,
    weight: Array,
    sigma: float,
    free: FreeParameters,
    prior: ArrivalPrior,
) -> System:
    """Return the normal equations of the linearised arrivals, in units of sigma."""
    of_impacts, shared = _slopes(impacts, point, free)
    scaled = weight / sigma**2
    weighted_own, weighted_shared = of_impacts * scaled[..., None], shared * scaled[..., None]
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
        np.einsum("mna,mnb->mab", of_impacts, weighted_own),
        np.einsum("mna,mns->mas", of_impacts, weighted_shared),
        matrix,
        np.einsum("mna,mn->ma", weighted_own, point.residuals),
        side,
    )


def _slopes(impacts: Impacts, point: Point, free: FreeParameters) -> tuple[Array, Array]:
    """Return the derivatives of arrivals by own, (m, n, a), and shared unknowns, (m, n, s).

    The shared ones are pace, exponent and, where these are estimated, the offsets.
    """
    floor, (m, n) = point.floor, point.residuals.shape
    apart = _distances(impacts, floor, point.places)
    travel = floor.travel_s(apart)
    shared = np.zeros((m, n, 2 + n * free.offsets))
    shared[..., 0] = travel
    shared[..., 1] = travel * np.log(apart / floor.reference_m)
    if free.offsets:
        shared[:, np.arange(n), 2 + np.arange(n)] = 1.0
    of_impacts = np.ones((m, n, impacts.owned))
    if impacts.true_places is None:
        slope = floor.exponent * travel / apart**2
        of_impacts[..., 1:] = slope[..., None] * (point.places[:, None] - impacts.positions)
    return of_impacts, shared
