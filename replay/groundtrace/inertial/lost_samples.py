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
        self._recorded = np.concatenate([self._recorded, ~lost])
        at, variance = np.flatnonzero(self._recorded), np.zeros(values.shape)
        if not len(at):
            return variance
        start, stop = at[:-1], at[1:]
        side = np.clip((stop - start) // 2, 1, self._side)
        known_at = stop + side
        waits = known_at >= len(x)
        first = max(int(start[waits][0] if waits.any() else at[-1]) - self._side, 0)
        self._values, self._recorded = x[first:], self._recorded[first:]
        counted = (known_at >= remembered) & ~waits & (start > 0)
        if counted.any():
            ends = (y[counted] for y in (start, stop, side, known_at))
            np.add.at(variance, known_at[counted] - remembered, self._off(x, *ends) ** 2)
        return variance

    def _off(self, x: Array, start: Index, stop: Index, side: Index, known_at: Index) -> Array:
        """Return how far the integral over each line may be off, shape (k, m)."""
        length, early = (stop - start)[:, None], np.minimum(side, start)
        slope = (x[stop] - x[start]) / length
        before = (x[start] - x[start - early]) / early[:, None]
        after = (x[known_at] - x[stop]) / side[:, None]
        bend = np.maximum(np.abs(slope - before), np.abs(after - slope))
        sigma = np.where(length > 1, LINE_SIGMA, self._neighbours)
        off: Array = sigma / 12 * length**2 * bend * self._period_s
        return off
