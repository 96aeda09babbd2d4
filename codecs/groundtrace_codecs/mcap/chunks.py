"""Records and chunks of the MCAP format: their fields, and the messages inside a chunk.

A record is ``u8 opcode, u64 length, content``, little-endian (MCAP specification, "Records"). A
known record may carry bytes after the fields known here; they are left unread.

A chunk is delivered whole or not at all, after a checked decompression of bounded size. Its CRC
covers the uncompressed records only, so nothing else of the Chunk record is believed: times and
channels come from a checked summary or from the records themselves.

Each record gives the start of the next one, so messages are found one by one. What a recorder
writes repeats, however. Where the lengths of many records equal those of as many before, the same
pattern is tested on the following bytes all at once. Every record that is taken lies where the one
before it ends, whether its length was predicted or not.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, overload

import lz4.frame
import numpy as np
import zstandard
from zlib_ng import zlib_ng

from ..unpacking import most_unpacked, too_much

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator

    from numpy.typing import NDArray

    from .byte_source import ByteSource

#: Records walked through one by one before their lengths are looked at, at first.
_LOOK: Final = 256
_HEAD: Final = np.dtype([("opcode", "u1"), ("length", "<u8")])


def copied(data: memoryview, places: NDArray[np.int64], size: int) -> NDArray[np.void]:
    """Copy ``size`` bytes at every place, shape (n,); all lie inside."""
    if not len(places):
        return np.empty(0, f"V{size}")
    everywhere = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return everywhere[places]


def message_places(records: memoryview, define: Callable[[int], int]) -> NDArray[np.int64]:
    """Return where each Message record begins, shape (n,).

    Parameters
    ----------
    records
        The content of a chunk.
    define
        Takes the record of another kind at a place, and returns where it ends.

    Raises
    ------
    MalformedError
        If a message is too short, or the records do not fill the chunk exactly.
    struct.error
        If the last one is cut by the chunk's end.
    """
    offsets: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    position, end, look = 0, len(records), _LOOK
    while position < end:
        single, position = _one_by_one(records, position, look, define)
        offsets.append(single)
        if len(single) == look:
            strides, position = _repeated(records, single, position)
            offsets.append(strides)
            look = _LOOK if len(strides) else 2 * look
    if position != end:
        raise MalformedError(f"expected records of {end} bytes, found {position}")
    return np.concatenate(offsets)


def _one_by_one(
    records: memoryview, position: int, most: int, define: Callable[[int], int]
) -> tuple[NDArray[np.int64], int]:
    """Walk until the end, or until ``most`` messages are found; return them and where it ends."""
    # The hot loop: no call a message but unpack and append.
    unpack, head, end = RECORD_HEAD.unpack_from, RECORD_HEAD.size, len(records)
    offsets: list[int] = []
    keep = offsets.append
    while position < end and len(offsets) < most:
        opcode, length = unpack(records, position)
        if opcode != MESSAGE:
            position = define(position)
            continue
        if length < MESSAGE_FIELDS:
            raise MalformedError(f"expected 22 bytes of message fields, found {length}")
        keep(position)
        position += head + length
    # a length may be of any size, and then ends the walk
    return np.array(offsets, np.int64), position


def _repeated(
    records: memoryview, before: NDArray[np.int64], position: int
) -> tuple[NDArray[np.int64], int]:
    """Return the messages from ``position`` on that repeat the lengths before; where they end."""
    nothing = np.empty(0, np.int64)
    if position > len(records):
        return nothing, position
    sizes = np.diff(before, append=position)
    raw = sizes.astype("<u4").tobytes()
    half = len(raw) // 8 * 4
    at = raw.rfind(raw[half:], 0, len(raw) - 4)
    period = (half - at) // 4
    if at < 0 or at % 4:
        return nothing, position
    pattern = sizes[-period:]
    times = (len(records) - position) // int(pattern.sum()) + 1
    guessed = np.tile(pattern, times)
    ends = position + np.cumsum(guessed)
    starts = ends - guessed
    inside = int(np.searchsorted(ends, len(records), side="right"))
    heads = copied(records, starts[:inside], _HEAD.itemsize).view(_HEAD)
    right = (heads["opcode"] == MESSAGE) & (
        heads["length"] == guessed[:inside].astype(np.uint64) - _HEAD.itemsize
    )
    count = inside if right.all() else int(right.argmin())
    return starts[:count], int(ends[count - 1]) if count else position


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
        complete = entries[: len(entries) // U64_U64.size * U64_U64.size]
        rows = np.frombuffer(complete, "<u8").astype(np.int64).reshape(-1, 2)
        yield channel_id, rows[np.argsort(rows[:, 1], kind="stable")]


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


MAGIC: Final = b"\x89MCAP0\r\n"

HEADER: Final = 0x01
FOOTER: Final = 0x02
SCHEMA: Final = 0x03
CHANNEL: Final = 0x04
MESSAGE: Final = 0x05
CHUNK: Final = 0x06
MESSAGE_INDEX: Final = 0x07
CHUNK_INDEX: Final = 0x08
ATTACHMENT: Final = 0x09
ATTACHMENT_INDEX: Final = 0x0A
STATISTICS: Final = 0x0B
METADATA: Final = 0x0C
METADATA_INDEX: Final = 0x0D
DATA_END: Final = 0x0F

#: Opcode and content length that open every record.
RECORD_HEAD: Final = struct.Struct("<BQ")
#: Shortest content of a Message record: its fields, without data.
MESSAGE_FIELDS: Final = 22
#: Larger records are never read whole: their length is taken for damage.
MAX_RECORD_BYTES: Final = 1 << 30

U16: Final = struct.Struct("<H")
U32: Final = struct.Struct("<I")
U64: Final = struct.Struct("<Q")
_U16_U16: Final = struct.Struct("<HH")
U64_U64: Final = struct.Struct("<QQ")


class MalformedError(Exception):
    """Bytes that are not the record they should be: "expected X, found Y".

    Inside this package only; callers see a `Damage` or a `FormatError`.
    """


@dataclass(frozen=True, slots=True)
class Schema:
    """How the messages of a channel are described.

    Attributes
    ----------
    id
        1 to 65535.
    name
        Name of the message type.
    encoding
        Of ``data``: ``protobuf``, ``ros2msg``, ``jsonschema``, ...
    data
        The description itself.
    """

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A topic and the encoding of its messages.

    Attributes
    ----------
    id
        0 to 65535.
    topic
        Name of the stream.
    schema_id
        Of its `Schema`; 0 = none.
    message_encoding
        ``protobuf``, ``cdr``, ``json``, ...
    metadata
        Free text by key.
    """

    id: int
    topic: str
    schema_id: int
    message_encoding: str
    metadata: dict[str, str]


