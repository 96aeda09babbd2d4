"""What localizers share: outline of a site, arrivals of an impact, the floor estimated so far."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import shapely

from groundtrace_codecs.events import Fix, Note, Pick, Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.robust import ChiSquareCheck, chi_square_quantile
from ..errors import PipelineError
from ..pipeline.gates import Candidates, Level, Reach, gate_specs, never_passed
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import LEAST_PICKS, CannotStart, Context, Input, Memory, Stage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event
    from groundtrace_codecs.geometry import Medium

    from ..pipeline.gates import Gate
    from ..pipeline.stage import LocationEstimate, Output
    from .path_errors import PathErrors

    Array = NDArray[np.float64]

#: Without an outline the sensors' rectangle is searched, widened by this part of its longer side.
#: Chosen by judgement: steps are heard from a little beyond the sensors too.
MARGIN = 0.1


def outline_of(
    positions: NDArray[np.float64], outline: NDArray[np.float64] | None = None
) -> shapely.Polygon:
    """Return the area to search.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.

    Raises
    ------
    PipelineError
        Where the outline encloses no area or crosses itself, or no sensors span one.
    """
    if outline is None or len(outline) == 0:
        low, high = positions.min(axis=0), positions.max(axis=0)
        pad = MARGIN * float(np.max(high - low))
        room = shapely.box(*(low - pad), *(high + pad))
    else:
        room = shapely.Polygon(outline) if len(outline) > 2 else shapely.Polygon()
    if room.area <= 0 or not room.is_valid:
        raise PipelineError(
            f"geometry: outline: expected corners around an area, found "
            f"{shapely.is_valid_reason(room) if room.area > 0 else 'none'}"
        )
    return room


#: Places looked back on, and how many of them the value given beforehand counts as. Chosen by
#: judgement: a minute of steps follows a slow change, and four hold the value while little is
#: known.
MEMORY, PRIOR_COUNT = 64, 4


@dataclass(slots=True)
class RunningSigma:
    """The standard deviation of an arrival: the median of those that single places tell.

    One place has few arrivals to spare and tells little; a median of many stands false picks.

    Attributes
    ----------
    prior_s
        What it is before there are places [s].
    unknowns
        How many arrivals a place uses up.
    """

    prior_s: float
    unknowns: int
    sigmas_s: deque[float] = field(default_factory=lambda: deque(maxlen=MEMORY))

    @property
    def value_s(self) -> float:
        """The estimate by now [s]."""
        return median([*self.sigmas_s, *[self.prior_s] * PRIOR_COUNT])

    def learn(self, estimate: LocationEstimate) -> None:
        """Take in the residual of a place, the root of its mean loss [s]."""
        spare = estimate.picks - self.unknowns
        if not estimate.located or spare < 1:
            return
        typical = (chi_square_quantile(spare, 0.0) / spare) ** 0.5
        self.sigmas_s.append(estimate.residual * (estimate.picks / spare) ** 0.5 / typical)


#: A model may be wrong by this part of how far arrivals are apart. Chosen by judgement: as much as
#: velocities differ over a floor.
MODEL_ERROR = 0.2


@dataclass(slots=True)
class ModelCheck:
    """Whether residuals of the last places are those of the model: their chi-square.

    Attributes
    ----------
    sigma_s
        The standard deviation of an arrival that the localizer begins with [s].
    unknowns
        How many arrivals a place uses up.
    """

    sigma_s: float
    unknowns: int
    residuals: ChiSquareCheck = field(default_factory=ChiSquareCheck)

    def learn(self, estimate: LocationEstimate, times_s: Array) -> None:
        """Take in the residual of a place, the root of its mean loss [s]."""
        spare = estimate.picks - self.unknowns
        if not estimate.located or spare < 1:
            return
        scatter = float(times_s[np.isfinite(times_s)].std())
        square = (
            estimate.picks * estimate.residual**2 / (self.sigma_s**2 + (MODEL_ERROR * scatter) ** 2)
        )
        self.residuals.learn(square, spare)


#: How arrival times grow with distance on a thin plate. Source: thesis, equation (4.24).
EXPONENT = 4 / 3


@dataclass(frozen=True, slots=True, eq=False)
class ArrivalModel:
    """Arrivals t = t0 + pace (d / reference)^exponent + offset.

    The pace is the scale k of t = t0 + k d^p where d is the reference: unlike k it hardly depends
    on the exponent, so that both can be estimated together.

    Attributes
    ----------
    reference_m
        A distance typical of the layout [m].
    pace_s
        How long a wave takes over it [s].
    exponent
        p; 4/3 on a thin plate, 1 where velocity is constant.
    offsets_s
        Shape (n,): how far the clock of each sensor is ahead [s]; their sum is 0.
    """

    reference_m: float
    pace_s: float
    exponent: float
    offsets_s: Array

    @property
    def scale(self) -> float:
        """The scale k of t = t0 + k d^p [s/m^p]."""
        return float(self.pace_s * self.reference_m**-self.exponent)

    def travel_s(self, distance_m: Array) -> Array:
        """Return how long waves take over distances [s]."""
        taken: Array = self.pace_s * (distance_m / self.reference_m) ** self.exponent
        return taken

    def near(self, other: ArrivalModel) -> bool:
        """Whether another floor is the same to 1e-5 of the pace."""
        least = 1e-5 * self.pace_s
        return (
            abs(self.pace_s - other.pace_s) < least
            and abs(self.exponent - other.exponent) < 1e-5
            and bool(np.all(np.abs(self.offsets_s - other.offsets_s) < least))
        )


@dataclass(frozen=True, slots=True)
class ArrivalPrior:
    """What is known of a floor beforehand; infinite deviations know nothing.

    Attributes
    ----------
    pace_s, pace_deviation
        The pace [s], and the standard deviation of its logarithm.
    exponent, exponent_deviation
        The exponent and its standard deviation.
    """

    pace_s: float = 1.0
    pace_deviation: float = float("inf")
    exponent: float = EXPONENT
    exponent_deviation: float = float("inf")

    def surer(self, factor: float) -> ArrivalPrior:
        """Return it with variances that are smaller by a factor."""
        return replace(
            self,
            pace_deviation=self.pace_deviation / factor**0.5,
            exponent_deviation=self.exponent_deviation / factor**0.5,
        )


def reference_distance(positions: Array) -> float:
    """Return the root mean square distance of sensors, shape (n, 2), from their middle [m]."""
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))


#: A place tells which sensors are near the next one for so long [ns]. Source: as a track ends, two
#: seconds without a fix.
STILL_NEAR_NS = 2 * NS_PER_S
#: Arrivals older than this before the newest are forgotten: a step is announced well before [ns].
#: Chosen by judgement: it bounds memory.
KEEP_NS = 10 * NS_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSensors:
    """Where a localizer works.

    Attributes
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None where unknown.
    medium
        What the waves run through.
    length_unit
        ``m``, or ``units`` where the unit of all these lengths is unknown.
    """

    positions: NDArray[np.float64]
    outline: NDArray[np.float64] | None
    medium: Medium
    length_unit: str = "m"


@dataclass(frozen=True, slots=True)
class LocalizerParameters:
    """Parameters that every localizer has."""

    window_s: Annotated[
        float, measured("s", "Longest time after a step that arrivals belong to it.", gt=0)
    ] = 0.05
    min_picks: Annotated[int, gate("1", "Least number of arrivals, one a channel.", ge=3)] = 3
    nearest: Annotated[
        int,
        measured(
            "1",
            "Arrivals taken, of so many sensors nearest to the place before; 0: of all.",
            ge=0,
        ),
    ] = 0


class ArrivalLocalizer(Stage):
    """Finds the place of each step by its arrivals, and its gates decide which places count.

    A step is announced once its arrivals are complete, so it is located at once. Where a clock is
    set back the arrivals are forgotten; what was learnt of the floor goes on. With ``nearest`` a
    step is located by the sensors around the place before alone, as the outlook of the thesis on
    footstep localisation suggests.

    Notes
    -----
    ``Parameters`` is a dataclass that derives from :class:`LocalizerParameters`. ``columns`` are
    those of :func:`columns`.
    """

    takes = (Input(Pick), Input(StepEvent))
    gives = (Fix,)
    compiles = ("locate",)
    ends_at = "clock step"
    site_lengths = True

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters
        self._context: Context | None = None
        self._channels: dict[str, int] = {}
        self._picks: deque[Pick] = deque()
        self._reported = False
        self._before: tuple[int, Array] | None = None
        self._check: ModelCheck | None = None
        self._path_errors: PathErrors | None = None
        self._doubted = False

    @property
    def memory(self) -> Memory:
        """All places before, which tell how well the model holds; and the window of a step."""
        return Memory(None, self.parameters.window_s)

    def begin(self, site: PlacedSensors) -> str:
        """Begin at a site; return what it lacks, or an empty text."""
        self._positions = site.positions
        missing = self.prepare(site)
        self._path_errors = None if missing else self.path_errors()
        return missing

    @abstractmethod
    def prepare(self, site: PlacedSensors) -> str:
        """Prepare for a site; return what it lacks, or an empty text."""

    def model_check(self) -> ModelCheck | None:
        """Return what looks at the residuals; None where they are no times."""
        return None

    def path_errors(self) -> PathErrors | None:
        """Return what learns how far arrivals err alike; None where places are not by times."""
        return None

    @abstractmethod
    def locate(self, times_s: Array) -> LocationEstimate:
        """Return the place for arrivals, shape (n,), NaN where a sensor has none."""

    def start(self, context: Context) -> tuple[str, ...]:
        """Prepare for the site of the channels that are picked, or begin anew without arrivals."""
        self._picks.clear()
        self._before = None
        if self._context is not None:
            return ("all",)
        geometry = context.geometry
        self._channels, positions = geometry.placed(context.source.channels)
        missing = "places of three or more sensors"
        if len(np.unique(positions, axis=0)) >= LEAST_PICKS:
            outline = np.array(geometry.outline, np.float64)
            room = outline if len(outline) else None
            missing = self.begin(
                PlacedSensors(positions, room, geometry.medium, geometry.length_unit)
            )
        if missing:
            raise CannotStart(f"no places: expected a geometry with {missing}, found none")
        self._check = self.model_check()
        self._offsets_s = geometry.clock_offsets(self._channels)
        self._context = context
        return ("all",)

    def process(self, item: Pick | StepEvent) -> Iterable[Output]:
        """Gather picks, and locate steps."""
        if isinstance(item, StepEvent):
            return self._located(item)
        if item.channel in self._channels:
            self._picks.append(item)
            while self._picks[0].time_ns < item.time_ns - KEEP_NS:
                self._picks.popleft()
        return ()

    def _located(self, item: StepEvent) -> Iterator[Output]:
        """Yield a step's place for the gates."""
        yield from self._never_passed(item.time_ns)
        while self._picks and self._picks[0].time_ns < item.time_ns:
            self._picks.popleft()
        window_s = self.parameters.window_s
        arrivals = first_arrivals(
            self._picks, self._channels, item.time_ns, window_s, self._offsets_s
        )
        self._latest_estimate = item.time_ns, self.locate_step(item.time_ns, arrivals)
        yield from self._checked(item.time_ns, arrivals)
        yield place_candidate(*self._latest_estimate)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts."""
        assert self._context is not None  # it was started
        if block.accepted[0]:
            time_ns, location = self._latest_estimate
            context, doubted = self._context, self._doubted
            yield location.fix(time_ns, context.plugin, context.stage, doubted=doubted)

    def locate_step(self, time_ns: int, arrivals: Array) -> LocationEstimate:
        """Return the place of the next step, by the arrivals that are taken of it.

        Parameters
        ----------
        time_ns
            Of the step.
        arrivals
            Shape (n,): of all sensors [s]; NaN where there is none.
        """
        count = self.parameters.nearest
        if not count:
            return self._widened(arrivals)
        estimate = self._widened(self._around(time_ns, arrivals, count))
        if estimate.located and self._passes(estimate):
            self._before = time_ns, np.array([estimate.x, estimate.y])
        return estimate

    def _widened(self, arrivals: Array) -> LocationEstimate:
        """Return the place, its covariance widened by what arrivals err alike."""
        estimate, errors = self.locate(arrivals), self._path_errors
        return estimate if errors is None else errors.widened(estimate, arrivals)

    def _around(self, time_ns: int, arrivals: Array, count: int) -> Array:
        """Return the arrivals of so many sensors nearest to the place before, the others NaN."""
        if self._before is None or time_ns - self._before[0] > STILL_NEAR_NS:
            return arrivals
        distance = np.hypot(*(self._positions - self._before[1]).T)
        distance[np.isnan(arrivals)] = np.inf
        near = np.argsort(distance, kind="stable")[:count]
        nearest = np.full_like(arrivals, np.nan)
        nearest[near] = arrivals[near]
        return nearest

    def _passes(self, estimate: LocationEstimate) -> bool:
        """Whether a place passes the gates, on which the next one may then rely."""
        value = place_candidate(0, estimate).value[0]
        values = dict(zip((column.name for column in self.columns), value, strict=True))
        return all(
            (1 if gate.at_least else -1) * (values[gate.name] - gate.threshold) >= 0
            for gate in gate_specs(self.gates, self.parameters)
        )

    def _checked(self, time_ns: int, arrivals: Array) -> Iterator[Note]:
        """Say when residuals begin to contradict the model, and when they no longer do."""
        check, context = self._check, self._context
        if check is None or context is None:
            return
        check.learn(self._latest_estimate[1], arrivals)
        ratio, limit = check.residuals.ratio, check.residuals.limit
        if (ratio > limit) == self._doubted:
            return
        self._doubted = not self._doubted
        text = (
            f"{context.topic}: the residuals of the last places contradict what "
            f"{context.stage} presumes of waves: chi-square is {ratio:.1f} times the expected one "
            f"({limit:.1f} allowed); no track takes its places"
            if self._doubted
            else f"{context.topic}: the residuals of {context.stage} are those it expects again"
        )
        yield Note(time_ns, text, "WARN" if self._doubted else "INFO", context.stage)

    def _never_passed(self, time_ns: int) -> Iterator[Note]:
        """Say with the first step that more arrivals are asked for than there are sensors."""
        context, reported, self._reported = self._context, self._reported, True
        if context is None or reported:
            return
        most, why = len(self._channels), "the picked channels that have a place"
        if 0 < self.parameters.nearest < most:
            most, why = self.parameters.nearest, "nearest"
        reach = {"picks": Reach(most, why)}
        specs = gate_specs(self.gates, self.parameters)
        for text in never_passed(context.topic, context.stage, specs, reach):
            yield Note(time_ns, text, "WARN", context.stage)


def first_arrivals(
    picks: Iterable[Pick],
    channels: Mapping[str, int],
    step_ns: int,
    window_s: float,
    offsets_s: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the first arrival at each sensor within the window of a step [s], else NaN.

    Parameters
    ----------
    picks
        In any order; those of channels that have no place are left out.
    channels
        The row of each channel that has one.
    step_ns, window_s
        The step, and how long after it arrivals belong to it, by the clocks as they are.
    offsets_s
        Shape (n,): how far the clock of each channel is ahead [s]; subtracted from its arrival.
    """
    times = np.full(len(channels), np.nan)
    for pick in picks:
        since = (pick.time_ns - step_ns) / NS_PER_S
        index = channels.get(pick.channel)
        if index is not None and 0 <= since <= window_s and not times[index] <= since:
            times[index] = since
    return times if offsets_s is None else times - offsets_s


def place_candidate(time_ns: int, location: LocationEstimate) -> Candidates:
    """Return a place as the candidate that a localizer's gates decide on."""
    sigma = float(np.sqrt(np.trace(location.covariance) / 2))
    value = [location.picks, location.residual, location.x, location.y, sigma]
    return Candidates(
        np.array([time_ns], np.int64), np.zeros(1, np.int32), np.array([value], np.float32)
    )


def columns(unit: str) -> tuple[Quantity, ...]:
    """Return the columns of a localizer whose residual has a unit."""
    return (
        Quantity("picks", "1"),
        Quantity("residual", unit),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )


def gates(unit: str, parameter: str) -> tuple[Gate, ...]:
    """Return the gates on the number of arrivals and on the residual."""
    return (
        Level("picks", "1", "min_picks"),
        Level("residual", unit, parameter, at_least=False),
    )
