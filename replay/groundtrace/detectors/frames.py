"""The trace of a detector: per frame of 50 ms, what the decision function and signal reached."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..detector import Frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAME_S = 0.05
NOISE_S = 5.0


class FrameTrace:
    """Reduces columns of a signal to frames.

    The quantities are the maximum of the decision function, the largest absolute value, and the
    noise level: the smallest root-mean-square of a frame within the last 5 s.

    Parameters
    ----------
    rate_hz
        Columns per second [Hz].
    channels
        Number of channels.
    """

    def __init__(self, rate_hz: float, channels: int) -> None:
        self.length = max(1, round(FRAME_S * rate_hz))
        self.history = max(1, round(NOISE_S * rate_hz / self.length))
        self._columns = np.empty((3, channels, 0))
        self._times = np.empty(0, np.int64)
        self._rms = np.full((channels, self.history - 1), np.inf)

    def add(
        self,
        times: NDArray[np.int64],
        decision: NDArray[np.float64],
        peak: NDArray[np.float64],
        power: NDArray[np.float64],
    ) -> Frames:
        """Take columns: times (n,); decision, peak and mean power (n_channels, n) each.

        Returns
        -------
        The frames that are complete by now.
        """
        times = np.concatenate([self._times, times])
        columns = np.concatenate([self._columns, np.stack([decision, peak, power])], axis=2)
        whole = len(times) // self.length * self.length
        self._times, self._columns = times[whole:], columns[:, :, whole:]
        return self._reduce(times[:whole], columns[:, :, :whole], self.length)

    def finish(self) -> Frames:
        """Return the last, shorter frame."""
        return self._reduce(self._times, self._columns, max(len(self._times), 1))

    def _reduce(
        self, times: NDArray[np.int64], columns: NDArray[np.float64], length: int
    ) -> Frames:
        channels = columns.shape[1]
        count = len(times) // length
        if count == 0:
            return Frames(np.empty(0, np.int64), np.empty((0, channels, 3), np.float32))
        folded = columns.reshape(3, channels, count, length)
        rms = np.sqrt(folded[2].mean(axis=2))
        past = np.concatenate([self._rms, rms], axis=1)
        windows = np.lib.stride_tricks.sliding_window_view(past, self.history, axis=1)
        self._rms = past[:, count:]
        value = np.stack([folded[0].max(axis=2), folded[1].max(axis=2), windows.min(axis=2)])
        return Frames(times[::length][:count], value.transpose(2, 1, 0).astype(np.float32))
