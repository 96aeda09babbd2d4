"""Reads MCAP recordings: ordered, checked, in constant memory, whatever state the file is in.

The index of a file, its channels and the places of its chunks, comes from the summary, or else from
a front scan. A summary is used only if its CRC matches and its Statistics record proves that it is
complete, since a summary may lawfully leave out channels, schemas or indexes.

Several MCAP files written one after the other into one file are read as one recording. A logger
that appends to an existing file, or two files put together, leave a second beginning after the
first end. Ids have another meaning in each part, so they are made distinct; a second copy of the
same bytes is left out.

Messages are ordered by log time, except where the clock was set back while the file was written.
Such a clock shows some times twice, and by log time what was recorded first and last would be
mixed. There the order of the file counts: each message is read at the time that its clock would
show, had it never been set back. Messages that only lie in another order in the file, as some
writers leave them, keep their log times.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np
from zlib_ng import zlib_ng

from ..errors import FormatError
from .byte_source import RemoteBytes, Window, crc32_of, open_bytes, sha256_of
from .chunks import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    METADATA,
    METADATA_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    U32,
    U64,
    U64_U64,
    AttachmentRef,
    ChannelRecord,
    ChunkEntry,
    ChunkReader,
    Damage,
    Definitions,
    Fields,
    MalformedError,
    Message,
    MessageTable,
    MetadataRecord,
    MisplacedError,
    Schema,
    indexed_messages,
    indexed_times,
    parse_attachment,
    parse_metadata,
    read_record,
)
from .recover import ANY_TIME, front_scan, gap_reason

if TYPE_CHECKING:
    from collections.abc import (
        Callable,
        Collection,
        Container,
        Iterable,
        Iterator,
        Mapping,
        Sequence,
    )
    from types import TracebackType

    from numpy.typing import NDArray

    from .byte_source import ByteSource
    from .recover import Scan

    Times = NDArray[np.int64]


class _Part:
    """Reads the chunks of one segment.

    Parameters
    ----------
    source
        The file.
    segment
        Which of the files in it.
    wanted
        Channels to read, ids of the whole.
    """

    def __init__(self, source: ByteSource, segment: Segment, wanted: Container[int]) -> None:
        self.reader = ChunkReader(source, segment.definitions)
        self._ids = segment.ids
        self.wanted = wanted
        if self._ids is not None:
            self.wanted = {
                part_id for part_id, joined_id in self._ids.items() if joined_id in wanted
            }

    def in_whole(self, table: MessageTable) -> MessageTable:
        """Give messages the channel ids of the whole."""
        ids = self._ids
        if ids is None or not len(table):
            return table
        rows = table.rows.copy()
        part_ids, places = np.unique(rows["channel_id"], return_inverse=True)
        rows["channel_id"] = np.array([ids[i] for i in part_ids.tolist()])[places]
        return MessageTable(table.pieces, rows).in_order()


class McapFile:
    """One MCAP file, open for reading.

    Damaged parts are left out and listed in `damage`; a byte that fails its check is never passed
    on. Made by `open`.

    Attributes
    ----------
    name
        What errors call the file.
    profile, library
        Of its Header record.
    schemas, channels
        By id. Every channel's ``schema_id`` is 0 or a key of ``schemas``.
    attachments, metadata
        In the order of the file.
    message_counts
        Messages by channel id: as the statistics state them, or as a front scan found them.
    start_ns, end_ns
        Log times of the first and the last message; both 0 without messages.
    indexed
        True if the file's own summary was used, False after a front scan.
    """

    def __init__(self, source: ByteSource, index: FileIndex, *, strict: bool) -> None:
        self.name: str = source.name
        self.profile: str = index.profile
        self.library: str = index.library
        self.schemas: dict[int, Schema] = index.definitions.schemas
        self.channels: dict[int, ChannelRecord] = index.definitions.channels
        self.attachments: tuple[AttachmentRef, ...] = index.attachments
        self.metadata: tuple[MetadataRecord, ...] = index.metadata
        self.message_counts: dict[int, int] = index.message_counts
        self.start_ns: int = index.start_ns
        self.end_ns: int = index.end_ns
        self.indexed: bool = index.indexed
        self._source = source
        self._segments = index.segments
        self._chunks = index.chunks
        self._strict = strict
        self._damage: dict[tuple[int, str], Damage] = {}
        self._loader = ChunkLoader(source, index.chunks)
        for damage in index.damage:
            self._note(damage)

    @classmethod
    def open(cls, source: str | Path | ByteSource, *, strict: bool = False) -> McapFile:
        """Open a file and find out what it holds.

        Parameters
        ----------
        source
            Path, URL, or bytes from elsewhere; closed with the file.
        strict
            Raise at the first damage instead of listing it.

        Raises
        ------
        FormatError
            If it is no MCAP file, or, with ``strict``, at any damage.
        OSError
            If it cannot be read.
        """
        opened = open_bytes(source) if isinstance(source, str | Path) else source
        try:
            return cls(opened, load_index(opened), strict=strict)
        except BaseException:
            opened.close()
            raise

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self._source.size

    def sha256(self) -> str:
        """Return the SHA-256 of the bytes that are read here, whatever file has their name now.

        Of a remote file only what was not read yet is fetched.
        """
        source = self._source
        return source.sha256() if isinstance(source, RemoteBytes) else sha256_of(source)

    @property
    def remote(self) -> bool:
        """Whether the file is behind a URL: each of its bytes costs a transfer."""
        return isinstance(self._source, RemoteBytes)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far; grows while messages are read."""
        return tuple(self._damage.values())

    def messages(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[Message]:
        """Read messages in the order (log time, channel id, sequence, file offset).

        Parameters
        ----------
        channel_ids
            Channels to read; None = all.
        start_ns, stop_ns
            Log times ``[start_ns, stop_ns)``; None = no bound.

        Raises
        ------
        FormatError
            With ``strict``, at the first damage met.
        """
        for table in self.tables(channel_ids, start_ns, stop_ns):
            yield from table

    def as_recorded(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[Message]:
        """Read messages in the order in which they were recorded, for a copy.

        As :meth:`messages`, but where a clock was set back: there the messages of each channel
        come in the order of the file, which a copy has to keep.
        """
        wanted = self.channels.keys() if channel_ids is None else channel_ids
        clock = self.reading_clock(wanted)
        if clock is None:
            yield from self.messages(channel_ids, start_ns, stop_ns)
            return
        low = ANY_TIME[0] if start_ns is None else start_ns
        high = ANY_TIME[1] if stop_ns is None else stop_ns
        latest = None if stop_ns is None else stop_ns + clock.latest_ns
        for table in self.tables(channel_ids, start_ns, latest, clock):
            yield from table.as_logged().between(low, high)

    def tables(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        clock: ReadingClock | None = None,
    ) -> Iterator[MessageTable]:
        """Read messages as :meth:`messages` does, as many at once as lie together.

        With a ``clock``, its times of reading are in the place of log times, also in the messages.
        """
        low = ANY_TIME[0] if start_ns is None else start_ns
        high = ANY_TIME[1] if stop_ns is None else stop_ns
        wanted: Container[int] = self.channels
        chunks = [
            c
            for c in (self._chunks if clock is None else clock.chunks)
            if c.start_ns < high and low <= c.end_ns
        ]
        if channel_ids is not None:
            wanted = chosen = self.channels.keys() & set(channel_ids)
            chunks = [c for c in chunks if c.channel_ids is None or c.channel_ids & chosen]
        parts = [_Part(self._source, segment, wanted) for segment in self._segments]

        def load(entry: ChunkEntry, floor_ns: int) -> MessageTable:
            if clock is None:
                table = self._load(parts[entry.segment], entry, low, high)
            else:
                table = clock.read(entry, self._load(parts[entry.segment], entry, *ANY_TIME))
                table = table.between(low, high).in_order()
            return self._in_time(entry, table, floor_ns)

        room_bytes = max(_OVERLAP_BYTES, _OVERLAP_RATIO * self._source.size)
        return merge(chunks, load, self._refuse, room_bytes)

    def reading_clock(self, channel_ids: Collection[int]) -> ReadingClock | None:
        """Return at what times some channels are to be read if a clock was set back, else None."""
        near = not self.remote
        return reading_clock(self._source, self._chunks, self._segments, channel_ids, near=near)

    def counted(self, channel_id: int) -> tuple[tuple[ChunkEntry, int], ...]:
        """Return the chunks with messages of a channel, and how many, by the index alone.

        In the order of the file; nothing where the index does not say it.
        """
        chunks = [c for c in self._chunks if c.channel_ids is None or channel_id in c.channel_ids]
        counts = [(c, n) for c in chunks for i, n in c.counts if i == channel_id]
        complete = sum(n for _, n in counts) == self.message_counts.get(channel_id)
        sure = self.indexed and len(self._segments) == 1 and complete and len(counts) == len(chunks)
        return tuple(sorted(counts, key=lambda pair: pair[0].offset)) if sure else ()

    def chunk(self, entry: ChunkEntry, channel_id: int) -> MessageTable:
        """Return the messages of a channel in one chunk, by log time."""
        part = _Part(self._source, self._segments[entry.segment], {channel_id})
        return self._load(part, entry, *ANY_TIME)

    def attachment(self, ref: AttachmentRef) -> bytes:
        """Read the content of an attachment.

        Raises
        ------
        FormatError
            If it is not where ``ref`` says, or its CRC does not match.
        """
        try:
            record = read_record(self._source, ref.offset, ATTACHMENT)
            fields = Fields(record)
            if parse_attachment(ref.offset, ref.length, fields) != ref:
                raise MalformedError("expected the attachment of the index, found another one")
            data = fields.blob(ref.size)
            checked = record[: fields.position]
            (crc,) = fields.unpack(U32)
            # As with chunks, 0 means that the writer kept none.
            if crc and (actual_crc := zlib_ng.crc32(checked)) != crc:
                raise MalformedError(f"expected CRC 0x{crc:08x}, found 0x{actual_crc:08x}")
        except MalformedError as error:
            raise FormatError(f"{self.name}: attachment {ref.name!r}: {error}") from error
        return bytes(data)

    def check_data(self) -> None:
        """Read all bytes once more: what no CRC of its own protects is damage where it changed.

        The CRC of the data section tells (MCAP specification, "Data End"), in a file with a summary
        and without other damage, which would be a reason for it as well.
        """
        if self._damage or not self.indexed or (span := _summary_span(self._source)) is None:
            return
        end = span[0] - RECORD_HEAD.size - U32.size
        try:
            (expected,) = Fields(read_record(self._source, end, DATA_END)).unpack(U32)
        except MalformedError:  # the summary does not follow the data at once
            return
        if expected and (actual_crc := crc32_of(self._source, 0, end)) != expected:
            reason = (
                f"data section: expected CRC 0x{expected:08x}, found 0x{actual_crc:08x}: metadata, "
                f"definitions or indexes were changed"
            )
            self._note(Damage(0, end, None, None, 0, reason))

    def close(self) -> None:
        """Close the source."""
        self._loader.discard()
        self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _load(self, part: _Part, entry: ChunkEntry, low: int, high: int) -> MessageTable:
        """Give the wanted messages of one chunk; none, and a note, if it is damaged."""
        try:
            records = self._loader.records(part.reader, entry, self._note)
            table, strays = part.reader.messages(records, part.wanted, low, high)
        except MalformedError as error:
            self._refuse(entry, error)
            return MessageTable.none()
        if strays:
            self._lost(entry, strays, gap_reason(entry))
        return part.in_whole(table)

    def _in_time(self, entry: ChunkEntry, table: MessageTable, floor_ns: int) -> MessageTable:
        """Leave out what would go back in time because the chunk states too late a start."""
        late = table.before(floor_ns)
        if not late:
            return table
        reason = f"chunk: expected log times from {entry.start_ns}, found {table[0].log_time}"
        self._lost(entry, late, reason)
        return table[late:]

    def _refuse(self, entry: ChunkEntry, error: MalformedError) -> None:
        """Note that a chunk is left out as a whole."""
        lost = indexed_messages(self._source, entry.offset + entry.length).messages
        self._lost(entry, lost, f"chunk: {error}")

    def _lost(self, entry: ChunkEntry, messages: int | None, reason: str) -> None:
        self._note(
            Damage(entry.offset, entry.length, entry.start_ns, entry.end_ns, messages, reason)
        )

    def _note(self, damage: Damage) -> None:
        if self._strict:
            raise FormatError(f"{self.name}: byte {damage.offset}: {damage.reason}")
        self._damage.setdefault((damage.offset, damage.reason), damage)


@dataclass(frozen=True, slots=True)
class FileIndex:
    """All that is known of a file before its messages are read.

    Attributes
    ----------
    profile, library
        Of the Header record.
    definitions
        Schemas and channels.
    segments
        The files it consists of: one, unless some were put together.
    chunks
        Where the messages are, in the order (start time, offset).
    attachments, metadata
        In the order of the file.
    message_counts
        Messages by channel id.
    start_ns, end_ns
        First and last log time; 0 without messages.
    indexed
        True if the summary was used.
    damage
        What was found wrong so far.
    """

    profile: str
    library: str
    definitions: Definitions
    segments: tuple[Segment, ...]
    chunks: tuple[ChunkEntry, ...]
    attachments: tuple[AttachmentRef, ...]
    metadata: tuple[MetadataRecord, ...]
    message_counts: dict[int, int]
    start_ns: int
    end_ns: int
    indexed: bool
    damage: tuple[Damage, ...]


def load_index(source: ByteSource) -> FileIndex:
    """Find out what ``source`` holds.

    Raises
    ------
    FormatError
        If the source neither begins as an MCAP file nor has a sound summary. Every other fault is
        a `Damage`.
    """
    start = source.read_at(0, len(MAGIC))
    damage: list[Damage] = []
    index = _from_summary(source, damage)
    if start != MAGIC:
        fault = (
            f"start of file: expected the MCAP magic {MAGIC.hex(' ')}, "
            f"found {start.hex(' ') or 'an empty file'}"
        )
        # a summary that passes its checks proves that this was an MCAP file
        if index is None:
            raise FormatError(f"{source.name}: {fault}")
        damage.insert(0, Damage(0, len(MAGIC), None, None, 0, fault))
    index = index or _from_scan(source)
    return replace(index, damage=(*damage, *index.damage))


def _from_summary(source: ByteSource, damage: list[Damage]) -> FileIndex | None:
    try:
        summary = read_summary(source)
    except MalformedError as error:
        reason = f"summary: {error}; recovered by a front scan"
        damage.append(Damage(source.size, 0, None, None, 0, reason))
        return None
    if summary is None or summary.statistics is None:
        return None
    profile, library = _header(source, damage)
    stated = summary.statistics
    # Messages outside chunks stay unread here: with chunk indexes present they are invisible to
    # every indexed reader (MCAP specification, "Chunk Index").
    return FileIndex(
        profile,
        library,
        summary.definitions,
        (Segment(summary.definitions),),
        _in_order(summary.chunks),
        tuple(summary.attachments),
        tuple(_metadata(source, summary.metadata, damage)),
        stated.message_counts,
        stated.start_ns,
        stated.end_ns,
        indexed=True,
        damage=(),
    )


def _from_scan(source: ByteSource) -> FileIndex:
    damage: list[Damage] = []
    profile, library = _header(source, damage)
    scans, several = distinct(source, front_scan(source))
    joined = join(scans)
    return FileIndex(
        profile,
        library,
        joined.definitions,
        joined.segments,
        _in_order(joined.chunks),
        tuple(ref for scan in scans for ref in scan.attachments),
        tuple(record for scan in scans for record in scan.metadata),
        joined.counts,
        min((chunk.start_ns for chunk in joined.chunks), default=0),
        max((chunk.end_ns for chunk in joined.chunks), default=0),
        indexed=False,
        damage=(*damage, *(d for scan in scans for d in scan.damage), *several),
    )


def _header(source: ByteSource, damage: list[Damage]) -> tuple[str, str]:
    try:
        fields = Fields(read_record(source, len(MAGIC), HEADER))
        return fields.text(), fields.text()
    except MalformedError as error:
        damage.append(Damage(len(MAGIC), 0, None, None, 0, f"header: {error}"))
        return "", ""


def _metadata(
    source: ByteSource, spans: list[tuple[int, int, str]], damage: list[Damage]
) -> list[MetadataRecord]:
    """Return the records of an index; one that is not as long or called as it says is damage."""
    records = []
    for offset, length, name in spans:
        try:
            content = read_record(source, offset, METADATA)
            record = parse_metadata(content)
            size = RECORD_HEAD.size + len(content)
            if (record.name, size) != (name, length):
                raise MalformedError(
                    f"expected {name!r} of {length} bytes, found {record.name!r} of {size}"
                )
            records.append(record)
        except MalformedError as error:
            damage.append(Damage(offset, length, None, None, 0, f"metadata: {error}"))
    return records


def _in_order(chunks: list[ChunkEntry]) -> tuple[ChunkEntry, ...]:
    return tuple(sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset)))


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
        Offset, length and name of each Metadata record.
    statistics
        None where the summary has none.
    """

    def __init__(self) -> None:
        self.definitions = Definitions()
        self.channels: list[memoryview] = []
        self.chunks: list[ChunkEntry] = []
        self.attachments: list[AttachmentRef] = []
        self.metadata: list[tuple[int, int, str]] = []
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
            fields = Fields(content)
            offset, length = fields.unpack(U64_U64)
            self.metadata.append((offset, length, fields.text()))
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
        offsets = _pairs(fields.blob(fields.unpack(U32)[0]))
        # An empty map means that the writer kept no message index, not that the chunk is empty.
        ids = frozenset(channel for channel, _ in offsets) or None
        (indexed,) = fields.unpack(U64)
        counts = _counts(offsets, offset + length + indexed)
        self.chunks.append(ChunkEntry(offset, length, start_ns, end_ns, ids, counts=counts))

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
    if crc and (actual_crc := crc32_of(source, start, source.size - len(MAGIC) - U32.size)) != crc:
        raise MalformedError(f"expected CRC 0x{crc:08x}, found 0x{actual_crc:08x}")
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


#: Bytes of a MessageIndex record without entries: its head, a channel's id, the entries' length.
#: Source: MCAP specification, "Message Index".
_INDEX_BYTES = RECORD_HEAD.size + 2 + U32.size


def _counts(offsets: Sequence[tuple[int, int]], end: int) -> tuple[tuple[int, int], ...]:
    """Return how many messages each channel has in a chunk, by the lengths of its indexes.

    Parameters
    ----------
    offsets
        Id of each channel, and the offset of its MessageIndex record; they follow each other.
    end
        Where the last one ends.

    Returns
    -------
    Nothing where there are none, or of other lengths than such indexes are.
    """
    if not offsets:
        return ()
    placed = sorted(offsets, key=itemgetter(1))
    ends = [*(at for _, at in placed[1:]), end]
    sizes = [(i, stop - at - _INDEX_BYTES) for (i, at), stop in zip(placed, ends, strict=True)]
    if any(size < 0 or size % U64_U64.size for _, size in sizes):
        return ()
    return tuple((i, size // U64_U64.size) for i, size in sizes)


class ChunkLoader:
    """Gives the records of a file's chunks, and those of the last one again without reading it.

    Whoever opens a recording asks for the first messages of one channel after the other.

    Parameters
    ----------
    source
        The file.
    chunks
        Its chunks as the index has them.
    """

    def __init__(self, source: ByteSource, chunks: Sequence[ChunkEntry]) -> None:
        self._source = source
        self._chunks = chunks
        self._scanned: tuple[ChunkEntry, ...] | None = None
        self._last: tuple[int, memoryview] | None = None

    def records(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        """Give the records of a chunk.

        By its own fields if only its opcode or length is wrong, of which ``note`` is told; if it is
        not where the index says, a front scan looks for it.

        Raises
        ------
        MalformedError
            Where that does not help.
        """
        if self._last is not None and self._last[0] == entry.offset:
            return self._last[1]
        self._last = None  # its memory is wanted for the next one
        records = self._read(reader, entry, note)
        self._last = (entry.offset, records)
        return records

    def discard(self) -> None:
        """Let go of the last chunk."""
        self._last = None

    def _read(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        try:
            return reader.records(entry)
        except MisplacedError:
            with suppress(MalformedError):
                return self._mended(reader, entry, note)
            for other in self._unindexed_chunks():
                if (other.start_ns, other.end_ns) == (entry.start_ns, entry.end_ns):
                    return reader.records(other)
            raise

    def _mended(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        records = reader.mended(entry)
        reason = reader.head_fault(entry)
        note(Damage(entry.offset, RECORD_HEAD.size, None, None, 0, reason))
        return records

    def _unindexed_chunks(self) -> tuple[ChunkEntry, ...]:
        if self._scanned is None:
            indexed = {chunk.offset for chunk in self._chunks}
            chunks = front_scan(self._source)[0].chunks
            self._scanned = tuple(c for c in chunks if not c.bare and c.offset not in indexed)
        return self._scanned


# Overlapping chunks may take so much memory together, or so much for each byte of a larger file: a
# megabyte that overlaps itself a thousand times is no recording. Chosen by judgement: 128 MiB are
# five hundred of our own chunks, and 64 is more than what sensors record is compressed.
_OVERLAP_BYTES = 1 << 27
_OVERLAP_RATIO = 64
# Later than any message: log times are u64.
_NEVER_NS = 1 << 64
_NONE = MessageTable.none()

#: Of a chunk the first log time that is left, its offset, and what is left.
_Left = tuple[int, int, MessageTable]


def merge(
    chunks: Sequence[ChunkEntry],
    load: Callable[[ChunkEntry, int], MessageTable],
    refuse: Callable[[ChunkEntry, MalformedError], None],
    room_bytes: int,
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
    refuse
        Takes note of a chunk that is left out because too much overlaps.
    room_bytes
        The most that chunks in memory may take together; one alone may take more.
    """
    left: list[_Left] = []
    floor_ns = 0
    for index, chunk in enumerate(chunks):
        table = load(chunk, floor_ns)
        taken = table.nbytes + sum(run.nbytes for _, _, run in left)
        if left and taken > room_bytes:
            table = _NONE
            reason = f"expected overlapping chunks of at most {room_bytes} bytes, found {taken}"
            refuse(chunk, MalformedError(reason))
        _keep(left, chunk.offset, table)
        following = chunks[index + 1 : index + 2]
        table = _take_before(left, following[0].start_ns if following else _NEVER_NS)
        if table:
            floor_ns = int(table.rows["log_time"][-1])
            yield table
        del table  # its memory is wanted for the next chunk


