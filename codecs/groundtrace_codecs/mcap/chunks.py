"""From a Chunk record to its messages: checked, bounded decompression and one walk.

A chunk is delivered whole or not at all. Its CRC covers the uncompressed records only, so nothing
else of the record is believed: times and channels come from a checked summary or from the records
themselves.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

import lz4.frame
import zstandard
from zlib_ng import zlib_ng

from groundtrace_codecs.mcap.records import (
    CHANNEL,
    CHUNK,
    MAX_RECORD_BYTES,
    RECORD_HEAD,
    SCHEMA,
    U64,
    ChannelRecord,
    Fields,
    MalformedError,
    Schema,
    parse_channel,
    parse_schema,
    read_record,
)
from groundtrace_codecs.mcap.table import MessageTable
from groundtrace_codecs.mcap.walk import message_places

if TYPE_CHECKING:
    from collections.abc import Container

    from groundtrace_codecs.mcap.bytesource import ByteSource

_CHUNK_HEAD: Final = struct.Struct("<QQQI")

# What each format can reach at best (zstd: a 4-byte block repeats 128 KiB; LZ4: 255 bytes a byte);
# more is a lie, and would be allocated before it is found out.
_MAX_RATIO: Final = {"": 1, "lz4": 256, "zstd": 1 << 15}


class MisplacedError(MalformedError):
    """The index points to something that is not the chunk it describes."""


@dataclass(frozen=True, slots=True)
class ChunkEntry:
    """Where messages are: a chunk, or a run of messages outside any chunk.

    Attributes
    ----------
    offset, length
        Bytes of the whole record or run.
    start_ns, end_ns
        First and last log time.
    channel_ids
        Channels with messages inside; None = unknown.
    bare
        True for a run of Message records outside any chunk.
    segment
        Which of the files written one after the other it belongs to, from 0.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channel_ids: frozenset[int] | None
    bare: bool = False
    segment: int = 0


