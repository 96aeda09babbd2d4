"""Traffic on a road: vehicles fitted jointly to the powers of all stations beside it.

Chains of peaks are the start. A vehicle of constant speed v that is d from a station at
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

from groundtrace_codecs.events import Note, Pass, Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from .medium import CYCLE_POINTS, CYCLE_WEIGHTS, Scatter, cube_root_normalised, scatter_of
from .passes import StationPass, chains, station_peaks
from .presence import over_floor_db
from .stations import CycleStage, candidates_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..pipeline.gates import Candidates
    from ..pipeline.stage import Context
    from .passes import Chain, Peak
    from .stations import StationPowers

    Array = NDArray[np.float64]

#: A pass without which a vehicle is none. Chosen by judgement: of one pass no speed is known.
_FEWEST = 2
#: Peaks and chains from these prominences on are candidates [dB], so that ``why`` knows of them; a
#: peak of the second one starts a vehicle of the joint fit. Chosen by judgement: half of what gates
#: ask for, and what they ask for.
_LEAST_DB, _START_DB = 4.0, 8.0
#: Vehicles that pass a station within so much make one peak [s]. Chosen by judgement: the running
#: median is as long.
_MERGED_S = 0.7
#: A fit within so much of a peak may be of the same vehicle [s]. Chosen by judgement: what scores
#: take for the same pass.
_SAME_S = 1.0
#: Where others' power is taken off, so much of the noise is left at least; a vehicle's highest
#: power is looked for so long before and after its moment [s]. Chosen by judgement.
_LEFT, _NEAR_S = 0.5, (0.5, 2.0)
#: Beyond this before and after a peak nothing is looked at [s]. Chosen by trial on simulated nodes
#: of seeds 1 to 10: slow vehicles that pass far away stand out within that.
_REACH_S = 15.0
#: Running medians so much over the noise are something that goes on. Chosen by judgement: 3 dB.
_GOES_ON = 2.0
#: Quiet cycles kept before the first in which something goes on [s]. Chosen by judgement: the
#: skirts of a slow vehicle's power are that long.
_LEAD_S = 15.0
#: The joint fit is that of a chain where no moment is further off, in standard deviations of the
#: peaks. Chosen by judgement: one of 400 is, where the law holds.
_AGREES = 3.0
#: The law holds where powers scatter by so much about the fit at most, while a vehicle passes, for
#: so long before and after [s]; where it does not, what stands out only once others' power is taken
#: off must do so by so much more [dB]. Chosen by trial: single vehicles that obey the law scatter
#: by 0.29 to 0.43 (seeds 111 and 112 of stations), what the fit makes of gusts, doors and walkers
#: by 0.43 and more, and stands out by 12 to 20 dB, vehicles by 19 and more (nodes of seeds
#: 1 to 10, with vehicles and without), as was the gate of speed. Gates of
#: prominence: on seeds 1 to 20 and 31 to 60 (docs/notebook/vehicles.md).
_HOLDS, _PASSES_S, _HIDDEN_DB = 0.45, (2.0, 6.0), 6.0
#: Where no fit agrees with a chain, peaks are not those of the law, which their deviations are
#: taken from: the speed's is so much greater. Chosen by trial on nodes of seeds 1 to 10: vehicles
#: have speeds known to a quarter, without the factor, gusts and far trucks to 0.28 and more.
_UNLAWFUL = 2.0
#: No leg, for a vehicle of a single station: gates of legs let it pass. Source: definition.
_NO_LEG = (float("inf"), 0.0, 1.0, 0.0)
#: Vehicles by which places along the road are checked, and by what factor a leg must be longer or
#: shorter than they say. Chosen by trial on simulated nodes of seeds 11 and 12, whose places are
#: right: three vehicles seen at the joints of a road rather than beside nodes say 3.4 times.
_CHECKS, _CONTRADICTS = 5, 2.0


@dataclass(frozen=True, slots=True)
class PassParameters:
    """Parameters of :class:`StationPasses`."""

    exponent: Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)] = 1.5
    slowest_mps: Annotated[float, measured("m/s", "Slowest leg looked for.", gt=0)] = 1.5
    fastest_mps: Annotated[float, measured("m/s", "Fastest leg looked for.", gt=0)] = 45.0
    most_s: Annotated[float, measured("s", "Longest time looked at in one piece.", ge=60)] = 300.0
    prominence: Annotated[
        float,
        gate("dB", "Lowest prominence at the station; at all, where no fit agrees with a chain."),
    ] = 8.0
    mean_prominence: Annotated[
        float, gate("dB", "Lowest prominence in the mean over the stations.")
    ] = 15.0
    slow_leg: Annotated[float, gate("m/s", "Slowest leg from station to station.", gt=0)] = 2.5
    fast_leg: Annotated[float, gate("m/s", "Fastest leg from station to station.", gt=0)] = 30.0
    leg_ratio: Annotated[float, gate("1", "Fastest over slowest leg at most.", ge=1)] = 3.0
    speed_sigma: Annotated[
        float, gate("1", "Largest standard deviation of the speed over it.", gt=0)
    ] = 0.5
    time_sigma: Annotated[float, gate("s", "Largest standard deviation of its time.", gt=0)] = 2.0
    breadth: Annotated[
        float, gate("1", "Longest time that it is heard, over that of a vehicle on the road.", gt=0)
    ] = 0.8


class StationPasses(CycleStage):
    """When vehicles pass each station, and which passes are of one vehicle.

    Power that stands out at one station after the other makes a chain; vehicles are fitted jointly
    to the powers of all stations, too, from those chains on, and where the fit agrees with a chain,
    it tells the moments. Passes are told once all stations have been quiet for as long as the
    slowest vehicle takes from the first station to the last, and 15 s; where they never are, a
    piece ends at its quietest moment, after ``most_s`` at the latest. Places along the road come
    from the geometry's road, or, without one, from the line through the stations. Where these are
    one, or their places are not known, what stands out is told without direction and speed.
    """

    Parameters = PassParameters
    gives = (Pass,)
    columns = (
        Quantity("prominence", "dB"),
        Quantity("mean_prominence", "dB"),
        Quantity("least_prominence", "dB"),
        Quantity("slow_leg", "m/s"),
        Quantity("fast_leg", "m/s"),
        Quantity("leg_ratio", "1"),
        Quantity("speed_sigma", "1"),
        Quantity("time_sigma", "s"),
        Quantity("breadth", "1"),
        Quantity("over_floor", "dB"),
        Quantity("half_width", "s"),
        Quantity("together", "1"),
    )
    gates = (
        Level("least_prominence", "dB", "prominence"),
        Level("slow_leg", "m/s", "slow_leg"),
        Level("fast_leg", "m/s", "fast_leg", at_least=False),
        Level("leg_ratio", "1", "leg_ratio", at_least=False),
        Level("mean_prominence", "dB", "mean_prominence"),
        Level("speed_sigma", "1", "speed_sigma", at_least=False),
        Level("time_sigma", "s", "time_sigma", at_least=False),
        Level("breadth", "1", "breadth", at_least=False),
    )
    least_stations = 0

    def __init__(self, parameters: PassParameters) -> None:
        super().__init__(parameters)

    def stations_of(self, context: Context) -> Stations:
        """Return the stations; where no places are known, those of the first topic, at one spot."""
        site = context.geometry.stations()
        if site.names:
            return site
        channels = context.source.channels
        short = [name[:-1] for name in channels]
        names = [n if short.count(n) > 1 else name for n, name in zip(short, channels, strict=True)]
        order = tuple(dict.fromkeys(names))
        of_channel = {c: order.index(n) for c, n in zip(channels, names, strict=True)}
        return replace(site, names=order, places=np.zeros((len(order), 2)), of_channel=of_channel)

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin with the stations in the order of the geometry."""
        p = self.parameters
        self._site, self._stage = site, stage
        self._along, self._offsets = site.along_road()
        reach_s = float(np.ptp(self._along)) / p.slowest_mps
        self._quiet_ns = round((reach_s + _REACH_S) * NS_PER_S)
        self._cycles: list[StationPowers] = []
        self._last_ns: int | None = None
        self._vehicles = 0
        self._station_passes: list[tuple[int, StationPass, RoadVehicle | None]] = []
        self._origin_ns = 0
        self._check = PlaceCheck(site.names, self._along)
        self._alone = not np.ptp(self._along) > 0
        return site.names

    def take(self, cycle: StationPowers) -> Candidates:
        """Return the passes of the piece that the cycle ends."""
        self._cycles.append(cycle)
        if _activity(cycle) > _GOES_ON:
            self._last_ns = cycle.time_ns
        if self._last_ns is None:
            lead_ns = cycle.time_ns - round(_LEAD_S * NS_PER_S)
            while self._cycles[0].time_ns < lead_ns:
                del self._cycles[0]
            return candidates_of([], len(self.columns))
        if cycle.time_ns - self._last_ns > self._quiet_ns:
            return self.finish()
        if cycle.time_ns - self._cycles[0].time_ns > self.parameters.most_s * NS_PER_S:
            return self._cut()
        return candidates_of([], len(self.columns))

    def finish(self) -> Candidates:
        """Return the passes of the piece so far."""
        cycles, self._cycles, self._station_passes = self._cycles, [], []
        active, self._last_ns = self._last_ns is not None, None
        if not active or len(cycles) < 2:
            return candidates_of([], len(self.columns))
        self._origin_ns = cycles[0].time_ns
        times = np.array([c.time_ns - self._origin_ns for c in cycles], np.int64) / NS_PER_S
        powers, steady, floors = (
            np.array([getattr(c, name) for c in cycles]) for name in ("powers", "steady", "floors")
        )
        self._station_passes = self._passes(times, powers, steady, floors)
        self._station_passes.sort(
            key=lambda station_pass: (self._at_ns(station_pass[1].time_s), station_pass[0])
        )
        rows = [
            (self._at_ns(one.time_s), station, _values(one, vehicle))
            for station, one, vehicle in self._station_passes
        ]
        return candidates_of(rows, len(self.columns))

    def _cut(self) -> Candidates:
        """End a piece that lasts too long at the quietest moment of its last third."""
        first = len(self._cycles) * 2 // 3
        level = [_activity(cycle) for cycle in self._cycles[first:]]
        where = first + int(np.argmin(level))
        rest, last_ns = self._cycles[where:], self._last_ns
        self._cycles = self._cycles[:where]
        candidates = self.finish()
        self._cycles, self._last_ns = rest, last_ns
        return candidates

    def _passes(
        self, times: Array, powers: Array, steady: Array, floors: Array
    ) -> list[tuple[int, StationPass, RoadVehicle | None]]:
        """Return passes with their stations and vehicles; all of shape (c, n)."""
        p = self.parameters
        peaks = [
            station_peaks(times, *columns, _REACH_S, _LEAST_DB)
            for columns in zip(steady.T, powers.T, strict=True)
        ]
        awake = np.flatnonzero((np.isfinite(floors) & (floors > 0)).mean(axis=0) > 0.5)
        if self._alone or len(awake) < _FEWEST:
            return [
                (i, _peak_pass(one, times, floors[:, i]), None)
                for i, those in enumerate(peaks)
                for one in those
            ]
        cycle_s = float(np.median(np.diff(times)))
        observed = RoadPowers(
            times,
            powers[:, awake],
            floors[:, awake],
            self._along[awake],
            self._offsets[awake],
            p.exponent,
            cycle_s,
        )
        speeds = p.slowest_mps, p.fastest_mps
        vehicles = driven(observed, [peaks[i] for i in awake], speeds)
        return [(int(awake[i]), one, v) for v in vehicles for i, one in v.passes]

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the accepted passes; a vehicle has two at least. Say what places contradict."""
        passes = [
            station_pass
            for station_pass, good in zip(self._station_passes, accepted, strict=True)
            if good
        ]
        passed = Counter(id(vehicle) for _, _, vehicle in passes if vehicle is not None)
        numbers: dict[int, int] = {}
        for station, one, vehicle in passes:
            if vehicle is None:
                yield self._pass(station, one, None)
                continue
            if passed[id(vehicle)] < _FEWEST:
                continue  # of one pass neither direction nor speed is known
            if id(vehicle) not in numbers:
                self._vehicles += 1
                numbers[id(vehicle)] = self._vehicles
                self._check.update(vehicle.chain)
            yield self._pass(station, one, (numbers[id(vehicle)], vehicle))
        text = self._check.text() if passes else ""
        if passes and self._alone:
            text = self._check.unknown()
        if text:
            yield Note(self._origin_ns, text, "WARN", self._stage)

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
            one.over_floor_db,
            self._stage,
        )

    def _at_ns(self, time_s: float) -> int:
        """Return a moment of the piece [ns]; one fitted to lie before it is at its first cycle."""
        return self._origin_ns + max(0, round(time_s * NS_PER_S))


def _activity(cycle: StationPowers) -> float:
    """Return the highest running median over the noise."""
    valid = np.isfinite(cycle.steady) & (cycle.floors > 0)
    return float((cycle.steady[valid] / cycle.floors[valid]).max(initial=0.0))


#: A pass of a chain is as uncertain as this part of its peak, whose own deviation allows for two
#: stations that differ. Chosen by trial on simulated nodes of seeds 1 to 10.
_TOLD_SIGMA = 0.8


def _peak_pass(peak: Peak, times_s: Array, floors: Array) -> StationPass:
    """Return a peak of one station as a pass; ``floors`` of shape (c,)."""
    floor = float(np.interp(peak.time_s, times_s, floors))
    over_db = float(over_floor_db(np.array(peak.power), np.array(floor)))
    sigma = _TOLD_SIGMA * peak.sigma_s
    return StationPass(peak.time_s, sigma, peak.half_width_s, peak.prominence_db, over_db, 1)


def _values(one: StationPass, vehicle: RoadVehicle | None) -> list[float]:
    """Return the columns of a pass."""
    legs, mean_db, least_db, breadth = _NO_LEG, one.prominence_db, one.prominence_db, 0.0
    if vehicle is not None:
        slow, fast = vehicle.legs_mps
        legs = slow, fast, fast / slow, vehicle.speed_sigma_mps / vehicle.speed_mps
        mean_db, breadth = vehicle.prominence_db, vehicle.breadth
        if not vehicle.is_fitted:
            least_db = min(other.prominence_db for _, other in vehicle.passes)
    rest = one.time_sigma_s, breadth, one.over_floor_db, one.half_width_s, float(one.together)
    return [one.prominence_db, mean_db, least_db, *legs, *rest]


class PlaceCheck:
    """Whether the stations' places along the road agree with how long vehicles take between them.

    Parameters
    ----------
    names, along_m
        Of the stations.
    """

    def __init__(self, names: Sequence[str], along_m: Array) -> None:
        self._order = np.argsort(along_m, kind="stable").tolist()
        self._names, self._along = names, along_m
        self._off: list[Array] = []
        self._reported = False

    def update(self, chain: Chain | None) -> None:
        """Take the chain of a vehicle, where it has one of all stations."""
        if chain is None or len(chain.members) < max(3, len(self._order)):
            return
        times = {station: peak.time_s for station, peak in chain.members}
        lags = np.abs(np.diff([times[station] for station in self._order]))
        ways = np.diff(self._along[self._order])
        off = np.log(np.maximum(lags, 1e-3) / ways)
        self._off.append(np.asarray(off - off.mean()))

    def text(self) -> str:
        """Return what is wrong, once; empty where nothing is."""
        if self._reported or len(self._off) < _CHECKS:
            return ""
        off = np.array(self._off)
        middle = np.median(off, axis=0)
        error = off.std(axis=0, ddof=1) / np.sqrt(len(off))
        long, short = int(middle.argmax()), int(middle.argmin())
        factor = float(np.exp(middle[long] - middle[short]))
        sure = middle[long] - middle[short] > 3 * float(np.hypot(error[long], error[short]))
        if factor < _CONTRADICTS or not sure:
            return ""
        self._reported = True
        return (
            f"the places of stations contradict the speeds: {len(off)} vehicles take "
            f"{factor:.1f} times as long for a metre from {self._leg(long)} as from "
            f"{self._leg(short)}: check the places of these stations, and the road for joints"
        )

    def unknown(self) -> str:
        """Return, once, that passes have no direction and no speed; empty after that."""
        if self._reported:
            return ""
        self._reported = True
        which = (
            f"{self._names[0]} is the only station with a place of its own"
            if len(self._names) == 1
            else "the places of stations along the road are not known"
        )
        return (
            f"passes are told without direction and speed: {which}; what lasts as long as a "
            f"vehicle is not told from one"
        )

    def _leg(self, leg: int) -> str:
        one, other = self._order[leg : leg + 2]
        return f"{self._names[one]} to {self._names[other]}"


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
    legs_mps
        Slowest and fastest speed from one station to the next [m/s].
    prominence_db
        In the mean over the stations [dB].
    breadth
        By :func:`_breadth`.
    chain
        The peaks that it is seen by, where there are some.
    """

    speed_mps: float
    speed_sigma_mps: float
    direction: int
    passes: tuple[tuple[int, StationPass], ...]
    legs_mps: tuple[float, float]
    prominence_db: float
    breadth: float
    chain: Chain | None

    @property
    def is_fitted(self) -> bool:
        """Whether the joint fit tells it, not a chain alone."""
        return any(one.together for _, one in self.passes)


