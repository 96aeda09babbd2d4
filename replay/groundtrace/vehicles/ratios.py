"""The ratio of the powers of two sensors, in which the vehicle's strength does not matter.

Source: the paper, equations (10) to (15). The squared envelopes of two sensors, exponentially
distributed by fading, have the ratio s = p_n / p_l with the density theta / (1 + theta s)^2, (10).
Two things are corrected here:

- under (10), theta is (r_n / r_l)^n, one over the median of s, and not (r_l / r_n)^n;
- (14) has no square in its denominator, sum theta s / (1 + theta s) = K / 2; as printed no term
  exceeds 1/4 and no theta solves it.

The mean of s, which the paper's figure 1 shows beside, has no expectation; it is not offered. The
standard deviations of the logarithm are, over the root of the number of independent samples:
sqrt(3) of maximum likelihood, 2 of the median, pi / sqrt(3) of the geometric mean, sqrt(2) of the
ratio of the means, which is the best while power is stationary, and wrong while it is not alike
at both sensors.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Fix, Note, Presence, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import planar
from ..localizers.base import place_candidate
from ..pipeline.gates import Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import (
    CannotStart,
    Context,
    Frames,
    Input,
    LocationEstimate,
    Stage,
    no_location,
)
from .likelihood import best_node, correlation, lattice, locate, solve, squares
from .presence import AnalyticBand, power
from .stations import row_doubt

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from ..pipeline.stage import Output

    Array = NDArray[np.float64]

Method = Literal["likelihood", "median", "geometric", "means"]
#: Standard deviation of ln theta times the root of the number of independent samples. Source:
#: large-sample theory of each, of powers that are exponential deviates.
DEVIATIONS: dict[Method, float] = {
    "likelihood": 3**0.5,
    "median": 2.0,
    "geometric": float(np.pi / 3**0.5),
    "means": 2**0.5,
}
#: A power that is less above the noise counts as if this part of it were the vehicle's. Chosen by
#: judgement: a fifth of a power scatters by more than itself.
_LEAST_SHARE = 0.2
#: Newton steps at most. Chosen by judgement: far more than it takes.
_NEWTON = 20
#: Of a Newton step in ln theta. Chosen by judgement: it keeps a bad start from overshooting.
_LONGEST = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class RatioEstimate:
    """Ratios of distances to the power n, of one pair of sensors or many.

    Attributes
    ----------
    log_theta
        ln theta, shape (...).
    log_sigma
        Its standard deviation, shape (...).
    count
        How many independent samples that reckons with, shape (...).
    """

    log_theta: Array
    log_sigma: Array
    count: Array

    @property
    def theta(self) -> Array:
        """(r_n / r_l)^n, shape (...)."""
        return np.exp(self.log_theta)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What is known of the noise in the powers of one cycle.

    Attributes
    ----------
    share
        Shape (n,): part of each sensor's power that is the vehicle's, from 0.2 to 1.
    sigma
        Shape (n,): standard deviation of the noise's power over the vehicle's.
    """

    share: Array
    sigma: Array

    @classmethod
    def of(cls, powers: Array, floors: Array, floor_sigmas: Array) -> Noise:
        """Return it for powers with the noise, that of the noise, and its standard deviation."""
        total_power = np.maximum(powers, np.finfo(np.float32).tiny)
        share = np.clip(1 - floors / total_power, _LEAST_SHARE, 1.0)
        return cls(share, floor_sigmas / (share * total_power))

    def variance(self, count: Array) -> Array:
        """Return by how much taking the noise off raises the variance of ln of power, shape (n,).

        From P to P - F the variance P^2 / K counts (P / (P - F))^2 times, and that of F is added.
        """
        return np.asarray((self.share**-2 - 1) / count.mean() + self.sigma**2)


