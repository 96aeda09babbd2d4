"""Clocks that were set back while a file was written: in what order its messages were recorded.

Log times tell the order of messages, but for a clock that is set back: it shows some times twice,
and by log time what was recorded first and last would be mixed. There the order of the file tells:
each message is read at the time that its clock would show, had it never been set back. Messages
that only lie in another order in the file, as some writers leave them, go by their log times.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.mcap.message_index import indexed_times

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.mcap.bytesource import ByteSource
    from groundtrace_codecs.mcap.chunks import ChunkEntry
    from groundtrace_codecs.mcap.segments import Segment
    from groundtrace_codecs.mcap.table import MessageTable

    Times = NDArray[np.int64]

#: Times that go back by no more than this are those of messages that came late [ns].
BACK_NS = 1_000_000_000
#: Fewest messages, before a step and after it, in the time that is shown twice, and what part of
#: them has one of the others within the mean interval: late messages fill a hole, those of a clock
#: that was set back do not.
_FEWEST, _DENSE = 3, 0.5
#: Times beyond are of no clock [ns].
_LATEST_NS = 2**62


def set_backs(times_ns: Times) -> list[tuple[int, int]]:
    """Return where a clock was set back, and by how much.

    Parameters
    ----------
    times_ns
        Shape (n,): in the order in which they were recorded [ns].

    Returns
    -------
    Of each step the index of the first time after it, and the sum of it and all before [ns]: with
    that added, the times go on by the usual interval.
    """
    steps = np.diff(times_ns)
    places = np.flatnonzero(steps < -BACK_NS) + 1
    if not len(places):
        return []
    usual_ns = round(float(np.median(steps[steps >= 0]))) if (steps >= 0).any() else 0
    found: list[tuple[int, int]] = []
    begin, total = 0, 0
    for place, after in zip(places.tolist(), [*places[1:].tolist(), len(times_ns)], strict=True):
        earlier, later = times_ns[begin:place], times_ns[place:after]
        if _show_the_same(earlier, later):
            total += int(earlier.max()) - int(later[0]) + usual_ns
            if total + int(later.max()) >= _LATEST_NS:
                return []
            found.append((place, total))
            begin = place
    return found


def _show_the_same(earlier: Times, later: Times) -> bool:
    """Return whether the times from a step on, up to where it came from, were shown before it."""
    low, high = int(later[0]), min(int(earlier.max()), int(later.max()))
    known = np.sort(earlier[(earlier >= low) & (earlier <= high)])
    again = np.sort(later[(later >= low) & (later <= high)])
    if min(len(known), len(again)) < _FEWEST:
        return False
    apart_ns = (int(earlier.max()) - int(earlier.min())) / (len(earlier) - 1)
    return all(
        np.mean(_nearest_ns(one, other) <= apart_ns) >= _DENSE
        for one, other in ((known, again), (again, known))
    )


def _nearest_ns(times: Times, others: Times) -> Times:
    """Return how far each time is from the nearest of other sorted ones, shape (n,) [ns]."""
    after = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    apart_ns: Times = np.minimum(np.abs(times - others[after - 1]), np.abs(times - others[after]))
    return apart_ns


class _Steps(NamedTuple):
    """Of one channel: the places in the file from which on its messages are read later.

    ``places`` are offsets of the chunk and of the record in it [bytes], ``later_ns`` by how much.
    """

    places: list[tuple[int, int]]
    later_ns: list[int]

    def at(self, chunk: int, records: Times) -> Times:
        """Return by how much the messages of a chunk are read later, shape (n,) [ns]."""
        later_ns = np.zeros(len(records), np.int64)
        for (offset, record), total in zip(self.places, self.later_ns, strict=True):
            if offset < chunk:
                later_ns[:] = total
            elif offset == chunk:
                later_ns[records >= record] = total
        return later_ns


class _Series(NamedTuple):
    """The messages of one channel in the order of the file: log times, and where they lie."""

    times_ns: Times
    chunks: Times
    records: Times

    @property
    def usual_ns(self) -> int:
        """The usual interval [ns]."""
        steps = np.diff(self.times_ns)
        return round(float(np.median(steps[steps >= 0]))) if (steps >= 0).any() else 0


@dataclass(frozen=True, slots=True, eq=False)
class ReadingClock:
    """At what times the messages of a file are read whose clock was set back.

    Attributes
    ----------
    chunks
        Where the messages are, with times of reading, in the order (start time, offset).
    edges_ns
        Times of reading of the first message after each step, in order.
    latest_ns
        By how much a message is read later than it was logged at most.
    """

    chunks: tuple[ChunkEntry, ...]
    edges_ns: tuple[int, ...]
    latest_ns: int
    _steps: dict[int, _Steps]

    def read(self, entry: ChunkEntry, found: MessageTable) -> MessageTable:
        """Return a chunk's messages with their times of reading as log times."""
        own = [i for i in found.counts() if i in self._steps]
        if not own:
            return found
        rows = found.rows.copy()
        for i in own:
            mine = rows["channel_id"] == i
            # a row tells where the payload begins, behind the head of its record
            later_ns = self._steps[i].at(entry.offset, rows["start"][mine])
            rows["log_time"][mine] += later_ns.astype(np.uint64)
        return type(found)(found.pieces, rows)


