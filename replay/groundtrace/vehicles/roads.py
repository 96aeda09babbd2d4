"""Vehicles on a road, from their passes by a few stations beside it: direction and speed.

A vehicle of constant speed v passes the station at x along the road at t0 + x / v. Passes of
several vehicles are told apart by that line, and by how wide and strong they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .passes import StationPass

    Array = NDArray[np.float64]

#: By so much (natural logarithm) widths and peaks of one vehicle differ from station to station.
_UNLIKE_WIDTH, _UNLIKE_PEAK = 0.4, 1.0


@dataclass(frozen=True, slots=True)
class Road:
    """Stations beside a straight road.

    Attributes
    ----------
    along_m
        Of each station, along the road [m].
    offsets_m
        Distance of each from the lane [m]; empty where unknown. Known, the width of a pass tells
        the speed at one station as well.
    speeds_mps
        Slowest and fastest vehicle [m/s].
    tolerance_s
        Standard deviation of a moment beside that of its fit [s]: speed is not quite constant, and
        the ground at no station is like the law.
    gate
        Standard deviations that a moment may be off the line.
    """

    along_m: tuple[float, ...]
    offsets_m: tuple[float, ...] = ()
    speeds_mps: tuple[float, float] = (0.8, 45.0)
    tolerance_s: float = 0.1
    gate: float = 3.5


@dataclass(frozen=True, slots=True)
class RoadPass:
    """A vehicle that passed two stations or more.

    Attributes
    ----------
    speed_mps, speed_sigma_mps
        Speed and its standard deviation [m/s].
    direction
        1 towards greater distance along the road, else -1.
    along_m, time_s, time_sigma_s
        A place along the road [m], when the vehicle was there, and the standard deviation [s].
    passes
        Station and number of pass, of those that are its.
    surprise
        Sum of squares of what is unlike, in standard deviations: moments off the line, widths and
        peaks.
    """

    speed_mps: float
    speed_sigma_mps: float
    direction: int
    along_m: float
    time_s: float
    time_sigma_s: float
    passes: tuple[tuple[int, int], ...]
    surprise: float

    def time_at(self, along_m: float) -> float:
        """Return when it was at a place along the road [s]."""
        return self.time_s + self.direction * (along_m - self.along_m) / self.speed_mps


def associate(road: Road, passes: Sequence[Sequence[StationPass]]) -> tuple[RoadPass, ...]:
    """Tell vehicles apart, in time order.

    Lines through two passes of two stations collect the passes that fit at the other stations.
    Lines of more stations come first, then those of less surprise; a pass belongs to one vehicle.
    Two that meet at a station make one pass there, so one of them has a station less.

    Parameters
    ----------
    road
        The stations.
    passes
        Of each station, in the road's order.
    """
    left = [set(range(len(those))) for those in passes]
    found: list[RoadPass] = []
    while members := set(_lines(road, passes, left)):
        vehicles = [_vehicle(road, passes, those) for those in members]
        best = min(vehicles, key=lambda v: (-len(v.passes), v.surprise))
        found.append(best)
        for station, number in best.passes:
            left[station].discard(number)
    return tuple(sorted(found, key=lambda v: v.time_s))


def _lines(
    road: Road, passes: Sequence[Sequence[StationPass]], left: list[set[int]]
) -> Iterator[tuple[tuple[int, int], ...]]:
    """Give all lines through two passes that are left, with those of other stations that fit."""
    slow, fast = road.speeds_mps
    for a, b in combinations(range(len(passes)), 2):
        way = road.along_m[b] - road.along_m[a]
        if way == 0:
            continue
        for i, j in product(left[a], left[b]):
            slowness = (passes[b][j].time_s - passes[a][i].time_s) / way
            if 1 / fast <= abs(slowness) <= 1 / slow:
                yield _collected(road, passes, left, {a: i, b: j})


def _collected(
    road: Road,
    passes: Sequence[Sequence[StationPass]],
    left: list[set[int]],
    seed: dict[int, int],
) -> tuple[tuple[int, int], ...]:
    (a, i), (b, j) = seed.items()
    one, other = passes[a][i], passes[b][j]
    members = dict(seed)
    for station in set(range(len(passes))) - {a, b}:
        part = (road.along_m[station] - road.along_m[a]) / (road.along_m[b] - road.along_m[a])
        expected = (1 - part) * one.time_s + part * other.time_s
        ends = (1 - part) ** 2 * _variance(road, one) + part**2 * _variance(road, other)
        off = {
            number: abs(those.time_s - expected) / (ends + _variance(road, those)) ** 0.5
            for number, those in enumerate(passes[station])
            if number in left[station]
        }
        nearest = min(off, key=lambda number: off[number], default=None)
        if nearest is not None and off[nearest] <= road.gate:
            members[station] = nearest
    return tuple(sorted(members.items()))


def _variance(road: Road, one: StationPass) -> float:
    return one.time_sigma_s**2 + road.tolerance_s**2


def _vehicle(
    road: Road, passes: Sequence[Sequence[StationPass]], members: tuple[tuple[int, int], ...]
) -> RoadPass:
    """Fit the line of a vehicle by weighted least squares."""
    those = [passes[station][number] for station, number in members]
    along = np.array([road.along_m[station] for station, _ in members])
    times = np.array([p.time_s for p in those])
    weights = 1 / np.array([_variance(road, p) for p in those])
    middle = float(weights @ along / weights.sum())
    moment = float(weights @ times / weights.sum())
    spread = float(weights @ (along - middle) ** 2)
    slowness = float(weights @ ((along - middle) * (times - moment))) / spread
    speed = 1 / max(abs(slowness), np.finfo(float).tiny)
    off = times - moment - slowness * (along - middle)
    surprise = float(weights @ off**2) + _unlike(road, members, those, speed)
    return RoadPass(
        speed,
        float(speed**2 / np.sqrt(spread)),
        1 if slowness > 0 else -1,
        middle,
        moment,
        float(1 / np.sqrt(weights.sum())),
        members,
        surprise,
    )


def _unlike(
    road: Road, members: tuple[tuple[int, int], ...], those: list[StationPass], speed_mps: float
) -> float:
    """Return by how much widths and peaks differ from those of one vehicle."""
    widths = np.log([p.half_width_s for p in those])
    width_sigma = np.hypot([p.log_width_sigma for p in those], _UNLIKE_WIDTH)
    peaks = np.log([p.peak for p in those])
    peak_sigma = np.hypot([p.log_peak_sigma for p in those], _UNLIKE_PEAK)
    if road.offsets_m:  # then the law says how wide, and stations compare after spreading
        offsets = np.array([road.offsets_m[station] for station, _ in members])
        off = widths - np.log(offsets / speed_mps)
    else:
        off = widths - np.average(widths, weights=1 / width_sigma**2)
    off_peak = peaks - np.average(peaks, weights=1 / peak_sigma**2)
    return float(np.sum((off / width_sigma) ** 2) + np.sum((off_peak / peak_sigma) ** 2))