def _keep(left: list[_Left], offset: int, run: MessageTable) -> None:
    if run:
        heappush(left, (int(run.rows["log_time"][0]), offset, run))


def _take_before(left: list[_Left], stop_ns: int) -> MessageTable:
    """Take out the messages before a time [ns], in order."""
    runs: dict[int, MessageTable] = {}
    while left and left[0][0] < stop_ns:
        _, offset, run = heappop(left)
        stop = run.before(stop_ns)
        runs[offset] = run[:stop]
        _keep(left, offset, run[stop:])
    parts = [runs[offset] for offset in sorted(runs)]
    return MessageTable.joined(parts).in_order() if len(parts) > 1 else (parts or [_NONE])[0]


@dataclass(frozen=True, slots=True)
class Segment:
    """One of the files in a source.

    Attributes
    ----------
    definitions
        Its own schemas and channels.
    ids
        Id of each of its channels in the whole; None where they are the same.
    """

    definitions: Definitions
    ids: Mapping[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Joined:
    """Several scans as one.

    Attributes
    ----------
    segments
        The files.
    definitions
        Of the whole.
    chunks
        With the ids of the whole.
    counts
        Messages by channel id of the whole.
    """

    segments: tuple[Segment, ...]
    definitions: Definitions
    chunks: list[ChunkEntry]
    counts: dict[int, int]


def distinct(source: ByteSource, scans: Sequence[Scan]) -> tuple[list[Scan], list[Damage]]:
    """Leave out scans of the same bytes as an earlier one; say where each file begins."""
    seen: dict[tuple[int, int], int] = {}
    unique, damage = [], []
    for scan in scans:
        length = scan.stop - scan.start
        # one file alone has nothing to be compared with
        key = (length, crc32_of(source, scan.start, scan.stop) if len(scans) > 1 else 0)
        first = seen.setdefault(key, scan.start)
        if first == scan.start:
            unique.append(scan)
        if scan.start:
            actual = "another begins; both are read" if first == scan.start else "a copy of it"
            reason = f"files: expected the end of the file, found {actual}"
            damage.append(Damage(scan.start, length, None, None, 0, reason))
    return unique, damage


def join(scans: Sequence[Scan]) -> Joined:
    """Put scans together; the first keeps its ids."""
    joined = Definitions()
    segments, chunks, counts = [], [], Counter[int]()
    for number, scan in enumerate(scans):
        ids = _added(joined, scan.definitions)
        same = all(old == new for old, new in ids.items())
        segments.append(Segment(scan.definitions, None if same else ids))
        for chunk in scan.chunks:
            channels = frozenset(ids[i] for i in chunk.channel_ids or ())
            chunks.append(replace(chunk, channel_ids=channels, segment=number))
        for channel, messages in scan.message_counts().items():
            counts[ids[channel]] += messages
    return Joined(tuple(segments), joined, chunks, dict(counts))


def _added(joined: Definitions, part: Definitions) -> dict[int, int]:
    """Add the definitions of one file; give the new id of each of its channels."""
    schemas, earlier = {0: 0}, dict(joined.schemas)
    for schema in part.schemas.values():
        equal_ids = (s.id for s in earlier.values() if replace(s, id=schema.id) == schema)
        schemas[schema.id] = new = _new_id(joined.schemas, schema.id, equal_ids)
        joined.schemas[new] = replace(schema, id=new)
    ids, before = dict[int, int](), dict(joined.channels)
    for channel in part.channels.values():
        moved = replace(channel, schema_id=schemas[channel.schema_id])
        # two channels of one file stay two, even where they say the same
        equal_ids = (c.id for c in before.values() if replace(c, id=channel.id) == moved)
        ids[channel.id] = new = _new_id(
            joined.channels, channel.id, (i for i in equal_ids if i not in ids.values())
        )
        joined.channels[new] = replace(moved, id=new)
    return ids


def _new_id(taken: Mapping[int, object], wanted: int, equal_ids: Iterable[int]) -> int:
    """Give the id of the same thing, the wanted one if it is free, or the next free one."""
    existing = next(iter(equal_ids), None)
    if existing is not None:
        return existing
    return wanted if wanted not in taken else next(i for i in count(1) if i not in taken)


#: Times that go back by no more than this are those of messages that came late [ns].
BACK_NS = 1_000_000_000
#: Fewest messages, before a step and after it, in the time that is shown twice, and what part of
#: them has one of the others within the mean interval: late messages fill a hole, those of a clock
#: that was set back do not.
_FEWEST, _DENSE = 3, 0.5
#: Times beyond are of no clock [ns].
_LATEST_NS = 2**62


def set_backs(times_ns: Times) -> list[tuple[int, int]]:
    """Return where a clock was set back, and by how much.

    Parameters
    ----------
    times_ns
        Shape (n,): in the order in which they were recorded [ns].

    Returns
    -------
    Of each step the index of the first time after it, and the sum of it and all before [ns]: with
    that added, the times go on by the usual interval.
    """
    steps = np.diff(times_ns)
    places = np.flatnonzero(steps < -BACK_NS) + 1
    if not len(places):
        return []
    usual_ns = round(float(np.median(steps[steps >= 0]))) if (steps >= 0).any() else 0
    jumps: list[tuple[int, int]] = []
    begin, total = 0, 0
    for index, after in zip(places.tolist(), [*places[1:].tolist(), len(times_ns)], strict=True):
        earlier, later = times_ns[begin:index], times_ns[index:after]
        if _show_the_same(earlier, later):
            total += int(earlier.max()) - int(later[0]) + usual_ns
            if total + int(later.max()) >= _LATEST_NS:
                return []
            jumps.append((index, total))
            begin = index
    return jumps


def _show_the_same(earlier: Times, later: Times) -> bool:
    """Return whether the times from a step on, up to where it came from, were shown before it."""
    low, high = int(later[0]), min(int(earlier.max()), int(later.max()))
    shown = np.sort(earlier[(earlier >= low) & (earlier <= high)])
    again = np.sort(later[(later >= low) & (later <= high)])
    if min(len(shown), len(again)) < _FEWEST:
        return False
    apart_ns = (int(earlier.max()) - int(earlier.min())) / (len(earlier) - 1)
    return all(
        np.mean(_nearest_ns(one, other) <= apart_ns) >= _DENSE
        for one, other in ((shown, again), (again, shown))
    )


def _nearest_ns(times: Times, others: Times) -> Times:
    """Return how far each time is from the nearest of other sorted ones, shape (n,) [ns]."""
    after = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    apart_ns: Times = np.minimum(np.abs(times - others[after - 1]), np.abs(times - others[after]))
    return apart_ns


class _Steps(NamedTuple):
    """Of one channel: the places in the file from which on its messages are read later.

    ``places`` are offsets of the chunk and of the record in it [bytes], ``later_ns`` by how much.
    """

    places: list[tuple[int, int]]
    later_ns: list[int]

    def at(self, chunk: int, records: Times) -> Times:
        """Return by how much the messages of a chunk are read later, shape (n,) [ns]."""
        later_ns = np.zeros(len(records), np.int64)
        for (offset, record), total in zip(self.places, self.later_ns, strict=True):
            if offset < chunk:
                later_ns[:] = total
            elif offset == chunk:
                later_ns[records >= record] = total
        return later_ns


class _Series(NamedTuple):
    """The messages of one channel in the order of the file: log times, and where they lie."""

    times_ns: Times
    chunks: Times
    records: Times

    @property
    def usual_ns(self) -> int:
        """The usual interval [ns]."""
        steps = np.diff(self.times_ns)
        return round(float(np.median(steps[steps >= 0]))) if (steps >= 0).any() else 0


@dataclass(frozen=True, slots=True, eq=False)
class ReadingClock:
    """At what times the messages of a file are read whose clock was set back.

    Attributes
    ----------
    chunks
        Where the messages are, with times of reading, in the order (start time, offset).
    edges_ns
        Times of reading of the first message after each step, in order.
    latest_ns
        By how much a message is read later than it was logged at most.
    """

    chunks: tuple[ChunkEntry, ...]
    edges_ns: tuple[int, ...]
    latest_ns: int
    _steps: dict[int, _Steps]

    def read(self, entry: ChunkEntry, table: MessageTable) -> MessageTable:
        """Return a chunk's messages with their times of reading as log times."""
        ids = [i for i in table.counts() if i in self._steps]
        if not ids:
            return table
        rows = table.rows.copy()
        for i in ids:
            mine = rows["channel_id"] == i
            # a row tells where the payload begins, behind the head of its record
            later_ns = self._steps[i].at(entry.offset, rows["start"][mine])
            rows["log_time"][mine] += later_ns.astype(np.uint64)
        return type(table)(table.pieces, rows)


def reading_clock(
    source: ByteSource,
    chunks: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
    *,
    near: bool,
) -> ReadingClock | None:
    """Return when messages are to be read, or None where no clock was set back.

    Parameters
    ----------
    source
        The file.
    chunks, segments
        Of its index.
    wanted
        Channels that are asked about; others are read when they were logged.
    near
        Whether the file is of this machine. The indexes behind the chunks tell: they are looked at
        where a chunk is longer than a second, else where chunks overlap by more than that.
    """
    ordered = sorted((c for c in chunks if not c.bare), key=lambda chunk: chunk.offset)
    long = near and any(c.end_ns - c.start_ns > BACK_NS for c in ordered)
    if not wanted or not (long or _overlap(ordered)):
        return None
    back = _gone_back(source, ordered, segments, wanted)
    series = _series(source, ordered, segments, back)
    jumps = {
        i: channel_jumps for i, one in series.items() if (channel_jumps := set_backs(one.times_ns))
    }
    if not jumps:
        return None
    jumps = _together(jumps, series)
    steps: dict[int, _Steps] = {}
    edges: set[int] = set()
    for i, channel_jumps in jumps.items():
        one = series[i]
        places = [(int(one.chunks[at]), int(one.records[at])) for at, _ in channel_jumps]
        steps[i] = _Steps(places, [later_ns for _, later_ns in channel_jumps])
        edges.update(int(one.times_ns[at]) + later_ns for at, later_ns in channel_jumps)
    latest_ns = max(shift.later_ns[-1] for shift in steps.values())
    return ReadingClock(_as_read(chunks, steps, wanted), tuple(sorted(edges)), latest_ns, steps)


def _overlap(ordered: Sequence[ChunkEntry]) -> bool:
    """Return whether a chunk goes back to a time that those before it had left."""
    reached: dict[int, int] = {}
    for chunk in ordered:
        for i in chunk.channel_ids or ():
            if chunk.start_ns < reached.get(i, 0) - BACK_NS:
                return True
            reached[i] = max(reached.get(i, 0), chunk.end_ns)
    return False


def _indexed(
    source: ByteSource, chunk: ChunkEntry, segments: Sequence[Segment], wanted: Collection[int]
) -> Iterator[tuple[int, Times]]:
    """Yield of each wanted channel of a chunk its log times and the places of its records."""
    ids = segments[chunk.segment].ids
    for part_id, entries in indexed_times(source, chunk.offset + chunk.length):
        i = part_id if ids is None else ids.get(part_id, -1)
        if i in wanted:
            sound = (entries[:, 0] >= 0) & (entries[:, 0] < _LATEST_NS)
            yield i, entries[sound]


def _gone_back(
    source: ByteSource,
    ordered: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
) -> set[int]:
    """Return the channels of which a time goes back by more than a late message's."""
    back: set[int] = set()
    reached: dict[int, int] = {}
    for chunk in ordered:
        for i, entries in _indexed(source, chunk, segments, wanted):
            times_ns = entries[:, 0]
            before = np.maximum.accumulate(np.append(reached.get(i, 0), times_ns))
            if (times_ns < before[:-1] - BACK_NS).any():
                back.add(i)
            reached[i] = int(before[-1])
    return back


def _series(
    source: ByteSource,
    ordered: Sequence[ChunkEntry],
    segments: Sequence[Segment],
    wanted: Collection[int],
) -> dict[int, _Series]:
    parts: defaultdict[int, list[tuple[Times, int]]] = defaultdict(list)
    for chunk in ordered if wanted else ():
        for i, entries in _indexed(source, chunk, segments, wanted):
            parts[i].append((entries, chunk.offset))
    return {
        i: _Series(
            np.concatenate([entries[:, 0] for entries, _ in pieces]),
            np.concatenate([np.full(len(entries), offset) for entries, offset in pieces]),
            np.concatenate([entries[:, 1] for entries, _ in pieces]),
        )
        for i, pieces in parts.items()
    }


def _together(
    jumps: Mapping[int, list[tuple[int, int]]], series: Mapping[int, _Series]
) -> dict[int, list[tuple[int, int]]]:
    """Let channels whose clock was set back together go on together: the fastest tells by what.

    A channel knows its own step to one interval only.
    """
    references: list[tuple[int, int]] = []  # of a step the last time before it, and its length [ns]
    out = {}
    for i in sorted(jumps, key=lambda i: series[i].usual_ns):
        one, total, before = series[i], 0, 0
        out[i] = list[tuple[int, int]]()
        for at, sum_ns in jumps[i]:
            last_ns, length_ns = int(one.times_ns[:at].max()), sum_ns - before
            reach_ns = 2 * one.usual_ns + BACK_NS // 2
            matches = [
                reference
                for reference in references
                if abs(reference[0] - last_ns) <= reach_ns
                and abs(reference[1] - length_ns) <= reach_ns
            ]
            if not matches:
                references.append((last_ns, length_ns))
            total, before = total + (matches[0][1] if matches else length_ns), sum_ns
            out[i].append((at, total))
    return out


def _as_read(
    chunks: Sequence[ChunkEntry], steps: Mapping[int, _Steps], wanted: Collection[int]
) -> tuple[ChunkEntry, ...]:
    """Return chunks with times of reading, which their messages do not leave."""
    moved = []
    ends = np.array([0, 2**62])
    for chunk in chunks:
        ids = set(wanted) if chunk.channel_ids is None else chunk.channel_ids & set(wanted)
        shifts = [0]
        if ids and not chunk.bare:
            none = np.zeros(2, np.int64)
            per = [steps[i].at(chunk.offset, ends) if i in steps else none for i in ids]
            shifts = np.concatenate(per).tolist()
        start_ns, end_ns = chunk.start_ns + min(shifts), chunk.end_ns + max(shifts)
        moved.append(replace(chunk, start_ns=start_ns, end_ns=end_ns))
    return tuple(sorted(moved, key=lambda chunk: (chunk.start_ns, chunk.offset)))
