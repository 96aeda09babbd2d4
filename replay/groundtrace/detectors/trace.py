"""The trace of a detector: per frame of 50 ms, what the decision function and signal reached.

It shows why there was no candidate: no signal came, the filter attenuated it, or the channel was
dead or clipped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from .. import kernels
from ..dsp.noise import SignalFrames
from ..pipeline.stage import Frames, Memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

#: Length of a frame, and memory of the quiet swing and the noise [s]. Chosen by judgement: frames
#: resolve a step and cost little; in 5 s there is quiet between steps.
FRAME_S = 0.05
NOISE_S = 5.0
#: How much signal a trace depends on: the frame under way, and those before it.
TRACE = Memory(NOISE_S + 2 * FRAME_S, 2 * FRAME_S)


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


class WholeFrames:
    """Leaves out what comes of a run before its first whole frame.

    Where a replay begins in the middle of a run, its frames are so those of the whole run.

    Parameters
    ----------
    samples
        Of a frame.
    """

    def __init__(self, samples: int) -> None:
        self._samples = samples
        self._skip: int | None = None

    def of(self, block: SignalBlock) -> SignalBlock:
        """Return what is left of the next block of a run, which may be nothing."""
        if self._skip is None:
            self._skip = -block.first % self._samples
        if not self._skip:
            return block
        cut = min(self._skip, len(block))
        self._skip -= cut
        return block.slice(cut, len(block))


class FrameTrace:
    """Reduces columns of a signal to frames; the quantities are those of :func:`trace_of`.

    Parameters
    ----------
    rate_hz
        Columns per second [Hz].
    channels
        Number of channels.

    Attributes
    ----------
    length
        Columns of a frame.
    signal
        Reduces the signal; a picker may give it the columns itself, and then the decisions alone
        to :meth:`take`.
    """

    def __init__(self, rate_hz: float, channels: int) -> None:
        self.rate_hz = rate_hz
        self.length = max(1, round(FRAME_S * rate_hz))
        self.history = max(1, round(NOISE_S * rate_hz / self.length))
        self.signal = SignalFrames(channels, self.length)
        self._filled = 0  # columns of the frame under way
        self._most = np.full(channels, -np.inf)  # the largest decision in it
        self._begin_ns = 0
        self._past = np.full((2, channels, self.history), np.inf)  # levels and swings
        self._least = np.full((2, channels), np.inf)
        self._count = 0

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
        decision, *signal = rows
        return self.take(times[self.begins(len(times))], decision, self.signal.add(*signal))

    def begins(self, columns: int) -> slice:
        """Return which of the next columns begin a frame."""
        return slice(-self._filled % self.length, columns, self.length)

    def take(
        self,
        begins: NDArray[np.int64],
        decision: NDArray[np.float64],
        signal: NDArray[np.float64],
    ) -> Frames:
        """Take columns of the decision function.

        Parameters
        ----------
        begins
            The times of those that begin a frame.
        decision
            Shape (n_channels, n).
        signal
            What :attr:`signal` has made of the same columns.
        """
        starts = np.arange(decision.shape[1])[self.begins(decision.shape[1])]
        if self._filled:
            begins, starts = np.append(self._begin_ns, begins), np.append(0, starts)
        most = np.fmax.reduceat(decision, starts, axis=1)
        if self._filled:
            most[:, 0] = np.fmax(most[:, 0], self._most)
        self._filled = (self._filled + decision.shape[1]) % self.length
        self._begin_ns, self._most = int(begins[-1]), most[:, -1]
        count = signal.shape[1]
        return self._frames(begins[:count], most[:, :count], signal)

    def flush(self) -> Frames:
        """Return the last, shorter frame."""
        if not self._filled:
            return self.nothing()
        self._filled = 0
        return self._frames(
            np.array([self._begin_ns]), self._most[:, np.newaxis], self.signal.flush()
        )

    def nothing(self) -> Frames:
        """Return no frames."""
        return Frames(np.empty(0, np.int64), np.empty((0, len(self._most), 6), np.float32))

    def _frames(
        self,
        begins: NDArray[np.int64],
        decision: NDArray[np.float64],
        signal: NDArray[np.float64],
    ) -> Frames:
        """Return frames, with the quietest of the last 5 s."""
        values = np.empty((len(begins), len(self._most), 6), np.float32)
        last = (self._past, self._least, self._count, self.rate_hz)
        kernels.frames.trace_values(decision, signal, *last, values)
        self._count += len(begins)
        return Frames(begins, values)
