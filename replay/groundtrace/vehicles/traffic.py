"""Traffic on a road: vehicles fitted jointly to the powers of all stations beside it.

Passes of single stations are the start. A vehicle of constant speed v that is d from a station at
the nearest has there the power

    P(t) = mu / ((v (t - t0 - x / v))^2 + d^2)^(n/2),

by the paper's (4), x along the road. One time, one slowness and one distance thus hold for all
stations; a fit to a single station has a time and a width of its own in each, which makes two
vehicles within a second look like one.

The cube root of a power over its mean is nearly Gaussian whatever its degrees of freedom; its
density with what is known beforehand is maximised by Fisher scoring, and integrated about the
maximum by Laplace's method, so that numbers of vehicles and their directions compare.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pass, Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from .medium import CYCLE_POINTS, CYCLE_WEIGHTS, Scatter, cube_root_normalised, scatter_of
from .passes import PassFinder, Road, StationPass, associate, smoothed
from .stations import CycleStage, candidates_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..pipeline.gates import Candidates
    from .stations import StationPowers

    Array = NDArray[np.float64]

#: The cycles after a pass whose window of signal holds it [s]: those tell whether it is an impact,
#: which a vehicle that has just gone by does not. Source: definition: windows of 4 s that end by
#: then.
_ABOUT_S = (0.5, 3.5)
#: Passes without which a vehicle is none. Chosen by judgement: of one pass no speed is known.
_FEWEST = 2
#: Peak over the noise, and standard deviation of its moment [s], from which a pass of a single
#: station may start a vehicle. They are no gates: those decide about what is found. Chosen by trial
#: on simulated roads of seeds 1 to 10 (docs/vehicles.md).
_CLEAR, _CLEAR_S = 4.0, 2.0
#: Quiet cycles kept before the first in which something passes [s]. Chosen by judgement: the skirts
#: of a slow vehicle's power are that long.
_LEAD_S = 15.0


@dataclass(frozen=True, slots=True)
class PassParameters:
    """Parameters of :class:`StationPasses`."""

    exponent: Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)] = 1.5
    smooth_s: Annotated[float, measured("s", "Hann window over the logarithm of power.", gt=0)] = (
        3.0
    )
    least_over_floor: Annotated[
        float, measured("1", "Smoothed power over the noise from which a maximum counts.", gt=1)
    ] = 2.0
    slowest_mps: Annotated[float, measured("m/s", "Slowest vehicle.", gt=0)] = 2.0
    fastest_mps: Annotated[float, measured("m/s", "Fastest vehicle.", gt=0)] = 45.0
    most_s: Annotated[float, measured("s", "Longest time looked at in one piece.", gt=0)] = 600.0
    over_floor: Annotated[float, gate("dB", "Lowest peak over the noise.")] = 6.0
    presence: Annotated[
        float, gate("s", "Least time soon after it in which its station hears a vehicle.", ge=0)
    ] = 0.5
    time_sigma: Annotated[float, gate("s", "Largest standard deviation of its time.", gt=0)] = 2.0


class StationPasses(CycleStage):
    """When vehicles pass each station, and which passes are of one vehicle.

    Passes are looked for once all stations have been quiet for as long as the slowest vehicle
    takes from the first station to the last, and told then: at each station by itself, then, of
    several along a road, as vehicles that all of them hear. Places along the road come from the
    geometry's road, or, without one, from the line through the stations.
    """

    Parameters = PassParameters
    gives = (Pass,)
    columns = (
        Quantity("over_floor", "dB"),
        Quantity("presence", "s"),
        Quantity("time_sigma", "s"),
        Quantity("half_width", "s"),
        Quantity("together", "1"),
    )
    gates = (
        Level("over_floor", "dB", "over_floor"),
        Level("presence", "s", "presence"),
        Level("time_sigma", "s", "time_sigma", at_least=False),
    )
    least_stations = 1

    def __init__(self, parameters: PassParameters) -> None:
        super().__init__(parameters)

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin with the stations in the order of the geometry."""
        p = self.parameters
        self._site, self._stage = site, stage
        self._finder = PassFinder(p.exponent, p.smooth_s, p.least_over_floor)
        self._along, self._offsets = site.along_road()
        reach_m = float(np.ptp(self._along))
        self._quiet_ns = round((reach_m / p.slowest_mps + 2 * p.smooth_s) * NS_PER_S)
        self._cycles: list[StationPowers] = []
        self._last_ns: int | None = None
        self._vehicles = 0
        self._found: list[tuple[int, StationPass, RoadVehicle | None]] = []
        self._origin_ns = 0
        return site.names

    def take(self, cycle: StationPowers) -> Candidates:
        """Return the passes of the piece that the cycle ends."""
        self._cycles.append(cycle)
        if cycle.present.any():
            self._last_ns = cycle.time_ns
        if self._last_ns is None:
            lead_ns = cycle.time_ns - round(_LEAD_S * NS_PER_S)
            while self._cycles[0].time_ns < lead_ns:
                del self._cycles[0]
            return candidates_of([], len(self.columns))
        long_ns = cycle.time_ns - self._cycles[0].time_ns
        quiet = cycle.time_ns - self._last_ns > self._quiet_ns
        if quiet or long_ns > self.parameters.most_s * NS_PER_S:
            return self.finish()
        return candidates_of([], len(self.columns))

    def finish(self) -> Candidates:
        """Return the passes of the piece so far."""
        cycles, self._cycles, self._found = self._cycles, [], []
        active, self._last_ns = self._last_ns is not None, None
        if not active or len(cycles) < 2:
            return candidates_of([], len(self.columns))
        self._origin_ns = cycles[0].time_ns
        times = np.array([c.time_ns - self._origin_ns for c in cycles], np.int64) / NS_PER_S
        powers, floors, present = (
            np.array([getattr(c, name) for c in cycles]).T
            for name in ("powers", "floors", "present")
        )
        self._found = self._passes(times, powers, floors)
        self._found.sort(key=lambda found: (self._at_ns(found[1].time_s), found[0]))
        rows = [
            (self._at_ns(one.time_s), station, _values(one, times, present[station]))
            for station, one, _ in self._found
        ]
        return candidates_of(rows, len(self.columns))

    def _passes(
        self, times: Array, powers: Array, floors: Array
    ) -> list[tuple[int, StationPass, RoadVehicle | None]]:
        """Return passes with their stations and vehicles; powers and floors of shape (n, c)."""
        p = self.parameters
        alone = [self._finder.find(times, *both) for both in zip(powers, floors, strict=True)]
        if not np.ptp(self._along) > 0:
            return [(i, one, None) for i, those in enumerate(alone) for one in those]
        clear = [[one for one in those if _is_clear(one)] for those in alone]
        cycle_s = float(np.median(np.diff(times)))
        observed = RoadPowers(
            times, powers.T, floors.T, self._along, self._offsets, p.exponent, cycle_s
        )
        road = Road(tuple(self._along), speeds_mps=(p.slowest_mps, p.fastest_mps))
        vehicles = driven(observed, clear, road)
        return [(station, one, vehicle) for vehicle in vehicles for station, one in vehicle.passes]

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the accepted passes; a vehicle has two at least."""
        kept = [found for found, good in zip(self._found, accepted, strict=True) if good]
        passed = Counter(id(vehicle) for _, _, vehicle in kept if vehicle is not None)
        numbers: dict[int, int] = {}
        for station, one, vehicle in kept:
            if vehicle is None or passed[id(vehicle)] < _FEWEST:
                yield self._pass(station, one, None)
                continue
            if id(vehicle) not in numbers:
                self._vehicles += 1
                numbers[id(vehicle)] = self._vehicles
            yield self._pass(station, one, (numbers[id(vehicle)], vehicle))

    def _pass(self, station: int, one: StationPass, whose: tuple[int, RoadVehicle] | None) -> Pass:
        number, direction, speed = 0, "", (float("nan"), float("nan"))
        if whose is not None:
            number, vehicle = whose
            direction = "forward" if vehicle.direction > 0 else "backward"
            speed = vehicle.speed_mps, vehicle.speed_sigma_mps
        # the waves need their time from the lane to the station
        late_s = float(self._offsets[station]) / self._site.velocity_mps
        return Pass(
            self._at_ns(one.time_s - late_s),
            one.time_sigma_s,
            self._site.names[station],
            number,
            direction,
            *speed,
            one.half_width_s,
            float(10 * np.log10(one.over_floor)),
            self._stage,
        )

    def _at_ns(self, time_s: float) -> int:
        """Return a moment of the piece [ns]; one fitted to lie before it is at its first cycle."""
        return self._origin_ns + max(0, round(time_s * NS_PER_S))


def _is_clear(one: StationPass) -> bool:
    return one.over_floor >= _CLEAR and one.time_sigma_s <= _CLEAR_S


def _values(one: StationPass, times_s: Array, present: NDArray[np.bool_]) -> list[float]:
    """Return the columns of a pass; ``present`` is of its station, shape (c,)."""
    about = (times_s >= one.time_s + _ABOUT_S[0]) & (times_s <= one.time_s + _ABOUT_S[1])
    cycle_s = float(np.median(np.diff(times_s)))
    heard_s = cycle_s * float((present & about).sum())
    over_db = float(10 * np.log10(one.over_floor))
    return [over_db, heard_s, one.time_sigma_s, one.half_width_s, float(one.together)]


@dataclass(frozen=True, slots=True)
class RoadVehicle:
    """A vehicle on a road, and its passes.

    Attributes
    ----------
    speed_mps, speed_sigma_mps
        Speed and its standard deviation [m/s].
    direction
        1 towards greater distance along the road, else -1.
    passes
        Of each station by which it comes while cycles last.
    """

    speed_mps: float
    speed_sigma_mps: float
    direction: int
    passes: tuple[tuple[int, StationPass], ...]


def driven(
    observed: RoadPowers, passes: Sequence[Sequence[StationPass]], road: Road
) -> tuple[RoadVehicle, ...]:
    """Return the vehicles that all stations tell jointly, in order of time.

    Parameters
    ----------
    observed
        Powers of two stations or more, at different places along the road.
    passes
        Of each station by itself: where to start.
    road
        Stations and speeds by which those are put together.
    """
    start = list(_started(observed, passes, road))
    return tuple(_driven(observed, told) for told in vehicles_on(observed, start))


def _started(
    observed: RoadPowers, passes: Sequence[Sequence[StationPass]], road: Road
) -> Iterator[Vehicle]:
    """Give the vehicles of passes that lie on a line, then one for each pass that is left."""
    left = {(i, number): one for i, those in enumerate(passes) for number, one in enumerate(those)}
    for found in associate(road, passes):
        peaks = [np.log(left.pop(member).peak) for member in found.passes]
        values = observed.usual.copy()
        values[MOMENT] = found.time_at(float(observed.along_m.mean()))
        values[SLOWNESS], values[PEAK] = -np.log(found.speed_mps), np.mean(peaks)
        yield Vehicle(values, found.direction)
    for (station, _), one in left.items():
        values = observed.usual.copy()
        values[PEAK] = np.log(one.peak)
        values[MOMENT] = one.time_s - observed.centred_m[station] * np.exp(values[SLOWNESS])
        yield Vehicle(values, 1)


def _driven(observed: RoadPowers, told: FittedVehicle) -> RoadVehicle:
    vehicle, speed = told.vehicle, told.vehicle.speed_mps
    first, last = observed.times_s[0], observed.times_s[-1]
    passes = tuple(
        (station, one)
        for station, one in enumerate(_passes(observed, told))
        if first <= one.time_s <= last
    )
    sigma = speed * float(np.sqrt(told.covariance[SLOWNESS, SLOWNESS]))
    return RoadVehicle(speed, sigma, vehicle.direction, passes)


def _passes(observed: RoadPowers, told: FittedVehicle) -> Iterator[StationPass]:
    """Give a vehicle's pass at each station, errors by the delta method."""
    vehicle, spread = told.vehicle, told.covariance
    moments, widths, peaks = (
        f(vehicle).tolist() for f in (observed.moments, observed.widths, observed.peaks)
    )
    for station, along in enumerate(observed.centred_m):
        moment, width, peak = np.zeros((3, len(spread)))
        moment[[MOMENT, SLOWNESS]] = 1.0, vehicle.slowness * along
        width[[SLOWNESS, DISTANCE]] = 1.0
        peak[[PEAK, GAINS + station]] = 1.0
        time_sigma, width_sigma, peak_sigma = (
            float(np.sqrt(row @ spread @ row)) for row in (moment, width, peak)
        )
        floor = float(np.interp(moments[station], observed.times_s, observed.noise[:, station]))
        yield StationPass(
            moments[station],
            time_sigma,
            widths[station],
            width_sigma,
            peaks[station],
            peak_sigma,
            peaks[station] / floor,
            told.together,
        )