@dataclass(slots=True)
class Definitions:
    """The schemas and channels of a file; every channel's schema is 0 or among them."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)

    def add(self, opcode: int, content: memoryview) -> None:
        """Take a Schema or Channel record; other records and repeats change nothing.

        Raises
        ------
        MalformedError
            If an id gets a second meaning, or a channel names a schema that is not there.
        """
        if opcode == SCHEMA:
            schema = parse_schema(content)
            if self.schemas.setdefault(schema.id, schema) != schema:
                raise MalformedError(
                    f"expected one schema {schema.id}, found a second, different one"
                )
        elif opcode == CHANNEL:
            channel = parse_channel(content)
            if channel.schema_id and channel.schema_id not in self.schemas:
                raise MalformedError(
                    f"expected schema {channel.schema_id} before channel {channel.id}, found none"
                )
            if self.channels.setdefault(channel.id, channel) != channel:
                raise MalformedError(
                    f"expected one channel {channel.id}, found a second, different one"
                )


@dataclass(slots=True)
class ChunkReader:
    """Reads chunks of one source; not to be shared between threads.

    Attributes
    ----------
    source
        The file.
    definitions
        What its messages refer to; definitions met on the way are added.
    """

    source: ByteSource
    definitions: Definitions
    _zstd: zstandard.ZstdDecompressor = field(default_factory=zstandard.ZstdDecompressor)

    def records(self, entry: ChunkEntry) -> memoryview:
        """Give the uncompressed, checked records of ``entry``.

        Raises
        ------
        MisplacedError
            If no chunk of that length is there.
        MalformedError
            If the chunk cannot be decompressed or its CRC does not match.
        """
        if entry.bare:
            if entry.length > MAX_RECORD_BYTES:
                raise MalformedError(
                    f"expected a message of at most 1 GiB, found {entry.length} bytes"
                )
            return memoryview(self.source.read_at(entry.offset, entry.length))
        try:
            content = read_record(self.source, entry.offset, CHUNK)
        except MalformedError as error:
            raise MisplacedError(str(error)) from error
        if len(content) + RECORD_HEAD.size != entry.length:
            raise MisplacedError(
                f"expected a chunk of {entry.length} bytes, found {len(content) + RECORD_HEAD.size}"
            )
        return self._unpack(Fields(content))

    def mended(self, entry: ChunkEntry) -> memoryview:
        """Give the checked records of a chunk whose opcode or length field is wrong.

        Its own fields must fill ``entry`` exactly, and it must have a CRC.

        Raises
        ------
        MalformedError
            If that is not so.
        """
        if entry.bare or entry.length > MAX_RECORD_BYTES:
            raise MalformedError("expected a chunk of at most 1 GiB, found none")
        fields = Fields(
            memoryview(self.source.read_at(entry.offset, entry.length))[RECORD_HEAD.size :]
        )
        crc = fields.unpack(_CHUNK_HEAD)[3]
        fields.text()
        fields.blob(fields.unpack(U64)[0])
        if not crc or fields.position + RECORD_HEAD.size != entry.length:
            raise MalformedError(
                f"expected fields of {entry.length - RECORD_HEAD.size} bytes and a CRC, "
                f"found {fields.position} and 0x{crc:08x}"
            )
        fields.position = 0
        return self._unpack(fields)

    def head_fault(self, entry: ChunkEntry) -> str:
        """Say what is wrong with the head of a chunk that was read by its own fields."""
        opcode, length = RECORD_HEAD.unpack(self.source.read_at(entry.offset, RECORD_HEAD.size))
        return (
            f"chunk head: expected opcode 0x06 of {entry.length - RECORD_HEAD.size} bytes, "
            f"found 0x{opcode:02x} of {length}; read by the chunk's own fields"
        )

    def messages(
        self, records: memoryview, wanted: Container[int], start_ns: int, stop_ns: int
    ) -> tuple[MessageTable, int]:
        """Collect messages of ``wanted`` channels with log time in ``[start_ns, stop_ns)``.

        Returns
        -------
        messages
            In the order (log time, channel id, sequence, offset).
        strays
            Number of messages whose channel is defined nowhere.

        Raises
        ------
        MalformedError
            If the records do not fill the chunk exactly.
        """
        try:
            places = message_places(records, partial(self._define, records))
            found = MessageTable.at(records, places)
        except struct.error as error:
            raise MalformedError(
                "expected whole records, found one cut by the chunk's end"
            ) from error
        counts = found.counts()
        chosen = [i for i in counts if i in wanted]
        if len(chosen) < len(counts):
            found = found.of_channels(chosen)
        known = self.definitions.channels
        strays = sum(n for i, n in counts.items() if i not in wanted and i not in known)
        return found.between(start_ns, stop_ns).in_order(), strays

    def _define(self, records: memoryview, position: int) -> int:
        opcode, length = RECORD_HEAD.unpack_from(records, position)
        start = position + RECORD_HEAD.size
        self.definitions.add(opcode, records[start : start + min(length, len(records))])
        return int(start + length)

    def _unpack(self, fields: Fields) -> memoryview:
        _, _, size, crc = fields.unpack(_CHUNK_HEAD)
        compression = fields.text()
        packed = fields.blob(fields.unpack(U64)[0])
        if compression not in _MAX_RATIO:
            raise MalformedError(f"expected compression zstd, lz4 or none, found {compression!r}")
        limit = min(MAX_RECORD_BYTES, len(packed) * _MAX_RATIO[compression])
        if size > limit:
            raise MalformedError(f"expected at most {limit} uncompressed bytes, found {size}")
        records = packed if compression == "" else self._decompress(compression, packed, size)
        if len(records) != size:
            raise MalformedError(f"expected {size} uncompressed bytes, found {len(records)}")
        # A CRC of 0 means that the writer kept none (MCAP specification, "Chunk").
        if crc and (found := zlib_ng.crc32(records)) != crc:
            raise MalformedError(f"expected chunk CRC 0x{crc:08x}, found 0x{found:08x}")
        return records

    def _decompress(self, compression: str, packed: memoryview, size: int) -> memoryview:
        try:
            if compression == "lz4":
                # One byte more than wanted, so that a longer frame is noticed.
                decoder = lz4.frame.LZ4FrameDecompressor()
                return memoryview(decoder.decompress(packed, max_length=size + 1))
            declared = zstandard.frame_content_size(packed)
            if declared not in (-1, size):
                raise MalformedError(f"expected {size} uncompressed bytes, found {declared}")
            return memoryview(self._zstd.decompress(packed, max_output_size=size))
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
            raise MalformedError(f"expected {compression} data, found: {error}") from error