def without_noise(ratio_estimate: RatioEstimate, noise: Noise) -> RatioEstimate:
    """Return ratios of what the vehicle alone gives, from those of all that is heard.

    Parameters
    ----------
    ratio_estimate
        Of n - 1 sensors to a reference, shape (n - 1,).
    noise
        Of the n sensors, the reference first.
    """
    log_share, more = np.log(noise.share), noise.variance(ratio_estimate.count)
    sigma = np.sqrt(ratio_estimate.log_sigma**2 + more[1:] + more[0])
    return RatioEstimate(
        ratio_estimate.log_theta + log_share[0] - log_share[1:], sigma, ratio_estimate.count
    )


def sensor_sigmas(ratio_estimate: RatioEstimate, noise: Noise) -> Array:
    """Return the standard deviations of ln of each sensor's own power, shape (n,).

    Of independent sensors those of :func:`without_noise` are made up of; parameters as there.
    """
    ratio_variance = 0.5 * float(np.mean(ratio_estimate.log_sigma**2))
    return np.sqrt(ratio_variance + noise.variance(ratio_estimate.count))


def log_likelihood(log_theta: Array, log_s: Array) -> Array:
    """Return the logarithm of (11) less the part without theta.

    Parameters
    ----------
    log_theta
        Shape (...).
    log_s
        Shape (..., K).
    """
    terms = log_theta[..., None] - 2 * np.logaddexp(0, log_theta[..., None] + log_s)
    return np.asarray(terms.sum(axis=-1))


def by_likelihood(log_s: Array) -> Array:
    """Return ln theta of the maximum of (11): (14) as corrected, by Newton's method in ln theta.

    Parameters
    ----------
    log_s
        Shape (..., K): ln(p_n / p_l).

    Returns
    -------
    Shape (...).
    """
    log_theta = by_geometric_mean(log_s)
    for _ in range(_NEWTON):
        share = _share(log_theta, log_s)  # theta s / (1 + theta s)
        slope = (share * (1 - share)).mean(axis=-1)
        step = (0.5 - share.mean(axis=-1)) / np.maximum(slope, np.finfo(float).tiny)
        log_theta = log_theta + np.clip(step, -_LONGEST, _LONGEST)
    return log_theta


def by_median(log_s: Array) -> Array:
    """Return ln theta = -ln median(s), (15), shape (...) from (..., K)."""
    return np.asarray(-np.median(log_s, axis=-1))


def by_geometric_mean(log_s: Array) -> Array:
    """Return ln theta = -mean(ln s), closed and nearly as sure as the maximum of (11)."""
    return np.asarray(-log_s.mean(axis=-1))


def by_means(power_n: Array, power_l: Array) -> Array:
    """Return ln theta = ln(mean p_l / mean p_n), shape (...) from two of (..., K)."""
    return np.asarray(np.log(power_l.mean(axis=-1) / power_n.mean(axis=-1)))


def independent(log_theta: Array, log_s: Array) -> Array:
    """Return how many independent samples neighbouring ones are worth.

    K over one plus twice the sum of the autocorrelation of the score of (13), which is bounded, up
    to where it first falls below 0 (C. J. Geyer: Practical Markov chain Monte Carlo, 1992).

    Parameters
    ----------
    log_theta
        Shape (...).
    log_s
        Shape (..., K), evenly in time.

    Returns
    -------
    Shape (...), from 1 to K.
    """
    score = _share(log_theta, log_s) - 0.5
    score = score - score.mean(axis=-1, keepdims=True)
    k = score.shape[-1]
    spectrum = np.abs(np.fft.rfft(score, 2 * k, axis=-1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=-1)[..., :k]
    power = covariance[..., :1]
    autocorrelations = np.divide(covariance, power, out=np.zeros_like(covariance), where=power > 0)
    until = np.cumprod(autocorrelations > 0, axis=-1)
    length = 2 * (autocorrelations * until).sum(axis=-1) - 1
    return np.asarray(np.clip(k / np.maximum(length, 1.0), 1.0, k))


def _share(log_theta: Array, log_s: Array) -> Array:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * (log_theta[..., None] + log_s))))


