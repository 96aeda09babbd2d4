"""Filters that run on blocks of any length and give the same samples as one run over the whole.

A signal can also be looked at sample by sample, each once its surroundings are there: what is
measured at a sample then depends on the samples around it alone, not on the blocks they came in.

scipy.signal designs such filters and runs them, too, but imports all of statistics, optimisation
and interpolation for it, most of a second before the first sample: what is needed of it is here and
in :mod:`.kernels.filters`, in scipy's order of operations, to scipy's bits.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from .. import kernels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock


#: Highest usable corner as a part of the sampling rate: a corner at Nyquist cannot be designed.
#: Chosen by judgement: a tenth below Nyquist.
HIGHEST_CORNER = 0.45


def planar(block: SignalBlock) -> NDArray[np.float64]:
    """Return a block's values channel by channel, shape (n_channels, n_samples), contiguous."""
    scales = block.stream.scales
    return np.ascontiguousarray(block.samples.T, dtype=np.float64) * scales[:, None]


def corner(hz: float, rate_hz: float) -> float:
    """Return a corner frequency that can be designed at ``rate_hz`` [Hz]."""
    return min(hz, HIGHEST_CORNER * rate_hz)


def butterworth(
    order: int, edges_hz: Sequence[float], rate_hz: float, *, highpass: bool = False
) -> NDArray[np.float64]:
    """Design a digital Butterworth filter by the bilinear transform.

    Source: T. W. Parks, C. S. Burrus, Digital Filter Design, 1987, chapter 7: the poles of the
    analogue low-pass, moved to the corners, which are warped before.

    Parameters
    ----------
    order
        Of the analogue low-pass, at least 1; a band-pass has twice as many poles.
    edges_hz
        The corner, or both of a band-pass [Hz], rising, within 0 < f < rate / 2.
    rate_hz
        Sampling rate [Hz].
    highpass
        With one corner: let pass what lies above it.

    Returns
    -------
    Second-order sections, shape (n_sections, 6); the poles nearest to the unit circle come last.
    """
    return _designed(order, tuple(edges_hz), rate_hz, highpass=highpass).copy()


@cache
def _designed(
    order: int, edges_hz: tuple[float, ...], rate_hz: float, *, highpass: bool
) -> NDArray[np.float64]:
    warped = 4.0 * np.tan(np.pi * (np.asarray(edges_hz, np.float64) / (rate_hz / 2)) / 2.0)
    poles = -np.exp(1j * np.pi * np.arange(1.0 - order, order, 2) / (2 * order))
    zeros = np.zeros(0 if len(warped) == 1 and not highpass else order)
    if len(warped) == 2:
        width, middle = float(warped[1] - warped[0]), float(np.sqrt(warped[0] * warped[1]))
        poles = poles * width / 2
        apart = np.sqrt(poles**2 - middle**2)
        poles, gain = np.concatenate([poles + apart, poles - apart]), width**order
    elif highpass:
        poles, gain = float(warped[0]) / poles, float(np.real(1.0 / np.prod(-poles)))
    else:
        poles, gain = float(warped[0]) * poles, float(warped[0]) ** order
    return _bilinear(zeros, poles, gain)


#: Poles of the analogue Bessel low-pass 3 / (s^2 + 3 s + 3), whose power is a half at 1 rad/s once
#: they are over the root of (sqrt(45) - 3) / 2. Source: the equations.
BESSEL = np.array([-1.5 + 0.75**0.5 * 1j, -1.5 - 0.75**0.5 * 1j]) / ((45**0.5 - 3) / 2) ** 0.5


def bessel(corner_hz: float, rate_hz: float) -> NDArray[np.float64]:
    """Design a digital Bessel low-pass of order 2, whose delay hardly depends on frequency.

    Source: W. E. Thomson, Delay networks having maximally flat frequency characteristics, Proc. IEE
    96 (1949), by the bilinear transform.

    Parameters
    ----------
    corner_hz
        Where the power is a half [Hz], within 0 < f < rate / 2.
    rate_hz
        Sampling rate [Hz].

    Returns
    -------
    Second-order sections, shape (1, 6).
    """
    poles = 4.0 * np.tan(np.pi * corner_hz / rate_hz) * BESSEL
    return _bilinear(np.zeros(0), poles, float(np.abs(poles[0]) ** 2))


