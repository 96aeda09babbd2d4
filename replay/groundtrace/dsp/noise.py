"""Cells: a signal reduced to about 1 ms, and the ratio of each cell to the noise before it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..kernels.lanes import LANES, zero_rows
from ..kernels.picker import (
    OPEN,
    empty_cell,
    load,
    ratio_to_noise,
    reduce_cells,
    settled_maxima,
    window_maxima,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Length of a cell [s]. Chosen by judgement: a wave's onset takes some milliseconds.
CELL_S = 0.001
#: Gives the noise level up to and including each cell, from the cells' levels; keeps its state.
NoiseLevel = Callable[["NDArray[np.float64]"], "NDArray[np.float64]"]


class RunningMaximum:
    """Maximum over the last cells.

    Parameters
    ----------
    cells
        How many, the present one included.
    """

    def __init__(self, cells: int) -> None:
        self.cells = cells
        self._tail: NDArray[np.float64] | None = None

    def __call__(self, level: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the maximum up to and including each cell, shape (n_channels, n)."""
        if self._tail is None:
            self._tail = np.zeros((level.shape[0], self.cells - 1))
        found, self._tail = window_maxima(self._tail, level)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class CompleteCells:
    """Complete cells.

    Attributes
    ----------
    first
        Index in the run of the first of them.
    level, peak, power, high, low
        Shape (n_channels, n): largest level of the decision function, largest absolute value and
        mean square of the filtered signal, maximum and minimum of the recorded signal.
    """

    first: int
    level: NDArray[np.float64]
    peak: NDArray[np.float64]
    power: NDArray[np.float64]
    high: NDArray[np.float64]
    low: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.level.shape[1])


