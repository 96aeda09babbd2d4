"""Writing an MCAP file: chunks that hold one kind of content each, their indexes and the summary.

Whoever reads one kind of content does not decompress the others, and each is compressed as suits
it. Schemas and channels lie in the chunks of the kind that needs them, before the first message
that does: what is left of a torn file says how its messages are read.
"""

from __future__ import annotations

import struct
from collections import Counter
from typing import TYPE_CHECKING, Final, Protocol

from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from zlib_ng import zlib_ng

from groundtrace_codecs.mcap.open_chunk import OpenChunk, encoded
from groundtrace_codecs.mcap.records import (
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mcap.records import McapRecord

# What of a Footer its CRC covers, and the length of its fields, which are 4 bytes more.
_FOOTER: Final = struct.Struct("<BQQQ")
_FOOTER_FIELDS: Final = 20


class Sink(Protocol):
    """Where the bytes of a file go."""

    def write(self, data: bytes) -> int:
        """Take the next bytes."""

    def flush(self) -> None:
        """Pass on what was taken."""


class McapWriter:
    """Writes one MCAP file.

    Parameters
    ----------
    sink
        Takes the file, which begins here.
    compression
        ``zstd``, ``lz4`` or ``none``.
    levels
        Of zstd, one for each kind of content; chunks that end together are in this order.
    chunk_bytes
        Length of records. Where a chunk is longer, those of all kinds are ended, so that their
        spans of time agree.
    profile, library
        Of the Header record.
    """

    def __init__(
        self,
        sink: Sink,
        compression: str,
        levels: Sequence[int],
        chunk_bytes: int,
        profile: str,
        library: str,
    ) -> None:
        self._sink = sink
        self._open = [OpenChunk(compression, level) for level in levels]
        self._open_of: dict[int, OpenChunk] = {}
        self._chunk_bytes = chunk_bytes
        self._length = self._crc = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._put(MAGIC + encoded(Header(profile, library)))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Return the id of a new schema, which is written before the first channel that has it."""
        schema_id = len(self._schemas) + 1
        self._schemas[schema_id] = Schema(schema_id, data, encoding, name)
        return schema_id

    def add_channel(
        self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str], kind: int
    ) -> int:
        """Return the id of a new channel.

        Parameters
        ----------
        topic, encoding, metadata
            Of the Channel record.
        schema_id
            What `add_schema` gave; 0 = none.
        kind
            Of its content: a place in ``levels``.
        """
        channel_id = len(self._channels) + 1
        channel = Channel(channel_id, topic, encoding, dict(metadata), schema_id)
        self._channels[channel_id] = channel
        chunk = self._open_of[channel_id] = self._open[kind]
        for record in (self._schemas[schema_id], channel) if schema_id else (channel,):
            chunk.define(record)
            if len(chunk) > self._chunk_bytes:
                self._end_chunks()
        return channel_id

    def add_message(
        self,
        channel_id: int,
        log_ns: int,
        data: bytes | memoryview,
        publish_ns: int,
        sequence: int,
    ) -> None:
        """Write a message; its times [ns] are 0 or more."""
        length = self._open_of[channel_id].add(channel_id, log_ns, data, publish_ns, sequence)
        if length > self._chunk_bytes:
            self._end_chunks()

    def add_attachment(
        self, made_ns: int, log_ns: int, name: str, media_type: str, data: bytes
    ) -> None:
        """Write an attachment, with the times it was made and recorded at [ns]."""
        record = encoded(Attachment(made_ns, log_ns, name, media_type, data))
        place = (self._length, len(record), log_ns, made_ns, len(data))
        self._attachments.append(AttachmentIndex(*place, name, media_type))
        self._put(record)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        record = encoded(Metadata(name, dict(values)))
        self._metadata.append(MetadataIndex(self._length, len(record), name))
        self._put(record)

    def flush(self) -> None:
        """End the chunks in progress that have messages, and pass on everything."""
        self._end_chunks()
        self._sink.flush()

    def finish(self) -> None:
        """End the file: the rest of the messages, the summary, and what leads to it."""
        self._end_chunks()
        self._put(encoded(DataEnd(self._crc)))
        self._crc = 0  # the summary has a CRC of its own
        start, offsets = self._length, list[SummaryOffset]()
        for opcode, records in self._summary():
            group = encoded(*records)
            offsets.append(SummaryOffset(opcode, self._length, len(group)))
            self._put(group)
        offset_start = self._length
        self._put(encoded(*offsets))
        covered = _FOOTER.pack(FOOTER, _FOOTER_FIELDS, start, offset_start)
        crc = zlib_ng.crc32(covered, self._crc)
        self._put(encoded(Footer(start, offset_start, crc)) + MAGIC)

    def _end_chunks(self) -> None:
        for chunk in self._open:
            if counts := chunk.counts:
                data, index = chunk.end(self._length)
                self._counts.update(counts)
                self._chunks.append(index)
                self._put(data)

    def _summary(self) -> tuple[tuple[int, Iterable[McapRecord]], ...]:
        """Return the records of the summary in groups of one opcode each."""
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return (
            (SCHEMA, self._schemas.values()),
            (CHANNEL, self._channels.values()),
            (STATISTICS, (statistics,)),
            (CHUNK_INDEX, self._chunks),
            (ATTACHMENT_INDEX, self._attachments),
            (METADATA_INDEX, self._metadata),
        )

    def _put(self, data: bytes) -> None:
        self._crc = zlib_ng.crc32(data, self._crc)
        self._length += len(data)
        self._sink.write(data)
