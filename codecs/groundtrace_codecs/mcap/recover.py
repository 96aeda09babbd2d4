"""The front scan: every record that can be believed, for files whose summary cannot be used.

A file that is still being written is scanned as far as it came, and on from there as it grows.

Every chunk is decompressed and checked once, so that times, channels and counts come from the
messages themselves and no unprotected record is believed. Where the head of a record is broken, the
chunk's own fields are tried, then the next record is searched for. Files that were written one
after the other into one are scanned one by one.

Nothing protects the opcode and the length of a record. One flipped bit in a length would send a
scan into the middle of another record, and cost the rest of the file or make messages of other
bytes. So a head is believed only if the record's own fields have that length, or if a record can
follow where it ends.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from .byte_source import Window, crc32_of
from .chunks import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MAX_RECORD_BYTES,
    MESSAGE,
    MESSAGE_FIELDS,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    U16,
    U32,
    U64,
    U64_U64,
    ChunkEntry,
    ChunkReader,
    Damage,
    Definitions,
    Fields,
    MalformedError,
    indexed_messages,
    message_places,
    parse_attachment,
    parse_metadata,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator

    from .byte_source import ByteSource
    from .chunks import AttachmentRef, MessageTable, MetadataRecord

#: No time bound: log times are u64.
ANY_TIME: Final = (0, 1 << 64)

_INDEX_HEAD: Final = struct.Struct("<HI")
# Longest run of bare messages that becomes one entry: what is in memory at once when it is read.
_BARE_RUN_BYTES: Final = 1 << 20
# Room for the names in front of an attachment's data.
_ATTACHMENT_HEAD_BYTES: Final = 1 << 16


def front_scan(source: ByteSource) -> tuple[Scan, ...]:
    """Walk the records of every file in ``source``: one, unless some were put together."""
    scans = [Scanner(source, 0).run()]
    while scans[-1].stop < source.size:
        scans.append(Scanner(source, scans[-1].stop).run())
    return tuple(scans)


class Scanner:
    """Walks the records of one file, once or as the file grows.

    Parameters
    ----------
    source
        The file; its size may grow between two calls of `advance`.
    start
        Where it begins in the source [bytes].
    deliver
        Takes the messages of each sound chunk, in order, as soon as they are checked.

    Attributes
    ----------
    scan
        What the records said so far.
    offset
        Where the first record lies that was not taken yet [bytes].
    ended
        True behind the file's own end.
    """

    def __init__(
        self, source: ByteSource, start: int, deliver: Callable[[MessageTable], None] | None = None
    ) -> None:
        self._source = source
        self.scan = Scan(start, source.size)
        self._heads = RecordHeaderScan(source, self.scan.definitions.channels)
        self._window = self._heads.window
        self._indexing = False
        self._chunked = False
        self._reader = ChunkReader(source, self.scan.definitions)
        self._deliver = deliver
        self.offset = start + len(MAGIC)
        self.ended = False

    def run(self) -> Scan:
        """Walk to the end of the file, whatever is broken on the way."""
        while self.step(growing=False):
            pass
        return self.scan

    def refresh(self) -> None:
        """Look again at what was only seen in part: the file may have grown."""
        self._window.forget()

    def step(self, *, growing: bool) -> bool:
        """Take the next record, or run of messages outside chunks; return whether there was one.

        Parameters
        ----------
        growing
            Leave what is not whole yet to a later call; else it is damage.
        """
        if self.ended:
            return False
        offset, size = self.offset, self._source.size
        self._heads.stop = self.scan.stop = size
        if offset >= size or (growing and self._heads.is_cut(offset)):
            return False
        head = self._heads.believed(offset)
        if head is not None and head[0] in (DATA_END, FOOTER):
            if growing and self._closing(offset) is None:
                return False
            self._end(offset, head[0])
            self.ended = True
            return True
        taken = 0 if head is None else self._take(offset, *head)
        if taken:
            self.offset += taken
        elif self._heads.begins_file(offset):
            self.scan.stop = offset
            self.ended = True
        else:
            self.offset = self._broken(offset, growing=growing)
        return self.offset > offset or self.ended

    def _take(self, offset: int, opcode: int, length: int) -> int:
        """Take one record, or one run of bare messages; give its length, 0 if it is not sound."""
        size = RECORD_HEAD.size + length
        indexing, self._indexing = self._indexing, opcode in (CHUNK, MESSAGE_INDEX)
        if opcode == MESSAGE and indexing and self._reads_as_index(offset, length):
            self._indexing = True
            reason = "message index: expected opcode 0x07, found 0x05"
            self.scan.note(offset, size, reason, 0)
        elif opcode == MESSAGE:
            size = self._bare_run(offset)
            if size:
                self._entry(ChunkEntry(offset, size, 0, 0, None, bare=True))
        elif opcode == CHUNK:
            self._chunked = True
            self._entry(ChunkEntry(offset, size, 0, 0, None))
        elif opcode in (SCHEMA, CHANNEL, METADATA, ATTACHMENT):
            self._note(opcode, offset, length)
        return size

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
        channels = self.scan.definitions.channels
        try:
            messages, strays = self._reader.messages(records, channels, *ANY_TIME)
        except MalformedError as error:
            self._lost(entry, error)
            return
        if strays:
            self.scan.note(entry.offset, entry.length, gap_reason(entry), strays)
        if messages and self._deliver is not None:
            self._deliver(messages)
        if messages:
            counts = messages.counts()
            start_ns, end_ns = messages[0].log_time, messages[-1].log_time
            there = (start_ns, end_ns, frozenset(counts), entry.bare)
            self.scan.counts.append(counts)
            self.scan.chunks.append(ChunkEntry(entry.offset, entry.length, *there))

    def _note(self, opcode: int, offset: int, length: int) -> None:
        """Take a definition, metadata or attachment record; a malformed one is damage."""
        start, scan = offset + RECORD_HEAD.size, self.scan
        try:
            if opcode == ATTACHMENT:
                head = Fields(self._window.view(start, min(length, _ATTACHMENT_HEAD_BYTES)))
                ref = parse_attachment(offset, RECORD_HEAD.size + length, head)
                scan.attachments.append(ref)
            elif opcode == METADATA:
                scan.metadata.append(parse_metadata(self._content(start, length)))
            else:
                scan.definitions.add(opcode, self._content(start, length))
        except MalformedError as error:
            reason = f"record with opcode 0x{opcode:02x}: {error}"
            scan.note(offset, RECORD_HEAD.size + length, reason)

    def _content(self, start: int, length: int) -> memoryview:
        if length > MAX_RECORD_BYTES:
            raise MalformedError(f"expected at most {MAX_RECORD_BYTES} bytes, found {length}")
        return memoryview(self._source.read_at(start, length))

    def _end(self, offset: int, opcode: int) -> None:
        """Check the data section's CRC, and look at what comes after the file's own end.

        Messages that were delivered cannot be taken back: their CRC is left to who reads the file.
        """
        if self._deliver is not None:
            return
        if opcode == DATA_END:
            self._check_data(offset)
        elif (last := self.scan.running_on()) is not None:
            # there are messages alone: nothing is defined on the way
            message_offset = int(message_places(self._reader.records(last), int)[-1])
            self.scan.drop_last(last, message_offset)
            if message_offset:
                self._entry(replace(last, length=message_offset))
        closing = self._closing(offset)
        following = self._heads.next_file(closing or offset)
        self.scan.stop = self._source.size if following is None else following
        rest = 0 if closing is None else self.scan.stop - closing
        if closing is not None and rest > 0:
            reason = f"end of file: expected nothing after the closing magic, found {rest} bytes"
            self.scan.note(closing, rest, reason, 0)

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
        if not expected or not any(chunk.bare for chunk in self.scan.chunks):
            return
        actual_crc = crc32_of(self._source, self.scan.start, offset)
        if actual_crc != expected:
            self.scan.drop_bare(
                "messages outside chunks: "
                f"expected data section CRC 0x{expected:08x}, found 0x{actual_crc:08x}"
            )

    def _broken(self, offset: int, *, growing: bool) -> int:
        """Go on after a head that cannot be believed; give the offset of the next record.

        Where none is found in a growing file it is the same offset: one may come.
        """
        mended = self._mended(offset)
        if mended:
            return offset + mended
        measured = self._heads.measured(offset)
        if measured:
            return offset + self._measured(offset, measured)
        if not growing and self._cut_attachment(offset):
            self._torn(offset, self._source.size)
            return self._source.size
        if not self._chunked:
            raw = self._window.view(offset, 1)
            self._chunked = raw[0] == CHUNK or self._heads.has_chunks(offset)
        following = self._heads.next_record(offset + 1, chunked=self._chunked)
        if following is None and growing:
            return offset
        stop = self._source.size if following is None else following
        self._torn(offset, stop)
        return stop

    def _mended(self, offset: int) -> int:
        """Read a chunk whose opcode or length is wrong by its own fields; give its length or 0."""
        content_length = self._heads.own_length(CHUNK, offset)
        size = RECORD_HEAD.size + (content_length or 0)
        if content_length is None or offset + size > self._source.size:
            return 0
        entry = ChunkEntry(offset, size, 0, 0, None)
        try:
            records = self._reader.mended(entry)
        except MalformedError:
            return 0
        self._chunked = self._indexing = True
        self.scan.note(offset, RECORD_HEAD.size, self._reader.head_fault(entry), 0)
        self._keep(entry, records)
        return size

    def _measured(self, offset: int, length: int) -> int:
        """Take a record whose length field is wrong by its own fields; give its length."""
        opcode, stated = RECORD_HEAD.unpack(self._window.view(offset, RECORD_HEAD.size))
        reason = (
            f"record head: expected opcode 0x{opcode:02x} of {length} bytes, found {stated}; "
            "read by the record's own fields"
        )
        self.scan.note(offset, RECORD_HEAD.size, reason, 0)
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
        self.scan.damage.append(Damage(entry.offset, entry.length, *times, messages, reason))

    def _torn(self, offset: int, stop: int) -> None:
        """Note that nothing can be told of the bytes from ``offset`` to ``stop``."""
        head = self._window.view(offset, RECORD_HEAD.size + U64_U64.size)
        index = indexed_messages(self._source, stop)
        times: tuple[int | None, int | None] = index[1:]
        if times[0] is None and len(head) == RECORD_HEAD.size + U64_U64.size and head[0] == CHUNK:
            times = U64_U64.unpack_from(head, RECORD_HEAD.size)
        reason = truncation_reason(head, self._source.size - offset)
        if stop < self._source.size:
            reason += f"; found again at byte {stop}"
        self.scan.damage.append(Damage(offset, stop - offset, *times, index.messages, reason))


@dataclass(slots=True)
class Scan:
    """What a front scan found, in the order of the file.

    Attributes
    ----------
    start, stop
        Bytes of the file within the source; ``stop`` lies where another file begins, or at the end.
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

    start: int
    stop: int
    definitions: Definitions = field(default_factory=Definitions)
    chunks: list[ChunkEntry] = field(default_factory=list)
    counts: list[Counter[int]] = field(default_factory=list)
    attachments: list[AttachmentRef] = field(default_factory=list)
    metadata: list[MetadataRecord] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)

    def message_counts(self) -> Counter[int]:
        """Sum the messages by channel id."""
        total: Counter[int] = Counter()
        for counter in self.counts:
            total.update(counter)
        return total

    def note(self, offset: int, length: int, reason: str, messages: int | None = None) -> None:
        """Add damage that has no span of time."""
        self.damage.append(Damage(offset, length, None, None, messages, reason))

    def drop_bare(self, reason: str) -> None:
        """Leave out all messages outside chunks: one of them is wrong, and nobody knows which."""
        pairs = list(zip(self.chunks, self.counts, strict=True))
        bare = [chunk for chunk in self.chunks if chunk.bare]
        lost = sum(counts.total() for chunk, counts in pairs if chunk.bare)
        first, last = min(c.start_ns for c in bare), max(c.end_ns for c in bare)
        length = bare[-1].offset + bare[-1].length - bare[0].offset
        self.damage.append(Damage(bare[0].offset, length, first, last, lost, reason))
        self.chunks = [chunk for chunk, _ in pairs if not chunk.bare]
        self.counts = [counts for chunk, counts in pairs if not chunk.bare]

    def running_on(self) -> ChunkEntry | None:
        """Return the messages outside chunks that come last, if nothing behind them is broken."""
        last = self.chunks[-1] if self.chunks else None
        if last is None or not last.bare:
            return None
        stop = last.offset + last.length
        return None if any(d.offset + d.length > stop for d in self.damage) else last

    def drop_last(self, entry: ChunkEntry, message_offset: int) -> None:
        """Leave out the last entry, of which only the message at a place [bytes] is damage.

        A DataEnd follows messages; where the records run on to the Footer without one, the message
        before has taken it in.
        """
        del self.chunks[-1], self.counts[-1]
        reason = "message: expected a DataEnd record between it and the summary, found none"
        self.note(entry.offset + message_offset, entry.length - message_offset, reason, 1)


