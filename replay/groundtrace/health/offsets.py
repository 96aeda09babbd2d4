"""Offset steps: a level that shifts and stays, of channels whose level is nothing but an offset.

Frames of 0.3 s hold whole periods of 50 and 60 Hz, and the mean of a wave that has passed is nil:
a step stands over the spread of the frames' means on both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .finding import Finding, Tally, times
from .held_lines import level

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from .windows import Window

    Array = NDArray[np.float64]

FRAME_S = 0.3
#: Frames on each side of a step: 3 s, longer than any step rings.
SIDE = 10
#: A step is so many times the range of the means on either side, and of the frames' own deviation:
#: less is neither sure nor matters.
SURE, MATTERS = 3.0, 1.0


class Offsets:
    """Looks for offset steps.

    Parameters
    ----------
    stream, columns
        The channels that are looked at; their values swing about a level that means nothing.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self.columns = list(columns)
        self.length = max(4, round(FRAME_S * stream.rate_hz))
        self._found = {c: Tally() for c in columns}
        self._largest = dict.fromkeys(columns, 0.0)
        self._begin()

    def gap(self) -> None:
        """Judge what is left and forget all levels: the next run may begin at another."""
        for _ in range(SIDE):
            self._keep(np.zeros(len(self.columns)), (0, 0))
        self._begin()

    def _begin(self) -> None:
        self._rest = np.empty((len(self.columns), 0))
        self._frames = np.empty((2, len(self.columns), 0))
        self._times: list[int] = []
        self._shifts = np.zeros((len(self.columns), 2 * SIDE))
        self._spans = [(0, 0)] * (2 * SIDE)

    def hear(self, window: Window) -> None:
        """Take the next window."""
        core = window.core[self.columns].astype(np.float64)
        before = self._rest.shape[1]
        core = np.concatenate([self._rest, core], axis=1)
        count = core.shape[1] // self.length
        folded = core[:, : count * self.length].reshape(len(self.columns), count, self.length)
        self._rest = core[:, count * self.length :]
        if not count:
            return
        mean = folded.mean(axis=2, dtype=np.float64)
        spread = folded.std(axis=2, dtype=np.float64)
        self._frames = np.concatenate([self._frames, np.stack([mean, spread])], axis=2)
        self._times += [window.time_ns(k * self.length - before) for k in range(count)]
        self._judge()

    def _judge(self) -> None:
        """Take the shift in the middle of as many frames as it needs, frame by frame."""
        while self._frames.shape[2] >= 2 * SIDE:
            shift = _shift(*self._frames[:, :, : 2 * SIDE])
            self._keep(shift, (self._times[SIDE - 1], self._times[SIDE + 1]))
            self._frames, self._times = self._frames[:, :, 1:], self._times[1:]

    def _keep(self, shift: Array, span_ns: tuple[int, int]) -> None:
        """Take a shift; count the middle one of those kept where it is the largest of them."""
        self._shifts = np.column_stack([self._shifts[:, 1:], shift])
        self._spans = [*self._spans[1:], span_ns]
        size = np.abs(self._shifts)
        for row in np.flatnonzero((size[:, SIDE] > 0) & (size.argmax(axis=1) == SIDE)):
            c = self.columns[row]
            self._found[c].add(*self._spans[SIDE], 0)
            self._largest[c] = max(self._largest[c], float(self._shifts[row, SIDE]), key=abs)

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with offset steps."""
        for c, tally in self._found.items():
            if tally.events:
                channel = self.stream.channels[c]
                yield Finding(
                    self.stream.topic,
                    channel.name,
                    "offset",
                    tally.start_ns,
                    tally.end_ns,
                    tally.events,
                    0.0,
                    f"its level shifts {times(tally.events)} and stays, by up to "
                    f"{level(channel, self._largest[c])}",
                    "a band-pass rings there once and may pick it on this channel",
                    "look for a loose contact or a change of gain",
                )


def _shift(mean: Array, own: Array) -> Array:
    """Return by how much each level shifts in the middle of frames; 0 where it is not sure.

    Parameters
    ----------
    mean, own
        Shape (n_channels, 2 * SIDE): mean and standard deviation of each frame.
    """
    before, after = (np.sort(part, axis=1) for part in (mean[:, : SIDE - 1], mean[:, SIDE + 1 :]))
    middle = (SIDE - 1) // 2
    shift = after[:, middle] - before[:, middle]
    spread = np.maximum(before[:, -1] - before[:, 0], after[:, -1] - after[:, 0])
    own = np.sort(own, axis=1)
    noise = own[:, SIDE // 2]  # between steps
    least = np.maximum(SURE * spread, MATTERS * noise)
    # where a channel stands still it is dead: said elsewhere
    return np.where((np.abs(shift) >= least) & (own[:, 0] > 0), shift, 0.0)
