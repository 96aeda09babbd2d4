"""Straight courses of one or two vehicles, from the powers of all cycles at once.

The paper finds a position in each cycle, (7), and a course through these, (9). Positions err
unevenly and not normally, so much is lost. Here the powers themselves are fitted: mu / r^n with r
the distance to the course (8), the noise added. See :mod:`.medium` for the likelihood.

Powers of two vehicles in one run add up, so that each course is fitted with the other's mean power
as a part of the noise, in turn. Whether there are two is decided by Schwarz's criterion, with a
margin, since under fading the powers of one vehicle stay off its law for some cycles.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .lines import Course
from .medium import (
    CYCLE_POINTS,
    CYCLE_WEIGHTS,
    EXPONENT,
    Fitted,
    PowerLaw,
    cube_root_normalised,
    deviance,
    fit_powers,
    ranges,
    repeated,
    usable,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Stations

    from .stations import StationPowers

    Array = NDArray[np.float64]

_LAW = PowerLaw(1.0, EXPONENT)
#: Courses nearer than this many standard deviations, and 0.1 m, are one. Chosen by judgement: what
#: errors cannot tell apart is one.
_ALIKE, _ALIKE_M = 0.5, 0.1
#: Neighbours on a lattice are nearer than this many of its steps, and go the same way within this
#: angle [rad]. Source: definition for the first, with room for rounding; the second chosen by
#: judgement: a fit turns a course by less.
APART, TURNED_RAD = 1.1, 0.5
#: What is known of the noise's factor: that this power of it is 1, as surely as a power is known.
#: Chosen by trial on simulated roads: held more tightly, courses were better or worse by no more
#: than by the vehicles (docs/accuracy/vehicles.md).
_FACTOR_WEIGHT = 0.2
#: Log-likelihood that a rival may lack. Source: definition: 22000 times less likely.
MOST_LOST = 10.0


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
        not on which side of a sensor it went. Fits of other laws, too, where some were tried.
    """

    course: Course
    log_mu: Array
    log_mu_sigma: Array
    log_likelihood: float
    evidence: float
    relative_sigma: float
    samples: int
    rivals: tuple[tuple[Course, float], ...] = ()

    def tempered(self, factor: float) -> CourseFit:
        """Return the fit as if its powers told so many times less: rivals are less behind, too."""
        course, *others = (
            replace(one, covariance=factor * one.covariance)
            for one in (self.course, *(rival for rival, _ in self.rivals))
        )
        rivals = zip(others, (lost / factor for _, lost in self.rivals), strict=True)
        return replace(self, course=course, rivals=tuple(rivals))

    @property
    def cautious(self) -> Course:
        """The course with a covariance that takes in the rivals, each by how likely it is."""
        best = self.course
        centre = np.concatenate([best.position, best.velocity])
        total, weights = best.covariance.copy(), 1.0
        for rival, lost in self.rivals:
            weight = float(np.exp(_log_volume(rival) - _log_volume(best) - lost))
            off = np.concatenate([rival.position, rival.velocity]) - centre
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
    course_fits = [model.result(fit) for fit in fits if np.isfinite(fit.covariance).all()]
    if not course_fits:
        return None
    best = course_fits[0]
    rivals: list[tuple[Course, float]] = []
    for fit in course_fits[1:]:
        # each found a fluctuation of its own; they are compared for the best one's
        lost = best.log_likelihood - fit.log_likelihood * (
            fit.relative_sigma**2 / best.relative_sigma**2
        )
        distinct = [best.course, *(course for course, _ in rivals)]
        if lost < MOST_LOST and all(_differ(fit.course, other) for other in distinct):
            rivals.append((fit.course, lost))
    return replace(best, rivals=tuple(rivals))


def vehicle_power(observed: Observed, fit: CourseFit) -> Array:
    """Return the mean power of a vehicle of one strength, shape (c, n); 0 where there is none."""
    model = _Model(observed, each_mu=False)
    ahead = model.time_s - fit.course.time_s
    position = fit.course.position + ahead * fit.course.velocity
    power: Array = np.zeros(observed.powers.shape)
    power[model.used] = model.unit_power(np.concatenate([position, fit.course.velocity]))
    power *= np.exp(fit.log_mu[0])
    return power


def _log_volume(course: Course) -> float:
    return 0.5 * float(np.linalg.slogdet(course.covariance)[1])