#: Of a damped fit; the largest step, and the damping at which it gives up; where it gains so
#: little, it ends. Chosen by judgement: a tolerance far below what a vehicle more must gain.
_DAMPING = (1e-2, 0.3, 5.0)  # at the start; after a step that helps, and after one that does not
_LARGEST_STEP, _WORST_DAMPING = 1.5, 1e5
_TOLERANCE = 0.04  # of twice the log-likelihood


@dataclass(frozen=True, slots=True, eq=False)
class TrafficFit:
    """Vehicles that were fitted jointly.

    Attributes
    ----------
    vehicles
        In no order.
    information
        Shape (v k, v k), k values of each vehicle: the inverse of their covariance.
    mean
        Shape (r, n): fitted mean powers, those of the noise and other vehicles included [unit^2].
    evidence
        Logarithm of the likelihood, integrated over what vehicles may be, but for a constant.
    """

    vehicles: tuple[Vehicle, ...]
    information: Array
    mean: Array
    evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Some cycles, in which vehicles are fitted while others stay.

    Attributes
    ----------
    observed
        All cycles.
    rows
        Which of them.
    beside
        Shape (r, n): mean power of the noise and of the vehicles that stay [unit^2].
    scatter
        Of the powers.
    """

    observed: RoadPowers
    rows: slice
    beside: Array
    scatter: Scatter

    def fit(self, vehicles: Sequence[Vehicle], steps: int) -> TrafficFit:
        """Fit vehicles from where they are, in so many steps at most."""
        values = np.array([v.values for v in vehicles]).reshape(-1, len(self.observed.usual))
        around = np.tile(self.observed.usual, (len(values), 1))
        around[:, MOMENT] = values[:, MOMENT]
        signs = tuple(v.direction for v in vehicles)
        at, damping = self._at(values, signs, around), _DAMPING[0]
        for _ in range(steps if len(values) else 0):
            ridge = damping * np.diag(np.diag(at.information))
            step = np.linalg.solve(at.information + ridge, at.gradient)
            step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
            tried = self._at(at.values + step.reshape(values.shape), signs, around)
            if not tried.lost <= at.lost:  # NaN does not help either
                damping *= _DAMPING[2]
                if damping > _WORST_DAMPING:
                    break
                continue
            done, at = at.lost - tried.lost < _TOLERANCE, tried
            damping *= _DAMPING[1]
            if done:
                break
        return self._finished(at, signs)

    def _at(self, values: Array, signs: tuple[int, ...], around: Array) -> _State:
        observed = self.observed
        known = observed.known[self.rows]
        mean, parts, slopes = self._model(values, signs)
        variance, tempered = self.scatter.variance, self.scatter.effective
        ratio = np.where(known, observed.powers[self.rows], mean) / mean
        off = np.where(known, cube_root_normalised(ratio) + variance / 3, 0.0)
        lower = np.linalg.cholesky(self.scatter.correlation(parts, known))
        white = np.linalg.solve(lower, np.concatenate([slopes, off[:, :, None]], axis=2))
        design = white[..., :-1].reshape(mean.size, slopes.shape[2])
        left = white[..., -1]
        # what the mean does to the density of a cube root: its Jacobian, and the determinant
        scale = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() - 2 / 3 * np.log(ratio).sum()
        weights = np.linalg.solve(np.swapaxes(lower, 1, 2), left[..., None])[..., 0]
        score = np.where(known, np.cbrt(ratio) * weights / tempered - variance / tempered / 3, 0.0)
        precision = np.tile(observed.precision, len(values))
        away = (values - around).ravel()
        lost = float(((left**2).sum() + scale * variance) / tempered + precision @ away**2)
        gradient = (
            slopes.reshape(mean.size, slopes.shape[2]).T @ score.reshape(-1) - precision * away
        )
        information = design.T @ design / tempered + np.diag(precision)
        return _State(values, mean, lost, gradient, information)

    def _model(self, values: Array, signs: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return the mean, each vehicle's part of it, and slopes of its logarithm."""
        found = [
            self.observed.power(Vehicle(row, sign), self.rows)
            for row, sign in zip(values, signs, strict=True)
        ]
        mean = self.beside + sum((power for power, _ in found), np.zeros_like(self.beside))
        parts = np.array([power / mean for power, _ in found]).reshape(-1, *mean.shape)
        slopes = np.concatenate([np.zeros((*mean.shape, 0)), *(s for _, s in found)], axis=2)
        known = self.observed.known[self.rows]
        return mean, parts, np.where(known, 1 / mean, 0.0)[:, :, None] * slopes

    def _finished(self, at: _State, signs: tuple[int, ...]) -> TrafficFit:
        """Return the fit, its evidence by Laplace's method."""
        prior = 0.5 * float(np.log(self.observed.precision).sum()) + self.observed.log_chance
        volume = float(np.linalg.slogdet(at.information)[1]) if len(signs) else 0.0
        evidence = -0.5 * (at.lost + volume) + len(signs) * prior
        vehicles = tuple(Vehicle(row, sign) for row, sign in zip(at.values, signs, strict=True))
        return TrafficFit(vehicles, at.information, at.mean, evidence)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The density at some values: twice what is lost, its gradient, and the information."""

    values: Array
    mean: Array
    lost: float
    gradient: Array
    information: Array


#: Columns of a vehicle: moment, ln slowness, ln peak, ln distance, then ln gain at each station.
#: Source: definition.
MOMENT, SLOWNESS, PEAK, DISTANCE, GAINS = range(5)
#: Slowness is kept between these [s/m]. Chosen by judgement: from a walk to 216 km/h.
_SLOWNESS = (1 / 60, 1.0)
#: Distance from the lane where no road is known, and the least that is believed [m]. Chosen by
#: judgement: a lane and its verge.
_USUAL_M, _LEAST_M = 5.0, 2.0
#: Standard deviations of what is known beforehand: of the moment about where it is looked for [s],
#: and of logarithms: 2 to 60 m/s within two of 11 m/s, peaks of 13 dB over the noise within two of
#: 9 dB each, lanes of a road, gains of stations. Chosen by judgement.
_SIGMAS = (3.0, 0.7, 2.0, 0.35, 0.3)
_USUAL_MPS, _USUAL_OVER_FLOOR = 11.0, 20.0
#: Vehicles expected, one in so many seconds. Chosen by judgement: a quiet road; a factor of ten is
#: 2.3 of log evidence.
_EVERY_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """A vehicle on a road.

    Attributes
    ----------
    values
        Shape (4 + n_stations,): when it is at the middle of the stations [s], ln slowness [s/m],
        ln of its power at the nearest [unit^2], ln of its mean distance from the stations [m], ln
        of each station's gain.
    direction
        1 towards greater distance along the road, else -1.
    """

    values: Array
    direction: int

    @property
    def slowness(self) -> float:
        """Seconds a metre, below 0 backward [s/m]."""
        return self.direction * float(np.exp(np.clip(self.values[SLOWNESS], *np.log(_SLOWNESS))))

    @property
    def speed_mps(self) -> float:
        """Speed [m/s]."""
        return 1 / abs(self.slowness)


@dataclass(frozen=True, eq=False)
class RoadPowers:
    """The powers of all stations beside a road.

    Attributes
    ----------
    times_s
        Shape (c,): middles of even cycles [s].
    powers, floors
        Shape (c, n): noise included, and of the noise [unit^2]; NaN or 0 where there is none.
    along_m, offsets_m
        Shape (n,): along the road, and distance from it, 0 for all where unknown [m].
    exponent
        n of the law.
    cycle_s
        Length of a cycle [s].
    """

    times_s: Array
    powers: Array
    floors: Array
    along_m: Array
    offsets_m: Array
    exponent: float
    cycle_s: float

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Where there is a power, shape (c, n)."""
        return (
            np.isfinite(self.powers)
            & (self.powers > 0)
            & np.isfinite(self.floors)
            & (self.floors > 0)
        )

    @cached_property
    def noise(self) -> Array:
        """The floors, 1 where there is none, shape (c, n) [unit^2]."""
        return np.where(self.known, self.floors, 1.0)

    @cached_property
    def centred_m(self) -> Array:
        """Places along the road from the middle of the stations, shape (n,) [m]."""
        return np.asarray(self.along_m - self.along_m.mean())

    @cached_property
    def distances_m(self) -> Array:
        """How far stations are from the lane, shape (n,) [m]."""
        if not self.offsets_m.any():
            return np.full(len(self.along_m), _USUAL_M)
        return np.maximum(self.offsets_m, _LEAST_M)

    @cached_property
    def usual(self) -> Array:
        """The values of a vehicle of which nothing is known, shape (4 + n,); its moment is 0."""
        peak = _USUAL_OVER_FLOOR * float(np.median(self.noise[self.known]))
        known = [0.0, -np.log(_USUAL_MPS), np.log(peak), np.log(self.distances_m.mean())]
        return np.concatenate([known, np.zeros(len(self.along_m))])

    @cached_property
    def precision(self) -> Array:
        """Of what is known beforehand of each value, shape (4 + n,)."""
        sigmas = np.concatenate([_SIGMAS[:GAINS], np.full(len(self.along_m), _SIGMAS[GAINS])])
        return np.asarray(sigmas**-2, np.float64)

    @property
    def log_chance(self) -> float:
        """Logarithm of the chance of a vehicle about a moment, of either direction."""
        return float(np.log(np.sqrt(2 * np.pi) * _SIGMAS[MOMENT] / _EVERY_S / 2))

    def moments(self, vehicle: Vehicle) -> Array:
        """Return when a vehicle is nearest to each station, shape (n,) [s]."""
        return np.asarray(vehicle.values[MOMENT] + vehicle.slowness * self.centred_m)

    def widths(self, vehicle: Vehicle) -> Array:
        """Return distance over speed at each station, shape (n,) [s]."""
        scale = self.distances_m / self.distances_m.mean()
        return np.asarray(np.exp(vehicle.values[DISTANCE]) * scale * abs(vehicle.slowness))

    def peaks(self, vehicle: Vehicle) -> Array:
        """Return its power at the nearest to each station, shape (n,) [unit^2]."""
        scale = self.distances_m / self.distances_m.mean()
        level = vehicle.values[PEAK] + vehicle.values[GAINS:]
        return np.asarray(np.exp(np.clip(level - self.exponent * np.log(scale), -600, 600)))

    def power(self, vehicle: Vehicle, rows: slice) -> tuple[Array, Array]:
        """Return the mean power of a vehicle in some cycles, and its slopes by its values.

        Returns
        -------
        Shapes (r, n) and (r, n, 4 + n).
        """
        n = len(self.along_m)
        width = self.widths(vehicle)[:, None]
        late = self.times_s[rows, None, None] + CYCLE_POINTS * self.cycle_s / 2
        x = (late - self.moments(vehicle)[:, None]) / width
        parts = (
            self.peaks(vehicle)[:, None] * (1 + x**2) ** (-self.exponent / 2) * (CYCLE_WEIGHTS / 2)
        )
        falling = self.exponent * x / (1 + x**2) * parts
        power, wider = parts.sum(axis=-1), (falling * x).sum(axis=-1)
        later = (falling / width).sum(axis=-1)
        slopes = np.zeros((*power.shape, GAINS + n))
        slopes[..., MOMENT], slopes[..., PEAK] = later, power
        slopes[..., SLOWNESS] = wider + later * vehicle.slowness * self.centred_m
        slopes[..., DISTANCE] = wider
        slopes[:, np.arange(n), GAINS + np.arange(n)] = power
        return power, slopes


