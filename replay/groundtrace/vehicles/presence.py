"""Presence of a vehicle, per cycle of signal: power that lasts, told apart from blows.

The power in a band is measured per channel and working cycle (the paper, equation (6)). Cycles lie
on multiples of their length on the recording's clock, so that those of several recorders begin
together, whenever each was switched on. Power is averaged over blocks of a tenth of a second, whose
running median over seven of them knows nothing of what is shorter than half of that: footsteps and
doors that slam. A block counts as eight times the median at most.

The noise floor of powers is a low quantile of the last minutes. Vehicles pass in less time than is
quiet, so the low powers of a few minutes are the noise's (after R. Martin: Noise power spectral
density estimation based on optimal smoothing and minimum statistics, IEEE Trans. Speech Audio
Process. 9, 2001, with a quantile in the minimum's place).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy import special

from groundtrace_codecs.events import Presence, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import (
    StreamingFilter,
    WeightedSums,
    bandpass,
    corner,
    forgotten_s,
    planar,
)
from ..dsp.robust import medians
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import (
    BRIDGE_NS,
    Context,
    Frames,
    Input,
    Measured,
    Memory,
    PresenceIntervals,
    Stage,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock

    from ..pipeline.stage import Output

    Array = NDArray[np.float64]

#: Standard deviation of a power over its mean, from the paper's experiments. Source: NSTU, its
#: experiments.
RELATIVE_SIGMA = 1 / 3
#: A cycle counts from this part of its samples on, at the ends of a run. Chosen by judgement: half
#: of a cycle has a power that scatters by 1.4 times as much.
_LEAST_PART = 0.5


#: A block [ns], and how many a running median takes. Chosen by judgement: a footstep shakes for 0.1
#: to 0.2 s and a door for 0.3 s, a vehicle of 20 m/s at 5 m for half a second and more.
BLOCK_NS, _MEDIAN = NS_PER_S // 10, 7
#: Order of the band-pass. Chosen by judgement: steep enough that wind below it counts little.
_ORDER = 4
#: Over its median a block counts so much at most. Chosen by trial: with 3, the courses of 12
#: vehicles that fade over 0.5 m err by 2.45 m at 90 %, with 8 by 1.76 m, with no limit by 1.84 m.
_LIMIT = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class CyclePowers:
    """Powers of whole cycles.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: middle of each cycle.
    power
        Shape (n_channels, n): mean squares [unit^2], (6), of blocks limited to eight times the
        running median.
    steady
        Shape (n_channels, n): mean of that running median [unit^2].
    freedom
        Shape (n_channels, n): degrees of freedom of each, 2 B T: the variance of a power P of
        Gaussian noise is 2 P^2 / freedom.
    """

    time_ns: NDArray[np.int64]
    power: Array
    steady: Array
    freedom: Array


def degrees_of_freedom(samples: Array) -> Array:
    """Return the effective degrees of freedom of the mean square of each row.

    2 B T with B the bandwidth (int S)^2 / int S^2 of the spectrum S. Of n even lines of noise the
    periodogram has sum I^2 / (sum I)^2 = 2 / (n + 1) in the mean, so that the inverse of what is
    returned has no bias.

    Parameters
    ----------
    samples
        Shape (n_channels, n), n at least 4.

    Returns
    -------
    Shape (n_channels,), at least 1 and at most n; 2 for a single line.
    """
    periodogram = np.abs(np.fft.rfft(samples, axis=1)) ** 2
    total, square = periodogram.sum(axis=1), (periodogram**2).sum(axis=1)
    n = samples.shape[1]
    ratio = np.divide(total**2, square, out=np.full(len(total), float(n)), where=square > 0)
    return np.asarray(np.clip(4 * ratio - 2, 1.0, n))


class CyclePower:
    """Filters samples, and cuts them into cycles, each told three blocks after its end.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    channels
        Number of channels.
    cycle_s
        Length of a cycle [s], 0.1 at least.
    low_hz, high_hz
        Band [Hz]; 0 leaves an edge out, as does an upper one beyond the rate's reach.
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        cycle_s: float = 1.0,
        low_hz: float = 5.0,
        high_hz: float = 40.0,
    ) -> None:
        self.cycle_ns = round(cycle_s * NS_PER_S)
        self._least = max(4, round(_LEAST_PART * cycle_s * rate_hz))
        self._least_block = max(1, round(_LEAST_PART * rate_hz * BLOCK_NS / NS_PER_S))
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=_ORDER))
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((channels, 0))
        self._next: int | None = None

    def add(self, times: NDArray[np.int64], x: Array) -> CyclePowers:
        """Take samples, shapes (n,) and (n_channels, n); return the cycles they complete."""
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, self._filter(x)], axis=1)
        return self._cut(open_end=True)

    def flush(self) -> CyclePowers:
        """Return the last cycles, of the very last half at least; then start anew."""
        cycle_powers = self._cut(open_end=False)
        self._filter.zi = None
        self._times, self._samples, self._next = self._times[:0], self._samples[:, :0], None
        return cycle_powers

    def _cut(self, open_end: bool) -> CyclePowers:
        """Return the cycles that are complete, or all; keep what later ones need."""
        if not len(self._times):
            return self._powers([], [])
        if self._next is None:
            self._next = int(self._times[0] // self.cycle_ns)
        around_ns = _MEDIAN // 2 * BLOCK_NS
        last_ns = int(self._times[-1]) if open_end else 2**62
        stop = int((last_ns - around_ns) // self.cycle_ns)  # the first one that is not complete
        stop = min(stop, int(self._times[-1] // self.cycle_ns) + 1)
        numbers = list(range(self._next, stop))
        starts_ns = np.array([*numbers, stop], np.int64) * self.cycle_ns
        edges = np.searchsorted(self._times, starts_ns)
        spans = [slice(a, b) for a, b in pairwise(edges.tolist())]
        pairs = zip(numbers, spans, strict=True)
        cycles = [(number, s) for number, s in pairs if s.stop - s.start >= self._least]
        cycle_powers = self._powers([n for n, _ in cycles], [s for _, s in cycles])
        self._next = max(self._next, stop)
        first_ns = (self._next * self.cycle_ns - around_ns) // BLOCK_NS * BLOCK_NS
        done = int(np.searchsorted(self._times, first_ns))
        self._times, self._samples = self._times[done:], self._samples[:, done:]
        return cycle_powers

    def _powers(self, numbers: list[int], spans: list[slice]) -> CyclePowers:
        shape = (len(self._samples), len(numbers))
        power, steady, freedom = np.empty(shape), np.empty(shape), np.empty(shape)
        if numbers:
            middles, weights, means, typical = self._blocks()
            limited = np.minimum(means, _LIMIT * typical) * weights
        for column, (number, span) in enumerate(zip(numbers, spans, strict=True)):
            inside = middles // self.cycle_ns == number
            power[:, column] = limited[:, inside].sum(axis=1) / weights[inside].sum()
            steady[:, column] = typical[:, inside].mean(axis=1)
            freedom[:, column] = degrees_of_freedom(self._samples[:, span])
        times = np.array(numbers, np.int64) * self.cycle_ns + self.cycle_ns // 2
        return CyclePowers(times, power, steady, freedom)

    def _blocks(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Return the middles of blocks [ns], their samples, mean squares and running medians."""
        number = self._times // BLOCK_NS
        starts = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
        counts = np.diff(np.append(starts, len(number)))
        sums = np.add.reduceat(self._samples**2, starts, axis=1)
        full = counts >= min(self._least_block, counts.max())
        means = sums[:, full] / counts[full]
        around = ((0, 0), (_MEDIAN // 2, _MEDIAN // 2))
        padded = np.pad(means, around, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, _MEDIAN, axis=1)
        middles = number[starts[full]] * BLOCK_NS + BLOCK_NS // 2
        return middles, counts[full].astype(np.float64), means, medians(windows)


@dataclass(frozen=True, slots=True, eq=False)
class Floors:
    """The floor at each cycle.

    Attributes
    ----------
    power, sigma
        Shape (n_channels, n): mean power of the noise and its standard deviation [unit^2].
    """

    power: Array
    sigma: Array


class NoiseFloor:
    """Running low quantile of the last cycles, made up to the mean.

    Powers of noise are gamma distributed with half their degrees of freedom as shape; the quantile
    of that law over its mean is what the quantile found is divided by. The cycle itself counts in.

    Parameters
    ----------
    cycles
        How many are looked back on; the quantile's part of them should be quiet.
    quantile
        From 0 to 1: where a quarter of the cycles is quiet at least, below that.
    least
        Until there are so many, the floor's standard deviation is as large as itself at least.
    """

    def __init__(self, cycles: int = 120, quantile: float = 0.2, least: int = 5) -> None:
        self.cycles, self.quantile, self.least = cycles, quantile, least
        self._power: Array | None = None
        self._freedom: Array | None = None

    def __call__(self, power: Array, freedom: Array) -> Floors:
        """Take powers and their degrees of freedom, shapes (n_channels, n); return the floors."""
        if self._power is None or self._freedom is None:
            self._power, self._freedom = power[:, :0], freedom[:, :0]
        old = self._power.shape[1]
        powers = np.concatenate([self._power, power], axis=1)
        freedoms = np.concatenate([self._freedom, freedom], axis=1)
        levels = np.empty((2, *power.shape))
        for column in range(power.shape[1]):
            end = old + column + 1
            span = slice(max(0, end - self.cycles), end)
            levels[:, :, column] = self._level(powers[:, span], freedoms[:, span])
        self._power, self._freedom = powers[:, -self.cycles :], freedoms[:, -self.cycles :]
        return Floors(levels[0], levels[1])

    def _level(self, powers: Array, freedoms: Array) -> tuple[Array, Array]:
        n = powers.shape[1]
        low = np.quantile(powers, self.quantile, axis=1)
        # a pass concentrates on few lines at times: the freedom of the quiet half is the noise's
        quiet = powers <= np.median(powers, axis=1, keepdims=True)
        shape = 0.5 / np.array([np.mean(1 / f[q]) for f, q in zip(freedoms, quiet, strict=True)])
        expected = special.gammaincinv(shape, self.quantile) / shape
        floor = low / expected
        x = expected * shape
        density = shape * np.exp((shape - 1) * np.log(x) - x - special.gammaln(shape))
        spread = np.sqrt(self.quantile * (1 - self.quantile) / n) / (density * expected)
        return floor, floor * np.maximum(spread, 1.0 if n < self.least else 0.0)


#: Length of a window-designed filter times its transition's width over the rate (Hamming window).
#: Source: E. C. Ifeachor, B. W. Jervis, Digital signal processing, filters by windows.
_HAMMING = 3.3
#: The transition's width, as a part of the lower edge and of the band: what lies at negative
#: frequencies, twice the lower edge away, is then gone. Chosen by judgement: narrower ones take
#: longer filters.
_TRANSITION = 0.5


class AnalyticBand:
    """A complex band-pass of linear phase: it lets the positive frequencies of a band through.

    The power of a signal in the band is half the mean square of its analytic signal. Samples whose
    surroundings are not complete, at both ends of a run, are left out.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    low_hz, high_hz
        The band [Hz], above 0; the upper edge comes down to what the rate allows.
    """

    def __init__(self, rate_hz: float, low_hz: float, high_hz: float) -> None:
        high = corner(high_hz, rate_hz)
        width = high - low_hz
        transition = _TRANSITION * min(low_hz, width)
        half = int(np.ceil(_HAMMING * rate_hz / transition / 2))
        late = np.arange(-half, half + 1)
        base = np.sinc(width / rate_hz * late) * np.hamming(len(late))
        turn = 2j * np.pi * (low_hz + width / 2) / rate_hz * late
        self.kernel: NDArray[np.complex128] = 2 * base / base.sum() * np.exp(turn)
        self.delay = half
        self._sums = WeightedSums(self.kernel.real), WeightedSums(self.kernel.imag)
        self._times: NDArray[np.int64] = np.empty(0, np.int64)
        self._skip = 2 * half

    def __call__(
        self, times: NDArray[np.int64], x: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
        """Take times (n,) and signals (n_channels, n) [unit]; offsets need not be taken off.

        Returns
        -------
        Times and analytic signals of the samples that are complete, shapes (m,) and
        (n_channels, m).
        """
        real, imaginary = (sums(x) for sums in self._sums)
        y = real + 1j * imaginary
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        y = np.asarray(y[:, skipped:])
        self._times = np.concatenate([self._times, times])
        done = slice(self.delay, self.delay + y.shape[1])
        complete_times = self._times[done]
        self._times = self._times[y.shape[1] :]
        return complete_times, y


def power(analytic: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the instantaneous power, half the squared envelope, any shape [unit^2]."""
    return np.asarray(0.5 * (analytic.real**2 + analytic.imag**2))


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of windows of signal.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: end of each window.
    flatness
        Shape (n_channels, n): geometric over arithmetic mean of the spectrum in the band, from 0
        for a line to 1 for white noise.
    centroid_hz
        Shape (n_channels, n): mean frequency of power in the band [Hz].
    """

    time_ns: NDArray[np.int64]
    flatness: Array
    centroid_hz: Array

    def after(self, time_ns: int) -> Features:
        """Return the windows that end later."""
        late = self.time_ns > time_ns
        return Features(self.time_ns[late], self.flatness[:, late], self.centroid_hz[:, late])


def joined(one: Features, other: Features) -> Features:
    """Return the windows of both, in their order."""
    return Features(
        np.concatenate([one.time_ns, other.time_ns]),
        np.concatenate([one.flatness, other.flatness], axis=1),
        np.concatenate([one.centroid_hz, other.centroid_hz], axis=1),
    )


def spectral_shape(
    samples: Array, rate_hz: float, band_hz: tuple[float, float]
) -> tuple[Array, Array]:
    """Return flatness and centroid [Hz] of rows in a band, shapes (n_channels,).

    Parameters
    ----------
    samples
        Shape (n_channels, n).
    rate_hz
        Sampling rate [Hz].
    band_hz
        Lower and upper edge [Hz].

    Notes
    -----
    Spectra are means over half overlapping Hann windows of a quarter of the samples (Welch), else
    the flatness of noise would be that of its periodogram, 0.56.
    """
    length = max(8, samples.shape[1] // 4)
    starts = range(0, samples.shape[1] - length + 1, length // 2)
    window = np.hanning(length + 2)[1:-1]
    parts = np.stack([samples[:, a : a + length] for a in starts]) * window
    spectrum = (np.abs(np.fft.rfft(parts, axis=2)) ** 2).mean(axis=0)
    frequency = np.fft.rfftfreq(length, 1 / rate_hz)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    power = np.maximum(spectrum[:, inside], np.finfo(float).tiny)
    flatness = np.exp(np.log(power).mean(axis=1)) / power.mean(axis=1)
    return flatness, power @ frequency[inside] / power.sum(axis=1)


class PresenceFeatures:
    """Features of windows that end with every cycle, on multiples of its length.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    channels
        Number of channels.
    cycle_s, window_s
        Lengths of a cycle and of the window that ends with it [s]; until a window is full, there
        are no features.
    low_hz, high_hz
        Band [Hz].
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        cycle_s: float = 1.0,
        window_s: float = 4.0,
        low_hz: float = 5.0,
        high_hz: float = 40.0,
    ) -> None:
        self.rate_hz, self.band_hz = rate_hz, (low_hz, high_hz)
        self.cycle_ns = round(cycle_s * NS_PER_S)
        self.window = round(window_s * rate_hz)
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=_ORDER))
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((channels, 0))

    def add(self, times: NDArray[np.int64], x: Array) -> Features:
        """Take samples, shapes (n,) and (n_channels, n); return the features they complete."""
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, self._filter(x)], axis=1)
        number = self._times // self.cycle_ns
        ends = np.flatnonzero(np.diff(number)) + 1
        full = ends[ends >= self.window]
        windows = [self._samples[:, e - self.window : e] for e in full]
        features = self._features(number[full] * self.cycle_ns, windows)
        # the next cycle ends at the next sample at the earliest: no more than a window is needed
        drop = max(0, len(self._times) - self.window)
        self._times, self._samples = self._times[drop:], self._samples[:, drop:]
        return features

    def _features(self, times: NDArray[np.int64], windows: list[Array]) -> Features:
        rows = np.empty((2, len(self._samples), len(windows)))
        for column, window in enumerate(windows):
            rows[:, :, column] = spectral_shape(window, self.rate_hz, self.band_hz)
        return Features(times, *rows)


