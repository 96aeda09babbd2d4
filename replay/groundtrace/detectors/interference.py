"""Interference: hum of the mains, offset steps, spikes.

Hum: spectra of 2 s are averaged as logarithms, so that a permanent line stands out and bursts such
as steps do not. A line with harmonics that lies well off 50 and 60 Hz shows that the sampling rate
is wrong, for no mains is half a hertz off.

Offset steps: a level that shifts and stays, in channels whose level is only an offset. Frames of
0.3 s hold whole periods of 50 and 60 Hz, and the mean of a wave that has passed is zero, so a step
exceeds the spread of the frames' means on both sides.

Spikes: single samples far off their neighbours, which no motion can cause. Before it is sampled a
signal is limited to half the rate, so that a true onset rings on over several samples. A spike's
second difference stands alone: large at its sample, half as large and opposite on both sides, and
nothing before or after.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..dsp.filters import HIGHEST_CORNER
from ..dsp.parabola import highest
from ..dsp.robust import medians
from .held_values import level
from .signal_faults import FaultSpans, Finding, percent, times

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from .signal_faults import Window

    Array = NDArray[np.float64]

#: Frequencies of mains. Source: definition, those of public grids.
MAINS_HZ = (50.0, 60.0)
#: Length of a spectrum [s], and the rate to which a faster signal is averaged [Hz]. Chosen by
#: judgement: 0.5 Hz tells 50 from 60 Hz and a line from its neighbours; 1 kHz holds the first
#: harmonics.
SPECTRUM_S, RATE_HZ = 2.0, 1000.0
#: Rates below this do not show 60 Hz, spectra fewer than this no steadiness. Chosen by judgement:
#: 150 Hz leaves room above 60 Hz, and of three spectra no deviation is told.
LEAST_RATE_HZ, LEAST_SPECTRA = 150.0, 4
#: Where a fundamental is looked for [Hz]: rates that are a quarter off. Source: definition: 50 Hz
#: less and 60 Hz more a quarter.
LOW_HZ, HIGH_HZ = 37.5, 75.0
#: The neighbourhood of a line, without the line itself [Hz]. Chosen by judgement: 3 and 16 bins of
#: a spectrum.
NEAR_HZ, LINE_HZ = 8.0, 1.5
#: A line stands over it by so much [dB], a harmonic by so much; both besides chance: so many
#: standard deviations of a mean of logarithms, each 5.6 dB. The last is pi / sqrt(6) of a natural
#: logarithm. Source: definition; the others chosen by judgement: ten times the power is seen by
#: eye, and three deviations are chance once in 700 times.
LINE_DB, HARMONIC_DB, SURE, LOG_DB = 10.0, 6.0, 3.0, 5.6
#: Hum below this part of the quiet power does nothing. Chosen by judgement: it adds 1 % to the
#: noise's amplitude.
MATTERS = 0.02
#: Mains keep their frequency within this [Hz]; so many harmonics make a line one of mains. Chosen
#: by judgement: EN 50160 allows grids 1 % of 50 Hz; one harmonic may be another machine's.
KEPT_HZ, HARMONICS = 0.5, 2
#: Harmonics are looked for up to this one. Chosen by judgement: higher ones of mains are weak.
LAST_HARMONIC = 7
#: Spectra that overlap by half are worth this part of their number. Chosen by judgement: on the
#: safe side; under a Hann window neighbours correlate by 1/36 in power.
HALF_OVERLAP = 0.75


@dataclass(frozen=True, slots=True)
class Line:
    """A steady line: frequency [Hz], part of the quiet power, orders of harmonics seen."""

    frequency_hz: float
    share: float
    harmonics: tuple[int, ...]

    @property
    def mains_hz(self) -> float:
        """The mains frequency it is nearest to, by ratio [Hz]."""
        return min(MAINS_HZ, key=lambda f: abs(np.log(self.frequency_hz / f)))


class MainsHum:
    """Looks for a steady line in each channel.

    Parameters
    ----------
    stream, columns
        The channels that are looked at.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self.columns = list(columns) if stream.rate_hz >= LEAST_RATE_HZ else []
        self._every = max(1, int(stream.rate_hz // RATE_HZ))
        self.rate_hz = stream.rate_hz / self._every
        self.length = round(SPECTRUM_S * self.rate_hz)
        self._logs = np.zeros((len(self.columns), self.length // 2 + 1))
        self._count = np.zeros(len(self.columns), np.int64)
        self._span = (0, 0)
        self.gap()

    def gap(self) -> None:
        """Forget the spectrum that was begun."""
        self._raw = np.empty((len(self.columns), 0), np.float32)
        self._slow = np.empty((len(self.columns), 0))

    def update(self, window: Window) -> None:
        """Take the next window."""
        if not self.columns:
            return
        raw = np.concatenate([self._raw, window.core[self.columns]], axis=1)
        count = raw.shape[1] // self._every
        self._raw = raw[:, count * self._every :]
        folded = raw[:, : count * self._every].reshape(len(self.columns), count, self._every)
        self._slow = np.concatenate([self._slow, folded.mean(axis=2)], axis=1)
        while self._slow.shape[1] >= self.length:
            self._add(self._slow[:, : self.length])
            self._slow = self._slow[:, self.length // 2 :]
        self._span = (self._span[0] or window.start_ns, window.time_ns(len(window)))

    def _add(self, part: Array) -> None:
        swing = (part - part.mean(axis=1, keepdims=True)) * np.hanning(self.length)
        power = np.abs(np.fft.rfft(swing, axis=1)) ** 2
        # a channel that is dead or not finite in this part says nothing
        good = np.isfinite(power).all(axis=1) & (power.sum(axis=1) > 0)
        self._logs[good] += np.log(power[good] + 1e-12 * power[good].max(axis=1, keepdims=True))
        self._count += good

    def line(self, row: int) -> Line | None:
        """Return the strongest steady line of a channel; None where there is none."""
        if self._count[row] < LEAST_SPECTRA:
            return None
        mean = self._logs[row] / self._count[row]
        chance_db = SURE * LOG_DB / np.sqrt(HALF_OVERLAP * self._count[row])
        low, high = (
            round(f * SPECTRUM_S) for f in (LOW_HZ, min(HIGH_HZ, HIGHEST_CORNER * self.rate_hz))
        )
        over = _over_db(mean, np.arange(low, high + 1))
        best = low + int(np.argmax(over))
        if over.max() < LINE_DB + chance_db:
            return None
        frequency = _peak(mean, best) / SPECTRUM_S
        n = np.arange(2, LAST_HARMONIC + 1)
        n = n[n * frequency < HIGHEST_CORNER * self.rate_hz]
        at = np.rint(n * frequency * SPECTRUM_S).astype(np.intp)
        harmonics = tuple(n[_over_db(mean, at) >= HARMONIC_DB + chance_db].tolist())
        return Line(frequency, _share(mean, (1, *harmonics), frequency), harmonics)

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with hum that matters, or a line of a wrong rate."""
        for row, c in enumerate(self.columns):
            line = self.line(row)
            if line is not None and line.share >= MATTERS:
                text = self._words(line)
                if text is not None:
                    kind, what, effect, remedy = text
                    name, share = self.stream.channels[c].name, min(line.share, 1.0)
                    span = self._span
                    yield Finding(
                        self.stream.topic, name, kind, *span, 1, share, what, effect, remedy
                    )

    def _words(self, line: Line) -> tuple[str, str, str, str] | None:
        f, mains = line.frequency_hz, line.mains_hz
        orders = ", ".join(f"{n * f:.0f}" for n in line.harmonics)
        also = f" with harmonics at {orders} Hz" if orders else ""
        if abs(f - mains) <= KEPT_HZ:
            return (
                "hum",
                f"hum at {f:.1f} Hz{also}, {percent(line.share)} of the power between steps",
                "weak onsets drown in it",
                _filter_advice(line, self.stream.rate_hz),
            )
        if len(line.harmonics) < HARMONICS:
            return None
        return (
            "rate",
            f"a steady line at {f:.2f} Hz{also}, where mains have {mains:.0f} Hz",
            f"if it is the mains, the rate is {100 * (f / mains - 1):+.1f} % off: times, "
            f"velocities and bands are wrong by as much",
            f"check whether the rate is {self.stream.rate_hz * mains / f:.6g} Hz rather than "
            f"{self.stream.rate_hz:g} Hz",
        )


def _filter_advice(line: Line, rate_hz: float) -> str:
    """Return the band that keeps it out: a slope of second order takes 24 dB over two octaves.

    Where that leaves no octave below half the rate, what finds steps beside it.
    """
    top = max((1, *line.harmonics)) * line.frequency_hz
    low = 10 * np.ceil(4 * top / 10)
    if 4 * low > rate_hz:
        return "look for its source; floor-steps finds steps at the frequencies beside it"
    return (
        f"look for its source; where places suffer, a band above it helps: --set "
        f"picks.low_hz={low:.0f} --set arrivals.low_hz={low:.0f}"
    )


def _over_db(mean: Array, at: NDArray[np.intp]) -> Array:
    """Return how far bins of a mean log power are over the median of their neighbourhoods [dB]."""
    near, line = round(NEAR_HZ * SPECTRUM_S), round(LINE_HZ * SPECTRUM_S)
    away = np.concatenate([np.arange(-near, -line), np.arange(line + 1, near + 1)])
    # the first two bins hold what the window leaves of the mean, none lies outside the spectrum
    bounded = np.concatenate([np.full(near, np.nan), mean, np.full(near, np.nan)])
    bounded[: near + 2] = np.nan
    return np.asarray((mean[at] - medians(bounded[at[:, None] + near + away])) * 10 / np.log(10))


def _peak(mean: Array, i: int) -> float:
    """Return the place of a maximum between bins, by a parabola."""
    return i + float(highest(*mean[i - 1 : i + 2, None])[0])


def _share(mean: Array, orders: Sequence[int], frequency: float) -> float:
    """Return which part of the quiet power lies in a line and its harmonics."""
    power = np.exp(mean - mean.max())
    lines = 0.0
    for n in orders:
        i = round(n * frequency * SPECTRUM_S)
        lines += float(power[i - 2 : i + 3].sum())
    return lines / float(power[2:].sum())


#: Chosen by judgement: longer than a period of hum or a step's impact, short beside SIDE of them.
FRAME_S = 0.3
#: Frames on each side of a step: 3 s, longer than any step rings. Chosen by judgement.
SIDE = 10
#: A step is so many times the range of the means on either side, and of the frames' own deviation:
#: less is neither sure nor matters. Chosen by judgement: three deviations.
STEP_SURE, STEP_MATTERS = 3.0, 1.0


class Offsets:
    """Looks for offset steps.

    Parameters
    ----------
    stream, columns
        The channels that are looked at; their values swing about a level that means nothing.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self.columns = list(columns)
        self.length = max(4, round(FRAME_S * stream.rate_hz))
        self._tallies = {c: FaultSpans() for c in columns}
        self._largest = dict.fromkeys(columns, 0.0)
        self._begin()

    def gap(self) -> None:
        """Judge what is left and forget all levels: the next run may begin at another."""
        for _ in range(SIDE):
            self._keep(np.zeros(len(self.columns)), (0, 0))
        self._begin()

    def _begin(self) -> None:
        self._rest = np.empty((len(self.columns), 0))
        self._frames = np.empty((2, len(self.columns), 0))
        self._times: list[int] = []
        self._shifts = np.zeros((len(self.columns), 2 * SIDE))
        self._spans = [(0, 0)] * (2 * SIDE)

    def update(self, window: Window) -> None:
        """Take the next window."""
        core = window.core[self.columns].astype(np.float64)
        before = self._rest.shape[1]
        core = np.concatenate([self._rest, core], axis=1)
        count = core.shape[1] // self.length
        folded = core[:, : count * self.length].reshape(len(self.columns), count, self.length)
        self._rest = core[:, count * self.length :]
        if not count:
            return
        mean = folded.mean(axis=2, dtype=np.float64)
        spread = folded.std(axis=2, dtype=np.float64)
        self._frames = np.concatenate([self._frames, np.stack([mean, spread])], axis=2)
        self._times += [window.time_ns(k * self.length - before) for k in range(count)]
        self._judge()

    def _judge(self) -> None:
        """Take the shift in the middle of as many frames as it needs, frame by frame."""
        while self._frames.shape[2] >= 2 * SIDE:
            shift = _shift(*self._frames[:, :, : 2 * SIDE])
            self._keep(shift, (self._times[SIDE - 1], self._times[SIDE + 1]))
            self._frames, self._times = self._frames[:, :, 1:], self._times[1:]

    def _keep(self, shift: Array, span_ns: tuple[int, int]) -> None:
        """Take a shift; count the middle one of those kept where it is the largest of them."""
        self._shifts = np.column_stack([self._shifts[:, 1:], shift])
        self._spans = [*self._spans[1:], span_ns]
        size = np.abs(self._shifts)
        for row in np.flatnonzero((size[:, SIDE] > 0) & (size.argmax(axis=1) == SIDE)):
            c = self.columns[row]
            self._tallies[c].add(*self._spans[SIDE], 0)
            self._largest[c] = max(self._largest[c], float(self._shifts[row, SIDE]), key=abs)

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with offset steps."""
        for c, tally in self._tallies.items():
            if tally.events:
                channel = self.stream.channels[c]
                yield Finding(
                    self.stream.topic,
                    channel.name,
                    "offset",
                    tally.start_ns,
                    tally.end_ns,
                    tally.events,
                    0.0,
                    f"its level shifts {times(tally.events)} and stays, by up to "
                    f"{level(channel, self._largest[c])}",
                    "a band-pass rings there once and may pick it on this channel",
                    "look for a loose contact or a change of gain",
                )


def _shift(mean: Array, deviation: Array) -> Array:
    """Return by how much each level shifts in the middle of frames; 0 where it is not sure.

    Parameters
    ----------
    mean, deviation
        Shape (n_channels, 2 * SIDE): mean and standard deviation of each frame.
    """
    before, after = (np.sort(part, axis=1) for part in (mean[:, : SIDE - 1], mean[:, SIDE + 1 :]))
    middle = (SIDE - 1) // 2
    shift = after[:, middle] - before[:, middle]
    spread = np.maximum(before[:, -1] - before[:, 0], after[:, -1] - after[:, 0])
    deviation = np.sort(deviation, axis=1)
    noise = deviation[:, SIDE // 2]  # between steps
    least = np.maximum(STEP_SURE * spread, STEP_MATTERS * noise)
    # where a channel stands still it is dead: said elsewhere
    return np.where((np.abs(shift) >= least) & (deviation[:, 0] > 0), shift, 0.0)


#: Second differences are looked at from so many times their mean in the window on. Chosen by
#: judgement: white noise has such three times in a million samples.
LOUD = 6.0
#: And so many times their mean within so many samples: a window may be silent for the most part.
#: Chosen by judgement: a quarter of a second at 1 kHz, less than from step to step.
LOCAL = 256
#: The same between two and so many samples away, of which at least so many are there. Chosen by
#: judgement: a spike is one sample, what rings is seen in the next eight.
NEAR, LEAST_NEAR = 8, 8
#: So many times the largest and the median of those: the first leaves out what rings, the second
#: what is only the largest of its noise (4 standard deviations of white noise are 6 medians).
#: Chosen by judgement.
ALONE, FAR = 4.0, 12.0
#: Worn sensors see hits of a heel shorter than a sample: only what stands so much higher counts.
#: Chosen by judgement: of 60 public recordings no foot sensor has a spike then (docs/faults.md).
WORN = 2.0
#: The two neighbours differ by no more than this part of the spike's height. Chosen by judgement:
#: before and after a spike the signal is what it was.
BACK = 0.25


class Spikes:
    """Looks for spikes.

    Parameters
    ----------
    stream, columns
        The channels that are looked at.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self._tallies = {c: FaultSpans() for c in columns}
        self._highest = dict.fromkeys(columns, 0.0)
        self._sample_count = 0

    def update(self, window: Window) -> None:
        """Take the next window."""
        self._sample_count += len(window)
        for c in self._tallies:
            row = window.values[c]
            worn = 1.0 if self.stream.channels[c].quantity in SEISMIC_QUANTITIES else WORN
            for at in _spikes(row, worn):
                index = at - window.left
                if 0 <= index < len(window):
                    span = window.time_ns(index), window.time_ns(index + 1)
                    self._tallies[c].add(*span, 1)
                    height = float(abs(row[at] - (row[at - 1] + row[at + 1]) / 2))
                    self._highest[c] = max(self._highest[c], height)

    def gap(self) -> None:
        """Nothing crosses windows."""

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with spikes."""
        for c, tally in self._tallies.items():
            if not tally.events:
                continue
            channel = self.stream.channels[c]
            yield Finding(
                self.stream.topic,
                channel.name,
                "spikes",
                tally.start_ns,
                tally.end_ns,
                tally.events,
                tally.samples / self._sample_count,
                f"single samples far off {times(tally.events)}, up to "
                f"{level(channel, self._highest[c])} high",
                "each may be picked as an onset on this channel, which alone makes no step",
                "look for static, bit errors or a loose contact",
            )


def _spikes(row: NDArray[np.floating], factor: float) -> list[int]:
    """Return the indices of spikes that stand ``factor`` times as high as they have to."""
    if len(row) < 2 * NEAR:
        return []
    bend = row[1:-1] - (row[:-2] + row[2:]) * row.dtype.type(0.5)
    np.abs(bend, out=bend)
    finite_bend = bend if not np.isnan(bend).any() else np.nan_to_num(bend)
    spikes = []
    for i in np.flatnonzero(finite_bend > LOUD * finite_bend.mean()).tolist():
        highest = finite_bend[i] >= finite_bend[max(0, i - 1) : i + 2].max()
        comes_back = abs(row[i + 2] - row[i]) <= BACK * finite_bend[i]
        loud = finite_bend[i] > LOUD * finite_bend[max(0, i - LOCAL) : i + LOCAL].mean()
        if highest and comes_back and loud and _alone(finite_bend, i, factor):
            spikes.append(i + 1)
    return spikes


def _alone(bend: NDArray[np.floating], i: int, factor: float) -> bool:
    """Return whether a second difference stands alone."""
    around = np.concatenate([bend[max(0, i - NEAR) : max(0, i - 1)], bend[i + 2 : i + NEAR + 1]])
    return bool(
        len(around) >= LEAST_NEAR
        and bend[i] >= factor * ALONE * around.max()
        and bend[i] >= factor * FAR * medians(around)
    )
