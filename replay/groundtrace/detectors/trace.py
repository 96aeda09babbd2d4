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
        self._frame = kernels.frames.open_frames(channels)  # under way
        self._filled = 0  # columns of it
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
        return slice(-self._filled % self.length, columns, self.length)

    def take(self, begins: NDArray[np.int64], *rows: NDArray[np.float64]) -> Frames:
        """Take columns as :meth:`add` does, but the times of those alone that begin a frame."""
        if self._filled:
            begins = np.concatenate([[self._begin_ns], begins])
        if len(begins):
            self._begin_ns = int(begins[-1])
        return self._frames(begins, self.length, *rows)

    def flush(self) -> Frames:
        """Return the last, shorter frame."""
        if not self._filled:
            return self.nothing()
        rows = [np.empty((len(self._frame), 0))] * 5
        return self._frames(np.array([self._begin_ns]), self._filled, *rows)

    def nothing(self) -> Frames:
        """Return no frames."""
        return Frames(np.empty(0, np.int64), np.empty((0, self._past.shape[1], 6), np.float32))

    def _frames(self, begins: NDArray[np.int64], length: int, *rows: NDArray[np.float64]) -> Frames:
        """Return the frames that columns complete, with the quietest of the last 5 s."""
        filled = self._filled + rows[0].shape[1]
        count, filled_before, self._filled = filled // length, self._filled, filled % length
        values = np.empty((len(self._frame), count, kernels.frames.VALUES))
        decision, peak, power, high, low = (np.ascontiguousarray(x, np.float64) for x in rows)
        kernels.frames.frames(
            decision, peak, power, high, low, self._frame, filled_before, length, values
        )
        if not count:
            return self.nothing()
        most, largest, level, swing, still = np.moveaxis(values, -1, 0)
        # dead stretches say nothing about the noise
        quiet = np.stack([level, swing])
        line = np.concatenate([self._past, np.where(quiet > 0.0, -quiet, -np.inf)], axis=2)
        self._past = line[:, :, count:]
        noise, least = (kernels.frames.window_maxima(kind, self.history) for kind in line)
        shown = (
            most,
            largest,
            np.where(noise > -np.inf, -noise, 0.0),
            swing,
            np.where(least > -np.inf, -least, 0.0),
            still / self.rate_hz,
        )
        return Frames(
            begins[:count], np.stack(shown, axis=-1).transpose(1, 0, 2).astype(np.float32)
        )
