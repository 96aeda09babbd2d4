"""Windows: a run of blocks cut into stretches long enough to judge, with a margin on both sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

#: Samples of context on both sides of a window.
MARGIN = 16
#: A window is so long, whatever the blocks: the mean of so many samples is not moved by one.
LENGTH_S, LEAST_SAMPLES = 2.0, 512


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A stretch of a run.

    Attributes
    ----------
    values
        Shape (n_channels, left + n + right), as stored, as floats that hold every stored value;
        NaN where a sample is not finite.
    left, right
        Samples of context before and after; fewer than the margin at the ends of a run.
    first
        Index in the run of the first sample after the context.
    start_ns
        Its time [ns].
    period_ns
        Time between two samples [ns].
    """

    values: NDArray[np.floating]
    left: int
    right: int
    first: int
    start_ns: int
    period_ns: float

    def __len__(self) -> int:
        return int(self.values.shape[1]) - self.left - self.right

    @property
    def core(self) -> NDArray[np.floating]:
        """The values without context, shape (n_channels, n)."""
        return self.values[:, self.left : self.left + len(self)]

    def time_ns(self, index: float) -> int:
        """Return the time of sample ``index`` of the core [ns]."""
        return self.start_ns + round(index * self.period_ns)


class Windows:
    """Makes windows of the blocks of one run after the other."""

    def __init__(self, rate_hz: float) -> None:
        self._length = max(LEAST_SAMPLES, round(LENGTH_S * rate_hz))
        self.reset()

    def reset(self) -> None:
        """Begin a new run."""
        self._context: NDArray[np.floating] | None = None
        self._waiting: list[NDArray[np.floating]] = []
        self._count = 0
        self._first = 0

    def add(self, block: SignalBlock) -> Iterator[Window]:
        """Take a block; yield the windows that it completes."""
        self._waiting.append(_floats(block))
        self._count += len(block)
        self._end_ns = block.end_ns
        self._period_ns = block.stream.period_ns
        while self._count >= self._length + MARGIN:
            yield self._window(self._count - self._length)

    def finish(self) -> Iterator[Window]:
        """Yield what is left and begin a new run."""
        if self._count:
            yield self._window(0)
        self.reset()

    def _window(self, rest: int) -> Window:
        """Return all that waits but its last ``rest`` samples, with context."""
        parts = self._waiting if self._context is None else [self._context, *self._waiting]
        values = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        left = 0 if self._context is None else self._context.shape[1]
        size, right = self._count - rest, min(rest, MARGIN)
        start_ns = self._end_ns - round(self._count * self._period_ns)
        shown = values[:, : left + size + right]
        window = Window(shown, left, right, self._first, start_ns, self._period_ns)
        self._context = values[:, max(0, left + size - MARGIN) : left + size]
        self._waiting, self._count = [values[:, left + size :]], rest
        self._first += size
        return window


def _floats(block: SignalBlock) -> NDArray[np.floating]:
    """Return samples channel by channel in a type that holds each of them exactly."""
    kind = block.samples.dtype
    small = (kind.kind in "iu" and kind.itemsize <= 2) or (kind.kind == "f" and kind.itemsize <= 4)
    values: NDArray[np.floating] = np.array(
        block.samples.T, np.float32 if small else np.float64, order="C"
    )
    if kind.kind == "f" and not np.isfinite(values).all():
        values[~np.isfinite(values)] = np.nan
    return values
