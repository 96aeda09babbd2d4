"""Passes of vehicles by stations beside a road: time, duration and strength, direction and speed.

A vehicle that passes at a distance d with a speed v has the power mu / ((v (t - t0))^2 + d^2)^(n/2)
by the paper's (4). One station gives only the time t0, the power peak mu / d^n and the half width d
/ v of

    P(t) = peak / (1 + ((t - t0) / width)^2)^(n/2) + noise,

so that speed needs several stations. The powers of vehicles that overlap add up: their laws are
fitted jointly.

A vehicle of constant speed v passes the station at x along the road at t0 + x / v. Passes of
several vehicles are separated by that line, and by how wide and strong they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from .medium import CYCLE_POINTS, CYCLE_WEIGHTS, EXPONENT, Fitted, fit_powers, usable
from .presence import RELATIVE_SIGMA

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Widths are kept between these [s]; a narrower pass is within one cycle anyhow. Chosen by
#: judgement: 20 m/s a metre beside the lane; in five minutes nobody drives by.
_WIDTHS_S = (0.05, 300.0)
#: Parameters of a pass, in the order of a fit: t0, ln peak, ln width. Source: definition.
_PER_PASS = 3
#: What a pass more must gain over Schwarz's criterion. Chosen by judgement: "strong" for twice a
#: log Bayes factor, R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995).
_SURE = 6
#: Most passes in one event. Chosen by judgement: it bounds the cost; more that overlap cannot be
#: told apart.
_MOST = 6


@dataclass(frozen=True, slots=True)
class StationPass:
    """A vehicle passes a station.

    Attributes
    ----------
    time_s, time_sigma_s
        When it is nearest, and the standard deviation [s].
    half_width_s, log_width_sigma
        d / v [s], and the standard deviation of its logarithm.
    peak, log_peak_sigma
        Power at the nearest, without noise [unit^2], and the standard deviation of its logarithm.
    over_floor
        Peak over the noise.
    together
        How many passes were fitted jointly with it, itself counted in.
    """

    time_s: float
    time_sigma_s: float
    half_width_s: float
    log_width_sigma: float
    peak: float
    log_peak_sigma: float
    over_floor: float
    together: int


@dataclass(frozen=True, slots=True)
class PassFinder:
    """How passes are found in the powers of a station.

    Attributes
    ----------
    exponent
        n of the law.
    smooth_s
        Full length of the Hann window over the logarithm of power [s].
    least_over_floor
        Smoothed power over the noise from which a maximum is a pass.
    least_prominence
        By what a maximum must stand out of what lies between it and a higher one, as a factor.
    edge_over_floor
        An event reaches as far as smoothed power is above this.
    relative_sigma
        Standard deviation of a power over its mean; a second vehicle must explain more than that.
    """

    exponent: float = EXPONENT
    smooth_s: float = 3.0
    least_over_floor: float = 3.0
    least_prominence: float = 1.6
    edge_over_floor: float = 1.3
    relative_sigma: float = RELATIVE_SIGMA

    def find(self, times_s: Array, powers: Array, floors: Array) -> tuple[StationPass, ...]:
        """Return the passes in time order.

        Parameters
        ----------
        times_s
            Shape (c,): middles of even cycles, c at least 2 [s].
        powers, floors
            Shape (c,): noise included, and of the noise [unit^2]; NaN where there is none.
        """
        used = usable(powers) & usable(floors)
        cycle_s = float(np.median(np.diff(times_s)))
        times, level, noise = times_s[used], powers[used], floors[used]
        if len(times) < _PER_PASS + 2:
            return ()
        smooth = smoothed(np.log(level / noise), round(self.smooth_s / cycle_s))
        peaks, _ = signal.find_peaks(
            smooth, height=np.log(self.least_over_floor), prominence=np.log(self.least_prominence)
        )
        found: list[StationPass] = []
        for span in self._events(smooth, peaks):
            inside = peaks[(peaks >= span.start) & (peaks < span.stop)] - span.start
            event = Event(times[span], level[span], noise[span], self.exponent, cycle_s)
            found += self._explained(event, inside)
        return tuple(sorted(found, key=lambda one: one.time_s))

    def _events(self, smooth: Array, peaks: NDArray[np.intp]) -> list[slice]:
        """Return the stretches above the edge in which there are peaks, with quiet about them."""
        edges = np.diff(np.concatenate([[0], smooth > np.log(self.edge_over_floor), [0]]))
        starts, stops = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        spans = []
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            if ((peaks >= start) & (peaks < stop)).any():
                quiet = max(3, (stop - start) // 4)
                spans.append(slice(max(0, start - quiet), stop + quiet))
        return spans

    def _explained(self, event: Event, peaks: NDArray[np.intp]) -> list[StationPass]:
        """Add passes while one more explains what noise does not."""
        fit = event.fit([event.guess(peak) for peak in peaks], self.relative_sigma)
        needed = self.relative_sigma**2 * (_PER_PASS * np.log(event.samples) + _SURE)
        while fit.samples > len(fit.values) + _PER_PASS and len(fit.values) < _PER_PASS * _MOST:
            known = fit.values.reshape(-1, _PER_PASS)
            more = event.fit([*known, event.missing(fit.values)], self.relative_sigma)
            if fit.deviance - more.deviance < needed or not np.isfinite(more.covariance).all():
                break
            fit = more
        return [p for p in event.passes(fit) if p.over_floor >= self.least_over_floor]


@dataclass(frozen=True, slots=True, eq=False)
class Event:
    """A stretch of a station's powers.

    Attributes
    ----------
    times_s, powers, floors
        Shape (c,): middles of cycles [s], powers above 0, and those of the noise [unit^2].
    exponent
        n.
    cycle_s
        Length of a cycle [s].
    """

    times_s: Array
    powers: Array
    floors: Array
    exponent: float
    cycle_s: float

    @property
    def samples(self) -> int:
        """Number of cycles."""
        return len(self.times_s)

    def fit(self, guesses: list[Array], relative_sigma: float) -> Fitted:
        """Fit the sum of as many passes as there are guesses, each (t0, ln peak, ln width)."""
        start = np.concatenate(guesses)
        return fit_powers(self._mean, self.powers, start, relative_sigma)

    def guess(self, peak: int) -> Array:
        """Return the parameters of a pass at a cycle: as wide as it is above half its power."""
        above = self.powers - self.floors
        high = smoothed(above, 3)
        low = np.flatnonzero(high < high[peak] / 2)
        before, after = low[low < peak], low[low > peak]
        reach = [peak - before[-1]] if len(before) else []
        reach += [after[0] - peak] if len(after) else []
        half = self.cycle_s * float(min(reach, default=2))
        width = half / np.sqrt(4 ** (1 / self.exponent) - 1)
        return self._parameters(float(self.times_s[peak]), float(high[peak]), width)

    def missing(self, values: Array) -> Array:
        """Return the parameters of a pass where powers exceed the fitted mean most."""
        mean, _ = self._mean(values)
        excess = smoothed(self.powers / mean - 1, 5)
        where = int(excess.argmax())
        width = float(np.exp(values[2::_PER_PASS]).min()) / 2
        peak = float(excess[where] * mean[where])
        return self._parameters(float(self.times_s[where]), peak, width)

    def passes(self, fit: Fitted) -> list[StationPass]:
        """Return a fit's passes."""
        rows = fit.values.reshape(-1, _PER_PASS)
        sigmas = np.sqrt(np.diag(fit.covariance)).reshape(-1, _PER_PASS)
        found = []
        for (time, peak, width), sigma in zip(rows.tolist(), sigmas.tolist(), strict=True):
            floor = float(np.interp(time, self.times_s, self.floors))
            power, half = float(np.exp(peak)), float(np.exp(np.clip(width, *np.log(_WIDTHS_S))))
            over = power / floor
            found.append(
                StationPass(time, sigma[0], half, sigma[2], power, sigma[1], over, len(rows))
            )
        return found

    def _parameters(self, time_s: float, peak: float, width_s: float) -> Array:
        least = 1e-3 * float(self.powers.max())
        return np.array([time_s, np.log(max(peak, least)), np.log(max(width_s, self.cycle_s / 2))])

    def _mean(self, values: Array) -> tuple[Array, Array]:
        mean = self.floors.copy()
        parts = []
        for row in values.reshape(-1, _PER_PASS):
            power, slopes = self._pass(row)
            mean = mean + power
            parts.append(slopes)
        return mean, np.concatenate(parts, axis=1) / mean[:, None]

    def _pass(self, row: Array) -> tuple[Array, Array]:
        """Return the mean power of a pass in each cycle and its slopes, shapes (c,) and (c, 3)."""
        time, log_peak = row[0], np.clip(row[1], -600, 600)
        width = np.exp(np.clip(row[2], *np.log(_WIDTHS_S)))
        late = self.times_s[:, None] + CYCLE_POINTS * self.cycle_s / 2 - time
        x = late / width
        power = np.exp(log_peak) * (1 + x**2) ** (-self.exponent / 2) * (CYCLE_WEIGHTS / 2)
        falling = self.exponent * x / (1 + x**2) * power
        columns = [falling / width, power, falling * x]
        return power.sum(axis=1), np.stack([c.sum(axis=1) for c in columns], axis=1)


def smoothed(values: Array, length: int) -> Array:
    """Return values under a Hann window of so many points, renormalised at the ends, shape (n,)."""
    window = np.hanning(2 * (length // 2) + 3)[1:-1]
    if len(window) > len(values):
        window = np.ones(1)
    total = np.convolve(np.ones(len(values)), window, "same")
    return np.asarray(np.convolve(values, window, "same") / total)


#: By so much (natural logarithm) widths and peaks of one vehicle differ from station to station.
#: Chosen by judgement: stations are by a half nearer or farther, and the ground is by 4 dB softer.
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
