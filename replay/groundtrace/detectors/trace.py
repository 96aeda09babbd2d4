"""The trace of a detector: per frame of 50 ms, what the decision function and signal reached.

It shows why there was no candidate: no signal came, the filter attenuated it, or the channel was
dead or clipped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..kernels.picker import FRAME, close_frame, fold_frames, frame_values, open_frame
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
        self._state = np.empty((channels, FRAME))
        open_frame(self._state)
        self._filled = 0
        self._begin_ns = 0
        self._past = np.full((2 * channels, self.history - 1), -np.inf)

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
        decision, peak, power, high, low = (np.ascontiguousarray(r, np.float64) for r in rows)
        state = (self._state, self._filled, self.length)
        folded = fold_frames(decision, peak, power, high, low, *state)
        if self._filled:
            begins = np.concatenate([[self._begin_ns], begins])
        self._filled = (self._filled + decision.shape[1]) % self.length
        self._begin_ns = int(begins[-1])
        return self._frames(begins[: len(folded)], folded)

    def finish(self) -> Frames:
        """Return the last, shorter frame."""
        if not self._filled:
            return self.nothing()
        folded = np.empty((1, len(self._state), 5))
        for state, found in zip(self._state, folded[0], strict=True):
            close_frame(state, self._filled, found)
        open_frame(self._state)
        self._filled = 0
        return self._frames(np.array([self._begin_ns]), folded)

    def nothing(self) -> Frames:
        """Return no frames."""
        return Frames(np.empty(0, np.int64), np.empty((0, len(self._state), 6), np.float32))

    def _frames(self, times: NDArray[np.int64], folded: NDArray[np.float64]) -> Frames:
        """Return frames with the quietest of the last 5 s beside each."""
        value, self._past = frame_values(folded, self._past, self.rate_hz)
        return Frames(times, value)
