"""Courses of vehicles, fitted at the end of each run: straight at once, by cycles, or curved."""

from __future__ import annotations

import re
from abc import abstractmethod
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from groundtrace_codecs.events import LineCrossing, Note, Quantity, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError
from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from .courses import (
    MOST_LOST,
    RunCollector,
    RunLimits,
    Search,
    fit_course,
    fit_two,
    heard_span,
    near_span,
    observed_of,
    part_of,
    scatter_along,
    strengths,
    vehicle_power,
)
from .lines import Course, through
from .medium import deviance, ranges, repeated, usable
from .presence import RELATIVE_SIGMA
from .stations import CycleStage, candidates_of, line_through
from .tracker import MotionModel, cycle_places, scatter_about, track, track_places

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..pipeline.gates import Candidates
    from .courses import CourseFit, Observed
    from .lines import Loss
    from .stations import StationPowers

    Array = NDArray[np.float64]

_Exponent = Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)]
_Lead = Annotated[float, measured("s", "Of the run before its first cycle.", ge=0)]
_Quiet = Annotated[float, measured("s", "Without a vehicle until a run has ended.", gt=0)]
_Most = Annotated[float, measured("s", "Longest run.", gt=0)]
_Line = Annotated[str, measured("m", "A line whose crossing is told, as x,y x,y.")]
_Scatter = Annotated[
    float,
    measured("1", "Of powers about one vehicle's at most; up to 1 where the ground fades.", gt=0),
]
_Sigma = Annotated[float, gate("m", "Largest standard deviation of the middle place.", gt=0)]
_Fast = Annotated[float, gate("m/s", "Highest speed.", gt=0)]
_Cycles = Annotated[float, gate("1", "Fewest cycles with a place.", ge=4)]

#: Log-likelihood that a mirror image lacks at least where powers tell it from the course: it is
#: then 20 times less likely. Source: definition, exp(3).
_TOLD = 3.0
_SPEED, _PLACE = Quantity("speed", "m/s"), Quantity("sigma", "m")
_MOTION = (
    Level("speed", "m/s", "speed", at_least=False),
    Level("sigma", "m", "sigma", at_least=False),
)


@dataclass(frozen=True, slots=True)
class CourseParameters:
    """Parameters of :class:`CourseFinder`."""

    exponent: _Exponent = 1.5
    lead_s: _Lead = 4.0
    quiet_s: _Quiet = 2.0
    most_s: _Most = 120.0
    slowest_mps: Annotated[float, measured("m/s", "Slowest vehicle.", gt=0)] = 1.0
    fastest_mps: Annotated[float, measured("m/s", "Fastest vehicle.", gt=0)] = 30.0
    strength: Annotated[
        Literal["auto", "one", "each"],
        measured("", "Of the vehicle: one, or each cycle its own; auto: by what is likelier."),
    ] = "auto"
    line: _Line = ""
    expected_scatter: _Scatter = 0.43  # of the likeliest of several laws, which leaves less
    evidence: Annotated[float, gate("1", "Lowest log-likelihood over that of noise.")] = 20.0
    speed: _Fast = 45.0
    sigma: _Sigma = 10.0
    scatter: Annotated[
        float, gate("1", "Highest standard deviation of a power over its mean.", gt=0)
    ] = 1.0


@dataclass(frozen=True, slots=True)
class CycleCourseParameters:
    """Parameters of :class:`CycleCourseFinder`."""

    exponent: _Exponent = 1.5
    loss: Annotated[
        Literal["squares", "huber", "tukey"], measured("", "squares: (9); the others are robust.")
    ] = "huber"
    lead_s: _Lead = 4.0
    quiet_s: _Quiet = 2.0
    most_s: _Most = 120.0
    line: _Line = ""
    expected_scatter: _Scatter = 0.5  # a course through places is off by more
    cycles: _Cycles = 6.0
    speed: _Fast = 45.0
    sigma: _Sigma = 10.0


@dataclass(frozen=True, slots=True)
class CurveParameters:
    """Parameters of :class:`CurveFinder`."""

    exponent: _Exponent = 1.5
    acceleration: Annotated[
        float, measured("m^2/s^3", "Spectral density of white acceleration.", gt=0)
    ] = 1.0
    lead_s: _Lead = 4.0
    quiet_s: _Quiet = 2.0
    most_s: _Most = 120.0
    line: _Line = ""
    expected_scatter: _Scatter = 0.45
    cycles: _Cycles = 6.0
    speed: _Fast = 45.0
    sigma: _Sigma = 10.0


