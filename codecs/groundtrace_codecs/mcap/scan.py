"""The front scan: every record that can be believed, for files whose summary cannot be used.

Every chunk is decompressed and checked once, so that times, channels and counts come from the
messages themselves and no unprotected record is believed. Where a record's head is broken, the
chunk's own fields are tried, then the next record is searched for. Files that were written one
after the other into one are scanned one by one.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from groundtrace_codecs.mcap.bytesource import crc32_of
from groundtrace_codecs.mcap.chunks import ChunkEntry, ChunkReader
from groundtrace_codecs.mcap.message_index import indexed_messages
from groundtrace_codecs.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MAGIC,
    MAX_RECORD_BYTES,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    U32,
    U64_U64,
    Damage,
    Fields,
    MalformedError,
    parse_attachment,
    parse_metadata,
)
from groundtrace_codecs.mcap.resync import Heads
from groundtrace_codecs.mcap.scanned import Scan, stray_reason, tear_reason
from groundtrace_codecs.mcap.walk import message_places

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource

#: No time bound: log times are u64.
ANY_TIME: Final = (0, 1 << 64)

_INDEX_HEAD: Final = struct.Struct("<HI")
# Longest run of bare messages that becomes one entry: what is in memory at once when it is read.
_BARE_RUN_BYTES: Final = 1 << 20
# Room for the names in front of an attachment's data.
_ATTACHMENT_HEAD_BYTES: Final = 1 << 16


def front_scan(source: ByteSource) -> tuple[Scan, ...]:
    """Walk the records of every file in ``source``: one, unless some were put together."""
    scans = [_Scanner(source, 0).run()]
    while scans[-1].stop < source.size:
        scans.append(_Scanner(source, scans[-1].stop).run())
    return tuple(scans)


class _Scanner:
    def __init__(self, source: ByteSource, start: int) -> None:
        self._source = source
        self._found = Scan(start, source.size)
        self._heads = Heads(source, self._found.definitions.channels)
        self._window = self._heads.window
        self._indexing = False
        self._chunked = False
        self._reader = ChunkReader(source, self._found.definitions)

    def run(self) -> Scan:
        offset, size = self._found.start + len(MAGIC), self._source.size
        while offset < size:
            head = self._heads.believed(offset)
            if head is not None and head[0] in (DATA_END, FOOTER):
                self._end(offset, head[0])
                break
            taken = 0 if head is None else self._take(offset, *head)
            if taken:
                offset += taken
            elif self._heads.begins_file(offset):
                self._found.stop = offset
                break
            else:
                offset = self._broken(offset)
        return self._found

    def _take(self, offset: int, opcode: int, length: int) -> int:
        """Take one record, or one run of bare messages; give its length, 0 if it is not sound."""
        whole = RECORD_HEAD.size + length
        indexing, self._indexing = self._indexing, opcode in (CHUNK, MESSAGE_INDEX)
        if opcode == MESSAGE and indexing and self._reads_as_index(offset, length):
            self._indexing = True
            reason = "message index: expected opcode 0x07, found 0x05"
            self._found.note(offset, whole, reason, 0)
        elif opcode == MESSAGE:
            whole = self._bare_run(offset)
            if whole:
                self._entry(ChunkEntry(offset, whole, 0, 0, None, bare=True))
        elif opcode == CHUNK:
            self._chunked = True
            self._entry(ChunkEntry(offset, whole, 0, 0, None))
        elif opcode in (SCHEMA, CHANNEL, METADATA, ATTACHMENT):
            self._note(opcode, offset, length)
        return whole

    def _reads_as_index(self, offset: int, length: int) -> bool:
        """Recognise a MessageIndex among those of its chunk whose opcode turned into Message.

        Nothing protects a MessageIndex, and one flipped bit would make it a message of its channel.
        """
        fields = self._window.view(offset + RECORD_HEAD.size, _INDEX_HEAD.size)
        return length >= _INDEX_HEAD.size and _INDEX_HEAD.unpack(fields)[1] == length - len(fields)

    def _bare_run(self, offset: int) -> int:
        """Give the length of the run of Message records at ``offset``, all of them believable."""
        position = last = offset
        while position - offset < _BARE_RUN_BYTES:
            head = self._heads.head(position) if position < self._source.size else None
            if head is None or head[0] != MESSAGE:
                break
            last = position
            position += RECORD_HEAD.size + head[1]
        return (position if self._heads.can_follow(position) else last) - offset

    def _entry(self, entry: ChunkEntry) -> None:
        """Check the messages of ``entry`` and keep it with its true times and channels."""
        try:
            records = self._reader.records(entry)
        except MalformedError as error:
            self._lost(entry, error)
            return
        self._keep(entry, records)

    def _keep(self, entry: ChunkEntry, records: memoryview) -> None:
        channels = self._found.definitions.channels
        try:
            messages, strays = self._reader.messages(records, channels, *ANY_TIME)
        except MalformedError as error:
            self._lost(entry, error)
            return
        if strays:
            self._found.note(entry.offset, entry.length, stray_reason(entry), strays)
        if messages:
            counts = messages.counts()
            start_ns, end_ns = messages[0].log_time, messages[-1].log_time
            there = (start_ns, end_ns, frozenset(counts), entry.bare)
            self._found.counts.append(counts)
            self._found.chunks.append(ChunkEntry(entry.offset, entry.length, *there))

    def _note(self, opcode: int, offset: int, length: int) -> None:
        """Take a definition, metadata or attachment record; a malformed one is damage."""
        start, found = offset + RECORD_HEAD.size, self._found
        try:
            if opcode == ATTACHMENT:
                head = Fields(self._window.view(start, min(length, _ATTACHMENT_HEAD_BYTES)))
                ref = parse_attachment(offset, RECORD_HEAD.size + length, head)
                found.attachments.append(ref)
            elif opcode == METADATA:
                found.metadata.append(parse_metadata(self._content(start, length)))
            else:
                found.definitions.add(opcode, self._content(start, length))
        except MalformedError as error:
            reason = f"record with opcode 0x{opcode:02x}: {error}"
            found.note(offset, RECORD_HEAD.size + length, reason)

    def _content(self, start: int, length: int) -> memoryview:
        if length > MAX_RECORD_BYTES:
            raise MalformedError(f"expected at most {MAX_RECORD_BYTES} bytes, found {length}")
        return memoryview(self._source.read_at(start, length))

    def _end(self, offset: int, opcode: int) -> None:
        """Check the data section's CRC, and look at what comes after the file's own end."""
        if opcode == DATA_END:
            self._check_data(offset)
        elif (last := self._found.running_on()) is not None:
            # there are messages alone: nothing is defined on the way
            place = int(message_places(self._reader.records(last), int)[-1])
            self._found.drop_last(last, place)
            if place:
                self._entry(replace(last, length=place))
        closing = self._closing(offset)
        following = self._heads.next_file(closing or offset)
        self._found.stop = self._source.size if following is None else following
        rest = 0 if closing is None else self._found.stop - closing
        if closing is not None and rest > 0:
            reason = f"end of file: expected nothing after the closing magic, found {rest} bytes"
            self._found.note(closing, rest, reason, 0)

    def _closing(self, offset: int) -> int | None:
        """Give where the file's closing magic ends; None where the records do not lead to it."""
        opcode = DATA_END
        while opcode != FOOTER:
            head = self._heads.head(offset)
            if head is None:
                return None
            opcode, length = head
            offset += RECORD_HEAD.size + length
        magic = bytes(self._window.view(offset, len(MAGIC))) == MAGIC
        # the file may have lost its own magic, and another one begin here
        ends = magic and not self._heads.begins_file(offset)
        return offset + len(MAGIC) if ends else None

    def _check_data(self, offset: int) -> None:
        """Drop the bare messages if the data section's CRC says that some byte is wrong.

        Chunks have their own CRC, and an unmatched one need not be theirs; nothing else protects
        messages outside chunks, and which of them is wrong cannot be told.
        """
        expected = U32.unpack(self._window.view(offset + RECORD_HEAD.size, U32.size))[0]
        if not expected or not any(chunk.bare for chunk in self._found.chunks):
            return
        found = crc32_of(self._source, self._found.start, offset)
        if found != expected:
            self._found.drop_bare(
                "messages outside chunks: "
                f"expected data section CRC 0x{expected:08x}, found 0x{found:08x}"
            )

    def _broken(self, offset: int) -> int:
        """Go on after a head that cannot be believed; give the offset of the next record."""
        mended = self._mended(offset)
        if mended:
            return offset + mended
        measured = self._heads.measured(offset)
        if measured:
            return offset + self._measured(offset, measured)
        if self._cut_attachment(offset):
            self._torn(offset, self._source.size)
            return self._source.size
        if not self._chunked:
            raw = self._window.view(offset, 1)
            self._chunked = raw[0] == CHUNK or self._heads.has_chunks(offset)
        following = self._heads.next_record(offset + 1, chunked=self._chunked)
        stop = self._source.size if following is None else following
        self._torn(offset, stop)
        return stop

    def _mended(self, offset: int) -> int:
        """Read a chunk whose opcode or length is wrong by its own fields; give its length or 0."""
        own = self._heads.own_length(CHUNK, offset)
        whole = RECORD_HEAD.size + (own or 0)
        if own is None or offset + whole > self._source.size:
            return 0
        entry = ChunkEntry(offset, whole, 0, 0, None)
        try:
            records = self._reader.mended(entry)
        except MalformedError:
            return 0
        self._chunked = self._indexing = True
        self._found.note(offset, RECORD_HEAD.size, self._reader.head_fault(entry), 0)
        self._keep(entry, records)
        return whole

    def _measured(self, offset: int, length: int) -> int:
        """Take a record whose length field is wrong by its own fields; give its length."""
        opcode, stated = RECORD_HEAD.unpack(self._window.view(offset, RECORD_HEAD.size))
        reason = (
            f"record head: expected opcode 0x{opcode:02x} of {length} bytes, found {stated}; "
            "read by the record's own fields"
        )
        self._found.note(offset, RECORD_HEAD.size, reason, 0)
        return self._take(offset, opcode, length)

    def _cut_attachment(self, offset: int) -> bool:
        """Tell whether the file ends inside an attachment: it may be a recording itself."""
        raw = self._window.view(offset, RECORD_HEAD.size)
        if len(raw) < RECORD_HEAD.size or raw[0] != ATTACHMENT:
            return False
        return bool(self._heads.own_length(ATTACHMENT, offset) == RECORD_HEAD.unpack(raw)[1])

    def _lost(self, entry: ChunkEntry, error: MalformedError) -> None:
        """Note a chunk that is not delivered, with what its header and index still tell."""
        times: tuple[int | None, int | None] = (None, None)
        if not entry.bare and entry.length >= RECORD_HEAD.size + U64_U64.size:
            times = U64_U64.unpack(self._window.view(entry.offset + RECORD_HEAD.size, U64_U64.size))
        messages = indexed_messages(self._source, entry.offset + entry.length).messages
        reason = f"{'messages outside chunks' if entry.bare else 'chunk'}: {error}"
        self._found.damage.append(Damage(entry.offset, entry.length, *times, messages, reason))

    def _torn(self, offset: int, stop: int) -> None:
        """Note that nothing can be told of the bytes from ``offset`` to ``stop``."""
        head = self._window.view(offset, RECORD_HEAD.size + U64_U64.size)
        index = indexed_messages(self._source, stop)
        times: tuple[int | None, int | None] = index[1:]
        if times[0] is None and len(head) == RECORD_HEAD.size + U64_U64.size and head[0] == CHUNK:
            times = U64_U64.unpack_from(head, RECORD_HEAD.size)
        reason = tear_reason(head, self._source.size - offset)
        if stop < self._source.size:
            reason += f"; found again at byte {stop}"
        self._found.damage.append(Damage(offset, stop - offset, *times, index.messages, reason))