class PartialCells:
    """The cells under way of all channels, at fixed places of the run, whatever the blocks.

    Attributes
    ----------
    length
        Samples of a cell.
    groups
        Channels are taken in groups of :data:`~.kernels.lanes.LANES`.
    cell
        Shape (groups, OPEN, LANES): what the cells under way hold.
    filled
        How many samples they have.
    """

    def __init__(self, rate_hz: float, channels: int) -> None:
        self.length = max(1, round(CELL_S * rate_hz))
        self.channels = channels
        self.groups = -(-channels // LANES)
        self.cell = zero_rows(self.groups, OPEN)
        for cell in self.cell:
            empty_cell(cell)
        self.filled = 0
        self._first = 0

    def room(self, samples: int) -> NDArray[np.float64]:
        """Return an array for the cells that some more samples complete, (OPEN, channels, n)."""
        return np.empty((OPEN, self.channels, (self.filled + samples) // self.length))

    def done(self, cells: NDArray[np.float64], samples: int) -> CompleteCells:
        """Return the cells, now that the samples were taken."""
        first, count = self._first, cells.shape[2]
        self._first += count
        self.filled = (self.filled + samples) % self.length
        return CompleteCells(first, *cells)


class CellReducer:
    """Reduces signals to cells, where all of them are there sample by sample."""

    def __init__(self, rate_hz: float, channels: int) -> None:
        self._open = PartialCells(rate_hz, channels)
        self._levels = np.empty((channels, 0))  # from the last block's first cell on
        self._first = 0  # sample of the run that they begin with

    def add(self, *signals: NDArray[np.float64]) -> CompleteCells:
        """Take the recorded signal, the filtered one and the level, each (n_channels, n)."""
        cells, n = self._open, signals[0].shape[1]
        tail = self._levels.shape[1] - cells.filled
        self._levels = np.concatenate([self._levels[:, tail:], signals[-1]], axis=1)
        self._first += tail
        found = cells.room(n)
        for group in range(cells.groups):
            rows = zero_rows(len(signals), n)
            for signal, lanes in zip(signals, rows, strict=True):
                load(np.ascontiguousarray(signal), group * LANES, 0, lanes)
            recorded, filtered, level = rows
            state = (group * LANES, cells.cell[group], cells.filled, cells.length)
            reduce_cells(recorded, filtered, level, *state, found)
        return cells.done(found, n)

    def samples(self, start: int, stop: int) -> NDArray[np.float64]:
        """Return the level of samples whose cells the last block completed, (n, n_channels)."""
        return self._levels[:, start - self._first : stop - self._first].T


class NoiseRatio:
    """Ratio of each cell's level to a noise level some cells earlier.

    Parameters
    ----------
    noise
        Gives the noise level up to and including each cell; keeps its own state.
    gap
        The noise level is taken this many cells earlier.
    warm_up
        The ratio T cells after the start of the noise is multiplied by T / (T + warm_up): a noise
        level known for a short time only is trusted less.
    """

    def __init__(
        self,
        noise: NoiseLevel,
        gap: int,
        warm_up: float,
    ) -> None:
        self._noise = noise
        self.gap = gap
        self.warm_up = warm_up
        self._tail: NDArray[np.float64] | None = None
        self._count = 0

    def __call__(self, level: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ratio of the cells of a block, shape (n_channels, n)."""
        n = level.shape[1]
        if n == 0:
            return level
        noise = self._noise(level)
        if self._tail is None:
            self._tail = np.repeat(noise[:, :1], self.gap, axis=1)
        known, self._count = self._count - self.gap + 1, self._count + n
        level, noise = np.ascontiguousarray(level), np.ascontiguousarray(noise)
        ratio, self._tail = ratio_to_noise(level, self._tail, noise, known, self.warm_up)
        return ratio


class LocalMaximaWithOnset(NamedTuple):
    """Maxima and the rises that lead to them, by cell and channel; each of shape (n,)."""

    begin: NDArray[np.intp]
    peak: NDArray[np.intp]
    channel: NDArray[np.intp]
    value: NDArray[np.float64]

    @classmethod
    def none(cls) -> LocalMaximaWithOnset:
        """Return no maxima."""
        nothing = np.empty(0, np.intp)
        return cls(nothing, nothing, nothing, np.empty(0))

    def and_then(self, later: LocalMaximaWithOnset) -> LocalMaximaWithOnset:
        """Return these maxima and later ones."""
        if not len(self.begin):
            return later
        return LocalMaximaWithOnset(
            np.concatenate([self.begin, later.begin]),
            np.concatenate([self.peak, later.peak]),
            np.concatenate([self.channel, later.channel]),
            np.concatenate([self.value, later.value]),
        )

    def part(self, which: slice) -> LocalMaximaWithOnset:
        """Return some of the maxima."""
        return LocalMaximaWithOnset(
            self.begin[which], self.peak[which], self.channel[which], self.value[which]
        )


class LocalMaxima:
    """Cells that are the largest within ``reach`` cells on both sides, first of equals.

    Parameters
    ----------
    channels
        Number of channels.
    reach
        Distance within which a maximum is the largest [cells].
    floor
        Values up to this are nothing.
    back
        How far before a maximum its rise over the floor may begin [cells].
    """

    def __init__(self, channels: int, reach: int, floor: float, back: int) -> None:
        self.reach = reach
        self.floor = floor
        self.back = back
        self._keep = max(reach, back)
        self._tail = np.full((channels, self._keep), -np.inf)  # cells before ``settled``
        self.settled = 0

    def add(self, values: NDArray[np.float64], *, final: bool = False) -> LocalMaximaWithOnset:
        """Take the values of new cells; return the settled maxima, by cell and channel."""
        rule, before = (self.reach, self.floor, self.back), self._tail.shape[1]
        found = settled_maxima(self._tail, values, self._keep, rule, final)
        (begin, peak, channel), value, self._tail = found
        begin, peak = begin + self.settled, peak + self.settled
        after = self.reach if final else 0
        self.settled += before + values.shape[1] + after - self._tail.shape[1]
        return LocalMaximaWithOnset(begin, peak, channel, value)