class Message(NamedTuple):
    """One message as recorded.

    Attributes
    ----------
    channel_id
        Of its `ChannelRecord`.
    sequence
        Counter of the writer, 0 where it keeps none.
    log_time
        When it was recorded, ns.
    publish_time
        When it was made, ns.
    data
        Payload; a view keeps the whole chunk it came from in memory.
    """

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes | memoryview


@dataclass(frozen=True, slots=True)
class AttachmentRef:
    """Where an attachment is and what it is called.

    Attributes
    ----------
    offset, length
        Of its record in the file, bytes, opcode and length field included.
    log_time, create_time
        When it was recorded and made, ns.
    size
        Of its content, bytes.
    name, media_type
        File name and MIME type.
    """

    offset: int
    length: int
    log_time: int
    create_time: int
    size: int
    name: str
    media_type: str


@dataclass(frozen=True, slots=True)
class MetadataRecord:
    """Named free text by key."""

    name: str
    values: dict[str, str]


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that was not read, or not as the file says it should be.

    Attributes
    ----------
    offset, length
        The bytes concerned.
    start_ns, end_ns
        First and last log time of the messages lost, where the file still tells; else None.
    messages
        Number of messages lost, where the file still tells; else None.
    reason
        "PLACE: expected X, found Y".
    """

    offset: int
    length: int
    start_ns: int | None
    end_ns: int | None
    messages: int | None
    reason: str


class Fields:
    """Reads the fields of one record's content in order, never past its end.

    Parameters
    ----------
    content
        The record without opcode and length.

    Raises
    ------
    MalformedError
        By every method, if the content is too short or its text is not UTF-8.
    """

    __slots__ = ("_content", "position")

    def __init__(self, content: memoryview) -> None:
        self._content = content
        self.position = 0

    def blob(self, length: int) -> memoryview:
        """Give the next ``length`` bytes."""
        start, self.position = self.position, self.position + length
        if self.position > len(self._content):
            raise MalformedError(
                f"expected {self.position} bytes of fields, found {len(self._content)}"
            )
        return self._content[start : self.position]

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Give the numbers of ``layout``."""
        return layout.unpack(self.blob(layout.size))

    def text(self) -> str:
        """Give a string prefixed with its u32 length."""
        raw = self.blob(self.unpack(U32)[0])
        try:
            return str(raw, "utf-8")
        except UnicodeDecodeError as error:
            raise MalformedError(
                f"expected UTF-8 text, found byte 0x{raw[error.start]:02x}"
            ) from error

    def mapping(self) -> dict[str, str]:
        """Give a map of strings prefixed with its u32 length in bytes."""
        inner = Fields(self.blob(self.unpack(U32)[0]))
        values: dict[str, str] = {}
        while inner.position < len(inner._content):
            key = inner.text()
            values[key] = inner.text()
        return values


