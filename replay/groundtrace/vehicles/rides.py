"""A vehicle's ride through a run: places and motion at every cycle, by one of three methods."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from .api import line_through
from .courses import fit_course, vehicle_power
from .crossings import crossing_of
from .cycles import RELATIVE_SIGMA
from .lines import Course, through
from .medium import ranges
from .runs import heard_span, near_span, part_of
from .scoring import deviance, usable
from .search import Search, strengths
from .tracker import MotionModel, cycle_places, scatter_about, track, track_places
from .two_courses import fit_two, scatter_along

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import LineCrossing

    from .courses import CourseFit, Observed
    from .crossings import Line, Way
    from .lines import Loss

    Array = NDArray[np.float64]

#: One strength of the vehicle for all cycles, one for each, or what the powers speak for.
Strength = Literal["one", "each", "auto"]
#: Fewest places of single cycles that make a course or start a path.
_LEAST_PLACES = 4
#: Nodes along the longer side of the lattice of single cycles.
_NODES = 60
_MARGIN = 0.75  # of the stations' longer side
#: Power over the noise from which a station counts in a single cycle [1], and the standard
#: deviation along the longer axis from which a place does not [m].
_CLEAR, _UNSURE_M = 1.5, 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Ride:
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

    def points(self, way: Way) -> Iterator[TrackPoint]:
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

    def crossings(self, lines: Sequence[Line], way: Way) -> Iterator[LineCrossing]:
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
) -> tuple[Ride, ...]:
    """Return the straight course fitted to the powers of all cycles at once, or two.

    Parameters
    ----------
    observed
        Powers of a run.
    search
        Where and how fast vehicles may be.
    velocity_mps
        Of the waves, inf where unknown.
    strength
        Whether the vehicle's strength is one for all cycles, or each has its own; ``auto``: by the
        Bayesian information criterion.
    """
    span = heard_span(observed)
    if span.stop - span.start < _LEAST_PLACES:
        return ()
    fit = _fitted(observed, search, strength)
    if fit is None:
        return ()
    alone = fit if len(fit.log_mu) == 1 else fit_course(observed, search, fit_noise=True)
    both = None if alone is None else fit_two(observed, search, alone)
    spans = [_own_span(heard, one) for one, heard in both or ()]
    # where one of two is heard in no cycle beside the other, there is but one
    if both is None or any(own.start == own.stop for own in spans):
        scatter = fit.relative_sigma if alone is None else alone.relative_sigma
        return (_direct_ride(observed, fit, span, velocity_mps, scatter),)
    return tuple(
        _direct_ride(heard, one, own, velocity_mps, one.relative_sigma)
        for (one, heard), own in zip(both, spans, strict=True)
    )


def _own_span(observed: Observed, fit: CourseFit) -> slice:
    """Return the cycles in which one vehicle of two is heard."""
    power = vehicle_power(observed, fit)
    return heard_span(replace(observed, powers=observed.floors + power))


def _direct_ride(
    observed: Observed, fit: CourseFit, span: slice, velocity_mps: float, scatter: float
) -> Ride:
    course = _undelayed(fit, observed, velocity_mps)
    times = observed.times_s[span]
    values = (fit.evidence, *_motion(course, times), fit.relative_sigma, float(len(fit.rivals)))
    lost = mirror_lost(part_of(observed, span), course.at(times), values[2])
    return Ride(times, (course,) * len(times), values, scatter, lost)


def cycle_ride(observed: Observed, loss: Loss) -> Ride | None:
    """Return the course through the places of single cycles, (7) and then (9) or a robust loss."""
    heard = part_of(observed, near_span(observed))
    places, _ = _places(heard)
    known = np.isfinite(places).all(axis=1)
    if known.sum() < _LEAST_PLACES:
        return None
    course = through(heard.times_s[known], places[known], loss)
    values = (float(known.sum()), *_motion(course, heard.times_s))
    along = course.at(heard.times_s)
    scatter, lost = scatter_along(heard, along), mirror_lost(heard, along, values[2])
    return Ride(heard.times_s, (course,) * len(heard.times_s), values, scatter, lost)


def curved_ride(observed: Observed, acceleration: float) -> Ride | None:
    """Return the path by the iterated smoother on powers, from the places of single cycles.

    Once with the paper's scatter of powers, then with the one found about that path.
    """
    heard = part_of(observed, near_span(observed))
    places, spreads = _places(heard)
    known = np.isfinite(places).all(axis=1)
    if known.sum() < _LEAST_PLACES:
        return None
    motion = MotionModel(acceleration)
    guess = track_places(heard.times_s, places, spreads, motion)
    path = track(heard, guess, motion, RELATIVE_SIGMA)
    path = track(heard, path, motion, scatter_about(heard, path))
    courses = tuple(path.course(cycle) for cycle in range(len(path.times_s)))
    middle = courses[len(courses) // 2]
    values = (float(known.sum()), *_motion(middle, path.times_s[len(courses) // 2 :][:1]))
    scatter, lost = scatter_along(heard, path.places), mirror_lost(heard, path.places, values[2])
    return Ride(path.times_s, courses, values, scatter, lost)


def about(sensors: Array, speeds_mps: tuple[float, float]) -> Search:
    """Return where and how fast vehicles may be."""
    return replace(Search.about(sensors, _MARGIN), speeds_mps=speeds_mps)


def mirror_lost(observed: Observed, places: Array, sigma_m: float) -> float:
    """Return by how much less likely a path's mirror image is, see :class:`Ride`.

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
    known = np.asarray(np.isfinite(spreads).all(axis=(1, 2)))
    larger = np.linalg.eigvalsh(np.where(known[:, None, None], spreads, 0.0))[:, -1]
    unsure = ~known | (larger > _UNSURE_M**2)
    places[unsure], spreads[unsure] = np.nan, np.inf
    return places, spreads


def _motion(course: Course, times_s: Array) -> tuple[float, float]:
    """Return the speed, and the standard deviation of the place in the middle [m]."""
    spread = course.spread_at(np.array([times_s[len(times_s) // 2]]))[0]
    return course.speed_mps, float(np.sqrt(np.trace(spread) / 2))


def _fitted(observed: Observed, search: Search, strength: Strength) -> CourseFit | None:
    kinds = {"one": (False,), "each": (True,), "auto": (False, True)}[strength]
    fits = [fit_course(observed, search, each, fit_noise=True) for each in kinds]
    return min((fit for fit in fits if fit is not None), key=_criterion, default=None)


def _criterion(fit: CourseFit) -> float:
    """Return Schwarz's criterion, lower where likelier, the scatter of powers found too."""
    unknowns = 4 + len(fit.log_mu)
    return float(fit.samples * np.log(fit.relative_sigma**2) + unknowns * np.log(fit.samples))


def _undelayed(fit: CourseFit, observed: Observed, velocity_mps: float) -> Course:
    """Return the course as it was driven: powers tell it later, by the way of the waves.

    One delay for all cycles, the mean by how strong the vehicle is.
    """
    course = fit.cautious
    if not np.isfinite(velocity_mps):
        return course
    r = ranges(course.at(observed.times_s), observed.sensors)
    weights = observed.law.power(r)
    delay_s = float((weights * r).sum() / weights.sum()) / velocity_mps
    return replace(course, time_s=course.time_s - delay_s)