def gap_reason(entry: ChunkEntry) -> str:
    """Name the damage of messages whose channel is defined nowhere."""
    where = "messages outside chunks" if entry.bare else "chunk"
    return f"{where}: expected a channel record before each message, found none for some"


def truncation_reason(head: memoryview, rest: int) -> str:
    """Say what is wrong where no record can be; ``head`` begins the ``rest`` bytes of the file."""
    if len(head) < RECORD_HEAD.size:
        return f"records: expected a record, found {rest} bytes"
    opcode, length = RECORD_HEAD.unpack_from(head)
    if not opcode:
        return "records: expected an opcode, found 0x00"
    if length > rest - RECORD_HEAD.size:
        return (
            f"records: expected {length} bytes of opcode 0x{opcode:02x}, "
            f"found {rest - RECORD_HEAD.size} before the end of the file"
        )
    return f"records: expected a record, found opcode 0x{opcode:02x} of {length} bytes"


# Of each kind: bytes before its texts, texts (u32 length each), whether a blob (u64 length)
# follows, bytes after it (MCAP specification, "Records").
_LAYOUTS: Final = {
    HEADER: (0, 2, False, 0),
    FOOTER: (20, 0, False, 0),
    SCHEMA: (2, 3, False, 0),
    CHANNEL: (4, 3, False, 0),
    CHUNK: (28, 1, True, 0),
    MESSAGE_INDEX: (2, 1, False, 0),
    ATTACHMENT: (16, 2, True, 4),
    METADATA: (0, 2, False, 0),
    DATA_END: (4, 0, False, 0),
}
# These may not grow fields after the known ones (MCAP specification, "Records").
_FIXED: Final = (DATA_END, FOOTER)
# What a search may stop at. Schemas, channels and messages count only where there are no chunks:
# inside a chunk that lost its head they look the same, and no CRC vouches for them.
_IN_CHUNKED: Final = (CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END)
_IN_BARE: Final = (*_IN_CHUNKED, SCHEMA, CHANNEL, MESSAGE)
# Records in a row that make a message believable where a search found it.
_CHAIN: Final = 4
# Longest fields before the data of a message or a chunk, and some more.
_FIELDS_BYTES: Final = 64
# Unknown records in a row that are passed over to find a known one.
_UNKNOWN_RECORDS: Final = 64
_SEARCH_BYTES: Final = 1 << 20
# So many zeros in the place of a record of a growing file are room for those to come. Chosen by
# judgement: a sector.
_ROOM_BYTES: Final = 512