def parse_schema(content: memoryview) -> Schema:
    """Read a Schema record's content."""
    fields = Fields(content)
    (schema_id,) = fields.unpack(U16)
    name, encoding = fields.text(), fields.text()
    if schema_id == 0:
        raise MalformedError("expected a schema id from 1 to 65535, found 0")
    return Schema(schema_id, name, encoding, bytes(fields.blob(fields.unpack(U32)[0])))


def parse_channel(content: memoryview) -> ChannelRecord:
    """Read a Channel record's content."""
    fields = Fields(content)
    channel_id, schema_id = fields.unpack(_U16_U16)
    topic, encoding = fields.text(), fields.text()
    return ChannelRecord(channel_id, topic, schema_id, encoding, fields.mapping())


def parse_metadata(content: memoryview) -> MetadataRecord:
    """Read a Metadata record's content."""
    fields = Fields(content)
    return MetadataRecord(fields.text(), fields.mapping())


def parse_attachment(offset: int, length: int, fields: Fields) -> AttachmentRef:
    """Read the fields before an Attachment's data; leaves ``fields`` at the data."""
    log_time, create_time = fields.unpack(U64_U64)
    name, media_type = fields.text(), fields.text()
    (size,) = fields.unpack(U64)
    return AttachmentRef(offset, length, log_time, create_time, size, name, media_type)


