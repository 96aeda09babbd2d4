"""The rhythm of walking: how strongly a signal repeats itself, and after which time.

A signal that repeats after a period correlates with itself shifted by one, two and three periods.
The mean of these correlations, maximised over the period, separates walking from arms that move
without steps: a gesture may look like its neighbour, but not like the next three. Amplitudes are
clipped at a multiple of their median, so that one large gesture does not hide the steps in it.
The documents leave the walking decision open; method and numbers are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .even_grid import GRID_HZ, Kept

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

#: Points of the grid from one window to the next.
HOP = 10
#: Shortest and longest period that is tried [s]: from the step of a runner to the stride of a
#: walker or the step of one who walks slowly.
PERIODS_S = (0.36, 1.3)
#: The repetitions must fit in this part of the window.
_FITS = 0.6
#: Amplitudes are clipped at this multiple of their median.
_CLIP = 1.5
#: What part of a period must correlate by, as a part of what the period does, to be its step:
#: more than this at a third; at a half more than minus this, because nearly always a long period is
#: a stride, however much more one foot or one arm swings.
_PART = 0.5
#: Shortest run in which a rhythm can be told [s].
_SHORTEST_S = 2.6
#: Peak to peak of a sinusoid as a multiple of the median of its absolute values.
_SWING = 2.0 * np.sqrt(2.0)
#: Step time where there is no rhythm at all [s].
USUAL_STEP_S = 0.55


@dataclass(frozen=True, slots=True)
class Scale:
    """A length over which the rhythm is judged.

    Attributes
    ----------
    window_s
        Length of the window [s].
    repeats
        How many periods on the signal must repeat itself.
    """

    window_s: float
    repeats: int

    @property
    def points(self) -> int:
        """Points of the grid in a window."""
        return round(self.window_s * GRID_HZ)


def autocorrelations(windows: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """Return the correlations of windows, shape (m, n), with themselves shifted by 0 to ``lags``.

    Each is divided by the energies of the two parts that overlap, so that a perfect rhythm gives 1
    at all multiples of its period. Shape (m, lags + 1).
    """
    count, length = windows.shape
    limit = _CLIP * np.median(np.abs(windows), axis=1, keepdims=True)
    x = np.clip(windows, -limit, limit)
    x = x - x.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(x, 2 * length, axis=1)
    products = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, axis=1)[:, : lags + 1]
    energy = np.concatenate([np.zeros((count, 1)), np.cumsum(x * x, axis=1)], axis=1)
    head = energy[:, length - np.arange(lags + 1)]
    tail = energy[:, -1:] - energy[:, : lags + 1]
    return np.asarray(products / np.sqrt(head * tail + 1e-9))


def repetition(window: NDArray[np.float64], repeats: int) -> tuple[float, float]:
    """Return how strongly a window repeats itself (at most 1), and its step time [s].

    -1 and the usual step time where no period stands out.
    """
    (found,) = repetitions(window[None, :], repeats)
    return found


def repetitions(windows: NDArray[np.float64], repeats: int) -> list[tuple[float, float]]:
    """Return what :func:`repetition` says of each of some windows, shape (m, n)."""
    longest_s = min(PERIODS_S[1], _FITS * windows.shape[1] / GRID_HZ / repeats)
    periods = np.arange(int(PERIODS_S[0] * GRID_HZ), int(longest_s * GRID_HZ) + 1)
    if len(periods) < 3 or not len(windows):
        return [(-1.0, USUAL_STEP_S)] * len(windows)
    correlation = autocorrelations(windows, repeats * int(periods[-1]))
    comb = np.mean([correlation[:, k * periods] for k in range(1, repeats + 1)], axis=0)
    inner = comb[:, 1:-1]
    peak = (inner > comb[:, :-2]) & (inner >= comb[:, 2:])
    best = np.where(peak, inner, -np.inf).argmax(axis=1) + 1
    some = peak.any(axis=1).tolist()
    return [
        (strength, _step_s(row, period, strength)) if stands else (-1.0, USUAL_STEP_S)
        for row, period, strength, stands in zip(
            correlation,
            periods[best].tolist(),
            comb[np.arange(len(comb)), best].tolist(),
            some,
            strict=True,
        )
    ]


def _step_s(correlation: NDArray[np.float64], period: int, strength: float) -> float:
    """Return the step time that a period of so many points stands for [s].

    The correlations at a step and at a stride tell the two apart (Moe-Nilssen and Helbostad, J.
    Biomechanics 37, 2004): at half a period, the even harmonics count positive and the odd ones
    negative. Of a stride, two steps, the even ones are strong; a step of one who walks slowly has
    little but its first. Three steps of a fast walker fit in a long period, too.
    """
    half, third = _between(correlation, period / 2), _between(correlation, period / 3)
    steps = 1
    if period >= 3 * PERIODS_S[0] * GRID_HZ and third > _PART * strength:
        steps = 3
    elif period >= 2 * PERIODS_S[0] * GRID_HZ and half > -_PART * strength:
        steps = 2
    return period / steps / GRID_HZ


def _between(values: NDArray[np.float64], place: float) -> float:
    """Return the value at a place, on the straight line between its neighbours."""
    before = int(place)
    low, high = values[before : before + 2].tolist()
    return float((high - low) * (place - before) + low)


class Rhythm:
    """Follows the rhythm of a signal on the grid, one value every :data:`HOP` points.

    The rhythm at a time is that of the best window of each scale in which the time lies, so that a
    walk is recognised from its first step to its last. What chance gives falls with the square
    root of the window's length; longer windows are weighted by as much.

    Parameters
    ----------
    scales
        The first also gives the step time.
    ahead_s
        How far ahead of a time its windows may reach [s], the first ones of a run excepted.
    """

    def __init__(self, scales: Sequence[Scale], ahead_s: float) -> None:
        self.scales = tuple(scales)
        self.ahead = round(ahead_s * GRID_HZ) // HOP
        self._signal = Kept()
        self._found: list[Kept] = [Kept(3) for _ in self.scales]  # as a hop, by window
        self._next = 0

    def __call__(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take values of the grid, shape (1, n); return strength, step time and swing by hop."""
        self._signal.add(signal)
        for scale, found in zip(self.scales, self._found, strict=True):
            count = (self._signal.end - scale.points) // HOP + 1
            if count > found.end:
                found.add(self._windows(found.end, count, scale))
        self._signal.forget_before(HOP * min(found.end for found in self._found))
        known = min(map(self._known, self.scales, self._found))
        return self._until(known)

    def finish(self) -> NDArray[np.float64]:
        """Return the values up to the end of the signal."""
        shortest = round(_SHORTEST_S * GRID_HZ)
        for scale, found in zip(self.scales, self._found, strict=True):
            if not found.end and self._signal.end >= shortest:
                found.add(self._windows(0, 1, scale))
        return self._until(-(-self._signal.end // HOP) + 1)

    def _windows(self, start: int, end: int, scale: Scale) -> NDArray[np.float64]:
        """Return strength, step time and swing of windows ``[start, end)``, shape (3, n)."""
        signal = self._signal.between(start * HOP, (end - 1) * HOP + scale.points)[0]
        length = min(scale.points, len(signal))
        windows = np.lib.stride_tricks.sliding_window_view(signal, length)[::HOP]
        found = np.array(repetitions(windows, scale.repeats)).reshape(-1, 2)
        longer = length / GRID_HZ / self.scales[0].window_s
        swing = _SWING * np.median(np.abs(windows), axis=1)
        return np.stack([found[:, 0] * np.sqrt(longer), found[:, 1], swing])

    def _last(self, hop: int, scale: Scale) -> int:
        """Return the last window that counts at a hop."""
        return min(hop, max(0, hop + self.ahead - scale.points // HOP))

    def _known(self, scale: Scale, found: Kept) -> int:
        """Return the first hop that needs a window which is not there yet."""
        if not found.end:
            return 0
        return max(found.end, found.end + scale.points // HOP - self.ahead)

    def _until(self, end: int) -> NDArray[np.float64]:
        """Return the next values, up to hop ``end``."""
        hops = range(self._next, end)
        values = np.array([self._at(hop) for hop in hops]).reshape(-1, 3).T
        self._next = max(self._next, end)
        for scale, found in zip(self.scales, self._found, strict=True):
            found.forget_before(min(self._next - 1 - scale.points // HOP, found.end - 1))
        return values

    def _at(self, hop: int) -> tuple[float, float, float]:
        strongest, step_s, swing = 0.0, USUAL_STEP_S, 0.0
        for index, (scale, found) in enumerate(zip(self.scales, self._found, strict=True)):
            last = min(self._last(hop, scale), found.end - 1)
            windows = found.between(min(hop - 1 - scale.points // HOP, last), last + 1)
            if windows.shape[1]:
                best = int(np.argmax(windows[0]))
                strength, its_step_s, its_swing = windows[:, best].tolist()
                step_s = its_step_s if index == 0 else step_s
                if strength > strongest:
                    strongest, swing = strength, its_swing
        return strongest, step_s, swing
