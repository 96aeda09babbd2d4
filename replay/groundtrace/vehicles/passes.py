"""Passes of vehicles in the power of single stations, and chains of them along a road.

A vehicle that goes by lifts the power of a station out of what is before and after it, whatever the
law by which waves get weaker: its peak has a prominence, as a mountain has. It comes by one station
after the other, in their order, in times that speeds of vehicles allow. What shakes all of them at
once, or at walking pace, makes no chain, and what is shorter than half of the running median makes
no peak (see :mod:`.presence`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: A peak is as wide as the power is less than this below it [dB]; its moment is uncertain by this
#: part of the width, and by so much beside it [s]. Chosen by trial on simulated nodes of seeds 1 to
#: 20: errors of 68 % of true passes.
_WIDE_DB, _UNSURE, _LEAST_S = 3.0, 0.3, 0.1


@dataclass(frozen=True, slots=True)
class StationPass:
    """A vehicle passes a station.

    Attributes
    ----------
    time_s, time_sigma_s
        When it is nearest, and the standard deviation [s].
    half_width_s
        d / v of the law, or half of the peak's width [s].
    prominence_db, over_floor_db
        By what its power stands out of that before and after it, and of the noise [dB].
    together
        How many vehicles were fitted jointly with it, itself counted in.
    """

    time_s: float
    time_sigma_s: float
    half_width_s: float
    prominence_db: float
    over_floor_db: float
    together: int


@dataclass(frozen=True, slots=True)
class Peak:
    """Power that stands out at a station.

    Attributes
    ----------
    time_s, sigma_s
        When, and the standard deviation of that [s].
    half_width_s
        Half of the time in which the power is less than 3 dB below it [s].
    prominence_db
        By what it stands out of the higher one of the lowest powers before and after it, as far as
        there is no higher peak [dB].
    power
        Of the running median [unit^2].
    """

    time_s: float
    sigma_s: float
    half_width_s: float
    prominence_db: float
    power: float


def prominences(level_db: Array, peaks: NDArray[np.intp], reach: int) -> Array:
    """Return by how much peaks stand out within a reach on either side [dB].

    Of two peaks of one height the first one stands out less; even tops are one peak.

    Parameters
    ----------
    level_db
        Shape (c,) [dB].
    peaks
        Shape (p,): indices.
    reach
        Looked at on either side [cycles].
    """
    prominence_db = np.zeros(len(peaks))
    for i, peak in enumerate(peaks.tolist()):
        height = level_db[peak]
        before, after = level_db[max(0, peak - reach) : peak][::-1], level_db[peak + 1 :][:reach]
        even = int((after != height).argmax()) if (after != height).any() else len(after)
        after = after[even:]
        higher, other = np.flatnonzero(before > height), np.flatnonzero(after >= height)
        before = before[: higher[0]] if len(higher) else before
        after = after[: other[0]] if len(other) else after
        prominence_db[i] = height - max(before.min(initial=height), after.min(initial=height))
    return prominence_db


def tops(level: Array) -> NDArray[np.intp]:
    """Return where a line is higher than before and after; of an even top, its middle."""
    ends = np.append(np.flatnonzero(np.diff(level)), len(level) - 1)
    starts = np.append(0, ends[:-1] + 1)
    rises = np.diff(level[starts]) > 0
    high = 1 + np.flatnonzero(rises[:-1] & ~rises[1:])
    return np.asarray((starts[high] + ends[high]) // 2)


def station_peaks(
    times_s: Array, steady: Array, powers: Array, reach_s: float, least_db: float
) -> tuple[Peak, ...]:
    """Return what stands out at a station, in time order.

    Parameters
    ----------
    times_s
        Shape (c,): middles of even cycles, two at least [s].
    steady, powers
        Shape (c,): running medians, and means [unit^2]; where there is none, no peak is found.
    reach_s
        Looked at before and after a peak [s].
    least_db
        Least prominence [dB].
    """
    cycle_s = float(np.median(np.diff(times_s)))
    valid = np.isfinite(steady) & (steady > 0)
    if not valid.any():
        return ()
    level = 10 * np.log10(np.where(valid, steady, steady[valid].min()))
    where = tops(level)
    stands = prominences(level, where, round(reach_s / cycle_s))
    return tuple(
        _peak(times_s, level, powers, peak, db)
        for peak, db in zip(where.tolist(), stands.tolist(), strict=True)
        if db >= least_db
    )


def _peak(times_s: Array, level: Array, powers: Array, peak: int, db: float) -> Peak:
    """Return a peak, its moment the mean of the time while it is high, weighted by power."""
    low = np.flatnonzero(level < level[peak] - _WIDE_DB)
    before, after = low[low < peak], low[low > peak]
    start = int(before[-1]) + 1 if len(before) else 0
    stop = int(after[0]) if len(after) else len(level)
    weights = np.nan_to_num(powers[start:stop])
    if not weights.sum() > 0:
        weights = np.ones(stop - start)
    time = float(weights @ times_s[start:stop] / weights.sum())
    width = float(times_s[1] - times_s[0]) * (stop - start)
    sigma = float(np.hypot(_LEAST_S, _UNSURE * width))
    return Peak(time, sigma, width / 2, db, float(10 ** (level[peak] / 10)))


#: A leg may be this many standard deviations longer or shorter than from peak to peak. Chosen by
#: trial on simulated nodes of seeds 1 to 10.
_SLACK = 2.0
#: Chains that go on from one peak at most. Chosen by judgement: it bounds the cost.
_BEAM = 12
#: Legs of vehicles [m/s], the fastest over the slowest one at most, and what a chain loses of its
#: prominence for each e-fold beyond [dB]. Chosen by judgement: the first are what the gates ask
#: for, so that a chain that fails them takes no peaks of one that does not.
_USUAL_MPS, _USUAL_RATIO, _LOSS_DB = (2.5, 30.0), 3.0, 50.0
#: One station of so many may miss a pass. Chosen by judgement: a chain of three needs all.
_SPARE = 4


@dataclass(frozen=True, slots=True)
class Chain:
    """Peaks of one vehicle, station after station.

    Attributes
    ----------
    direction
        1 towards greater distance along the road, else -1.
    members
        Station and peak, in the order of passing.
    legs_mps
        Slowest and fastest speed from one station to the next, the moments within two standard
        deviations as near to one speed as can be [m/s].
    prominence_db
        Sum of prominences over the number of stations [dB].
    slowness, slowness_sigma
        Of the line through the moments, along the road, and its standard deviation by how the
        moments are off it [s/m].
    """

    direction: int
    members: tuple[tuple[int, Peak], ...]
    legs_mps: tuple[float, float]
    prominence_db: float
    slowness: float
    slowness_sigma: float

    @property
    def ratio(self) -> float:
        """Fastest over slowest leg."""
        return self.legs_mps[1] / self.legs_mps[0]

    @property
    def rank(self) -> float:
        """Prominence, less where legs are unusual for a vehicle [dB]."""
        slow, fast = self.legs_mps
        beyond = (
            max(0.0, float(np.log(_USUAL_MPS[0] / slow)))
            + max(0.0, float(np.log(fast / _USUAL_MPS[1])))
            + max(0.0, float(np.log(self.ratio / _USUAL_RATIO)))
        )
        return self.prominence_db - _LOSS_DB * beyond

    def time_at(self, along_m: float, places_m: Array) -> float:
        """Return when the line is at a place along the road; ``places_m`` are the stations' [s]."""
        times, places = self.moments(), places_m[[station for station, _ in self.members]]
        return float(times.mean() + self.slowness * (along_m - places.mean()))

    def moments(self) -> Array:
        """Return its moments, in the order of passing [s]."""
        return np.array([peak.time_s for _, peak in self.members])


