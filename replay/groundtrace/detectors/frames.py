"""The trace of a detector: per frame of 50 ms, what the decision function and signal reached.

It answers why there was no candidate: nothing came, the filter took it out, the channel was dead
or clipped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..detector import Frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAME_S = 0.05
NOISE_S = 5.0


def trace_of(decision: Quantity, filtered_unit: str, recorded_unit: str) -> tuple[Quantity, ...]:
    """Return the quantities of a :class:`FrameTrace`.

    ``peak`` and ``noise`` are of the filtered signal, ``swing`` (half peak to peak), ``quiet`` (the
    smallest swing of the last 5 s) and ``flat`` (how long it stood still at its extreme) of the
    signal as recorded. ``noise`` and ``quiet`` are 0 where nothing but dead frames came before.
    """
    return (
        decision,
        Quantity("peak", filtered_unit),
        Quantity("noise", filtered_unit),
        Quantity("swing", recorded_unit),
        Quantity("quiet", recorded_unit),
        Quantity("flat", "s"),
    )


class FrameTrace:
    """Reduces columns of a signal to frames; the quantities are those of :func:`trace_of`.

    Parameters
    ----------
    rate_hz
        Columns per second [Hz].
    channels
        Number of channels.
    """

    def __init__(self, rate_hz: float, channels: int) -> None:
        self.rate_hz = rate_hz
        self.length = max(1, round(FRAME_S * rate_hz))
        self.history = max(1, round(NOISE_S * rate_hz / self.length))
        self._columns = np.empty((5, channels, 0))
        self._times = np.empty(0, np.int64)
        self._past = np.full((2, channels, self.history - 1), np.inf)

    def add(self, times: NDArray[np.int64], *rows: NDArray[np.float64]) -> Frames:
        """Take columns.

        Parameters
        ----------
        times
            Shape (n,).
        rows
            Five arrays of shape (n_channels, n): decision function; peak and mean power of the
            filtered signal; maximum and minimum of the recorded signal.

        Returns
        -------
        The frames that are complete by now.
        """
        times = np.concatenate([self._times, times])
        columns = np.concatenate([self._columns, np.stack(rows)], axis=2)
        whole = len(times) // self.length * self.length
        self._times, self._columns = times[whole:], columns[:, :, whole:]
        return self._reduce(times[:whole], columns[:, :, :whole], self.length)

    def finish(self) -> Frames:
        """Return the last, shorter frame."""
        return self._reduce(self._times, self._columns, max(len(self._times), 1))

    def _reduce(
        self, times: NDArray[np.int64], columns: NDArray[np.float64], length: int
    ) -> Frames:
        channels, count = columns.shape[1], len(times) // length
        if count == 0:
            return Frames(np.empty(0, np.int64), np.empty((0, channels, 6), np.float32))
        folded = columns.reshape(5, channels, count, length)
        high, low = folded[3].max(axis=2), folded[4].min(axis=2)
        levels = np.stack([np.sqrt(folded[2].mean(axis=2)), (high - low) / 2])
        # a dead stretch says nothing about the noise
        past = np.concatenate([self._past, np.where(levels > 0, levels, np.inf)], axis=2)
        quiet = np.lib.stride_tricks.sliding_window_view(past, self.history, axis=2).min(axis=3)
        self._past = past[:, :, count:]
        quiet = np.where(np.isfinite(quiet), quiet, 0.0)
        value = np.stack(
            [
                folded[0].max(axis=2),
                folded[1].max(axis=2),
                quiet[0],
                levels[1],
                quiet[1],
                _still(folded[3], folded[4], high, low) / self.rate_hz,
            ]
        )
        return Frames(times[::length][:count], value.transpose(2, 1, 0).astype(np.float32))


def _still(
    high: NDArray[np.float64],
    low: NDArray[np.float64],
    highest: NDArray[np.float64],
    lowest: NDArray[np.float64],
) -> NDArray[np.intp]:
    """Return how many columns of each frame go on at the extreme that the one before stood at."""
    extreme = (high == highest[:, :, None]) | (low == lowest[:, :, None])
    still = (high == low) & extreme
    same = high[:, :, 1:] == high[:, :, :-1]
    return np.asarray((still[:, :, 1:] & still[:, :, :-1] & same).sum(axis=2))