def driven(
    observed: RoadPowers, peaks: Sequence[Sequence[Peak]], speeds_mps: tuple[float, float]
) -> tuple[RoadVehicle, ...]:
    """Return the vehicles on a road: chains of peaks, and those of the joint fit.

    Where the fit agrees with a chain at every station, the fit tells the moments and the speed.
    Where it does not, and powers scatter about it as the law has them, the chain is a mix of
    vehicles, and dropped; else the law or the places are wrong, and the chain tells.

    Parameters
    ----------
    observed
        Powers of two stations or more, at different places along the road.
    peaks
        Of each station by itself.
    speeds_mps
        Slowest and fastest leg that is looked for [m/s].
    """
    linked = chains(observed.along_m, peaks, speeds_mps, _LEAST_DB)
    start = list(_started(observed, peaks, linked))
    fitted = _singled(observed, vehicles_on(observed, start))
    stands = own_prominences(observed, fitted)
    mean = _mean(observed, [one.vehicle for one in fitted], slice(None))
    left = dict(enumerate(fitted))
    vehicles, alone = [], []
    for chain in linked:
        near = [(_apart(observed, one, chain), number) for number, one in left.items()]
        if near and min(near)[0] <= _AGREES:
            number = min(near)[1]
            vehicles.append(
                _fitted_vehicle(observed, left.pop(number), stands[number], chain, mean)
            )
        else:
            alone.append(chain)
    lawful = [one for one in left.values() if scatter_about(observed, one, mean) <= _HOLDS]
    alone = [c for c in alone if not any(_shared(observed, one, c) >= 0.5 for one in lawful)]
    for number, one in left.items():
        if not any(_shared(observed, one, chain) > 0.5 for chain in alone):
            vehicles.append(_fitted_vehicle(observed, one, stands[number], None, mean))
    return (*vehicles, *(_chain_vehicle(observed, chain) for chain in alone))