def chains(
    along_m: Array,
    peaks: Sequence[Sequence[Peak]],
    speeds_mps: tuple[float, float],
    least_db: float,
) -> tuple[Chain, ...]:
    """Put peaks together that one vehicle may have made; a peak belongs to one chain.

    The chain of the highest prominence comes first, then that of what is left.

    Parameters
    ----------
    along_m
        Of each station, along the road [m].
    peaks
        Of each station, in that order.
    speeds_mps
        Slowest and fastest leg [m/s].
    least_db
        Least prominence of a chain [dB].
    """
    order = np.argsort(along_m, kind="stable")
    candidates: list[Chain] = []
    for direction in (1, -1):
        way = order[::direction].tolist()
        for members in _members(along_m, peaks, way, speeds_mps):
            chain = _chain(direction, along_m, members, len(way))
            if chain is not None and chain.prominence_db >= least_db:
                candidates.append(chain)
    candidates.sort(key=lambda chain: -chain.rank)
    taken: set[tuple[int, int]] = set()
    retained: list[Chain] = []
    for chain in candidates:
        chain_peaks = {(station, id(peak)) for station, peak in chain.members}
        if not chain_peaks & taken:
            retained.append(chain)
            taken |= chain_peaks
    return tuple(sorted(retained, key=lambda chain: float(chain.moments().min())))