#: Vehicles whose ways along the stations come this near in time are fitted jointly [s]; so much
#: before and after them is looked at. Chosen by trial on simulated roads of seeds 1 to 10
#: (docs/vehicles.md).
_BESIDE_S, _SEARCH_ABOUT_S = 1.5, 5.0
#: By so much the evidence must grow. Chosen by trial on simulated roads of seeds 1 to 10
#: (docs/vehicles.md).
_MARGIN = 1.5
#: Steps of a first trial, of a full fit; how many trials are fitted fully. Chosen by trial on
#: simulated roads of seeds 1 to 10 (docs/vehicles.md).
_FIRST, _FULL, _BEST = 5, 25, 2
_CHANGES, _SWEEPS = 6, 2
#: Half of what two halves of a vehicle are apart [s], and what each has of its peak, ln. Chosen by
#: trial on simulated roads of seeds 1 to 10 (docs/vehicles.md).
_APART_S, _HALF = 0.4, 0.5
#: Excess of power is smoothed over so many cycles, and looked for this far from the ends [s].
#: Chosen by trial on simulated roads of seeds 1 to 10 (docs/vehicles.md).
_SMOOTH, _INSIDE_S = 5, 3.0
_TRIED_MPS = (6.0, 14.0)
#: Of a vehicle that stations hear at once [s/m]. Chosen by trial on simulated roads of seeds 1 to
#: 10 (docs/vehicles.md).
_LEAST_SLOWNESS = 1 / 50