class RunWorker(CycleStage):
    """What the finders share: they collect runs, and tell tracks and crossings of what they find.

    A run ends when no station has heard a vehicle for ``quiet_s``; what is found is told then. A
    run of several vehicles at once is fitted as one, but for the direct fit, which tells two apart.
    Where powers scatter about the only track by more than one vehicle's do, a note says so: two
    vehicles do that, and so does a ground that fades. So does one where the mirror image of a track
    in the line through the stations is as likely, as it is where these stand in a row.
    """

    gives = (TrackPoint, LineCrossing)
    least_stations = 3

    def __init__(self, parameters: Any) -> None:
        super().__init__(parameters)
        self._tracks = 0
        self._origin_ns = 0
        self._rides: tuple[VehicleTrajectory, ...] = ()

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin without a run."""
        p = self.parameters
        self.site, self._stage = site, stage
        self._lines = lines_of(site, p.line)
        self._runs = RunCollector(RunLimits(p.lead_s, p.quiet_s, p.most_s))
        return ("all",)

    def take(self, cycle: StationPowers) -> Candidates:
        """Return the candidate of the run that the cycle ends."""
        return self._candidate(self._runs.take(cycle))

    def finish(self) -> Candidates:
        """Return the candidate of the last run."""
        return self._candidate(self._runs.flush())

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the track of an accepted run, the lines it crosses, and whether to doubt it."""
        for ride, good in zip(self._rides, accepted, strict=False):
            if good:
                self._tracks += 1
                way = TrackOrigin(self._tracks, self._stage, self._origin_ns)
                yield from ride.points(way)
                yield from ride.crossings(self._lines, way)
                yield from self._doubts(ride)

    def _doubts(self, ride: VehicleTrajectory) -> Iterator[Note]:
        time_ns = self._origin_ns + round(float(ride.times_s[0]) * NS_PER_S)
        if ride.mirror_lost < _TOLD:
            text = (
                f"the mirror image of this course in the row of {', '.join(self.site.names)} fits "
                f"the powers as well: which side it is on, they do not tell"
            )
            yield Note(time_ns, text, "WARN", self._stage)
        expected = self.parameters.expected_scatter
        if len(self._rides) == 1 and ride.scatter > expected:
            text = (
                f"the scatter about this course is {ride.scatter:.2f} where {expected:g} at most "
                f"is expected: perhaps two vehicles"
            )
            yield Note(time_ns, text, "WARN", self._stage)

    @abstractmethod
    def rides(self, observed: Observed) -> tuple[VehicleTrajectory, ...]:
        """Return what the run was, nothing where the powers do not tell."""

    def _candidate(self, run: list[StationPowers]) -> Candidates:
        self._rides = ()
        if not run:
            return candidates_of([], len(self.columns))
        rides = self.rides(observed_of(run, self.site, self.parameters.exponent))
        if not rides:
            nothing = [0.0, *[np.nan] * (len(self.columns) - 1)]
            return candidates_of([(run[len(run) // 2].time_ns, 0, nothing)], len(self.columns))
        self._origin_ns = run[0].time_ns
        middles = [float(ride.times_s[len(ride.times_s) // 2]) for ride in rides]
        order = sorted(range(len(rides)), key=lambda i: middles[i])
        self._rides = tuple(rides[i] for i in order)
        rows = [
            (self._origin_ns + round(middles[i] * 1e9), 0, list(rides[i].values)) for i in order
        ]
        return candidates_of(rows, len(self.columns))


class CourseFinder(RunWorker):
    """The straight course that suits the powers of all cycles at once, rivals reckoned with.

    It is the one to use where vehicles go straight.
    """

    Parameters = CourseParameters
    columns = (
        Quantity("evidence", "1"),
        _SPEED,
        _PLACE,
        Quantity("scatter", "1"),
        Quantity("rivals", "1"),
    )
    gates = (
        Level("evidence", "1", "evidence"),
        *_MOTION,
        Level("scatter", "1", "scatter", at_least=False),
    )

    def rides(self, observed: Observed) -> tuple[VehicleTrajectory, ...]:
        """Return the course fitted to the powers, or the courses of two vehicles."""
        p = self.parameters
        search = search_bounds(observed.sensors, (p.slowest_mps, p.fastest_mps))
        return direct_rides(observed, search, self.site.velocity_mps, p.strength)


class CycleCourseFinder(RunWorker):
    """The paper's course: a place in every cycle, (7), and a straight line through them, (9)."""

    Parameters = CycleCourseParameters
    columns = (Quantity("cycles", "1"), _SPEED, _PLACE)
    gates = (Level("cycles", "1", "cycles"), *_MOTION)

    def rides(self, observed: Observed) -> tuple[VehicleTrajectory, ...]:
        """Return the course through the places."""
        ride = cycle_ride(observed, self.parameters.loss)
        return () if ride is None else (ride,)


class CurveFinder(RunWorker):
    """A curved path by an iterated smoother on the powers, for vehicles that do not go straight."""

    Parameters = CurveParameters
    columns = (Quantity("cycles", "1"), _SPEED, _PLACE)
    gates = (Level("cycles", "1", "cycles"), *_MOTION)

    def rides(self, observed: Observed) -> tuple[VehicleTrajectory, ...]:
        """Return the smoothed path."""
        ride = curved_ride(observed, self.parameters.acceleration)
        return () if ride is None else (ride,)


#: One strength of the vehicle for all cycles, one for each, or what the powers speak for.
Strength = Literal["one", "each", "auto"]
#: Exponents that are tried, over the one that is given. Chosen by trial on grounds drawn by seed 6
#: (bench/vehicle_accuracy.py).
_EXPONENTS = (0.67, 1.0, 1.5)
#: By these factors covariances grow for what no law of power knows, gains, loss and fading: of the
#: direct fit, of the course through places of cycles, and of the smoothed path. Chosen by trial on
#: the same grounds: two thirds of them are then within a standard deviation.
_DIRECT_UNKNOWN, _CYCLES_UNKNOWN, _CURVE_UNKNOWN = 4.5, 4.0, 2.0
#: Fewest places of single cycles that make a course or start a path. Chosen by judgement: two make
#: any line, a third one may be chance.
_LEAST_PLACES = 4
#: Nodes along the longer side of the lattice of single cycles. Chosen by judgement: finer than the
#: error of a single cycle.
_NODES = 60
#: Of the stations' longer side. Chosen by judgement: farther away powers tell no place.
_MARGIN = 0.75
#: Power over the noise from which a station counts in a single cycle [1], and the standard
#: deviation along the longer axis from which a place does not [m]. Chosen by judgement: a power
#: scatters by a third, so that noise alone seldom reaches it.
_CLEAR, _UNSURE_M = 1.5, 15.0


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTrajectory:
    """Where a vehicle is at every cycle in which it is heard.

    Attributes
    ----------
    times_s
        Shape (c,), increasing [s].
    courses
        Of each cycle: where it goes if it goes straight on.
    values
        What the gates look at, in the order of the method's columns.
    scatter
        Standard deviation of powers over those of one vehicle, of one strength, along it.
    mirror_lost
        By how much the log-likelihood of its mirror image in the line through the stations is
        lower, each cycle of a strength of its own; inf where the two are no further apart than
        the places err.
    """

    times_s: Array
    courses: tuple[Course, ...]
    values: tuple[float, ...]
    scatter: float
    mirror_lost: float

    def points(self, way: TrackOrigin) -> Iterator[TrackPoint]:
        """Yield the track."""
        for time, course in zip(self.times_s, self.courses, strict=True):
            (x, y), spread = course.at(time).tolist(), course.spread_at(time)
            vx, vy = course.velocity.tolist()
            yield TrackPoint(
                way.origin_ns + round(float(time) * NS_PER_S),
                way.track,
                x,
                y,
                vx,
                vy,
                (float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1])),
                way.stage,
            )

    def crossings(self, lines: Sequence[Line], way: TrackOrigin) -> Iterator[LineCrossing]:
        """Yield the lines that are crossed, by the course of the cycle that is nearest in time."""
        edges = np.concatenate(
            [self.times_s[:1], (self.times_s[1:] + self.times_s[:-1]) / 2, self.times_s[-1:]]
        )
        for line in lines:
            for cycle, course in enumerate(self.courses):
                # a straight course is one for all cycles, and crosses once
                span = (float(edges[cycle]), float(np.nextafter(edges[cycle + 1], -np.inf)))
                yield from crossing_of(line, course, span, way)


def direct_rides(
    observed: Observed, search: Search, velocity_mps: float, strength: Strength = "auto"
) -> tuple[VehicleTrajectory, ...]:
    """Return the straight course fitted to the powers of all cycles at once, or two.

    Of several exponents of the law, and one strength for all cycles or one for each, the likeliest
    is taken, by the Bayesian information criterion; others that are nearly as likely widen its
    covariance.

    Parameters
    ----------
    observed
        Powers of a run.
    search
        Where and how fast vehicles may be.
    velocity_mps
        Of the waves, inf where unknown.
    strength
        Whether the vehicle's strength is one for all cycles, or each has its own; ``auto``: by what
        is likelier.
    """
    span = heard_span(observed)
    if span.stop - span.start < _LEAST_PLACES:
        return ()
    steady = _tried(observed, search, each_mu=False)
    varying = _tried(observed, search, each_mu=True) if strength != "one" else []
    likeliest = _likeliest([*(steady if strength != "each" else []), *varying])
    if likeliest is None:
        return ()
    fit, own_law = likeliest
    alone, its_law = min(steady, key=lambda one: _criterion(one[0]), default=(None, observed))
    both = None if alone is None else fit_two(its_law, search, alone)
    spans = [_own_span(fitted_powers, one) for one, fitted_powers in both or ()]
    # where one of two is heard in no cycle beside the other, there is but one
    if both is None or any(vehicle_span.start == vehicle_span.stop for vehicle_span in spans):
        scatter = fit.relative_sigma if alone is None else alone.relative_sigma
        return (_direct_ride(own_law, fit, span, velocity_mps, scatter),)
    return tuple(
        _direct_ride(fitted_powers, one, vehicle_span, velocity_mps, one.relative_sigma)
        for (one, fitted_powers), vehicle_span in zip(both, spans, strict=True)
    )


def _own_span(observed: Observed, fit: CourseFit) -> slice:
    """Return the cycles in which one vehicle of two is heard."""
    power = vehicle_power(observed, fit)
    return heard_span(replace(observed, powers=observed.floors + power))


def _direct_ride(
    observed: Observed, fit: CourseFit, span: slice, velocity_mps: float, scatter: float
) -> VehicleTrajectory:
    course = _undelayed(fit, observed, velocity_mps)
    times = observed.times_s[span]
    values = (fit.evidence, *_motion(course, times), fit.relative_sigma, float(len(fit.rivals)))
    lost = mirror_lost(part_of(observed, span), course.at(times), values[2])
    return VehicleTrajectory(times, (course,) * len(times), values, scatter, lost)


def cycle_ride(observed: Observed, loss: Loss) -> VehicleTrajectory | None:
    """Return the course through the places of single cycles, (7) and then (9) or a robust loss."""
    near_powers = part_of(observed, near_span(observed))
    places, _ = _places(near_powers)
    valid = np.isfinite(places).all(axis=1)
    if valid.sum() < _LEAST_PLACES:
        return None
    course = through(near_powers.times_s[valid], places[valid], loss)
    off = places - course.at(near_powers.times_s)
    course = _widened(course, _CYCLES_UNKNOWN * repeated(off))
    values = (float(valid.sum()), *_motion(course, near_powers.times_s))
    along = course.at(near_powers.times_s)
    scatter, lost = scatter_along(near_powers, along), mirror_lost(near_powers, along, values[2])
    return VehicleTrajectory(
        near_powers.times_s, (course,) * len(near_powers.times_s), values, scatter, lost
    )


def curved_ride(observed: Observed, acceleration: float) -> VehicleTrajectory | None:
    """Return the path by the iterated smoother on powers, from the places of single cycles.

    Once with the paper's scatter of powers, then with the one found about that path.
    """
    near_powers = part_of(observed, near_span(observed))
    places, spreads = _places(near_powers)
    valid = np.isfinite(places).all(axis=1)
    if valid.sum() < _LEAST_PLACES:
        return None
    motion = MotionModel(acceleration)
    guess = track_places(near_powers.times_s, places, spreads, motion)
    path = track(near_powers, guess, motion, RELATIVE_SIGMA)
    path = track(near_powers, path, motion, scatter_about(near_powers, path))
    courses = tuple(
        _widened(path.course(cycle), _CURVE_UNKNOWN) for cycle in range(len(path.times_s))
    )
    middle = courses[len(courses) // 2]
    values = (float(valid.sum()), *_motion(middle, path.times_s[len(courses) // 2 :][:1]))
    scatter, lost = (
        scatter_along(near_powers, path.places),
        mirror_lost(near_powers, path.places, values[2]),
    )
    return VehicleTrajectory(path.times_s, courses, values, scatter, lost)


def _widened(course: Course, factor: float) -> Course:
    return replace(course, covariance=factor * course.covariance)


def search_bounds(sensors: Array, speeds_mps: tuple[float, float]) -> Search:
    """Return where and how fast vehicles may be."""
    return replace(Search.about(sensors, _MARGIN), speeds_mps=speeds_mps)


def mirror_lost(observed: Observed, places: Array, sigma_m: float) -> float:
    """Return by how much less likely a path's mirror image is, see :class:`VehicleTrajectory`.

    Parameters
    ----------
    observed
        Powers of the path's cycles.
    places
        Shape (c, 2): of the path [m].
    sigma_m
        Standard deviation of a place [m].
    """
    centre, along = line_through(observed.sensors)
    off = places - centre
    mirrored = centre + 2 * (off @ along)[:, None] * along - off
    if float(np.median(np.hypot(*(mirrored - places).T))) <= sigma_m:
        return float("inf")
    lost, lost_mirrored = (_cycle_deviance(observed, path) for path in (places, mirrored))
    samples = int(usable(observed.powers).sum())
    relative = max(RELATIVE_SIGMA**2, lost / max(samples, 1))
    return (lost_mirrored - lost) / (2 * relative)


def _cycle_deviance(observed: Observed, places: Array) -> float:
    """Return the deviance of powers from a vehicle's at places, of a strength for each cycle."""
    used = usable(observed.powers)
    powers = np.where(used, observed.powers, 1.0)
    floors = np.where(used, observed.floors, 0.0)
    spread = observed.law.power(ranges(places, observed.sensors))
    mean = np.exp(strengths(powers, floors, spread, (1,))) * spread + floors
    return float(deviance(powers, mean)[used].sum())


def _places(observed: Observed) -> tuple[Array, Array]:
    low, high = observed.sensors.min(axis=0), observed.sensors.max(axis=0)
    longer = float((high - low).max())
    step = longer * (1 + 2 * _MARGIN) / _NODES
    x, y = (
        np.arange(a - _MARGIN * longer, b + _MARGIN * longer + step / 2, step)
        for a, b in zip(low, high, strict=True)
    )
    clear = observed.powers > _CLEAR * observed.floors
    places, spreads = cycle_places(
        replace(observed, powers=np.where(clear, observed.powers, np.nan)), x, y
    )
    valid = np.asarray(np.isfinite(spreads).all(axis=(1, 2)))
    larger = np.linalg.eigvalsh(np.where(valid[:, None, None], spreads, 0.0))[:, -1]
    unsure = ~valid | (larger > _UNSURE_M**2)
    places[unsure], spreads[unsure] = np.nan, np.inf
    return places, spreads


def _motion(course: Course, times_s: Array) -> tuple[float, float]:
    """Return the speed, and the standard deviation of the place in the middle [m]."""
    spread = course.spread_at(np.array([times_s[len(times_s) // 2]]))[0]
    return course.speed_mps, float(np.sqrt(np.trace(spread) / 2))


def _tried(observed: Observed, search: Search, each_mu: bool) -> list[tuple[CourseFit, Observed]]:
    """Return fits by several exponents, each with the powers and the law that it is of."""
    of_laws = [
        replace(observed, law=replace(observed.law, exponent=k * observed.law.exponent))
        for k in _EXPONENTS
    ]
    fits = [(fit_course(one, search, each_mu, fit_noise=True), one) for one in of_laws]
    return [(fit, one) for fit, one in fits if fit is not None]


def _likeliest(tried: list[tuple[CourseFit, Observed]]) -> tuple[CourseFit, Observed] | None:
    """Return the likeliest fit; those that are nearly as likely are its rivals."""
    if not tried:
        return None
    best, of_law = min(tried, key=lambda one: _criterion(one[0]))
    lost = [(_criterion(fit) - _criterion(best)) / 2 for fit, _ in tried]
    others = [
        (fit.course, off)
        for (fit, _), off in zip(tried, lost, strict=True)
        if fit is not best and off < MOST_LOST
    ]
    return replace(best, rivals=(*best.rivals, *others)), of_law


def _criterion(fit: CourseFit) -> float:
    """Return Schwarz's criterion, lower where likelier, the scatter of powers found too."""
    unknowns = 4 + len(fit.log_mu)
    return float(fit.samples * np.log(fit.relative_sigma**2) + unknowns * np.log(fit.samples))


def _undelayed(fit: CourseFit, observed: Observed, velocity_mps: float) -> Course:
    """Return the course as it was driven: powers tell it later, by the way of the waves.

    One delay for all cycles, the mean by how strong the vehicle is.
    """
    course = fit.tempered(_DIRECT_UNKNOWN).cautious
    if not np.isfinite(velocity_mps):
        return course
    r = ranges(course.at(observed.times_s), observed.sensors)
    weights = observed.law.power(r)
    delay_s = float((weights * r).sum() / weights.sum()) / velocity_mps
    return replace(course, time_s=course.time_s - delay_s)


#: Sine of the angle at which a line has to be crossed: along it, place and time are unknown. Chosen
#: by judgement: 17 degrees.
_STEEP = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line through two points [m], and its name."""

    name: str
    start: Array
    end: Array


@dataclass(frozen=True, slots=True)
class TrackOrigin:
    """What a vehicle's course is known by.

    Attributes
    ----------
    track, stage
        Number of the track, and the stage.
    origin_ns
        Time that the course's times count from.
    """

    track: int
    stage: str
    origin_ns: int


def lines_of(site: Stations, text: str = "") -> tuple[Line, ...]:
    """Return the lines of a site, and the one told as ``x,y x,y`` [m].

    Stations whose names differ by their number alone, as A1 to A3, are an antenna; its line goes
    through the two that are farthest apart.

    Raises
    ------
    PipelineError
        Where the text is not two places.
    """
    lines = []
    if text:
        lines.append(_parsed_line(text))
    lines += [Line("road", a, b) for a, b in pairwise(site.road)]
    order = sorted(range(len(site.names)), key=lambda i: site.names[i])
    for _, members in groupby(order, key=lambda i: re.sub(r"\d+$", "", site.names[i])):
        those = list(members)
        if len(those) > 1:
            places = site.places[those]
            apart = np.linalg.norm(places[:, None] - places, axis=2)
            a, b = sorted(np.unravel_index(int(apart.argmax()), apart.shape))
            name = f"{site.names[those[a]]}-{site.names[those[b]]}"
            lines.append(Line(name, places[a], places[b]))
    return tuple(lines)


def _parsed_line(text: str) -> Line:
    try:
        (x0, y0), (x1, y1) = (map(float, point.split(",")) for point in text.split())
    except ValueError:
        raise PipelineError(f"line: expected two places as x,y x,y, found {text!r}") from None
    if (x0, y0) == (x1, y1):
        raise PipelineError(f"line: expected two places apart, found {text!r}")
    return Line("line", np.array([x0, y0]), np.array([x1, y1]))


def crossing_of(
    line: Line, course: Course, span_s: tuple[float, float], way: TrackOrigin
) -> Iterator[LineCrossing]:
    """Yield where a course crosses a line between its ends, within a span of time [s]."""
    along = (line.end - line.start) / np.hypot(*(line.end - line.start))
    vx, vy = course.velocity
    steep = abs(along[0] * vy - along[1] * vx) / max(course.speed_mps, 1e-9)
    crossing = course.crossing(line.start, line.end) if steep >= _STEEP else None
    if crossing is None or not crossing.inside or not span_s[0] <= crossing.time_s <= span_s[1]:
        return
    x, y = crossing.position.tolist()
    yield LineCrossing(
        way.origin_ns + round(crossing.time_s * NS_PER_S),
        crossing.time_sigma_s,
        way.track,
        line.name,
        x,
        y,
        crossing.along_sigma_m,
        course.speed_mps,
        course.speed_sigma_mps,
        course.heading_rad,
        way.stage,
    )