def read_record(source: ByteSource, offset: int, opcode: int) -> memoryview:
    """Read the content of the record at ``offset``, which must be of kind ``opcode``.

    Raises
    ------
    MalformedError
        If there is another kind of record, or one that reaches past the end of the source.
    """
    head = source.read_at(offset, RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise MalformedError(f"expected a record, found the end of the file at {source.size}")
    actual, length = RECORD_HEAD.unpack(head)
    if actual != opcode:
        raise MalformedError(f"expected opcode 0x{opcode:02x}, found 0x{actual:02x}")
    start = offset + RECORD_HEAD.size
    room = min(source.size - start, MAX_RECORD_BYTES)
    if length > room:
        raise MalformedError(f"expected a record of at most {room} bytes, found length {length}")
    content = source.read_at(start, length)
    if len(content) < length:
        raise MalformedError(f"expected a record of {length} bytes, found {len(content)}")
    return memoryview(content)


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
    counts
        Id of each channel with messages inside, and how many; empty = unknown.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channel_ids: frozenset[int] | None
    bare: bool = False
    segment: int = 0
    counts: tuple[tuple[int, int], ...] = ()


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
            table = MessageTable.at(records, places)
        except struct.error as error:
            raise MalformedError(
                "expected whole records, found one cut by the chunk's end"
            ) from error
        counts = table.counts()
        chosen = [i for i in counts if i in wanted]
        if len(chosen) < len(counts):
            table = table.of_channels(chosen)
        defined = self.definitions.channels
        strays = sum(n for i, n in counts.items() if i not in wanted and i not in defined)
        return table.between(start_ns, stop_ns).in_order(), strays

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
        possible = len(packed) * _MAX_RATIO[compression]
        limit = min(MAX_RECORD_BYTES, possible, most_unpacked(len(packed)))
        if size > limit:
            raise MalformedError(too_much(limit, len(packed), size))
        records = packed if compression == "" else self._decompress(compression, packed, size)
        if len(records) != size:
            raise MalformedError(f"expected {size} uncompressed bytes, found {len(records)}")
        # A CRC of 0 means that the writer kept none (MCAP specification, "Chunk").
        if crc and (actual_crc := zlib_ng.crc32(records)) != crc:
            raise MalformedError(f"expected chunk CRC 0x{crc:08x}, found 0x{actual_crc:08x}")
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


#: A Message record up to its data (MCAP specification, "Message").
_TABLE_HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("size", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_ROW: Final = np.dtype(
    [
        ("channel_id", "<i8"),
        ("sequence", "<i8"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("piece", "<i8"),
        ("start", "<i8"),
        ("length", "<i8"),
    ]
)
_BYTES: Final = np.dtype(("V", _ROW.itemsize))
_COPIED: Final = ("channel_id", "sequence", "log_time", "publish_time")
#: What messages are ordered by, the first key last.
_ORDER: Final = ("sequence", "channel_id", "log_time")
_LATEST_NS: Final = (1 << 64) - 1
#: Copies of the rows while they are sorted: rows, joined ones, keys, and what they come out as.
_SORTED_ROWS: Final = 4
#: Payloads of at most so many bytes are looked at for whether they are all the same. chosen by
#: judgement: a megabyte that unpacks to millions of messages has short ones.
_SHORT: Final = 256
#: Heads of messages that are copied at once.
_HEADS: Final = 1 << 16
#: Rows that become Python's numbers at once, which take ten times the memory.
_LISTED: Final = 4096


def _heads(
    records: memoryview, places: NDArray[np.int64]
) -> Iterator[tuple[slice, NDArray[np.void]]]:
    """Yield the heads of the messages at some places, and which of the places, some at once."""
    for first in range(0, len(places), _HEADS):
        some = slice(first, first + _HEADS)
        yield some, copied(records, places[some], _TABLE_HEAD.itemsize).view(_TABLE_HEAD)


class MessageTable(Sequence[Message]):
    """Messages in the order of a replay, wherever their payloads lie.

    Parameters
    ----------
    pieces
        Memory that their payloads lie in: of a chunk one, of a part of a recording a few.
    rows
        One per message: its fields, and in which piece its payload starts, where, and its length.
    """

    __slots__ = ("pieces", "rows")

    def __init__(self, pieces: tuple[memoryview, ...], rows: NDArray[np.void]) -> None:
        self.pieces = pieces
        self.rows = rows

    @classmethod
    def at(cls, records: memoryview, places: NDArray[np.int64]) -> Self:
        """Take the messages whose records begin at ``places``, each of them whole."""
        rows = np.empty(len(places), _ROW)
        for some, heads in _heads(records, places):
            for name in _COPIED:
                rows[name][some] = heads[name]
            rows["length"][some] = heads["size"].astype(np.int64) - MESSAGE_FIELDS
        rows["piece"] = 0
        rows["start"] = places + _TABLE_HEAD.itemsize
        return cls((records,), rows)

    @classmethod
    def of(cls, messages: Iterable[Message]) -> Self:
        """Take messages from anywhere, in their order."""
        listed = list(messages)
        sizes = np.array([len(m.data) for m in listed], np.int64)
        rows = np.empty(len(listed), _ROW)
        for column, name in enumerate(_COPIED):
            rows[name] = [m[column] for m in listed]
        rows["piece"], rows["start"], rows["length"] = 0, np.cumsum(sizes) - sizes, sizes
        return cls((memoryview(b"".join(m.data for m in listed)),), rows)

    @classmethod
    def joined(cls, tables: Sequence[MessageTable]) -> MessageTable:
        """Return the messages of several tables, one table after the other."""
        if len(tables) == 1:
            return tables[0]
        # as bytes: numpy compares the fields of structured arrays one by one before it joins them
        rows = np.concatenate([table.rows.view(_BYTES) for table in tables]).view(_ROW)
        first, done = 0, 0
        for table in tables:
            rows["piece"][done : done + len(table)] += first
            first, done = first + len(table.pieces), done + len(table)
        return cls(tuple(piece for table in tables for piece in table.pieces), rows)

    @classmethod
    def none(cls) -> Self:
        """Return no messages."""
        return cls((), np.empty(0, _ROW))

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Message: ...

    @overload
    def __getitem__(self, index: slice) -> MessageTable: ...

    def __getitem__(self, index: int | slice) -> Message | MessageTable:
        if isinstance(index, slice):
            return MessageTable(self.pieces, self.rows[index])
        (message,) = MessageTable(self.pieces, self.rows.take([index]))
        return message

    def __iter__(self) -> Iterator[Message]:
        make, pieces = tuple.__new__, self.pieces
        for first in range(0, len(self), _LISTED):
            rows = self.rows[first : first + _LISTED].tolist()
            for channel_id, sequence, log_ns, publish_ns, piece, start, length in rows:
                payload = pieces[piece][start : start + length]
                yield make(Message, (channel_id, sequence, log_ns, publish_ns, payload))

    @property
    def nbytes(self) -> int:
        """Bytes of memory that hold the messages, what they are sorted in included."""
        return sum(len(piece) for piece in self.pieces) + _SORTED_ROWS * self.rows.nbytes

    def where(self, which: NDArray[np.bool_]) -> MessageTable:
        """Return the messages that a mask chooses."""
        if which.all():
            return self
        # a structured array is indexed field by field, but taken row by row
        return MessageTable(self.pieces, self.rows.take(np.flatnonzero(which)))

    def counts(self) -> Counter[int]:
        """Return how many messages each channel has here, of those that have any, in order."""
        numbers = np.bincount(self.rows["channel_id"])
        ids = np.flatnonzero(numbers)
        return Counter(dict(zip(ids.tolist(), numbers[ids].tolist(), strict=True)))

    def of_channels(self, ids: Sequence[int]) -> MessageTable:
        """Return the messages of some channels."""
        if not len(ids):
            return self[:0]
        selected = self.rows["channel_id"] == ids[0]
        for channel_id in ids[1:]:
            selected |= self.rows["channel_id"] == channel_id
        return self.where(selected)

    def as_logged(self) -> MessageTable:
        """Return the messages of a file with the log times of their records, in the order here."""
        rows = self.rows.copy()
        starts, pieces = rows["start"], rows["piece"]
        ends = [*np.flatnonzero(np.diff(pieces)) + 1, len(rows)] if len(rows) else []
        for begin, end in pairwise([0, *ends]):
            places = starts[begin:end] - _TABLE_HEAD.itemsize
            for some, heads in _heads(self.pieces[pieces[begin]], places):
                rows["log_time"][begin:end][some] = heads["log_time"]
        return MessageTable(self.pieces, rows)

    def same_payload_count(self) -> int:
        """Return how many messages, from the first on, have its payload, if that is a short one.

        Of a table that has some; what is so for the first is so for them, as long as it does not
        depend on the log time.
        """
        size = int(self.rows["length"][0])
        if size > _SHORT:
            return 1
        first, done, step = self._payloads(self.rows[:1], size), 1, 1
        while done < len(self):
            rows = self.rows[done : done + step]
            same = rows["length"] == size
            if size and same.any():
                here = self._payloads(rows[same], size).view(("u1", size))
                same[same] = (here == first.view("u1")).all(axis=1)
            if not same.all():
                return done + int(same.argmin())
            done, step = done + len(rows), 2 * step
        return done

    def before(self, time_ns: int) -> int:
        """Return how many messages were logged before a time [ns], of a table in order."""
        if time_ns > _LATEST_NS:
            return len(self)
        return int(np.searchsorted(self.rows["log_time"], np.uint64(max(time_ns, 0))))

    def between(self, start_ns: int, stop_ns: int) -> MessageTable:
        """Return the messages logged in ``[start_ns, stop_ns)``, of a table in any order."""
        times = self.rows["log_time"]
        inside = np.ones(len(times), np.bool_)
        if start_ns > 0:
            inside &= times >= np.uint64(min(start_ns, _LATEST_NS))
        if stop_ns <= _LATEST_NS:
            inside &= times < np.uint64(max(stop_ns, 0))
        return self.where(inside)

    def in_order(self) -> MessageTable:
        """Return the messages by log time, channel and sequence, else as they lie."""
        right = np.ones(max(len(self) - 1, 0), np.bool_)
        for name in _ORDER:
            column = np.ascontiguousarray(self.rows[name])
            right = (column[1:] > column[:-1]) | ((column[1:] == column[:-1]) & right)
        if right.all():
            return self
        keys = [self.rows[name] for name in _ORDER]
        return MessageTable(self.pieces, self.rows.take(np.lexsort(keys)))

    def by_size(self) -> Iterator[tuple[NDArray[np.intp], NDArray[np.void]]]:
        """Yield the payloads of one size together: their places in the table, and their bytes."""
        lengths = self.rows["length"]
        if len(self) and (lengths == lengths[0]).all():
            yield np.arange(len(self)), self._payloads(self.rows, int(lengths[0]))
            return
        for size in np.unique(lengths).tolist():
            same = np.flatnonzero(lengths == size)
            yield same, self._payloads(self.rows.take(same), size)

    def _payloads(self, rows: NDArray[np.void], size: int) -> NDArray[np.void]:
        """Copy the payloads of some rows, all of one size."""
        starts, pieces = rows["start"], rows["piece"]
        ends = [*np.flatnonzero(np.diff(pieces)) + 1, len(rows)]
        if len(ends) == 1:
            return copied(self.pieces[pieces[0]], starts, size)
        payloads = np.empty(len(rows), f"V{size}")
        for begin, end in pairwise([0, *ends]):
            payloads[begin:end] = copied(self.pieces[pieces[begin]], starts[begin:end], size)
        return payloads
