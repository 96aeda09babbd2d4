"""Messages of many chunks as one stream in the order of a replay."""

from __future__ import annotations

from heapq import heappop, heappush
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.table import MessageTable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from groundtrace_codecs.mcap.chunks import ChunkEntry

# Later than any message: log times are u64.
_NEVER_NS = 1 << 64
_NONE = MessageTable.none()

#: Of a chunk the first log time that is left, its offset, and what is left.
_Left = tuple[int, int, MessageTable]


def merge(
    chunks: Sequence[ChunkEntry], load: Callable[[ChunkEntry, int], MessageTable]
) -> Iterator[MessageTable]:
    """Merge the messages of ``chunks`` in the order (log time, channel id, sequence, offset).

    A chunk is loaded when all that comes before its start has gone out, so that as many are in
    memory as overlap. What comes before the start of the next goes out in one piece.

    Parameters
    ----------
    chunks
        In the order (start time, offset).
    load
        Gives the messages of a chunk in order, none earlier than the log time it is told.
    """
    left: list[_Left] = []
    floor_ns = 0
    for place, chunk in enumerate(chunks):
        _keep(left, chunk.offset, load(chunk, floor_ns))
        following = chunks[place + 1 : place + 2]
        found = _due(left, following[0].start_ns if following else _NEVER_NS)
        if found:
            floor_ns = int(found.rows["log_time"][-1])
            yield found
        del found  # its memory is wanted for the next chunk


def _keep(left: list[_Left], offset: int, run: MessageTable) -> None:
    if run:
        heappush(left, (int(run.rows["log_time"][0]), offset, run))


def _due(left: list[_Left], stop_ns: int) -> MessageTable:
    """Take out the messages before a time [ns], in order."""
    due: dict[int, MessageTable] = {}
    while left and left[0][0] < stop_ns:
        _, offset, run = heappop(left)
        stop = run.before(stop_ns)
        due[offset] = run[:stop]
        _keep(left, offset, run[stop:])
    parts = [due[offset] for offset in sorted(due)]
    return MessageTable.joined(parts).in_order() if len(parts) > 1 else (parts or [_NONE])[0]
