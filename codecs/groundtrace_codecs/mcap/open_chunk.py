"""The chunk in progress of a file that is written: its records, and what becomes of them."""

from __future__ import annotations

import struct
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, ChunkIndex, Schema
from zlib_ng import zlib_ng

from groundtrace_codecs.mcap.records import MESSAGE, MESSAGE_FIELDS, MESSAGE_INDEX, RECORD_HEAD

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcap.records import Channel, McapRecord

# Head and fields of a Message, and of a MessageIndex.
_MESSAGE: Final = struct.Struct("<BQHIQQ").pack
_INDEX: Final = struct.Struct("<BQHI")
# An entry of a MessageIndex: log time and place.
_ENTRY_BYTES: Final = 16


class OpenChunk:
    """One chunk after the other of one kind of content.

    Parameters
    ----------
    compression
        ``zstd``, ``lz4`` or ``none``.
    level
        Of zstd.
    """

    def __init__(self, compression: str, level: int) -> None:
        self._compression = "" if compression == "none" else compression
        self._packed = _packer(compression, level)
        self._schemas: set[int] = set()
        self._begin()

    def __len__(self) -> int:
        """Return the length of the records so far [bytes]."""
        return len(self._records)

    @property
    def counts(self) -> dict[int, int]:
        """How many messages there are, by channel in the order of their first."""
        return {i: len(entries) // 2 for i, entries in self._index.items()}

    def define(self, record: Schema | Channel) -> None:
        """Take a definition; a schema that one of these chunks has already changes nothing."""
        if isinstance(record, Schema):
            if record.id in self._schemas:
                return
            self._schemas.add(record.id)
        self._records += encoded(record)

    def add(
        self,
        channel_id: int,
        log_ns: int,
        data: bytes | memoryview,
        publish_ns: int,
        sequence: int,
    ) -> int:
        """Take a message; return the length of the records so far [bytes]."""
        records = self._records
        size = MESSAGE_FIELDS + len(data)
        head = _MESSAGE(MESSAGE, size, channel_id, sequence, log_ns, publish_ns)
        self._index[channel_id] += (log_ns, len(records))
        records += head
        records += data
        return len(records)

    def end(self, offset: int) -> tuple[bytes, ChunkIndex]:
        """End the chunk, which has messages, and begin the next.

        Parameters
        ----------
        offset
            Where in the file it will lie [bytes].

        Returns
        -------
        bytes
            The Chunk record, and the MessageIndex records that follow it.
        ChunkIndex
            What the summary says of it.
        """
        records, index = self._records, self._index
        self._begin()
        start_ns = min(min(entries[::2]) for entries in index.values())
        end_ns = max(max(entries[::2]) for entries in index.values())
        packed, crc = self._packed(records), zlib_ng.crc32(records)
        parts = [encoded(Chunk(self._compression, packed, end_ns, start_ns, crc, len(records)))]
        place = index_start = offset + len(parts[0])
        offsets: dict[int, int] = {}
        for channel_id, entries in index.items():
            offsets[channel_id] = place
            parts.append(_index_record(channel_id, entries))
            place += len(parts[-1])
        return b"".join(parts), ChunkIndex(
            chunk_length=len(parts[0]),
            chunk_start_offset=offset,
            compression=self._compression,
            compressed_size=len(packed),
            message_end_time=end_ns,
            message_index_length=place - index_start,
            message_index_offsets=offsets,
            message_start_time=start_ns,
            uncompressed_size=len(records),
        )

    def _begin(self) -> None:
        self._records = bytearray()
        # log time and place of each message in turn, by channel
        self._index: defaultdict[int, list[int]] = defaultdict(list)


def encoded(*records: McapRecord) -> bytes:
    """Return the bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _packer(compression: str, level: int) -> Callable[[bytearray], bytes]:
    if compression == "zstd":
        return zstandard.ZstdCompressor(level).compress
    return lz4.frame.compress if compression == "lz4" else bytes


def _index_record(channel_id: int, entries: list[int]) -> bytes:
    size = len(entries) // 2 * _ENTRY_BYTES
    head = _INDEX.pack(MESSAGE_INDEX, _INDEX.size - RECORD_HEAD.size + size, channel_id, size)
    return head + struct.pack(f"<{len(entries)}Q", *entries)
