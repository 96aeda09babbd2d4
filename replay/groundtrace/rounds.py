"""What several streams hand over in turn, brought into one order that their portions do not change.

A source hands over all of one stream's window, then the next stream's, and the windows may be of
any length. A stage that brings streams together must not notice.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from groundtrace_codecs.events import Gap

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.signals import SignalBlock

    Item = SignalBlock | Gap

#: Reason of a gap at which times go back, so that they say nothing of the order.
STEPPED = "clock step"


@dataclass(slots=True)
class Rounds:
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
        ready = self.finish() if self._over(item) else []
        self._items.append(item)
        return ready

    def finish(self) -> list[Item]:
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
        if not any(held.topic == item.topic for held in self._items):
            return reached_ns > last_ns
        if any(isinstance(held, Gap) and held.reason == STEPPED for held in self._items):
            return True
        # what begins early in the round is of its window: the one before had little of the stream
        first_ns = min(held.start_ns for held in self._items)
        return 2 * item.start_ns >= first_ns + last_ns


def _last_ns(item: Item) -> int:
    return item.end_ns if isinstance(item, Gap) else item.last_ns


def in_order(items: Sequence[Item], order: Sequence[str]) -> list[Item]:
    """Return the items of a round, each stream's in its order, as :class:`Rounds` gives them."""
    gaps = [item for item in items if isinstance(item, Gap) and not item.bridged]
    cuts = sorted({gap.end_ns for gap in gaps if gap.reason != STEPPED})
    stepped: dict[str, int] = {}  # how often each stream's clock has
    keyed: list[tuple[tuple[int, int, int], Item]] = []
    for item in items:
        if isinstance(item, Gap):
            stepped[item.topic] = stepped.get(item.topic, 0) + (
                item.reason == STEPPED and not item.bridged
            )
            place = bisect_right(cuts, item.end_ns)
            keyed.append(((stepped[item.topic], place, 0), item))
            continue
        first = [i for i, q in enumerate(order[:-1]) if item.stream.columns_of({q})]
        if first:
            keyed.append(((-1, first[0], item.start_ns), item))
            continue
        last = 2 if item.stream.columns_of({order[-1]}) else 1
        for part in _parts(item, cuts):
            place = bisect_right(cuts, part.start_ns)
            keyed.append(((stepped.get(item.topic, 0), place, last), part))
    return [item for _, item in sorted(keyed, key=lambda pair: pair[0])]


def _parts(block: SignalBlock, cuts: Sequence[int]) -> Iterator[SignalBlock]:
    """Yield a block in parts, cut at times."""
    inside = [cut for cut in cuts if block.start_ns < cut <= block.last_ns]
    if not inside:
        yield block
        return
    edges = [block.index_of(cut) for cut in inside]
    yield from (block.slice(a, b) for a, b in pairwise([0, *edges, len(block)]) if b > a)