def _started(
    observed: RoadPowers, peaks: Sequence[Sequence[Peak]], linked: Sequence[Chain]
) -> Iterator[Vehicle]:
    """Give the vehicles of chains, then one for each peak that is left."""
    middle = float(observed.along_m.mean())
    taken = set()
    for chain in linked:
        taken |= {id(peak) for _, peak in chain.members}
        values = observed.typical.copy()
        values[MOMENT] = chain.time_at(middle, observed.along_m)
        values[SLOWNESS] = np.log(max(abs(chain.slowness), _LEAST_SLOWNESS))
        values[PEAK] = np.mean([np.log(peak.power) for _, peak in chain.members])
        yield Vehicle(values, chain.direction)
    for station, those in enumerate(peaks):
        for peak in those:
            if id(peak) not in taken and peak.prominence_db >= _START_DB:
                values = observed.typical.copy()
                values[PEAK] = np.log(peak.power)
                late = observed.centred_m[station] * np.exp(values[SLOWNESS])
                values[MOMENT] = peak.time_s - late
                yield Vehicle(values, 1)


def _apart(observed: RoadPowers, one: FittedVehicle, chain: Chain) -> float:
    """Return how far the moments of a fit are from a chain's, at most; inf the other way.

    In standard deviations of the peaks.
    """
    if one.vehicle.direction != chain.direction:
        return float("inf")
    moments = observed.moments(one.vehicle)
    off = [abs(moments[station] - peak.time_s) / peak.sigma_s for station, peak in chain.members]
    return float(max(off))