@dataclass(frozen=True, slots=True, eq=False)
class FittedVehicle:
    """A vehicle that was found.

    Attributes
    ----------
    vehicle
        Its values.
    covariance
        Shape (4 + n, 4 + n), of them.
    together
        How many vehicles were fitted jointly, itself counted in.
    """

    vehicle: Vehicle
    covariance: Array
    together: int


def vehicles_on(observed: RoadPowers, start: Sequence[Vehicle]) -> tuple[FittedVehicle, ...]:
    """Find the vehicles on a road, in order of time.

    Vehicles that are near in time are a group. In each group directions are turned, and vehicles
    added, split and taken away, while the evidence grows.

    Parameters
    ----------
    observed
        Powers of at least two stations.
    start
        Where to start; where there is none, none is found.
    """
    if not start or not observed.known.any():
        return ()
    scatter = Scatter()
    groups = _groups(observed, start)
    fits: list[tuple[Stretch, TrafficFit]] = []
    for sweep in range(_SWEEPS + 1):
        fits = []
        for number, group in enumerate(groups):
            others = [v for k, those in enumerate(groups) if k != number for v in those]
            stretch = _stretch(observed, group, others, scatter)
            fit = stretch.fit(group, _FULL)
            fit = _searched(stretch, fit) if sweep else fit
            groups[number] = fit.vehicles
            fits.append((stretch, fit))
        everyone = [v for group in groups for v in group]
        mean = _mean(observed, everyone, slice(None))
        scatter = scatter_of(observed.powers, observed.noise, observed.known, mean)
        if sweep < _SWEEPS:
            groups = _groups(observed, everyone)
    told = [one for _, fit in fits for one in _told(observed, fit)]
    return tuple(sorted(told, key=lambda one: float(one.vehicle.values[MOMENT])))


