"""Places of vehicles from the ratios of instantaneous powers, cycle by cycle."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Fix, Note, Presence, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..detector import Frames
from ..detectors.filters import planar
from ..gates import Level
from ..localizers.api import place_candidate
from ..localizers.location import Location, nowhere
from ..parameters import gate, measured
from ..stage import CannotStart, Context, Input, Stage
from .analytic import AnalyticBand, power
from .api import row_doubt
from .positions import correlation, lattice, locate, solve, squares
from .ratios import DEVIATIONS, Noise, estimate, sensor_sigmas, without_noise

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from ..stage import Output
    from .ratios import Method, RatioEstimate

    Array = NDArray[np.float64]

#: A cycle's ratios need so much of its samples.
_LEAST_PART = 0.9
#: A place needs so many stations.
_LEAST = 3
#: Cycles with a vehicle are remembered for so long [ns].
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

    def remember(self, block: CandidateBlock) -> None:
        """Keep the cycles in which any channel hears a vehicle."""
        named = [c.name for c in block.spec.columns]
        columns = [named.index(name) for name in ("power", "floor", "floor_sigma")]
        for time_ns in np.unique(block.time_ns[block.accepted]).tolist():
            rows = np.flatnonzero(block.time_ns == time_ns)
            known = np.full((len(self.names), len(columns)), np.nan)
            known[block.channel[rows]] = block.value[rows][:, columns]
            self.cycles.append((time_ns, known))
        while self.cycles and self.cycles[0][0] < self.cycles[-1][0] - _KEEP_NS:
            self.cycles.popleft()

    def noise(self, time_ns: int, names: Sequence[str]) -> Noise | None:
        """Return the noise at channels in a cycle, None if no vehicle is heard; forget older."""
        while self.cycles and self.cycles[0][0] < time_ns:
            self.cycles.popleft()
        if not self.cycles or self.cycles[0][0] != time_ns:
            return None
        known = self.cycles[0][1][[self.names.index(name) for name in names]]
        return Noise.of(*known.T)


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
        self._heard = HeardCycles(context.source.channels)
        if self._doubt is None:
            self._doubt = row_doubt(self._names, sensors)
        self.begin(stream.rate_hz, sensors)
        return tuple(f"{name}/{self._names[0]}" for name in self._names[1:])

    def process(self, item: SignalBlock | CandidateBlock) -> Iterator[Output]:
        """Take samples, and the cycles in which there is a vehicle: places and ratios are there."""
        if isinstance(item, CandidateBlock):
            self._heard.remember(item)
            return
        samples = planar(item.select(self._columns))
        for ratios in self.add(item.sample_times(), samples):
            noise = self._heard.noise(ratios.time_ns, self._names)
            if noise is None:
                continue
            columns = [
                column
                for found in ratios.without(noise).estimates.values()
                for column in (found.log_theta, found.log_sigma)
            ]
            value = np.stack(columns, axis=-1).astype(np.float32)[None]
            yield Frames(np.array([ratios.time_ns], np.int64), value)
            self._found = ratios.time_ns, self.locate(ratios, noise)
            yield place_candidate(*self._found)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts, and once what to doubt of it."""
        if not block.accepted[0]:
            return
        context, (time_ns, location) = self._context, self._found
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
        told, analytic = self._band(times, x)
        self._times = np.concatenate([self._times, told])
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

    def locate(self, ratios: CycleRatios, noise: Noise) -> Location:
        """Return the place that suits the ratios of a cycle, of all that is heard."""
        p = self.parameters
        found = ratios.estimates[p.estimator]
        log_theta, sigmas = without_noise(found, noise).log_theta, sensor_sigmas(found, noise)
        place = locate(self._nodes, self._sensors, log_theta, sigmas, p.exponent)
        if p.method != "squares":
            place = self._otherwise(log_theta, sigmas, place)
        inside = (self._low < (place.x, place.y)) & ((place.x, place.y) < self._high)
        return place if inside.all() else nowhere(len(self._sensors))

    def _otherwise(self, log_theta: Array, sigmas: Array, place: Location) -> Location:
        """Return the place by (17) or (16), as sure as that of least squares."""
        p = self.parameters
        if p.method == "correlation":
            metric = correlation(self._nodes, self._sensors, log_theta, p.exponent)
            spots = self._nodes[[int(metric.argmax())]]
        else:
            spots = solve(self._sensors[:3], log_theta[:2], p.exponent)
        if not len(spots):
            return nowhere(len(self._sensors))
        misfit = squares(spots, self._sensors, log_theta, p.exponent, sigmas)
        best = int(misfit.argmin())  # of two mirrored places the one that suits the others
        (x, y), residual = spots[best].tolist(), float(np.sqrt(misfit[best]))
        return Location(x, y, place.covariance, residual, len(self._sensors))

    def _estimates(self, powers: Array) -> dict[Method, RatioEstimate]:
        return {method: estimate(powers[1:], powers[:1], method) for method in DEVIATIONS}