#: What a candidate tells. Source: definition.
_COLUMNS = 7
#: Power over the floor is told within this [dB]: a channel that is off has neither. Chosen by
#: judgement: over what 16 bits hold, 96 dB.
_RANGE_DB = 100.0


@dataclass(frozen=True, slots=True)
class PresenceParameters:
    """Parameters of :class:`VehiclePresence`."""

    low_hz: Annotated[float, measured("Hz", "Lower edge of the band.", gt=0)] = 5.0
    high_hz: Annotated[float, measured("Hz", "Upper edge of the band.", gt=0)] = 40.0
    cycle_s: Annotated[float, measured("s", "Length of a working cycle.", ge=0.1, le=10)] = 0.5
    window_s: Annotated[float, measured("s", "Looked at for the shape.", ge=3, le=30)] = 4.0
    floor_s: Annotated[float, measured("s", "Looked back on for the noise.", ge=10)] = 120.0
    over_floor: Annotated[float, gate("dB", "Lowest running median over the noise.")] = 5.0
    flatness: Annotated[float, gate("1", "Highest spectral flatness; noise is near 1.")] = 0.92
    centroid: Annotated[float, gate("Hz", "Lowest mean frequency; wind is lower.", ge=0)] = 8.0


@dataclass(slots=True)
class _State:
    cycles: CyclePower
    floor: NoiseFloor
    features: PresenceFeatures
    shapes: Features


