"""Cells: a signal reduced to about 1 ms, and the ratio of each cell to the noise before it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import kernels

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Length of a cell [s]. Chosen by judgement: a wave's onset takes some milliseconds.
CELL_S = 0.001
#: Noise up to this is none: a filter's memory of what was before the silence. Chosen by judgement:
#: far below any sample, far above the numbers that are slow to count with.
SILENCE = 1e-140
#: Gives the noise level up to and including each cell, from the cells' levels; keeps its state.
NoiseLevel = Callable[["NDArray[np.float64]"], "NDArray[np.float64]"]


def cell_length(rate_hz: float) -> int:
    """Return the samples of a cell."""
    return max(1, round(CELL_S * rate_hz))


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
        line = np.ascontiguousarray(np.concatenate([self._tail, level], axis=1))
        self._tail = line[:, level.shape[1] :]
        return kernels.maxima.window_maxima(line, self.cells)


class SignalFrames:
    """What signals reached in each frame of so many columns: cells, or samples.

    Parameters
    ----------
    channels
        Number of channels.
    length
        Columns of a frame.

    Attributes
    ----------
    open_frame, filled
        What is kept of the frame under way, and how many columns it has.
    """

    def __init__(self, channels: int, length: int) -> None:
        self.length = length
        self.open_frame = kernels.frames.open_frames(channels)
        self.filled = 0

    def add(self, *rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take columns: peak and mean power as filtered, maximum and minimum as recorded.

        Each of shape (n_channels, n). Returned are the frames they complete, of shape
        (n_channels, m, 4): peak, level, swing, and how many columns stood still at an extreme.
        """
        filled = self.filled
        values = self.completed_by(rows[0].shape[1])
        peak, power, high, low = (np.ascontiguousarray(row, np.float64) for row in rows)
        of_frame = (self.open_frame, filled, self.length, values)
        kernels.frames.frames(peak, power, high, low, *of_frame)
        return values

    def completed_by(self, columns: int) -> NDArray[np.float64]:
        """Count columns in; return room for the frames that they complete."""
        filled = self.filled + columns
        self.filled = filled % self.length
        return np.empty((len(self.open_frame), filled // self.length, kernels.frames.VALUES))

    def flush(self) -> NDArray[np.float64]:
        """Return the last, shorter frame, or none."""
        values = np.empty((len(self.open_frame), min(self.filled, 1), kernels.frames.VALUES))
        if self.filled:
            kernels.frames.close_frames(self.open_frame, self.filled, values)
        self.filled = 0
        return values


@dataclass(frozen=True, slots=True, eq=False)
class CompleteCells:
    """Complete cells.

    Attributes
    ----------
    first
        Index in the run of the first of them.
    level
        Shape (n_channels, n): largest level of the decision function.
    frames
        Shape (n_channels, m, 4): the frames of the signal that they complete, as
        :class:`SignalFrames` has them.
    """

    first: int
    level: NDArray[np.float64]
    frames: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.level.shape[1])


class CellReducer:
    """Reduces signals to cells, where all of them are there sample by sample.

    Parameters
    ----------
    rate_hz
        Of the signals.
    frames
        Reduces the cells to frames.

    Attributes
    ----------
    length
        Samples of a cell.
    """

    def __init__(self, rate_hz: float, frames: SignalFrames) -> None:
        self.length = cell_length(rate_hz)
        self._frames = frames
        self._rows = np.empty((3, len(frames.open_frame), 0))  # from the last block's first cell on
        self._first = 0  # cell of the run that they begin with
        self._count = 0  # cells that they complete

    def add(self, *signals: NDArray[np.float64]) -> CompleteCells:
        """Take the recorded signal, the filtered one and the level, each (n_channels, n)."""
        rest = self._rows[:, :, self._count * self.length :]
        self._rows = np.concatenate([rest, np.stack(signals)], axis=2)
        self._first += self._count
        self._count = self._rows.shape[2] // self.length
        cells = self._rows[:, :, : self._count * self.length]
        recorded, filtered, level = cells.reshape(*cells.shape[:2], self._count, self.length)
        # along the first axis numpy adds in order, as the pickers' kernel does
        power = np.moveaxis(filtered * filtered, -1, 0).copy().sum(axis=0) / self.length
        frames = self._frames.add(
            np.abs(filtered).max(axis=-1, initial=0.0),
            power,
            recorded.max(axis=-1, initial=-np.inf),
            recorded.min(axis=-1, initial=np.inf),
        )
        return CompleteCells(self._first, level.max(axis=-1, initial=-np.inf), frames)

    def samples(self, start: int, stop: int) -> NDArray[np.float64]:
        """Return the level of samples whose cells the last block completed, (n, n_channels)."""
        first = self._first * self.length
        return np.asarray(self._rows[2][:, start - first : stop - first].T)


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

    def begin_at(self, cell: int) -> None:
        """Begin with a cell of the run that is not its first: so long the noise has gone on."""
        self._count = cell

    def __call__(self, level: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ratio of the cells of a block, shape (n_channels, n)."""
        n = level.shape[1]
        if n == 0:
            return level
        noise = self._noise(level)
        if self._tail is None:
            self._tail = np.repeat(noise[:, :1], self.gap, axis=1)
        noise_cells = np.maximum(self._count - self.gap + 1 + np.arange(n), 0)
        trust = np.divide(
            noise_cells, noise_cells + self.warm_up, out=np.zeros(n), where=noise_cells > 0
        )
        self._count += n
        line = np.ascontiguousarray(np.concatenate([self._tail, noise], axis=1))
        self._tail = line[:, n:].copy()
        # over digital silence nothing has a ratio: a sensor coming alive is not an arrival
        ratio = np.empty(level.shape)
        level = np.ascontiguousarray(level)
        kernels.picker.ratio_to_noise(level, line, trust, SILENCE, ratio)
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
        line = np.concatenate([self._tail, values], axis=1)
        if final:  # nothing follows
            line = np.concatenate([line, np.full((len(line), self.reach), -np.inf)], axis=1)
        count = max(0, line.shape[1] - self._keep - self.reach)
        maxima = self._among(line, count)
        self._tail = line[:, count:].copy()
        self.settled += count
        return maxima

    def _among(self, line: NDArray[np.float64], count: int) -> LocalMaximaWithOnset:
        """Find the maxima of ``count`` cells of a line, which begins ``_keep`` cells before."""
        first, stop = self._keep, self._keep + count
        rule = (self.reach, self.floor, self.back)
        line = np.ascontiguousarray(line)
        begin, peak, channel = kernels.picker.local_maxima(line, first, stop, *rule)
        offset = self.settled - first
        value = line[channel, peak]
        return LocalMaximaWithOnset(begin + offset, peak + offset, channel, value)