def _bilinear(
    zeros: NDArray[np.float64], poles: NDArray[np.complex128], gain: float
) -> NDArray[np.float64]:
    """Return analogue zeros, poles and gain as digital sections at a rate of 2 Hz."""
    gain = gain * float(np.real(np.prod(4.0 - zeros) / np.prod(4.0 - poles)))
    nyquist = np.full(len(poles) - len(zeros), -1.0)
    zeros = np.concatenate([(4.0 + zeros) / (4.0 - zeros), nyquist])
    sections = _sections(zeros, (4.0 + poles) / (4.0 - poles))
    sections[0, :3] *= gain
    return sections


def _sections(zeros: NDArray[np.float64], poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Pair poles, the nearest to the unit circle first, with the zeros nearest to them."""
    if len(poles) % 2:
        zeros, poles = np.append(zeros, 0.0), np.append(poles, 0.0)
    sections = np.zeros((len(poles) // 2, 6))
    upper, real = poles[poles.imag > 0], poles[poles.imag == 0]
    upper = upper[np.lexsort((upper.imag, upper.real))]
    left = [*upper.tolist(), *np.sort(real.real).tolist()]
    zeros = np.sort(zeros)
    for section in sections[::-1]:
        pair = [left.pop(_nearest_circle(left))]
        if isinstance(pair[0], complex):
            pair.append(pair[0].conjugate())
        else:
            reals = [i for i, pole in enumerate(left) if not isinstance(pole, complex)]
            pair.append(left.pop(reals[_nearest_circle([left[i] for i in reals])]))
        near = []
        for _ in range(2):
            index = int(np.argmin(np.abs(zeros - pair[0])))
            near.append(zeros[index])
            zeros = np.delete(zeros, index)
        section[:] = [*np.poly(near), *np.poly(pair)]
    return sections


def _nearest_circle(poles: Sequence[complex]) -> int:
    return int(np.argmin(np.abs(1 - np.abs(poles))))


def steady_state(sos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what second-order sections hold after a long row of ones, shape (n_sections, 2)."""
    states = np.empty((len(sos), 2))
    scale = 1.0
    for section, state in zip(sos, states, strict=True):
        b, a = section[:3], section[3:]
        state[:] = np.linalg.solve([[1 + a[1], -1.0], [a[2], 1.0]], b[1:] - a[1:] * b[0]) * scale
        scale *= b.sum() / a.sum()
    return states


def bandpass(low_hz: float, high_hz: float, rate_hz: float, order: int = 2) -> NDArray[np.float64]:
    """Design a Butterworth band-pass; a band edge that cannot be had is left out.

    Parameters
    ----------
    low_hz
        Lower corner [Hz]; 0 leaves it out.
    high_hz
        Upper corner [Hz]; 0, or one above 0.45 of the rate, leaves it out.
    rate_hz
        Sampling rate [Hz].
    order
        Order of each edge.

    Returns
    -------
    Second-order sections, shape (n_sections, 6); a unit section where both edges are left out.
    """
    has_high = 0 < high_hz <= HIGHEST_CORNER * rate_hz
    has_low = 0 < low_hz < HIGHEST_CORNER * rate_hz
    if has_low and has_high and low_hz < high_hz:
        return butterworth(order, (low_hz, high_hz), rate_hz)
    if has_low or has_high:
        edge_hz = low_hz if has_low else high_hz
        return butterworth(order, (edge_hz,), rate_hz, highpass=has_low)
    return np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])


#: What a recursive filter holds of the past is nothing after its slowest part has fallen by so many
#: factors of e. Source: arithmetic, e^45 is 3e19: a thousandth of the rounding of a double.
FORGOTTEN = 45.0


