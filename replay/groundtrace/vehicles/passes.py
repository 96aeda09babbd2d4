"""Passes of vehicles by one station: when, how slowly, how strongly, also several at once.

A vehicle that passes at a distance d with a speed v has the power mu / ((v (t - t0))^2 + d^2)^(n/2)
by the paper's (4). One station tells only the moment t0, the power peak mu / d^n and the half
width d / v of

    P(t) = peak / (1 + ((t - t0) / width)^2)^(n/2) + noise,

so that speed comes from several stations, see :mod:`groundtrace.vehicles.roads`. Vehicles that
overlap add up: their laws are fitted jointly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from .cycles import RELATIVE_SIGMA
from .medium import EXPONENT
from .scoring import Fitted, fit_powers, usable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)
#: Widths are kept between these [s]; a narrower pass is within one cycle anyhow.
_WIDTHS_S = (0.05, 300.0)
#: Parameters of a pass, in the order of a fit: t0, ln peak, ln width.
_PER_PASS = 3
#: Most passes in one event.
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
        needed = self.relative_sigma**2 * (_PER_PASS * np.log(event.samples) + 6)
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
        late = self.times_s[:, None] + _POINTS * self.cycle_s / 2 - time
        x = late / width
        power = np.exp(log_peak) * (1 + x**2) ** (-self.exponent / 2) * (_WEIGHTS / 2)
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
