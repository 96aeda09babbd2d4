"""The base of arrival pickers: from a decision function to candidates with refined onsets.

A picker gives the level of its decision function, reduced to cells of about 1 ms; the ratio of a
cell to the noise level some time before it is the candidates' first column. Candidates are the
local maxima of that ratio.

Their onset is refined on the signal as recorded by the Akaike information criterion (AIC) of
variances: AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]) (Maeda 1985). Instead of the minimum
alone, the onset is the mean of k under Akaike weights exp(-(AIC - min) / 2), with the sum divided
by the signal's correlation length, since neighbouring samples are not independent. The spread of
the weights is the uncertainty of the onset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.filters import SampleClock, SampleHistory
from ..dsp.noise import CELL_S, LocalMaxima, LocalMaximaWithOnset, NoiseLevel, NoiseRatio
from ..kernels.compiling import inlined as compiled
from ..kernels.lanes import LANES, every, greater, put_row, row
from ..kernels.logarithms import ROUGHNESS, logarithm, rough_logarithm
from ..kernels.picker import times_of
from ..pipeline.gates import Candidates
from ..pipeline.stage import Curve, Measured
from .trace import FrameTrace

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from ..dsp.noise import CompleteCells

    Array = NDArray[np.float64]
    Indices = NDArray[np.intp]

COLUMNS = (Quantity("ratio", "1"), Quantity("uncertainty", "s"))
NOTHING = Candidates.empty(len(COLUMNS))


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
    """

    gap_s: float
    warm_up_s: float
    floor: float
    separation_s: float
    anchor: Literal["rise", "peak"]
    back_s: float
    windows_s: tuple[tuple[float, float], ...]
    correlation_s: float

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
        return cls(*shared, anchor, back_s, windows_s, correlation_s)


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
    clock, history
        Times and signals of the run; the picker adds to them before it tells the cells.
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
        self._channels = channels
        self._length = max(1, round(CELL_S * rate_hz))
        cell_s = self._length / rate_hz
        gap = max(1, round(settings.gap_s / cell_s))
        self._ratio = NoiseRatio(noise(cell_s), gap, settings.warm_up_s / cell_s)
        reach = max(1, round(settings.separation_s / cell_s))
        back = round(settings.back_s / cell_s)
        self._maxima = LocalMaxima(channels, reach, settings.floor, back)
        self._trace = FrameTrace(1 / cell_s, channels)
        self._reached: tuple[CompleteCells, NDArray[np.float64]] | None = None
        self._waiting = LocalMaximaWithOnset.none()  # maxima whose AIC windows are open
        self._held = NOTHING
        self._back = round(settings.back_s * rate_hz)
        self._windows = np.rint(np.array(settings.windows_s) * rate_hz).astype(np.intp)
        before, self._after = (int(most) for most in self._windows.max(axis=0))
        self._before = self._back + before

    def take(self, cells: CompleteCells) -> Measured:
        """Take the cells that are complete by now, after the samples were added to the history."""
        if not len(cells):
            self._reached = (cells, cells.level)
            return Measured(NOTHING, self._trace.nothing())
        ratio = self._ratio(cells.level)
        self._reached = (cells, ratio)
        start, stop, step = self._trace.begins(len(cells)).indices(len(cells))
        begins = np.arange(cells.first + start, cells.first + stop, step)
        rows = (ratio, cells.peak, cells.power, cells.high, cells.low)
        frames = self._trace.take(self.clock.at(begins * self._length), *rows)
        return Measured(self._candidates(ratio, final=False), frames)

    def curve(self, level: Callable[[int, int], NDArray[np.float64]]) -> Curve | None:
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

    def finish(self) -> Measured:
        """End the run: the last cells count although nothing follows them."""
        candidates = self._candidates(np.empty((self._channels, 0)), final=True)
        return Measured(candidates, self._trace.finish())

    def _candidates(self, ratio: NDArray[np.float64], *, final: bool) -> Candidates:
        waiting = self._waiting.and_then(self._maxima.add(ratio, final=final))
        closed = self.history.end - self._after
        # in the order of their cells: those whose windows are open are the last
        ready = int(np.searchsorted((waiting.peak + 1) * self._length, closed, side="right"))
        ready = len(waiting.peak) if final else ready
        self._waiting = waiting.part(slice(ready, None))
        if ready:
            self._held = self._refined(waiting.part(slice(ready)))
        return self._held if final else self._release()

    def _release(self) -> Candidates:
        """Give out what no later candidate can precede, and forget the samples before that."""
        peaks = self._waiting.peak
        next_cell = int(peaks[0]) if len(peaks) else self._maxima.settled
        earliest = next_cell * self._length - self._before - 1
        if earliest <= self.history.first:
            return NOTHING
        horizon_ns = self.clock.time_of(earliest)
        self.history.drop_before(earliest)
        self.clock.discard_before(min(earliest, self._reached_from()))
        count = int(np.searchsorted(self._held.time_ns, horizon_ns, side="left"))
        if not count:
            return NOTHING
        released, self._held = self._held.rows(slice(count)), self._held.rows(slice(count, None))
        return released

    def _reached_from(self) -> int:
        """Return the sample from which the curve can be asked for."""
        return 0 if self._reached is None else self._reached[0].first * self._length

    def _refined(self, rises: LocalMaximaWithOnset) -> Candidates:
        """Return the candidates that are held, and those at the onsets of rises."""
        held = (self._held.time_ns, self._held.channel, self._held.value)
        signal = (self.history.rows(), (self.history.first, self.history.end))
        new = (self._anchors(rises), rises.channel, rises.value)
        correlation = self.settings.correlation_s * self.rate_hz
        clock = (self.clock.table, self.rate_hz)
        return Candidates(*with_onsets(held, signal, new, self._windows, correlation, clock))

    def _anchors(self, rises: LocalMaximaWithOnset) -> NDArray[np.intp]:
        """Return the sample around which each onset is looked for."""
        length, channel = self._length, rises.channel
        if self.settings.anchor == "rise":
            return rises.begin * length
        width = self._back + length
        stop = (rises.peak + 1) * length
        index = stop[:, None] - width + np.arange(width)
        index = np.maximum(index, self.history.first)
        places = (channel[:, None] // LANES, index - self.history.first, channel[:, None] % LANES)
        drive = np.abs(self.history.rows(-1)[places])
        return np.asarray(index[np.arange(len(stop)), drive.argmax(axis=1)])


#: Samples at both ends of the window where a variance means nothing.
EDGE = 3
#: Least variance, so that there is a logarithm.
LEAST = 1e-300
#: A weight below exp(-WEIGHTLESS) changes no sum of weights, of which the largest is 1.
WEIGHTLESS = 60.0


@compiled
def _cut(line: Array, index: int, value: Any, end: int) -> Any:
    """Return a row of no less than zero, zero from element ``end`` of the line on."""
    put_row(line, index, greater(value, every(0.0)))
    for lane in range(LANES):
        if index * LANES + lane >= end:
            line[index, lane] = 0.0
    return row(line, index)


@compiled
def _rows_near_the_least(line: Array, n: int, margin: float) -> tuple[int, int]:
    """Return which rows, first and after the last, may have an AIC within a margin of the least.

    ``line`` are rough ones of a window of n samples, none of them above the true one.
    """
    first, last = EDGE, n - 2 - EDGE
    least = line[first]
    for i in range(first, last + 1):
        least = line[i] if line[i] < least else least
    limit = least + n * ROUGHNESS + margin
    while line[first] > limit:
        first += 1
    while line[last] > limit:
        last -= 1
    return first // LANES, last // LANES + 1


@compiled
def memory_of(n: int) -> Array:
    """Return memory for sums of windows of up to n samples, shape (7, at least n / LANES, LANES).

    Row 4 holds k = 1, 2, ..., row 5 their inverse, row 6 those of n - k as long as n is the same.
    """
    sums = np.ones((7, n // LANES + 1, LANES))
    k, inverse = sums[4].reshape(-1), sums[5].reshape(-1)
    for i in range(len(k)):
        k[i], inverse[i] = i + 1.0, 1.0 / (i + 1.0)
    return sums


@compiled
def _count_down(sums: Array, n: int) -> None:
    inverse, down = sums[5].reshape(-1), sums[6].reshape(-1)
    if down[0] == inverse[n - 2] and down[n - 2] == 1.0:
        return
    for i in range(len(down)):
        down[i] = inverse[n - 2 - i] if i < n - 1 else 0.0


@compiled
def criterion_of(window: Array, sums: Array, found: Array, margin: float) -> tuple[int, int]:
    """Write AIC(k) for k = 1 ... n-1 of a window of n samples into ``found``.

    ``found`` and the rows of ``sums``, as :func:`memory_of` has them, are used as lines.
    What is more than ``margin`` above the least, and lies before or after all that is not, is known
    roughly only: still above it, but up to n * ROUGHNESS too low.

    Returns
    -------
    Where, on that line, lies what is known, away from the ends of the window: first, after last.
    """
    n = len(window)
    _count_down(sums, n)
    total, square = sums[0].reshape(-1), sums[1].reshape(-1)
    first, all_of_x, all_of_squares = window[0], 0.0, 0.0
    for i in range(n):
        x = window[i] - first  # an offset would take the digits of the variance
        all_of_x += x
        all_of_squares += x * x
        total[i], square[i] = all_of_x, all_of_squares
    rows = (n - 2) // LANES + 1
    most, nothing = every(0.0), every(0.0)
    count, all_total, all_square = every(n * 1.0), every(all_of_x), every(all_of_squares)
    for i in range(rows):
        share, mean = row(sums[5], i), row(sums[0], i) * row(sums[5], i)
        put_row(sums[2], i, greater(row(sums[1], i) * share - mean * mean, nothing))
        share = row(sums[6], i)
        rest = (all_total - row(sums[0], i)) * share
        spread = (all_square - row(sums[1], i)) * share - rest * rest
        spread = greater(spread, nothing) if i + 1 < rows else _cut(sums[3], i, spread, n - 1)
        put_row(sums[3], i, spread)
        most = greater(spread, most)
    put_row(found, 0, most)
    least = every(max(1e-8 * found[0].max(), LEAST))
    for i in range(rows):
        k, before, after = row(sums[4], i), row(sums[2], i) + least, row(sums[3], i) + least
        put_row(sums[2], i, before)
        put_row(sums[3], i, after)
        put_row(found, i, k * rough_logarithm(before) + (count - k) * rough_logarithm(after))
    first_row, end = _rows_near_the_least(found.reshape(-1), n, margin)
    for i in range(first_row, end):
        k, before, after = row(sums[4], i), row(sums[2], i), row(sums[3], i)
        put_row(found, i, k * logarithm(before) + (count - k) * logarithm(after))
    return max(first_row * LANES, EDGE), min(end * LANES, n - 1 - EDGE)


@compiled
def _weighted(criterion: Array, start: int, stop: int, scale: float) -> tuple[float, float]:
    """Return mean and deviation of k under the weights exp(-scale AIC(k)) of some of the line."""
    least = criterion[start]
    for i in range(start, stop):
        least = criterion[i] if criterion[i] < least else least
    mass = place = 0.0
    first, last = stop, start
    for i in range(start, stop):
        distance = (criterion[i] - least) * scale
        criterion[i] = 0.0
        if distance < WEIGHTLESS:
            first, last = min(i, first), i
            criterion[i] = weight = np.exp(-distance)
            mass += weight
            place += weight * (i + 1)
    onset, spread = place / mass, 0.0
    for i in range(first, last + 1):
        spread += criterion[i] * (i + 1 - onset) ** 2
    return onset, np.sqrt(spread / mass)


@compiled
def lane_onsets(
    rows: Array, start: Indices, length: Indices, channel: Indices, correlation: float
) -> Array:
    """Return onset in each window, from its first sample on, and deviation: shape (2, m), samples.

    Parameters
    ----------
    rows
        Shape (n_groups, n, LANES): each window holds noise, then signal.
    start, length, channel
        Shape (m,): of each window. Windows that are too short for a variance on both sides (under
        9 samples) give their middle.
    correlation
        Correlation length of the signal [samples].
    """
    result, scale = np.empty((2, len(start))), 1.0 / (2.0 * max(correlation, 1.0))
    most = 0
    for i in range(len(length)):
        most = max(most, length[i])
    window, sums = np.empty(most), memory_of(most)
    criterion = np.empty(sums[0].shape)
    for i in range(len(start)):
        n, group, lane = length[i], channel[i] // LANES, channel[i] % LANES
        if n < 2 * EDGE + 3:
            result[0, i], result[1, i] = n / 2, n / np.sqrt(12.0)
            continue
        for k in range(n):
            window[k] = rows[group, start[i] + k, lane]
        known, end = criterion_of(window[:n], sums, criterion, WEIGHTLESS / scale)
        result[0, i], result[1, i] = _weighted(criterion.reshape(-1), known, end, scale)
    return result


@compiled
def mean_onsets(
    rows: Array,
    span: tuple[int, int],
    anchor: Indices,
    channel: Indices,
    windows: Indices,
    correlation: float,
) -> Array:
    """Return onset and deviation, the mean over windows around each anchor: shape (2, m), samples.

    Parameters
    ----------
    rows, span
        Shape (n_groups, n, LANES), and which samples of the run they are: first, and after the
        last. A window that reaches over them is shorter, not padded.
    anchor, channel
        Shape (m,): a sample of the run, and its channel.
    windows
        Shape (k, 2): how many samples before and after the anchor.
    correlation
        Correlation length of the signal [samples].
    """
    begin, end = span
    found = np.zeros((2, len(anchor)))
    for before, after in windows:
        start = np.maximum(anchor - before, begin)
        length = np.minimum(anchor + 1 + after, end) - start
        onset, deviation = lane_onsets(rows, start - begin, length, channel, correlation)
        found[0] += start + onset
        found[1] += deviation**2
    found[0] /= len(windows)
    found[1] = np.sqrt(found[1] / len(windows))
    return found


@compiled
def with_onsets(
    held: Any, signal: Any, rises: Any, windows: Indices, correlation: float, clock: Any
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Return candidates and new ones at refined onsets, in the order of (time, channel).

    Parameters
    ----------
    held
        Times, channels and values of candidates in that order, as of
        :class:`~.pipeline.gates.Candidates`: ratio, and deviation of the onset [s].
    signal, windows, correlation
        Rows and span, windows and correlation, as :func:`mean_onsets` takes them.
    rises
        Of the new ones: anchor and channel, as :func:`mean_onsets` takes them, and ratio, (m,).
    clock
        Anchors as :func:`~.kernels.picker.times_of` takes them, and rate [Hz].
    """
    (known_ns, known_channel, known_value), (anchors, rate_hz) = held, clock
    anchor, channel, ratio = rises
    onset, deviation = mean_onsets(signal[0], signal[1], anchor, channel, windows, correlation)
    whole = np.floor(onset).astype(np.intp)
    at_ns = times_of(whole, anchors, NS_PER_S / rate_hz)
    known, count = len(known_ns), len(known_ns) + len(ratio)
    time_ns, own = np.empty(count, np.int64), np.empty(count, np.int32)
    value = np.empty((count, 2), np.float32)
    time_ns[:known], own[:known], value[:known] = known_ns, known_channel, known_value
    for i in range(len(ratio)):
        at_ns[i] += np.int64(np.rint((onset[i] - whole[i]) * NS_PER_S / rate_hz))
        place = known + i
        while place and (time_ns[place - 1], own[place - 1]) > (at_ns[i], channel[i]):
            time_ns[place], own[place] = time_ns[place - 1], own[place - 1]
            value[place] = value[place - 1]
            place -= 1
        time_ns[place], own[place] = at_ns[i], channel[i]
        value[place, 0], value[place, 1] = ratio[i], deviation[i] / rate_hz
    return time_ns, own, value
