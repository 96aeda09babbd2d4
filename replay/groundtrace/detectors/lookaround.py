"""A signal of which every sample is looked at once its surroundings are there.

What is measured at a sample then depends on the samples around it alone, and not on the blocks
they came in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Lookaround:
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

    def finish(self) -> range:
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
        found = (inside > x[low - 1 : high - 1]) & (inside >= x[low + 1 : high + 1])
        return np.flatnonzero(found) + low


def level(values: NDArray[np.float64]) -> float:
    """Return the root of the mean square of a stretch of signal."""
    return float(np.sqrt(np.mean(values * values)))