_Members = tuple[tuple[int, Peak], ...]


def _members(
    along_m: Array,
    peaks: Sequence[Sequence[Peak]],
    way: Sequence[int],
    speeds_mps: tuple[float, float],
) -> Iterator[_Members]:
    """Give the peaks of chains over all stations of a way, but for those that may be missed."""
    spare = len(way) // _SPARE
    ends: list[list[tuple[float, _Members]]] = []  # of each station, prominence and members
    for index, station in enumerate(way):
        here: list[tuple[float, _Members]] = []
        for peak in peaks[station]:
            before: list[tuple[float, _Members]] = [(0.0, ())] if index <= spare else []
            for back in range(1, min(index, spare + 1) + 1):
                for total, members in ends[index - back]:
                    missed = index - len(members)
                    if missed <= spare and _follows(
                        along_m, members[-1], (station, peak), speeds_mps
                    ):
                        before.append((total, members))
            before.sort(key=lambda one: -one[0])
            member = (station, peak)
            here += [(total + peak.prominence_db, (*m, member)) for total, m in before[:_BEAM]]
        ends.append(here)
    for index in range(max(0, len(way) - 1 - spare), len(way)):
        for _, members in ends[index]:
            if len(members) >= max(2, len(way) - spare):
                yield members


def _follows(
    along_m: Array, one: tuple[int, Peak], other: tuple[int, Peak], speeds_mps: tuple[float, float]
) -> bool:
    """Return whether a vehicle may take so long from a peak to another."""
    way = abs(float(along_m[other[0]] - along_m[one[0]]))
    lag = other[1].time_s - one[1].time_s
    slack = _SLACK * float(np.hypot(one[1].sigma_s, other[1].sigma_s))
    return way / speeds_mps[1] - slack <= lag <= way / speeds_mps[0] + slack


def _chain(direction: int, along_m: Array, members: _Members, stations: int) -> Chain | None:
    """Return peaks as a chain, with the line through their moments by weighted least squares."""
    x = np.array([along_m[station] for station, _ in members])
    t = np.array([peak.time_s for _, peak in members])
    sigma = np.array([peak.sigma_s for _, peak in members])
    weights = sigma**-2
    centred = x - weights @ x / weights.sum()
    spread = float(weights @ centred**2)
    slowness = float(weights @ (centred * (t - weights @ t / weights.sum()))) / spread
    if not slowness * direction > 0:
        return None
    off = t - weights @ t / weights.sum() - slowness * centred
    excess = float(weights @ off**2) / max(len(members) - 2, 1)
    slack = _SLACK * np.hypot(sigma[1:], sigma[:-1])
    ways, lags = np.abs(np.diff(x)), np.diff(t)
    lags = np.clip(abs(slowness) * ways, lags - slack, lags + slack)
    if not (lags > 0).all():
        return None
    legs = ways / lags
    return Chain(
        direction,
        members,
        (float(legs.min()), float(legs.max())),
        sum(peak.prominence_db for _, peak in members) / stations,
        slowness,
        float(np.sqrt(max(1.0, excess) / spread)),
    )