def _shared(observed: RoadPowers, one: FittedVehicle, chain: Chain) -> float:
    """Return which part of a chain's peaks are where a fitted vehicle passes."""
    moments = observed.moments(one.vehicle)
    near = [abs(moments[s] - p.time_s) < max(_SAME_S, 2 * p.sigma_s) for s, p in chain.members]
    return float(np.mean(near))


def _chain_vehicle(observed: RoadPowers, chain: Chain) -> RoadVehicle:
    """Return the vehicle of a chain that no joint fit agrees with: 0 are fitted together."""
    passes = tuple(
        (
            station,
            replace(_peak_pass(peak, observed.times_s, observed.noise[:, station]), together=0),
        )
        for station, peak in chain.members
    )
    speed = 1 / abs(chain.slowness)
    sigma = _UNLAWFUL * speed * chain.slowness_sigma / abs(chain.slowness)
    breadth = _breadth(observed, passes, speed)
    return RoadVehicle(
        speed, sigma, chain.direction, passes, chain.legs_mps, chain.prominence_db, breadth, chain
    )


def _fitted_vehicle(
    observed: RoadPowers,
    fitted_vehicle: FittedVehicle,
    stands_db: Array,
    chain: Chain | None,
    mean: Array,
) -> RoadVehicle:
    """Return a vehicle of the joint fit.

    Where powers scatter about the fitted mean, (c, n), by more than the law has them scatter, what
    stands out by the fit alone counts less.
    """
    vehicle, speed = fitted_vehicle.vehicle, fitted_vehicle.vehicle.speed_mps
    first, last = observed.times_s[0], observed.times_s[-1]
    if not scatter_about(observed, fitted_vehicle, mean) <= _HOLDS:
        stands_db = stands_db - _HIDDEN_DB
    for station, peak in chain.members if chain is not None else ():
        stands_db[station] = max(stands_db[station], peak.prominence_db)
    passes = tuple(
        (station, one)
        for station, one in enumerate(_passes(observed, fitted_vehicle, stands_db))
        if first <= one.time_s <= last
    )
    sigma = speed * float(np.sqrt(fitted_vehicle.covariance[SLOWNESS, SLOWNESS]))
    mean_db = float(stands_db.mean())
    breadth, legs = _breadth(observed, passes, speed), (speed, speed)
    return RoadVehicle(speed, sigma, vehicle.direction, passes, legs, mean_db, breadth, chain)


