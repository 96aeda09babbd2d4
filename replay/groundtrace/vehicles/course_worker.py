"""Courses of vehicles, fitted at the end of each run: straight at once, by cycles, or curved."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from groundtrace_codecs.events import LineCrossing, Note, Quantity, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Level
from ..parameters import gate, measured
from .api import candidates_of
from .crossings import Way, lines_of
from .joining import CycleStage
from .rides import about, curved_ride, cycle_ride, direct_rides
from .runs import RunCollector, RunLimits, observed_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..gates import Candidates
    from .api import Cycle
    from .courses import Observed
    from .rides import Ride

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
#: then 20 times less likely.
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
    expected_scatter: _Scatter = 0.45
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
        self._found: tuple[Ride, ...] = ()

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin without a run."""
        p = self.parameters
        self.site, self._stage = site, stage
        self._lines = lines_of(site, p.line)
        self._runs = RunCollector(RunLimits(p.lead_s, p.quiet_s, p.most_s))
        return ("all",)

    def take(self, cycle: Cycle) -> Candidates:
        """Return the candidate of the run that the cycle ends."""
        return self._candidate(self._runs.take(cycle))

    def finish(self) -> Candidates:
        """Return the candidate of the last run."""
        return self._candidate(self._runs.finish())

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the track of an accepted run, the lines it crosses, and whether to doubt it."""
        for ride, good in zip(self._found, accepted, strict=False):
            if good:
                self._tracks += 1
                way = Way(self._tracks, self._stage, self._origin_ns)
                yield from ride.points(way)
                yield from ride.crossings(self._lines, way)
                yield from self._doubts(ride)

    def _doubts(self, ride: Ride) -> Iterator[Note]:
        time_ns = self._origin_ns + round(float(ride.times_s[0]) * NS_PER_S)
        if ride.mirror_lost < _TOLD:
            text = (
                f"the mirror image of this course in the row of {', '.join(self.site.names)} fits "
                f"the powers as well: which side it is on, they do not tell"
            )
            yield Note(time_ns, text, "WARN", self._stage)
        expected = self.parameters.expected_scatter
        if len(self._found) == 1 and ride.scatter > expected:
            text = (
                f"the scatter about this course is {ride.scatter:.2f} where {expected:g} at most "
                f"is expected: perhaps two vehicles"
            )
            yield Note(time_ns, text, "WARN", self._stage)

    @abstractmethod
    def rides(self, observed: Observed) -> tuple[Ride, ...]:
        """Return what the run was, nothing where the powers do not tell."""

    def _candidate(self, run: list[Cycle]) -> Candidates:
        self._found = ()
        if not run:
            return candidates_of([], len(self.columns))
        found = self.rides(observed_of(run, self.site, self.parameters.exponent))
        if not found:
            nothing = [0.0, *[np.nan] * (len(self.columns) - 1)]
            return candidates_of([(run[len(run) // 2].time_ns, 0, nothing)], len(self.columns))
        self._origin_ns = run[0].time_ns
        middles = [float(ride.times_s[len(ride.times_s) // 2]) for ride in found]
        order = sorted(range(len(found)), key=lambda i: middles[i])
        self._found = tuple(found[i] for i in order)
        rows = [
            (self._origin_ns + round(middles[i] * 1e9), 0, list(found[i].values)) for i in order
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

    def rides(self, observed: Observed) -> tuple[Ride, ...]:
        """Return the course fitted to the powers, or the courses of two vehicles."""
        p = self.parameters
        search = about(observed.sensors, (p.slowest_mps, p.fastest_mps))
        return direct_rides(observed, search, self.site.velocity_mps, p.strength)


class CycleCourseFinder(RunWorker):
    """The paper's course: a place in every cycle, (7), and a straight line through them, (9)."""

    Parameters = CycleCourseParameters
    columns = (Quantity("cycles", "1"), _SPEED, _PLACE)
    gates = (Level("cycles", "1", "cycles"), *_MOTION)

    def rides(self, observed: Observed) -> tuple[Ride, ...]:
        """Return the course through the places."""
        ride = cycle_ride(observed, self.parameters.loss)
        return () if ride is None else (ride,)


class CurveFinder(RunWorker):
    """A curved path by an iterated smoother on the powers, for vehicles that do not go straight."""

    Parameters = CurveParameters
    columns = (Quantity("cycles", "1"), _SPEED, _PLACE)
    gates = (Level("cycles", "1", "cycles"), *_MOTION)

    def rides(self, observed: Observed) -> tuple[Ride, ...]:
        """Return the smoothed path."""
        ride = curved_ride(observed, self.parameters.acceleration)
        return () if ride is None else (ride,)