def _told(observed: RoadPowers, fit: TrafficFit) -> Iterator[FittedVehicle]:
    size = len(observed.usual)
    if not fit.vehicles:
        return
    covariance = np.asarray(np.linalg.inv(fit.information), np.float64)
    for number, vehicle in enumerate(fit.vehicles):
        own = slice(number * size, (number + 1) * size)
        yield FittedVehicle(vehicle, covariance[own, own], len(fit.vehicles))


def _groups(observed: RoadPowers, vehicles: Sequence[Vehicle]) -> list[tuple[Vehicle, ...]]:
    spans = [(observed.moments(v), v) for v in vehicles]
    spans.sort(key=lambda span: float(span[0].min()))
    groups: list[list[Vehicle]] = []
    last = -np.inf
    for moments, vehicle in spans:
        if moments.min() - last > 2 * _BESIDE_S:
            groups.append([])
        groups[-1].append(vehicle)
        last = max(last, float(moments.max()))
    return [tuple(group) for group in groups]


def _mean(observed: RoadPowers, vehicles: Sequence[Vehicle], rows: slice) -> Array:
    mean = observed.noise[rows].copy()
    for vehicle in vehicles:
        mean += observed.power(vehicle, rows)[0]
    return mean


def _stretch(
    observed: RoadPowers, group: Sequence[Vehicle], others: Sequence[Vehicle], scatter: Scatter
) -> Stretch:
    moments = np.concatenate([observed.moments(v) for v in group])
    edges = moments.min() - _SEARCH_ABOUT_S, moments.max() + _SEARCH_ABOUT_S
    rows = slice(*np.searchsorted(observed.times_s, edges).tolist())
    return Stretch(observed, rows, _mean(observed, others, rows), scatter)


