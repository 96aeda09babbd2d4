"""A straight course from the powers of all cycles at once, without a place for any single one.

The paper finds a place in each cycle, (7), and a course through these, (9). Places err unevenly and
not normally, so much is lost. Here the powers themselves are fitted: mu / r^n with r the distance
to the course (8), the noise added. See :mod:`groundtrace.vehicles.scoring` for the likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .lines import Course
from .medium import EXPONENT, PowerLaw, ranges
from .scoring import Fitted, deviance, fit_powers, usable
from .search import Search, starts
from .traffic_scatter import lasting_of, rooted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Points of Gauss's quadrature within a cycle: a vehicle at speed is not in one place.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_LAW = PowerLaw(1.0, EXPONENT)
#: Courses nearer than this many standard deviations, and 0.1 m, are one.
_ALIKE, _ALIKE_M = 0.5, 0.1
#: What is known of the noise's factor: that this power of it is 1, as surely as a power is known.
_FACTOR_WEIGHT = 0.2
#: Log-likelihood that a rival may lack.
_MOST_LOST = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Powers of cycles at sensors.

    Attributes
    ----------
    times_s
        Shape (c,): middles of the cycles [s].
    powers
        Shape (c, n): (6), noise included; NaN or 0 where there is none.
    floors
        Shape (c, n): mean power of the noise.
    sensors
        Shape (n, 2) [m].
    law
        How power falls; its mu is not used.
    cycle_s
        Length of a cycle, within which the vehicle moves on [s]; 0: it does not.
    floor_sigmas
        Shape (c, n): standard deviations of the floors, which places of single cycles reckon with;
        None: they are known.
    """

    times_s: Array
    powers: Array
    floors: Array
    sensors: Array
    law: PowerLaw = _LAW
    cycle_s: float = 0.0
    floor_sigmas: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CourseFit:
    """A course fitted to powers.

    Attributes
    ----------
    course
        The likeliest; its covariance allows for powers that stay off from cycle to cycle.
    log_mu, log_mu_sigma
        ln of the energy parameter, shape (1,), or (c,) with one per cycle, and standard deviations.
    log_likelihood
        Less that of a mean for every power of its own.
    evidence
        By how much that is above the log-likelihood of noise alone; inf where no noise is known.
    relative_sigma
        Standard deviation of a power over its mean, given or found.
    samples
        How many powers.
    rivals
        Other courses that are maxima too, and by how much their log-likelihood is lower, at most
        10; sensors in a line cannot tell a course from its mirror image, and few cycles at times
        not on which side of a sensor it went.
    """

    course: Course
    log_mu: Array
    log_mu_sigma: Array
    log_likelihood: float
    evidence: float
    relative_sigma: float
    samples: int
    rivals: tuple[tuple[Course, float], ...] = ()

    @property
    def cautious(self) -> Course:
        """The course with a covariance that takes in the rivals, each by how likely it is."""
        best = self.course
        centre = np.concatenate([best.place, best.velocity])
        total, weights = best.covariance.copy(), 1.0
        for rival, lost in self.rivals:
            weight = float(np.exp(_log_volume(rival) - _log_volume(best) - lost))
            off = np.concatenate([rival.place, rival.velocity]) - centre
            total += weight * (rival.covariance + np.outer(off, off))
            weights += weight
        return replace(best, covariance=total / weights)


def fit_course(
    observed: Observed,
    search: Search | None = None,
    each_mu: bool = False,
    relative_sigma: float | None = None,
    fit_noise: bool = False,
) -> CourseFit | None:
    """Fit a straight course to powers.

    Parameters
    ----------
    observed
        The powers.
    search
        Where and how fast vehicles may be; None: about the sensors.
    each_mu
        Whether the vehicle's strength may differ from cycle to cycle; then the directions between
        sensors tell its places, and not how its power rises and falls.
    relative_sigma
        Standard deviation of a power over its mean; None: found.
    fit_noise
        Whether a factor that all floors share is found too; they count as one measurement of it,
        as sure as a single power. For floors that a vehicle heard for long has raised.

    Returns
    -------
    The likeliest course, or None with fewer than two powers beyond the unknowns, or where these are
    open, as where there is but noise.
    """
    model = _Model(observed, each_mu, fit_noise)
    if model.samples < 4 + model.strengths + 2:
        return None
    reach = search or Search.about(observed.sensors)
    fits = [
        fit_powers(model, model.fitted, model.start(start), relative_sigma)
        for start in starts(observed, reach, each_mu)
    ]
    fits.sort(key=lambda fit: fit.deviance)
    found = [model.result(fit) for fit in fits if np.isfinite(fit.covariance).all()]
    if not found:
        return None
    best = found[0]
    rivals: list[tuple[Course, float]] = []
    for fit in found[1:]:
        # each found a fluctuation of its own; they are compared for the best one's
        lost = best.log_likelihood - fit.log_likelihood * (
            fit.relative_sigma**2 / best.relative_sigma**2
        )
        known = [best.course, *(course for course, _ in rivals)]
        if lost < _MOST_LOST and all(_differ(fit.course, other) for other in known):
            rivals.append((fit.course, lost))
    return replace(best, rivals=tuple(rivals))


def vehicle_power(observed: Observed, fit: CourseFit) -> Array:
    """Return the mean power of a vehicle of one strength, shape (c, n); 0 where there is none."""
    model = _Model(observed, each_mu=False)
    ahead = model.time_s - fit.course.time_s
    place = fit.course.place + ahead * fit.course.velocity
    power: Array = np.zeros(observed.powers.shape)
    power[model.used] = model.unit_power(np.concatenate([place, fit.course.velocity]))
    power *= np.exp(fit.log_mu[0])
    return power