def estimate(
    power_n: Array, power_l: Array, method: Method = "geometric", correlated: bool = True
) -> RatioEstimate:
    """Estimate theta = (r_n / r_l)^n from instantaneous powers of two sensors.

    Parameters
    ----------
    power_n, power_l
        Shapes that numpy joins to (..., K), above 0: squared envelopes at the same moments.
    method
        See :data:`DEVIATIONS`.
    correlated
        Whether neighbouring samples may be alike, as those of a band are; else K counts.

    Returns
    -------
    Estimates, shape (...).
    """
    tiny = np.finfo(float).tiny
    log_s = np.log(np.maximum(power_n, tiny)) - np.log(np.maximum(power_l, tiny))
    named: dict[Method, Callable[[], Array]] = {
        "likelihood": lambda: by_likelihood(log_s),
        "median": lambda: by_median(log_s),
        "geometric": lambda: by_geometric_mean(log_s),
        "means": lambda: by_means(power_n, power_l),
    }
    log_theta = named[method]()
    count = np.full(log_theta.shape, float(log_s.shape[-1]))
    if correlated:
        count = independent(log_theta, log_s)
    return RatioEstimate(log_theta, DEVIATIONS[method] / np.sqrt(count), count)


#: A cycle's ratios need so much of its samples. Chosen by judgement: ratios want the same time at
#: all stations.
_LEAST_PART = 0.9
#: A place needs so many stations. Source: definition: two ratios for two coordinates.
_LEAST = 3
#: Cycles with a vehicle are remembered for so long [ns]. Chosen by judgement: it bounds memory; a
#: vehicle has passed by then.
_KEEP_NS = 60 * NS_PER_S


@dataclass(frozen=True, slots=True)
class RatioParameters:
    """Parameters of :class:`RatioPlaces`."""

    low_hz: Annotated[float, measured("Hz", "Lower edge of the band.", gt=0)] = 8.0
    high_hz: Annotated[float, measured("Hz", "Upper edge of the band.", gt=0)] = 40.0
    cycle_s: Annotated[float, measured("s", "Length of a working cycle.", ge=0.1, le=10)] = 0.5
    exponent: Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)] = 1.5
    estimator: Annotated[
        Literal["likelihood", "median", "geometric", "means"],
        measured("", "Of the ratios that places are made of; the trace has all."),
    ] = "geometric"
    method: Annotated[
        Literal["squares", "correlation", "solve"],
        measured("", "squares: of logarithms; correlation: with a table, (17); solve: (16)."),
    ] = "squares"
    step_m: Annotated[float, measured("m", "Between the nodes of the table.", gt=0)] = 1.0
    margin_m: Annotated[float, measured("m", "Of the table about the stations.", ge=0)] = 20.0
    residual: Annotated[
        float, gate("1", "Highest root mean square of unexplained ln of distance.", ge=0)
    ] = 0.6
    sigma: Annotated[float, gate("m", "Largest standard deviation.", gt=0)] = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class CycleRatios:
    """Ratios of one cycle.

    Attributes
    ----------
    time_ns
        Middle.
    estimates
        By estimator: ln theta of every station but the first, to the first.
    """

    time_ns: int
    estimates: dict[Method, RatioEstimate]

    def without(self, noise: Noise) -> CycleRatios:
        """Return the ratios of what the vehicle alone gives."""
        cleared = {method: without_noise(e, noise) for method, e in self.estimates.items()}
        return CycleRatios(self.time_ns, cleared)


