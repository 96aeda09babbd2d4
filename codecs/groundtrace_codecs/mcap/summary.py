"""The summary section: what a file says of itself, checked before it is believed."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from groundtrace_codecs.mcap.bytesource import Window, crc32_of
from groundtrace_codecs.mcap.chunks import ChunkEntry, Definitions
from groundtrace_codecs.mcap.records import (
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    METADATA_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    U32,
    U64_U64,
    AttachmentRef,
    Fields,
    MalformedError,
)

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource

_FOOTER: Final = struct.Struct("<BQQQI")
_CHUNK_INDEX: Final = struct.Struct("<QQQQ")
_ATTACHMENT_INDEX: Final = struct.Struct("<QQQQQ")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
_COUNT: Final = struct.Struct("<HQ")


@dataclass(frozen=True, slots=True)
class Statistics:
    """How many records of each kind the file holds, and the span of its log times."""

    messages: int
    schemas: int
    channels: int
    attachments: int
    metadata: int
    chunks: int
    start_ns: int
    end_ns: int
    message_counts: dict[int, int]


class Summary:
    """The records of a summary section.

    Attributes
    ----------
    definitions
        Schemas, and after `complete` channels.
    channels
        Contents of the Channel records.
    chunks, attachments
        As indexed.
    metadata
        Offset and length of each Metadata record.
    statistics
        None where the summary has none.
    """

    def __init__(self) -> None:
        self.definitions = Definitions()
        self.channels: list[memoryview] = []
        self.chunks: list[ChunkEntry] = []
        self.attachments: list[AttachmentRef] = []
        self.metadata: list[tuple[int, int]] = []
        self.statistics: Statistics | None = None

    def take(self, opcode: int, content: memoryview) -> None:
        """Take one record; kinds that say nothing about where things are change nothing."""
        if opcode == SCHEMA:
            self.definitions.add(opcode, content)
        elif opcode == CHANNEL:
            # The groups of a summary have no order, and a channel needs its schema.
            self.channels.append(content)
        elif opcode == CHUNK_INDEX:
            self._chunk(Fields(content))
        elif opcode == ATTACHMENT_INDEX:
            self._attachment(Fields(content))
        elif opcode == METADATA_INDEX:
            offset, length = Fields(content).unpack(U64_U64)
            self.metadata.append((offset, length))
        elif opcode == STATISTICS:
            self._statistics(Fields(content))

    def complete(self) -> bool:
        """Tell whether the summary lists everything that the data section holds."""
        stated = self.statistics
        if stated is None or (stated.messages and not self.chunks):
            return False
        if stated.schemas != len(self.definitions.schemas) or stated.channels != len(self.channels):
            return False
        for content in self.channels:
            self.definitions.add(CHANNEL, content)
        return (
            stated.channels == len(self.definitions.channels)
            and stated.chunks == len({chunk.offset for chunk in self.chunks}) == len(self.chunks)
            and stated.attachments == len(self.attachments)
            and stated.metadata == len(self.metadata)
        )

    def _chunk(self, fields: Fields) -> None:
        start_ns, end_ns, offset, length = fields.unpack(_CHUNK_INDEX)
        offsets = fields.blob(fields.unpack(U32)[0])
        # An empty map means that the writer kept no message index, not that the chunk is empty.
        ids = frozenset(channel for channel, _ in _pairs(offsets)) or None
        self.chunks.append(ChunkEntry(offset, length, start_ns, end_ns, ids))

    def _attachment(self, fields: Fields) -> None:
        offset, length, log_time, create_time, size = fields.unpack(_ATTACHMENT_INDEX)
        name, media_type = fields.text(), fields.text()
        self.attachments.append(
            AttachmentRef(offset, length, log_time, create_time, size, name, media_type)
        )

    def _statistics(self, fields: Fields) -> None:
        messages, schemas, channels, attachments, metadata, chunks, start_ns, end_ns = (
            fields.unpack(_STATISTICS)
        )
        counts = dict(_pairs(fields.blob(fields.unpack(U32)[0])))
        self.statistics = Statistics(
            messages, schemas, channels, attachments, metadata, chunks, start_ns, end_ns, counts
        )


def read_summary(source: ByteSource) -> Summary | None:
    """Read and check the summary section.

    Returns
    -------
    Summary or None
        None where there is none, or where it does not list everything.

    Raises
    ------
    MalformedError
        If the end of the file or the summary is damaged.
    """
    span = _summary_span(source)
    return _read_records(source, *span) if span else None


def _summary_span(source: ByteSource) -> tuple[int, int] | None:
    """Give the checked bytes of the summary section; None where the file has none."""
    tail_size = _FOOTER.size + len(MAGIC)
    tail = source.read_at(max(0, source.size - tail_size), tail_size)
    if not tail.endswith(MAGIC) or len(tail) < tail_size:
        raise MalformedError(
            f"expected the closing magic {MAGIC.hex(' ')}, found {tail[-len(MAGIC) :].hex(' ')}"
        )
    opcode, length, start, _, crc = _FOOTER.unpack_from(tail)
    if (opcode, length) != (FOOTER, _FOOTER.size - RECORD_HEAD.size):
        raise MalformedError(
            f"expected a footer of 20 bytes, found opcode 0x{opcode:02x} of {length}"
        )
    stop = source.size - tail_size
    if start == 0:
        return None
    if not len(MAGIC) <= start <= stop:
        raise MalformedError(f"expected its start from {len(MAGIC)} to {stop}, found {start}")
    if crc and (found := crc32_of(source, start, source.size - len(MAGIC) - U32.size)) != crc:
        raise MalformedError(f"expected CRC 0x{crc:08x}, found 0x{found:08x}")
    return start, stop


def _read_records(source: ByteSource, start: int, stop: int) -> Summary | None:
    """Read the summary; None where it does not list everything."""
    summary, window, offset = Summary(), Window(source), start
    while offset < stop:
        head = window.view(offset, RECORD_HEAD.size)
        opcode, length = Fields(head).unpack(RECORD_HEAD)
        offset += RECORD_HEAD.size
        if length > stop - offset:
            raise MalformedError(
                f"expected a record of at most {stop - offset} bytes, found {length}"
            )
        summary.take(opcode, window.view(offset, length))
        offset += length
    return summary if summary.complete() else None


def _pairs(raw: memoryview) -> list[tuple[Any, ...]]:
    if len(raw) % _COUNT.size:
        raise MalformedError(f"expected a map of 10-byte entries, found {len(raw)} bytes")
    return list(_COUNT.iter_unpack(raw))
