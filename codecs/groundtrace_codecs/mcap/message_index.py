"""What the MessageIndex records after a chunk still tell of it when the chunk cannot be read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from groundtrace_codecs.mcap.records import (
    MESSAGE_INDEX,
    RECORD_HEAD,
    U16,
    U32,
    U64_U64,
    Fields,
    MalformedError,
    read_record,
)

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource


class IndexedMessages(NamedTuple):
    """What the MessageIndex records after a chunk say of it; None where there are none.

    Attributes
    ----------
    messages
        Their number.
    start_ns, end_ns
        First and last log time.
    """

    messages: int | None
    start_ns: int | None
    end_ns: int | None


def indexed_messages(source: ByteSource, offset: int) -> IndexedMessages:
    """Count the messages of a chunk by the MessageIndex records that follow it at ``offset``."""
    total, times, seen = 0, set[int](), False
    while True:
        try:
            content = read_record(source, offset, MESSAGE_INDEX)
            fields = Fields(content)
            fields.unpack(U16)
            entries = fields.blob(fields.unpack(U32)[0])
        except MalformedError:
            break
        seen = True
        offset += RECORD_HEAD.size + len(content)
        pairs = len(entries) // U64_U64.size
        total += pairs
        log_times = [t for t, _ in U64_U64.iter_unpack(entries[: pairs * U64_U64.size])]
        times.update((min(log_times), max(log_times)) if log_times else ())
    if not seen:
        return IndexedMessages(None, None, None)
    return IndexedMessages(total, min(times, default=None), max(times, default=None))
