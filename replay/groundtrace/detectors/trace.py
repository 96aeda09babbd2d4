"""The trace of a detector: per frame of 50 ms, what the decision function and signal reached.

It shows why there was no candidate: no signal came, the filter attenuated it, or the channel was
dead or clipped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from .. import kernels
from ..pipeline.stage import Frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Length of a frame, and memory of the quiet swing and the noise [s]. Chosen by judgement: frames
#: resolve a step and cost little; in 5 s there is quiet between steps.
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
        self._columns = np.empty((5, channels, 0))  # of the frame under way
        self._begin_ns = 0
        self._past = np.full((2, channels, self.history - 1), -np.inf)

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
        if not len(times):
            return self.nothing()
        return self.take(times[self.begins(len(times))], *rows)

    def begins(self, columns: int) -> slice:
        """Return which of the next columns begin a frame."""
        return slice(-self._columns.shape[2] % self.length, columns, self.length)

    def take(self, begins: NDArray[np.int64], *rows: NDArray[np.float64]) -> Frames:
        """Take columns as :meth:`add` does, but the times of those alone that begin a frame."""
        if self._columns.shape[2]:
            begins = np.concatenate([[self._begin_ns], begins])
        before = self._columns.shape[2]
        columns = np.empty((*self._columns.shape[:2], before + rows[0].shape[1]))
        columns[:, :, :before] = self._columns
        for row, own in zip(rows, columns, strict=True):
            own[:, before:] = row
        count = columns.shape[2] // self.length
        whole, self._columns = np.split(columns, [count * self.length], axis=2)
        self._begin_ns = int(begins[-1])
        return self._frames(begins[:count], whole, self.length)

    def flush(self) -> Frames:
        """Return the last, shorter frame."""
        columns, self._columns = self._columns, self._columns[:, :, :0]
        if not columns.shape[2]:
            return self.nothing()
        return self._frames(np.array([self._begin_ns]), columns, columns.shape[2])

    def nothing(self) -> Frames:
        """Return no frames."""
        return Frames(np.empty(0, np.int64), np.empty((0, self._past.shape[1], 6), np.float32))

    def _frames(
        self, times: NDArray[np.int64], columns: NDArray[np.float64], length: int
    ) -> Frames:
        """Return frames of columns, shape (5, rows, n), with the quietest of the last 5 s."""
        if not len(times):
            return self.nothing()
        folded = columns.reshape(*columns.shape[:2], -1, length)  # (5, rows, frames, length)
        decision, peak, power, high, low = folded
        level = np.sqrt(power.mean(axis=-1))
        highest, lowest = high.max(axis=-1), low.min(axis=-1)
        swing = (highest - lowest) / 2.0
        # dead stretches say nothing about the noise
        quiet = np.stack([level, swing])
        line = np.concatenate([self._past, np.where(quiet > 0.0, -quiet, -np.inf)], axis=2)
        self._past = line[:, :, len(times) :]
        noise, least = (kernels.picker.window_maxima(kind, self.history) for kind in line)
        flat, still = np.zeros(level.shape), high == low
        if still.any():
            still = still[..., 1:] & still[..., :-1]  # and as in the column before:
            still &= high[..., 1:] == high[..., :-1]
            at_end = (high == highest[..., None]) | (high == lowest[..., None])
            flat = (still & at_end[..., 1:]).sum(axis=-1) / self.rate_hz
        values = (
            decision.max(axis=-1),
            peak.max(axis=-1),
            np.where(noise > -np.inf, -noise, 0.0),
            swing,
            np.where(least > -np.inf, -least, 0.0),
            flat,
        )
        return Frames(times, np.stack(values, axis=-1).transpose(1, 0, 2).astype(np.float32))