#: Half of a vehicle's length [m], and of the running median [s]: no peak is narrower. Chosen by
#: judgement: a van's.
_HALF_LONG_M, _HALF_MEDIAN_S = 3.0, 0.35


def _breadth(
    observed: RoadPowers, passes: Sequence[tuple[int, StationPass]], speed_mps: float
) -> float:
    """Return how long a vehicle is heard, over how long one on the road is, 0 without a road.

    What goes by at a distance d with speed v is heard for d / v before and after its moment, give
    or take what the ground's spreading says (0.9 to 1.7 times for powers that fall with r^-2.4 to
    r^-1): a truck on a road further off, or a gust, for longer. The assumption is that the vehicle
    is on the road of the geometry.
    """
    if not (passes and observed.offsets_m.any()):
        return 0.0
    width_m = speed_mps * np.array([one.half_width_s for _, one in passes])
    away_m = np.hypot(observed.offsets_m[[station for station, _ in passes]], _HALF_LONG_M)
    return float(np.median(width_m / (away_m + _HALF_MEDIAN_S * speed_mps)))


def own_prominences(observed: RoadPowers, fitted: Sequence[FittedVehicle]) -> list[Array]:
    """Return by how much each vehicle stands out once the others' power is taken off, (n,) [dB].

    Of those that meet it at a station nothing is taken off there: they make one peak.
    """
    means = np.array([observed.power(one.vehicle, slice(None))[0] for one in fitted])
    moments = np.array([observed.moments(one.vehicle) for one in fitted])
    reach = round(_REACH_S / observed.cycle_s)
    prominences_db = []
    for number, one in enumerate(fitted):
        apart = np.abs(moments - moments[number]) > _MERGED_S
        others = (means * apart[:, None, :]).sum(axis=0)
        left = np.where(observed.valid, observed.powers - others, 0.0)
        level = 10 * np.log10(np.maximum(left, _LEFT * observed.noise))
        level = _of_three(level)
        near = np.clip(observed.widths(one.vehicle), *_NEAR_S)
        stands = np.zeros(len(near))
        for station, (moment, width) in enumerate(zip(moments[number], near, strict=True)):
            low, high = np.searchsorted(observed.times_s, [moment - width, moment + width])
            if low < high:
                peak = low + int(level[low:high, station].argmax())
                before = level[max(0, peak - reach) : peak + 1, station].min()
                after = level[peak : peak + reach + 1, station].min()
                stands[station] = level[peak, station] - max(before, after)
        prominences_db.append(stands)
    return prominences_db


