"""The rhythm of walking: how strongly a signal repeats itself, and after which time.

A signal that repeats after a period correlates with itself shifted by one, two and three periods.
The mean of these correlations, maximised over the period, separates walking from arms that move
without steps: a gesture may look like its neighbour, but not like the next three. Amplitudes are
clipped at a multiple of their median, so that one large gesture does not hide the steps in it. The
documents do not define the walking decision; method and numbers are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import kernels
from .resample import GRID_HZ, ColumnBuffer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


#: Points of the grid from one window to the next. Chosen by judgement: a rhythm is told four times
#: a second.
HOP = 10
#: Shortest and longest period that is tried [s]: from the step of a runner to the stride of a
#: walker or the step of one who walks slowly. Chosen by trial on mobgap and rieck-stepcounter: with
#: periods up to 1.7 s F1 falls from 0.946 to 0.938 and 0.901 to 0.895, and counts by 5 %; and on 15
#: people who jog: from 0.36 s on, runners lose a step in ten (docs/notebook/steps.md).
PERIODS_S = (0.28, 1.3)
#: The repetitions must fit in this part of the window. Chosen by judgement: the rest is
#: left to correlate over.
_FITS = 0.6
#: Amplitudes are clipped at this multiple of their median. Chosen by judgement: a hit does not
#: outweigh the steps.
_CLIP = 1.5
#: What part of a period must correlate by, as a part of what the period does, to be its step: more
#: than this at a third; at a half more than minus this, because nearly always a long period is a
#: stride, however much more one foot or one arm swings. Chosen by trial on rieck-stepcounter, among
#: 0, 0.25, 0.5 and 0.75 (docs/notebook/steps.md).
_PART = 0.5
#: Shortest run in which a rhythm can be told [s]. Source: definition, twice the longest period.
_SHORTEST_S = 2.6
#: Peak to peak of a sinusoid as a multiple of the median of its absolute values. Source:
#: definition: the median is 1 / sqrt(2) of the amplitude.
_SWING = 2.0 * np.sqrt(2.0)
#: Step time where there is no rhythm at all [s]. Chosen by judgement: of a usual walk.
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


def repetition(window: NDArray[np.float64], repeats: int) -> tuple[float, float]:
    """Return how strongly a window repeats itself (at most 1), and its step time [s].

    -1 and the usual step time where no period stands out.
    """
    strength, step_s, _ = repetitions(window, len(window), repeats)[:, 0].tolist()
    return strength, step_s


def repetitions(signal: NDArray[np.float64], length: int, repeats: int) -> NDArray[np.float64]:
    """Return what :func:`repetition` says of the windows that begin at every :data:`HOP`-th point.

    The correlations at a step and at a stride tell the two apart (Moe-Nilssen and Helbostad, J.
    Biomechanics 37, 2004): at half a period, the even harmonics count positive and the odd ones
    negative. Of a stride, two steps, the even ones are strong; a step of one who walks slowly has
    little but its first. Three steps of a fast walker fit in a long period, too.

    Parameters
    ----------
    signal
        Shape (m,).
    length
        Of a window [points].
    repeats
        As that of :class:`Scale`.

    Returns
    -------
    Strength, step time [s] and median amplitude, shape (3, n).
    """
    longest_s = min(PERIODS_S[1], _FITS * length / GRID_HZ / repeats)
    fastest = PERIODS_S[0] * GRID_HZ
    periods = (int(fastest), int(longest_s * GRID_HZ))
    signal = np.ascontiguousarray(signal)
    rhythms = kernels.steps.rhythms(signal, HOP, length, repeats, periods, fastest, _CLIP, _PART)
    rhythms[1] = np.where(rhythms[1] > 0, rhythms[1] / GRID_HZ, USUAL_STEP_S)
    return rhythms


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
        self._signal = ColumnBuffer()
        self._by_scale: list[ColumnBuffer] = [
            ColumnBuffer(3) for _ in self.scales
        ]  # as a hop, by window
        self._next = 0

    def __call__(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take values of the grid, shape (1, n); return strength, step time and swing by hop."""
        self._signal.add(signal)
        for scale, windows in zip(self.scales, self._by_scale, strict=True):
            count = (self._signal.end - scale.points) // HOP + 1
            if count > windows.end:
                windows.add(self._windows(windows.end, count, scale))
        self._signal.discard_before(HOP * min(windows.end for windows in self._by_scale))
        end = min(map(self._complete_to, self.scales, self._by_scale))
        return self._until(end)

    def flush(self) -> NDArray[np.float64]:
        """Return the values up to the end of the signal."""
        shortest = round(_SHORTEST_S * GRID_HZ)
        for scale, windows in zip(self.scales, self._by_scale, strict=True):
            if not windows.end and self._signal.end >= shortest:
                windows.add(self._windows(0, 1, scale))
        return self._until(-(-self._signal.end // HOP) + 1)

    def _windows(self, start: int, end: int, scale: Scale) -> NDArray[np.float64]:
        """Return strength, step time and swing of windows ``[start, end)``, shape (3, n)."""
        signal = self._signal.between(start * HOP, (end - 1) * HOP + scale.points)[0]
        length = min(scale.points, len(signal))
        rhythms = repetitions(signal, length, scale.repeats)
        rhythms[0] *= np.sqrt(length / GRID_HZ / self.scales[0].window_s)
        rhythms[2] *= _SWING
        return rhythms

    def _complete_to(self, scale: Scale, windows: ColumnBuffer) -> int:
        """Return the first hop that needs a window which is not there yet."""
        if not windows.end:
            return 0
        return max(windows.end, windows.end + scale.points // HOP - self.ahead)

    def _until(self, end: int) -> NDArray[np.float64]:
        """Return the next values, up to hop ``end``."""
        end = max(self._next, end)
        values = np.zeros((3, end - self._next))
        values[1] = USUAL_STEP_S
        for scale, windows in zip(self.scales, self._by_scale, strict=True):
            self._add(values, windows, scale)
        self._next = end
        for scale, windows in zip(self.scales, self._by_scale, strict=True):
            windows.discard_before(min(self._next - 1 - scale.points // HOP, windows.end - 1))
        return values

    def _add(self, values: NDArray[np.float64], windows: ColumnBuffer, scale: Scale) -> None:
        """Take in what a scale says of the next hops."""
        hops = (self._next, self._next + values.shape[1])
        width = scale.points // HOP
        best = kernels.steps.strongest(windows.contiguous(), windows.first, hops, self.ahead, width)
        if scale is self.scales[0]:
            values[1] = np.where(np.isfinite(best[0]), best[1], values[1])
        stronger = best[0] > values[0]
        values[0][stronger], values[2][stronger] = best[0][stronger], best[2][stronger]
