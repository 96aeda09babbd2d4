"""How far motion may be off that is integrated over lines between samples, or over lost ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rotations import Array

    Index = NDArray[np.intp]

#: How far the integral over a straight line may be off, one standard deviation, in T^2 / 12 times
#: the larger of its bends at both ends, T its length: that of a parabola is 4 / 3. Bench:
#: lost_samples.py for feet; lost_packets.py and heading_accuracy.py --thin for headings.
LINE_SIGMA = 2.5
#: The same between neighbours of a foot, whose errors partly cancel. Bench: lost_samples.py.
FOOT_SIGMA = 0.5
#: A line's bend is that against the lines over half of its length on either side, but over no more
#: than this [s]. Chosen by judgement: half of the longest gap that is filled.
SIDE_S = 0.15
#: Samples that the line between neighbours which a new one completes looks back at. Source:
#: definition: that before the line, and its two ends.
_BEFORE = 3


class StraightLines:
    """Tells how far the integrals over straight lines between samples may be off.

    Lines bend at samples. What a motion does beside a line it does under it too: lost packets are
    no part of the motion, nor is when a sensor samples.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    neighbours
        As :data:`LINE_SIGMA`, of lines between samples with none lost between them.
    """

    def __init__(self, rate_hz: float, neighbours: float = LINE_SIGMA) -> None:
        self._period_s = 1.0 / rate_hz
        self._side = max(1, round(SIDE_S * rate_hz))
        self._neighbours = neighbours
        self._values: Array = np.empty((0, 0))
        self._recorded = np.empty(0, np.bool_)

    def __call__(self, values: Array, lost: NDArray[np.bool_]) -> Array:
        """Return the variance of the integral over each line, where its bends are known.

        Parameters
        ----------
        values
            The next samples, shape (n, m).
        lost
            Which of them lie on lines, shape (n,).

        Returns
        -------
        Shape (n, m), in squares of the values' units times seconds; 0 elsewhere.
        """
        remembered = len(self._values)
        x = self._values = np.concatenate([self._values, values]) if remembered else values
        recorded = self._recorded = np.concatenate([self._recorded, ~lost])
        if not len(values):
            return np.zeros(values.shape)
        variance = self._between_neighbours(x, recorded, remembered)
        at = np.flatnonzero(recorded)
        gap = np.flatnonzero(np.diff(at) > 1)
        start, stop = at[gap], at[gap + 1]
        side = np.clip((stop - start) // 2, 1, self._side)
        known_at = stop + side
        waits = known_at >= len(x)
        counted = (known_at >= remembered) & ~waits & (start > 0)
        if counted.any():
            ends = (y[counted] for y in (start, stop, side, known_at))
            np.add.at(variance, known_at[counted] - remembered, self._over_gaps(x, *ends) ** 2)
        first = int(start[waits][0]) if waits.any() else int(at[-1]) if len(at) else 0
        first = max(first - max(self._side, _BEFORE), 0)
        self._values, self._recorded = x[first:], recorded[first:]
        return variance

    def _between_neighbours(self, x: Array, recorded: NDArray[np.bool_], remembered: int) -> Array:
        """Return the variances of lines with no sample lost, shape (n - remembered, m)."""
        first = max(remembered - _BEFORE, 0)
        is_recorded, slope = recorded[first:], np.diff(x[first:], axis=0)
        bend: Array = np.abs(slope[1:] - slope[:-1])
        off = self._neighbours / 12 * np.maximum(bend[:-1], bend[1:]) * self._period_s
        off[~(is_recorded[1:-2] & is_recorded[2:-1])] = 0.0
        variance = np.zeros((len(x) - remembered, x.shape[1]))
        variance[len(variance) - len(off) :] = off**2
        return variance

    def _over_gaps(
        self, x: Array, start: Index, stop: Index, side: Index, known_at: Index
    ) -> Array:
        """Return how far the integral over each line may be off, shape (k, m)."""
        length, early = (stop - start)[:, None], np.minimum(side, start)
        slope = (x[stop] - x[start]) / length
        before = (x[start] - x[start - early]) / early[:, None]
        after = (x[known_at] - x[stop]) / side[:, None]
        bend = np.maximum(np.abs(slope - before), np.abs(after - slope))
        return np.asarray(LINE_SIGMA / 12 * length**2 * bend * self._period_s, np.float64)