class VehiclePresence(Stage):
    """A vehicle is power that lasts: its running median is over the noise.

    Every channel and cycle is a candidate, told 0.3 s after its end. Power, running median and
    floor are kept beside what the gates look at: the stages after this one work on them.
    """

    Parameters = PresenceParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Presence,)
    compiles = ("filters",)
    columns = (
        Quantity("over_floor", "dB"),
        Quantity("power", "unit^2"),
        Quantity("floor", "unit^2"),
        Quantity("floor_sigma", "unit^2"),
        Quantity("steady", "unit^2"),
        Quantity("flatness", "1"),
        Quantity("centroid", "Hz"),
    )
    trace = (Quantity("over_floor", "dB"),)
    gates = (
        Level("over_floor", "dB", "over_floor"),
        Level("flatness", "1", "flatness", at_least=False),
        Level("centroid", "Hz", "centroid"),
    )

    def __init__(self, parameters: PresenceParameters) -> None:
        self.parameters = parameters
        self.spans = PresenceIntervals()

    @property
    def memory(self) -> Memory:
        """That of the filters, and of the floor or the shape; and what ends a span."""
        p = self.parameters
        filtered_s = forgotten_s(p.low_hz, p.high_hz, _ORDER)
        held_s = max(p.floor_s, p.window_s) + 2 * p.cycle_s
        told_s = p.cycle_s + (_MEDIAN // 2 + 1) * BLOCK_NS / NS_PER_S
        return Memory(filtered_s + held_s, told_s + p.cycle_s + BRIDGE_NS / NS_PER_S)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is heard on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        self.state = _State(
            CyclePower(rate, n, p.cycle_s, p.low_hz, p.high_hz),
            NoiseFloor(round(p.floor_s / p.cycle_s)),
            PresenceFeatures(rate, n, p.cycle_s, p.window_s, p.low_hz, p.high_hz),
            Features(np.empty(0, np.int64), np.empty((n, 0)), np.empty((n, 0))),
        )
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Return the cycles that the block completes."""
        times, x = block.sample_times(), planar(block)
        shapes = self.state.features.add(times, x)
        self.state.shapes = joined(self.state.shapes, shapes)
        return self._measured(self.state.cycles.add(times, x))

    def flush(self) -> Iterator[Output]:
        """Yield the last cycle, if there is half of it; its shape stays unknown. End all spans."""
        yield from self._measured(self.state.cycles.flush())
        yield from self.spans.flush()

    def decided(self, block: CandidateBlock) -> Iterator[Presence]:
        """Yield the spans that have ended."""
        return self.spans.take(block)

    def _measured(self, cycle_powers: CyclePowers) -> Measured:
        channels, cycles = cycle_powers.power.shape
        if not cycles:
            empty = np.empty((0, channels, 1), np.float32)
            return Measured(Candidates.empty(_COLUMNS), Frames(np.empty(0, np.int64), empty))
        floors = self.state.floor(cycle_powers.power, cycle_powers.freedom)
        floor = floors.power
        columns = np.full((_COLUMNS, channels, cycles), np.nan)
        over_db = over_floor_db(cycle_powers.steady, floor)
        columns[:5] = over_db, cycle_powers.power, floor, floors.sigma, cycle_powers.steady
        half_ns = self.state.cycles.cycle_ns // 2
        shapes = self.state.shapes
        _, mine, theirs = np.intersect1d(
            cycle_powers.time_ns + half_ns, shapes.time_ns, return_indices=True
        )
        columns[5:, :, mine] = np.array([shapes.flatness, shapes.centroid_hz])[..., theirs]
        self.state.shapes = shapes.after(int(cycle_powers.time_ns[-1]) + half_ns)
        values = columns.transpose(2, 1, 0).astype(np.float32)
        candidates = Candidates(
            np.repeat(cycle_powers.time_ns, channels),
            np.tile(np.arange(channels, dtype=np.int32), cycles),
            values.reshape(-1, _COLUMNS),
        )
        return Measured(candidates, Frames(cycle_powers.time_ns - half_ns, values[..., :1]))


def over_floor_db(power: Array, floor: Array) -> Array:
    """Return power over the floor [dB], any shape; 0 where there is no floor."""
    valid = floor > 0
    ratio = np.divide(power, floor, out=np.ones_like(power), where=valid)
    least = 10 ** (-_RANGE_DB / 10)
    return np.asarray(np.clip(10 * np.log10(np.maximum(ratio, least)), -_RANGE_DB, _RANGE_DB))
