"""The base of arrival pickers: from a decision function to candidates with refined onsets.

A picker gives the level of its decision function, reduced to cells of about 1 ms; the ratio of a
cell to the noise level some time before it is the candidates' first column. Candidates are the
local maxima of that ratio.

Unrefined, a candidate is the arrival of the picker's own rule: the first sample of the rise at
which the ratio is over the floor; set the floor to the threshold for a rule that begins there.

Their onset is refined on the signal as recorded by the Akaike information criterion (AIC) of
variances: AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]) (Maeda 1985). Instead of the minimum
alone, the onset is the mean of k under Akaike weights exp(-(AIC - min) / 2), with the sum divided
by the signal's correlation length, since neighbouring samples are not independent. The spread of
the weights is the uncertainty of the onset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from .. import kernels
from ..dsp.filters import SampleClock, SampleHistory
from ..dsp.noise import (
    CELL_S,
    LocalMaxima,
    LocalMaximaWithOnset,
    NoiseLevel,
    NoiseRatio,
    cell_length,
)
from ..pipeline.gates import Candidates
from ..pipeline.stage import CHAINED, Curve, Measured, Memory
from .trace import TRACE, FrameTrace, WholeFrames

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

    from ..dsp.noise import CompleteCells

    Array = NDArray[np.float64]
    #: Gives the level of samples ``[start, stop)`` of the run, shape (n, n_channels).
    Levels = Callable[[int, int], Array]
    Indices = NDArray[np.intp]

#: How the onset of a candidate is found.
Refine = Literal["none", "aic"]
COLUMNS = (Quantity("ratio", "1"), Quantity("uncertainty", "s"))
#: The AIC window before and after the rise of a ratio [s]. Chosen by judgement: noise before it,
#: and the first half period of a footstep's wave after it.
RISE_WINDOWS_S = ((0.010, 0.005),)
NOTHING = Candidates.empty(len(COLUMNS))
#: A picker takes a gap of up to so long filled [s]. Chosen by trial on simulated rooms (bench:
#: lost_packets.py -> up to 50 ms make no false step, 70 ms do): half of what the noise is averaged
#: over, so that its level outlives the silence of a line.
BRIDGED_S = 0.05


@dataclass(frozen=True, slots=True)
class ArrivalSettings:
    """How candidates are found and refined; all times in seconds.

    Attributes
    ----------
    gap_s, warm_up_s
        See :class:`~.dsp.noise.NoiseRatio`.
    floor
        Smallest ratio kept as a candidate.
    separation_s
        A candidate is the largest ratio within this distance.
    anchor
        Where the onset is looked for: at the begin of the ``rise`` of the ratio over the floor,
        or at the ``peak`` of what the decision function averages.
    back_s
        The anchor lies at most this long before the maximum of the ratio.
    windows_s
        Pairs (before, after) the anchor: the AIC windows whose onsets are averaged.
    correlation_s
        Correlation time of the signal.
    refine
        ``none`` leaves anchor, windows and correlation without effect.
    """

    gap_s: float
    warm_up_s: float
    floor: float
    separation_s: float
    anchor: Literal["rise", "peak"]
    back_s: float
    windows_s: tuple[tuple[float, float], ...]
    correlation_s: float
    refine: Refine

    @classmethod
    def of(
        cls,
        parameters: ArrivalParameters,
        anchor: Literal["rise", "peak"],
        back_s: float,
        windows_s: tuple[tuple[float, float], ...],
        correlation_s: float,
    ) -> ArrivalSettings:
        """Return the settings of a picker: its parameters, and how it refines onsets."""
        p = parameters
        shared = (p.gap_s, p.warm_up_s, p.floor, p.separation_s)
        return cls(*shared, anchor, back_s, windows_s, correlation_s, p.refine)


class ArrivalParameters(Protocol):
    """What the parameters of every arrival picker have in common."""

    @property
    def gap_s(self) -> float:
        """Time between noise and signal [s]."""

    @property
    def warm_up_s(self) -> float:
        """Noise needed to trust its level [s]."""

    @property
    def floor(self) -> float:
        """Lowest ratio kept as a candidate."""

    @property
    def separation_s(self) -> float:
        """Least time between candidates [s]."""

    @property
    def refine(self) -> Refine:
        """How the onset of a candidate is found."""

    @property
    def refractory_s(self) -> float:
        """Least time between two arrivals [s]."""


def picker_memory(
    parameters: ArrivalParameters,
    forgotten_s: float,
    back_s: float,
    windows_s: tuple[tuple[float, float], ...],
    ahead_s: float = 0.0,
) -> Memory:
    """Return how much signal the arrivals of a picker depend on.

    Parameters
    ----------
    parameters
        Its parameters.
    forgotten_s
        After how long its filters and its noise have forgotten what was before [s].
    back_s, windows_s
        As :class:`ArrivalSettings` has them.
    ahead_s
        How far its decision function looks ahead [s].
    """
    p = parameters
    before_s, after_s = (max(times) for times in zip(*windows_s, strict=True))
    around_s = p.separation_s + 2 * CELL_S
    window_memory = Memory(p.gap_s + back_s + before_s + around_s, ahead_s + after_s + around_s)
    chained = Memory(forgotten_s + CHAINED * p.refractory_s, 0.0)
    return window_memory.behind([TRACE]).behind([chained])


class ArrivalTracker:
    """Turns cells of decision functions into candidates, block by block.

    Parameters
    ----------
    rate_hz, channels
        Of the stream.
    settings
        See :class:`ArrivalSettings`.
    noise
        Makes, for cells of a given length [s], the noise level that
        :class:`~.dsp.noise.NoiseRatio` takes.
    signals
        How many signals the history has: first that in which onsets are refined, last what the
        decision function averages, where that is another.

    Attributes
    ----------
    clock, history, frames
        Times, signals and frames of the run; the picker adds to them before it tells the cells.
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        settings: ArrivalSettings,
        noise: Callable[[float], NoiseLevel],
        signals: int = 1,
    ) -> None:
        self.settings = settings
        self.rate_hz = rate_hz
        self.clock = SampleClock()
        self.history = SampleHistory(signals, channels)
        #: The ratio sample by sample, where onsets are not refined.
        self._ratios = SampleHistory(1, channels) if settings.refine == "none" else None
        self._channels = channels
        self._length = cell_length(rate_hz)
        cell_s = self._length / rate_hz
        gap = max(1, round(settings.gap_s / cell_s))
        self._ratio = NoiseRatio(noise(cell_s), gap, settings.warm_up_s / cell_s)
        reach = max(1, round(settings.separation_s / cell_s))
        back = round(settings.back_s / cell_s)
        self._maxima = LocalMaxima(channels, reach, settings.floor, back)
        self._trace = FrameTrace(1 / cell_s, channels)
        self._whole_frames = WholeFrames(self._trace.length * self._length)
        self._begun = False
        self.frames = self._trace.signal
        self._reached: tuple[CompleteCells, NDArray[np.float64]] | None = None
        self._waiting = LocalMaximaWithOnset.none()  # maxima whose AIC windows are open
        self._pending = NOTHING
        self._back = round(settings.back_s * rate_hz)
        self._windows = np.rint(np.array(settings.windows_s) * rate_hz).astype(np.intp)
        before, self._after = (int(most) for most in self._windows.max(axis=0))
        self._before = self._back + before

    def begun(self, block: SignalBlock) -> SignalBlock:
        """Count in the next block of the run; return it from the run's first whole frame on."""
        block = self._whole_frames.of(block)
        if len(block):
            if not self._begun:
                self._ratio.begin_at(block.first // self._length)
            self._begun = True
            self.clock.add(block)
        return block

    def nothing(self) -> Measured:
        """Return what a block without a whole frame brings."""
        return Measured(NOTHING, self._trace.nothing())

    def take(self, cells: CompleteCells, level: Levels) -> Measured:
        """Take the cells that are complete by now, after the samples were added to the history.

        ``level`` is as :meth:`curve` takes it.
        """
        if not len(cells):
            self._reached = (cells, cells.level)
            return self.nothing()
        ratio = self._ratio(cells.level)
        self._reached = (cells, ratio)
        if self._ratios is not None and (curve := self.curve(level)) is not None:
            self._ratios.append(curve.value.T)
        start, stop, step = self._trace.begins(len(cells)).indices(len(cells))
        begins = np.arange(cells.first + start, cells.first + stop, step)
        frames = self._trace.take(self.clock.at(begins * self._length), ratio, cells.frames)
        return Measured(self._candidates(ratio, final=False), frames)

    def curve(self, level: Levels) -> Curve | None:
        """Return the decision function over the samples of the last complete cells.

        Its largest value within a cell is the cell's ratio, which candidates have.

        Parameters
        ----------
        level
            Gives the level of samples ``[start, stop)`` of the run, shape (n, n_channels).
        """
        if self._reached is None:
            return None
        cells, ratio = self._reached
        start = cells.first * self._length
        stop = start + len(cells) * self._length
        scale = np.divide(ratio, cells.level, out=np.zeros_like(ratio), where=cells.level > 0)
        by_cell = level(start, stop).reshape(len(cells), self._length, self._channels)
        value = (by_cell * scale.T[:, np.newaxis]).reshape(stop - start, self._channels)
        return Curve(self.clock.at(np.arange(start, stop)), value)

    def flush(self) -> Measured:
        """End the run: the last cells count although nothing follows them."""
        candidates = self._candidates(np.empty((self._channels, 0)), final=True)
        return Measured(candidates, self._trace.flush())

    def _candidates(self, ratio: NDArray[np.float64], *, final: bool) -> Candidates:
        waiting = self._waiting.and_then(self._maxima.add(ratio, final=final))
        closed = self.history.end - self._after
        # in the order of their cells: those whose windows are open are the last
        ready = int(np.searchsorted((waiting.peak + 1) * self._length, closed, side="right"))
        ready = len(waiting.peak) if final else ready
        self._waiting = waiting.part(slice(ready, None))
        if ready:
            self._pending = self._refined(waiting.part(slice(ready)))
        return self._pending if final else self._release()

    def _release(self) -> Candidates:
        """Give out what no later candidate can precede, and forget the samples before that."""
        peaks = self._waiting.peak
        next_cell = int(peaks[0]) if len(peaks) else self._maxima.settled
        earliest = next_cell * self._length - self._before - 1
        if earliest <= self.history.first:
            return NOTHING
        horizon_ns = self.clock.time_of(earliest)
        self.history.drop_before(earliest)
        if self._ratios is not None:
            self._ratios.drop_before(earliest)
        self.clock.discard_before(min(earliest, self._reached_from()))
        count = int(np.searchsorted(self._pending.time_ns, horizon_ns, side="left"))
        if not count:
            return NOTHING
        released, self._pending = (
            self._pending.rows(slice(count)),
            self._pending.rows(slice(count, None)),
        )
        return released

    def _reached_from(self) -> int:
        """Return the sample from which the curve can be asked for."""
        return 0 if self._reached is None else self._reached[0].first * self._length

    def _refined(self, rises: LocalMaximaWithOnset) -> Candidates:
        """Return the pending candidates, and those at the onsets of rises."""
        if self._ratios is not None:
            anchor = self._first_over(rises, self._ratios)
            onset, deviation = np.zeros(len(anchor)), np.full(len(anchor), np.nan)
        else:
            correlation = self.settings.correlation_s * self.rate_hz
            anchor = self._anchors(rises)
            onset, deviation = mean_onsets(
                self.history, anchor, rises.channel, self._windows, correlation
            )
        onset_sample = np.floor(onset)
        after_ns = np.rint((onset - onset_sample) * NS_PER_S / self.rate_hz).astype(np.int64)
        time_ns = np.concatenate(
            [self._pending.time_ns, self.clock.at(anchor + onset_sample.astype(np.intp)) + after_ns]
        )
        channel = np.concatenate([self._pending.channel, rises.channel.astype(np.int32)])
        value = np.stack([rises.value, deviation / self.rate_hz], axis=1)
        # behind a channel that was still a ratio has no bound
        value = np.minimum(value, np.finfo(np.float32).max).astype(np.float32)
        order = np.lexsort((channel, time_ns))
        value = np.concatenate([self._pending.value, value])[order]
        return Candidates(time_ns[order], channel[order], value)

    def _first_over(self, rises: LocalMaximaWithOnset, ratios: SampleHistory) -> Indices:
        """Return the first sample of each rise at which the ratio is over the floor."""
        rows, length = ratios.rows(), self._length
        crossings = rises.begin * length
        for i, (begin, peak, channel) in enumerate(
            zip(crossings.tolist(), rises.peak.tolist(), rises.channel.tolist(), strict=True)
        ):
            rise_ratio = rows[begin - ratios.first : (peak + 1) * length - ratios.first, channel]
            crossings[i] = begin + int(np.argmax(rise_ratio > self.settings.floor))
        return np.asarray(crossings, np.intp)

    def _anchors(self, rises: LocalMaximaWithOnset) -> NDArray[np.intp]:
        """Return the sample around which each onset is looked for."""
        length, channel = self._length, rises.channel
        if self.settings.anchor == "rise":
            return rises.begin * length
        width = self._back + length
        stop = (rises.peak + 1) * length
        index = stop[:, None] - width + np.arange(width)
        index = np.maximum(index, self.history.first)
        drive = np.abs(self.history.rows(-1)[index - self.history.first, channel[:, None]])
        return np.asarray(index[np.arange(len(stop)), drive.argmax(axis=1)])


def mean_onsets(
    history: SampleHistory, anchor: Indices, channel: Indices, windows: Indices, correlation: float
) -> Array:
    """Return onset and deviation, the mean over windows around each anchor: shape (2, m), samples.

    Onsets are counted from their anchors on: so their rounding does not depend on how long the run
    is.

    Parameters
    ----------
    history
        Of the signal. A window that reaches over it is shorter, not padded.
    anchor, channel
        Shape (m,): a sample of the run, and its channel.
    windows
        Shape (k, 2): how many samples before and after the anchor.
    correlation
        Correlation length of the signal [samples].
    """
    onset, variance = np.zeros(len(anchor)), np.zeros(len(anchor))
    for before, after in windows:
        start = np.maximum(anchor - before, history.first)
        length = np.minimum(anchor + 1 + after, history.end) - start
        picks = kernels.picker.onsets(
            history.rows(), start - history.first, length, channel, correlation
        )
        onset += (start - anchor) + picks[0]
        variance += picks[1] ** 2
    return np.stack([onset / len(windows), np.sqrt(variance / len(windows))])