def forgotten_s(low_hz: float, high_hz: float, order: int = 2) -> float:
    """Return after how long :func:`bandpass` has forgotten what was before, at any rate [s].

    Of the analogue filter, whose poles the digital one has: the slowest of all that the rate may
    leave of it, with both edges or with one.
    """
    prototype = -np.exp(1j * np.pi * np.arange(1.0 - order, order, 2) / (2 * order))
    edges = [2 * np.pi * hz for hz in (low_hz, high_hz) if hz > 0]
    slowest = [edge * float(-prototype.real.max()) for edge in edges]
    if 0 < low_hz < high_hz:
        half = prototype * (edges[1] - edges[0]) / 2
        apart = np.sqrt(half**2 - edges[0] * edges[1])
        slowest.append(float(-np.concatenate([half + apart, half - apart]).real.max()))
    return FORGOTTEN / min(slowest) if slowest else 0.0


def phase_delay_s(sos: NDArray[np.float64], frequency_hz: float, rate_hz: float) -> float:
    """Return by how much ``sos`` delays a sinusoid of ``frequency_hz`` [s]."""
    phasors = np.exp(-2j * np.pi * frequency_hz / rate_hz * np.arange(3))
    response = np.prod(sos[:, :3] @ phasors / (sos[:, 3:] @ phasors))
    return float(-np.angle(response) / (2 * np.pi * frequency_hz))