def reading_clock(
    source: ByteSource,
    chunks: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
    *,
    near: bool,
) -> ReadingClock | None:
    """Return when messages are to be read, or None where no clock was set back.

    Parameters
    ----------
    source
        The file.
    chunks, segments
        Of its index.
    wanted
        Channels that are asked about; others are read when they were logged.
    near
        Whether the file is of this machine. The indexes behind the chunks tell: they are looked at
        where a chunk is longer than a second, else where chunks overlap by more than that.
    """
    ordered = sorted((c for c in chunks if not c.bare), key=lambda chunk: chunk.offset)
    long = near and any(c.end_ns - c.start_ns > BACK_NS for c in ordered)
    if not wanted or not (long or _overlap(ordered)):
        return None
    back = _gone_back(source, ordered, segments, wanted)
    series = _series(source, ordered, segments, back)
    found = {i: known for i, one in series.items() if (known := set_backs(one.times_ns))}
    if not found:
        return None
    found = _together(found, series)
    steps: dict[int, _Steps] = {}
    edges: set[int] = set()
    for i, own in found.items():
        one = series[i]
        places = [(int(one.chunks[at]), int(one.records[at])) for at, _ in own]
        steps[i] = _Steps(places, [later_ns for _, later_ns in own])
        edges.update(int(one.times_ns[at]) + later_ns for at, later_ns in own)
    latest_ns = max(own.later_ns[-1] for own in steps.values())
    return ReadingClock(_as_read(chunks, steps, wanted), tuple(sorted(edges)), latest_ns, steps)


def _overlap(ordered: Sequence[ChunkEntry]) -> bool:
    """Return whether a chunk goes back to a time that those before it had left."""
    reached: dict[int, int] = {}
    for chunk in ordered:
        for i in chunk.channel_ids or ():
            if chunk.start_ns < reached.get(i, 0) - BACK_NS:
                return True
            reached[i] = max(reached.get(i, 0), chunk.end_ns)
    return False


def _indexed(
    source: ByteSource, chunk: ChunkEntry, segments: Sequence[Segment], wanted: Collection[int]
) -> Iterator[tuple[int, Times]]:
    """Yield of each wanted channel of a chunk its log times and the places of its records."""
    ids = segments[chunk.segment].ids
    for own, entries in indexed_times(source, chunk.offset + chunk.length):
        i = own if ids is None else ids.get(own, -1)
        if i in wanted:
            sound = (entries[:, 0] >= 0) & (entries[:, 0] < _LATEST_NS)
            yield i, entries[sound]


def _gone_back(
    source: ByteSource,
    ordered: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
) -> set[int]:
    """Return the channels of which a time goes back by more than a late message's."""
    back: set[int] = set()
    reached: dict[int, int] = {}
    for chunk in ordered:
        for i, entries in _indexed(source, chunk, segments, wanted):
            times_ns = entries[:, 0]
            before = np.maximum.accumulate(np.append(reached.get(i, 0), times_ns))
            if (times_ns < before[:-1] - BACK_NS).any():
                back.add(i)
            reached[i] = int(before[-1])
    return back


def _series(
    source: ByteSource,
    ordered: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
) -> dict[int, _Series]:
    parts: defaultdict[int, list[tuple[Times, int]]] = defaultdict(list)
    for chunk in ordered if wanted else ():
        for i, entries in _indexed(source, chunk, segments, wanted):
            parts[i].append((entries, chunk.offset))
    return {
        i: _Series(
            np.concatenate([entries[:, 0] for entries, _ in own]),
            np.concatenate([np.full(len(entries), offset) for entries, offset in own]),
            np.concatenate([entries[:, 1] for entries, _ in own]),
        )
        for i, own in parts.items()
    }


def _together(
    found: Mapping[int, list[tuple[int, int]]], series: Mapping[int, _Series]
) -> dict[int, list[tuple[int, int]]]:
    """Let channels whose clock was set back together go on together: the fastest tells by what.

    A channel knows its own step to one interval only.
    """
    told: list[tuple[int, int]] = []  # of a step the last time before it, and its length [ns]
    out = {}
    for i in sorted(found, key=lambda i: series[i].usual_ns):
        one, total, before = series[i], 0, 0
        out[i] = list[tuple[int, int]]()
        for at, sum_ns in found[i]:
            last_ns, length_ns = int(one.times_ns[:at].max()), sum_ns - before
            reach_ns = 2 * one.usual_ns + BACK_NS // 2
            alike = [
                known
                for known in told
                if abs(known[0] - last_ns) <= reach_ns and abs(known[1] - length_ns) <= reach_ns
            ]
            if not alike:
                told.append((last_ns, length_ns))
            total, before = total + (alike[0][1] if alike else length_ns), sum_ns
            out[i].append((at, total))
    return out


def _as_read(
    chunks: Sequence[ChunkEntry], steps: Mapping[int, _Steps], wanted: Collection[int]
) -> tuple[ChunkEntry, ...]:
    """Return chunks with times of reading, which their messages do not leave."""
    moved = []
    ends = np.array([0, 2**62])
    for chunk in chunks:
        own = set(wanted) if chunk.channel_ids is None else chunk.channel_ids & set(wanted)
        shifts = [0]
        if own and not chunk.bare:
            none = np.zeros(2, np.int64)
            per = [steps[i].at(chunk.offset, ends) if i in steps else none for i in own]
            shifts = np.concatenate(per).tolist()
        start_ns, end_ns = chunk.start_ns + min(shifts), chunk.end_ns + max(shifts)
        moved.append(replace(chunk, start_ns=start_ns, end_ns=end_ns))
    return tuple(sorted(moved, key=lambda chunk: (chunk.start_ns, chunk.offset)))
