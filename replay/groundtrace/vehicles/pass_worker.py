"""Passes of vehicles at stations beside a road, put together over the stations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.traffic import Pass

from ..gates import Level
from ..parameters import gate, measured
from .api import candidates_of
from .joining import CycleStage
from .passes import PassFinder
from .roads import Road
from .traffic import driven
from .traffic_model import RoadPowers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..gates import Candidates
    from .api import Cycle
    from .passes import StationPass
    from .traffic import Driven

    Array = NDArray[np.float64]

#: The cycles after a pass whose window of signal holds it [s]: those tell whether it is an impact,
#: which a vehicle that has just gone by does not.
_ABOUT_S = (0.5, 3.5)
#: Passes without which a vehicle is none.
_FEWEST = 2
#: Peak over the noise, and standard deviation of its moment [s], from which a pass of a single
#: station may start a vehicle. They are no gates: those decide about what is found.
_CLEAR, _CLEAR_S = 4.0, 2.0
#: Quiet cycles kept before the first in which something passes [s].
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
        self._cycles: list[Cycle] = []
        self._last_ns: int | None = None
        self._vehicles = 0
        self._found: list[tuple[int, StationPass, Driven | None]] = []
        self._origin_ns = 0
        return site.names

    def take(self, cycle: Cycle) -> Candidates:
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
    ) -> list[tuple[int, StationPass, Driven | None]]:
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

    def _pass(self, station: int, one: StationPass, whose: tuple[int, Driven] | None) -> Pass:
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
