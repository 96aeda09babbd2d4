"""Footfall power: footfalls by the power of a floor's vibration over what is usual.

An arrival picker looks for the onset of a wave, some milliseconds sharp. A sensor that is sampled
at a few hundred hertz, or stands far away on a soft floor, shows a footfall as a swing of a tenth
of a second that hardly rises over what else the floor does; its onset is lost, its power is not.

Source: windows whose energy is improbable for that of noise, as in Pan et al., "Indoor person
identification through footstep induced structural vibration" (HotMobile 2015), with two changes.
Each frequency is compared with what is usual there, so that hum and a floor's own ringing, which
are loud at a few, do not hide what footfalls do at the others. And the usual is a median, which
the walk itself hardly raises, not the mean of a part that somebody called noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import SampleClock, planar
from ..dsp.noise import LocalMaxima, LocalMaximaWithOnset
from ..dsp.parabola import highest
from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import (
    CHAINED,
    CannotStart,
    Context,
    Input,
    Measured,
    Memory,
    Stage,
    joined,
)
from .trace import TRACE, FrameTrace, WholeFrames, trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: A window is so many hops long, which is odd: its middle is that of a hop. Chosen by judgement:
#: peaks of power are then told to a fiftieth of a second.
HOPS = 11
#: Samples are averaged to this many for a period of the highest frequency looked at. Chosen by
#: judgement: more than the two that it takes.
PER_PERIOD = 2.5
#: What is usual is told anew after so many hops, of one in some of them. Chosen by judgement: half
#: a second, and windows that overlap by half.
CHUNK, EVERY = 22, 5
#: So many of these chunks tell the usual at first. Chosen by judgement: two seconds.
FIRST_CHUNKS = 4
#: Frequencies that are compared at least. Chosen by judgement: the mean of fewer is often twice the
#: usual by chance.
LEAST_FREQUENCIES = 6
#: The mean of the power of noise over its median. Source: the exponential distribution.
MEAN_OF_MEDIAN = 1 / math.log(2)
#: The usual is taken for no less than this part of the most in its time. Chosen by judgement:
#: 60 dB, as of 10 bits; below it a line is silent.
SILENT = 1e-6
#: All frequencies there are. Source: definition.
OPEN_HZ = (1e-9, 1e9)
COLUMNS = (Quantity("ratio", "1"),)


@dataclass(frozen=True, slots=True)
class FootfallPowerParameters:
    """Parameters of :class:`FootfallPower`."""

    low_hz: Annotated[float, measured("Hz", "Lowest frequency looked at.", gt=0)] = 5.0
    high_hz: Annotated[float, measured("Hz", "Highest frequency looked at.", gt=0)] = 400.0
    window_s: Annotated[float, measured("s", "Length of the Hann window.", gt=0)] = 0.25
    noise_s: Annotated[float, measured("s", "Time whose median is the usual power.", gt=0)] = 10.0
    floor: Annotated[float, measured("1", "Lowest ratio kept as a candidate.", ge=0)] = 1.5
    separation_s: Annotated[float, measured("s", "Least time between candidates.", ge=0)] = 0.3
    ratio: Annotated[float, gate("1", "Lowest ratio that is a footfall.", ge=0)] = 2.5
    refractory_s: Annotated[float, gate("s", "Least time between two footfalls.", ge=0)] = 0.3


class UsualPower:
    """Compares power with its median of the last seconds, frequency by frequency.

    Parameters
    ----------
    chunks
        Over how many chunks the median goes.
    """

    def __init__(self, chunks: int) -> None:
        self._chunks = chunks
        self._past: list[Array] = []  # one in some hops of each chunk
        self._waiting: list[Array] = []  # chunks before anything is usual
        self._open: list[Array] = []  # of the chunk under way
        self._count = 0

    def ratios(self, power: Array, *, final: bool = False) -> Array:
        """Take power, shape (hops, n_channels, n); return ratios, as far as the usual is known.

        They are means over frequencies, shape (n_channels, hops).
        """
        self._open.append(power)
        self._count += len(power)
        if self._count < CHUNK and not final:
            return np.empty((power.shape[1], 0))
        line = np.concatenate(self._open)
        stop = len(line) if final else len(line) // CHUNK * CHUNK
        self._open, self._count = [line[stop:]], len(line) - stop
        starts = range(0, max(stop, 1) if final else stop, CHUNK)
        made = [self._ratios(line[k : k + CHUNK], final=final) for k in starts]
        return np.concatenate([np.empty((power.shape[1], 0)), *made], axis=1)

    def _ratios(self, chunk: Array, *, final: bool) -> Array:
        self._past = [*self._past, chunk[::EVERY]][-self._chunks :]
        self._waiting.append(chunk)
        if len(self._past) < FIRST_CHUNKS and not final:
            return np.empty((chunk.shape[1], 0))
        power, self._waiting = np.concatenate(self._waiting), []
        if not len(power):
            return np.empty((chunk.shape[1], 0))
        past = np.concatenate(self._past)
        median = MEAN_OF_MEDIAN * np.median(past, axis=0)
        median = np.maximum(median, SILENT * past.max(axis=(0, 2))[:, None])
        # over digital silence nothing has a ratio
        over = np.divide(power, median, out=np.zeros_like(power), where=median > 0)
        return np.asarray(over.mean(axis=2).T)


class HopWindows:
    """Cuts signals into hops, and takes the spectrum of the window around each.

    Parameters
    ----------
    rate_hz, channels
        Of the stream.
    parameters
        Of the detector.

    Attributes
    ----------
    hop
        Samples of a hop.
    frequencies
        Compared ones, as indices of the window's spectrum.
    """

    def __init__(self, rate_hz: float, channels: int, parameters: FootfallPowerParameters) -> None:
        p = parameters
        self._averaged = max(1, int(rate_hz / (PER_PERIOD * p.high_hz)))
        self._parts = max(1, round(p.window_s * rate_hz / (HOPS * self._averaged)))
        self.hop = self._parts * self._averaged
        self._window = np.hanning(HOPS * self._parts + 2)[1:-1]
        found_hz = np.fft.rfftfreq(len(self._window), self._averaged / rate_hz)
        # that of half the rate has half the degrees of freedom of others
        below_hz = rate_hz / (2 * self._averaged)
        inside = (found_hz >= p.low_hz) & (found_hz <= p.high_hz) & (found_hz < below_hz)
        self.frequencies = np.flatnonzero(inside)
        self._rest = np.empty((channels, 0))  # of the hop under way
        self._averages = np.empty((channels, 0))  # of hops around which windows are not complete
        self._limits = np.empty((2, channels, 0))  # the most and the least in those yet to come

    def add(self, samples: Array) -> tuple[Array, Array]:
        """Take samples, shape (n_channels, n); return what complete windows hold.

        Power by frequency, shape (hops, n_channels, n); and of the hops in their middle, shape
        (4, n_channels, hops): peak and mean power without the window's mean, and the most and the
        least as recorded. Before the first sample there was the same.
        """
        samples = np.concatenate([self._rest, samples], axis=1)
        stop = samples.shape[1] // self.hop * self.hop
        hops = samples[:, :stop].reshape(len(samples), stop // self.hop, self.hop)
        self._rest = samples[:, stop:]
        limits = np.stack([hops.max(axis=2), hops.min(axis=2)])
        self._limits = np.concatenate([self._limits, limits], axis=2)
        averages = hops.reshape(len(hops), stop // self._averaged, self._averaged).mean(axis=2)
        before = self._averages if self._averages.size else self._same(averages[:, :1])
        return self._complete(np.concatenate([before, averages], axis=1))

    def flush(self) -> tuple[Array, Array]:
        """Return the same of the last hops, as if the signal stayed as it is."""
        after = self._same(self._averages[:, -1:])
        return self._complete(np.concatenate([self._averages, after], axis=1))

    def _same(self, average: Array) -> Array:
        return np.repeat(average, HOPS // 2 * self._parts, axis=1)

    def _complete(self, averages: Array) -> tuple[Array, Array]:
        length, parts = len(self._window), self._parts
        count = max(0, (averages.shape[1] - length) // parts + 1)
        self._averages = averages[:, count * parts :]
        limits, self._limits = self._limits[:, :, :count], self._limits[:, :, count:]
        if not count:
            nothing = np.empty((0, len(averages), len(self.frequencies)))
            return nothing, np.empty((4, len(averages), 0))
        windows = np.lib.stride_tricks.sliding_window_view(averages, length, axis=1)[:, ::parts]
        windows = windows - windows.mean(axis=2, keepdims=True)
        spectra = np.fft.rfft(windows * self._window, axis=2)[:, :, self.frequencies]
        middle = windows[:, :, HOPS // 2 * parts : (HOPS // 2 + 1) * parts]
        signal = np.stack([np.abs(middle).max(axis=2), (middle * middle).mean(axis=2), *limits])
        # the same sums in the same order, whatever the blocks
        return np.ascontiguousarray(np.moveaxis(np.abs(spectra) ** 2, 1, 0)), signal


class FootfallPower(Stage):
    """A footfall is where the power of a floor is the most times the usual one.

    The power of a window is compared, frequency by frequency, with its median over some seconds,
    which end half a second later at most; ``ratio`` is the mean over frequencies, 1 of noise. A
    footfall lies in the middle of the window in which it is largest, between windows by a parabola.
    At low rates there are few frequencies, and noise alone reaches twice the usual.
    """

    Parameters = FootfallPowerParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Pick,)
    compiles = ("frames", "picker")
    columns = COLUMNS
    trace = trace_of(Quantity("ratio", "1"), "signal", "signal")
    gates = (Level("ratio", "1", "ratio"), Refractory())

    @classmethod
    def unfiltered(
        cls, parameters: FootfallPowerParameters
    ) -> tuple[type[FootfallPower], FootfallPowerParameters]:
        """Return what measures the same at all frequencies."""
        return cls, replace(parameters, low_hz=OPEN_HZ[0], high_hz=OPEN_HZ[1])

    def __init__(self, parameters: FootfallPowerParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """That of the usual power, of windows and of the refractory time."""
        p = self.parameters
        around_s, chunk_s = p.window_s + p.separation_s, 2 * CHUNK * p.window_s / HOPS
        compared = Memory(p.noise_s + chunk_s + around_s, FIRST_CHUNKS * chunk_s + around_s)
        return compared.behind([TRACE]).behind([Memory(CHAINED * p.refractory_s, 0.0)])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is looked at on its own."""
        stream, p = context.stream, self.parameters
        rate, channels = stream.rate_hz, len(stream.channels)
        windows = HopWindows(rate, channels, p)
        if len(windows.frequencies) < LEAST_FREQUENCIES:
            raise CannotStart(
                f"expected at least {LEAST_FREQUENCIES} frequencies from {p.low_hz:g} to "
                f"{p.high_hz:g} Hz in windows of {p.window_s:g} s, found "
                f"{len(windows.frequencies)} at {rate:g} Hz"
            )
        hop_s = windows.hop / rate
        self._windows, self._clock = windows, SampleClock()
        self._comparison = UsualPower(max(FIRST_CHUNKS, round(p.noise_s / (CHUNK * hop_s))))
        self._maxima = LocalMaxima(channels, max(1, round(p.separation_s / hop_s)), p.floor, 0)
        self._trace = FrameTrace(1 / hop_s, channels)
        self._frames = WholeFrames(math.lcm(CHUNK, self._trace.length) * windows.hop)
        self._signal = np.empty((4, channels, 0))  # rows of the trace that wait for their ratios
        self._ratios = np.empty((channels, 0))  # that maxima may be in, and one before
        self._first = 0  # hop of the first of them
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Compare the power of the windows that a block completes with the usual one."""
        block = self._frames.of(block)
        if not len(block):
            return Measured(Candidates.empty(len(self.columns)), self._trace.nothing())
        self._clock.add(block)
        return self._take(*self._windows.add(planar(block)))

    def flush(self) -> Measured:
        """End the run."""
        last = self._take(*self._windows.flush(), final=True)
        return joined(last, Measured(Candidates.empty(len(self.columns)), self._trace.flush()))

    def _take(self, power: Array, signal: Array, *, final: bool = False) -> Measured:
        """Take what windows hold; return what they complete."""
        ratios = self._comparison.ratios(power, final=final)
        signal = np.concatenate([self._signal, signal], axis=2)
        count = ratios.shape[1]
        self._signal, signal = signal[:, :, count:], signal[:, :, :count]
        begins = self._first + self._ratios.shape[1] + np.arange(count)
        self._ratios = np.concatenate([self._ratios, ratios], axis=1)
        frames = self._trace.add(self._clock.at(begins * self._windows.hop), ratios, *signal)
        candidates = self._candidates(self._maxima.add(ratios, final=final))
        self._forget()
        return Measured(candidates, frames)

    def _candidates(self, maxima: LocalMaximaWithOnset) -> Candidates:
        """Return maxima, between hops where the parabola through their neighbours has its top."""
        at, last = maxima.peak - self._first, self._ratios.shape[1] - 1
        before, after = (self._ratios[maxima.channel, np.clip(at + k, 0, last)] for k in (-1, 1))
        inside = (at > 0) & (at < last)
        off = np.where(inside, highest(before, maxima.value, after), 0.0)
        time_ns = self._times(maxima.peak.astype(np.float64) + off)
        channel = maxima.channel.astype(np.int32)
        value = np.minimum(maxima.value, np.finfo(np.float32).max).astype(np.float32)
        order = np.lexsort((channel, time_ns))
        return Candidates(time_ns[order], channel[order], value[order, None])

    def _times(self, hops: Array) -> NDArray[np.int64]:
        """Return the times of the middles of hops [ns], which may lie between."""
        sample = (hops + 0.5) * self._windows.hop - 0.5
        first = np.floor(sample).astype(np.intp)
        after_ns = np.rint((sample - first) * NS_PER_S / self._trace.rate_hz / self._windows.hop)
        return np.asarray(self._clock.at(first) + after_ns.astype(np.int64))

    def _forget(self) -> None:
        """Forget ratios in which no maximum is any more, and times of samples before them."""
        first = max(self._maxima.settled - 1, self._first)
        self._ratios = self._ratios[:, first - self._first :]
        self._first = first
        self._clock.discard_before(first * self._windows.hop)