def _searched(stretch: Stretch, fit: TrafficFit) -> TrafficFit:
    """Change the vehicles of a stretch while that makes the powers likelier."""
    for _ in range(_CHANGES):
        tried = [stretch.fit(those, _FIRST) for those in _changes(stretch, fit)]
        tried.sort(key=lambda one: -one.evidence)
        full = [stretch.fit(one.vehicles, _FULL) for one in tried[:_BEST]]
        best = max(full, key=lambda one: one.evidence, default=fit)
        if not best.evidence > fit.evidence + _MARGIN:
            break
        fit = best
    return fit


def _changes(stretch: Stretch, fit: TrafficFit) -> Iterator[tuple[Vehicle, ...]]:
    """Give what else there may be: others' directions, one less, one more."""
    vehicles = fit.vehicles
    several = range(len(vehicles))
    for turned in [*combinations(several, 1), *combinations(several, 2)]:
        yield tuple(_turned(v) if i in turned else v for i, v in enumerate(vehicles))
    for i, k in combinations(several, 2):
        rest = tuple(v for j, v in enumerate(vehicles) if j not in (i, k))
        yield (*rest, *_exchanged(stretch.observed, vehicles[i], vehicles[k]))
    for i in several:
        rest = (*vehicles[:i], *vehicles[i + 1 :])
        yield rest
        for signs in product((1, -1), repeat=2):
            yield (*rest, *_split(stretch, vehicles[i], signs))
    for more in _missing(stretch, fit):
        yield (*vehicles, more)


