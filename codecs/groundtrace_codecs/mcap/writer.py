"""Writes MCAP files: chunks that hold one kind of content each, their indexes and the summary.

A reader of one kind of content does not decompress the others, and each kind is compressed as suits
it. Schemas and channels lie in the chunks of the kind that needs them, before its first message, so
that the messages of a torn file can still be decoded.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
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

from ..errors import CodecError, NoRoomError
from ..signals import PREVIEW_KEY
from .chunks import (
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    MESSAGE,
    MESSAGE_FIELDS,
    MESSAGE_INDEX,
    METADATA_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from mcap.records import McapRecord

    from .chunks import ChannelRecord, Message
    from .chunks import Schema as chunks_Schema

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
        """Write a message; its times [ns] are 0 or more.

        Chunks that it ends are passed on at once: somebody may follow the file.
        """
        length = self._open_of[channel_id].add(channel_id, log_ns, data, publish_ns, sequence)
        if length > self._chunk_bytes:
            self.flush()

    def add_attachment(
        self, made_ns: int, log_ns: int, name: str, media_type: str, data: bytes
    ) -> None:
        """Write an attachment, with the times it was made and recorded at [ns]."""
        record = encoded(Attachment(made_ns, log_ns, name, media_type, data))
        entry = (self._length, len(record), log_ns, made_ns, len(data))
        self._attachments.append(AttachmentIndex(*entry, name, media_type))
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
        position = index_start = offset + len(parts[0])
        offsets: dict[int, int] = {}
        for channel_id, entries in index.items():
            offsets[channel_id] = position
            parts.append(_index_record(channel_id, entries))
            position += len(parts[-1])
        return b"".join(parts), ChunkIndex(
            chunk_length=len(parts[0]),
            chunk_start_offset=offset,
            compression=self._compression,
            compressed_size=len(packed),
            message_end_time=end_ns,
            message_index_length=position - index_start,
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


TOOL = "groundtrace"
#: Length at which a chunk is ended, before compression [bytes].
CHUNK_BYTES = 1 << 20
_COMPRESSIONS = ("zstd", "lz4", "none")
# Kinds of content, which get chunks of their own, and their levels of zstd. Samples are noise for
# the most part: a higher level takes longer and finds nothing more in them.
_OTHERS, _WAVEFORMS, _PREVIEWS = range(3)
_LEVELS = (3, 1, 3)


def tool_version() -> str:
    """Return the installed version of groundtrace; ``0`` where it runs from a bare checkout."""
    # reading needs none, and it takes a while to load
    from importlib.metadata import PackageNotFoundError, version

    with suppress(PackageNotFoundError):
        return version(TOOL)
    return "0"


@dataclass(frozen=True, slots=True)
class Output:
    """An MCAP channel to be written: topic, message type and metadata."""

    topic: str
    schema: str
    schema_encoding: str
    schema_data: bytes = field(repr=False)
    encoding: str
    metadata: tuple[tuple[str, str], ...] = ()
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        content = (self.topic, self.schema, self.schema_data, self.metadata)
        object.__setattr__(self, "_hash", hash(content))

    def __hash__(self) -> int:
        """Return what was computed once: each message asks for the id of its channel."""
        return self._hash


class Packet(NamedTuple):
    """One message to be written; times in ns."""

    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class _Growing:
    """The partial file; a disk that is full, or a limit that is reached, is a CodecError.

    Attributes
    ----------
    failed
        True once a write failed: what follows would not fit to what is there.
    """

    def __init__(self, partial: Path, path: Path) -> None:
        self._partial, self._path = partial, path
        self.failed = False
        try:
            self._file = partial.open("wb")
        except OSError as error:
            raise CodecError(
                f"{path}: expected a place to write, found: {error.strerror}"
            ) from error

    def write(self, data: bytes) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            raise self._full(error) from error

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            raise self._full(error) from error

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            # said already, where an earlier write failed
            if not self.failed:
                raise self._full(error) from error

    def _full(self, error: OSError) -> CodecError:
        self.failed = True
        remedy = (
            f"; what was written stays: groundtrace doctor {self._partial} --repair {self._path}"
        )
        return NoRoomError(self._path, error.strerror, remedy)


class Container:
    """An MCAP file that grows as ``NAME.partial``, or with another ending.

    Parameters
    ----------
    path
        Its name in the end.
    compression
        ``zstd``, ``lz4`` or ``none``.
    force
        Replace an existing file.
    chunk_bytes
        Length at which a chunk is ended, before compression.
    profile
        Of the Header record.
    ending
        What the file's name ends in while it grows.

    Raises
    ------
    CodecError
        Where the file exists already and ``force`` is not given, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        compression: str,
        force: bool,
        chunk_bytes: int = CHUNK_BYTES,
        profile: str = "",
        ending: str = "partial",
    ) -> None:

        self.path = path
        self._partial = path.with_name(f"{path.name}.{ending}")
        if path.exists() and not force:
            raise CodecError(f"{path}: expected a new file, found an existing one")
        if compression not in _COMPRESSIONS:
            names = ", ".join(_COMPRESSIONS)
            raise CodecError(f"{path}: compression: expected one of {names}, found {compression!r}")
        self._file = _Growing(self._partial, path)
        library = f"{TOOL} {tool_version()}"
        self._mcap = McapWriter(self._file, compression, _LEVELS, chunk_bytes, profile, library)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[Output, int] = {}

    def channel(self, output: Output) -> int:
        """Return the id of a channel, registered at its first use."""
        channel_id = self._channels.get(output)
        if channel_id is None:
            schema_id = self._schema(output.schema, output.schema_encoding, output.schema_data)
            metadata = dict(output.metadata)
            kind = _kind(output.schema, metadata)
            channel_id = self._mcap.add_channel(
                output.topic, output.encoding, schema_id, metadata, kind
            )
            self._channels[output] = channel_id
        return channel_id

    def flush(self) -> None:
        """End the chunks in progress."""
        self._mcap.flush()

    def send(self, output: Output, packet: Packet) -> None:
        """Write one message.

        Raises
        ------
        CodecError
            Where one of its times is negative, which MCAP cannot hold.
        """
        log_ns, publish_ns, sequence, data = packet
        if log_ns < 0 or publish_ns < 0:
            earliest = min(publish_ns, log_ns)
            raise CodecError(
                f"{self.path}: {output.topic}: expected times >= 0, found {earliest} ns"
            )
        self._mcap.add_message(self.channel(output), log_ns, data, publish_ns, sequence)

    def copy_channel(self, channel: ChannelRecord, schema: chunks_Schema | None) -> int:
        """Register a channel of another file, and return its id in this one."""
        schema_id = 0 if schema is None else self.copy_schema(schema)
        kind = _kind("" if schema is None else schema.name, channel.metadata)
        return self._mcap.add_channel(
            channel.topic, channel.message_encoding, schema_id, channel.metadata, kind
        )

    def copy_schema(self, schema: chunks_Schema) -> int:
        """Register a schema of another file, and return its id in this one."""
        return self._schema(schema.name, schema.encoding, bytes(schema.data))

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        key = (name, encoding, data)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.add_schema(name, encoding, data)
        return self._schemas[key]

    def copy(self, channel_id: int, message: Message) -> None:
        """Write a message of another file on a channel of this one, as it is."""
        self._mcap.add_message(
            channel_id,
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        self._mcap.add_metadata(name, values)

    def add_attachment(
        self, time_ns: int, name: str, media_type: str, data: bytes, created_ns: int | None = None
    ) -> None:
        """Write an attachment; without a time of its own it was made when it was recorded."""
        made_ns = time_ns if created_ns is None else created_ns
        self._mcap.add_attachment(made_ns, time_ns, name, media_type, data)

    def close(self, *, complete: bool) -> None:
        """Write the summary; give the file its name only if it is complete."""
        try:
            if not self._file.failed:
                self._mcap.finish()
        finally:
            self._file.close()
        if complete:
            self._partial.replace(self.path)


def _kind(schema: str, metadata: Mapping[str, str]) -> int:
    """Return the kind of content of a channel, by its message type and metadata."""
    if schema == "groundtrace.WaveformBlock":
        return _WAVEFORMS
    return _PREVIEWS if PREVIEW_KEY in metadata else _OTHERS
