"""Buffers: blocks of several streams in one order of time, and signal kept to look back at.

A source hands over all of one stream's window, then the next stream's, and the windows may be of
any length. A stage that brings streams together must not depend on them.

Some stages look back at the waveforms around a step. A step is announced when a later arrival
closes its window, which may take long. So the last seconds are kept, and of the group of arrivals
under way the window around its first one.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.signals import SignalBlock, Stream

    Item = SignalBlock | Gap

#: Reason of a gap at which times go back, so that they say nothing of the order.
STEPPED = "clock step"


@dataclass(slots=True)
class StreamSynchronizer:
    """Holds back a round: what every stream hands over of one window.

    A round is over when a stream goes on where it ended, speaks again, from later than the middle
    of the round on, after others did, or begins after all others ended.
    Within it nothing is cut but at gaps: what other streams have from before the end of a gap
    comes before it.

    Attributes
    ----------
    order
        Quantities of streams: the last one's come last, what stands beside them is then known; the
        others' come first of all, in this order; all other streams between, as they come.
    """

    order: tuple[str, ...]
    _items: list[Item] = field(default_factory=list)

    def add(self, item: Item) -> list[Item]:
        """Take the next item; return the round before it, in order, where that is over."""
        ready = self.flush() if self._over(item) else []
        self._items.append(item)
        return ready

    def flush(self) -> list[Item]:
        """Return what is held back, in order."""
        items, self._items = self._items, []
        return in_order(items, self.order)

    def _over(self, item: Item) -> bool:
        if not self._items:
            return False
        before = self._items[-1]
        if item.topic == before.topic:
            if isinstance(before, Gap) or isinstance(item, Gap):
                return False
            return item.continues(before)
        last_ns = max(map(_last_ns, self._items))
        reached_ns = item.end_ns if isinstance(item, Gap) else item.start_ns
        if not any(buffered.topic == item.topic for buffered in self._items):
            return reached_ns > last_ns
        if any(
            isinstance(buffered, Gap) and buffered.reason == STEPPED for buffered in self._items
        ):
            return True
        # what begins early in the round is of its window: the one before had little of the stream
        first_ns = min(buffered.start_ns for buffered in self._items)
        return 2 * item.start_ns >= first_ns + last_ns


def _last_ns(item: Item) -> int:
    return item.end_ns if isinstance(item, Gap) else item.last_ns


def in_order(items: Sequence[Item], order: Sequence[str]) -> list[Item]:
    """Return the items of a round in the order in which :class:`StreamSynchronizer` gives them."""
    gaps = [item for item in items if isinstance(item, Gap) and not item.bridged]
    cuts = sorted({gap.end_ns for gap in gaps if gap.reason != STEPPED})
    stepped: dict[str, int] = {}  # how often each stream's clock has
    keyed: list[tuple[tuple[int, int, int], Item]] = []
    for item in items:
        if isinstance(item, Gap):
            stepped[item.topic] = stepped.get(item.topic, 0) + (
                item.reason == STEPPED and not item.bridged
            )
            cut_index = bisect_right(cuts, item.end_ns)
            keyed.append(((stepped[item.topic], cut_index, 0), item))
            continue
        first = [i for i, q in enumerate(order[:-1]) if item.stream.columns_of({q})]
        if first:
            keyed.append(((-1, first[0], item.start_ns), item))
            continue
        last = 2 if item.stream.columns_of({order[-1]}) else 1
        for part in _parts(item, cuts):
            cut_index = bisect_right(cuts, part.start_ns)
            keyed.append(((stepped.get(item.topic, 0), cut_index, last), part))
    return [item for _, item in sorted(keyed, key=lambda pair: pair[0])]


def _parts(block: SignalBlock, cuts: Sequence[int]) -> Iterator[SignalBlock]:
    """Yield a block in parts, cut at times."""
    inside = [cut for cut in cuts if block.start_ns < cut <= block.last_ns]
    if not inside:
        yield block
        return
    edges = [block.index_of(cut) for cut in inside]
    yield from (block.slice(a, b) for a, b in pairwise([0, *edges, len(block)]) if b > a)


#: Time of the first sample [ns], and the samples, shape (n_samples, n_channels).
Cut = tuple[int, "NDArray[np.float64]"]

#: So long there must have been signal before a step's first arrival, that it is surely the first
#: [ns]: a picker needs noise of 50 ms, and 10 ms more. Chosen by trial on simulated rooms, seeds 11
#: to 16, cut in a step: of 122 places of such steps .71 lie in their regions of 90 %, of 85 with 20
#: ms of signal .82, of 48 with 60 ms all.
HEARD_NS = NS_PER_S * 6 // 100
#: Longer than any picker holds a pick back [ns]. Chosen by judgement.
KEEP_NS = 3 * NS_PER_S


@dataclass(slots=True)
class SignalBuffer:
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
    _window: Cut | None = None
    _runs_ns: deque[int] = field(default_factory=deque)  # when the last runs of the signal began
    first_ns: int | None = None

    def update(self, block: SignalBlock) -> None:
        """Take the next block; forget what no step can ask for any more."""
        self.pass_over(block)
        self._blocks.append(block)
        if self._picks and self._window is None:
            first_ns = self._picks[0].time_ns
            if block.end_ns > first_ns + self.after_ns + KEEP_NS:
                self._window = self._cut(first_ns)
        horizon = block.start_ns - KEEP_NS  # the picks of this block are to come
        if self._picks and self._window is None:
            spread_ns = round(float(np.ptp(self.ahead_s)) * NS_PER_S)
            horizon = min(horizon, self._picks[0].time_ns - self.before_ns - spread_ns)
        while self._blocks and self._blocks[0].end_ns <= horizon:
            self._blocks.popleft()

    def pass_over(self, block: SignalBlock) -> None:
        """Take the next block where no step asks for it: only when the signal began is kept."""
        self.first_ns = block.start_ns if self.first_ns is None else self.first_ns
        if not self._runs_ns or block.anchor_ns != self._runs_ns[-1]:
            self._runs_ns.append(block.anchor_ns)
        while len(self._runs_ns) > 1 and self._runs_ns[1] < block.start_ns - 2 * KEEP_NS:
            self._runs_ns.popleft()

    def pick(self, pick: Pick) -> None:
        """Take a pick: into the group under way, or as the first of the next."""
        if self._picks and pick.time_ns - self._picks[0].time_ns > self.together_ns:
            self._picks, self._window = [], None
        self._picks.append(pick)

    def discard(self) -> None:
        """Forget everything: the clock was set back."""
        self._blocks.clear()
        self._runs_ns.clear()
        self._picks, self._window, self.first_ns = [], None, None

    def window(self, step_ns: int) -> Cut:
        """Return the signal around a step: its first time [ns], and values in channel units."""
        if self._window is not None and step_ns == self._picks[0].time_ns:
            return self._window
        return self._cut(step_ns)

    @property
    def heard_ns(self) -> int:
        """How long there must have been signal before a step, that none of it is missing [ns]."""
        return max(self.before_ns, HEARD_NS)

    def is_heard_before(self, step_ns: int) -> bool:
        """Return whether there was signal for so long before a step."""
        begun_ns = [t for t in (self.first_ns, *self._runs_ns) if t is not None and t <= step_ns]
        return step_ns - max(begun_ns, default=step_ns) >= self.heard_ns

    def arrivals(self, step_ns: int, start_ns: int) -> NDArray[np.float64]:
        """Return each channel's first pick from a step on, after a time [s], (n_channels,).

        By the common clock.
        """
        arrivals_s = [float("nan")] * len(self.stream.channels)
        ahead_s = self.ahead_s.tolist()
        index = {c.name: i for i, c in enumerate(self.stream.channels)}
        for pick in self._picks:
            column = index.get(pick.channel)
            if column is not None and pick.time_ns >= step_ns:
                since = (pick.time_ns - start_ns) / NS_PER_S - ahead_s[column]
                if not arrivals_s[column] <= since:
                    arrivals_s[column] = since
        return np.array(arrivals_s)

    def _cut(self, step_ns: int) -> Cut:
        """Return the window of a step, held where there is no signal."""
        start_ns = step_ns - self.before_ns
        if self.ahead_s.any():
            first_s = np.nanmin([*self.arrivals(step_ns, step_ns), np.inf])
            start_ns += round(float(first_s) * NS_PER_S) if np.isfinite(first_s) else 0
        moved = whole_samples(self.ahead_s, self.stream.rate_hz)
        low, high = int(moved.min(initial=0)), int(moved.max(initial=0))
        period_ns = self.stream.period_ns
        count = round((self.before_ns + self.after_ns) / period_ns)
        wide_ns, wide = self._samples(start_ns + round(low * period_ns), count + high - low)
        if low == high:
            return wide_ns, _filled(wide)
        columns = [wide[m - low : m - low + count, c] for c, m in enumerate(moved.tolist())]
        return wide_ns - round(low * period_ns), _filled(np.column_stack(columns))

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


def _filled(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the samples with gaps filled by the nearest finite value of their channel, else 0."""
    if np.isfinite(values).all():
        return values
    filled = np.zeros_like(values)
    for column in range(values.shape[1]):
        valid = np.flatnonzero(np.isfinite(values[:, column]))
        if len(valid):
            index = np.arange(len(values))
            after = np.clip(np.searchsorted(valid, index), 0, len(valid) - 1)
            before = np.clip(after - 1, 0, None)
            nearer = np.abs(valid[before] - index) <= np.abs(valid[after] - index)
            filled[:, column] = values[np.where(nearer, valid[before], valid[after]), column]
    return filled
