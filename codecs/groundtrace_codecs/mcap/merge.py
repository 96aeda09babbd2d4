"""Messages of many chunks as one stream in the order of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.table import MessageTable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from groundtrace_codecs.mcap.chunks import ChunkEntry

# Later than any message: log times are u64.
_NEVER_NS = 1 << 64


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
    # what is left of each chunk, by its offset
    left: dict[int, MessageTable] = {}
    floor_ns = 0
    for place, chunk in enumerate(chunks):
        left[chunk.offset] = load(chunk, floor_ns)
        following = chunks[place + 1 : place + 2]
        stop_ns = following[0].start_ns if following else _NEVER_NS
        due = {offset: run.before(stop_ns) for offset, run in sorted(left.items())}
        parts = [left[offset][:stop] for offset, stop in due.items() if stop]
        left = {
            offset: run[due[offset] :] for offset, run in left.items() if due[offset] < len(run)
        }
        if parts:
            found = MessageTable.joined(parts).in_order() if len(parts) > 1 else parts[0]
            floor_ns = int(found.rows["log_time"][-1])
            yield found