def _log_volume(course: Course) -> float:
    return 0.5 * float(np.linalg.slogdet(course.covariance)[1])


def _differ(one: Course, other: Course) -> bool:
    """Return whether two courses are apart by more than they err."""
    sigma = np.sqrt(np.diag(one.covariance))
    off = np.abs(np.concatenate([one.place - other.place, one.velocity - other.velocity]))
    return bool((off > _ALIKE_M + _ALIKE * sigma).any())


class _Model:
    """Mean powers and their slopes for the parameters (x, y, vx, vy, ln mu..., ln of the noise).

    Where the noise is fitted, a last power of 1 has its factor as mean.
    """

    def __init__(self, observed: Observed, each_mu: bool, fit_noise: bool = False) -> None:
        self.observed = observed
        self.fit_noise = fit_noise
        self.used = usable(observed.powers)
        self.powers: Array = observed.powers[self.used]
        self.floors: Array = observed.floors[self.used]
        self.time_s = float(observed.times_s.mean())
        self.each_mu = each_mu
        cycle, _ = np.nonzero(self.used)
        heard, group = np.unique(cycle, return_inverse=True)
        self.group = group if each_mu else np.zeros(len(cycle), np.intp)
        self.strengths = len(heard) if each_mu else 1
        self.samples = len(self.powers)
        self.fitted: Array = np.append(self.powers, 1.0) if fit_noise else self.powers

    def start(self, course: Array) -> Array:
        """Return a course (4,) with the strengths that suit it, shape (4 + strengths,)."""
        spread, _ = self._spread(course)
        share = np.clip(1 - self.floors / self.powers, 1e-3, 1.0)
        logs = np.log(self.powers * share / spread)
        sums = np.bincount(self.group, share**2 * logs)
        logs = sums / np.bincount(self.group, share**2)
        return np.concatenate([course, logs, np.zeros(int(self.fit_noise))])

    def __call__(self, values: Array) -> tuple[Array, Array]:
        spread, slopes = self._spread(values[:4])
        logs = np.clip(values[4:], -600, 600)
        vehicle = spread * np.exp(logs[: self.strengths])[self.group]
        factor = float(np.exp(logs[-1])) if self.fit_noise else 1.0
        mean = vehicle + factor * self.floors
        strength = (self.group[:, None] == np.arange(self.strengths)).astype(np.float64)
        share = (vehicle / mean)[:, None]
        slopes = share * np.concatenate([slopes, strength], axis=1)
        return self._noise(mean, slopes, 1 - share, factor) if self.fit_noise else (mean, slopes)

    def _noise(
        self, mean: Array, slopes: Array, noise_share: Array, factor: float
    ) -> tuple[Array, Array]:
        """Add the noise's factor: a column of slopes, and a row for what is known of it."""
        alone = np.zeros((1, slopes.shape[1] + 1))
        alone[0, -1] = _FACTOR_WEIGHT
        wider = np.concatenate([slopes, noise_share], axis=1)
        return np.append(mean, factor**_FACTOR_WEIGHT), np.concatenate([wider, alone])

    def unit_power(self, course: Array) -> Array:
        """Return powers for mu = 1 on a course (4,), shape (k,)."""
        return self._spread(course)[0]

    def _spread(self, course: Array) -> tuple[Array, Array]:
        """Return powers for mu = 1 and the slopes of their logarithms, shapes (k,) and (k, 4)."""
        observed = self.observed
        power: Array = np.zeros(observed.powers.shape)
        slopes: Array = np.zeros((*power.shape, 4))
        for point, weight in zip(*self._quadrature(), strict=True):
            ahead = observed.times_s - self.time_s + point
            places = course[:2] + course[2:] * ahead[:, None]
            r = ranges(places, observed.sensors)
            part = 0.5 * weight * observed.law.power(r)
            power += part
            way = (places[:, None] - observed.sensors) / r[..., None]
            slope = (part * observed.law.slope(r))[..., None] * way
            slopes[..., :2] += slope
            slopes[..., 2:] += slope * ahead[:, None, None]
        return power[self.used], (slopes / power[..., None])[self.used]

    def _quadrature(self) -> tuple[Array, Array]:
        if self.observed.cycle_s <= 0:
            return np.zeros(1), np.full(1, 2.0)
        return _POINTS * self.observed.cycle_s / 2, _WEIGHTS

    def _repeated(self, fit: Fitted) -> float:
        """Return of how many cycles one tells as much as an independent one: a fade may last."""
        mean, _ = self(fit.values)
        off = np.full(self.used.shape, np.nan)
        off[self.used] = rooted(self.powers / mean[: self.samples])
        lasting = lasting_of(off)
        return (1 + lasting) / (1 - lasting)

    def result(self, fit: Fitted) -> CourseFit:
        """Return a fit in words of a course."""
        strengths = slice(4, 4 + self.strengths)
        place, velocity, log_mu = fit.values[:2], fit.values[2:4], fit.values[strengths]
        spread = fit.covariance[:4, :4] * self._repeated(fit)
        course = Course(self.time_s, place, velocity, spread)
        sigma = np.sqrt(np.diag(fit.covariance)[strengths])
        evidence = float("inf")
        if (self.floors > 0).all():
            # the likeliest factor of a gamma law is the mean ratio
            factor = float((self.powers / self.floors).mean()) if self.fit_noise else 1.0
            alone = float(deviance(self.powers, factor * self.floors).sum())
            evidence = (alone - fit.deviance) / (2 * fit.relative_sigma**2)
        likely, scatter, samples = fit.log_likelihood, fit.relative_sigma, fit.samples
        return CourseFit(course, log_mu, sigma, likely, evidence, scatter, samples)