@dataclass(slots=True)
class HeardCycles:
    """The cycles of one topic in which a vehicle is heard.

    Attributes
    ----------
    names
        Of the channels.
    cycles
        Time [ns] of each, and power, floor and its standard deviation, shape (n_channels, 3).
    """

    names: tuple[str, ...]
    cycles: deque[tuple[int, NDArray[np.float64]]] = field(default_factory=deque)

    def buffer(self, block: CandidateBlock) -> None:
        """Keep the cycles in which any channel hears a vehicle."""
        named = [c.name for c in block.spec.columns]
        columns = [named.index(name) for name in ("power", "floor", "floor_sigma")]
        for time_ns in np.unique(block.time_ns[block.accepted]).tolist():
            rows = np.flatnonzero(block.time_ns == time_ns)
            values = np.full((len(self.names), len(columns)), np.nan)
            values[block.channel[rows]] = block.value[rows][:, columns]
            self.cycles.append((time_ns, values))
        while self.cycles and self.cycles[0][0] < self.cycles[-1][0] - _KEEP_NS:
            self.cycles.popleft()

    def noise(self, time_ns: int, names: Sequence[str]) -> Noise | None:
        """Return the noise at channels in a cycle, None if no vehicle is heard; forget older."""
        while self.cycles and self.cycles[0][0] < time_ns:
            self.cycles.popleft()
        if not self.cycles or self.cycles[0][0] != time_ns:
            return None
        values = self.cycles[0][1][[self.names.index(name) for name in names]]
        return Noise.of(*values.T)