def _differ(one: Course, other: Course) -> bool:
    """Return whether two courses are apart by more than they err."""
    sigma = np.sqrt(np.diag(one.covariance))
    off = np.abs(np.concatenate([one.position - other.position, one.velocity - other.velocity]))
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
        cycles, group = np.unique(cycle, return_inverse=True)
        self.group = group if each_mu else np.zeros(len(cycle), np.intp)
        self.strengths = len(cycles) if each_mu else 1
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
        return CYCLE_POINTS * self.observed.cycle_s / 2, CYCLE_WEIGHTS

    def _repeated(self, fit: Fitted) -> float:
        mean, _ = self(fit.values)
        off = np.full(self.used.shape, np.nan)
        off[self.used] = cube_root_normalised(self.powers / mean[: self.samples])
        return repeated(off)

    def result(self, fit: Fitted) -> CourseFit:
        """Return a fit in words of a course."""
        strengths = slice(4, 4 + self.strengths)
        position, velocity, log_mu = fit.values[:2], fit.values[2:4], fit.values[strengths]
        spread = fit.covariance[:4, :4] * self._repeated(fit)
        course = Course(self.time_s, position, velocity, spread)
        sigma = np.sqrt(np.diag(fit.covariance)[strengths])
        evidence = float("inf")
        if (self.floors > 0).all():
            # the likeliest factor of a gamma law is the mean ratio
            factor = float((self.powers / self.floors).mean()) if self.fit_noise else 1.0
            alone = float(deviance(self.powers, factor * self.floors).sum())
            evidence = (alone - fit.deviance) / (2 * fit.relative_sigma**2)
        likely, scatter, samples = fit.log_likelihood, fit.relative_sigma, fit.samples
        return CourseFit(course, log_mu, sigma, likely, evidence, scatter, samples)


#: Courses scored at once, times powers. Chosen by judgement: 16 MB of doubles.
_CELLS = 2_000_000


