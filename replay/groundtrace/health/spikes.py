"""Spikes: single samples far off their neighbours, which nothing that moves can bring about.

Before it is sampled a signal is limited to half the rate: a true onset rings on over several
samples. A spike's second difference stands alone: large at its sample, half as large and opposite
on both sides, and nothing before or after.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .finding import Finding, Tally, times
from .held_lines import level

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from .windows import Window

#: Second differences are looked at from so many times their mean in the window on.
LOUD = 6.0
#: And so many times their mean within so many samples: a window may be silent for the most part.
LOCAL = 256
#: The same between two and so many samples away, of which at least so many are there.
NEAR, LEAST_NEAR = 8, 8
#: So many times the largest and the median of those: the first leaves out what rings, the second
#: what is only the largest of its noise (4 standard deviations of white noise are 6 medians).
ALONE, FAR = 4.0, 12.0
#: Worn sensors see hits of a heel shorter than a sample: only what stands so much higher counts.
WORN = 2.0
#: The two neighbours differ by no more than this part of the spike's height.
BACK = 0.25


class Spikes:
    """Looks for spikes.

    Parameters
    ----------
    stream, columns
        The channels that are looked at.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self._found = {c: Tally() for c in columns}
        self._highest = dict.fromkeys(columns, 0.0)
        self._heard = 0

    def hear(self, window: Window) -> None:
        """Take the next window."""
        self._heard += len(window)
        for c in self._found:
            row = window.values[c]
            worn = 1.0 if self.stream.channels[c].quantity in SEISMIC_QUANTITIES else WORN
            for at in _spikes(row, worn):
                index = at - window.left
                if 0 <= index < len(window):
                    span = window.time_ns(index), window.time_ns(index + 1)
                    self._found[c].add(*span, 1)
                    height = float(abs(row[at] - (row[at - 1] + row[at + 1]) / 2))
                    self._highest[c] = max(self._highest[c], height)

    def gap(self) -> None:
        """Nothing crosses windows."""

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with spikes."""
        for c, tally in self._found.items():
            if not tally.events:
                continue
            channel = self.stream.channels[c]
            yield Finding(
                self.stream.topic,
                channel.name,
                "spikes",
                tally.start_ns,
                tally.end_ns,
                tally.events,
                tally.samples / self._heard,
                f"single samples far off {times(tally.events)}, up to "
                f"{level(channel, self._highest[c])} high",
                "each may be picked as an onset on this channel, which alone makes no step",
                "look for static, bit errors or a loose contact",
            )


def _spikes(row: NDArray[np.floating], factor: float) -> list[int]:
    """Return the indices of spikes that stand ``factor`` times as high as they have to."""
    if len(row) < 2 * NEAR:
        return []
    bend = row[1:-1] - (row[:-2] + row[2:]) * row.dtype.type(0.5)
    np.abs(bend, out=bend)
    known = bend if not np.isnan(bend).any() else np.nan_to_num(bend)
    found = []
    for i in np.flatnonzero(known > LOUD * known.mean()).tolist():
        highest = known[i] >= known[max(0, i - 1) : i + 2].max()
        comes_back = abs(row[i + 2] - row[i]) <= BACK * known[i]
        loud = known[i] > LOUD * known[max(0, i - LOCAL) : i + LOCAL].mean()
        if highest and comes_back and loud and _alone(known, i, factor):
            found.append(i + 1)
    return found


def _alone(bend: NDArray[np.floating], i: int, factor: float) -> bool:
    """Return whether a second difference stands alone."""
    around = np.concatenate([bend[max(0, i - NEAR) : max(0, i - 1)], bend[i + 2 : i + NEAR + 1]])
    return bool(
        len(around) >= LEAST_NEAR
        and bend[i] >= factor * ALONE * around.max()
        and bend[i] >= factor * FAR * np.median(around)
    )