@dataclass(slots=True)
class RecordHeaderScan:
    """The record heads of one file within a source.

    Attributes
    ----------
    source
        What is read.
    channels
        Ids a message may have; grows while the file is read.
    stop
        Where the source ends.
    window
        Serves small reads.
    """

    source: ByteSource
    channels: Container[int]
    stop: int = field(init=False)
    window: Window = field(init=False)

    def __post_init__(self) -> None:
        self.stop = self.source.size
        self.window = Window(self.source)

    def head(self, offset: int) -> tuple[int, int] | None:
        """Give opcode and content length; None where no whole record can be."""
        raw = self.window.view(offset, RECORD_HEAD.size)
        if len(raw) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(raw)
        fits = opcode and offset + RECORD_HEAD.size + length <= self.stop
        return (opcode, length) if fits else None

    def believed(self, offset: int) -> tuple[int, int] | None:
        """Give opcode and content length; None where they contradict what is there."""
        head = self.head(offset)
        if head is None:
            return None
        opcode, length = head
        if self.own_length(opcode, offset) == length:
            return head
        if opcode in _FIXED or self.own_length(CHUNK, offset) == length:
            return None
        # A record may have grown fields that are not known here.
        return head if self.can_follow(offset + RECORD_HEAD.size + length) else None

    def measured(self, offset: int) -> int:
        """Give the content length by the record's own fields, where a record follows; else 0.

        A chunk has a better witness, its CRC.
        """
        opcode = self.window.view(offset, 1)[0]
        content_length = None if opcode == CHUNK else self.own_length(opcode, offset)
        stop = offset + RECORD_HEAD.size + (content_length or 0)
        return (
            content_length if content_length and stop <= self.stop and self.can_follow(stop) else 0
        )

    def own_length(self, opcode: int, offset: int) -> int | None:
        """Give the content length that the fields of a record of that kind add up to.

        Returns
        -------
        int or None
            None where the kind's fields do not tell, or reach past the end of the source.
        """
        if opcode not in _LAYOUTS:
            return None
        lead, texts, blob, tail = _LAYOUTS[opcode]
        start = offset + RECORD_HEAD.size
        position = start + lead
        for _ in range(texts):
            raw = self.window.view(position, U32.size)
            if len(raw) < U32.size:
                return None
            position += U32.size + U32.unpack(raw)[0]
        if blob:
            raw = self.window.view(position, U64.size)
            if len(raw) < U64.size:
                return None
            position += U64.size + U64.unpack(raw)[0]
        return position + tail - start

    def can_follow(self, offset: int) -> bool:
        """Tell whether a record, another file or the end can begin at ``offset``."""
        for _ in range(_UNKNOWN_RECORDS):
            raw = self.window.view(offset, RECORD_HEAD.size)
            if len(raw) < RECORD_HEAD.size or bytes(raw[: len(MAGIC)]) == MAGIC:
                return True
            opcode, length = RECORD_HEAD.unpack(raw)
            if opcode == 0:
                return self._only_zeros(offset)
            if opcode <= DATA_END:
                shortest = MESSAGE_FIELDS if opcode == MESSAGE else _LAYOUTS.get(opcode, (0,))[0]
                fits = offset + RECORD_HEAD.size + length <= self.stop
                return bool(length >= shortest and (fits or self._is_cut(offset, opcode, length)))
            # An unknown opcode says little: what comes after it must say more.
            offset += RECORD_HEAD.size + length
            if offset > self.stop:
                return False
        return False

    def is_cut(self, offset: int) -> bool:
        """Tell whether the source ends in the record at ``offset``, which may go on."""
        raw = self.window.view(offset, RECORD_HEAD.size)
        if len(raw) < RECORD_HEAD.size:
            return True
        opcode, length = RECORD_HEAD.unpack(raw)
        if opcode == 0:  # room that a file system or a writer took before there was content
            return not any(self.window.view(offset, _ROOM_BYTES))
        if offset + RECORD_HEAD.size + length <= self.stop:
            return False
        return bool(opcode <= DATA_END and self._is_cut(offset, opcode, length))

    def _is_cut(self, offset: int, opcode: int, length: int) -> bool:
        """Tell whether the end of the source cuts a record, and not a wrong length leads past it.

        Of a record that is cut in its fields nothing can be told, and it is believed.
        """
        if length > MAX_RECORD_BYTES or self.stop - offset < _FIELDS_BYTES:
            return length <= MAX_RECORD_BYTES
        if opcode == MESSAGE:
            (channel,) = U16.unpack(self.window.view(offset + RECORD_HEAD.size, U16.size))
            return channel in self.channels
        return self.own_length(opcode, offset) == length

    def begins_file(self, offset: int) -> bool:
        """Tell whether an MCAP file begins at ``offset``: magic and a whole Header record."""
        if bytes(self.window.view(offset, len(MAGIC))) != MAGIC:
            return False
        head = self.head(offset + len(MAGIC))
        return (
            head is not None
            and head[0] == HEADER
            and self.own_length(HEADER, offset + len(MAGIC)) == head[1]
        )

    def next_file(self, start: int) -> int | None:
        """Search for the beginning of another file from ``start`` on."""
        for offset, raw in self._blocks(start):
            index = raw.find(MAGIC)
            while index >= 0:
                if self.begins_file(offset + index):
                    return offset + index
                index = raw.find(MAGIC, index + 1)
        return None

    def next_record(self, start: int, *, chunked: bool) -> int | None:
        """Search for the next record, or the beginning of another file, from ``start`` on.

        Every byte is looked at once. An Attachment or Metadata record that was longer than 4 GiB
        is not found.

        Parameters
        ----------
        start
            First byte looked at.
        chunked
            True where messages are in chunks only.
        """
        kinds = _IN_CHUNKED if chunked else _IN_BARE
        for base, raw in self._blocks(start):
            for index in _places(raw, kinds):
                if self._is_record(base + index):
                    return base + index
        return None

    def has_chunks(self, start: int) -> bool:
        """Tell whether there is a chunk, or the index of one, from ``start`` on."""
        return any(
            self._is_record(base + index)
            for base, raw in self._blocks(start)
            for index in _places(raw, (CHUNK, MESSAGE_INDEX))
        )

    def _is_record(self, offset: int) -> bool:
        """Tell whether what looks like a head is one: the record's fields must agree."""
        if self.begins_file(offset):
            return True
        head = self.head(offset)
        if head is None:
            return False
        opcode, length = head
        if opcode == MESSAGE:
            return self._is_message(offset)
        if self.own_length(opcode, offset) != length:
            return False
        # The lengths of a chunk, 64 bits each, do not agree by chance; those of others may.
        return opcode == CHUNK or self.can_follow(offset + RECORD_HEAD.size + length)

    def _is_message(self, offset: int) -> bool:
        raw = self.window.view(offset + RECORD_HEAD.size, U16.size)
        if len(raw) < U16.size or U16.unpack(raw)[0] not in self.channels:
            return False
        for _ in range(_CHAIN):
            head = self.head(offset)
            if head is None or not self.can_follow(offset):
                return False
            offset += RECORD_HEAD.size + head[1]
            if offset == self.stop:
                break
        return True

    def _only_zeros(self, start: int) -> bool:
        return not any(raw.strip(b"\0") for _, raw in self._blocks(start))

    def _blocks(self, start: int) -> Iterator[tuple[int, bytes]]:
        """Yield the source from ``start`` on in blocks that overlap by a head, with their place."""
        for base in range(start, self.stop, _SEARCH_BYTES):
            length = min(_SEARCH_BYTES + RECORD_HEAD.size, self.stop - base)
            yield base, self.source.read_at(base, length)


def _places(raw: bytes, kinds: tuple[int, ...]) -> list[int]:
    """Give where in a block heads of ``kinds``, or a file's magic, may be, in order."""
    if len(raw) < RECORD_HEAD.size:
        return []
    values = np.frombuffer(raw, np.uint8)
    count = len(values) - RECORD_HEAD.size + 1
    sought = np.zeros(256, bool)
    sought[list(kinds)] = True
    fitting = sought[values[:count]]
    for high in range(5, RECORD_HEAD.size):
        fitting &= values[high : high + count] == 0
    places: list[int] = np.flatnonzero(fitting).tolist()
    magic = raw.find(MAGIC)
    while magic >= 0:
        places.append(magic)
        magic = raw.find(MAGIC, magic + 1)
    return sorted(places)