def _rows(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a block as kernels take it."""
    return np.ascontiguousarray(x, np.float64)


class StreamingFilter:
    """Second-order sections over blocks, state kept in float64.

    It starts in the steady state of the first sample, so that an offset rings no bell.

    Parameters
    ----------
    sos
        Shape (n_sections, 6).
    """

    def __init__(self, sos: NDArray[np.float64]) -> None:
        self.sos = sos
        self.zi: NDArray[np.float64] | None = None

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Filter a block, shape (n_channels, n_samples); return the same shape."""
        if x.shape[1] == 0:
            return x
        if self.zi is None:
            settled = steady_state(self.sos)[:, None, :] * x[None, :, :1]
            self.zi = np.ascontiguousarray(settled)
        y = np.empty(x.shape)
        kernels.filters.sections(_rows(x), self.sos, self.zi, y)
        return y


class ExponentialMean:
    """Recursive mean ``m += coefficient * (x - m)`` over blocks, one per channel, from 0.

    Parameters
    ----------
    coefficient
        Forgetting factor, 0 < coefficient <= 1.
    """

    def __init__(self, coefficient: float) -> None:
        self.coefficient = coefficient
        self._memory: NDArray[np.float64] | None = None

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average a block, shape (n_channels, n_samples)."""
        if self._memory is None:
            self._memory = np.zeros(len(x))
        means = np.empty(x.shape)
        kernels.filters.recursive_means(_rows(x), self.coefficient, self._memory, means)
        return means


class UnbiasedMean:
    """Exponential mean divided by the sum of its weights: right from the first sample on.

    Parameters
    ----------
    memory
        Number of samples after which a weight has fallen to 1/e.
    """

    def __init__(self, memory: float) -> None:
        self._keep = float(np.exp(-1 / memory))
        self._mean = ExponentialMean(1 - self._keep)
        self._count = 0

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average a block, shape (n_channels, n_samples)."""
        index = np.arange(self._count + 1, self._count + x.shape[1] + 1)
        self._count += x.shape[1]
        return self._mean(x) / (1 - self._keep**index)


class WeightedSums:
    """Sums of the last samples by weights, over blocks, one per channel.

    Parameters
    ----------
    weights
        Shape (k,): of the newest sample first.
    at_rest
        Before its first sample a signal was as that is; else it was 0.
    """

    def __init__(self, weights: NDArray[np.float64], *, at_rest: bool = False) -> None:
        self.weights = np.array(weights, np.float64)
        self._at_rest = at_rest
        self._memory: NDArray[np.float64] | None = None

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add up a block, shape (n_channels, n_samples)."""
        if x.shape[1] == 0:
            return x
        if self._memory is None:
            self._memory = np.zeros((len(x), len(self.weights)))
            if self._at_rest:
                self._memory[:, :-1] = x[:, :1] * np.cumsum(self.weights[:0:-1])[::-1]
        sums = np.empty(x.shape)
        kernels.filters.weighted(_rows(x), self.weights, self._memory, sums)
        return sums


class SmoothedSlope:
    """Centred slope of a signal smoothed by a Hann window: linear phase, so no delay remains.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    smooth_s
        Full length of the smoothing window [s].
    slope_s
        Distance of the two points of the slope [s].
    """

    def __init__(self, rate_hz: float, smooth_s: float, slope_s: float) -> None:
        half = round(smooth_s * rate_hz / 2)
        window = np.hanning(2 * half + 3)[1:-1]
        reach = max(1, round(slope_s * rate_hz / 2))
        ends = np.zeros(2 * reach + 1)
        ends[0], ends[-1] = 1.0, -1.0
        self.kernel = np.convolve(window / window.sum(), ends / (2 * reach))
        self.delay = len(self.kernel) // 2
        #: The same of what the signal rises by: no offset of it rounds the slope.
        self._slopes = WeightedSums(np.cumsum(self.kernel))
        self._last: NDArray[np.float64] = np.empty(0)
        self._signal: NDArray[np.float64] = np.empty((0, 0))
        self._skip = self.delay

    def __call__(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Take a signal, shape (n_channels, n).

        Returns
        -------
        Signal and slope of the samples whose slope is complete, aligned; before the run the signal
        is taken to have been constant.
        """
        if x.shape[1] == 0:
            return x, x
        if not self._last.size:
            self._last = x[:, :1]
            self._signal = np.empty((x.shape[0], 0))
        slope = self._slopes(np.diff(x, prepend=self._last))
        self._last = x[:, -1:]
        skipped = min(self._skip, x.shape[1])
        self._skip -= skipped
        slope = slope[:, skipped:]
        x = np.concatenate([self._signal, x], axis=1)
        done = slope.shape[1]
        self._signal = x[:, done:]
        return x[:, :done], slope

    def flush(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what the last samples lack; after the run the signal is taken to be constant."""
        waiting = self._signal.shape[1]
        if not waiting:
            return self._signal, self._signal
        x, slope = self(np.repeat(self._signal[:, -1:], self.delay, axis=1))
        return x[:, :waiting], slope[:, :waiting]


class SampleClock:
    """Times of a run's samples by their index from its first block on.

    The anchor of the times may move from block to block: the source follows small steps of a clock.
    """

    def __init__(self) -> None:
        self._count = 0
        self._period_ns = 0.0
        self._starts = [0]  # index from which an anchor holds
        self._anchors = [(0, 0)]  # time of the anchor, and which index before ours it counts from

    def add(self, block: SignalBlock) -> None:
        """Count in a block of the run."""
        anchor = (block.anchor_ns, block.first - self._count)
        self._period_ns = block.stream.period_ns
        if not self._count or self._anchors[-1] != anchor:
            count = len(self._anchors) if self._count else 0
            self._starts[count:], self._anchors[count:] = [self._count], [anchor]
        self._count += len(block)

    def at(self, index: NDArray[np.intp]) -> NDArray[np.int64]:
        """Return the times of samples [ns], shape (n,), as their blocks have them."""
        blocks = np.maximum(np.searchsorted(self._starts, index, side="right") - 1, 0)
        anchor_ns, before = np.array(self._anchors, np.int64)[blocks].T
        return np.asarray(anchor_ns + np.rint((index + before) * self._period_ns).astype(np.int64))

    def time_of(self, index: int) -> int:
        """Return the time of one sample [ns]."""
        anchor = self._anchors[max(0, bisect_right(self._starts, index) - 1)]
        return anchor[0] + round((index + anchor[1]) * self._period_ns)

    def discard_before(self, index: int) -> None:
        """Forget anchors of samples before one."""
        while len(self._starts) > 1 and self._starts[1] <= index:
            del self._starts[0], self._anchors[0]


class SampleHistory:
    """The last samples of a few signals, by their index in the run; the memory is used again.

    Parameters
    ----------
    signals
        How many signals each channel has.
    channels
        Number of channels.

    Attributes
    ----------
    first, end
        Index of the first sample kept, and just after the last.
    """

    def __init__(self, signals: int, channels: int) -> None:
        self.first = 0
        self.end = 0
        self._begin = 0  # row of the first sample kept
        self._rows = np.empty((signals, 0, channels))

    def extend(self, samples: int) -> None:
        """Make room for some more samples; they are written by :meth:`recent`."""
        stored = self.end - self.first
        if self._begin + stored + samples > self._rows.shape[1]:
            signals, room, channels = self._rows.shape
            # little more than a block stays near in the caches, and yet what is kept moves seldom
            wanted = max(room, 4 * stored + samples)
            rows = self._rows if wanted == room else np.empty((signals, wanted, channels))
            rows[:, :stored] = self._rows[:, self._begin : self._begin + stored]
            self._rows, self._begin = rows, 0
        self.end += samples

    def append(self, *signals: NDArray[np.float64]) -> None:
        """Take samples of every signal, each (n_channels, n)."""
        n = signals[0].shape[1]
        self.extend(n)
        for index, signal in enumerate(signals):
            self.recent(n, index)[:] = signal.T

    def recent(self, samples: int, signal: int = 0) -> NDArray[np.float64]:
        """Return the last samples of a signal, shape (n, n_channels): a view."""
        return self.between(self.end - samples, self.end, signal)

    def rows(self, signal: int = 0) -> NDArray[np.float64]:
        """Return what is kept of a signal, shape (n, n_channels): a view."""
        return self.between(self.first, self.end, signal)

    def between(self, start: int, stop: int, signal: int = 0) -> NDArray[np.float64]:
        """Return samples ``[start, stop)`` of a signal, shape (n, n_channels): a view.

        What was dropped is there until more samples come.
        """
        begin = self._begin + start - self.first
        return self._rows[signal, begin : begin + stop - start]

    def drop_before(self, index: int) -> None:
        """Drop the samples before one; they are there until more samples come."""
        cut = max(0, index - self.first)
        self.first += cut
        self._begin += cut


class CentredWindow:
    """The last stretch of a few signals on one time axis.

    Parameters
    ----------
    rows
        Number of signals.
    before, after
        Samples kept before and after each that is looked at, at least 1; fewer at the ends of a
        run.
    """

    def __init__(self, rows: int, before: int, after: int) -> None:
        self.before, self.after = before, after
        self.times: NDArray[np.int64] = np.empty(0, np.int64)
        self.values: NDArray[np.float64] = np.empty((rows, 0))
        self._next = 0  # column of the first sample that was not looked at

    def add(self, times: NDArray[np.int64], values: NDArray[np.float64]) -> range:
        """Take samples, shapes (n,) and (n_rows, n); return the columns to look at now."""
        start = max(0, self._next - self.before)  # what no sample looks back to is dropped
        self.times = np.concatenate([self.times[start:], times])
        self.values = np.concatenate([self.values[:, start:], values], axis=1)
        first = self._next - start
        self._next = max(first, len(self.times) - self.after)
        return range(first, self._next)

    def flush(self) -> range:
        """Return the columns that are left; nothing comes after them."""
        first, self._next = self._next, len(self.times)
        return range(first, self._next)

    def around(self, column: int, reach: int) -> slice:
        """Return the columns at most ``reach`` away from one, as far as there are any."""
        return slice(max(0, column - reach), column + reach + 1)

    def maxima(self, columns: range, row: int = 0) -> NDArray[np.intp]:
        """Return those of the columns at which a signal has a local maximum."""
        x = self.values[row]
        low = max(columns.start, 1)
        high = max(low, min(columns.stop, len(x) - 1))
        inside = x[low:high]
        is_maximum = (inside > x[low - 1 : high - 1]) & (inside >= x[low + 1 : high + 1])
        return np.flatnonzero(is_maximum) + low


def level(values: NDArray[np.float64]) -> float:
    """Return the root of the mean square of a stretch of signal."""
    return float(np.sqrt(np.mean(values * values)))
