"""Signal remembered for stages that look back at the waveforms around a step.

A step is announced when a later arrival closes its window, which may take long. So the last
seconds are kept, and of the group of arrivals under way the window around its first one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.signals import SignalBlock, Stream

#: Time of the first sample [ns], and the samples, shape (n_samples, n_channels).
Cut = tuple[int, "NDArray[np.float64]"]

#: Longer than any picker holds a pick back [ns].
KEEP_NS = 3 * NS_PER_S


@dataclass(slots=True)
class Recall:
    """The recent signal of one stream, and the picks of the step under way.

    Attributes
    ----------
    stream
        What the columns of the signal are.
    before_ns, after_ns
        Span of a window before and from a group's first pick on [ns].
    together_ns
        How long after its first pick others still belong to a group [ns].
    ahead_s
        How far the clock of each column is ahead of the common one, shape (n_channels,) [s].
    first_ns
        The first sample since the clock was set back; None before it.

    Notes
    -----
    Windows are cut by the common clock: each column moved by whole samples. Steps are named, and
    picks come, by the clocks as they are.
    """

    stream: Stream
    before_ns: int
    after_ns: int
    together_ns: int
    ahead_s: NDArray[np.float64]
    _blocks: deque[SignalBlock] = field(default_factory=deque)
    _picks: list[Pick] = field(default_factory=list)
    _kept: Cut | None = None
    first_ns: int | None = None

    def hear(self, block: SignalBlock) -> None:
        """Take the next block; forget what no step can ask for any more."""
        self.first_ns = block.start_ns if self.first_ns is None else self.first_ns
        self._blocks.append(block)
        if self._picks and self._kept is None:
            first_ns = self._picks[0].time_ns
            if block.end_ns > first_ns + self.after_ns + KEEP_NS:
                self._kept = self._cut(first_ns)
        horizon = block.end_ns - KEEP_NS
        if self._picks and self._kept is None:
            spread_ns = round(float(np.ptp(self.ahead_s)) * NS_PER_S)
            horizon = min(horizon, self._picks[0].time_ns - self.before_ns - spread_ns)
        while self._blocks and self._blocks[0].end_ns <= horizon:
            self._blocks.popleft()

    def pick(self, pick: Pick) -> None:
        """Take a pick: into the group under way, or as the first of the next."""
        if self._picks and pick.time_ns - self._picks[0].time_ns > self.together_ns:
            self._picks, self._kept = [], None
        self._picks.append(pick)

    def forget(self) -> None:
        """Forget everything: the clock was set back."""
        self._blocks.clear()
        self._picks, self._kept, self.first_ns = [], None, None

    def window(self, step_ns: int) -> Cut:
        """Return the signal around a step: its first time [ns], and values in channel units."""
        if self._kept is not None and step_ns == self._picks[0].time_ns:
            return self._kept
        return self._cut(step_ns)

    def arrivals(self, step_ns: int, start_ns: int) -> NDArray[np.float64]:
        """Return each channel's first pick from a step on, after a time [s], (n_channels,).

        By the common clock.
        """
        found = np.full(len(self.stream.channels), np.nan)
        index = {c.name: i for i, c in enumerate(self.stream.channels)}
        for pick in self._picks:
            place = index.get(pick.channel)
            if place is not None and pick.time_ns >= step_ns:
                since = (pick.time_ns - start_ns) / NS_PER_S - self.ahead_s[place]
                found[place] = np.fmin(found[place], since)
        return found

    def _cut(self, step_ns: int) -> Cut:
        """Return the window of a step, held where there is no signal."""
        first_s = np.nanmin([*self.arrivals(step_ns, step_ns), np.inf])
        start_ns = step_ns - self.before_ns
        if self.ahead_s.any() and np.isfinite(first_s):
            start_ns += round(float(first_s) * NS_PER_S)
        moved = whole_samples(self.ahead_s, self.stream.rate_hz)
        low, high = int(moved.min(initial=0)), int(moved.max(initial=0))
        period_ns = self.stream.period_ns
        count = round((self.before_ns + self.after_ns) / period_ns)
        wide_ns, wide = self._samples(start_ns + round(low * period_ns), count + high - low)
        if low == high:
            return wide_ns, _held(wide)
        columns = [wide[m - low : m - low + count, c] for c, m in enumerate(moved.tolist())]
        return wide_ns - round(low * period_ns), _held(np.column_stack(columns))

    def _samples(self, start_ns: int, count: int) -> Cut:
        """Return samples from about a time on, NaN where there are none, by the clocks as are."""
        period_ns = self.stream.period_ns
        end_ns = start_ns + round(count * period_ns)
        values = np.full((count, len(self.stream.channels)), np.nan)
        inside = [b for b in self._blocks if b.end_ns > start_ns and b.start_ns < end_ns]
        if inside:  # on the grid of the samples
            start_ns = inside[0].time_of(round((start_ns - inside[0].start_ns) / period_ns))
        for block in inside:
            at = round((block.start_ns - start_ns) / period_ns)
            first, last = max(0, -at), min(len(block), len(values) - at)
            if first < last:
                values[at + first : at + last] = block.slice(first, last).values
        return start_ns, values


def whole_samples(ahead_s: NDArray[np.float64], rate_hz: float) -> NDArray[np.intp]:
    """Return by how many samples channels are moved whose clocks are ahead, shape (n,)."""
    return np.rint(ahead_s * rate_hz).astype(np.intp)


def _held(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the samples with gaps filled by the nearest finite value of their channel, else 0."""
    if np.isfinite(values).all():
        return values
    filled = np.zeros_like(values)
    for column in range(values.shape[1]):
        known = np.flatnonzero(np.isfinite(values[:, column]))
        if len(known):
            index = np.arange(len(values))
            after = np.clip(np.searchsorted(known, index), 0, len(known) - 1)
            before = np.clip(after - 1, 0, None)
            nearer = np.abs(known[before] - index) <= np.abs(known[after] - index)
            filled[:, column] = values[np.where(nearer, known[before], known[after]), column]
    return filled