def _of_three(level: Array) -> Array:
    """Return the median of each row and its neighbours; those at the ends count twice."""
    padded = level[[0, *range(len(level)), -1]]
    return np.asarray(np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0))


def scatter_about(observed: RoadPowers, one: FittedVehicle, mean: Array) -> float:
    """Return the standard deviation of powers about a fitted mean, (c, n), while one passes."""
    moments = observed.moments(one.vehicle)
    about = np.clip(3 * observed.widths(one.vehicle), *_PASSES_S)
    near = (np.abs(observed.times_s[:, None] - moments) <= about) & observed.valid
    if not near.any():
        return float("inf")
    ratio = observed.powers[near] / mean[near]
    return float(np.sqrt(np.mean(cube_root_normalised(ratio) ** 2)))


def _singled(observed: RoadPowers, fitted: Sequence[FittedVehicle]) -> tuple[FittedVehicle, ...]:
    """Return vehicles without those that go beside a stronger one all the way: its other half."""
    retained: list[FittedVehicle] = []
    for one in sorted(fitted, key=lambda one: -float(one.vehicle.values[PEAK])):
        moments = observed.moments(one.vehicle)
        beside = (
            other.vehicle.direction == one.vehicle.direction
            and float(np.abs(observed.moments(other.vehicle) - moments).max()) < _MERGED_S
            for other in retained
        )
        if not any(beside):
            retained.append(one)
    return tuple(sorted(retained, key=lambda one: float(one.vehicle.values[MOMENT])))


