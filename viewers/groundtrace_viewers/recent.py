"""The last samples of a stream, for what is decided about them later."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

#: How much signal is kept [s]; gaps do not count, so a shot stays until others replace it.
KEEP_S = 10.0


class Recent:
    """Keeps the last blocks of a stream.

    Parameters
    ----------
    stream
        What the blocks hold.
    keep_s
        How much signal is kept at least [s].
    """

    def __init__(self, stream: Stream, keep_s: float = KEEP_S) -> None:
        self._blocks: deque[SignalBlock] = deque()
        self._enough = round(keep_s * stream.rate_hz)
        self._held = 0

    def push(self, block: SignalBlock) -> None:
        """Take a block."""
        self._blocks.append(block)
        self._held += len(block)
        while self._held - len(self._blocks[0]) >= self._enough:
            self._held -= len(self._blocks.popleft())

    def value(self, time_ns: int, columns: list[int]) -> float:
        """Return the norm over columns of the sample at a time, with its sign if it is one column.

        The value is in the channels' unit, and 0 where the sample is no longer or not yet there.
        """
        for block in reversed(self._blocks):
            if block.start_ns <= time_ns < block.end_ns:
                at = min(block.index_of(time_ns), len(block) - 1)
                sample = block.samples[at, columns] * block.stream.scales[columns]
                return float(sample[0] if len(columns) == 1 else np.linalg.norm(sample))
        return 0.0

    def between(
        self, start_ns: int, end_ns: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield times, shape (n,), and values, shape (n, n_channels), of a half-open span."""
        for block in self._blocks:
            if block.start_ns < end_ns and block.last_ns >= start_ns:
                part = block.slice(block.index_of(start_ns), block.index_of(end_ns))
                yield part.sample_times(), part.values
