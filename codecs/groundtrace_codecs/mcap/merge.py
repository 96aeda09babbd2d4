"""Messages of many chunks as one stream in the order of a replay."""

from __future__ import annotations

from bisect import bisect_left
from heapq import heappop, heappush
from operator import itemgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from groundtrace_codecs.mcap.chunks import ChunkEntry
    from groundtrace_codecs.mcap.table import MessageTable

#: Order of a replay; in one chunk the offset is the last key.
replay_order = itemgetter(2, 0, 1)

#: Order of the first message left, offset of its chunk, its place in the chunk, the messages.
_Run = tuple[tuple[int, int, int], int, int, "MessageTable"]


def merge(
    chunks: Sequence[ChunkEntry], load: Callable[[ChunkEntry, int], MessageTable]
) -> Iterator[MessageTable]:
    """Merge the messages of ``chunks`` in the order (log time, channel id, sequence, offset).

    A chunk is loaded when its start time is due, so that as many are in memory as overlap. What
    comes before the next message of another chunk goes out in one piece.

    Parameters
    ----------
    chunks
        In the order (start time, offset).
    load
        Gives the messages of a chunk in order, none earlier than the log time it is told.
    """
    heap: list[_Run] = []
    waiting, floor_ns = 0, 0
    while True:
        while waiting < len(chunks) and (not heap or chunks[waiting].start_ns <= heap[0][0][0]):
            chunk = chunks[waiting]
            waiting += 1
            if run := load(chunk, floor_ns):
                heappush(heap, (replay_order(run[0]), chunk.offset, 0, run))
        if not heap:
            return
        _, offset, start, run = heappop(heap)
        stop = _before_others(run, start, heap)
        if waiting < len(chunks):
            stop = min(stop, max(start, run.before(chunks[waiting].start_ns)))
        yield run[start:stop]
        floor_ns = run[stop - 1].log_time
        if stop < len(run):
            heappush(heap, (replay_order(run[stop]), offset, stop, run))


def _before_others(run: MessageTable, start: int, heap: list[_Run]) -> int:
    """Find where ``run`` must let the next chunk of ``heap`` go first."""
    if not heap:
        return len(run)
    key = heap[0][0]
    # by time first, then among those of one time
    low = max(run.before(key[0]), start + 1)
    return bisect_left(run, key, low, max(run.before(key[0] + 1), low), key=replay_order)