def _passes(
    observed: RoadPowers, fitted_vehicle: FittedVehicle, stands_db: Array
) -> Iterator[StationPass]:
    """Give a vehicle's pass at each station, errors by the delta method."""
    vehicle, spread = fitted_vehicle.vehicle, fitted_vehicle.covariance
    moments, widths, peaks = (
        f(vehicle).tolist() for f in (observed.moments, observed.widths, observed.peaks)
    )
    for station, along in enumerate(observed.centred_m):
        moment = np.zeros(len(spread))
        moment[[MOMENT, SLOWNESS]] = 1.0, vehicle.slowness * along
        sigma = float(np.sqrt(moment @ spread @ moment))
        floor = float(np.interp(moments[station], observed.times_s, observed.noise[:, station]))
        over_db = float(over_floor_db(np.array(peaks[station]), np.array(floor)))
        yield StationPass(
            moments[station],
            sigma,
            widths[station],
            float(stands_db[station]),
            over_db,
            fitted_vehicle.together,
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
        values = np.array([v.values for v in vehicles]).reshape(-1, len(self.observed.typical))
        around = np.tile(self.observed.typical, (len(values), 1))
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
        valid = observed.valid[self.rows]
        mean, parts, slopes = self._model(values, signs)
        variance, tempered = self.scatter.variance, self.scatter.effective
        ratio = np.where(valid, observed.powers[self.rows], mean) / mean
        off = np.where(valid, cube_root_normalised(ratio) + variance / 3, 0.0)
        lower = np.linalg.cholesky(self.scatter.correlation(parts, valid))
        white = np.linalg.solve(lower, np.concatenate([slopes, off[:, :, None]], axis=2))
        design = white[..., :-1].reshape(mean.size, slopes.shape[2])
        left = white[..., -1]
        # what the mean does to the density of a cube root: its Jacobian, and the determinant
        scale = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() - 2 / 3 * np.log(ratio).sum()
        weights = np.linalg.solve(np.swapaxes(lower, 1, 2), left[..., None])[..., 0]
        score = np.where(valid, np.cbrt(ratio) * weights / tempered - variance / tempered / 3, 0.0)
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
        contributions = [
            self.observed.power(Vehicle(row, sign), self.rows)
            for row, sign in zip(values, signs, strict=True)
        ]
        mean = self.beside + sum((power for power, _ in contributions), np.zeros_like(self.beside))
        parts = np.array([power / mean for power, _ in contributions]).reshape(-1, *mean.shape)
        slopes = np.concatenate(
            [np.zeros((*mean.shape, 0)), *(s for _, s in contributions)], axis=2
        )
        valid = self.observed.valid[self.rows]
        return mean, parts, np.where(valid, 1 / mean, 0.0)[:, :, None] * slopes

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
    def valid(self) -> NDArray[np.bool_]:
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
        return np.where(self.valid, self.floors, 1.0)

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
    def typical(self) -> Array:
        """The values of a vehicle of which nothing is known, shape (4 + n,); its moment is 0."""
        peak = _USUAL_OVER_FLOOR * float(np.median(self.noise[self.valid]))
        vehicle_values = [0.0, -np.log(_USUAL_MPS), np.log(peak), np.log(self.distances_m.mean())]
        return np.concatenate([vehicle_values, np.zeros(len(self.along_m))])

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
#: (docs/accuracy/vehicles.md).
_BESIDE_S, _SEARCH_ABOUT_S = 1.5, 5.0
#: So many are fitted jointly at most: of more, each part has the others' powers as given. The time
#: of a search grows with the cube of their number. Chosen by trial on nodes of seeds 1 to 10: 8
#: tell what no bound does, with 4 two gusts more are told.
_JOINTLY = 8
#: By so much the evidence must grow. Chosen by trial on simulated roads of seeds 1 to 10
#: (docs/accuracy/vehicles.md).
_MARGIN = 1.5
#: Steps of a first trial, of a full fit; how many trials are fitted fully. Chosen by trial on
#: simulated roads of seeds 1 to 10 (docs/accuracy/vehicles.md).
_FIRST, _FULL, _BEST = 5, 25, 2
_CHANGES, _SWEEPS = 6, 2
#: Half of what two halves of a vehicle are apart [s], and what each has of its peak, ln. Chosen by
#: trial on simulated roads of seeds 1 to 10 (docs/accuracy/vehicles.md).
_APART_S, _HALF = 0.4, 0.5
#: Excess of power is smoothed over so many cycles, and looked for this far from the ends [s].
#: Chosen by trial on simulated roads of seeds 1 to 10 (docs/accuracy/vehicles.md).
_SMOOTH, _INSIDE_S = 5, 3.0
_TRIED_MPS = (6.0, 14.0)
#: Of a vehicle that stations hear at once [s/m]. Chosen by trial on simulated roads of seeds 1 to
#: 10 (docs/accuracy/vehicles.md).
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
    if not start or not observed.valid.any():
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
        scatter = scatter_of(observed.powers, observed.noise, observed.valid, mean)
        if sweep < _SWEEPS:
            groups = _groups(observed, everyone)
    vehicles = [one for _, fit in fits for one in _with_covariances(observed, fit)]
    return tuple(sorted(vehicles, key=lambda one: float(one.vehicle.values[MOMENT])))


def _with_covariances(observed: RoadPowers, fit: TrafficFit) -> Iterator[FittedVehicle]:
    size = len(observed.typical)
    if not fit.vehicles:
        return
    covariance = np.asarray(np.linalg.inv(fit.information), np.float64)
    for number, vehicle in enumerate(fit.vehicles):
        block = slice(number * size, (number + 1) * size)
        yield FittedVehicle(vehicle, covariance[block, block], len(fit.vehicles))


def _groups(observed: RoadPowers, vehicles: Sequence[Vehicle]) -> list[tuple[Vehicle, ...]]:
    """Return vehicles that pass at about the same time, of those that pass while cycles last."""
    first, last = observed.times_s[[0, -1]] + np.array([-_SEARCH_ABOUT_S, _SEARCH_ABOUT_S])
    spans = [(observed.moments(v), v) for v in vehicles]
    spans = [span for span in spans if span[0].max() > first and span[0].min() <= last]
    spans.sort(key=lambda span: float(span[0].min()))
    groups: list[list[Vehicle]] = []
    last = -np.inf
    for moments, vehicle in spans:
        if moments.min() - last > 2 * _BESIDE_S:
            groups.append([])
        groups[-1].append(vehicle)
        last = max(last, float(moments.max()))
    return [part for group in groups for part in _cut(observed, group)]


def _cut(observed: RoadPowers, group: Sequence[Vehicle]) -> Iterator[tuple[Vehicle, ...]]:
    """Cut vehicles in order of time where they are farthest apart, until no part has too many."""
    if len(group) <= _JOINTLY:
        yield tuple(group)
        return
    middles = [float(observed.moments(vehicle).mean()) for vehicle in group]
    where = 1 + int(np.argmax(np.diff(middles)))
    yield from _cut(observed, group[:where])
    yield from _cut(observed, group[where:])


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
    for flipped in [*combinations(several, 1), *combinations(several, 2)]:
        yield tuple(_reversed(v) if i in flipped else v for i, v in enumerate(vehicles))
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


def _reversed(vehicle: Vehicle) -> Vehicle:
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
    typical = stretch.observed.typical
    for sign, late_s in zip(signs, (-_APART_S, _APART_S), strict=True):
        values = vehicle.values.copy()
        values[[SLOWNESS, DISTANCE]] = typical[[SLOWNESS, DISTANCE]]
        values[MOMENT] += late_s
        values[PEAK] -= _HALF
        yield Vehicle(values, sign)


def smoothed(values: Array, length: int) -> Array:
    """Return values under a Hann window of so many points, renormalised at the ends, shape (n,)."""
    window = np.hanning(2 * (length // 2) + 3)[1:-1]
    if len(window) > len(values):
        window = np.ones(1)
    total = np.convolve(np.ones(len(values)), window, "same")
    return np.asarray(np.convolve(values, window, "same") / total)


def _missing(stretch: Stretch, fit: TrafficFit) -> Iterator[Vehicle]:
    """Give vehicles where the powers of a station exceed the fitted mean most."""
    observed, rows = stretch.observed, stretch.rows
    times, valid = observed.times_s[rows], observed.valid[rows]
    inside = (times >= times[0] + _INSIDE_S) & (times <= times[-1] - _INSIDE_S)
    if not inside.any():
        return
    excess = np.log(np.where(valid, observed.powers[rows], fit.mean) / fit.mean)
    for station, along in enumerate(observed.centred_m):
        high = np.where(inside, smoothed(excess[:, station], _SMOOTH), -np.inf)
        cycle = int(high.argmax())
        more = fit.mean[cycle, station] * max(float(np.expm1(high[cycle])), 0.1)
        for speed, sign in product(_TRIED_MPS, (1, -1)):
            values = observed.typical.copy()
            values[:DISTANCE] = times[cycle] - sign * along / speed, -np.log(speed), np.log(more)
            yield Vehicle(values, sign)