@dataclass(frozen=True, slots=True)
class Search:
    """Which courses are tried.

    Attributes
    ----------
    low, high
        Corners of the area in which a vehicle is in the middle of the time [m].
    speeds_mps
        From slowest to fastest [m/s].
    places, headings, speeds
        How many of each: places along either axis.
    refined
        How many of the best, each from another place or heading, are refined.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    speeds_mps: tuple[float, float] = (1.0, 25.0)
    places: int = 9
    headings: int = 16
    speeds: int = 5
    refined: int = 12

    @classmethod
    def about(cls, sensors: Array, margin: float = 0.75) -> Search:
        """Return the rectangle of sensors, shape (n, 2), widened on all sides.

        ``margin`` is in parts of its longer side.
        """
        low, high = sensors.min(axis=0), sensors.max(axis=0)
        wider = margin * float((high - low).max())
        (x0, y0), (x1, y1) = (low - wider).tolist(), (high + wider).tolist()
        return cls((x0, y0), (x1, y1))

    def courses(self) -> Array:
        """Return all courses, shape (m, 4): x, y [m], vx, vy [m/s] in the middle of the time."""
        x, y = (np.linspace(a, b, self.places) for a, b in zip(self.low, self.high, strict=True))
        heading = 2 * np.pi * np.arange(self.headings) / self.headings
        speed = np.geomspace(*self.speeds_mps, self.speeds)
        mesh = np.meshgrid(x, y, heading, speed, indexing="ij")
        xs, ys, headings, speeds = (m.ravel() for m in mesh)
        return np.stack([xs, ys, speeds * np.cos(headings), speeds * np.sin(headings)], axis=1)


def starts(observed: Observed, search: Search, each_mu: bool) -> Array:
    """Return the courses of a lattice from which to start, shape (k, 4), the best first.

    Parameters
    ----------
    observed
        Powers of cycles.
    search
        The lattice.
    each_mu
        Whether the vehicle's strength may differ from cycle to cycle.
    """
    courses = search.courses()
    step = max(1, _CELLS // max(1, observed.powers.size))
    lost = np.concatenate(
        [_lost(observed, courses[a : a + step], each_mu) for a in range(0, len(courses), step)]
    )
    order = np.argsort(lost, kind="stable")
    apart = max((b - a) / (search.places - 1) for a, b in zip(search.low, search.high, strict=True))
    retained: list[Array] = []
    for course in courses[order]:
        if all(_apart(course, other, apart) for other in retained):
            retained.append(course)
            if len(retained) == search.refined:
                break
    return np.array(retained)


def strengths(powers: Array, floors: Array, spread: Array, axes: tuple[int, ...]) -> Array:
    """Return ln mu, the mean over axes of what stands out of the noise, those kept of length 1.

    Powers count by the square of the vehicle's part of them, so that cycles lost in the noise do
    not.

    Parameters
    ----------
    powers, floors
        Noise included, and that of the noise, shapes that numpy joins.
    spread
        Powers of mu = 1.
    axes
        Over which mu is one.
    """
    share = np.clip(1 - floors / powers, 1e-3, 1.0)
    weights = share**2
    logs = np.log(powers * share / spread)
    total = np.broadcast_to(weights, logs.shape).sum(axis=axes, keepdims=True)
    return np.asarray((weights * logs).sum(axis=axes, keepdims=True) / total)


def _apart(one: Array, other: Array, distance_m: float) -> bool:
    """Return whether courses lie in other places by more than neighbours, or go another way."""
    turn = one[2:] @ other[2:] / (np.hypot(*one[2:]) * np.hypot(*other[2:]))
    return bool(np.abs(one[:2] - other[:2]).max() > APART * distance_m or turn < np.cos(TURNED_RAD))


def _lost(observed: Observed, courses: Array, each_mu: bool) -> Array:
    """Return the deviance of courses, shape (m,), each with the strength that suits it."""
    used = usable(observed.powers)
    powers = np.where(used, observed.powers, 1.0)
    floors = np.where(used, observed.floors, 0.0)
    ahead = observed.times_s - observed.times_s.mean()
    places = courses[:, None, :2] + courses[:, None, 2:] * ahead[:, None]
    spread = observed.law.power(ranges(places, observed.sensors))
    mu = np.exp(strengths(powers, floors, spread, (2,) if each_mu else (1, 2)))
    lost = np.where(used, deviance(powers, mu * spread + floors), 0.0)
    return np.asarray(lost.sum(axis=(1, 2)))


#: Power over the noise from which a station hears a vehicle on its way [1]. Chosen by judgement:
#: the vehicle is as strong as the noise.
_HEARD = 2.0
_LEAST_HEARD = 2
#: A vehicle is near while the loudest station has this part of the run's greatest power. Chosen by
#: judgement: 10 dB.
_NEAR = 0.1


@dataclass(frozen=True, slots=True)
class RunLimits:
    """When a run begins and ends.

    Attributes
    ----------
    lead_s
        How much before the first cycle with a vehicle belongs to it [s].
    quiet_s
        It ends when so long no station has heard any [s].
    most_s
        And after this at the latest [s].
    """

    lead_s: float
    quiet_s: float
    most_s: float


class RunCollector:
    """Collects the cycles of runs.

    Parameters
    ----------
    limits
        When runs begin and end.
    """

    def __init__(self, limits: RunLimits) -> None:
        self.limits = limits
        self._lead: deque[StationPowers] = deque()
        self._cycles: list[StationPowers] = []
        self._last_ns = 0

    def take(self, cycle: StationPowers) -> list[StationPowers]:
        """Take the next cycle; return the run that has ended with it, else nothing."""
        if cycle.present.any():
            if not self._cycles:
                self._cycles = list(self._lead)
                self._lead.clear()
            self._last_ns = cycle.time_ns
        if not self._cycles and not cycle.present.any():
            self._lead.append(cycle)
            while self._lead[0].time_ns < cycle.time_ns - self.limits.lead_s * NS_PER_S:
                self._lead.popleft()
            return []
        self._cycles.append(cycle)
        quiet_ns = cycle.time_ns - self._last_ns
        long_ns = cycle.time_ns - self._cycles[0].time_ns
        if quiet_ns > self.limits.quiet_s * NS_PER_S or long_ns > self.limits.most_s * NS_PER_S:
            return self.flush()
        return []

    def flush(self) -> list[StationPowers]:
        """Return the run that has not ended yet, as one that has."""
        run, self._cycles = self._cycles, []
        self._lead.clear()
        return run


def observed_of(run: list[StationPowers], site: Stations, exponent: float) -> Observed:
    """Return the powers of a run; times count from its first cycle [s].

    A cycle is as long as the shortest step between two.
    """
    times = np.array([cycle.time_ns - run[0].time_ns for cycle in run], np.int64) / NS_PER_S
    powers = np.array([cycle.powers for cycle in run])
    floors = np.array([cycle.floors for cycle in run])
    sigmas = np.array([cycle.floor_sigmas for cycle in run])
    cycle_s = float(np.diff(times).min()) if len(times) > 1 else 0.0
    law = PowerLaw(1.0, exponent)
    return Observed(times, powers, floors, site.places, law, cycle_s, sigmas)


def heard_span(observed: Observed) -> slice:
    """Return the cycles from the first to the last in which two stations hear a vehicle."""
    over = np.where(observed.floors > 0, observed.powers, 0) > _HEARD * observed.floors
    return _span(over.sum(axis=1) >= _LEAST_HEARD)


def near_span(observed: Observed) -> slice:
    """Return the cycles from the first to the last in which a vehicle is near for single cycles.

    From afar all stations hear it nearly alike, and a single cycle puts it amid them as well.
    """
    signal = np.nan_to_num(observed.powers - observed.floors).max(axis=1)
    return _span(signal > _NEAR * signal.max())


def _span(which: NDArray[np.bool_]) -> slice:
    indices = np.flatnonzero(which)
    return slice(int(indices[0]), int(indices[-1]) + 1) if len(indices) else slice(0, 0)


def part_of(observed: Observed, span: slice) -> Observed:
    """Return some of the cycles."""
    sigmas = observed.floor_sigmas
    return replace(
        observed,
        times_s=observed.times_s[span],
        powers=observed.powers[span],
        floors=observed.floors[span],
        floor_sigmas=None if sigmas is None else sigmas[span],
    )


#: Standard deviation of a power over its mean from which one course may be of two vehicles: that of
#: one vehicle is a third, and up to 0.8 under fading. Chosen by judgement: a little over a third;
#: more than one vehicle must then be likelier.
UNLIKE = 0.4
#: Unknowns of a second vehicle; by what part of the powers' number Schwarz's criterion must be
#: better, as if each scattered by a fifth less. Chosen by judgement: powers of a cycle are not
#: independent of those of the next.
_UNKNOWNS, _MARGIN = 5, 0.4
#: Chosen by judgement: parts of two vehicles settle in fewer.
_ROUNDS = 3


def scatter_along(observed: Observed, places: Array) -> float:
    """Return by how much powers scatter about those of one vehicle of one strength at places.

    The standard deviation of a power over its mean, of powers made nearly Gaussian, so that one
    sensor that is passed closely does not decide.

    Parameters
    ----------
    observed
        Powers of a run.
    places
        Shape (c, 2): the vehicle's [m].
    """
    used = usable(observed.powers)
    powers = np.where(used, observed.powers, 1.0)
    floors = np.where(used, observed.floors, powers)
    spread = observed.law.power(ranges(places, observed.sensors))
    mean = np.exp(strengths(powers, floors, spread, (0, 1))) * spread + observed.floors
    return float(np.sqrt(np.mean(cube_root_normalised(powers / mean)[used] ** 2)))


def fit_two(
    observed: Observed, search: Search, one: CourseFit
) -> tuple[tuple[CourseFit, Observed], tuple[CourseFit, Observed]] | None:
    """Fit two courses, or return None where one is as likely.

    Parameters
    ----------
    observed
        Powers of a run.
    search
        Where and how fast vehicles may be.
    one
        The course fitted to them as if they were of one vehicle.

    Returns
    -------
    The courses in the order in which vehicles come by the sensors' middle, each with what it
    was fitted to: the other's power is in the floors.
    """
    if one.relative_sigma < UNLIKE:
        return None
    fits = [(one, observed), (one, observed)]
    for turn in range(2 * _ROUNDS):
        fit, noisier = _beside(observed, search, fits[turn % 2][0])
        if fit is None:
            return None
        fits[1 - turn % 2] = fit, noisier
    first, second = (fit for fit, _ in fits)
    n = one.samples
    scatter = max(first.relative_sigma, second.relative_sigma)
    gain = 2 * n * np.log(one.relative_sigma / scatter) - _UNKNOWNS * np.log(n)
    if not gain > _MARGIN * n:
        return None
    centre = observed.sensors.mean(axis=0)
    fits.sort(key=lambda pair: _middle_s(pair[0], centre))
    return fits[0], fits[1]


def _beside(
    observed: Observed, search: Search, other: CourseFit
) -> tuple[CourseFit | None, Observed]:
    """Fit one vehicle, the other one's power being noise."""
    noisier = replace(observed, floors=observed.floors + vehicle_power(observed, other))
    return fit_course(noisier, search), noisier


def _middle_s(fit: CourseFit, centre: Array) -> float:
    course = fit.course
    ahead = (centre - course.position) @ course.velocity / course.speed_mps**2
    return float(course.time_s + ahead)
