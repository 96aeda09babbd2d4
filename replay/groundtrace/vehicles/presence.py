"""Presence of a vehicle, per window of signal, told apart from footsteps and impacts.

A vehicle shakes the ground without a break: Gaussian noise of a band, whose kurtosis is that of a
normal law and whose envelope has no line. Footsteps are impulses at a cadence.

The power in a band is measured per channel and working cycle (the paper, equation (6)). Cycles lie
on multiples of their length on the recording's clock, so that those of several recorders begin
together, whenever each was switched on.

The noise floor of powers is a low quantile of the last minutes. Vehicles pass in less time than is
quiet, so the low powers of a few minutes are the noise's (after R. Martin: Noise power spectral
density estimation based on optimal smoothing and minimum statistics, IEEE Trans. Speech Audio
Process. 9, 2001, with a quantile in the minimum's place).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy import signal, special

from groundtrace_codecs.events import Presence, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import StreamingFilter, bandpass, corner, planar
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Frames, Input, Measured, PresenceIntervals, Stage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock

    from ..pipeline.gates import GateState
    from ..pipeline.stage import Output

    Array = NDArray[np.float64]

#: Standard deviation of a power over its mean, from the paper's experiments. Source: NSTU, its
#: experiments.
RELATIVE_SIGMA = 1 / 3
#: A cycle counts from this part of its samples on, at the ends of a run. Chosen by judgement: half
#: of a cycle has a power that scatters by 1.4 times as much.
_LEAST_PART = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class CyclePowers:
    """Powers of whole cycles.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: middle of each cycle.
    power
        Shape (n_channels, n): mean squares [unit^2], (6).
    freedom
        Shape (n_channels, n): degrees of freedom of each, 2 B T: the variance of a power P of
        Gaussian noise is 2 P^2 / freedom.
    """

    time_ns: NDArray[np.int64]
    power: Array
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
    """Filters samples, and cuts them into cycles.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    channels
        Number of channels.
    cycle_s
        Length of a cycle [s].
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
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=4))
        self._times = np.empty(0, np.int64)
        self._samples = np.empty((channels, 0))

    def add(self, times: NDArray[np.int64], x: Array) -> CyclePowers:
        """Take samples, shapes (n,) and (n_channels, n); return the cycles they complete."""
        self._times = np.concatenate([self._times, times])
        self._samples = np.concatenate([self._samples, self._filter(x)], axis=1)
        return self._cut(open_end=True)

    def flush(self) -> CyclePowers:
        """Return the last cycle, if there is half of it; then start anew."""
        found = self._cut(open_end=False)
        self._filter.zi = None
        self._times, self._samples = self._times[:0], self._samples[:, :0]
        return found

    def _cut(self, open_end: bool) -> CyclePowers:
        number = self._times // self.cycle_ns
        edges = np.flatnonzero(np.diff(number)) + 1
        if not open_end and len(number):
            edges = np.append(edges, len(number))
        starts = np.concatenate([[0], edges[:-1]]).astype(np.intp)
        spans = [(a, b) for a, b in zip(starts, edges, strict=False) if b - a >= self._least]
        middles = np.array([number[a] for a, _ in spans], np.int64) * self.cycle_ns
        rows = [self._samples[:, a:b] for a, b in spans]
        shape = (len(self._samples), len(rows))
        power, freedom = np.empty(shape), np.empty(shape)
        for column, row in enumerate(rows):
            power[:, column] = np.mean(row**2, axis=1)
            freedom[:, column] = degrees_of_freedom(row)
        done = int(edges[-1]) if len(edges) else 0
        self._times, self._samples = self._times[done:], self._samples[:, done:]
        return CyclePowers(middles + self.cycle_ns // 2, power, freedom)


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
        found = np.empty((2, *power.shape))
        for column in range(power.shape[1]):
            end = old + column + 1
            span = slice(max(0, end - self.cycles), end)
            found[:, :, column] = self._level(powers[:, span], freedoms[:, span])
        self._power, self._freedom = powers[:, -self.cycles :], freedoms[:, -self.cycles :]
        return Floors(found[0], found[1])

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
        base = signal.firwin(2 * half + 1, width / 2, fs=rate_hz)
        turn = 2j * np.pi * (low_hz + width / 2) / rate_hz * np.arange(-half, half + 1)
        self.kernel: NDArray[np.complex128] = 2 * base * np.exp(turn)
        self.delay = half
        self._zi: NDArray[np.complex128] | None = None
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
        if x.shape[1] == 0:  # lfilter would lose its state
            return times, x.astype(np.complex128)
        if self._zi is None:
            self._zi = np.zeros((x.shape[0], len(self.kernel) - 1), np.complex128)
        # two denominator terms keep lfilter sample by sample: the same sums whatever the blocks
        y, self._zi = signal.lfilter(self.kernel, [1.0, 0.0], x, axis=1, zi=self._zi)
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        y = np.asarray(y[:, skipped:])
        self._times = np.concatenate([self._times, times])
        done = slice(self.delay, self.delay + y.shape[1])
        found = self._times[done]
        self._times = self._times[y.shape[1] :]
        return found, y


def power(analytic: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the instantaneous power, half the squared envelope, any shape [unit^2]."""
    return np.asarray(0.5 * (analytic.real**2 + analytic.imag**2))


#: Cadence of walking [steps/s]. Chosen by judgement: from a stroll to a run.
CADENCE_HZ = (1.4, 2.5)
#: The envelope's spectrum is looked at in this range: from half a slow cadence to a few harmonics.
#: Chosen by judgement.
_ENVELOPE_HZ = (0.9, 8.0)
#: Rate the envelope is brought down to [Hz]. Source: definition: over twice the highest of
#: :data:`_ENVELOPE_HZ`, with room for a filter.
_ENVELOPE_RATE_HZ = 40.0
#: Samples are levelled by their running root mean square under a Hann window of this length [s]:
#: longer than a step's interval, shorter than a vehicle takes to pass. Chosen by judgement.
_LEVEL_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of windows of signal.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: end of each window.
    power
        Shape (n_channels, n): mean square in the band [unit^2].
    kurtosis
        Shape (n_channels, n): excess over a normal law's, 0 for Gaussian noise.
    impulsiveness
        Shape (n_channels, n): the same of levelled samples, so that a vehicle that comes near
        within the window has none.
    flatness
        Shape (n_channels, n): geometric over arithmetic mean of the spectrum in the band, from 0
        for a line to 1 for white noise.
    centroid_hz
        Shape (n_channels, n): mean frequency of power in the band [Hz].
    cadence
        Shape (n_channels, n): part of the envelope's fluctuation that is at one cadence of walking
        and its second harmonic, from 0 to 1.
    cadence_hz
        Shape (n_channels, n): that cadence [Hz].
    """

    time_ns: NDArray[np.int64]
    power: Array
    kurtosis: Array
    impulsiveness: Array
    flatness: Array
    centroid_hz: Array
    cadence: Array
    cadence_hz: Array


def kurtosis(samples: Array) -> Array:
    """Return the excess kurtosis of rows, shape (n_channels,) from (n_channels, n)."""
    centred = samples - samples.mean(axis=1, keepdims=True)
    square = np.mean(centred**2, axis=1)
    fourth = np.mean(centred**4, axis=1)
    ratio = np.divide(fourth, square**2, out=np.full(len(square), 3.0), where=square > 0)
    return np.asarray(ratio - 3)


def levelled(samples: Array, rate_hz: float) -> Array:
    """Return rows over their running root mean square, shape (n_channels, n)."""
    length = min(round(_LEVEL_S * rate_hz), samples.shape[1])
    window = np.hanning(length + 2)[1:-1]
    weight = np.convolve(np.ones(samples.shape[1]), window, "same")
    square = np.array([np.convolve(row, window, "same") for row in samples**2]) / weight
    found: Array = samples / np.sqrt(np.maximum(square, np.finfo(float).tiny))
    return found


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


def cadence(samples: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return how much of the envelope is at a cadence of walking, and that cadence [Hz].

    The envelope is the root of mean squares over 25 ms, less its line; its spectrum at a cadence
    and at twice that is compared to all from 0.9 to 8 Hz.

    Parameters
    ----------
    samples
        Shape (n_channels, n): of a band, for 3 s at least.
    rate_hz
        Sampling rate [Hz].

    Returns
    -------
    Shapes (n_channels,).
    """
    step = max(1, round(rate_hz / _ENVELOPE_RATE_HZ))
    n = samples.shape[1] // step
    cells = samples[:, : n * step].reshape(len(samples), n, step)
    envelope = np.sqrt(np.mean(cells**2, axis=2))
    time = np.arange(n) - (n - 1) / 2
    slope = envelope @ time / (time @ time)
    level = envelope - envelope.mean(axis=1, keepdims=True) - slope[:, None] * time
    window = np.hanning(n + 2)[1:-1]
    size = 8 * n
    spectrum = np.asarray(np.abs(np.fft.rfft(level * window, size, axis=1)) ** 2, np.float64)
    frequency = np.asarray(np.fft.rfftfreq(size, step / rate_hz), np.float64)
    return _line(spectrum, frequency, rate_hz / step / n)


def _line(spectrum: Array, frequency: Array, resolution_hz: float) -> tuple[Array, Array]:
    """Return the strongest line with its harmonic; a line is two resolutions wide either way."""
    low, high = _ENVELOPE_HZ
    inside = (frequency >= low) & (frequency <= high)
    total = np.maximum(spectrum[:, inside].sum(axis=1), np.finfo(float).tiny)
    cumulative = np.concatenate([np.zeros((len(spectrum), 1)), spectrum.cumsum(axis=1)], axis=1)

    def about(centres: Array) -> Array:
        ends = [centres - resolution_hz, centres + resolution_hz]
        a, b = (np.searchsorted(frequency, np.clip(e, low, high)) for e in ends)
        return np.asarray(cumulative[:, b] - cumulative[:, a])

    candidates = frequency[(frequency >= CADENCE_HZ[0]) & (frequency <= CADENCE_HZ[1])]
    parts = about(candidates) + about(2 * candidates)
    best = parts.argmax(axis=1)
    return parts[np.arange(len(parts)), best] / total, candidates[best]


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
        self._filter = StreamingFilter(bandpass(low_hz, high_hz, rate_hz, order=4))
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
        found = self._features(number[full] * self.cycle_ns, windows)
        # the next cycle ends at the next sample at the earliest: no more than a window is needed
        drop = max(0, len(self._times) - self.window)
        self._times, self._samples = self._times[drop:], self._samples[:, drop:]
        return found

    def _features(self, times: NDArray[np.int64], windows: list[Array]) -> Features:
        rows = np.empty((7, len(self._samples), len(windows)))
        for column, window in enumerate(windows):
            rows[0, :, column] = np.mean(window**2, axis=1)
            rows[1, :, column] = kurtosis(window)
            rows[2, :, column] = kurtosis(levelled(window, self.rate_hz))
            rows[3:5, :, column] = spectral_shape(window, self.rate_hz, self.band_hz)
            rows[5:7, :, column] = cadence(window, self.rate_hz)
        return Features(times, *rows)


@dataclass(frozen=True, slots=True)
class Persistence:
    """A minimum time for which candidates of a channel have passed all gates before this one.

    Parameters
    ----------
    bridge_s
        A run goes on over candidates that fail while two that pass are no further apart [s].
    """

    parameter: str = "lasting_s"
    bridge_s: float = 1.0
    name: str = "lasting"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],  # noqa: ARG002
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the time since the run began [s]; 0 for candidates that failed before."""
        first = carry.last_ns.setdefault(f"{self.name} since", {})
        last = carry.last_ns.setdefault(self.name, {})
        out = np.zeros(len(candidates))
        for channel in set(candidates.channel.tolist()):
            rows = np.flatnonzero(alive & (candidates.channel == channel))
            if not len(rows):
                continue
            times = candidates.time_ns[rows]
            known = channel in last
            before = np.concatenate([[last[channel] if known else times[0]], times[:-1]])
            late = times - before
            begins = (late > self.bridge_s * NS_PER_S) | (late < 0)
            begins[0] |= not known
            starts = np.where(begins, times, 0)
            group = np.maximum.accumulate(np.where(begins, np.arange(len(rows)), -1))
            began = np.where(group >= 0, starts[group], first.get(channel, times[0]))
            out[rows] = (times - began) / NS_PER_S
            first[channel], last[channel] = int(began[-1]), int(times[-1])
        return out


#: What a candidate tells before the features. Source: definition.
_COLUMNS = 8
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
    over_floor: Annotated[float, gate("dB", "Lowest power over the noise.")] = 5.0
    impulsiveness: Annotated[
        float, gate("1", "Highest excess kurtosis of the levelled samples.")
    ] = 1.5
    cadence: Annotated[
        float, gate("1", "Highest part of the envelope at a walking cadence.", ge=0)
    ] = 0.5
    flatness: Annotated[float, gate("1", "Highest spectral flatness; noise is near 1.")] = 0.92
    centroid: Annotated[float, gate("Hz", "Lowest mean frequency; wind is lower.", ge=0)] = 8.0
    lasting_s: Annotated[float, gate("s", "Shortest time for which all that is so.", ge=0)] = 1.0


@dataclass(slots=True)
class _State:
    cycles: CyclePower
    floor: NoiseFloor
    features: PresenceFeatures


class VehiclePresence(Stage):
    """A vehicle is power that lasts, without the impulses and the cadence of footsteps.

    Every channel and cycle is a candidate. Power and floor are kept beside what the gates look at:
    the stages after this one work on them.
    """

    Parameters = PresenceParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Presence,)
    columns = (
        Quantity("over_floor", "dB"),
        Quantity("power", "unit^2"),
        Quantity("floor", "unit^2"),
        Quantity("floor_sigma", "unit^2"),
        Quantity("impulsiveness", "1"),
        Quantity("cadence", "1"),
        Quantity("flatness", "1"),
        Quantity("centroid", "Hz"),
    )
    trace = (Quantity("over_floor", "dB"),)
    gates = (
        Level("over_floor", "dB", "over_floor"),
        Level("impulsiveness", "1", "impulsiveness", at_least=False),
        Level("cadence", "1", "cadence", at_least=False),
        Level("flatness", "1", "flatness", at_least=False),
        Level("centroid", "Hz", "centroid"),
        Persistence(),
    )

    def __init__(self, parameters: PresenceParameters) -> None:
        self.parameters = parameters
        self.spans = PresenceIntervals()

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is heard on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        self.state = _State(
            CyclePower(rate, n, p.cycle_s, p.low_hz, p.high_hz),
            NoiseFloor(round(p.floor_s / p.cycle_s)),
            PresenceFeatures(rate, n, p.cycle_s, p.window_s, p.low_hz, p.high_hz),
        )
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Return the cycles that the block completes."""
        times, x = block.sample_times(), planar(block)
        return self._measured(self.state.cycles.add(times, x), self.state.features.add(times, x))

    def flush(self) -> Iterator[Output]:
        """Yield the last cycle, if there is half of it; its shape stays unknown. End all spans."""
        yield from self._measured(self.state.cycles.flush(), None)
        yield from self.spans.flush()

    def decided(self, block: CandidateBlock) -> Iterator[Presence]:
        """Yield the spans that have ended."""
        return self.spans.take(block)

    def _measured(self, found: CyclePowers, shapes: Features | None) -> Measured:
        channels, cycles = found.power.shape
        if not cycles:
            empty = np.empty((0, channels, 1), np.float32)
            return Measured(Candidates.empty(_COLUMNS), Frames(np.empty(0, np.int64), empty))
        floors = self.state.floor(found.power, found.freedom)
        floor = floors.power
        columns = np.full((_COLUMNS, channels, cycles), np.nan)
        columns[:4] = over_floor_db(found.power, floor), found.power, floor, floors.sigma
        half_ns = self.state.cycles.cycle_ns // 2
        if shapes is not None:
            _, mine, theirs = np.intersect1d(
                found.time_ns + half_ns, shapes.time_ns, return_indices=True
            )
            told = shapes.impulsiveness, shapes.cadence, shapes.flatness, shapes.centroid_hz
            columns[4:, :, mine] = np.array(told)[..., theirs]
        values = columns.transpose(2, 1, 0).astype(np.float32)
        candidates = Candidates(
            np.repeat(found.time_ns, channels),
            np.tile(np.arange(channels, dtype=np.int32), cycles),
            values.reshape(-1, _COLUMNS),
        )
        return Measured(candidates, Frames(found.time_ns - half_ns, values[..., :1]))


def over_floor_db(power: Array, floor: Array) -> Array:
    """Return power over the floor [dB], any shape; 0 where there is no floor."""
    known = floor > 0
    ratio = np.divide(power, floor, out=np.ones_like(power), where=known)
    least = 10 ** (-_RANGE_DB / 10)
    return np.asarray(np.clip(10 * np.log10(np.maximum(ratio, least)), -_RANGE_DB, _RANGE_DB))