def _turned(vehicle: Vehicle) -> Vehicle:
    return replace(vehicle, direction=-vehicle.direction)


def _exchanged(observed: RoadPowers, one: Vehicle, other: Vehicle) -> Iterator[Vehicle]:
    """Give two vehicles with their passes at the last station exchanged."""
    first, last = int(observed.along_m.argmin()), int(observed.along_m.argmax())
    length = observed.centred_m[last] - observed.centred_m[first]
    for here, there in ((one, other), (other, one)):
        start = observed.moments(here)[first]
        slowness = (observed.moments(there)[last] - start) / length
        values = here.values.copy()
        values[MOMENT] = start - slowness * observed.centred_m[first]
        values[SLOWNESS] = np.log(max(abs(slowness), _LEAST_SLOWNESS))
        yield Vehicle(values, 1 if slowness > 0 else -1)


def _split(stretch: Stretch, vehicle: Vehicle, signs: tuple[int, ...]) -> Iterator[Vehicle]:
    usual = stretch.observed.usual
    for sign, late_s in zip(signs, (-_APART_S, _APART_S), strict=True):
        values = vehicle.values.copy()
        values[[SLOWNESS, DISTANCE]] = usual[[SLOWNESS, DISTANCE]]
        values[MOMENT] += late_s
        values[PEAK] -= _HALF
        yield Vehicle(values, sign)


def _missing(stretch: Stretch, fit: TrafficFit) -> Iterator[Vehicle]:
    """Give vehicles where the powers of a station exceed the fitted mean most."""
    observed, rows = stretch.observed, stretch.rows
    times, known = observed.times_s[rows], observed.known[rows]
    inside = (times >= times[0] + _INSIDE_S) & (times <= times[-1] - _INSIDE_S)
    if not inside.any():
        return
    excess = np.log(np.where(known, observed.powers[rows], fit.mean) / fit.mean)
    for station, along in enumerate(observed.centred_m):
        high = np.where(inside, smoothed(excess[:, station], _SMOOTH), -np.inf)
        cycle = int(high.argmax())
        more = fit.mean[cycle, station] * max(float(np.expm1(high[cycle])), 0.1)
        for speed, sign in product(_TRIED_MPS, (1, -1)):
            values = observed.usual.copy()
            values[:DISTANCE] = times[cycle] - sign * along / speed, -np.log(speed), np.log(more)
            yield Vehicle(values, sign)
