"""Cells: a signal reduced to about 1 ms, and the ratio of each cell to the noise before it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

if TYPE_CHECKING:
    from numpy.typing import NDArray

CELL_S = 0.001
#: Gives the noise level up to and including each cell, from the cells' levels; keeps its state.
NoiseLevel = Callable[["NDArray[np.float64]"], "NDArray[np.float64]"]


def sliding_maximum(x: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return the maximum of every ``width`` neighbours, shape (n_channels, n - width + 1)."""
    half = width // 2
    centred = maximum_filter1d(x, width, axis=1, mode="nearest")
    return np.asarray(centred[:, half : half + x.shape[1] - width + 1])


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Complete cells.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: first sample of each.
    level, peak, power, high, low
        Shape (n_channels, n): largest level of the decision function, largest absolute value and
        mean square of the filtered signal, maximum and minimum of the recorded signal.
    sample_ns, samples
        Shape (n * length,) and (n_channels, n, length): the level sample by sample.
    """

    time_ns: NDArray[np.int64]
    level: NDArray[np.float64]
    peak: NDArray[np.float64]
    power: NDArray[np.float64]
    high: NDArray[np.float64]
    low: NDArray[np.float64]
    sample_ns: NDArray[np.int64]
    samples: NDArray[np.float64]


class CellReducer:
    """Cuts samples into cells at fixed places of the run, whatever the blocks."""

    def __init__(self, rate_hz: float, channels: int) -> None:
        self.length = max(1, round(CELL_S * rate_hz))
        self._times = np.empty(0, np.int64)
        self._rows = np.empty((3, channels, 0))

    def add(
        self,
        times: NDArray[np.int64],
        recorded: NDArray[np.float64],
        filtered: NDArray[np.float64],
        level: NDArray[np.float64],
    ) -> Cells:
        """Take times (n,), signals and level (n_channels, n); return the complete cells."""
        times = np.concatenate([self._times, times])
        rows = np.concatenate([self._rows, np.stack([filtered, level, recorded])], axis=2)
        whole = len(times) // self.length * self.length
        self._times, self._rows = times[whole:], rows[:, :, whole:]
        folded = rows[:, :, :whole].reshape(3, rows.shape[1], -1, self.length)
        return Cells(
            times[: whole : self.length],
            folded[1].max(axis=2),
            np.maximum(folded[0].max(axis=2), -folded[0].min(axis=2)),
            np.einsum("ckl,ckl->ck", folded[0], folded[0]) / self.length,
            folded[2].max(axis=2),
            folded[2].min(axis=2),
            times[:whole],
            folded[1],
        )


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
        line = np.concatenate([self._tail, noise], axis=1)
        self._tail = line[:, n:]
        known = np.maximum(np.arange(self._count, self._count + n) - self.gap + 1.0, 0.0)
        self._count += n
        with np.errstate(divide="ignore", invalid="ignore"):
            trust = known / (known + self.warm_up)
            ratio = level / line[:, :n] * trust
        # over digital silence nothing has a ratio: a sensor coming alive is not an arrival
        return np.asarray(np.nan_to_num(ratio, nan=0.0, posinf=0.0))


class Rise(NamedTuple):
    """A maximum and the rise that leads to it: cells, channel, value."""

    begin: int
    peak: int
    channel: int
    value: float


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

    def add(self, values: NDArray[np.float64], *, final: bool = False) -> list[Rise]:
        """Take the values of new cells; return the settled maxima, by cell and channel."""
        r, keep = self.reach, self._keep
        line = np.concatenate([self._tail, values], axis=1)
        if final:
            line = np.concatenate([line, np.full((len(line), r), -np.inf)], axis=1)
        count = line.shape[1] - keep - r
        if count <= 0:
            self._tail = line
            return []
        windows = sliding_maximum(line[:, keep - r :], r)
        middle = line[:, keep : keep + count]
        before, after = windows[:, :count], windows[:, r + 1 : r + 1 + count]
        found = np.nonzero(((middle > before) & (middle >= after) & (middle > self.floor)).T)
        rises = [
            Rise(
                self.settled + int(cell) - self._length_of_rise(line[channel, : keep + cell]),
                self.settled + int(cell),
                int(channel),
                float(middle[channel, cell]),
            )
            for cell, channel in zip(*found, strict=True)
        ]
        self.settled += count
        self._tail = line[:, count:]
        return rises

    def _length_of_rise(self, before: NDArray[np.float64]) -> int:
        """Return how many of the last cells are above the floor without a break."""
        below = np.flatnonzero(before[len(before) - self.back :] <= self.floor)
        return self.back if not len(below) else self.back - 1 - int(below[-1])
