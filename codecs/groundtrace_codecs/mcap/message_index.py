"""What the MessageIndex records after a chunk still tell of it when the chunk cannot be read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

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
    from collections.abc import Iterator

    from numpy.typing import NDArray

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


def indexed_times(source: ByteSource, offset: int) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield the MessageIndex records that follow a chunk at ``offset``.

    Each is a channel's id, and of its messages the log time [ns] and the place of the record among
    the chunk's [bytes], in the order of these, shape (n, 2).
    """
    while True:
        try:
            content = read_record(source, offset, MESSAGE_INDEX)
            fields = Fields(content)
            (channel_id,) = fields.unpack(U16)
            entries = fields.blob(fields.unpack(U32)[0])
        except MalformedError:
            return
        offset += RECORD_HEAD.size + len(content)
        whole = entries[: len(entries) // U64_U64.size * U64_U64.size]
        found = np.frombuffer(whole, "<u8").astype(np.int64).reshape(-1, 2)
        yield channel_id, found[np.argsort(found[:, 1], kind="stable")]


def indexed_messages(source: ByteSource, offset: int) -> IndexedMessages:
    """Count the messages of a chunk by the MessageIndex records that follow it at ``offset``."""
    total, times, seen = 0, set[int](), False
    for _, entries in indexed_times(source, offset):
        seen = True
        total += len(entries)
        if len(entries):
            times.update((int(entries[:, 0].min()), int(entries[:, 0].max())))
    if not seen:
        return IndexedMessages(None, None, None)
    return IndexedMessages(total, min(times, default=None), max(times, default=None))