class RatioPlaces(Stage):
    """Where the ratios of powers of the stations of one recorder put a vehicle.

    The first station is the reference. Ratios are estimated of all that is heard; then the noise
    is taken off, as it is known from the cycle's powers.

    Stations of several recorders are not compared: their samples are not of the same moments. Any
    gap starts the analytic signal anew.
    """

    Parameters = RatioParameters
    takes = (
        Input(SignalBlock, SEISMIC_QUANTITIES, hold=False),
        Input(CandidateBlock, of=Presence),
    )
    gives = (Fix,)
    compiles = ("filters",)
    site_lengths = True
    columns = (
        Quantity("heard", "1"),
        Quantity("residual", "1"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )
    gates = (
        Level("residual", "1", "residual", at_least=False),
        Level("sigma", "m", "sigma", at_least=False),
    )
    trace = tuple(
        quantity
        for name in DEVIATIONS
        for quantity in (Quantity(name, "ln"), Quantity(f"{name} sigma", "ln"))
    )

    def __init__(self, parameters: RatioParameters) -> None:
        self.parameters = parameters
        self._doubt: str | None = None  # None before any start

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run of samples where three or more stations of the stream have a place."""
        self._context, stream = context, context.stream
        rows, sensors = context.geometry.placed([c.name for c in stream.channels])
        if len(np.unique(sensors, axis=0)) < _LEAST:
            raise CannotStart
        self._names = tuple(rows)
        index = {c.name: i for i, c in enumerate(stream.channels)}
        self._columns = [index[name] for name in self._names]
        self._cycles = HeardCycles(context.source.channels)
        if self._doubt is None:
            self._doubt = row_doubt(self._names, sensors)
        self.begin(stream.rate_hz, sensors)
        return tuple(f"{name}/{self._names[0]}" for name in self._names[1:])

    def process(self, item: SignalBlock | CandidateBlock) -> Iterator[Output]:
        """Take samples, and the cycles in which there is a vehicle: places and ratios are there."""
        if isinstance(item, CandidateBlock):
            self._cycles.buffer(item)
            return
        samples = planar(item.select(self._columns))
        for ratios in self.add(item.sample_times(), samples):
            noise = self._cycles.noise(ratios.time_ns, self._names)
            if noise is None:
                continue
            columns = [
                column
                for ratio_estimate in ratios.without(noise).estimates.values()
                for column in (ratio_estimate.log_theta, ratio_estimate.log_sigma)
            ]
            value = np.stack(columns, axis=-1).astype(np.float32)[None]
            yield Frames(np.array([ratios.time_ns], np.int64), value)
            self._latest_estimate = ratios.time_ns, self.locate(ratios, noise)
            yield place_candidate(*self._latest_estimate)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts, and once what to doubt of it."""
        if not block.accepted[0]:
            return
        context, (time_ns, location) = self._context, self._latest_estimate
        if self._doubt:
            yield Note(time_ns, self._doubt, "WARN", context.stage)
            self._doubt = ""
        yield location.fix(time_ns, f"{context.plugin} {self.parameters.method}", context.stage)

    def begin(self, rate_hz: float, sensors: Array) -> None:
        """Begin a run of samples of stations at places, shape (n, 2) [m]."""
        p = self.parameters
        self._sensors = sensors
        self._least = _LEAST_PART * p.cycle_s * rate_hz
        low, high = sensors.min(axis=0) - p.margin_m, sensors.max(axis=0) + p.margin_m
        self._low, self._high = low, high
        self._nodes = lattice(tuple(low.tolist()), tuple(high.tolist()), p.step_m)
        self._band = AnalyticBand(rate_hz, p.low_hz, p.high_hz)
        self._cycle_ns = round(p.cycle_s * NS_PER_S)
        self._times = np.empty(0, np.int64)
        self._powers = np.empty((len(sensors), 0))

    def add(self, times: NDArray[np.int64], x: Array) -> Iterator[CycleRatios]:
        """Take samples of the stations, shapes (n_samples,) and (n, n_samples)."""
        band_times, analytic = self._band(times, x)
        self._times = np.concatenate([self._times, band_times])
        self._powers = np.concatenate([self._powers, power(analytic)], axis=1)
        number = self._times // self._cycle_ns
        edges = np.flatnonzero(np.diff(number)) + 1
        starts = [0, *edges[:-1].tolist()]
        for a, b in zip(starts, edges.tolist(), strict=False):
            if b - a >= self._least and (self._powers[:, a:b] > 0).all():
                middle_ns = int(number[a]) * self._cycle_ns + self._cycle_ns // 2
                yield CycleRatios(middle_ns, self._estimates(self._powers[:, a:b]))
        done = int(edges[-1]) if len(edges) else 0
        self._times, self._powers = self._times[done:], self._powers[:, done:]

    def locate(self, ratios: CycleRatios, noise: Noise) -> LocationEstimate:
        """Return the place that suits the ratios of a cycle, of all that is heard."""
        p = self.parameters
        ratio_estimate = ratios.estimates[p.estimator]
        log_theta, sigmas = (
            without_noise(ratio_estimate, noise).log_theta,
            sensor_sigmas(ratio_estimate, noise),
        )
        location = locate(self._nodes, self._sensors, log_theta, sigmas, p.exponent)
        if p.method != "squares":
            location = self._otherwise(log_theta, sigmas, location)
        inside = (self._low < (location.x, location.y)) & ((location.x, location.y) < self._high)
        return location if inside.all() else no_location(len(self._sensors))

    def _otherwise(
        self, log_theta: Array, sigmas: Array, location: LocationEstimate
    ) -> LocationEstimate:
        """Return the place by (17) or (16), as sure as that of least squares."""
        p = self.parameters
        if p.method == "correlation":
            metric = correlation(self._nodes, self._sensors, log_theta, p.exponent)
            spots = self._nodes[[best_node(metric)]]
        else:
            spots = solve(self._sensors[:3], log_theta[:2], p.exponent)
        if not len(spots):
            return no_location(len(self._sensors))
        misfit = squares(spots, self._sensors, log_theta, p.exponent, sigmas)
        best = best_node(-misfit)  # of two mirrored places the one that suits the others
        (x, y), residual = spots[best].tolist(), float(np.sqrt(misfit[best]))
        return LocationEstimate(x, y, location.covariance, residual, len(self._sensors))

    def _estimates(self, powers: Array) -> dict[Method, RatioEstimate]:
        return {method: estimate(powers[1:], powers[:1], method) for method in DEVIATIONS}
