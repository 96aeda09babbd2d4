"""The front scan: everything up to the first tear, for files whose summary cannot be used.

Every chunk is decompressed and checked once, so that times, channels and counts come from the
messages themselves and no unprotected record is believed.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field
from operator import itemgetter
from typing import TYPE_CHECKING, Final

from groundtrace_codecs.mcap.bytesource import Window, crc32_of
from groundtrace_codecs.mcap.chunks import ChunkEntry, ChunkReader, Definitions, count_indexed
from groundtrace_codecs.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    U32,
    U64_U64,
    AttachmentRef,
    Damage,
    Fields,
    MalformedError,
    MetadataRecord,
    parse_attachment,
    parse_metadata,
    read_record,
)

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource

#: No time bound: log times are u64.
ANY_TIME: Final = (0, 1 << 64)

_INDEX_HEAD: Final = struct.Struct("<HI")
# Longest run of bare messages that becomes one entry: what is in memory at once when it is read.
_BARE_RUN_BYTES: Final = 1 << 20
# Room for the names in front of an attachment's data.
_ATTACHMENT_HEAD_BYTES: Final = 1 << 16


@dataclass(slots=True)
class Scan:
    """What a front scan found, in the order of the file.

    Attributes
    ----------
    definitions
        Schemas and channels.
    chunks
        Sound chunks and runs of bare messages.
    counts
        Messages by channel id, one counter for each of ``chunks``.
    attachments, metadata
        As recorded.
    damage
        What was left out.
    """

    definitions: Definitions = field(default_factory=Definitions)
    chunks: list[ChunkEntry] = field(default_factory=list)
    counts: list[Counter[int]] = field(default_factory=list)
    attachments: list[AttachmentRef] = field(default_factory=list)
    metadata: list[MetadataRecord] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)

    def message_counts(self) -> dict[int, int]:
        """Sum the messages by channel id."""
        total: Counter[int] = Counter()
        for counter in self.counts:
            total.update(counter)
        return dict(total)


def stray_reason(entry: ChunkEntry) -> str:
    """Name the damage of messages whose channel is defined nowhere."""
    place = "messages outside chunks" if entry.bare else "chunk"
    return f"{place}: expected a channel record before each message, found none for some"


def front_scan(source: ByteSource) -> Scan:
    """Walk the records from the start of ``source`` to the end of its data, or to a tear."""
    return _Scanner(source).run()


class _Scanner:
    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self._window = Window(source)
        self._found = Scan()
        self._indexing = False
        self._reader = ChunkReader(source, self._found.definitions)

    def run(self) -> Scan:
        offset, size = len(MAGIC), self._source.size
        while offset < size:
            head = self._head(offset)
            if head is None:
                self._torn(offset)
                break
            opcode, length = head
            if opcode == DATA_END:
                self._data_end(offset, length)
                break
            offset = self._take(opcode, offset, length)
        return self._found

    def _head(self, offset: int) -> tuple[int, int] | None:
        """Give opcode and content length; None where no whole record can be."""
        head = self._window.view(offset, RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(head)
        fits = opcode and offset + RECORD_HEAD.size + length <= self._source.size
        return (opcode, length) if fits else None

    def _take(self, opcode: int, offset: int, length: int) -> int:
        """Take one record, or one run of bare messages; give where the next one begins."""
        whole = RECORD_HEAD.size + length
        indexing, self._indexing = self._indexing, opcode in (CHUNK, MESSAGE_INDEX)
        if opcode == MESSAGE and indexing and self._reads_as_index(offset, length):
            self._indexing = True
            self._damage(offset, whole, "message index: expected opcode 0x07, found 0x05")
        elif opcode == MESSAGE:
            whole = self._bare_run(offset)
            self._entry(ChunkEntry(offset, whole, 0, 0, None, bare=True))
        elif opcode == CHUNK:
            self._entry(ChunkEntry(offset, whole, 0, 0, None))
        elif opcode in (SCHEMA, CHANNEL, METADATA, ATTACHMENT):
            self._note(opcode, offset, length)
        return offset + whole

    def _reads_as_index(self, offset: int, length: int) -> bool:
        """Recognise a MessageIndex among those of its chunk whose opcode turned into Message.

        Nothing protects a MessageIndex, and one flipped bit would make it a message of its channel.
        """
        fields = self._window.view(offset + RECORD_HEAD.size, _INDEX_HEAD.size)
        return length >= _INDEX_HEAD.size and _INDEX_HEAD.unpack(fields)[1] == length - len(fields)

    def _bare_run(self, offset: int) -> int:
        """Give the length of the run of Message records at ``offset``."""
        position = offset
        while position - offset < _BARE_RUN_BYTES:
            head = self._head(position) if position < self._source.size else None
            if head is None or head[0] != MESSAGE:
                break
            position += RECORD_HEAD.size + head[1]
        return position - offset

    def _entry(self, entry: ChunkEntry) -> None:
        """Check the messages of ``entry`` and keep it with its true times and channels."""
        channels = self._found.definitions.channels
        try:
            messages, strays = self._reader.messages(
                self._reader.records(entry), channels, *ANY_TIME
            )
        except MalformedError as error:
            self._lost(entry, f"{'messages outside chunks' if entry.bare else 'chunk'}: {error}")
            return
        if strays:
            self._damage(entry.offset, entry.length, stray_reason(entry), strays)
        if messages:
            counts = Counter(map(itemgetter(0), messages))
            start_ns, end_ns = messages[0].log_time, messages[-1].log_time
            ids = frozenset(counts)
            self._found.counts.append(counts)
            self._found.chunks.append(
                ChunkEntry(entry.offset, entry.length, start_ns, end_ns, ids, entry.bare)
            )

    def _note(self, opcode: int, offset: int, length: int) -> None:
        """Take a definition, metadata or attachment record; a malformed one is damage."""
        start, found = offset + RECORD_HEAD.size, self._found
        try:
            if opcode == ATTACHMENT:
                head = Fields(self._window.view(start, min(length, _ATTACHMENT_HEAD_BYTES)))
                ref = parse_attachment(offset, RECORD_HEAD.size + length, head)
                found.attachments.append(ref)
            elif opcode == METADATA:
                found.metadata.append(parse_metadata(read_record(self._source, offset, opcode)))
            else:
                found.definitions.add(opcode, read_record(self._source, offset, opcode))
        except MalformedError as error:
            reason = f"record with opcode 0x{opcode:02x}: {error}"
            self._damage(offset, RECORD_HEAD.size + length, reason)

    def _data_end(self, offset: int, length: int) -> None:
        """Drop the bare messages if the data section's CRC says that some byte is wrong.

        Chunks have their own CRC, and an unmatched one need not be theirs; nothing else protects
        messages outside chunks, and which of them is wrong cannot be told.
        """
        content = self._window.view(offset + RECORD_HEAD.size, min(length, U32.size))
        expected = U32.unpack(content)[0] if len(content) == U32.size else 0
        if not expected or not any(chunk.bare for chunk in self._found.chunks):
            return
        found = crc32_of(self._source, 0, offset)
        if found == expected:
            return
        kept = zip(self._found.chunks, self._found.counts, strict=True)
        sound = [(chunk, counts) for chunk, counts in kept if not chunk.bare]
        bare = [chunk for chunk in self._found.chunks if chunk.bare]
        lost = sum(map(Counter.total, self._found.counts)) - sum(c.total() for _, c in sound)
        first, last = min(c.start_ns for c in bare), max(c.end_ns for c in bare)
        reason = (
            "messages outside chunks: "
            f"expected data section CRC 0x{expected:08x}, found 0x{found:08x}"
        )
        span = (bare[0].offset, bare[-1].offset + bare[-1].length - bare[0].offset)
        self._found.damage.append(Damage(*span, first, last, lost, reason))
        self._found.chunks = [chunk for chunk, _ in sound]
        self._found.counts = [counts for _, counts in sound]

    def _lost(self, entry: ChunkEntry, reason: str) -> None:
        """Note a chunk that is not delivered, with what its header and index still tell."""
        times: tuple[int | None, int | None] = (None, None)
        if not entry.bare and entry.length >= RECORD_HEAD.size + U64_U64.size:
            times = U64_U64.unpack(self._window.view(entry.offset + RECORD_HEAD.size, U64_U64.size))
        messages = count_indexed(self._source, entry.offset + entry.length)
        self._found.damage.append(Damage(entry.offset, entry.length, *times, messages, reason))

    def _torn(self, offset: int) -> None:
        """Note that nothing can be told from ``offset`` to the end of the file."""
        rest = self._source.size - offset
        head = self._window.view(offset, RECORD_HEAD.size + U64_U64.size)
        reason = f"records: expected a record, found {rest} bytes"
        times: tuple[int | None, int | None] = (None, None)
        if len(head) >= RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack_from(head)
            reason = (
                f"records: expected {length} bytes of opcode 0x{opcode:02x}, "
                f"found {rest - RECORD_HEAD.size} before the end of the file"
                if opcode
                else "records: expected an opcode, found 0x00"
            )
            if opcode == CHUNK and len(head) == RECORD_HEAD.size + U64_U64.size:
                times = U64_U64.unpack_from(head, RECORD_HEAD.size)
        self._found.damage.append(Damage(offset, rest, *times, None, reason))

    def _damage(self, offset: int, length: int, reason: str, messages: int | None = None) -> None:
        self._found.damage.append(Damage(offset, length, None, None, messages, reason))
